"""The tables of the benchmark: entrants by task, and a summary."""

import math
from collections.abc import Iterable, Sequence

import numpy as np

from seatrial.runner.compare.benchmark.boards import Board, overall
from seatrial.runner.compare.benchmark.boards import boards as boards
from seatrial.runner.compare.benchmark.scores import BAND_LEVEL, REFERENCES, interval, pooled
from seatrial.runner.compare.grid import TableCell, TextTable, number_text
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.configuration.invocation import trial_program

COMPARED = ("auto", "none", *REFERENCES)  # entrants that the summary shows beside the first one
SUMMARY = ("task", "cells", "first", "score", "90 %", "not significantly worse")
BOLD = (
    "bold: not significantly worse than the first, by ranks, or where there are too few cells by a"
    " paired bootstrap of the errors, and none of its cells lost; mean_motion, persistence and"
    " at_rest are left out"
)
NO_SKILL = "no skill: none, or a trivial rival, is at least as good as the first entrant"


def grids(boards: Sequence[Board]) -> list[TextTable]:
    """Return the tables of the tasks."""
    return [leaderboard(board) for board in boards]


def leaderboard(board: Board) -> TextTable:
    """Return the table of a task: the best mean rank first.

    FIT is that of the pooled free runs, with its 90 % interval; after each horizon stands the mean
    NRMSE of the predictions over it. `in 90 % band` is the share of the outputs of the free run
    that were measured in the band.
    """
    task, ranked = board.task, board.ranked
    if board.entries.empty:
        notes = [f"no runs: {trial_program()} benchmark --task {task.name}"]
        return TextTable(task.title, [*_columns(board, "").keys()], [], notes=notes)
    best = board.rivals()
    rows = [_columns(board, name, name in best and not board.lost(name)) for name in ranked.order()]
    cells = ranked.cases
    notes = [
        f"{cells} cell{'s'[: cells != 1]} that all entrants have run; rank: mean over them, 1 is"
        " best; FIT, NRMSE, band and CRPS: of the cells that did not diverge",
        BOLD,
    ]
    return TextTable(task.title, [*rows[0]], [[*row.values()] for row in rows], notes=notes)


def _columns(board: Board, name: str, best: bool = False) -> dict[str, TableCell]:
    """Return the row of an entrant, by its headers."""
    task, own, good = board.task, board.of(name), board.scores(name, "score")
    fits = 100.0 * (1.0 - pooled(good)) if good else np.full(len(task.outputs), np.nan)
    row = {
        "entrant": TableCell(name, bold=best),
        "rank": _number(board.ranked.mean_ranks.get(name, math.nan), 3, best),
        "FIT [%]": _number(float(np.mean(fits)), 3, best),
        "90 %": TableCell(interval_text(board, name)),
    }
    row |= {f"{dof} FIT": _number(f, 3) for dof, f in zip(task.outputs, fits, strict=True)}
    for s in task.horizons_s:
        row[f"NRMSE {s:g} s"] = _number(_mean(after[s] for after in own["after"] if after), 2)
    if task.score != "free_run":
        row[_score_name(board)] = _number(score(board, name), 3)
    covered = _pooled_mean([each for one in good if (each := one.covered) is not None])
    row[f"in {100.0 * BAND_LEVEL:.0f} % band [%]"] = _number(100.0 * covered, 3)
    row["CRPS"] = _number(_pooled_mean([one.crps for one in good]), 2)
    row["diverged"] = TableCell(f"{board.lost(name)} of {len(own)}")
    row["training [s]"] = _number(_mean(own["training_s"]), 2)
    return row


def _number(value: float, digits: int, bold: bool = False) -> TableCell:
    """A cell of a number; a dash for one that is not known."""
    if math.isnan(value):
        return TableCell("–", bold=bold)
    rounded = 0.0 if abs(value) < 1e-6 else value  # a FIT of the mean motion is 0 but for rounding
    return TableCell(number_text(rounded, digits), bold, rounded)


def _mean(values: Iterable[float]) -> float:
    known = [value for value in values if math.isfinite(value)]
    return float(np.mean(known)) if known else math.nan


def _pooled_mean(parts: Sequence[Sample]) -> float:
    """Mean over all outputs and samples (N, n) of several free runs; NaN if there are none."""
    return float(np.mean(np.concatenate(parts))) if parts else math.nan


def score(board: Board, name: str) -> float:
    """What a task ranks an entrant by, over the cells that it did not lose; NaN if it lost all.

    The mean FIT [%] over the outputs of the pooled predictions, or the error of the position [m].
    """
    if board.task.score == "position":
        return _mean(board.of(name)["loss"])
    good = board.scores(name)
    return 100.0 * (1.0 - float(np.mean(pooled(good)))) if good else math.nan


def _score_name(board: Board) -> str:
    """What a task ranks by, with its unit."""
    task = board.task
    if task.score == "position":
        return f"position error after {task.after_s:g} s [m]"
    return "FIT [%]" if task.score == "free_run" else f"FIT after {task.after_s:g} s [%]"


def interval_text(board: Board, name: str) -> str:
    """Return the 90 % interval of an entrant's FIT as `87 to 95`; a dash if all diverge."""
    good = board.scores(name)
    if not good or board.task.score == "position":
        return "–"
    low, high = interval(good)
    return f"{100.0 * (1.0 - high):.0f} to {100.0 * (1.0 - low):.0f}"


def summary(boards: Sequence[Board]) -> TextTable:
    """Return one line for each task that has been run: the first entrant, and what others reach."""
    rows = []
    for board in (board for board in boards if len(board.entries)):
        first, *others = board.rivals()
        own_score = "" if board.task.score == "free_run" else f": {_score_name(board)}"
        skill = "" if board.has_skill(first) else " (no skill)"
        rows.append([
            TableCell(f"{board.task.title}{own_score}"),
            TableCell(str(board.contest.cases)),
            TableCell(f"{first}{skill}"),
            _counted(board, first, False),
            TableCell(interval_text(board, first)),
            TableCell(", ".join(others) or "–", prose=True),
            *(_counted(board, name, name in (first, *others)) for name in COMPARED),
        ])  # fmt: skip
    notes = ["score: FIT [%] of the free runs, if the task names no other", BOLD]
    notes += [NO_SKILL] if any("(no skill)" in row[2].text for row in rows) else []
    for group, ranks in overall(boards):
        order = ", ".join(f"{name} {rank:.1f}" for name, rank in ranks.mean_ranks.items())
        titles = "; ".join(board.task.title for board in group)
        notes.append(f"mean ranks over {ranks.cases} cases of {titles}: {order}")
    headers = [*SUMMARY, *COMPARED]
    return TextTable("Benchmark", headers, rows, notes=notes)


def _counted(board: Board, name: str, rival: bool) -> TableCell:
    """The score of an entrant, with the number of its cells that it did not lose."""
    cell, lost = _number(score(board, name), 3), board.lost(name)
    own = len(board.of(name))
    text = f"{cell.text} ({own - lost} of {own})" if lost else cell.text
    return TableCell(text, rival and not lost, cell.sort)
