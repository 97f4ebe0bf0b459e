"""Statistics over the seeds of a cell: location, spread, intervals and the paired test.

Samples are arrays of finite numbers, shape (n,), one number for each run. A statistic is NaN if the
sample is too small for it.
"""

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy  # its subpackages are loaded at their first use
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError
from seatrial.runner.record.catalogue import Better

Sample = NDArray[np.float64]
IntervalKind = Literal["t", "bootstrap"]
RELATIVE_ROUNDING = 1e-9  # relative: smaller differences are rounding errors
EQUAL = 1e-6  # relative: numbers that differ by less are equal in a comparison
BOOTSTRAP_RESAMPLES = 10_000
LEAST_PAIRS = 5  # below, no p-value of the signed-rank test is meaningful
CONFIDENCE = 0.95  # probability that an interval covers the mean
BOOTSTRAP_SEED = 0  # fixed, so that a repeated table shows the same interval
_QUANTILE = re.compile(r"q(\d{1,2})")


def _std(sample: Sample) -> float:
    """Standard deviation with n - 1 in the denominator; NaN for a single value."""
    return float(np.std(sample, ddof=1)) if sample.size > 1 else math.nan


SIMPLE: dict[str, Callable[[Sample], float]] = {
    "mean": lambda sample: float(np.mean(sample)),
    "std": _std,
    "median": lambda sample: float(np.median(sample)),
    "min": lambda sample: float(np.min(sample)),
    "max": lambda sample: float(np.max(sample)),
}
CHOICES = "mean, std, n, median, min, max, q05 ... q95 (any quantile in percent), ci"
DEFAULT = ("mean", "std", "n")


def checked(names: Sequence[str]) -> tuple[str, ...]:
    """Return the distinct statistics; raises ConfigurationError for an unknown one."""
    for name in names:
        if name not in SIMPLE and name not in ("n", "ci") and not _QUANTILE.fullmatch(name):
            raise ConfigurationError(f"--statistic: {name!r} is not known; expected {CHOICES}")
    return tuple(dict.fromkeys(names))


def summary(
    sample: Sample, names: Sequence[str], interval: IntervalKind = "t"
) -> dict[str, float | int]:
    """Return the named statistics of a sample, shape (n,); `ci` gives `ci_low` and `ci_high`.

    `interval` is the kind of confidence interval. An empty sample has n = 0 and NaN otherwise.
    """
    values: dict[str, float | int] = {}
    for name in names:
        if name == "n":
            values["n"] = int(sample.size)
        elif name == "ci":
            values["ci_low"], values["ci_high"] = confidence_interval(sample, interval)
        else:
            values[name] = _statistic(sample, name) if sample.size else math.nan
    return values


def _statistic(sample: Sample, name: str) -> float:
    quantile = _QUANTILE.fullmatch(name)
    if quantile:
        return float(np.quantile(sample, int(quantile[1]) / 100.0))
    return SIMPLE[name](sample)


def confidence_interval(sample: Sample, kind: IntervalKind = "t") -> tuple[float, float]:
    """Return the 95 % interval of the mean of a sample (n,); (NaN, NaN) for fewer than two values.

    That of Student's t, or of the percentile bootstrap with a fixed seed.
    """
    if sample.size < 2:
        return math.nan, math.nan
    if kind == "bootstrap":
        return _bootstrap_interval(sample)
    quantile = quantile_of_t(sample.size - 1)
    mean, half = float(np.mean(sample)), quantile * _std(sample) / math.sqrt(sample.size)
    return mean - half, mean + half


def quantile_of_t(freedom: int) -> float:
    """Return the t within +- which Student's distribution of this freedom has 95 %."""
    return float(scipy.special.stdtrit(freedom, 0.5 + CONFIDENCE / 2.0))


def _bootstrap_interval(sample: Sample) -> tuple[float, float]:
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    # in blocks of one thousand resamples, to limit the memory of the index array
    means = [
        sample[rng.integers(0, sample.size, (1_000, sample.size))].mean(axis=1)
        for _ in range(BOOTSTRAP_RESAMPLES // 1_000)
    ]
    tail = (1.0 - CONFIDENCE) / 2.0
    low, high = np.quantile(np.concatenate(means), [tail, 1.0 - tail])
    return float(low), float(high)


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
    values = np.asarray(p_values, dtype=np.float64)
    known = np.flatnonzero(~np.isnan(values))
    adjusted, largest = np.full(len(values), np.nan), 0.0
    for place, k in enumerate(known[np.argsort(values[known], kind="stable")]):
        largest = max(largest, min((len(known) - place) * float(values[k]), 1.0))
        adjusted[k] = largest
    return adjusted.tolist()
