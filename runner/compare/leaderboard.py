"""The leaderboard: what every entrant reached in every case of the tasks, and their ranks.

The newest run of a cell counts. A run that failed or diverged, and one whose model cannot predict,
has an infinite loss: it ranks behind all others. Cells without a run are not ranked; a task is
ranked over the cases that all its entrants have run.
"""

import math
import re
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np
import sqlalchemy as sa

from seatrial.runner import search_path
from seatrial.runner.compare.benchmark.cells import Cell, cells, entrants_of
from seatrial.runner.compare.benchmark.scores import (
    MEAN_MOTION,
    PERSISTENCE,
    Score,
    interval,
    score,
)
from seatrial.runner.compare.benchmark.task import GROUP, Task, task_of
from seatrial.runner.compare.grid import Cell as Shown
from seatrial.runner.compare.grid import Grid, number_text
from seatrial.runner.compare.ranking import Ranking, ranking
from seatrial.runner.compare.results import FINISHED, Results, open_results
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.database.tables import Coefficient
from seatrial.runner.database.tables import Run as RunTable
from seatrial.runner.invocation import trial_program

REFERENCES = (MEAN_MOTION, PERSISTENCE)
LABELS = ("results_dir=", "sweep.", "hydra", "database")  # options that change no result
SPELLING = re.compile(r"[\s'\"]+")


@dataclass(frozen=True)
class Entry:
    """A cell with its newest run."""

    cell: Cell
    run: int
    status: str
    duration_s: float
    error: str
    parameters: int  # coefficients that differ from the believed ones
    score: Score | None  # None: without a prediction

    @property
    def loss(self) -> float:
        """Mean NRMSE of the free run; inf if there is none."""
        return math.inf if self.score is None else self.score.loss


def leaderboards(
    database: str, tasks: Sequence[str] = (), entrants: Sequence[str] = ()
) -> list[Grid]:
    """Return the tables of the named tasks, by default all, with further entrants."""
    grids = []
    with open_results(database) as results:
        for name in tasks or search_path.options(GROUP):
            task = task_of(name)
            named = {**task.entrants, **entrants_of(task, entrants)}
            own = entries(results, task, cells(name, task, named))
            grids.append(leaderboard(name, task, [*own, *references(results, task, own)]))
    return grids


def entries(results: Results, task: Task, listed: Iterable[Cell]) -> list[Entry]:
    """Return the cells that have been run, with their scores."""
    newest = _newest(results)
    found = []
    for cell in listed:
        row = newest.get(_normal(cell.options))
        if row is not None:
            found.append(_entry(results, task, cell, row))
    return found


Stored = sa.Row[int, str, list[str], datetime, datetime | None, str | None]


def _newest(results: Results) -> dict[tuple[str, ...], Stored]:
    """Return the newest run of each set of options, by their normal form."""
    columns = (RunTable.id, RunTable.status, RunTable.overrides)
    ends = (RunTable.started_at, RunTable.finished_at, RunTable.error)
    query = sa.select(*columns, *ends).order_by(RunTable.id)
    return {_normal(row.overrides): row for row in results.reader.select(query)}


def _normal(options: Iterable[str]) -> tuple[str, ...]:
    """Return the options that decide the results, in one spelling and order."""
    return tuple(sorted(SPELLING.sub("", text) for text in options if not text.startswith(LABELS)))


def _entry(results: Results, task: Task, cell: Cell, row: Stored) -> Entry:
    run_id, status, _, started, finished, error = row
    result = None
    if status == FINISHED:
        series = results.reader.series(run_id, "prediction")
        result = score(series, "identified", task.outputs, task.horizons_s)
    seconds = (finished - started).total_seconds() if finished else math.nan
    count = sa.select(sa.func.count()).select_from(Coefficient).where(
        Coefficient.run_id == run_id, Coefficient.model == "residual", Coefficient.value != 0.0
    )  # fmt: skip
    ((parameters,),) = results.reader.select(count)
    return Entry(cell, run_id, status, seconds, error or "", parameters, result)


def references(results: Results, task: Task, own: Sequence[Entry]) -> list[Entry]:
    """Return what the mean of the motion and a held velocity reach in the cells of `own`."""
    done: dict[tuple[str, int], Entry] = {}
    for entry in own:
        if entry.score is not None:
            done.setdefault((entry.cell.case, entry.cell.seed), entry)
    found = []
    for entry in done.values():
        series = results.reader.series(entry.run, "prediction")
        for name in REFERENCES:
            cell = replace(entry.cell, entrant=name)
            result = score(series, name, task.outputs)
            found.append(replace(entry, cell=cell, duration_s=0.0, parameters=0, score=result))
    return found


def losses(own: Sequence[Entry]) -> tuple[list[str], Sample]:
    """Return entrants, and their losses (n_cases, n_entrants) in the cells that all have run."""
    names = list(dict.fromkeys(entry.cell.entrant for entry in own))
    by_cell: dict[tuple[str, str, int], dict[str, float]] = defaultdict(dict)
    for entry in own:
        key = entry.cell.task, entry.cell.case, entry.cell.seed
        by_cell[key][entry.cell.entrant] = entry.loss
    rows = [[row[name] for name in names] for row in by_cell.values() if len(row) == len(names)]
    return names, np.array(rows, dtype=np.float64).reshape(len(rows), len(names))


def leaderboard(name: str, task: Task, own: Sequence[Entry]) -> Grid:
    """Return the table of a task: the best mean rank first.

    FIT is that of the pooled free runs, with its 90 % interval; after each horizon stands the mean
    NRMSE of the predictions over it.
    """
    names, table = losses(own)
    ranks = ranking(table) if len(table) else None
    order = ranks.order() if ranks else range(len(names))
    best = ranks.best() if ranks else set[int]()
    rows = [
        _row(names[i], [e for e in own if e.cell.entrant == names[i]], task, ranks, i, i in best)
        for i in order
    ]
    headers = ["entrant", "rank", "FIT [%]", "90 %", *(f"{dof} FIT" for dof in task.outputs)]
    headers += [*(f"NRMSE {seconds:g} s" for seconds in task.horizons_s), "diverged", "parameters"]
    notes = [f"{len(table)} cells that all entrants have run; rank: mean over them, 1 is best"]
    notes.append("bold: the best rank, and ranks that do not differ from it significantly")
    if not own:
        notes = [f"no runs: {trial_program()} benchmark --task {name}"]
    return Grid(task.title, [*headers, "time [s]"], rows, notes=notes)


def _row(
    name: str, own: Sequence[Entry], task: Task, ranks: Ranking | None, i: int, best: bool
) -> list[Shown]:
    scores = [entry.score for entry in own if entry.score is not None]
    lost = [entry for entry in own if math.isinf(entry.loss)]
    good = [result for result in scores if not math.isinf(result.loss)]
    fits = [np.nan] * len(task.outputs)
    if good:
        fits = (100.0 * (1.0 - _pooled([result.nrmse for result in good]))).tolist()
    low, high = interval(good) if good else (math.nan, math.nan)
    after = [
        _mean([float(np.mean(r.after[s])) for r in good if s in r.after]) for s in task.horizons_s
    ]
    return [
        Shown(name, bold=best),
        Shown(number_text(ranks.mean_ranks[i], 3) if ranks else "-", bold=best),
        Shown(number_text(float(np.mean(fits)), 3), bold=best),
        Shown(f"{100 * (1 - high):.0f} to {100 * (1 - low):.0f}" if good else "-"),
        *(Shown(number_text(value, 3)) for value in fits),
        *(Shown(number_text(value, 2)) for value in after),
        Shown(f"{len(lost)} of {len(own)}"),
        Shown(number_text(_mean([entry.parameters for entry in own]), 3)),
        Shown(number_text(_mean([entry.duration_s for entry in own]), 2)),
    ]


def _pooled(nrmse: Sequence[Sample]) -> Sample:
    """Root of the mean square over cells, per output."""
    return np.asarray(np.sqrt(np.mean(np.square(nrmse), axis=0)))


def _mean(values: Sequence[float]) -> float:
    known = [value for value in values if math.isfinite(value)]
    return float(np.mean(known)) if known else math.nan
