"""Boards of the benchmark: the entries of a task and their ranks, and the ranks over all tasks.

The newest run of a cell counts. Cells without a run are not ranked; a task is ranked over the cells
that all its entrants have run.
"""

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from seatrial.runner import search_path
from seatrial.runner.compare.benchmark.cells import cells, entrants_of
from seatrial.runner.compare.benchmark.entries import REFERENCES, BenchmarkRun, entries, references
from seatrial.runner.compare.benchmark.scores import AT_REST, chance
from seatrial.runner.compare.benchmark.task import GROUP, Task, task_of
from seatrial.runner.compare.frame import Queries
from seatrial.runner.compare.ranking import SIGNIFICANCE, Ranking, ranking
from seatrial.runner.compare.statistics import Sample, holm


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

        Where there are too few cells for tests of ranks, by a paired bootstrap of the errors, in
        which an entrant that lost a cell differs from one that did not.
        """
        if self.contest.tested:
            return self.contest.best()
        first, *others = self.contest.order()
        own = {name: {_key(e): e for e in self.of(name)} for name in (first, *others)}
        common = [key for key in own[first] if all(key in entries for entries in own.values())]
        values = holm([_chance([(own[first][key], own[n][key]) for key in common]) for n in others])
        return [first, *(n for n, p in zip(others, values, strict=True) if p >= SIGNIFICANCE)]

    def lost(self, entrant: str) -> int:
        """Number of the cells of an entrant that failed or diverged."""
        return sum(math.isinf(entry.loss) for entry in self.of(entrant))

    def has_skill(self, entrant: str) -> bool:
        """Whether an entrant identifies something, and is better than every trivial rival."""
        trivial = [name for name in self.ranked.names if name in (*REFERENCES, "none")]
        return entrant not in trivial and all(
            self.mean_loss(entrant) < self.mean_loss(name) for name in trivial
        )

    def mean_loss(self, entrant: str) -> float:
        """Mean loss over the cells that all entrants have run."""
        return float(np.mean(self.ranked.losses[:, self.ranked.names.index(entrant)]))

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


def _chance(pairs: Sequence[tuple[BenchmarkRun, BenchmarkRun]]) -> float:
    """Return the p-value of equal losses of two entrants in the same cells."""
    if any(math.isinf(one.loss) for pair in pairs for one in pair):
        both = all(math.isinf(first.loss) == math.isinf(other.loss) for first, other in pairs)
        return float(both)
    first, other = zip(*((a.judged, b.judged) for a, b in pairs), strict=True)
    return chance(first, other)


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
    return [(group, _ranked(group)) for group in groups.values() if len(group) > 1]


def _ranked(group: Sequence[Board]) -> Ranked:
    names = [name for name in group[0].ranked.names if name != AT_REST]
    rows = []
    for board in group:
        for case in board.task.cases:
            seeds: dict[str, list[float]] = defaultdict(list)
            for entry in board.entries:
                if entry.cell.case == case:
                    seeds[entry.cell.entrant].append(entry.loss)
            rows.append({name: float(np.median(values)) for name, values in seeds.items()})
    return Ranked(names, _table(names, rows))


def _table(names: Sequence[str], rows: Iterable[Mapping[str, float]]) -> Sample:
    """Losses (n_rows, n_names) of the rows that have all names."""
    whole = [[row[name] for name in names] for row in rows if all(name in row for name in names)]
    return np.array(whole, dtype=np.float64).reshape(len(whole), len(names))
