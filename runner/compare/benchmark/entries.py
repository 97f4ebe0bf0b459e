"""Entries of the benchmark: the cells that have been run, each with its newest run and scores.

A run that failed or diverged, and one whose model cannot predict, has an infinite loss.
"""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from datetime import datetime

import sqlalchemy as sa

from seatrial.runner.compare.benchmark.cells import BenchmarkTrial
from seatrial.runner.compare.benchmark.manoeuvre_scores import Measure, measures
from seatrial.runner.compare.benchmark.scores import (
    AT_REST,
    MEAN_MOTION,
    PERSISTENCE,
    Score,
    position_score,
    restart_score,
    score,
)
from seatrial.runner.compare.benchmark.task import Task
from seatrial.runner.compare.frame import FINISHED, Queries
from seatrial.runner.database.tables import DiagnosticRow
from seatrial.runner.database.tables import RunRow as RunTable
from seatrial.runner.record.rows import Coefficient, Series
from seatrial.runner.vocabulary import DOFS, ENDINGS, TRAINING_TIME

REFERENCES = (MEAN_MOTION, PERSISTENCE, AT_REST)
LABELS = ("results_dir=", "sweep.", "hydra", "database")  # options that change no result
SPELLING = re.compile(r"[\s'\"]+")


@dataclass(frozen=True)
class BenchmarkRun:
    """A cell with its newest run."""

    cell: BenchmarkTrial
    run: int
    status: str
    duration_s: float
    training_s: float  # NaN if it is not stored
    error: str
    parameters: int  # that differ from the nominal ones
    score: Score | None  # of the free run; None: without a prediction
    measures: tuple[Measure, ...] = ()
    judged: Score | None = None  # the score that ranks

    @property
    def loss(self) -> float:
        """Error of the position, or mean NRMSE of the velocities; inf if they diverge."""
        return math.inf if self.judged is None else self.judged.loss


def entries(results: Queries, task: Task, listed: Iterable[BenchmarkTrial]) -> list[BenchmarkRun]:
    """Return the cells that have been run, with their scores."""
    columns = (RunTable.id, RunTable.status, RunTable.overrides)
    ends = (RunTable.started_at, RunTable.finished_at, RunTable.error)
    ended = RunTable.status.in_(ENDINGS)
    query = sa.select(*columns, *ends).where(ended).order_by(RunTable.id)
    newest = {_normal(row.overrides): row for row in results.reader.select(query)}
    found = []
    for cell in listed:
        row = newest.get(_normal(cell.options))
        if row is not None:
            found.append(_entry(results, task, cell, row))
    return found


Stored = sa.Row[int, str, list[str], datetime, datetime | None, str | None]


def _normal(options: Iterable[str]) -> tuple[str, ...]:
    """Return the options that decide the results, in one spelling and order."""
    return tuple(sorted(SPELLING.sub("", text) for text in options if not text.startswith(LABELS)))


def _entry(results: Queries, task: Task, cell: BenchmarkTrial, row: Stored) -> BenchmarkRun:
    run, status, _, started, finished, error = row
    result, found, judged = None, tuple[Measure, ...](), None
    if status == FINISHED:
        series = results.reader.series(run, "prediction")
        result = score(series, "identified", task.outputs, task.horizons_s)
        judged = _judged(series, "identified", task, result)
        manoeuvre = task.cases[cell.case].manoeuvre
        if manoeuvre is not None:
            config = results.reader.run(run).config
            recording = results.reader.series(run, "recording")
            found = tuple(measures(series, recording, config, manoeuvre))
    return BenchmarkRun(
        cell, run, status, (finished - started).total_seconds() if finished else math.nan,
        _training_s(results, run), error or "", parameters(results.reader.coefficients(run)),
        result, found, judged,
    )  # fmt: skip


def _judged(series: Series, model: str, task: Task, free_run: Score) -> Score:
    """Return the score that a task ranks by."""
    if task.score == "free_run" or task.after_s is None:
        return free_run
    if task.score == "position":
        return position_score(series, model, task.after_s)
    return restart_score(series, model, task.outputs, task.after_s)


def _training_s(results: Queries, run: int) -> float:
    where = DiagnosticRow.run_id == run, DiagnosticRow.name == TRAINING_TIME
    rows = results.reader.select(sa.select(DiagnosticRow.value).where(*where))
    return float(rows[0].value) if rows else math.nan


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
            cell = replace(entry.cell, entrant=name)
            free_run = score(series, name, task.outputs, task.horizons_s)
            judged = _judged(series, name, task, free_run)
            row = BenchmarkRun(
                cell, entry.run, entry.status, 0.0, 0.0, "", 0, free_run, judged=judged
            )
            found.append(row)
    return found
