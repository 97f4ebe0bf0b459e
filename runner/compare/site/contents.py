"""What the page is told of a logbook: its runs, metrics, sweeps, failures, and one run whole."""

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
import pandas as pd
import sqlalchemy as sa

from seatrial.models.errors import LogbookError
from seatrial.runner.compare.frame import INTERVAL_OF_ESTIMATE, RUN, Queries, StoredRun
from seatrial.runner.compare.headlines import Headline, answers, headlines, in_words
from seatrial.runner.compare.runs import run_details
from seatrial.runner.compare.site.measures import StoredMeasures
from seatrial.runner.compare.site.run_columns import Json, run_columns
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.compare.table import TableRequest
from seatrial.runner.database.tables import Reuse
from seatrial.runner.invocation import results_program
from seatrial.runner.record.catalogue import definition_of
from seatrial.runner.record.rows import Series
from seatrial.runner.vocabulary import LOST

MOST_SWEEPS = 50  # whose tables are written, the newest ones
MOST_FAILURES = 500  # whose tracebacks the page is told, the newest ones
PARETO = ("pareto_objective", "pareto_chosen")
TRACK_SAMPLES = 600
STRETCHES = 300  # of which a line keeps the lowest and the highest sample
DIGITS = 5  # significant
PLANE = ("x", "y", "x_d", "y_d", "psi")
ERRORS = ("e_pos", "e_psi")


def summary(results: Queries, database: str, measures: StoredMeasures, opened: int) -> Json:
    """Return what every view of the page needs: runs, factors, sweeps, metrics and flags.

    `database` is the address as the user wrote it, for the commands that the page shows;
    `measures` remembers what earlier calls found; `opened` is the number of runs that were written
    whole.
    """
    runs = all_runs(results)
    places = {run.id: place for place, run in enumerate(runs)}
    return {
        "database": database,
        "program": results_program(),
        "opened": opened,
        "runs": {**run_columns(results, results.trials()), **_times(results, runs)}
        if runs
        else None,
        "sweeps": _sweeps(results, runs, places),
        "measures": measures.told(results),
        "opening": tabled(results),
    }


def tabled(results: Queries) -> list[int]:
    """Return the sweeps whose tables are written, the newest ones."""
    return [sweep.id for sweep in results.reader.sweeps()][-MOST_SWEEPS:]


def all_runs(results: Queries) -> list[StoredRun]:
    """Return one attempt at every trial, oldest first; none for an empty logbook."""
    ((number,),) = results.reader.select(sa.select(sa.func.count()).select_from(RUN))
    return results.runs() if number else []


def progress(results: Queries) -> Json:
    """Return how far the newest sweep and every running one are."""
    newest = [sweep.id for sweep in results.reader.sweeps()[-1:]]
    shown = sorted({*newest, *results.reader.running_sweeps()})
    return {"sweeps": [_sweep_state(results, id_) for id_ in shown]}


def _sweep_state(results: Queries, sweep: int) -> Json:
    """Return the numbers of trials of a sweep that are planned, running, ended and lost."""
    status = results.reader.sweep_status(sweep)
    ended = {name: n for name, n in status.counts.items() if name != "running"}
    return {
        "id": status.sweep_id,
        "name": status.name,
        "planned": status.planned,
        "running": 0 if status.finished_at else status.counts.get("running", 0),
        "ended": sum(ended.values()),
        "lost": sum(n for name, n in ended.items() if name in LOST),
    }


def _times(results: Queries, runs: Sequence[StoredRun]) -> Json:
    """Return begin and duration [s] of the runs."""
    columns = sa.select(RUN.c.id, RUN.c.started_at, RUN.c.duration_s)
    rows = {row.id: row for row in results.reader.select(columns)}
    known = [rows.get(run.id) for run in runs]
    return {
        "started": [f"{row.started_at:%Y-%m-%d %H:%M}" if row else "" for row in known],
        "duration": [number(row.duration_s) if row else None for row in known],
    }


def _sweeps(results: Queries, runs: Sequence[StoredRun], places: Mapping[int, int]) -> list[Json]:
    """Return the sweeps with the places of their runs, those that they reuse included."""
    members: dict[int | None, set[int]] = defaultdict(set)
    for run in runs:
        members[run.sweep].add(places[run.id])
    reuse = Reuse.__table__.c
    for sweep_id, run_id in results.reader.select(sa.select(reuse.sweep_id, reuse.run_id)):
        if run_id in places:
            members[sweep_id].add(places[run_id])
    return [
        {
            "id": sweep.id,
            "name": sweep.name,
            "tags": sweep.tags or [],
            "note": sweep.note,
            "planned": sweep.planned,
            "runs": sorted(members[sweep.id]),
        }
        for sweep in results.reader.sweeps()
    ]


def tables(results: Queries, sweep: int | None) -> Json:
    """Return the tables of a sweep, or of all runs, what the first one says, and their commands."""
    selection = None if sweep is None else str(sweep)
    condition, _ = results.selected(None, selection or "all")
    runs = results.runs(condition)
    found, refused = headlines(results, runs, TableRequest(names=[], sweep=selection or "all"))
    return {
        "answers": [*answers(found[0])] if found else [],
        "refused": refused,
        "tables": [_table(one) for one in found],
    }


def _table(one: Headline) -> Json:
    shown = in_words(one.table)
    return {
        "caption": definition_of(one.metric).heading,
        "shown": one.shown,
        "command": one.command,
        "title": shown.title,
        "headers": shown.headers,
        "labels": shown.labels,
        "rows": [[[cell.text, cell.bold, cell.sort] for cell in row] for row in shown.rows],
        "notes": shown.notes,
    }


def metric(results: Queries, name: str) -> list[Json]:
    """Return the numbers of one metric: by stage, model and degree of freedom, runs and values.

    `runs` are run numbers in the order of storage; a value is None where it is not finite.
    """
    return _parts(results, results.metrics([name]))


def coefficient(results: Queries, term: str) -> list[Json]:
    """Return the coefficients of one term as `metric` does."""
    return _parts(results, results.coefficients(terms=[term]))


def _parts(results: Queries, numbers: pd.DataFrame) -> list[Json]:
    """Return numbers by stage, model and degree of freedom."""
    own = numbers[numbers["run"].isin([run.id for run in all_runs(results)])]
    place = ["stage", "model", "dof"]
    return [
        dict(zip(place, levels, strict=True))
        | {"runs": part["run"].tolist(), "values": list(map(number, part["value"].tolist()))}
        for levels, part in own.groupby(place, observed=True, sort=False)
    ]


def failures(results: Queries) -> list[Json]:
    """Return the newest runs that failed, with their errors and tracebacks."""
    lost = [run for run in all_runs(results) if run.status in LOST][-MOST_FAILURES:]
    r = RUN.c
    query = sa.select(r.id, r.error_type, r.error, r.traceback)
    rows = {
        row.id: row
        for row in results.reader.select(query.where(r.id.in_([run.id for run in lost])))
    }
    return [
        {
            "run": run.id,
            "status": run.status,
            "type": rows[run.id].error_type,
            "error": rows[run.id].error,
            "traceback": rows[run.id].traceback,
        }
        for run in reversed(lost)
    ]


def one_run(results: Queries, run_id: int) -> Json:
    """Return all of one run: its properties, coefficients, Pareto set and, thinned, its series.

    Raises LogbookError if there is no such run; a series that cannot be read is named as trouble.
    """
    parts, trouble = {}, []
    for file in results.reader.series_files(run_id):
        try:
            if (part := thinned(results.reader.series(run_id, file.kind))) is not None:
                parts[file.kind] = part
        except LogbookError as error:
            trouble.append(str(error))
    diagnostics = [f for f in results.reader.diagnostics(run_id) if f.name in PARETO]
    return {
        "run": run_id,
        "tables": [  # what `show` prints, but for what the page draws itself
            (grid.title, grid.headers, [[cell.text for cell in row] for row in grid.rows])
            for grid in run_details(results, run_id)
            if grid.title not in ("metrics", "series", "coefficients")
        ],
        "metrics": [
            [definition_of(m.name).label, number(m.value), m.unit, m.dof, m.stage, m.model]
            for m in results.reader.metrics(run_id)
        ],
        "coefficients": _coefficients(results, run_id),
        "series": parts,
        "trouble": trouble,
        "pareto": [
            [f.name, f.dof, f.i, f.j, f.label, number(f.value), f.unit] for f in diagnostics
        ],
    }


def _coefficients(results: Queries, run_id: int) -> Json:
    """Return the coefficients of a run, and whether their intervals are of the coefficient."""
    of_estimate = [
        diagnostic.value
        for diagnostic in results.reader.diagnostics(run_id)
        if diagnostic.name == INTERVAL_OF_ESTIMATE
    ]
    return {
        "covers": 0.0 in of_estimate,
        "rows": [
            [c.model, c.dof, c.term, *map(number, (c.value, c.std_error, c.true_value)), c.unit]
            for c in results.reader.coefficients(run_id)
        ],
    }


def number(value: float | None) -> float | None:
    """Return a number that JSON can hold; None if it is not finite."""
    return None if value is None or not math.isfinite(value) else float(value)


def thinned(series: Series) -> Json | None:
    """Return the columns of a series that the page draws; None if it draws none of them.

    `track` holds columns of equal length in metres and radians, `lines` pairs of time [s] and
    value by column; `every` says how many samples one stands for.
    """
    columns = {name: np.asarray(v, dtype=np.float64) for name, v in series.columns.items()}
    t = columns.get("t", np.zeros(0))
    track = {name: columns[name] for name in PLANE if name in columns}
    lines = [name for name in columns if name in ERRORS or name.startswith("residual_")]
    if not t.size or not ({"x", "y"} <= track.keys() or lines):
        return None
    stride = max(1, -(-t.size // TRACK_SAMPLES))
    rows = np.unique(np.append(np.arange(0, t.size, stride), t.size - 1))
    return {
        "every": stride,
        "track": {name: _rounded(values[rows]) for name, values in track.items()},
        "lines": {name: [*map(_rounded, extremes(t, columns[name]))] for name in lines},
        "units": {name: series.units.get(name, "") for name in (*track, *lines)},
        "training_ends_s": _training_end(t, columns),
    }


def extremes(t: Sample, values: Sample) -> tuple[Sample, Sample]:
    """Return the lowest and the highest sample of each stretch, in their order.

    `t` and `values` have shape (n,), the results at most (2 STRETCHES,). Values that are not finite
    are left out.
    """
    kept = np.isfinite(values)
    t, values = t[kept], values[kept]
    if values.size <= 2 * STRETCHES:
        return t, values
    edges = np.linspace(0, values.size, STRETCHES + 1, dtype=np.int64)
    rows: Sequence[int] = [
        edge
        for low, high in pairwise(edges.tolist())
        for edge in (low + int(np.argmin(values[low:high])), low + int(np.argmax(values[low:high])))
    ]
    chosen = np.unique(np.array(rows))
    return t[chosen], values[chosen]


def _training_end(t: Sample, columns: Mapping[str, Sample]) -> float | None:
    """Return the end of the training part [s], if it is the first part of the series."""
    train = columns.get("train")
    if train is None or not np.any(train > 0) or np.all(train > 0) or np.any(np.diff(train) > 0):
        return None
    return float(t[int(np.argmin(train))])


def _rounded(values: Sample) -> list[float | None]:
    return [float(f"{v:.{DIGITS}g}") if np.isfinite(v) else None for v in values.tolist()]
