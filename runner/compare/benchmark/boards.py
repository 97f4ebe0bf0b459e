"""Boards of the benchmark: the entries of a task and their ranks, and the ranks over all tasks.

The newest run of a cell counts. Cells without a run are not ranked; a task is ranked over the cells
that all its entrants have run.
"""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from seatrial.runner import search_path
from seatrial.runner.compare.benchmark.cells import cells, entrants_of
from seatrial.runner.compare.benchmark.entries import REFERENCES, BenchmarkRun, entries, references
from seatrial.runner.compare.benchmark.scores import chance
from seatrial.runner.compare.benchmark.task import GROUP, Task, task_of
from seatrial.runner.compare.ranking import SIGNIFICANCE, Ranking, holm, ranking
from seatrial.runner.compare.results import Queries
from seatrial.runner.compare.statistics import Sample


@dataclass(frozen=True, eq=False)
class Ranked:
    """Entrants, their losses (n_cases, n_entrants), and their ranks; None without a case."""

    names: list[str]
    losses: Sample

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
    def ranked(self) -> Ranked:
        """The ranks over the cells that all entrants have run."""
        return Ranked(*losses(self.entries))

    @cached_property
    def contest(self) -> Ranked:
        """The ranks without the references, which know what is tested on."""
        names = [name for name in self.ranked.names if name not in REFERENCES]
        return Ranked(names, self.ranked.losses[:, [self.ranked.names.index(n) for n in names]])

    def rivals(self) -> list[str]:
        """The first entrant of the contest, and those not significantly worse, in order.

        Where there are too few cells for tests of ranks, by a paired bootstrap of the errors.
        """
        if self.contest.tested:
            return self.contest.best()
        first, *others = self.contest.order()
        own = {name: {_key(e): e for e in self.of(name)} for name in (first, *others)}
        common = [key for key in own[first] if all(key in entries for entries in own.values())]
        scored = {
            name: [score for key in common if (score := entries[key].judged)]
            for name, entries in own.items()
        }
        values = holm([chance(scored[first], scored[name]) for name in others])
        return [first, *(n for n, p in zip(others, values, strict=True) if not p < SIGNIFICANCE)]

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


def _key(entry: BenchmarkRun) -> tuple[str, str, int]:
    """What is the same for all entrants of a cell."""
    return entry.cell.task, entry.cell.case, entry.cell.seed


def losses(own: Sequence[BenchmarkRun]) -> tuple[list[str], Sample]:
    """Return entrants, and their losses (n_cases, n_entrants) in the cells that all have run."""
    names = list(dict.fromkeys(entry.cell.entrant for entry in own))
    by_cell: dict[tuple[str, str, int], dict[str, float]] = defaultdict(dict)
    for entry in own:
        by_cell[_key(entry)][entry.cell.entrant] = entry.loss
    return names, _table(names, by_cell.values())


def overall(boards: Sequence[Board]) -> Ranked:
    """Rank the entrants that all tasks have over the cases of all; the seeds of one count once.

    The loss in a case is the median over its seeds, since repeated trials of one case are no
    independent data sets. Tasks that have not been run are left out.
    """
    run = [board for board in boards if board.entries]
    names = list(dict.fromkeys(name for board in run for name in board.ranked.names))
    names = [name for name in names if all(name in board.ranked.names for board in run)]
    rows = []
    for board in run:
        for case in board.task.cases:
            of_case = [entry for entry in board.entries if entry.cell.case == case]
            seeds: dict[str, list[float]] = defaultdict(list)
            for entry in of_case:
                seeds[entry.cell.entrant].append(entry.loss)
            rows.append({name: float(np.median(values)) for name, values in seeds.items()})
    return Ranked(names, _table(names, rows))


def _table(names: Sequence[str], rows: Iterable[Mapping[str, float]]) -> Sample:
    """Losses (n_rows, n_names) of the rows that have all names."""
    whole = [[row[name] for name in names] for row in rows if all(name in row for name in names)]
    return np.array(whole, dtype=np.float64).reshape(len(whole), len(names))
