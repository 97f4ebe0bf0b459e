"""Grouping of observations into the cells of a table, the best cells and the paired baseline."""

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from seatrial.runner.compare.likeness import Counterparts, Likeness, within
from seatrial.runner.compare.results import (
    COEFFICIENT_STAGE,
    FINISHED,
    OWN_FACTORS,
    POOLED,
    Observation,
    StoredRun,
    ordered,
)
from seatrial.runner.compare.statistics import PairedTest, Sample, equal, holm, paired_test
from seatrial.runner.record.catalogue import HORIZONS, definition_of
from seatrial.runner.record.vocabulary import DOF_ORDER, MODELS

Key = tuple[str, ...]
Place = tuple[Key, Key]
Prediction = tuple[int, str, str]  # run, model and horizon
# Cells are compared with each other if they differ in nothing but these.
COMPARED = ("identifier", "controller", "update")


@dataclass(frozen=True)
class PivotCell:
    """The content of one cell.

    `observed` are the finite values, one for each experiment, and `by_seed` the values that the
    statistics are of: the average over the levels that a cell pools, for each seed that has them
    all; None is the seed of numbers that do not depend on one. `uneven` counts the other seeds.
    `unfinished` counts the unfinished runs by status, `diverged` the validations of finished runs
    that diverged, `without` the other finished runs whose number has no value, `not_applicable`
    those whose method has no such number, and `flagged` the runs below the true model, which fit
    lag or feedback instead of the vessel. `lost_seeds` are those of the experiments without a
    value, and `units` those of all numbers, with or without a value.
    """

    observed: Sequence[Observation] = ()
    by_seed: Mapping[str | None, float] = field(default_factory=dict)
    unfinished: Mapping[str, int] = field(default_factory=dict)
    without: int = 0
    not_applicable: int = 0
    flagged: int = 0
    diverged: int = 0
    held_s: float = math.nan  # median time that the diverged free runs held
    lost_seeds: frozenset[str] = frozenset()
    units: frozenset[str] = frozenset()
    uneven: int = 0

    @property
    def lost(self) -> bool:
        """Whether an experiment of the cell, started or planned, has no value."""
        return bool(self.lost_seeds)

    @property
    def deterministic(self) -> bool:
        """Whether no number depends on a seed."""
        return [*self.by_seed] == [None]

    @property
    def sample(self) -> Sample:
        """The values by seed, shape (n,)."""
        return np.array([*self.by_seed.values()], dtype=np.float64)


@dataclass(frozen=True)
class Pivot:
    """Cells by row key and column key; a key holds one level for each factor."""

    row_factors: Key
    column_factors: Key
    row_keys: Sequence[Key]
    column_keys: Sequence[Key]
    cells: Mapping[tuple[Key, Key], PivotCell]

    def cell(self, row: Key, column: Key) -> PivotCell:
        """Return the cell, which is empty if no run belongs to it."""
        return self.cells.get((row, column), PivotCell())

    def level(self, row: Key, column: Key, factor: str) -> str | None:
        """Return the level of a factor in a cell; None if it is no factor of the table."""
        levels = dict(zip((*self.row_factors, *self.column_factors), row + column, strict=True))
        return levels.get(factor)


def pivot(
    observations: Sequence[Observation],
    runs: Sequence[StoredRun],
    row_factors: Key,
    column_factors: Key,
    flagged: frozenset[tuple[int, str]],
    likeness: Likeness,
    diverged: Mapping[Prediction, float],
    name_order: Sequence[str] = (),
) -> Pivot:
    """Group observations of `runs` by the levels of the factors.

    `runs` are all runs of the table, finished or not; `flagged` holds (run id, dof) of those below
    the true model, `diverged` the predictions that diverged with the time that they held [s];
    `name_order` is the order of the metrics in the request. Every experiment counts once.
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
        observed = grouped.get((row, column), [])
        cells[row, column] = _cell(observed, members, flagged, likeness, diverged)
    order = _KeyOrder(name_order)
    rows = order.sort((row for row, _ in keys), row_factors)
    columns = order.sort((column for _, column in keys), column_factors)
    return Pivot(row_factors, column_factors, rows, columns, cells)


def _cell(
    observations: Sequence[Observation],
    runs: Sequence[StoredRun],
    flagged: frozenset[tuple[int, str]],
    likeness: Likeness,
    diverged: Mapping[Prediction, float],
) -> PivotCell:
    finite = [o for o in observations if o.value is not None and np.isfinite(o.value)]
    missing = {o.run.id: o for o in observations} | {o.run.id: None for o in finite}
    without = [o for o in missing.values() if o is not None]
    lost = [o for o in without if prediction_of(o) in diverged]
    held = [diverged[prediction_of(o)] for o in lost]
    finite, without = likeness.distinct(finite), likeness.distinct(without)
    unfinished = [run for run in runs if run.status != FINISHED]
    by_seed, uneven = averaged(finite, likeness)
    gone = [*unfinished, *(o.run for o in without)]
    return PivotCell(
        finite,
        by_seed,
        dict(Counter(run.status for run in unfinished)),
        without=len({o.run.id for o in without} - {o.run.id for o in lost}),
        not_applicable=sum(run.status == FINISHED and run.id not in missing for run in runs),
        flagged=len({o.run.id for o in finite if is_flagged(o, flagged)}),
        diverged=len({o.run.id for o in without} & {o.run.id for o in lost}),
        held_s=float(np.median(held)) if held else math.nan,
        lost_seeds=frozenset(run.levels["seed"] for run in gone),
        units=frozenset(o.unit for o in observations),
        uneven=uneven,
    )


def averaged(
    observations: Iterable[Observation], likeness: Likeness
) -> tuple[dict[str | None, float], int]:
    """Average numbers over their levels within each seed: levels are no replicates.

    Where every level has a seed of its own, the seeds are averaged over the levels that they have.

    Returns:
        The averages by seed, and the number of seeds left out because they lack a level.
    """
    levels: dict[Hashable, dict[str | None, float]] = defaultdict(dict)
    for o in observations:
        own = tuple(o.level(factor) for factor in OWN_FACTORS)
        levels[likeness.number(o), own][likeness.seed(o)] = float(o.value or 0.0)
    drawn = dict.fromkeys(seed for values in levels.values() for seed in values if seed is not None)
    seeds: list[str | None] = [*drawn] or ([None] if levels else [])
    has = {
        seed: [v[seed] if seed in v else v[None] for v in levels.values() if seed in v or None in v]
        for seed in seeds
    }
    nested = len(seeds) > 1 and all(len(values) == 1 for values in levels.values())
    averages = {
        seed: math.fsum(own) / len(own)
        for seed, own in has.items()
        if nested or len(own) == len(levels)
    }
    return averages, len(seeds) - len(averages)


def prediction_of(observation: Observation) -> Prediction:
    """Return the run, the model and the horizon of the prediction that a metric is about."""
    horizon = next((name for name in HORIZONS if observation.name.endswith(f"_{name}")), "")
    return observation.run.id, observation.model, horizon


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


def _runs_by_part(runs: Sequence[StoredRun], factors: Key) -> Mapping[Key, list[StoredRun]]:
    by_part: dict[Key, list[StoredRun]] = defaultdict(list)
    for run in runs:
        by_part[tuple(run.levels[f] for f in factors if f not in OWN_FACTORS)].append(run)
    return by_part


def _with_unobserved(
    observed: set[tuple[Key, Key]], runs: Sequence[StoredRun], row_factors: Key, column_factors: Key
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
        self.fixed = {
            "metric": tuple(name_order), "dof": DOF_ORDER, "model": MODELS, "file": (POOLED,),
        }  # fmt: skip

    def sort(self, keys: Iterable[Key], factors: Key) -> list[Key]:
        distinct = set(keys)
        ranks = []
        for position, factor in enumerate(factors):
            levels = ordered(key[position] for key in distinct)
            first = [level for level in self.fixed.get(factor, ()) if level in levels]
            rest = [level for level in levels if level not in first]
            ranks.append({level: rank for rank, level in enumerate([*first, *rest])})
        return sorted(distinct, key=lambda key: [r[v] for r, v in zip(ranks, key, strict=True)])


def best_cells(
    table: Pivot,
    loss: Callable[[Place, Sample], float],
    resolution: Callable[[Place], float],
    likeness: Likeness,
    is_baseline: Callable[[PivotCell], bool],
) -> set[Place]:
    """Return the cells to set in bold: the best among those under equal circumstances.

    Cells are compared over the same seeds: those of the baseline, without one those that most of
    the cells have. A cell that lacks one of them is not best, nor is one that lost an experiment,
    because the others are the easier ones, nor one below the true model, which does not fit the
    vessel.

    Args:
        table: the cells.
        loss: the number that a cell is compared by, of its values over those seeds, shape (n,);
            smaller is better, NaN excludes it.
        resolution: losses of a cell that differ by less are equal.
        likeness: the circumstances.
        is_baseline: whether a cell is the baseline.
    """
    groups: dict[Hashable, list[Place]] = defaultdict(list)
    for place, cell in table.cells.items():
        groups[_circumstances(table, place, cell, likeness)].append(place)
    best = set()
    for members in groups.values():
        cells = {place: table.cells[place] for place in members}
        seeds = reference_seeds(cells.values(), is_baseline)
        losses = {
            place: loss(place, np.array([*on_seeds(cell, seeds).values()]))
            for place, cell in cells.items()
            if cell.observed and not (cell.flagged or cell.lost or cell.uneven)
            and (cell.deterministic or seeds <= cell.by_seed.keys())
        }  # fmt: skip
        finite = {place: value for place, value in losses.items() if np.isfinite(value)}
        if len(members) > 1 and finite:
            lowest = min(finite.values())
            best |= {
                place
                for place, value in finite.items()
                if equal(np.array([value]), lowest, resolution(place))[0]
            }
    return best


def reference_seeds(
    cells: Iterable[PivotCell], is_baseline: Callable[[PivotCell], bool]
) -> frozenset[str]:
    """Return the seeds that cells are compared over.

    They are the seeds of the baseline, or those that more than half of the cells have.
    """
    drawn = [cell for cell in cells if cell.observed and not cell.deterministic]
    reference = [cell for cell in drawn if is_baseline(cell)]
    counts = Counter(seed for cell in reference or drawn for seed in cell.by_seed)
    most = 0 if reference else len(drawn) / 2.0
    return frozenset(seed for seed, n in counts.items() if seed is not None and n > most)


def on_seeds(cell: PivotCell, seeds: frozenset[str]) -> Mapping[str | None, float]:
    """Return the values of a cell over some seeds; a deterministic cell has every seed."""
    return {seed: v for seed, v in cell.by_seed.items() if seed is None or seed in seeds}


def _circumstances(table: Pivot, place: Place, cell: PivotCell, likeness: Likeness) -> Hashable:
    """Return what must be equal for two cells to be compared with each other."""
    named = zip((*table.row_factors, *table.column_factors), place[0] + place[1], strict=True)
    own = tuple(
        (factor, level)
        for factor, level in named
        if factor in ("metric", "stage", "dof", "file")
        or not within(factor, (*COMPARED, *OWN_FACTORS))
    )
    shared = frozenset(
        (name, level)
        for observation in cell.observed[:1]
        for name, level in likeness.of(observation).items()
        if not within(name, COMPARED)
    )
    return own, shared


def against_baseline(
    table: Pivot,
    observations: Sequence[Observation],
    baseline: Mapping[str, str],
    likeness: Likeness,
) -> dict[Place, PairedTest]:
    """Test each cell against its counterparts, which have the levels of `baseline`.

    A counterpart is equal in everything but the factors of the baseline, and in the seed if
    numbers depend on it. Where the baseline has several configurations, a counterpart is also
    equal in what they differ in. Cells of the baseline itself are omitted; a cell without a
    counterpart has a test without pairs. Each pair of experiments counts once.
    """
    factors = (*table.row_factors, *table.column_factors)
    free = tuple(name for name in factors if name not in baseline and name not in OWN_FACTORS)
    counterparts = Counterparts(observations, baseline, likeness, free)
    tests = {}
    for place, cell in table.cells.items():
        own = [o for o in cell.observed if not counterparts.is_reference(o)]
        if own:
            pairs = counterparts.pairs(own)
            known = counterparts.seeds(own)
            lost = {s for s in cell.lost_seeds - pairs.keys() if s in known or None in known}
            left, right = np.array([*pairs.values()], dtype=np.float64).reshape(-1, 2).T
            metric = definition_of(own[0].name)
            resolution = 0.0 if own[0].stage == COEFFICIENT_STAGE else metric.resolution
            tests[place] = paired_test(left, right, metric.better, resolution, len(lost))
    adjusted = holm([test.p_value for test in tests.values()])
    return {
        place: replace(test, p_holm=p)
        for (place, test), p in zip(tests.items(), adjusted, strict=True)
    }
