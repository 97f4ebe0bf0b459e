"""The table of docs/docking.md: `python -m docs.docking`, from the logbook of `make docking`.

A run with `identifier=auto` is deployed with two models, the nominal one, which is wrong, and the
identified one; a run with `identifier=none` is deployed with the true one.
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from docs.pages.markdown import table
from seatrial.runner.compare.frame import Queries, open_results
from seatrial.runner.compare.statistics import paired_test
from seatrial.runner.record.vocabulary import ENDINGS

LOGBOOK = Path(__file__).parents[1] / "results" / "docking" / "results.db"
MODELS = ("nominal", "identified", "true")
FACTORS = ("vessel", "disturbance", "controller")
ORDER = (
    ("milliampere", "supply_vessel", "cybership2"),
    ("calm", "wind+noise", "wind_current+noise"),
    ("nmpc", "mpc_integral", "pid_ff"),
)
WITHIN, WITHIN_DEG = 0.02, 1.0  # [L], of a berthed vessel
ERROR, HEADING = "final_position_error", "final_heading_error"
METRICS = ("contacts", ERROR, HEADING, "time_to_berth", "failures", "step_time_p99")


def dockings(results: Queries) -> pd.DataFrame:
    """One row for each deployment that a run was to have: factors, model, seed and metrics."""
    values = results.metrics(METRICS).set_index(["run", "model", "metric"])["value"].to_dict()
    rows = []
    for run in (run for run in results.runs(factors=()) if run.status in ENDINGS):
        own = {"nominal": "true"} if run.levels["identifier"] == "none" else {}
        for model in own or ("nominal", "identified"):
            numbers = {name: values.get((run.id, model, name), math.nan) for name in METRICS}
            factors = {name: run.levels[name] for name in (*FACTORS, "seed")}
            rows.append({**factors, "model": own.get(model, model), **numbers})
    return pd.DataFrame(rows)


def cell(runs: pd.DataFrame) -> str:
    """Runs with a contact, runs that are not berthed, of all; median error and time to berth."""
    if runs.empty:
        return ""
    touched, berthed = runs["contacts"] > 0.0, in_berth(runs)
    seconds = runs["time_to_berth"].median()  # of those that have one
    return f"{np.sum(touched)} · {np.sum(~berthed)}/{len(runs)} · {runs[ERROR].median():.4f} · " + (
        "–" if math.isnan(seconds) else f"{seconds:.0f} s"
    )


def in_berth(runs: pd.DataFrame) -> pd.Series:
    """Whether each run ended in its berth; one without an error did not."""
    return (runs[ERROR] <= WITHIN) & (runs[HEADING] <= WITHIN_DEG)


def compared(models: Mapping[str, pd.DataFrame]) -> str:
    """The identified model against the nominal one: p of the pairs, and the effect size."""
    pairs = [models[name].set_index("seed")[ERROR] for name in ("identified", "nominal")]
    both = pd.concat(pairs, axis=1, keys=("own", "other")).dropna()
    test = paired_test(both["own"].to_numpy(), both["other"].to_numpy())
    return f"{test.p_value:.2g} ({test.effect:+.2f})" if len(both) > 1 else ""


def lines(frame: pd.DataFrame) -> Sequence[Sequence[str]]:
    """The rows of the table."""
    known = dict(iter(frame.groupby([*FACTORS, "model"])))
    none, result = frame[:0], []
    for vessel, weather, controller in (
        (v, w, c) for v in ORDER[0] for w in ORDER[1] for c in ORDER[2]
    ):
        models = {m: known.get((vessel, weather, controller, m), none) for m in MODELS}
        own = [one for one in models.values() if not one.empty]
        if not own:
            continue
        every = pd.concat(own)
        slowest, failed = every["step_time_p99"].median() / 1e3, every["failures"].sum()
        result.append([
            vessel, weather, f"`{controller}`", *map(cell, models.values()), compared(models),
            f"{slowest:.2g} ms", f"{failed:.0f}",
        ])  # fmt: skip
    return result


def summary(frame: pd.DataFrame) -> str:
    """Contacts and vessels in their berths of all runs of each controller."""
    known = dict(iter(frame.groupby("controller")))
    parts = [
        f"`{name}` {np.sum(own['contacts'] > 0.0)} and {np.sum(in_berth(own))} of {len(own)}"
        for name in ORDER[2]
        if (own := known.get(name)) is not None
    ]
    return f"In all, runs with a contact and runs that ended in the berth: {', '.join(parts)}.\n"


def main() -> None:
    """Print the table."""
    headers = ["vessel", "weather", "controller", *MODELS, "p (size)", "step, 99 %", "failed"]
    with open_results(f"sqlite:///{LOGBOOK}") as results:
        found = dockings(results)
    print(table(headers, lines(found)), summary(found), sep="\n", end="")


if __name__ == "__main__":
    main()
