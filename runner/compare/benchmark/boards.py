"""Boards of the benchmark: what entrants reached in the cells of a task, and their ranks.

The newest run of a cell counts; one that failed or diverged, and one whose model cannot predict,
has an infinite loss. Cells without a run are not ranked; a task is ranked over the cells that all
its entrants have run.
"""

import math
import re
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import pandas as pd
import sqlalchemy as sa

from seatrial.runner.compare.benchmark.scores import (
    AT_REST,
    POSITION,
    REFERENCES,
    Score,
    chance,
    score,
)
from seatrial.runner.compare.benchmark.task import GROUP, Task, cells, task_of
from seatrial.runner.compare.frame import FINISHED, Queries
from seatrial.runner.compare.ranking import SIGNIFICANCE, Ranking, ranking
from seatrial.runner.compare.statistics import holm
from seatrial.runner.configuration import search_path
from seatrial.runner.database.tables import DiagnosticRow
from seatrial.runner.database.tables import RunRow as RunTable
from seatrial.runner.record.rows import Series
from seatrial.runner.record.vocabulary import ENDINGS, NO_RESULT, TRAINING_TIME

SPELLING = re.compile(r"[\s'\"]+")
CELL = ["task", "case", "seed"]  # what is the same for all entrants of a cell
ENTRY = (
    *(*CELL, "entrant", "run", "status", "error", "duration_s", "training_s"),
    *("score", "judged", "after", "loss"),
)


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
        return [each for each in self.of(entrant)[kind] if each and math.isfinite(each.loss)]

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
    references = [name for name in REFERENCES if name != AT_REST or task.score == "position"]
    own: list[dict[str, object]] = []
    trivial: dict[tuple[str, int], list[dict[str, object]]] = {}
    for cell in cells(task, entrants):
        row = newest.get(_normal(cell.options))
        if row is None:
            continue
        place = {**cell._asdict(), "run": row.id, "status": row.status, "error": row.error or ""}
        place |= {"duration_s": 0.0, "training_s": 0.0}
        own.append(place | {"score": None, "judged": None, "after": {}, "loss": math.inf})
        end = row.finished_at
        own[-1]["duration_s"] = (end - row.started_at).total_seconds() if end else math.nan
        own[-1]["training_s"] = training_s.get(row.id, math.nan)
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
    judged = free_run = score(series, model, task.outputs)
    if task.score != "free_run":
        outputs = POSITION if task.score == "position" else task.outputs
        judged = score(series, model, outputs, task.after_s)
    sound = math.isfinite(free_run.loss)
    after = {s: score(series, model, task.outputs, s).loss for s in task.horizons_s if sound}
    return {"score": free_run, "judged": judged, "after": after, "loss": judged.loss}


def _normal(options: Iterable[str]) -> tuple[str, ...]:
    """Return the options that decide the results, in one spelling and order."""
    return tuple(
        sorted(SPELLING.sub("", text) for text in options if not text.startswith(NO_RESULT))
    )
