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
    is better (None if the better direction is not known), `p_value` that of the two-sided Wilcoxon
    signed-rank test (NaN with fewer than LEAST_PAIRS pairs that differ from each other, and without
    differences). `mean` is that of the cell over the pairs.
    """

    pairs: int
    wins: int | None
    ratio: float
    p_value: float
    mean: float = math.nan
    difference: float = math.nan  # of the means over the pairs


def loss(values: Sample, better: Better) -> Sample:
    """Return the values such that smaller is better; unchanged if no direction is better.

    `values` and the result have shape (n,); `better` is `lower`, `higher`, a target value, or None.
    """
    if better == "higher":
        return -values
    if isinstance(better, int | float):
        return np.abs(values - better)
    return values


def paired_test(sample: Sample, baseline: Sample, better: Better = "lower") -> PairedTest:
    """Compare two samples, shape (n,), whose i-th values have the same seed and choices.

    `better` is `lower`, `higher`, a target value, or None. Raises ValueError for different lengths.
    """
    if sample.shape != baseline.shape:
        raise ValueError(f"pairs differ in length: {sample.shape} and {baseline.shape}")
    pairs = int(sample.size)
    if pairs == 0:
        return PairedTest(0, None if better is None else 0, math.nan, math.nan)
    gain = loss(baseline, better) - loss(sample, better)
    wins = None if better is None else int(np.sum(gain > 0.0))
    baseline_mean = float(np.mean(baseline))
    ratio = float(np.mean(sample)) / baseline_mean if baseline_mean != 0.0 else math.nan
    distinct = len({*zip(sample.tolist(), baseline.tolist(), strict=True)})
    tested = distinct >= LEAST_PAIRS and np.any(gain)
    p_value = float(scipy.stats.wilcoxon(gain).pvalue) if tested else math.nan
    mean = float(np.mean(sample))
    return PairedTest(pairs, wins, ratio, p_value, mean, mean - baseline_mean)
