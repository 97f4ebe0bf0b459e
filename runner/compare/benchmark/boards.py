"""Boards of the benchmark: what entrants reached in the cells of a task, and their ranks.

The newest run of a cell counts; one that failed or diverged, and one whose model cannot predict,
has an infinite loss. Cells without a run are not ranked; a task is ranked over the cells that all
its entrants have run.
"""

import math
import re
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd
import sqlalchemy as sa

from seatrial.runner.compare.benchmark.cells import BenchmarkTrial, cells, entrants_of
from seatrial.runner.compare.benchmark.manoeuvre_scores import Measure, measures
from seatrial.runner.compare.benchmark.scores import (
    AT_REST,
    REFERENCES,
    Score,
    chance,
    position_score,
    restart_score,
    score,
)
from seatrial.runner.compare.benchmark.task import GROUP, Task, task_of
from seatrial.runner.compare.frame import FINISHED, Queries
from seatrial.runner.compare.ranking import SIGNIFICANCE, Ranking, ranking
from seatrial.runner.compare.statistics import Sample, holm
from seatrial.runner.configuration import search_path
from seatrial.runner.database.tables import DiagnosticRow
from seatrial.runner.database.tables import RunRow as RunTable
from seatrial.runner.record.rows import Coefficient, Series
from seatrial.runner.record.vocabulary import DOFS, ENDINGS, TRAINING_TIME

LABELS = ("results_dir=", "sweep.", "hydra", "database")  # options that change no result
SPELLING = re.compile(r"[\s'\"]+")
CELL = ["task", "case", "seed"]  # what is the same for all entrants of a cell


@dataclass(frozen=True)
class BenchmarkRun:
    """A cell with its newest run; times in seconds, NaN if they are not stored."""

    cell: BenchmarkTrial
    run: int
    status: str
    duration_s: float = 0.0
    training_s: float = 0.0
    error: str = ""
    parameters: int = 0  # that differ from the nominal ones
    score: Score | None = None  # of the free run; None: without a prediction
    judged: Score | None = None  # the score that ranks
    measures: tuple[Measure, ...] = ()

    @property
    def loss(self) -> float:
        """Error of the position, or mean NRMSE of the velocities; inf if they diverge."""
        return math.inf if self.judged is None else self.judged.loss


@dataclass(frozen=True, eq=False)
class Ranked:
    """Entrants, their losses (n_cases, n_entrants), and their ranks; None without a case."""

    names: list[str]
    losses: Sample

    @classmethod
    def over(cls, frame: pd.DataFrame, cell: Sequence[str] = CELL) -> "Ranked":
        """Rank entrants over the cells that all have run, by the median of the losses of a cell."""
        names = list(dict.fromkeys(frame["entrant"]))
        if not names:
            return cls([], np.zeros((0, 0)))
        losses = frame.groupby([*cell, "entrant"], sort=False)["loss"].median().unstack()
        return cls(names, losses[names].dropna().to_numpy())

    @cached_property
    def ranks(self) -> Ranking | None:
        """Mean ranks and tests of the pairs."""
        return ranking(self.losses) if self.losses.size else None

    def order(self) -> list[str]:
        """The entrants from the best to the worst."""
        places = self.ranks.order() if self.ranks else range(len(self.names))
        return [self.names[i] for i in places]

    @property
    def tested(self) -> bool:
        """Whether there are enough cases to tell entrants apart at all, after Holm's correction."""
        cases, count = self.losses.shape
        return bool(count > 1 and 0.5 ** (cases - 1) * (count * (count - 1) // 2) < SIGNIFICANCE)

    def best(self) -> list[str]:
        """The first entrant, and those not significantly different from it; none if not tested."""
        best = self.ranks.best() if self.ranks and self.tested else set[int]()
        return [name for name in self.order() if self.names.index(name) in best]

    def mean_rank(self, name: str) -> float:
        """Mean rank of an entrant, 1 is best; NaN without a case."""
        return float(self.ranks.mean_ranks[self.names.index(name)]) if self.ranks else np.nan


@dataclass(frozen=True, eq=False)
class Board:
    """A task with the entries that have been run, references included."""

    name: str
    task: Task
    entries: list[BenchmarkRun]

    @cached_property
    def frame(self) -> pd.DataFrame:
        """The losses, one row an entry: task, case, seed, entrant and loss."""
        rows = [
            (e.cell.task, e.cell.case, e.cell.seed, e.cell.entrant, e.loss) for e in self.entries
        ]
        return pd.DataFrame(rows, columns=[*CELL, "entrant", "loss"])

    @cached_property
    def ranked(self) -> Ranked:
        """The ranks over the cells that all entrants have run."""
        return Ranked.over(self.frame)

    @cached_property
    def contest(self) -> Ranked:
        """The ranks without the references, which know what is tested on."""
        names = [name for name in self.ranked.names if name not in REFERENCES]
        return Ranked(names, self.ranked.losses[:, [self.ranked.names.index(n) for n in names]])

    def rivals(self) -> list[str]:
        """The first entrant of the contest, and those not significantly worse, in order.

        Where there are too few cells for tests of ranks, by a paired bootstrap of the errors, in
        which an entrant that lost a cell differs from one that did not.
        """
        if self.contest.tested:
            return self.contest.best()
        first, *others = self.contest.order()
        own = {
            name: {(e.cell.case, e.cell.seed): e for e in self.of(name)}
            for name in (first, *others)
        }
        common = [key for key in own[first] if all(key in entries for entries in own.values())]
        values = holm([_chance([(own[first][key], own[n][key]) for key in common]) for n in others])
        return [first, *(n for n, p in zip(others, values, strict=True) if p >= SIGNIFICANCE)]

    def lost(self, entrant: str) -> int:
        """Number of the cells of an entrant that failed or diverged."""
        return sum(math.isinf(entry.loss) for entry in self.of(entrant))

    def has_skill(self, entrant: str) -> bool:
        """Whether an entrant identifies something, and is better than every trivial rival."""
        means = dict(zip(self.ranked.names, np.mean(self.ranked.losses, axis=0), strict=True))
        trivial = [name for name in means if name in (*REFERENCES, "none")]
        return entrant not in trivial and all(means[entrant] < means[name] for name in trivial)

    def of(self, entrant: str) -> list[BenchmarkRun]:
        """The entries of an entrant."""
        return [entry for entry in self.entries if entry.cell.entrant == entrant]

    def leaders(self, count: int) -> list[str]:
        """The first entrants that identify something: no references, and not `none`."""
        return [name for name in self.contest.order() if name != "none"][:count]


def boards(
    results: Queries, tasks: Sequence[str] = (), entrants: Sequence[str] = ()
) -> list[Board]:
    """Return the boards of the named tasks, by default all, with further entrants."""
    found = []
    for name in tasks or search_path.options(GROUP):
        task = task_of(name)
        named = {**task.entrants, **entrants_of(task, entrants)}
        own = entries(results, task, cells(name, task, named))
        found.append(Board(name, task, [*own, *references(results, task, own)]))
    return found


def overall(boards: Sequence[Board]) -> list[tuple[list[Board], Ranked]]:
    """Rank the entrants of tasks with the same ones, over the cases of these tasks together.

    The loss in a case is the median over its seeds, since repeated trials of one case are no
    independent data sets. Tasks that have not been run are left out, and so is a task whose
    entrants no other one has: it has ranks of its own.
    """
    groups: dict[frozenset[str], list[Board]] = defaultdict(list)
    for board in boards:
        if board.entries:
            groups[frozenset(board.ranked.names) - {AT_REST}].append(board)
    several = [group for group in groups.values() if len(group) > 1]
    frames = [pd.concat([board.frame for board in group]) for group in several]
    return [
        (group, Ranked.over(frame[frame["entrant"] != AT_REST], ["task", "case"]))
        for group, frame in zip(several, frames, strict=True)
    ]


def _chance(pairs: Sequence[tuple[BenchmarkRun, BenchmarkRun]]) -> float:
    """Return the p-value of equal losses of two entrants in the same cells."""
    if any(math.isinf(one.loss) for pair in pairs for one in pair):
        both = all(math.isinf(first.loss) == math.isinf(other.loss) for first, other in pairs)
        return float(both)
    first, other = zip(*((a.judged, b.judged) for a, b in pairs), strict=True)
    return chance(first, other)


def entries(results: Queries, task: Task, listed: Iterable[BenchmarkTrial]) -> list[BenchmarkRun]:
    """Return the cells that have been run, each with its newest run and its scores."""
    columns = (RunTable.id, RunTable.status, RunTable.overrides)
    ends = (RunTable.started_at, RunTable.finished_at, RunTable.error)
    ended = RunTable.status.in_(ENDINGS)
    query = sa.select(*columns, *ends).where(ended).order_by(RunTable.id)
    newest = {_normal(row.overrides): row for row in results.reader.select(query)}
    timed = sa.select(DiagnosticRow.run_id, DiagnosticRow.value)
    timed = timed.where(DiagnosticRow.name == TRAINING_TIME)
    training_s = {row.run_id: float(row.value) for row in results.reader.select(timed)}
    found = []
    for cell in listed:
        row = newest.get(_normal(cell.options))
        if row is None:
            continue
        run, end = row.id, row.finished_at
        entry = BenchmarkRun(
            cell, run, row.status, (end - row.started_at).total_seconds() if end else math.nan,
            training_s.get(run, math.nan), row.error or "",
            parameters(results.reader.coefficients(run)),
        )  # fmt: skip
        if row.status == FINISHED:
            series = results.reader.series(run, "prediction")
            entry = _scored(entry, series, "identified", task)
            manoeuvre = task.cases[cell.case].manoeuvre
            if manoeuvre is not None:
                config = results.reader.run(run).config
                recording = results.reader.series(run, "recording")
                measured = tuple(measures(series, recording, config, manoeuvre))
                entry = replace(entry, measures=measured)
        found.append(entry)
    return found


def references(results: Queries, task: Task, own: Sequence[BenchmarkRun]) -> list[BenchmarkRun]:
    """Return what the trivial rivals reach in the cells of `own`; one at rest has a position."""
    names = [name for name in REFERENCES if name != AT_REST or task.score == "position"]
    done: dict[tuple[str, int], BenchmarkRun] = {}
    for entry in own:
        if entry.score is not None:
            done.setdefault((entry.cell.case, entry.cell.seed), entry)
    found = []
    for entry in done.values():
        series = results.reader.series(entry.run, "prediction")
        for name in names:
            row = BenchmarkRun(replace(entry.cell, entrant=name), entry.run, entry.status)
            found.append(_scored(row, series, name, task))
    return found


def _scored(entry: BenchmarkRun, series: Series, model: str, task: Task) -> BenchmarkRun:
    """Return an entry with its score of the free run, and the one that the task ranks by."""
    judged = free_run = score(series, model, task.outputs, task.horizons_s)
    if task.score == "position" and task.after_s is not None:
        judged = position_score(series, model, task.after_s)
    elif task.score == "restarts" and task.after_s is not None:
        judged = restart_score(series, model, task.outputs, task.after_s)
    return replace(entry, score=free_run, judged=judged)


def _normal(options: Iterable[str]) -> tuple[str, ...]:
    """Return the options that decide the results, in one spelling and order."""
    return tuple(sorted(SPELLING.sub("", text) for text in options if not text.startswith(LABELS)))


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
