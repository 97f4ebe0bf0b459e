"""Boards of the benchmark: what entrants reached in the cells of a task, and their ranks.

The newest run of a cell counts; one that failed or diverged, and one whose model cannot predict,
has an infinite loss. Cells without a run are not ranked; a task is ranked over the cells that all
its entrants have run.
"""

import math
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pandas as pd
import sqlalchemy as sa

from seatrial.models.diagnostics import Diagnostic
from seatrial.runner.compare.benchmark.scores import (
    AT_REST,
    POSITION,
    REFERENCES,
    Score,
    chance,
    score,
    score_after,
)
from seatrial.runner.compare.benchmark.task import GROUP, Task, cells, task_of
from seatrial.runner.compare.frame import FINISHED, Queries
from seatrial.runner.compare.ranking import SIGNIFICANCE, Ranking, ranking
from seatrial.runner.compare.statistics import holm
from seatrial.runner.configuration import search_path
from seatrial.runner.database.tables import DiagnosticRow
from seatrial.runner.database.tables import RunRow as RunTable
from seatrial.runner.export.manoeuvre_tracks import COMPARED, DIAGNOSTIC
from seatrial.runner.record.rows import Coefficient, Series
from seatrial.runner.record.vocabulary import DOFS, ENDINGS, NO_RESULT, TRAINING_TIME

ORDERED = ("helm", "change of heading")  # of a sheet: no result
SPELLING = re.compile(r"[\s'\"]+")
CELL = ["task", "case", "seed"]  # what is the same for all entrants of a cell
ENTRY = (
    *(*CELL, "entrant", "run", "status", "error", "duration_s", "training_s", "parameters"),
    *("score", "judged", "measures"),
)


class Measure(NamedTuple):
    """A quantity of the manoeuvre of one test file; NaN for what is not reached."""

    file: int
    quantity: str
    unit: str  # L: ship lengths
    measured: float
    predicted: float

    @property
    def error(self) -> float:
        """Error over the measured value; inf for what the model does not reach."""
        error = abs(self.predicted - self.measured) / abs(self.measured)
        return error if math.isfinite(error) else math.inf


@dataclass(frozen=True, eq=False)
class Board:
    """A task with the cells that have been run, references included: a row of `entries` each.

    Columns are those of ENTRY and the loss: times in seconds, NaN if they are not stored; the
    number of `parameters` that differ from the nominal ones; the `score` of the free run, and the
    one that ranks (`judged`), None without a prediction; the `measures` of manoeuvres.
    """

    task: Task
    entries: pd.DataFrame

    @cached_property
    def losses(self) -> pd.DataFrame:
        """Losses by entrant (n_cells, n_entrants), of the cells that all of them have run."""
        return losses_of(self.entries, CELL)

    @cached_property
    def ranked(self) -> Ranking:
        """The ranks over these cells."""
        return ranking(self.losses)

    @cached_property
    def contest(self) -> Ranking:
        """The ranks without the references, which know what is tested on."""
        return ranking(self.losses.drop(columns=list(REFERENCES), errors="ignore"))

    def rivals(self) -> list[str]:
        """The first entrant of the contest, and those not significantly worse, in order.

        Where there are too few cells for tests of ranks, by a paired bootstrap of the errors, in
        which an entrant that lost a cell differs from one that did not.
        """
        if self.contest.tested:
            return self.contest.best()
        first, *others = self.contest.order()
        judged = {name: self.of(name).set_index(CELL)["judged"] for name in (first, *others)}
        common = [cell for cell in judged[first].index if all(cell in j for j in judged.values())]
        values = holm([chance(judged[first][common], judged[name][common]) for name in others])
        return [first, *(n for n, p in zip(others, values, strict=True) if p >= SIGNIFICANCE)]

    def of(self, entrant: str) -> pd.DataFrame:
        """The entries of an entrant."""
        return self.entries[self.entries["entrant"] == entrant]

    def lost(self, entrant: str) -> int:
        """Number of the cells of an entrant that failed or diverged."""
        return int((self.of(entrant)["loss"] == math.inf).sum())

    def scores(self, entrant: str, kind: str = "judged") -> list[Score]:
        """The scores of an entrant, `judged` or `score`, of the cells that did not diverge."""
        scores = self.of(entrant)[kind]
        return [each for each in scores if each is not None and math.isfinite(each.loss)]

    def has_skill(self, entrant: str) -> bool:
        """Whether an entrant identifies something, and is better than every trivial rival."""
        means = self.losses.mean()
        trivial = [name for name in means.index if name in (*REFERENCES, "none")]
        return entrant not in trivial and bool((means[entrant] < means[trivial]).all())

    def leaders(self, count: int) -> list[str]:
        """The first entrants that identify something: no references, and not `none`."""
        return [name for name in self.contest.order() if name != "none"][:count]


def losses_of(entries: pd.DataFrame, cell: Sequence[str]) -> pd.DataFrame:
    """Median losses by entrant (n_cells, n_entrants), of the cells that all entrants have run."""
    if entries.empty:
        return pd.DataFrame()
    losses = entries.groupby([*cell, "entrant"], sort=False)["loss"].median().unstack()
    return losses[entries["entrant"].unique()].dropna()


def boards(
    results: Queries, tasks: Sequence[str] = (), entrants: Sequence[str] = ()
) -> list[Board]:
    """Return the boards of the named tasks, by default all, with further entrants."""
    known = [task_of(name) for name in tasks or search_path.options(GROUP)]
    return [Board(task, _entries(results, task, [*task.entrants, *entrants])) for task in known]


def overall(boards: Sequence[Board]) -> list[tuple[list[Board], Ranking]]:
    """Rank the entrants of tasks with the same ones, over the cases of these tasks together.

    The loss in a case is the median over its seeds, since repeated trials of one case are no
    independent data sets. Tasks that have not been run are left out, and so is a task whose
    entrants no other one has: it has ranks of its own.
    """
    groups: dict[frozenset[str], list[Board]] = defaultdict(list)
    for board in boards:
        if len(board.entries):
            groups[frozenset(board.losses) - {AT_REST}].append(board)
    ranks = []
    for group in groups.values():
        if len(group) > 1:
            entries = pd.concat([board.entries for board in group], ignore_index=True)
            entries = entries[entries["entrant"] != AT_REST]
            ranks.append((group, ranking(losses_of(entries, ["task", "case"]))))
    return ranks


def _entries(results: Queries, task: Task, entrants: Sequence[str]) -> pd.DataFrame:
    """Return the cells that have been run, each with its newest run, and then the trivial rivals.

    These have the cells in which some entrant has a prediction; one at rest has a position only.
    """
    r, d = RunTable, DiagnosticRow
    query = sa.select(r.id, r.status, r.overrides, r.started_at, r.finished_at, r.error)
    query = query.where(r.status.in_(ENDINGS)).order_by(r.id)
    newest = {_normal(row.overrides): row for row in results.reader.select(query)}
    timed = sa.select(d.run_id, d.value).where(d.name == TRAINING_TIME)
    training_s = {row.run_id: row.value for row in results.reader.select(timed)}
    own: list[dict[str, object]] = []
    trivial: dict[tuple[str, int], list[dict[str, object]]] = {}
    for cell in cells(task, entrants):
        row = newest.get(_normal(cell.options))
        if row is None:
            continue
        place: dict[str, object] = {**dict.fromkeys(ENTRY, 0), **cell._asdict()}
        place |= {"run": row.id, "status": row.status, "error": "", "measures": ()}
        end = row.finished_at
        entry = place | {
            "error": row.error or "",
            "duration_s": (end - row.started_at).total_seconds() if end else math.nan,
            "training_s": training_s.get(row.id, math.nan),
            "parameters": parameters(results.reader.coefficients(row.id)),
            **{"score": None, "judged": None},
        }
        own.append(entry)
        if row.status != FINISHED:
            continue
        series = results.reader.series(row.id, "prediction")
        entry |= _scores(series, "identified", task)
        if task.cases[cell.case].manoeuvre is not None:
            entry["measures"] = tuple(measures(results.reader.diagnostics(row.id)))
        if (cell.case, cell.seed) not in trivial:
            trivial[cell.case, cell.seed] = [
                place | {"entrant": name} | _scores(series, name, task)
                for name in REFERENCES
                if name != AT_REST or task.score == "position"
            ]
    rows = [*own, *(row for of_cell in trivial.values() for row in of_cell)]
    frame = pd.DataFrame(rows, columns=[*ENTRY], dtype=object)
    losses = [math.inf if judged is None else judged.loss for judged in frame["judged"]]
    return frame.assign(loss=np.array(losses, dtype=np.float64))


def _scores(series: Series, model: str, task: Task) -> dict[str, object]:
    """Return the score of the free run, and the one that the task ranks by."""
    judged = free_run = score(series, model, task.outputs, task.horizons_s)
    if task.score != "free_run" and task.after_s is not None:
        outputs = POSITION if task.score == "position" else task.outputs
        judged = score_after(series, model, outputs, task.after_s)
    return {"score": free_run, "judged": judged}


def _normal(options: Iterable[str]) -> tuple[str, ...]:
    """Return the options that decide the results, in one spelling and order."""
    return tuple(
        sorted(SPELLING.sub("", text) for text in options if not text.startswith(NO_RESULT))
    )


def measures(rows: Iterable[Diagnostic]) -> Iterator[Measure]:
    """Yield what a run has stored of the manoeuvres of its test files, measured and identified.

    Compared are results with a value to which an error is relative, and not what was ordered.
    """
    values: dict[tuple[int | None, str, str], dict[int | None, float | None]] = {}
    for row in rows:
        if row.name.startswith(DIAGNOSTIC):
            quantity = row.name.removeprefix(DIAGNOSTIC).replace("_", " ")
            values.setdefault((row.i, quantity, row.unit), {})[row.j] = row.value
    for (file, quantity, unit), own in values.items():
        measured, predicted = (own.get(COMPARED.index(n)) for n in ("measured", "identified model"))
        known = measured is not None and math.isfinite(measured) and measured != 0.0
        lasting = unit in ("L", "deg") or quantity == "period P"
        if measured is not None and known and lasting and quantity not in ORDERED:
            reached = math.nan if predicted is None else predicted
            yield Measure(file or 0, quantity, unit, measured, reached)


def parameters(rows: Iterable[Coefficient]) -> int:
    """Number of parameters of a run's model that differ from those of the nominal one.

    These are coefficients, parameters of devices, and entries of the matrices of a state space.
    """
    value = {(row.model, row.dof, row.term): row.value for row in rows}
    count = 0
    for (model, dof, term), own in value.items():
        if model in ("residual", "state_space"):
            count += own not in (0.0, 1.0) if model == "state_space" else own != 0.0
        elif model == "identified" and dof not in DOFS:
            count += own != value.get(("nominal", dof, term))
    return count
