"""Statistics of cells: location, spread, intervals, the paired test, and the best of them.

Samples are arrays of finite numbers, shape (n,), one number for each seed. A statistic is NaN if
the sample is too small for it. `pivot` groups the frame of observations into cells.
"""

import math
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd
import scipy  # its subpackages are loaded at their first use
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.comparability import EVERY_SEED, by_seed, distinct, pairs, within
from seatrial.runner.compare.frame import (
    BELOW_TRUE_MODEL,
    COEFFICIENT_STAGE,
    DIVERGED,
    METRIC_FACTORS,
    NOT_APPLICABLE,
    POOLED,
    WITHOUT,
    codes,
    ordered,
)
from seatrial.runner.record.catalogue import Better, definition_of
from seatrial.runner.record.vocabulary import DOF_ORDER, MODELS

Sample = NDArray[np.float64]
RELATIVE_ROUNDING = 1e-9  # relative: smaller differences are rounding errors
EQUAL = 1e-6  # relative: numbers that differ by less are equal in a comparison
LEAST_PAIRS = 5  # below, no p-value of the signed-rank test is meaningful
CONFIDENCE = 0.95  # probability that an interval covers the mean
_QUANTILE = re.compile(r"q(\d{1,2})")


SIMPLE: dict[str, Callable[[Sample], np.floating]] = {
    **{"mean": np.mean, "median": np.median, "min": np.min, "max": np.max},
    "std": lambda sample: np.std(sample, ddof=1) if sample.size > 1 else np.float64(np.nan),
}
CHOICES = "mean, std, n, median, min, max, q05 ... q95 (any quantile in percent), ci"
DEFAULT = ("mean", "std", "n")


def checked(names: Sequence[str]) -> tuple[str, ...]:
    """Return the distinct statistics; raises ConfigurationError for an unknown one."""
    for name in names:
        if name not in SIMPLE and name not in ("n", "ci") and not _QUANTILE.fullmatch(name):
            raise ConfigurationError(f"--statistic: {name!r} is not known; expected {CHOICES}")
    return tuple(dict.fromkeys(names))


def summary(sample: Sample, names: Sequence[str]) -> dict[str, float | int]:
    """Return the named statistics of a sample, shape (n,); `ci` gives `ci_low` and `ci_high`.

    An empty sample has n = 0 and NaN otherwise.
    """
    values: dict[str, float | int] = {}
    for name in names:
        if name == "n":
            values["n"] = int(sample.size)
        elif name == "ci":
            values["ci_low"], values["ci_high"] = confidence_interval(sample)
        elif not sample.size:
            values[name] = math.nan
        elif name in SIMPLE:
            values[name] = float(SIMPLE[name](sample))
        else:
            values[name] = float(np.quantile(sample, int(name[1:]) / 100.0))
    return values


def confidence_interval(sample: Sample) -> tuple[float, float]:
    """Return the 95 % interval of the mean of a sample (n,), of Student's t.

    (NaN, NaN) for fewer than two values.
    """
    if sample.size < 2:
        return math.nan, math.nan
    quantile = float(scipy.special.stdtrit(sample.size - 1, 0.5 + CONFIDENCE / 2.0))
    half = quantile * float(np.std(sample, ddof=1)) / math.sqrt(sample.size)
    return float(np.mean(sample)) - half, float(np.mean(sample)) + half


@dataclass(frozen=True)
class PairedTest:
    """Comparison of a cell with its baseline over their common seeds.

    `ratio` is the ratio of the means over the pairs, `wins` the number of pairs in which the cell
    is better (None if the better direction is not known), of the `pairs` and of the `lost` ones,
    whose number the cell failed to give. `p_value` is that of the two-sided Wilcoxon signed-rank
    test (NaN with fewer than LEAST_PAIRS pairs that differ from each other, and without
    differences), `p_holm` the same after Holm's correction over the tests of a table. `effect` is
    the matched-pairs rank-biserial correlation: 1 if the cell is better in every pair, -1 if it is
    worse in every pair. `mean` is that of the cell over the pairs.
    """

    pairs: int
    wins: int | None
    ratio: float
    p_value: float
    mean: float = math.nan
    difference: float = math.nan  # of the means over the pairs
    effect: float = math.nan
    lost: int = 0
    p_holm: float = math.nan


def equal(first: Sample, other: Sample | float, resolution: float = 0.0) -> NDArray[np.bool_]:
    """Return where numbers (n,) differ by less than one part in a million or the resolution."""
    size = np.maximum(np.abs(first), np.abs(other))
    with np.errstate(invalid="ignore"):  # inf - inf
        near = np.abs(first - other) <= np.maximum(EQUAL * size, resolution)
    return np.asarray((first == other) | (near & np.isfinite(size)))


def loss(values: Sample, better: Better) -> Sample:
    """Return the values such that smaller is better; unchanged if no direction is better.

    `values` and the result have shape (n,); `better` is `lower`, `higher`, a target value, or None.
    """
    if better == "higher":
        return -values
    if isinstance(better, int | float):
        return np.abs(values - better)
    return values


def paired_test(
    sample: Sample,
    baseline: Sample,
    better: Better = "lower",
    resolution: float = 0.0,
    lost: int = 0,
) -> PairedTest:
    """Compare two samples, shape (n,), whose i-th values have the same seed and choices.

    Args:
        sample: the values of the cell, shape (n,).
        baseline: those of the baseline, shape (n,).
        better: `lower`, `higher`, a target value, or None.
        resolution: values that differ by less are equal, in their unit.
        lost: number of pairs whose value the cell failed to give.

    Raises:
        ValueError: for different lengths.
    """
    if sample.shape != baseline.shape:
        raise ValueError(f"pairs differ in length: {sample.shape} and {baseline.shape}")
    pairs = int(sample.size)
    if pairs == 0:
        return PairedTest(0, None if better is None else 0, math.nan, math.nan, lost=lost)
    mean, baseline_mean = float(np.mean(sample)), float(np.mean(baseline))
    gain = loss(baseline, better) - loss(sample, better)
    gain[equal(sample, baseline, resolution)] = 0.0
    distinct = len({*zip(sample.tolist(), baseline.tolist(), strict=True)})
    tested = distinct >= LEAST_PAIRS and np.any(gain)
    return PairedTest(
        pairs,
        wins=None if better is None else int(np.sum(gain > 0.0)),
        ratio=mean / baseline_mean if baseline_mean != 0.0 else math.nan,
        p_value=float(scipy.stats.wilcoxon(gain).pvalue) if tested else math.nan,
        mean=mean,
        difference=mean - baseline_mean,
        effect=rank_biserial(gain),
        lost=lost,
    )


def rank_biserial(gain: Sample) -> float:
    """Return the rank sum of the positive gains less that of the negative ones, over their sum.

    The effect size of the signed-rank test. `gain` has shape (n,); 0 without differences. Kerby
    (2014), The simple difference formula.
    """
    gain = gain[gain != 0.0]
    ranks = scipy.stats.rankdata(np.abs(gain))
    return float(np.sum(np.sign(gain) * ranks) / np.sum(ranks)) if gain.size else 0.0


def holm(p_values: Sequence[float]) -> list[float]:
    """Adjust p-values so that a family of tests keeps its level. Holm (1979); NaN stays NaN."""
    known = pd.Series(p_values, dtype="float64").dropna().sort_values(kind="stable")
    steps = known * np.arange(len(known), 0, -1)
    adjusted: list[float] = steps.cummax().clip(upper=1.0).reindex(range(len(p_values))).tolist()
    return adjusted


Key = tuple[str, ...]
Place = tuple[Key, Key]
# Cells are compared with each other if they differ in nothing but these.
COMPARED = ("identifier", "controller", "update")
MARK, UNSETTLED, INFEASIBLE = "†", "‡", "§"  # below the true model; flaws of a controller's design


@dataclass(frozen=True)
class Cell:
    """The content of one cell.

    `by_seed` are the values that the statistics are of: the average over the levels that a cell
    pools, for each seed that has them all; EVERY_SEED is the seed of numbers that depend on none.
    `uneven` counts the other seeds. `missing` counts the trials without a value by the reason.
    `experiments` is the number of experiments with a value, `flagged` that of their runs below the
    true model, which fit lag or feedback instead of the vessel. `lost_seeds` are those of the
    trials, started or planned, that have no value, and `units` those of all numbers.
    """

    by_seed: Mapping[str, float] = field(default_factory=dict)
    missing: Mapping[str, int] = field(default_factory=dict)
    experiments: int = 0
    flagged: int = 0
    lost_seeds: frozenset[str] = frozenset()
    units: frozenset[str] = frozenset()
    uneven: int = 0
    metric: str = ""
    stage: str = ""
    condition: int = -1  # of its first number
    is_baseline: bool = False
    unstable: bool = False  # a controller of it, on its own model
    infeasible: bool = False  # the limits of a controller of it
    std_error: float = math.nan  # root mean square
    true_value: float = math.nan  # if all of its runs share it
    of_estimate: bool = False  # a standard error is of the estimate, not of the coefficient

    @property
    def marks(self) -> list[str]:
        """The marks of the cell in tables and figures."""
        held = {MARK: self.flagged, UNSETTLED: self.unstable, INFEASIBLE: self.infeasible}
        return [mark for mark, holds in held.items() if holds]

    @property
    def deterministic(self) -> bool:
        """Whether no number depends on a seed."""
        return [*self.by_seed] == [EVERY_SEED]

    @property
    def sample(self) -> Sample:
        """The values by seed, shape (n,)."""
        return np.array([*self.by_seed.values()], dtype=np.float64)

    @property
    def resolution(self) -> float:
        """Values that differ by less are equal."""
        is_coefficient = self.stage == COEFFICIENT_STAGE
        return 0.0 if is_coefficient else definition_of(self.metric).resolution

    def loss(self, value: float) -> float:
        """Return the loss of a value of the cell: of a coefficient its distance from the truth."""
        if self.stage == COEFFICIENT_STAGE:
            return abs(value - self.true_value)
        better = definition_of(self.metric).better
        return math.nan if better is None else float(loss(np.array(value), better))


@dataclass(frozen=True)
class Pivot:
    """Cells by row key and column key; a key holds one level for each factor.

    `known` are the distinct numbers with a value, each with the number of its `cell`, which is its
    place among the `cells`.
    """

    row_factors: Key
    column_factors: Key
    row_keys: Sequence[Key]
    column_keys: Sequence[Key]
    cells: Mapping[Place, Cell]
    known: pd.DataFrame

    def cell(self, row: Key, column: Key) -> Cell:
        """Return the cell, which is empty if no run belongs to it."""
        return self.cells.get((row, column), Cell())


def pivot(frame: pd.DataFrame, rows: Key, columns: Key, metrics: Sequence[str] = ()) -> Pivot:
    """Group a completed frame by the levels of the factors; every experiment counts once.

    `metrics` is the order of the metrics in the request.
    """
    factors = (*rows, *columns)
    frame = frame.assign(cell=codes(frame, factors))
    finite, own = frame["reason"] == "", frame["reason"].isin([DIVERGED, WITHOUT])
    known, lacking = (distinct(frame[chosen], ["cell"]) for chosen in (finite, own))
    missing = pd.concat([lacking, frame[~finite & ~own]])
    lost = missing[missing["reason"] != NOT_APPLICABLE].groupby("cell")["seed"]
    observed, values = known.groupby("cell"), by_seed(known)
    of_estimate = ["of_estimate"] if "of_estimate" in frame else []
    contents: dict[str, Mapping[int, object]] = {
        "experiments": observed.size().to_dict(),
        "flagged": known[known[BELOW_TRUE_MODEL]].groupby("cell")["run"].nunique().to_dict(),
        "uneven": (~values["whole"]).groupby(values["cell"]).sum().to_dict(),
        "lost_seeds": lost.agg(frozenset).to_dict(),
        "units": frame[frame["unit"].notna()].groupby("cell")["unit"].agg(frozenset).to_dict(),
        **observed[["condition", "metric", "stage"]].first().to_dict(),
        **observed[["unstable", "infeasible", *of_estimate]].any().to_dict(),
        **observed[["is_baseline"]].all().to_dict(),
    }
    if of_estimate:
        squares, truth = (known["std_error"] ** 2).groupby(known["cell"]), observed["true_value"]
        contents["std_error"] = np.sqrt(squares.mean()).to_dict()
        contents["true_value"] = truth.first().where(truth.nunique(dropna=False) == 1).to_dict()
    seeds, counts = (defaultdict[int, dict[str, Any]](dict) for _ in range(2))
    for row in values[values["whole"]].itertuples():
        seeds[row.cell][row.replicate] = row.value
    lacks = missing.groupby(["cell", "reason"], observed=True)["run"].nunique()
    for (cell, reason), number in lacks.items():
        counts[cell][reason] = int(number)
    contents |= {"by_seed": seeds, "missing": counts}
    levels = frame.loc[~frame["cell"].duplicated(), list(factors)].astype(str)
    keys = [tuple(each) for each in levels.itertuples(index=False)] if factors else [()]
    cells = {}
    for n, key in enumerate(keys):
        held: dict[str, Any] = {name: each[n] for name, each in contents.items() if n in each}
        cells[key[: len(rows)], key[len(rows) :]] = Cell(**held)
    row_keys = _sorted((row for row, _ in cells), rows, metrics)
    column_keys = _sorted((column for _, column in cells), columns, metrics)
    return Pivot(rows, columns, row_keys, column_keys, cells, known)


def _sorted(keys: Iterable[Key], factors: Key, metrics: Sequence[str]) -> list[Key]:
    """Return the distinct keys: metrics as requested, DOFs and models in their usual order."""
    first = {"metric": tuple(metrics), "dof": DOF_ORDER, "model": MODELS, "file": (POOLED,)}
    distinct_keys = {*keys}
    ranks = []
    for place, factor in enumerate(factors):
        levels = ordered(key[place] for key in distinct_keys)
        known = [level for level in first.get(factor, ()) if level in levels]
        ranks.append({v: i for i, v in enumerate(dict.fromkeys([*known, *levels]))})
    return sorted(distinct_keys, key=lambda k: [r[v] for r, v in zip(ranks, k, strict=True)])


def best_cells(
    table: Pivot, facts: pd.DataFrame, location: Callable[[Sample], float]
) -> set[Place]:
    """Return the cells to set in bold: the best among those under equal conditions.

    Cells are compared over the same seeds: those of the baseline, without one those that most of
    the cells have. A cell that lacks one of them is not best, nor is one that lost a trial, because
    the others are the easier ones, nor one below the true model, which does not fit the vessel.

    Args:
        table: the cells.
        facts: the facts of the conditions.
        location: the number of the values over those seeds, shape (n,), whose loss is compared.
    """
    shared = codes(facts, [name for name in facts if not within(name, COMPARED)])
    apart = [
        k for k, factor in enumerate((*table.row_factors, *table.column_factors))
        if factor in ("metric", "stage", "dof", "file")
        or not within(factor, (*COMPARED, *METRIC_FACTORS))
    ]  # fmt: skip
    groups: dict[Hashable, dict[Place, Cell]] = defaultdict(dict)
    for place, cell in table.cells.items():
        own = tuple((place[0] + place[1])[k] for k in apart)
        groups[own, int(shared[cell.condition]) if cell.experiments else -1][place] = cell
    best = set[Place]()
    for cells in groups.values():
        seeds, losses = reference_seeds(cells.values()), dict[Place, float]()
        for place, cell in cells.items():
            whole = cell.deterministic or seeds <= cell.by_seed.keys()
            if whole and cell.experiments and not (cell.flagged or cell.lost_seeds or cell.uneven):
                values = [v for k, v in cell.by_seed.items() if cell.deterministic or k in seeds]
                losses[place] = cell.loss(location(np.array(values)))
        lowest = min((loss for loss in losses.values() if np.isfinite(loss)), default=math.nan)
        best |= {
            place
            for place, loss in losses.items()
            if len(cells) > 1 and equal(np.array([loss]), lowest, cells[place].resolution)[0]
        }
    return best


def reference_seeds(cells: Iterable[Cell]) -> frozenset[str]:
    """Return the seeds that cells are compared over.

    They are the seeds of the baseline, or those that more than half of the cells have.
    """
    drawn = [cell for cell in cells if cell.experiments and not cell.deterministic]
    reference = [cell for cell in drawn if cell.is_baseline]
    counts = Counter(seed for cell in reference or drawn for seed in cell.by_seed)
    most = 0 if reference else len(drawn) / 2.0
    return frozenset(seed for seed, n in counts.items() if seed != EVERY_SEED and n > most)


def against_baseline(
    table: Pivot, frame: pd.DataFrame, facts: pd.DataFrame, baseline: Mapping[str, str]
) -> dict[Place, PairedTest]:
    """Test each cell against its counterparts in the frame, which have the levels of `baseline`.

    Cells of the baseline itself are omitted; a cell without a counterpart has a test without pairs.
    """
    factors = (*table.row_factors, *table.column_factors)
    named = [name for name in factors if name not in baseline and name not in METRIC_FACTORS]
    references = distinct(frame[(frame["reason"] == "") & frame["is_baseline"]]).assign(cell=-1)
    own = table.known[~table.known["is_baseline"]]
    both = pd.concat([own, references], ignore_index=True)
    beside, seeds = pairs(both, facts, baseline, named)
    of_cell, known_of = dict(iter(beside.groupby("cell"))), seeds.groupby("cell")["replicate"]
    known = known_of.agg(set).to_dict()
    tests, cells = {}, [*table.cells.items()]
    for number in sorted(own["cell"].unique()):
        (place, cell), pair = cells[number], of_cell.get(number, beside[:0])
        of_baseline = known.get(number, set())
        lost = {
            seed for seed in cell.lost_seeds - {*pair["replicate"]}
            if seed in of_baseline or EVERY_SEED in of_baseline
        }  # fmt: skip
        better, left, right = definition_of(cell.metric).better, pair["value"], pair["other"]
        tests[place] = paired_test(
            left.to_numpy(), right.to_numpy(), better, cell.resolution, len(lost)
        )
    adjusted = holm([test.p_value for test in tests.values()])
    return {
        place: replace(test, p_holm=p)
        for (place, test), p in zip(tests.items(), adjusted, strict=True)
    }
