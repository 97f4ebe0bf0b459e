"""The leaderboard of the benchmark: what entrants reached in the cells of a task, and their ranks.

The newest run of a cell counts; one that failed or diverged, and one whose model cannot predict,
has an infinite loss. Cells without a run are not ranked; a task is ranked over the cells that all
its entrants have run. Ranks are of tables of losses, shape (n_cases, n_entrants): smaller is best.

Demsar (2006), Statistical comparisons of classifiers over multiple data sets; Holm (1979);
Benavoli, Corani and Mangili (2016) for pairwise tests instead of mean ranks.
"""

import math
import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
import scipy  # its subpackages are loaded at their first use
import sqlalchemy as sa

from seatrial.runner.compare.benchmark import scores
from seatrial.runner.compare.benchmark.scores import AT_REST, POSITION, REFERENCES, Score
from seatrial.runner.compare.benchmark.task import GROUP, Task, cells, task_of
from seatrial.runner.compare.frame import FINISHED, Queries
from seatrial.runner.compare.grid import TableCell, TextTable, number_text
from seatrial.runner.compare.statistics import equal, holm
from seatrial.runner.configuration import search_path
from seatrial.runner.configuration.invocation import trial_program
from seatrial.runner.database.tables import DiagnosticRow
from seatrial.runner.database.tables import RunRow as RunTable
from seatrial.runner.record.rows import Series
from seatrial.runner.record.vocabulary import ENDINGS, NO_RESULT, TRAINING_TIME

SPELLING = re.compile(r"[\s'\"]+")
# A path in an option, of which the last folder and the name count: another checkout, or another
# folder of outside data, has the same runs.
PATH = re.compile(r'(?:/[^/",\]]+)*/([^/",\]]+/[^/",\]]+)(?=[",\]]|$)')
CELL = ["task", "case", "seed"]  # what is the same for all entrants of a cell
ENTRY = (
    *(*CELL, "entrant", "run", "status", "error", "duration_s", "training_s"),
    *("score", "judged", "after", "loss"),
)
COMPARED = ("auto", "none", *REFERENCES)  # entrants that the summary shows beside the first one
SUMMARY = ("task", "cells", "first", "score", "90 %", "not significantly worse")
BOLD = (
    "bold: not significantly worse than the first, by ranks, or where there are too few cells by a"
    " paired bootstrap of the errors, and none of its cells lost; mean_motion, persistence and"
    " at_rest are left out"
)
NO_SKILL = "no skill: none, or a trivial rival, is at least as good as the first entrant"


SIGNIFICANCE = 0.05


@dataclass(frozen=True, eq=False)
class Ranking:
    """Entrants over a number of cases.

    `mean_ranks` are by entrant, the best first: 1 is best, NaN without a case. `p_values` are those
    of every pair, by Holm's correction.
    """

    mean_ranks: "pd.Series[float]"
    p_values: Mapping[frozenset[str], float]
    cases: int

    def order(self) -> list[str]:
        """The entrants from the best mean rank to the worst."""
        return [*self.mean_ranks.index]

    def differ(self, one: str, other: str) -> bool:
        """Whether two entrants differ significantly."""
        return self.p_values[frozenset((one, other))] < SIGNIFICANCE

    def best(self) -> list[str]:
        """The first entrant, and those not significantly different from it.

        None where there are too few cases to tell entrants apart at all, after Holm's correction.
        """
        pairs, (first, *others) = len(self.p_values), self.order() or [""]
        if not pairs or 0.5 ** (self.cases - 1) * pairs >= SIGNIFICANCE:
            return []
        return [first, *(name for name in others if not self.differ(first, name))]

    def groups(self) -> list[list[str]]:
        """Largest runs of entrants, neighbours in rank, of which no two differ significantly."""
        order = self.order()
        parts = [order[first:end] for first, end in combinations(range(len(order) + 1), 2)]
        alike = [own for own in parts if not any(self.differ(*p) for p in combinations(own, 2))]
        whole = (own for own in alike if not any({*own} < {*other} for other in alike))
        return [own for own in whole if len(own) > 1]


def ranking(losses: pd.DataFrame) -> Ranking:
    """Rank entrants by their losses (n_cases, n_entrants); raises ValueError for NaN.

    Losses that are equal share the mean of their ranks. Pairs are compared by the two-sided
    signed-rank test of Wilcoxon on the ranks within a case, since losses of different cases have
    different scales.
    """
    if losses.isna().to_numpy().any():
        raise ValueError("losses: got NaN, expected numbers; inf for an entrant without a result")
    places = []
    for row in losses.to_numpy():
        order = np.argsort(row, kind="stable")
        apart = ~equal(row[order][1:], row[order][:-1])
        place = np.empty(len(row))
        place[order] = np.concatenate([[0], np.cumsum(apart)])
        places.append(scipy.stats.rankdata(place))
    ranks = pd.DataFrame(places, losses.index, losses.columns, dtype=np.float64)
    pairs = list(combinations(losses, 2))
    differences = [(ranks[one] - ranks[other]).to_numpy() for one, other in pairs]
    p_values = holm([  # 1 of entrants that are equal in every case
        scipy.stats.wilcoxon(each, zero_method="zsplit").pvalue if np.any(each) else 1.0
        for each in differences
    ])  # fmt: skip
    p_of = dict(zip(map(frozenset, pairs), p_values, strict=True))
    return Ranking(ranks.mean().sort_values(kind="stable"), p_of, len(losses))


def critical_difference(entrants: int, cases: int, level: float = SIGNIFICANCE) -> float:
    """Difference of two mean ranks that is significant by the test of Nemenyi.

    CD = q sqrt(k (k + 1) / (6 N)) of k entrants in N cases, with q the quantile of the Studentized
    range over sqrt(2). Demsar (2006), section 3.2.2. More cautious than `ranking`'s pairwise tests.
    """
    range_ = scipy.stats.studentized_range.ppf(1.0 - level, entrants, np.inf)
    return float(range_ / np.sqrt(2.0) * np.sqrt(entrants * (entrants + 1) / (6.0 * cases)))


@dataclass(frozen=True, eq=False)
class Board:
    """A task with the cells that have been run, references included: a row of `entries` each.

    Columns are those of ENTRY: times in seconds, NaN if they are not stored; the `score` of the
    free run, and the one that ranks (`judged`), None without a prediction; the NRMSE by horizon [s]
    (`after`) if the free run did not diverge; the loss, inf for a trial that failed or diverged.
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
        if best := self.contest.best():
            return best
        first, *others = self.contest.order()
        judged = {name: self.of(name).set_index(CELL)["judged"] for name in (first, *others)}
        common = [cell for cell in judged[first].index if all(cell in j for j in judged.values())]
        values = holm(
            [scores.chance(judged[first][common], judged[name][common]) for name in others]
        )
        return [first, *(n for n, p in zip(others, values, strict=True) if p >= SIGNIFICANCE)]

    def of(self, entrant: str) -> pd.DataFrame:
        """The entries of an entrant."""
        return self.entries[self.entries["entrant"] == entrant]

    def lost(self, entrant: str) -> int:
        """Number of the cells of an entrant that failed or diverged."""
        return int((self.of(entrant)["loss"] == math.inf).sum())

    def scores(self, entrant: str, kind: str = "judged") -> list[Score]:
        """The scores of an entrant, `judged` or `score`, of the cells that did not diverge."""
        return [each for each in self.of(entrant)[kind] if each and math.isfinite(each.loss)]

    def score(self, entrant: str) -> float:
        """What the task ranks an entrant by, over the cells that it did not lose; NaN without any.

        The mean FIT [%] over the outputs of the pooled predictions, or the error of position [m].
        """
        if self.task.score == "position":
            return _mean(self.of(entrant)["loss"])
        good = self.scores(entrant)
        return 100.0 * (1.0 - float(np.mean(scores.pooled(good)))) if good else math.nan

    @property
    def score_name(self) -> str:
        """What the task ranks by, with its unit."""
        after = "" if self.task.score == "free_run" else f" after {self.task.after_s:g} s"
        return f"position error{after} [m]" if self.task.score == "position" else f"FIT{after} [%]"

    def interval(self, entrant: str) -> str:
        """The 90 % interval of an entrant's FIT as `87 to 95`; a dash if all diverge."""
        good = self.scores(entrant)
        if not good or self.task.score == "position":
            return "–"
        low, high = scores.interval(good)
        return f"{100.0 * (1.0 - high):.0f} to {100.0 * (1.0 - low):.0f}"


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
    """Rank the entrants of several tasks with the same ones, over the cases of these together.

    The loss in a case is the median over its seeds, since repeated trials of one case are no
    independent data sets.
    """
    groups, ranks = defaultdict[frozenset[str], list[Board]](list), []
    for board in boards:
        if len(board.entries):
            groups[frozenset(board.losses) - {AT_REST}].append(board)
    for group in (group for group in groups.values() if len(group) > 1):
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
    references = [name for name in REFERENCES if name != AT_REST or task.score == "position"]
    own, trivial = list[dict[str, object]](), dict[tuple[str, int], list[dict[str, object]]]()
    for cell in cells(task, entrants, stored=True):
        row = newest.get(_normal(cell.options))
        if row is None:
            continue
        place = {**cell._asdict(), "run": row.id, "status": row.status, "error": row.error or ""}
        place |= {"duration_s": 0.0, "training_s": 0.0}
        lost: dict[str, object] = {"score": None, "judged": None, "after": {}, "loss": math.inf}
        end, lost["training_s"] = row.finished_at, training_s.get(row.id, math.nan)
        lost["duration_s"] = (end - row.started_at).total_seconds() if end else math.nan
        own.append(place | lost)
        if row.status == FINISHED:
            series = results.reader.series(row.id, "prediction")
            own[-1] |= _scores(series, "identified", task)
            if (cell.case, cell.seed) not in trivial:
                trivial[cell.case, cell.seed] = [
                    place | {"entrant": name} | _scores(series, name, task) for name in references
                ]
    rows = [*own, *(row for of_cell in trivial.values() for row in of_cell)]
    frame = pd.DataFrame(rows, columns=[*ENTRY], dtype=object)
    return frame.astype(dict.fromkeys(("duration_s", "training_s", "loss"), "float64"))


def _scores(series: Series, model: str, task: Task) -> dict[str, object]:
    """Return the score of the free run, the one that the task ranks by, and the other errors."""
    judged = free_run = scores.score(series, model, task.outputs)
    if task.score != "free_run":
        outputs = POSITION if task.score == "position" else task.outputs
        judged = scores.score(series, model, outputs, task.after_s)
    sound = math.isfinite(free_run.loss)
    after = {s: scores.score(series, model, task.outputs, s).loss for s in task.horizons_s if sound}
    return {"score": free_run, "judged": judged, "after": after, "loss": judged.loss}


def _normal(options: Iterable[str]) -> tuple[str, ...]:
    """Return the options that decide the results, in one spelling and order."""
    kept = (PATH.sub(r"\1", text) for text in options if not text.startswith(NO_RESULT))
    return tuple(sorted(SPELLING.sub("", text) for text in kept))


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
    best, cells = board.rivals(), ranked.cases
    rows = [_columns(board, name, name in best and not board.lost(name)) for name in ranked.order()]
    notes = [
        f"{cells} cell{'s'[: cells != 1]} that all entrants have run; rank: mean over them, 1 is"
        " best; FIT, NRMSE, band and CRPS: of the cells that did not diverge"
    ]
    return TextTable(task.title, [*rows[0]], [[*r.values()] for r in rows], notes=[*notes, BOLD])


def _columns(board: Board, name: str, best: bool = False) -> dict[str, TableCell]:
    """Return the row of an entrant, by its headers."""
    task, own, good = board.task, board.of(name), board.scores(name, "score")
    fits = 100.0 * (1.0 - scores.pooled(good)) if good else np.full(len(task.outputs), np.nan)
    row = {
        "entrant": TableCell(name, bold=best),
        "rank": _number(board.ranked.mean_ranks.get(name, math.nan), 3, best),
        "FIT [%]": _number(float(np.mean(fits)), 3, best), "90 %": TableCell(board.interval(name)),
    }  # fmt: skip
    row |= {f"{dof} FIT": _number(f, 3) for dof, f in zip(task.outputs, fits, strict=True)}
    for s in task.horizons_s:
        row[f"NRMSE {s:g} s"] = _number(_mean([after[s] for after in own["after"] if after]), 2)
    if task.score != "free_run":
        row[board.score_name] = _number(board.score(name), 3)
    covered = _mean(*(one.covered for one in good if one.deviations is not None))
    row[f"in {100.0 * scores.BAND_LEVEL:.0f} % band [%]"] = _number(100.0 * covered, 3)
    row["CRPS"] = _number(_mean(*(one.crps for one in good)), 2)
    row["diverged"] = TableCell(f"{board.lost(name)} of {len(own)}")
    row["training [s]"] = _number(_mean(own["training_s"]), 2)
    return row


def _number(value: float, digits: int, bold: bool = False) -> TableCell:
    """A cell of a number; a dash for one that is not known."""
    if math.isnan(value):
        return TableCell("–", bold=bold)
    rounded = 0.0 if abs(value) < 1e-6 else value  # a FIT of the mean motion is 0 but for rounding
    return TableCell(number_text(rounded, digits), bold, rounded)


def _mean(*parts: Any) -> float:
    """The mean of the finite numbers of all parts, of any shapes; NaN without any."""
    numbers = np.concatenate([[], *(np.ravel(np.asarray(part, np.float64)) for part in parts)])
    known = numbers[np.isfinite(numbers)]
    return float(np.mean(known)) if known.size else math.nan


def summary(boards: Sequence[Board]) -> TextTable:
    """Return one line for each task that has been run: the first entrant, and what others reach."""
    rows = []
    for board in (board for board in boards if len(board.entries)):
        first, *others = board.rivals()
        own_score = "" if board.task.score == "free_run" else f": {board.score_name}"
        means = board.losses.mean()
        trivial = [name for name in means.index if name in (*REFERENCES, "none")]
        skilled = first not in trivial and (means[first] < means[trivial]).all()
        skill = "" if skilled else " (no skill)"
        rows.append([
            TableCell(f"{board.task.title}{own_score}"),
            TableCell(str(board.contest.cases)),
            TableCell(f"{first}{skill}"),
            _counted(board, first, False),
            TableCell(board.interval(first)),
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
    cell, lost = _number(board.score(name), 3), board.lost(name)
    own = len(board.of(name))
    text = f"{cell.text} ({own - lost} of {own})" if lost else cell.text
    return TableCell(text, rival and not lost, cell.sort)
