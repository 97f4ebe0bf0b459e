"""Audit of a logbook: which of its runs mislead if they are compared without a second look."""

from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import replace

import pandas as pd

from seatrial.runner.compare.comparability import differing, of_runs, with_conditions
from seatrial.runner.compare.frame import BELOW_TRUE_MODEL, FINISHED, LIMITED, Queries
from seatrial.runner.compare.grid import TextTable, grid_of, one_line
from seatrial.runner.compare.runs import runs_of
from seatrial.runner.compare.where import Condition
from seatrial.runner.database.records import RunSummary
from seatrial.runner.record.vocabulary import DOF_ORDER, LOST

HEADERS = ("check", "runs", "what", "remedy")
Entry = tuple[str, Iterable[int], str]  # check, the runs that it is about, and what it found
CELL = ("identifier", "disturbance")  # the factors of a table without options
DEPLOYED = ("tau_mean_abs", "e_pos_mae")  # metrics that every deployment has
WIDEST = 60  # characters of the numbers of runs; the records have all
REMEDIES = {
    "pooled": "table splits them or refuses: name them in --rows, or select by --sweep, --where",
    "code": "select one by --where code=..., or start their command again",
    "below true model": "it fits lag or feedback: judge by velocity_rmse_free_run",
    "diverged validation": "judge by a shorter horizon: velocity_rmse_restarts or _ten_step",
    **{f"{name} run": f"show {{}} --traceback; retry --status {name}" for name in LOST},
}


def audit(results: Queries, where: str | None, sweep: str | None) -> TextTable:
    """Return one line for each group of runs that can mislead.

    `where` and `sweep` select runs as those of a table; by default all. Raises
    ConfigurationError for a wrong one of them, and if no run matches.
    """
    condition, scope = results.selected(where, sweep or "all")
    runs = results.trials(condition)
    finished = runs[runs["status"] == FINISHED]
    entries = [*_unlike(results, finished, condition), *_of_models(results, finished, condition)]
    groups = defaultdict[tuple[str, str | None], list[RunSummary]](list)
    for run in reversed(runs_of(results, condition, LOST)):
        if not run.superseded:
            groups[run.status, run.error_type].append(run)
    for (status, kind), lost in groups.items():
        reason = ": ".join(text for text in (kind, lost[0].error) if text) or "no reason known"
        entries.append((f"{status} run", [run.run_id for run in lost], one_line(reason, 120)))
    found = f"{len(entries)} diagnostic{'s'[: len(entries) != 1]}" if entries else "nothing found"
    checked = f"checked {len(runs)} run{'s'[: len(runs) != 1]}" + (f" of {scope}" if scope else "")
    rows = [
        {"check": check, "runs": ranges(own), "what": what,
         "remedy": REMEDIES[check].format(min(own))}
        for check, own, what in entries
    ]  # fmt: skip
    shown = [[*(row | {"runs": one_line(row["runs"], WIDEST)}).values()] for row in rows]
    return replace(grid_of(f"{checked}: {found}", HEADERS, shown, len(HEADERS)), records=rows)


def ranges(runs: Iterable[int]) -> str:
    """Return run numbers as `1-6, 9`."""
    numbers = pd.Series(sorted(set(runs)))
    parts = numbers.groupby(numbers.diff().ne(1).cumsum()).agg(["min", "max"])
    return ", ".join(str(a) if a == b else f"{a}-{b}" for a, b in parts.to_numpy())


def _unlike(results: Queries, finished: pd.DataFrame, condition: Condition) -> Iterator[Entry]:
    """Find runs that differ in a cell of a table."""
    deployed = finished.index.isin(results.metrics(DEPLOYED, condition)["run"])
    parts = of_runs(finished, "validation"), of_runs(finished[deployed], "deployment")
    frame, facts = with_conditions(results, finished, pd.concat(parts, ignore_index=True))
    for levels, own in frame.groupby([*CELL], observed=True, sort=False):
        factors, runs = differing(facts, own["stage"], own["condition"]), own["run"]
        cell = ", ".join(f"{name}={level}" for name, level in zip(CELL, levels, strict=True))
        if "code" in factors:
            codes = own["of_code"].nunique(dropna=False)
            yield "code", runs, f"{cell}: computed by {codes} versions of the code"
        if names := [name for name in factors if name != "code"]:
            listed = one_line(", ".join(names), 120)
            yield "pooled", runs, f"{cell}: would be averaged over {listed}"


def _of_models(results: Queries, finished: pd.DataFrame, condition: Condition) -> Iterator[Entry]:
    """Find models below the true one, and predictions that diverged."""
    marks = results.marks(condition).join(finished["identifier"], on="run", how="inner")
    below = marks[marks["metric"] == BELOW_TRUE_MODEL]
    for identifier, rows in below.groupby("identifier", observed=True, sort=False):
        dofs = ", ".join(dof for dof in DOF_ORDER if (rows["dof"] == dof).any())
        what = f"identifier={identifier}: force error below the true plant's in {dofs}"
        yield "below true model", rows["run"], what
    limited = marks[marks["metric"].isin(LIMITED.values())]
    groups = limited.groupby(["identifier", "model"], observed=True, sort=False)
    for (identifier, model), rows in groups:
        horizons = ", ".join(h for h, name in LIMITED.items() if (rows["metric"] == name).any())
        what = f"identifier={identifier}, {model} model: {horizons} diverged"
        yield "diverged validation", rows["run"], what
