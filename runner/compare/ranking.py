"""Ranks of entrants over many cases: mean ranks, paired tests with Holm's correction, and groups.

Losses are a table, shape (n_cases, n_entrants): smaller is better, inf is worst (an entrant that
diverged or failed). Demsar (2006), Statistical comparisons of classifiers over multiple data sets;
Holm (1979); Benavoli, Corani and Mangili (2016) for pairwise tests instead of mean ranks.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pandas as pd
import scipy  # its subpackages are loaded at their first use
from numpy.typing import NDArray

from seatrial.runner.compare.statistics import Sample, equal, holm

SIGNIFICANCE = 0.05


@dataclass(frozen=True, eq=False)
class Ranking:
    """Entrants over a number of cases.

    `mean_ranks` are by entrant, the best first: 1 is best, NaN without a case. `p_values` are those
    of every pair, by Holm's correction.
    """

    mean_ranks: "pd.Series[float]"
    p_values: Mapping[frozenset[str], float]
    cases: int

    def order(self) -> list[str]:
        """The entrants from the best mean rank to the worst."""
        return [*self.mean_ranks.index]

    def differ(self, one: str, other: str) -> bool:
        """Whether two entrants differ significantly."""
        return self.p_values[frozenset((one, other))] < SIGNIFICANCE

    @property
    def tested(self) -> bool:
        """Whether there are enough cases to tell entrants apart at all, after Holm's correction."""
        pairs = len(self.p_values)
        return bool(pairs and 0.5 ** (self.cases - 1) * pairs < SIGNIFICANCE)

    def best(self) -> list[str]:
        """The first entrant, and those not significantly different from it; none if not tested."""
        first, *others = self.order() if self.tested else [""]
        return [first, *(name for name in others if not self.differ(first, name))] if first else []

    def groups(self) -> list[list[str]]:
        """Largest runs of entrants, neighbours in rank, of which no two differ significantly."""
        order = self.order()
        alike = [
            order[first:end]
            for first, end in combinations(range(len(order) + 1), 2)
            if not any(self.differ(*pair) for pair in combinations(order[first:end], 2))
        ]
        within = (any({*own} < {*other} for other in alike) for own in alike)
        return [own for own, inner in zip(alike, within, strict=True) if len(own) > 1 and not inner]


def ranking(losses: pd.DataFrame) -> Ranking:
    """Rank entrants by their losses (n_cases, n_entrants); raises ValueError for NaN.

    Losses that are equal share the mean of their ranks. Pairs are compared by the two-sided
    signed-rank test of Wilcoxon on the ranks within a case, since losses of different cases have
    different scales.
    """
    if losses.isna().to_numpy().any():
        raise ValueError("losses: got NaN, expected numbers; inf for an entrant without a result")
    places = []
    for row in losses.to_numpy():
        order = np.argsort(row, kind="stable")
        apart = ~equal(row[order][1:], row[order][:-1])
        place = np.empty(len(row))
        place[order] = np.concatenate([[0], np.cumsum(apart)])
        places.append(scipy.stats.rankdata(place))
    ranks = pd.DataFrame(places, losses.index, losses.columns, dtype=np.float64)
    pairs = list(combinations(losses, 2))
    differences = [(ranks[one] - ranks[other]).to_numpy() for one, other in pairs]
    p_values = holm([  # 1 of entrants that are equal in every case
        scipy.stats.wilcoxon(each, zero_method="zsplit").pvalue if np.any(each) else 1.0
        for each in differences
    ])  # fmt: skip
    return Ranking(
        ranks.mean().sort_values(kind="stable"),
        dict(zip(map(frozenset, pairs), p_values, strict=True)),
        len(losses),
    )


def critical_difference(entrants: int, cases: int, level: float = SIGNIFICANCE) -> float:
    """Difference of two mean ranks that is significant by the test of Nemenyi.

    CD = q sqrt(k (k + 1) / (6 N)) of k entrants in N cases, with q the quantile of the Studentized
    range over sqrt(2). Demsar (2006), section 3.2.2. More cautious than `ranking`'s pairwise tests.
    """
    range_ = scipy.stats.studentized_range.ppf(1.0 - level, entrants, np.inf)
    return float(range_ / np.sqrt(2.0) * np.sqrt(entrants * (entrants + 1) / (6.0 * cases)))


def block_bootstrap(
    errors: Sequence[Sample], length: int, rng: np.random.Generator, resamples: int = 1000
) -> Sample:
    """Mean squares (resamples, n) of resampled errors, to give intervals of pooled scores.

    `errors` holds (N, n) for every file. Files are drawn with replacement, then blocks of `length`
    samples within each (circular, so that every sample is as likely): neighbouring errors depend on
    each other, and so do those of a file. Politis and Romano (1992).
    """
    total, count = np.zeros((resamples, errors[0].shape[1])), np.zeros(resamples)
    files = rng.integers(0, len(errors), (resamples, len(errors)))
    for file, of_file in enumerate(errors):
        n = len(of_file)
        row = np.repeat(np.arange(resamples), np.count_nonzero(files == file, axis=1))
        whole, rest = divmod(n, min(length, n))
        starts = rng.integers(0, n, (len(row), whole + 1))
        repeated = np.resize(np.square(of_file), (n + length, *of_file.shape[1:]))
        cumulative = np.cumsum(np.concatenate([np.zeros_like(repeated[:1]), repeated]), axis=0)
        squares = _sums(cumulative, starts[:, :whole], min(length, n)).sum(axis=1)
        np.add.at(total, row, squares + _sums(cumulative, starts[:, whole], rest))
        np.add.at(count, row, n)
    return np.asarray(total / count[:, None])


def _sums(cumulative: Sample, starts: NDArray[np.int64], length: int) -> Sample:
    """Sums of blocks of `length` samples from `starts`."""
    return np.asarray(cumulative[starts + length] - cumulative[starts])
