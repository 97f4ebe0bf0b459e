"""Decisions on fronts whose answer is known, and against pymoo's own."""

import warnings

import numpy as np
import pytest

from seatrial.models.identification.pareto_selection import (
    choose,
    knees,
    nearest_to_ideal,
    normalised,
    pseudo_weights,
)


def front_with_knee(n=61, at=0.2):
    """Two straight lines that meet at (at, at)."""
    first = np.linspace(0.0, at, n // 2, endpoint=False)
    steep = np.column_stack([first, 1.0 - first * (1.0 - at) / at])
    second = np.linspace(at, 1.0, n - n // 2)
    return np.vstack([steep, np.column_stack([second, at * (1.0 - second) / (1.0 - at)])])


def test_knee_of_two_lines_is_where_they_meet():
    front = front_with_knee() * [3.0, 0.02] + [7.0, 1.0]
    chosen, rule = choose(front, "knee", None)
    assert rule == "knee"
    np.testing.assert_allclose(normalised(front)[chosen], 0.2, atol=0.02)


@pytest.mark.parametrize("seed", range(6))
def test_knees_are_those_of_pymoo(seed):
    rng = np.random.default_rng(seed)
    x = np.sort(rng.random(60))
    front = np.column_stack([x, (1.0 - x ** rng.uniform(0.2, 0.8)) ** 2])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # scipy.spatial.ckdtree, and pymoo's own filter
        from pymoo.mcdm.high_tradeoff import HighTradeoffPoints

        expected = HighTradeoffPoints().do(normalised(front))
    assert knees(front).tolist() == ([] if expected is None else np.sort(expected).tolist())


@pytest.mark.parametrize("n", [1, 2])
def test_a_collapsed_front_has_no_knee_but_a_choice(n):
    front = np.array([[1.0, 2.0], [1.0 + 1e-9, 2.0 - 1e-9]])[:n]
    assert len(knees(front)) == 0
    assert choose(front, "knee", None)[1] == "ideal"


def test_equal_points_have_no_knee():
    assert len(knees(np.ones((9, 2)))) == 0
    assert choose(np.ones((9, 2)), "knee", None) == (0, "ideal")


def test_nearest_to_ideal_does_not_depend_on_units():
    front = front_with_knee()
    assert nearest_to_ideal(front) == nearest_to_ideal(front * [1e6, 1e-6])
    np.testing.assert_allclose(normalised(front)[nearest_to_ideal(front)], 0.2, atol=0.02)


def test_pseudo_weights_sum_to_one_and_choose_ends():
    front = front_with_knee()
    weights = pseudo_weights(front)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    assert choose(front, "pseudo_weights", (1.0, 1e-9))[0] == np.argmin(front[:, 0])
    assert choose(front, "pseudo_weights", (1e-9, 1.0))[0] == np.argmin(front[:, 1])
    middle, rule = choose(front, "pseudo_weights", None)
    assert rule == "pseudo_weights"
    np.testing.assert_allclose(weights[middle], 0.5, atol=0.05)
