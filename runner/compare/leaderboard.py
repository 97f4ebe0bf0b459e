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

from seatrial.runner.compare import benchmark
from seatrial.runner.compare.benchmark import AT_REST, POSITION, REFERENCES, Task
from seatrial.runner.compare.frame import FINISHED, Queries
from seatrial.runner.compare.grid import TableCell, TextTable, number_text
from seatrial.runner.compare.statistics import BOLD_NOTE, equal, holm, least, loss
from seatrial.runner.configuration import search_path
from seatrial.runner.configuration.invocation import trial_program
from seatrial.runner.database.tables import RunRow
from seatrial.runner.record.catalogue import Definition, definition_of
from seatrial.runner.record.rows import Series
from seatrial.runner.record.vocabulary import ENDINGS, NO_RESULT, TRAINING_TIME

SIGNIFICANCE = 0.05
SPELLING = re.compile(r"[\s'\"]+")
# A path in an option, of which the last folder and the name count: another checkout, or another
# folder of outside data, has the same runs.
PATH = re.compile(r'(?:/[^/",\]]+)*/([^/",\]]+/[^/",\]]+)(?=[",\]]|$)')
CELL = ["task", "case", "seed"]  # what is the same for all entrants of a cell
LOST: dict[str, Any] = dict.fromkeys(("score", "free_run"), benchmark.NOTHING)
LOST |= {"after": {}, "loss": math.inf}
ENTRY = [*CELL, "entrant", "run", "status", "error", "duration_s", "training_s", *LOST]
COMPARED = ("auto", "none", *REFERENCES)  # entrants that the summary shows beside the first one
SUMMARY = ("task", "cells", "first", "score", "90 %", "not significantly worse", *COMPARED)
BOLD = f"{BOLD_NOTE}; mean_motion, persistence and at_rest are left out"
RIVALS = (
    "not significantly worse than the first: by ranks, or where there are too few cells by a paired"
    " bootstrap of the errors"
)
NO_SKILL = "no skill: none, or a trivial rival, is at least as good as the first entrant"


def ranking(losses: pd.DataFrame, resolution: Any = 0.0) -> pd.DataFrame:
    """Rank entrants within each case (n_cases, n_entrants), the best in the mean first: 1 is best.

    Losses that are equal within the resolution, one or one for each case, share the mean of their
    ranks. Raises ValueError for NaN.
    """
    if losses.isna().to_numpy().any():
        raise ValueError("losses: got NaN, expected numbers; inf for an entrant without a result")
    ranks = losses.astype(float)
    for case, within in enumerate(np.broadcast_to(resolution, len(losses))):
        row = losses.iloc[case].to_numpy()
        order = np.argsort(row, kind="stable")
        apart = ~equal(row[order][1:], row[order][:-1], within)
        ranks.iloc[case, order] = scipy.stats.rankdata(np.concatenate([[0], np.cumsum(apart)]))
    return ranks[ranks.mean().sort_values(kind="stable").index]


def alike(ranks: pd.DataFrame) -> pd.DataFrame:
    """Say of every pair (n, n) whether it does not differ significantly, after Holm's correction.

    By the two-sided signed-rank test of Wilcoxon on the ranks within a case, since losses of
    different cases have different scales.
    """
    pairs, p_values = list(combinations(ranks, 2)), list[float]()
    for one, other in pairs:
        gain = ranks[one] - ranks[other]  # p is 1 of entrants that are equal in every case
        test = scipy.stats.wilcoxon(gain, zero_method="zsplit") if gain.any() else None
        p_values.append(test.pvalue if test else 1.0)
    same = pd.DataFrame(True, ranks.columns, ranks.columns)
    for (one, other), p_value in zip(pairs, holm(p_values), strict=True):
        same.loc[one, other] = same.loc[other, one] = p_value >= SIGNIFICANCE
    return same


def groups(same: pd.DataFrame) -> list[list[str]]:
    """Return the largest runs of neighbours of which every pair (n, n) is the same."""
    parts = [[*same.index[first:end]] for first, end in combinations(range(len(same) + 1), 2)]
    parts = [own for own in parts if len(own) > 1 and same.loc[own, own].all(axis=None)]
    return [own for own in parts if not any({*own} < {*other} for other in parts)]


def critical_difference(entrants: int, cases: int, level: float = SIGNIFICANCE) -> float:
    """Difference of mean ranks that is significant by Nemenyi's test, a more cautious one.

    q sqrt(k (k + 1) / (6 N)) of k entrants in N cases, with q the quantile of the Studentized range
    over sqrt(2). Demsar (2006), section 3.2.2.
    """
    quantile = scipy.stats.studentized_range.ppf(1.0 - level, entrants, np.inf) / math.sqrt(2.0)
    return float(quantile * math.sqrt(entrants * (entrants + 1) / (6.0 * cases)))


@dataclass(frozen=True, eq=False)
class Board:
    """A task with the cells that have been run, references included: a row of `entries` each.

    Columns are those of ENTRY: times in seconds, NaN if they are not stored; the score that ranks,
    and that of the free run; the NRMSE by horizon [s] (`after`); the loss, inf for a run that
    failed or diverged.
    """

    task: Task
    entries: pd.DataFrame

    @cached_property
    def losses(self) -> pd.DataFrame:
        """Losses of the cells that all entrants have run, shape (n_cells, n_entrants)."""
        return losses_of(self.entries, CELL)

    @cached_property
    def ranked(self) -> pd.DataFrame:
        """The ranks over these cells."""
        return ranking(self.losses, self.resolution)

    @cached_property
    def contest(self) -> pd.DataFrame:
        """The ranks without the references, which know what is tested on."""
        return ranking(self.losses.drop(columns=[*REFERENCES], errors="ignore"), self.resolution)

    @property
    def score(self) -> str:
        """What the task ranks by, with its unit: a column of `standings`."""
        after = "" if self.task.score == "free_run" else f" after {self.task.horizons_s[-1]:g} s"
        return f"position error{after} [m]" if self.task.score == "position" else f"FIT{after} [%]"

    @property
    def metric(self) -> Definition:
        """The metric of the catalogue that has the direction and the resolution of the score."""
        position = self.task.score == "position"
        return definition_of("pose_rmse_restarts" if position else "velocity_fit_restarts")

    @property
    def resolution(self) -> float:
        """Losses that differ by less are equal; that of an NRMSE is a hundredth of that of FIT."""
        return self.metric.resolution / (1.0 if self.task.score == "position" else 100.0)

    @cached_property
    def best(self) -> pd.DataFrame:
        """Where the `rank` and the score of an entrant are the best, of those that lost no cell."""
        own = self.entries.groupby("entrant")["loss"]
        whole = (own.size() == own.size().max()) & np.isfinite(own.max())
        shown = self.standings[["rank", self.score]].astype(float)
        shown[~whole.loc[shown.index] | shown.index.isin(REFERENCES)] = math.nan
        shown[self.score] = loss(shown[self.score].to_numpy(), self.metric.better)
        within = {"rank": 0.0, self.score: self.metric.resolution}
        return shown.apply(lambda own: least(own, np.zeros(len(own)), within[str(own.name)]))

    @cached_property
    def rivals(self) -> list[str]:
        """The first entrant of the contest, and those not significantly worse, in order.

        Where there are too few cells to tell any by their ranks, after Holm's correction, by a
        paired bootstrap of the errors, in which who lost a cell differs from who did not. Who lost
        every cell is no rival, not even of another one.
        """
        (first, *others), cases = self.contest, len(self.contest)
        scored = np.isfinite(self.losses).any()
        if 0.5 ** (cases - 1) * math.comb(1 + len(others), 2) < SIGNIFICANCE:
            same = alike(self.contest)
            return [first, *(name for name in others if same.loc[first, name] and scored[name])]
        cells = self.entries.pivot(index=CELL, columns="entrant", values="score")
        cells = cells.loc[self.losses.index]
        values = holm([benchmark.chance([*cells[first]], [*cells[name]]) for name in others])
        each = zip(others, values, strict=True)
        return [first, *(name for name, p in each if p >= SIGNIFICANCE and scored[name])]

    @cached_property
    def standings(self) -> pd.DataFrame:
        """What each entrant has reached, the best mean rank first; NaN where nothing is known.

        FIT is pooled over the cells, with its 90 % interval; after each horizon stands the mean
        NRMSE of the predictions over it. `in 90 % band` is the share of the outputs of the free run
        that were measured in the band.
        """
        rows, unknown = {}, np.full(len(self.task.outputs), math.nan)
        for name, own in self.entries.groupby("entrant"):
            good = own.loc[np.isfinite(own["loss"]), "score"].tolist()
            row = {"rank": self.ranked[name].mean(), self.score: _mean(own["loss"])}
            if self.task.score != "position":
                fits = 100.0 - 100.0 * (benchmark.pooled(good) if good else unknown)
                row |= {self.score: np.mean(fits), "90 %": "–"}
                row |= dict(zip((f"{dof} FIT" for dof in self.task.outputs), fits, strict=True))
                if good:
                    high, low = 100.0 - 100.0 * benchmark.interval(good)
                    row["90 %"] = f"{low:.0f} to {high:.0f}"
            for s in self.task.horizons_s:
                row[f"NRMSE {s:g} s"] = _mean(*(after[s] for after in own["after"] if after))
            free = [each for each in own["free_run"] if math.isfinite(each.loss)]
            rows[name] = row | {
                "in 90 % band [%]": 100.0 * _mean(*(each.covered for each in free)),
                "CRPS": _mean(*(each.crps for each in free)),
                "diverged": f"{np.isinf(own['loss']).sum()} of {len(own)}",
                "training [s]": _mean(own["training_s"]),
            }
        return pd.DataFrame.from_dict(rows, orient="index").loc[self.ranked.columns]


def _mean(*parts: Any) -> float:
    """The mean of the finite numbers of all parts, of any shapes; NaN without any."""
    numbers = np.concatenate([[], *(np.ravel(np.asarray(part, np.float64)) for part in parts)])
    known = numbers[np.isfinite(numbers)]
    return float(np.mean(known)) if known.size else math.nan


def losses_of(entries: pd.DataFrame, cell: Sequence[str]) -> pd.DataFrame:
    """Median losses by entrant (n_cells, n_entrants), of the cells that all entrants have run."""
    losses = entries.groupby([*cell, "entrant"], sort=False)["loss"].median().unstack()
    return losses[entries["entrant"].unique()].dropna()


def boards(
    results: Queries, tasks: Sequence[str] = (), entrants: Sequence[str] = ()
) -> list[Board]:
    """Return the boards of the named tasks, by default all, with further entrants."""
    run = RunRow
    query = sa.select(run.id.label("run"), run.overrides, run.status, run.error, run.duration_s)
    rows = results.reader.select(query.where(run.status.in_(ENDINGS)).order_by(run.id))
    newest = {_normal(row.overrides): row for row in rows}
    named = map(benchmark.task_of, tasks or search_path.options(benchmark.GROUP))
    return [Board(task, _entries(results, task, entrants, newest)) for task in named]


def _entries(
    results: Queries, task: Task, entrants: Sequence[str], newest: Mapping[tuple[str, ...], Any]
) -> pd.DataFrame:
    """Return the cells that have been run, each with its newest run, and then the trivial rivals.

    These have the cells in which some entrant has a prediction; one at rest has a position only.
    """
    spent = results.diagnostics([TRAINING_TIME]).set_index("run")["value"]
    own, trivial = list[dict[str, Any]](), dict[tuple[str, int, str], dict[str, Any]]()
    for cell in benchmark.cells(task, [*task.entrants, *entrants]):
        row = newest.get(_normal(cell.options))
        if row is None:
            continue
        own.append(cell._asdict() | row._asdict() | LOST | {"training_s": spent.get(row.run)})
        kinds = {file.kind for file in results.reader.series_files(row.run)}
        if row.status != FINISHED or "prediction" not in kinds:
            continue
        series = results.reader.series(row.run, "prediction")
        own[-1] |= _scores(series, "identified", task)
        for name in REFERENCES if task.score == "position" else REFERENCES[:-1]:
            if (cell.case, cell.seed, name) not in trivial:
                entry = own[-1] | {"entrant": name, "duration_s": 0.0, "training_s": 0.0}
                trivial[cell.case, cell.seed, name] = entry | _scores(series, name, task)
    frame = pd.DataFrame([*own, *trivial.values()], columns=ENTRY, dtype=object)
    return frame.astype(dict.fromkeys(("duration_s", "training_s", "loss"), "float64"))


def _scores(series: Series, model: str, task: Task) -> dict[str, Any]:
    """Return the score that the task ranks by, and the errors over other times."""
    score = free_run = benchmark.score(series, model, task.outputs)
    if task.score != "free_run":
        outputs = POSITION if task.score == "position" else task.outputs
        score = benchmark.score(series, model, outputs, task.horizons_s[-1])
    ahead = task.horizons_s if math.isfinite(score.loss) else ()
    after = {s: benchmark.score(series, model, task.outputs, s).loss for s in ahead}
    return {"score": score, "free_run": free_run, "after": after, "loss": score.loss}


def _normal(options: Iterable[str]) -> tuple[str, ...]:
    """Return the options that decide the results, in one spelling and order."""
    kept = (PATH.sub(r"\1", text) for text in options if not text.startswith(NO_RESULT))
    return tuple(sorted(SPELLING.sub("", text) for text in kept))


def overall(boards: Sequence[Board]) -> list[tuple[list[Board], pd.DataFrame]]:
    """Rank the entrants of several tasks with the same ones, over the cases of these together.

    The loss in a case is the median over its seeds, since repeated trials of one case are no
    independent data sets.
    """
    groups, ranks = defaultdict[frozenset[str], list[Board]](list), []
    for board in (board for board in boards if len(board.entries)):
        groups[frozenset(board.losses) - {AT_REST}].append(board)
    for group in (group for group in groups.values() if len(group) > 1):
        entries = pd.concat([board.entries for board in group], ignore_index=True)
        losses = losses_of(entries[entries["entrant"] != AT_REST], ["task", "case"])
        resolution = {board.task.name: board.resolution for board in group}
        each = losses.index.get_level_values("task").map(resolution).to_numpy(np.float64)
        ranks.append((group, ranking(losses, each)))
    return ranks


def leaderboard(board: Board) -> TextTable:
    """Return the table of a task: its standings, the best rank and score in bold."""
    rows, cells = list[list[TableCell]](), len(board.ranked)
    for name, row in board.standings.iterrows():
        bold = board.best.loc[name]
        shown = (_cell(value, bool(bold.get(header, False))) for header, value in row.items())
        rows.append([TableCell(str(name)), *shown])
    notes = [
        f"{cells} cell{'s'[: cells != 1]} that all entrants have run; rank: mean over them, 1 is"
        " best; FIT, NRMSE, band, CRPS: of cells that did not diverge",
        BOLD,
    ]
    if not rows:
        notes = [f"no runs: {trial_program()} benchmark --task {board.task.name}"]
    return TextTable(board.task.title, ["entrant", *board.standings], rows, notes=notes)


def _cell(value: Any, bold: bool = False, more: str = "") -> TableCell:
    """A cell of a text or a number, and more; a dash for a number that is not known."""
    if isinstance(value, str) or math.isnan(value):
        return TableCell((value if isinstance(value, str) else "–") + more, bold)
    rounded = 0.0 if abs(value) < 1e-6 else float(value)  # FIT of the mean motion, but for rounding
    return TableCell(number_text(rounded, 3) + more, bold, rounded)


def summary(boards: Sequence[Board]) -> TextTable:
    """Return one line for each task that has been run: the first entrant, and what others reach."""
    rows = []
    for board in (board for board in boards if len(board.entries)):
        (first, *others), means = board.rivals, board.losses.mean()
        trivial = [name for name in means.index if name in (*REFERENCES, "none")]
        apart = ~equal(means[trivial].to_numpy(), means[first], board.resolution)
        skilled = first not in trivial and (apart & (means[first] < means[trivial])).all()
        told = "" if board.task.score == "free_run" else f": {board.score}"
        texts = [f"{board.task.title}{told}", str(len(board.contest))]
        texts.append(first if skilled else f"{first} (no skill)")
        rows.append([
            *map(TableCell, texts), _counted(board, first),
            _cell(board.standings.get("90 %", {}).get(first, math.nan)),
            TableCell(", ".join(others) or "–", prose=True),
            *(_counted(board, name) for name in COMPARED),
        ])  # fmt: skip
    notes = ["score: FIT [%] of the free runs, if the task names no other", f"{BOLD}; {RIVALS}"]
    notes += [NO_SKILL] if any("(no skill)" in row[2].text for row in rows) else []
    for group, ranks in overall(boards):
        order = ", ".join(f"{name} {rank:.1f}" for name, rank in ranks.mean().items())
        titles = "; ".join(board.task.title for board in group)
        notes.append(f"mean ranks over {len(ranks)} cases of {titles}: {order}")
    return TextTable("Benchmark", SUMMARY, rows, notes=notes)


def _counted(board: Board, name: str) -> TableCell:
    """The score of an entrant, with the number of the cells that it lost."""
    if name not in board.standings.index:
        return TableCell("–")
    score, diverged = board.standings.loc[name, [board.score, "diverged"]]
    lost = "" if diverged.startswith("0 ") else f" ({diverged} lost)"
    return _cell(score, bool(board.best.loc[name, board.score]), lost)
