"""The robustness tables of docs/identification.md: `python -m docs.robustness`.

They are read from the logbook of `make robustness`. All errors are those of velocities on the
held-out part, predicted by free runs that begin again at the measured state every 30 s, or
sooner where errors of the nominal model grow fast (`validation.restart_length`).
"""

import math
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np
import pandas as pd

from docs.pages.markdown import table
from seatrial.runner.compare.frame import Queries, StoredRun, open_results
from seatrial.runner.record.vocabulary import LOST

LOGBOOK = Path(__file__).parents[1] / "results" / "robustness" / "results.db"
PATH = "excitation.path"
SECONDS = "duration_s"
FIT, RMSE = "velocity_fit_restarts", "velocity_rmse_restarts"
LIMITED = ("limited_share_restarts", "limited_share_free_run")
METRICS = (FIT, RMSE, *LIMITED)
NEGLIGIBLE = 1e-3  # error, relative to the spread of a velocity, that cannot be told from none
STILL = 1e-9  # [m/s, rad/s] spread below which nothing moved
WORSE, NEAR = 1.02, 1.10  # worse than the nominal model; near the best identifier
CASES = (
    "calm", "noise", "constant", "wind+noise", "constant+noise", "rough", "constant+noise_process"
)  # fmt: skip
IDENTIFIERS = ("none", "auto", "robust")  # the first rows


@dataclass(frozen=True)
class Case:
    """A vessel under a disturbance, or a recording of one."""

    vessel: str
    name: str  # disturbance, or file without its suffix
    recorded: bool


@dataclass(frozen=True)
class Outcome:
    """One run: FIT [%], errors per degree of freedom relative to two others, and its time [s]."""

    case: Case
    identifier: str
    fit: float  # -inf: there is no prediction
    to_none: Mapping[str, float]  # error over that of the nominal model
    to_mean: Mapping[str, float]  # error over that of the mean motion
    diverged: bool  # failed, or its rates had to be limited
    seconds: float

    @property
    def nrmse(self) -> float:
        """Mean error over the spread of the velocities."""
        return max(1.0 - self.fit / 100.0, NEGLIGIBLE)

    @property
    def worst(self) -> float:
        """The ratio to the nominal model of the degree of freedom where it is largest."""
        return max(self.to_none.values(), default=math.inf)


def outcomes(results: Queries) -> list[Outcome]:
    """The outcomes of all runs that ended."""
    runs = [run for run in results.runs(factors=(PATH, SECONDS)) if run.status != "running"]
    numbers = results.metrics(METRICS)
    by_run = dict(iter(numbers[np.isfinite(numbers["value"])].groupby("run")))
    return [outcome_of(run, by_run.get(run.id, numbers[:0])) for run in runs]


def outcome_of(run: StoredRun, numbers: pd.DataFrame) -> Outcome:
    """The outcome of a run with these metrics."""
    held = numbers.set_index(["model", "metric", "dof"])["value"].to_dict()
    errors: dict[str, dict[str, float]] = {"nominal": {}, "identified": {}, "mean_motion": {}}
    for (model, name, dof), value in held.items():
        if name == RMSE and model in errors:
            errors[model][dof] = value
    spread = {dof: value for dof, value in errors["mean_motion"].items() if value > STILL}
    path, seconds = run.levels[PATH], run.levels[SECONDS]
    recorded = path != "none"
    limited = any(held.get(("identified", name, "all"), 0.0) > 0.0 for name in LIMITED)
    return Outcome(
        Case(
            run.levels["vessel"],
            Path(path).stem if recorded else run.levels["disturbance"],
            recorded,
        ),
        run.levels["identifier"],
        held.get(("identified", FIT, "all"), -math.inf),
        ratios(errors["identified"], errors["nominal"], spread),
        ratios(errors["identified"], spread, spread),
        run.status in LOST or limited,
        math.nan if seconds == "none" else float(seconds),
    )


def ratios(
    own: Mapping[str, float], other: Mapping[str, float], spread: Mapping[str, float]
) -> dict[str, float]:
    """Errors over those of another model, per degree of freedom that moved.

    A model without an error does not predict: it is infinitely worse than one that does. Errors
    that are negligible beside the spread of the motion count as equal.
    """

    def error(of: Mapping[str, float], dof: str) -> float:
        return max(of.get(dof, math.inf), NEGLIGIBLE * spread[dof])

    found = {}
    for dof in spread:
        mine, reference = error(own, dof), error(other, dof)
        found[dof] = 1.0 if mine == reference else mine / reference
    return found


def cell(runs: Sequence[Outcome]) -> str:
    """Median FIT, diverged of all, worst ratio to the nominal model, seconds."""
    diverged = sum(run.diverged for run in runs)
    fit, worst = median(run.fit for run in runs), median(run.worst for run in runs)
    return (
        f"{shown(fit, '.1f')} · {diverged}/{len(runs)} · {shown(worst, '.2f')} ·"
        f" {median(run.seconds for run in runs):.1f} s"
    )


def shown(value: float, form: str) -> str:
    """A number, or a dash where there is none; numbers above 1000 are not distinguished."""
    if not math.isfinite(value):
        return "-"
    return "<-999" if value < -999.0 else ">999" if value > 999.0 else f"{value:{form}}"


def per_axis(runs: Sequence[Outcome], mean: bool = False) -> dict[str, float]:
    """Median ratio to the nominal model, or to the mean motion, per degree of freedom."""
    held = [run.to_mean if mean else run.to_none for run in runs]
    dofs = dict.fromkeys(dof for run in held for dof in run)
    return {dof: median(run.get(dof, math.inf) for run in held) for dof in dofs}


class Cells:
    """Outcomes by case and identifier."""

    def __init__(self, found: Iterable[Outcome]) -> None:
        self.held: dict[Case, dict[str, list[Outcome]]] = {}
        for one in found:
            self.held.setdefault(one.case, {}).setdefault(one.identifier, []).append(one)
        names = {name for of_case in self.held.values() for name in of_case}
        self.identifiers = sorted(names, key=lambda name: _place(IDENTIFIERS, name))

    def summary(self) -> str:
        """In how many cases each identifier is worse than none, diverges, or is near the best."""
        rows = [[f"`{name}`", *self._counts(name)] for name in self.identifiers]
        headers = ["identifier", "cases", "worse than `none`", "diverged", "near the best", "time"]
        return table(headers, rows)

    def _counts(self, name: str) -> list[str]:
        held = {case: of_case for case, of_case in self.held.items() if name in of_case}
        runs = [run for of_case in held.values() for run in of_case[name]]
        worse = sum(
            any(ratio > WORSE for ratio in per_axis(of_case[name]).values())
            or median(run.worst for run in of_case[name]) == math.inf
            for of_case in held.values()
        )
        diverged = sum(any(run.diverged for run in of_case[name]) for of_case in held.values())
        near = sum(_error(of_case[name]) <= NEAR * _best(of_case) for of_case in held.values())
        time = f"{median(run.seconds for run in runs):.1f} s"
        share = f"{near} ({100 * near / len(held):.0f} %)"
        return [str(len(held)), str(worse), str(diverged), share, time]

    def recordings(self) -> str:
        """The number of axes that are predicted better than by `none` and by the mean motion."""
        vessels = sorted({case.vessel for case in self.held if case.recorded})
        if not vessels:
            return ""
        rows = [[f"`{name}`", *(self._axes(name, v) for v in vessels)] for name in self.identifiers]
        return table(["identifier", *(f"`{vessel}`" for vessel in vessels)], rows)

    def _axes(self, name: str, vessel: str) -> str:
        better = [
            [ratio < 1.0 for ratio in per_axis(of_case[name], mean).values()]
            for mean in (False, True)
            for case, of_case in self.held.items()
            if case.recorded and case.vessel == vessel and name in of_case
        ]
        half = len(better) // 2
        first, second = (sum(map(sum, part)) for part in (better[:half], better[half:]))
        return f"{first}, {second} of {sum(map(len, better[:half]))}" if better else ""

    def tables(self) -> Iterable[str]:
        """One table for each vessel, and for the recordings of it, with a caption."""
        for vessel, recorded in dict.fromkeys((case.vessel, case.recorded) for case in self.held):
            cases = [c for c in self.held if (c.vessel, c.recorded) == (vessel, recorded)]
            cases.sort(key=lambda case: _place(CASES, case.name))
            rows = [
                [f"`{name}`", *(self._cell(case, name) for case in cases)]
                for name in self.identifiers
            ]
            caption = f"`{vessel}`, {'recordings' if recorded else 'simulated'}"
            yield f"{caption}\n\n{table(['identifier', *(case.name for case in cases)], rows)}"

    def _cell(self, case: Case, name: str) -> str:
        runs = self.held[case].get(name)
        return cell(runs) if runs else ""


def _error(runs: Sequence[Outcome]) -> float:
    return median(run.nrmse for run in runs)


def _best(of_case: Mapping[str, Sequence[Outcome]]) -> float:
    """The least median NRMSE of a single identifier; infinite, and near none, without one."""
    errors = [_error(runs) for name, runs in of_case.items() if name != "auto"]
    finite = [error for error in errors if math.isfinite(error)]
    return min(finite, default=-math.inf)


def _place(order: Sequence[str], name: str) -> tuple[int, str]:
    return (order.index(name) if name in order else len(order)), name


def page(results: Queries) -> str:
    """All tables in Markdown."""
    cells = Cells(outcomes(results))
    parts = [cells.summary()]
    if axes := cells.recordings():
        parts.append(f"Axes of the recordings, better than `none`, than the mean motion:\n\n{axes}")
    return "\n".join([*parts, *cells.tables()])


def main() -> None:
    """Print the tables."""
    file = Path(sys.argv[1]) if len(sys.argv) > 1 else LOGBOOK
    if not file.exists():
        sys.exit(f"{file}: not found; `make robustness` writes it")
    with open_results(str(file)) as results:
        print(page(results), end="")


if __name__ == "__main__":
    main()
