"""Ranks of entrants: published ranks, the level of the tests, and intervals by the bootstrap."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
import pytest

from seatrial.runner.compare.benchmark import block_bootstrap
from seatrial.runner.compare.leaderboard import alike, critical_difference, groups, ranking
from seatrial.runner.compare.statistics import holm

# Area under the curve of four variants of C4.5 on 14 data sets, Demsar (2006), Table 6.
# Its ranks of the last but one set are 4, 1, 2, 3: the tie there is one of rounding.
DEMSAR = """0.763 0.768 0.771 0.798  0.599 0.591 0.590 0.569  0.954 0.971 0.968 0.967
    0.628 0.661 0.654 0.657  0.882 0.888 0.886 0.898  0.936 0.931 0.916 0.931
    0.661 0.668 0.609 0.685  0.583 0.583 0.563 0.625  0.775 0.838 0.866 0.875
    1.000 1.000 1.000 1.000  0.940 0.962 0.965 0.962  0.619 0.666 0.614 0.669
    0.972 0.981 0.9751 0.975  0.957 0.978 0.946 0.970"""


def ranked(losses: Sequence[Sequence[float]] | np.ndarray) -> pd.DataFrame:
    """The ranks of entrants a, b, ... by their losses (n_cases, n_entrants)."""
    table = np.array(losses)
    return ranking(pd.DataFrame(table, columns=[*"abcd"[: table.shape[1]]]))


def best(ranks: pd.DataFrame) -> list[str]:
    """The first entrant, and those not significantly different from it."""
    return [*ranks.columns[alike(ranks).loc[ranks.columns[0]]]]


def test_mean_ranks_are_the_published_ones() -> None:
    losses = -np.array(DEMSAR.split(), dtype=float).reshape(14, 4)
    expected = [3.143, 2.000, 2.893, 1.964]
    ranks = ranked(losses).mean()
    assert [*ranks.index] == [*"dbca"]
    np.testing.assert_allclose(ranks[[*"abcd"]], expected, atol=5e-4)


@pytest.mark.parametrize(("level", "printed"), [(0.05, 1.25), (0.10, 1.12)])
def test_critical_difference_is_the_published_one(level: float, printed: float) -> None:
    """Demsar (2006), section 3.2.2: four classifiers on 14 data sets."""
    assert critical_difference(4, 14, level) == pytest.approx(printed, abs=5e-3)


@pytest.mark.parametrize(("entrants", "quantile"), [(2, 1.960), (5, 2.728), (9, 3.102)])
def test_critical_values_are_the_published_ones(entrants: int, quantile: float) -> None:
    """Demsar (2006), Table 5(a), at 5 %."""
    cases = entrants * (entrants + 1) // 6  # whose critical difference is the quantile
    assert critical_difference(entrants, cases) == pytest.approx(quantile, abs=5e-4)


def test_holm_is_the_step_down_procedure() -> None:
    # by hand: 0.01 * 4, 0.02 * 3, max(0.06, 0.03 * 2), max(0.06, 0.04)
    adjusted = holm([0.03, 0.01, float("nan"), 0.04, 0.02])
    np.testing.assert_allclose(adjusted, [0.06, 0.04, np.nan, 0.06, 0.06])


def test_equal_entrants_are_told_apart_at_most_as_often_as_the_level_says() -> None:
    rng, repeats = np.random.default_rng(1), 100
    wrong = sum(
        not alike(ranked(rng.standard_normal((20, 4)))).all(axis=None) for _ in range(repeats)
    )
    assert wrong <= 0.05 * repeats + 3 * np.sqrt(repeats * 0.05 * 0.95)


def test_a_better_entrant_is_first_and_alone_and_one_without_results_is_last() -> None:
    rng = np.random.default_rng(2)
    losses = 1.0 + 0.1 * rng.standard_normal((30, 4))
    losses[:, 2] -= 0.5
    losses[:, 0] = np.inf
    result = ranked(losses)
    assert [*result.columns[[0, -1]]] == ["c", "a"]
    assert best(result) == ["c"]
    assert sorted(map(sorted, groups(alike(result)))) == [["b", "d"]]


def test_of_a_group_no_two_differ_not_only_neighbours() -> None:
    same = pd.DataFrame([[1, 1, 0], [1, 1, 1], [0, 1, 1]], [*"abc"], [*"abc"]).astype(bool)
    assert groups(same) == [["a", "b"], ["b", "c"]]


def test_cases_in_which_entrants_are_equal_count_for_both() -> None:
    """Six wins tell them apart, six wins of 26 do not."""
    wins, draws = [[1.0, 2.0]] * 6, [[1.0, 1.0]] * 20
    assert best(ranked(wins)) == ["a"]
    assert best(ranked(wins + draws)) == ["a", "b"]


def test_losses_that_differ_by_rounding_share_their_rank() -> None:
    result = ranked([[1.0, 1.0 + 1e-9, 2.0], [3.0 + 1e-9, 3.0, np.inf]] * 8)
    assert dict(result.mean()) == {"a": 1.5, "b": 1.5, "c": 3.0}
    assert best(result) == ["a", "b"]


def test_losses_below_the_resolution_share_their_rank_each_case_by_its_own() -> None:
    table = pd.DataFrame([[1e-9, 3e-9], [0.1, 0.3]], columns=[*"ab"])
    assert [*ranking(table).mean()] == [1.0, 2.0]
    assert [*ranking(table, 1e-8).mean()] == [1.25, 1.75]
    assert [*ranking(table, np.array([1e-8, 1.0])).mean()] == [1.5, 1.5]


def test_no_number_is_refused() -> None:
    with pytest.raises(ValueError, match="got NaN, expected numbers"):
        ranked([[1.0, np.nan]])


def test_blocks_keep_the_dependence_of_neighbouring_errors() -> None:
    # the variance of the mean square of an autoregression, which independent draws underestimate
    rng, pole, n = np.random.default_rng(3), 0.95, 2000
    means, spreads, naive = [], [], []
    for _ in range(40):
        errors = np.zeros(n)
        for k in range(1, n):
            errors[k] = pole * errors[k - 1] + rng.standard_normal()
        means.append(np.mean(errors**2))
        spreads.append(block_bootstrap([errors[:, None]], 200, rng, 200).std())
        naive.append(block_bootstrap([errors[:, None]], 1, rng, 200).std())
    assert np.mean(spreads) == pytest.approx(np.std(means), rel=0.35)
    assert np.mean(naive) < 0.4 * np.std(means)


def test_blocks_as_long_as_the_file_keep_its_mean() -> None:
    errors = np.random.default_rng(4).standard_normal((50, 2))
    for length in (50, 80):  # a longer block is the whole file
        drawn = block_bootstrap([errors], length, np.random.default_rng(5), 20)
        np.testing.assert_allclose(drawn, np.tile(np.mean(errors**2, axis=0), (20, 1)), rtol=1e-12)


def test_every_sample_is_drawn_as_often() -> None:
    errors = np.sqrt(np.arange(1.0, 8.0))[:, None]
    drawn = block_bootstrap([errors], 3, np.random.default_rng(6), 20_000)
    spread = np.std(drawn) / np.sqrt(20_000)
    assert abs(np.mean(drawn) - 4.0) < 4.0 * spread
