"""Grouping of observations into the cells of a table, the best cells and the paired baseline."""

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from seatrial.runner.compare.results import FINISHED, OWN_FACTORS, Observation, Run, ordered
from seatrial.runner.compare.statistics import SAME, PairedTest, Sample, paired_test
from seatrial.runner.record.catalogue import definition_of
from seatrial.runner.vocabulary import DOF_ORDER, GROUPS, MODELS

Key = tuple[str, ...]
# Cells that differ in one of these factors are not compared with each other.
CIRCUMSTANCES = (
    *("metric", "stage", "dof"),
    *("vessel", "plant", "disturbance", "excitation", "evaluation", "seed"),
)


@dataclass(frozen=True)
class Cell:
    """The content of one cell.

    `observed` are the finite values; `unfinished` counts the unfinished runs by status, `without`
    the finished runs that lack this number, and `flagged` the runs below the true model, which fit
    lag or feedback instead of the vessel.
    """

    observed: Sequence[Observation] = ()
    unfinished: Mapping[str, int] = field(default_factory=dict)
    without: int = 0
    flagged: int = 0

    @property
    def sample(self) -> Sample:
        """The observed values, shape (n,)."""
        return np.array([o.value for o in self.observed], dtype=np.float64)


@dataclass(frozen=True)
class Pivot:
    """Cells by row key and column key; a key holds one level for each factor."""

    row_factors: Key
    column_factors: Key
    row_keys: Sequence[Key]
    column_keys: Sequence[Key]
    cells: Mapping[tuple[Key, Key], Cell]

    def cell(self, row: Key, column: Key) -> Cell:
        """Return the cell, which is empty if no run belongs to it."""
        return self.cells.get((row, column), Cell())

    def level(self, row: Key, column: Key, factor: str) -> str | None:
        """Return the level of a factor in a cell; None if it is no factor of the table."""
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
    """Group observations of `runs` by the levels of the factors.

    `runs` are all runs of the table, finished or not; `flagged` holds (run id, dof) of those below
    the true model; `name_order` is the order of the metrics in the request.
    """
    grouped: dict[tuple[Key, Key], list[Observation]] = defaultdict(list)
    for observation in observations:
        grouped[_key(observation, row_factors), _key(observation, column_factors)].append(
            observation
        )
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
    observations: Sequence[Observation], runs: Sequence[Run], flagged: frozenset[tuple[int, str]]
) -> Cell:
    finite = [o for o in observations if o.value is not None and np.isfinite(o.value)]
    run_ids = {o.run.id for o in finite}
    unfinished = Counter(run.status for run in runs if run.status != FINISHED)
    without = sum(run.status == FINISHED and run.id not in run_ids for run in runs)
    flagged_ids = {o.run.id for o in finite if is_flagged(o, flagged)}
    return Cell(finite, dict(unfinished), without, len(flagged_ids))


def is_flagged(observation: Observation, flagged: frozenset[tuple[int, str]]) -> bool:
    """Return whether this number is a validation force error below the true model's.

    `flagged` holds (run id, dof) of the numbers below the true model.
    """
    return (
        observation.stage == "validation"
        and observation.model == "identified"
        and observation.name.startswith("force_")
        and (observation.run.id, observation.dof) in flagged
    )


def _key(observation: Observation, factors: Key) -> Key:
    return tuple(observation.level(factor) for factor in factors)


def _run_part(key: Key, factors: Key) -> Key:
    return tuple(
        level for level, factor in zip(key, factors, strict=True) if factor not in OWN_FACTORS
    )


def _runs_by_part(runs: Sequence[Run], factors: Key) -> Mapping[Key, list[Run]]:
    by_part: dict[Key, list[Run]] = defaultdict(list)
    for run in runs:
        by_part[tuple(run.levels[f] for f in factors if f not in OWN_FACTORS)].append(run)
    return by_part


def _with_unobserved(
    observed: set[tuple[Key, Key]], runs: Sequence[Run], row_factors: Key, column_factors: Key
) -> set[tuple[Key, Key]]:
    """Add the cells of runs without a number, so that a failed run keeps its row and column."""
    factors = (*row_factors, *column_factors)
    own_positions = [i for i, factor in enumerate(factors) if factor in OWN_FACTORS]
    own_parts = {tuple((row + column)[i] for i in own_positions) for row, column in observed}
    observed_parts = {_run_part(row + column, factors) for row, column in observed}
    keys = set(observed)
    for part in set(_runs_by_part(runs, factors)) - observed_parts:
        for own in own_parts or {("",) * len(own_positions)}:
            levels = list(part)
            for position, level in zip(own_positions, own, strict=True):
                levels.insert(position, level)
            split = len(row_factors)
            keys.add((tuple(levels[:split]), tuple(levels[split:])))
    return keys


class _KeyOrder:
    """Order of keys: metrics as requested, DOFs and models in their usual order, others sorted."""

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
    """Return the cells to set in bold: the best among those under equal conditions.

    `loss` is the number that cells are compared by: smaller is better, NaN excludes a cell. Cells
    below the true model are excluded, because they do not fit the vessel.
    """
    groups: dict[Key, list[tuple[Key, Key]]] = defaultdict(list)
    factors = (*table.row_factors, *table.column_factors)
    positions = [i for i, factor in enumerate(factors) if factor.partition(".")[0] in CIRCUMSTANCES]
    for row, column in table.cells:
        groups[tuple((row + column)[i] for i in positions)].append((row, column))
    best = set()
    for members in groups.values():
        candidates = [key for key in members if np.isfinite(loss[key])]
        candidates = [key for key in candidates if not table.cells[key].flagged]
        if len(members) > 1 and candidates:
            lowest = min(loss[key] for key in candidates)
            best |= {key for key in candidates if abs(loss[key] - lowest) <= SAME * abs(lowest)}
    return best


def against_baseline(
    table: Pivot, observations: Sequence[Observation], factor: str, level: str
) -> dict[tuple[Key, Key], PairedTest]:
    """Test each cell against the runs with `factor` equal to `level`, paired by seed and choices.

    `observations` are the numbers of the table. Cells of the baseline itself are omitted. Trials of
    one cell with equal seed and choices count as one pair, with their mean.
    """
    factors = (*GROUPS, "seed", *OWN_FACTORS, *table.row_factors, *table.column_factors)
    shared_factors = tuple(
        dict.fromkeys(f for f in factors if not f"{f}.".startswith(f"{factor}."))
    )
    reference = _means(
        (o for o in observations if o.level(factor) == level and o.value is not None),
        shared_factors,
    )
    tests = {}
    for (row, column), cell in table.cells.items():
        own = [o for o in cell.observed if o.level(factor) != level]
        if own:
            values = _means(own, shared_factors)
            common = sorted(values.keys() & reference.keys())
            better = definition_of(own[0].name).better
            left = np.array([values[key] for key in common], dtype=np.float64)
            right = np.array([reference[key] for key in common], dtype=np.float64)
            tests[row, column] = paired_test(left, right, better)
    return tests


def _means(observations: Iterable[Observation], factors: Key) -> dict[Key, float]:
    grouped: dict[Key, list[float]] = defaultdict(list)
    for observation in observations:
        if observation.value is not None and np.isfinite(observation.value):
            grouped[_key(observation, factors)].append(observation.value)
    return {key: float(np.mean(values)) for key, values in grouped.items()}
