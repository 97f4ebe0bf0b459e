"""Audit of a logbook: which of its runs mislead if they are compared without a second look."""

import math
from collections import defaultdict
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from seatrial.runner.compare.grid import Scalar, TextTable, grid_of, number_text, one_line
from seatrial.runner.compare.likeness import Likeness, differing
from seatrial.runner.compare.results import (
    BELOW_TRUE_MODEL,
    FINISHED,
    Observation,
    Queries,
    StoredRun,
)
from seatrial.runner.compare.runs import runs_of
from seatrial.runner.compare.selection import DIVERGENCE, diverged_predictions
from seatrial.runner.compare.where import Condition
from seatrial.runner.record.vocabulary import DOF_ORDER, LOST

HEADERS = ("check", "runs", "what", "remedy")
K = TypeVar("K", bound=Hashable)
V = TypeVar("V")
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


@dataclass(frozen=True)
class AuditEntry:
    """One line of the audit: a check, the runs that it is about, what they have, and the remedy."""

    check: str
    runs: Sequence[int]
    what: str
    remedy: str


def audit(
    results: Queries, where: str | None, sweep: str | None, tag: str | None = None
) -> TextTable:
    """Return one line for each group of runs that can mislead.

    `where`, `sweep` and `tag` select runs as those of a table; by default all. Raises
    ConfigurationError for a wrong one of them, and if no run matches.
    """
    condition, scope = results.selected(where, sweep or "all", tag)
    runs = results.runs(condition)
    finished = [run for run in runs if run.status == FINISHED]
    entries = [
        *_unlike(results, finished, condition),
        *_below_true_model(results, finished, condition),
        *_diverged(results, finished, condition),
        *_without_coverage(results, finished, condition),
        *_lost(results, condition),
    ]
    found = f"{len(entries)} diagnostic{'s'[: len(entries) != 1]}" if entries else "nothing found"
    checked = f"checked {len(runs)} run{'s'[: len(runs) != 1]}" + (f" of {scope}" if scope else "")
    rows: list[list[Scalar]] = [[e.check, ranges(e.runs), e.what, e.remedy] for e in entries]
    shown = [[e.check, ranges(e.runs, MOST_RANGES), e.what, e.remedy] for e in entries]
    records = grid_of("", HEADERS, rows).as_records()
    grid = grid_of(f"{checked}: {found}", HEADERS, shown, labels=len(HEADERS))
    return TextTable(grid.title, grid.headers, grid.rows, grid.labels, records=records)


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


def _unlike(
    results: Queries, finished: Sequence[StoredRun], condition: Condition | None
) -> Iterator[AuditEntry]:
    """Find runs that differ in a cell of a table, and runs that are one experiment."""
    likeness = Likeness(results, finished)
    deployed = {o.run.id for o in results.metrics(finished, DEPLOYED, condition)}
    for cell, runs in _grouped((_cell(run), run) for run in finished).items():
        validation = [_number(run, "validation") for run in runs]
        deployment = [_number(run, "deployment") for run in runs if run.id in deployed]
        factors = differing(likeness, {"validation": validation, "deployment": deployment})
        ids = [run.id for run in runs]
        if "code" in factors:
            codes = len({run.code for run in runs})
            yield _entry("code", ids, f"{cell}: computed by {codes} versions of the code")
        names = [name for name in factors if name != "code"]
        if names:
            listed = one_line(", ".join(names), 120)
            yield _entry("pooled", ids, f"{cell}: would be averaged over {listed}")
    yield from _replicates(likeness, finished)


def _number(run: StoredRun, stage: str) -> Observation:
    return Observation(run, stage, "identified", "all", "", None, "")


def _replicates(likeness: Likeness, finished: Sequence[StoredRun]) -> Iterator[AuditEntry]:
    """Find experiments that are stored more than once, by what their runs differ in."""
    experiments = _grouped((likeness.experiment(_number(r, "validation")), r) for r in finished)
    stored: dict[tuple[str, tuple[str, ...]], list[list[StoredRun]]] = defaultdict(list)
    for runs in experiments.values():
        if len(runs) > 1:
            varied = [n for n in ("seed", "evaluation") if len({r.levels[n] for r in runs}) > 1]
            stored[_cell(runs[0]), tuple(varied)].append(runs)
    for (cell, several), groups in stored.items():
        under = (
            f"under several {' and '.join(f'{name}s' for name in several)}" if several else "again"
        )
        reason = ", but nothing random was drawn" if "seed" in several else ""
        number = "one experiment is" if len(groups) == 1 else f"{len(groups)} experiments are"
        ids = [run.id for runs in groups for run in runs]
        yield _entry("replicates", ids, f"{cell}: {number} stored {under}{reason}")


def _below_true_model(
    results: Queries, finished: Sequence[StoredRun], condition: Condition | None
) -> Iterator[AuditEntry]:
    flags = [o for o in results.metrics(finished, [BELOW_TRUE_MODEL], condition) if o.value]
    for identifier, rows in _grouped((o.run.levels["identifier"], o) for o in flags).items():
        dofs = ", ".join(dof for dof in DOF_ORDER if any(o.dof == dof for o in rows))
        what = f"identifier={identifier}: force error below the true plant's in {dofs}"
        yield _entry("below true model", [o.run.id for o in rows], what)


def _diverged(
    results: Queries, finished: Sequence[StoredRun], condition: Condition | None
) -> Iterator[AuditEntry]:
    """Find predictions that diverged, and models that cannot be simulated."""
    predictions = diverged_predictions(results.metrics(finished, DIVERGENCE, condition))
    reasons = results.diagnostics(finished, ["no_prediction"], condition)
    impossible = {(id_, str(r.label).split()[0]) for id_, rows in reasons.items() for r in rows}
    identifiers = {run.id: run.levels["identifier"] for run in finished}
    groups = _grouped(
        ((identifiers[id_], model, (id_, model) in impossible), (id_, horizon, held_s))
        for (id_, model, horizon), held_s in predictions.items()
    )
    for (identifier, model, without_inertia), rows in groups.items():
        ids, about = [id_ for id_, _, _ in rows], f"identifier={identifier}, {model} model"
        if without_inertia:
            yield _entry("inertia", ids, f"{about}: its inertia is not positive definite")
        else:
            horizons = ", ".join(dict.fromkeys(horizon for _, horizon, _ in rows))
            held = _held_text([held_s for _, _, held_s in rows])
            yield _entry("diverged validation", ids, f"{about}: {horizons} diverged{held}")


def _held_text(times_s: Sequence[float]) -> str:
    """Return `; the free run held 5 to 35 s`; empty if it is not known."""
    known = [time_s for time_s in times_s if math.isfinite(time_s)]
    if not known:
        return ""
    ends = dict.fromkeys(number_text(end, 3) for end in (min(known), max(known)))
    return f"; the free run held {' to '.join(ends)} s"


def _without_coverage(
    results: Queries, finished: Sequence[StoredRun], condition: Condition | None
) -> Iterator[AuditEntry]:
    covering = results.covering(finished, condition)
    uncertain = results.with_standard_errors(condition) - covering
    rows = _grouped((r.levels["identifier"], r.id) for r in finished if r.id in uncertain)
    for identifier, ids in rows.items():
        what = f"identifier={identifier}: standard errors of the estimate, not of the coefficient"
        yield _entry("coverage", ids, what)


def _lost(results: Queries, condition: Condition | None) -> Iterator[AuditEntry]:
    lost = [run for run in runs_of(results, condition, LOST) if not run.superseded]
    groups = _grouped(((run.status, run.error_type), run) for run in reversed(lost))
    for (status, error_type), runs in groups.items():
        reason = ": ".join(text for text in (error_type, runs[0].error) if text)
        remedy = f"show {runs[0].run_id} --traceback; retry --status {status}"
        ids = [run.run_id for run in runs]
        yield AuditEntry(f"{status} run", ids, one_line(reason or "no reason known", 120), remedy)


def _cell(run: StoredRun) -> str:
    return ", ".join(f"{name}={run.levels[name]}" for name in CELL)


def _entry(check: str, runs: Sequence[int], what: str) -> AuditEntry:
    return AuditEntry(check, runs, what, REMEDIES[check])


def _grouped(pairs: Iterable[tuple[K, V]]) -> Mapping[K, list[V]]:
    """Return the values by key, in the order of the first of each."""
    groups: dict[K, list[V]] = defaultdict(list)
    for key, value in pairs:
        groups[key].append(value)
    return groups
