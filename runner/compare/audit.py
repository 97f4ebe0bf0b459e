"""Audit of a logbook: which of its runs mislead if they are compared without a second look."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

import pandas as pd

from seatrial.runner.compare.comparability import EXPERIMENT, differing, of_runs, with_conditions
from seatrial.runner.compare.frame import BELOW_TRUE_MODEL, FINISHED, Queries, diverged_predictions
from seatrial.runner.compare.grid import TextTable, grid_of, number_text, one_line
from seatrial.runner.compare.runs import runs_of
from seatrial.runner.compare.where import Condition
from seatrial.runner.database.records import RunSummary
from seatrial.runner.record.vocabulary import DOF_ORDER, LOST

HEADERS = ("check", "runs", "what", "remedy")
Entry = tuple[str, Sequence[int], str, str]  # check, the runs it is about, what, and the remedy
CELL = ("identifier", "disturbance")  # the factors of a table without options
DEPLOYED = ("tau_mean_abs", "e_pos_mae")  # metrics that every deployment has
MOST_RANGES = 8
REMEDIES = {
    "pooled": "table splits them or refuses: name them in --rows, or select by --sweep, --where",
    "code": "select one by --where code=..., or start their command again",
    "replicates": "tables count them once; deployments stay apart",
    "below true model": "it fits lag or feedback: judge by velocity_rmse_free_run",
    "diverged validation": "judge by a shorter horizon: velocity_rmse_restarts or _ten_step",
    "inertia": "richer excitation or fewer terms: such a model cannot be simulated",
    "coverage": "identifier=iv and output_error have intervals of the coefficient",
}


def audit(results: Queries, where: str | None, sweep: str | None) -> TextTable:
    """Return one line for each group of runs that can mislead.

    `where` and `sweep` select runs as those of a table; by default all. Raises
    ConfigurationError for a wrong one of them, and if no run matches.
    """
    condition, scope = results.selected(where, sweep or "all")
    runs = results.trials(condition)
    finished = runs[runs["status"] == FINISHED]
    marks = results.marks(condition)
    marks = marks[marks["run"].isin(finished.index)].join(finished["identifier"], on="run")
    entries = [
        *_unlike(results, finished, condition),
        *_below_true_model(marks[marks["metric"] == BELOW_TRUE_MODEL]),
        *_diverged(results, finished, marks, condition),
        *_without_coverage(results, finished, condition),
        *_lost(results, condition),
    ]
    found = f"{len(entries)} diagnostic{'s'[: len(entries) != 1]}" if entries else "nothing found"
    checked = f"checked {len(runs)} run{'s'[: len(runs) != 1]}" + (f" of {scope}" if scope else "")
    whole, shown = (
        [[check, ranges(own, most), what, remedy] for check, own, what, remedy in entries]
        for most in (None, MOST_RANGES)
    )
    records = grid_of("", HEADERS, whole).as_records()
    return replace(
        grid_of(f"{checked}: {found}", HEADERS, shown, labels=len(HEADERS)), records=records
    )


def ranges(runs: Iterable[int], most: int | None = None) -> str:
    """Return run numbers as `1-6, 9`; of more than `most` ranges, the first and the total."""
    parts: list[tuple[int, int]] = []
    for run in (numbers := sorted(set(runs))):
        if parts and run == parts[-1][1] + 1:
            parts[-1] = parts[-1][0], run
        else:
            parts.append((run, run))
    texts = [str(a) if a == b else f"{a}-{b}" for a, b in parts]
    if most is not None and len(texts) > most:
        texts = [*texts[:most], f"… ({len(numbers)} runs)"]
    return ", ".join(texts)


def _unlike(results: Queries, finished: pd.DataFrame, condition: Condition) -> Iterator[Entry]:
    """Find runs that differ in a cell of a table, and runs that are one experiment."""
    deployed = finished.index.isin(results.metrics(DEPLOYED, condition)["run"])
    parts = of_runs(finished, "validation"), of_runs(finished[deployed], "deployment")
    frame, facts = with_conditions(results, finished, pd.concat(parts, ignore_index=True))
    for levels, own in frame.groupby([*CELL], observed=True, sort=False):
        factors = differing(facts, own["stage"], own["condition"])
        if "code" in factors:
            codes = own["of_code"].nunique(dropna=False)
            what = f"{_cell(levels)}: computed by {codes} versions of the code"
            yield _entry("code", own["run"], what)
        names = [name for name in factors if name != "code"]
        if names:
            listed = one_line(", ".join(names), 120)
            yield _entry("pooled", own["run"], f"{_cell(levels)}: would be averaged over {listed}")
    yield from _replicates(frame[frame["stage"] == "validation"])


def _replicates(frame: pd.DataFrame) -> Iterator[Entry]:
    """Find experiments that are stored more than once, by what their runs differ in."""
    experiments = frame.groupby([*EXPERIMENT], observed=True, sort=False)
    varied = {name: experiments[name].transform("nunique") > 1 for name in ("seed", "evaluation")}
    stored = frame.assign(**varied, number=experiments.ngroup())
    stored = stored[experiments["run"].transform("size") > 1]
    for key, runs in stored.groupby([*CELL, *varied], observed=True, sort=False):
        several = [name for name, varies in zip(varied, key[len(CELL) :], strict=True) if varies]
        under = (
            f"under several {' and '.join(f'{name}s' for name in several)}" if several else "again"
        )
        reason = ", but nothing random was drawn" if "seed" in several else ""
        count = runs["number"].nunique()
        number = "one experiment is" if count == 1 else f"{count} experiments are"
        what = f"{_cell(key[: len(CELL)])}: {number} stored {under}{reason}"
        yield _entry("replicates", runs["run"], what)


def _below_true_model(flags: pd.DataFrame) -> Iterator[Entry]:
    for (identifier,), rows in flags.groupby(["identifier"], observed=True, sort=False):
        dofs = ", ".join(dof for dof in DOF_ORDER if (rows["dof"] == dof).any())
        what = f"identifier={identifier}: force error below the true plant's in {dofs}"
        yield _entry("below true model", rows["run"], what)


def _diverged(
    results: Queries, finished: pd.DataFrame, marks: pd.DataFrame, condition: Condition
) -> Iterator[Entry]:
    """Find predictions that diverged, and models that cannot be simulated."""
    reasons = results.diagnostics(["no_prediction"], condition)
    impossible = {(row.run, str(row.label).split()[0]) for row in reasons.itertuples()}
    lost = diverged_predictions(marks).join(finished["identifier"], on="run")
    lost["singular"] = [pair in impossible for pair in zip(lost["run"], lost["model"], strict=True)]
    for (identifier, model, singular), rows in lost.groupby(
        ["identifier", "model", "singular"], observed=True, sort=False
    ):
        about = f"identifier={identifier}, {model} model"
        if singular:
            yield _entry("inertia", rows["run"], f"{about}: its inertia is not positive definite")
        else:
            horizons = ", ".join(rows["horizon"].unique())
            known = rows["held_s"].dropna()
            ends = dict.fromkeys(number_text(end, 3) for end in (known.min(), known.max()))
            held = f"; the free run held {' to '.join(ends)} s" if len(known) else ""
            yield _entry("diverged validation", rows["run"], f"{about}: {horizons} diverged{held}")


def _without_coverage(
    results: Queries, finished: pd.DataFrame, condition: Condition
) -> Iterator[Entry]:
    stated = results.coefficients(condition).dropna(subset="std_error")
    uncertain = {*stated["run"]} - results.covering(condition)
    own = finished[finished.index.isin(uncertain)]
    for identifier, rows in own.groupby("identifier", observed=True, sort=False):
        what = f"identifier={identifier}: standard errors of the estimate, not of the coefficient"
        yield _entry("coverage", rows.index, what)


def _lost(results: Queries, condition: Condition) -> Iterator[Entry]:
    lost = [run for run in runs_of(results, condition, LOST) if not run.superseded]
    groups: dict[tuple[str, str | None], list[RunSummary]] = {}
    for run in reversed(lost):
        groups.setdefault((run.status, run.error_type), []).append(run)
    for (status, error_type), runs in groups.items():
        reason = ": ".join(text for text in (error_type, runs[0].error) if text)
        remedy = f"show {runs[0].run_id} --traceback; retry --status {status}"
        ids = [run.run_id for run in runs]
        yield f"{status} run", ids, one_line(reason or "no reason known", 120), remedy


def _cell(levels: Sequence[str]) -> str:
    return ", ".join(f"{name}={level}" for name, level in zip(CELL, levels, strict=True))


def _entry(check: str, runs: Iterable[int], what: str) -> Entry:
    return check, [*runs], what, REMEDIES[check]
