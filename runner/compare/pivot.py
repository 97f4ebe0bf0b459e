"""From observations to the cells of a table: grouping, counting, the best, the paired baseline."""

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from seatrial.runner.compare.results import FINISHED, OWN_FACTORS, Observation, Run, ordered
from seatrial.runner.compare.statistics import SAME, PairedTest, Sample, paired_test
from seatrial.runner.record.catalogue import definition_of
from seatrial.runner.vocabulary import DOF_ORDER, GROUPS, MODELS

Key = tuple[str, ...]
# Figures from different ones of these are no rivals.
CIRCUMSTANCES = (
    *("metric", "stage", "dof"),
    *("vessel", "plant", "disturbance", "excitation", "evaluation", "seed"),
)


@dataclass(frozen=True)
class Cell:
    """What a cell holds.

    `observed` have a finite value; `unfinished` counts the runs of this cell by status, `without`
    those that finished without this number; `flagged` how many fit lag or feedback instead of the
    vessel (below the true model).
    """

    observed: Sequence[Observation] = ()
    unfinished: Mapping[str, int] = field(default_factory=dict)
    without: int = 0
    flagged: int = 0

    @property
    def sample(self) -> Sample:
        """The values, shape (n,)."""
        return np.array([o.value for o in self.observed], dtype=np.float64)


@dataclass(frozen=True)
class Pivot:
    """Cells by row key and column key; a key has one level for each of its factors."""

    row_factors: Key
    column_factors: Key
    row_keys: Sequence[Key]
    column_keys: Sequence[Key]
    cells: Mapping[tuple[Key, Key], Cell]

    def cell(self, row: Key, column: Key) -> Cell:
        """The cell, empty where no run belongs to it."""
        return self.cells.get((row, column), Cell())

    def level(self, row: Key, column: Key, factor: str) -> str | None:
        """The level of a factor in a cell, None where the table does not go by it."""
        levels = dict(zip((*self.row_factors, *self.column_factors), row + column, strict=True))
        return levels.get(factor)


def pivot(
    observations: Sequence[Observation],
    runs: Sequence[Run],
    row_factors: Key,
    column_factors: Key,
    flagged: frozenset[tuple[int, str]] = frozenset(),
    name_order: Sequence[str] = (),
) -> Pivot:
    """Groups observations of `runs` by the levels of the factors.

    `runs` are all that belong to the table, finished or not; `flagged` holds (run id, dof) of
    those below the true model; `name_order` is the order that metrics were asked for in.
    """
    grouped: dict[tuple[Key, Key], list[Observation]] = defaultdict(list)
    for one in observations:
        grouped[_key(one, row_factors), _key(one, column_factors)].append(one)
    keys = _with_unobserved(set(grouped), runs, row_factors, column_factors)
    by_run_part = _runs_by_part(runs, (*row_factors, *column_factors))
    cells = {}
    for row, column in keys:
        part = _run_part(row + column, (*row_factors, *column_factors))
        members = by_run_part.get(part, [])
        cells[row, column] = _cell(grouped.get((row, column), []), members, flagged)
    order = _KeyOrder(name_order)
    rows = order.sort((row for row, _ in keys), row_factors)
    columns = order.sort((column for _, column in keys), column_factors)
    return Pivot(row_factors, column_factors, rows, columns, cells)


def _cell(
    found: Sequence[Observation], runs: Sequence[Run], flagged: frozenset[tuple[int, str]]
) -> Cell:
    good = [o for o in found if o.value is not None and np.isfinite(o.value)]
    seen = {o.run.id for o in good}
    unfinished = Counter(run.status for run in runs if run.status != FINISHED)
    without = sum(run.status == FINISHED and run.id not in seen for run in runs)
    marked = {o.run.id for o in good if is_flagged(o, flagged)}
    return Cell(good, dict(unfinished), without, len(marked))


def is_flagged(one: Observation, flagged: frozenset[tuple[int, str]]) -> bool:
    """Whether this number is a validation force error below the true model's."""
    return (
        one.stage == "validation"
        and one.model == "identified"
        and one.name.startswith("force_")
        and (one.run.id, one.dof) in flagged
    )


def _key(one: Observation, factors: Key) -> Key:
    return tuple(one.level(factor) for factor in factors)


def _run_part(key: Key, factors: Key) -> Key:
    return tuple(
        level for level, factor in zip(key, factors, strict=True) if factor not in OWN_FACTORS
    )


def _runs_by_part(runs: Sequence[Run], factors: Key) -> Mapping[Key, list[Run]]:
    found: dict[Key, list[Run]] = defaultdict(list)
    for run in runs:
        found[tuple(run.levels[f] for f in factors if f not in OWN_FACTORS)].append(run)
    return found


def _with_unobserved(
    observed: set[tuple[Key, Key]], runs: Sequence[Run], row_factors: Key, column_factors: Key
) -> set[tuple[Key, Key]]:
    """Adds the cells of runs that left no number, so that a failure keeps its row and column."""
    factors = (*row_factors, *column_factors)
    own_positions = [i for i, factor in enumerate(factors) if factor in OWN_FACTORS]
    own_parts = {tuple((row + column)[i] for i in own_positions) for row, column in observed}
    seen = {_run_part(row + column, factors) for row, column in observed}
    keys = set(observed)
    for part in set(_runs_by_part(runs, factors)) - seen:
        for own in own_parts or {("",) * len(own_positions)}:
            levels = list(part)
            for position, level in zip(own_positions, own, strict=True):
                levels.insert(position, level)
            split = len(row_factors)
            keys.add((tuple(levels[:split]), tuple(levels[split:])))
    return keys


class _KeyOrder:
    """Reading order of keys: metrics as asked, DOFs and models as in the field, the rest sorted."""

    def __init__(self, name_order: Sequence[str]) -> None:
        self.fixed = {"metric": tuple(name_order), "dof": DOF_ORDER, "model": MODELS}

    def sort(self, keys: Iterable[Key], factors: Key) -> list[Key]:
        distinct = set(keys)
        ranks = []
        for position, factor in enumerate(factors):
            levels = ordered(key[position] for key in distinct)
            first = [level for level in self.fixed.get(factor, ()) if level in levels]
            rest = [level for level in levels if level not in first]
            ranks.append({level: rank for rank, level in enumerate([*first, *rest])})
        return sorted(distinct, key=lambda key: [r[v] for r, v in zip(ranks, key, strict=True)])


def best_cells(table: Pivot, loss: Mapping[tuple[Key, Key], float]) -> set[tuple[Key, Key]]:
    """The cells to set in bold: the best among those that compete under equal circumstances.

    `loss` gives the figure that cells are compared by, the smaller the better, NaN for a cell that
    is not judged. Cells below the true model take no part: what they fit is not the vessel.
    """
    groups: dict[Key, list[tuple[Key, Key]]] = defaultdict(list)
    factors = (*table.row_factors, *table.column_factors)
    apart = [i for i, factor in enumerate(factors) if factor.partition(".")[0] in CIRCUMSTANCES]
    for row, column in table.cells:
        groups[tuple((row + column)[i] for i in apart)].append((row, column))
    best = set()
    for members in groups.values():
        able = [key for key in members if np.isfinite(loss[key])]
        able = [key for key in able if not table.cells[key].flagged]
        if len(members) > 1 and able:
            top = min(loss[key] for key in able)
            best |= {key for key in able if abs(loss[key] - top) <= SAME * abs(top)}
    return best


def against_baseline(
    table: Pivot, observations: Sequence[Observation], factor: str, level: str
) -> dict[tuple[Key, Key], PairedTest]:
    """Each cell against the runs where `factor` is `level`, all else and the seed being equal.

    Cells of the baseline itself are left out. Several trials of one cell that share seed and
    choices count as one pair, by their mean.
    """
    factors = (*GROUPS, "seed", *OWN_FACTORS, *table.row_factors, *table.column_factors)
    kept = tuple(dict.fromkeys(f for f in factors if not f"{f}.".startswith(f"{factor}.")))
    reference = _means(
        (o for o in observations if o.level(factor) == level and o.value is not None), kept
    )
    tests = {}
    for (row, column), cell in table.cells.items():
        own = [o for o in cell.observed if o.level(factor) != level]
        if own:
            values = _means(own, kept)
            shared = sorted(values.keys() & reference.keys())
            better = definition_of(own[0].name).better
            left = np.array([values[key] for key in shared], dtype=np.float64)
            right = np.array([reference[key] for key in shared], dtype=np.float64)
            tests[row, column] = paired_test(left, right, better)
    return tests


def _means(observations: Iterable[Observation], factors: Key) -> dict[Key, float]:
    grouped: dict[Key, list[float]] = defaultdict(list)
    for one in observations:
        if one.value is not None and np.isfinite(one.value):
            grouped[_key(one, factors)].append(one.value)
    return {key: float(np.mean(values)) for key, values in grouped.items()}
