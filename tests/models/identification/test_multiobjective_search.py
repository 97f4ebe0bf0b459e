"""NSGA-II on known fronts, and the running metric."""

from itertools import pairwise

import numpy as np
import pytest

from seatrial.models.identification.multiobjective_search import (
    Operators,
    ParameterSpace,
    RunningMetric,
    change,
    search,
)

BOX = ParameterSpace(np.zeros(3), np.ones(3), np.zeros(3, dtype=bool))


def convex(points):
    """ZDT1 in three variables: the front is f2 = 1 - sqrt(f1)."""
    g = 1.0 + 9.0 * points[:, 1:].mean(axis=1)
    return np.column_stack([points[:, 0], g * (1.0 - np.sqrt(points[:, 0] / g))])


def bowl(points):
    """Both objectives vanish at (0.3, 0.6, 0.5)."""
    away = points - np.array([0.3, 0.6, 0.5])
    return np.column_stack([np.abs(away).sum(axis=1), (away**2).sum(axis=1)])


def run(evaluate, seed=0, population=100, generations=80, floor=0.0, **watch):
    rng = np.random.default_rng(seed)
    operators = Operators(population, 15.0, 0.9, 15.0, 1.0 / 3.0)
    return search(evaluate, BOX, np.full(2, floor), metric(**watch), operators, generations, rng)


def metric(window=10, threshold=1e-6):
    return RunningMetric(np.ones(2), window, threshold)


def test_front_of_zdt1():
    found = run(convex)
    f1, f2 = found.front.T
    np.testing.assert_allclose(f2, 1.0 - np.sqrt(f1), atol=0.02)
    assert len(found.front) > 60
    assert np.max(np.diff(np.sort(f1))) < 0.1
    np.testing.assert_array_equal(convex(found.points), found.front)


def test_one_optimum():
    found = run(bowl, floor=1e-3)
    assert found.reason == "floor"
    nearest = found.points[np.argmin(found.front[:, 0])]
    np.testing.assert_allclose(nearest, [0.3, 0.6, 0.5], atol=2e-3)


def test_the_generator_decides_and_numpys_own_is_left_alone():
    before = np.random.get_state()[1].copy()
    first, again, other = (run(convex, seed, population=40, generations=5) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.points, again.points)
    assert first.points.shape != other.points.shape or np.any(first.points != other.points)
    np.testing.assert_array_equal(before, np.random.get_state()[1])


def test_the_running_metric_ends_a_search():
    found = run(convex, generations=300, window=5, threshold=0.05)
    assert found.reason == "running_metric"
    assert 5 < found.generations < 300
    assert max(max(step) for step in found.metric.changes[-5:]) < 0.05
    assert max(found.metric.changes[-6]) >= 0.05


def test_change_of_a_front():
    """Hoyer (2021), eq. (3.9), by hand; the extents are those after."""
    before = np.array([[0.0, 10.0], [4.0, 2.0]])
    after = np.array([[0.0, 8.0], [2.0, 4.0], [4.0, 0.0]])
    ideal, nadir, front = change(before, after, np.full(2, 1e-12))
    assert ideal == pytest.approx(2.0 / 8.0)
    assert nadir == pytest.approx(2.0 / 8.0)
    nearest = [2.0 / 8.0, np.hypot(0.5, 0.25), 2.0 / 8.0]
    assert front == pytest.approx(np.mean(nearest))
    assert max(change(after, after, np.full(2, 1e-12))) == 0.0


def test_a_front_of_one_point_does_not_converge():
    watched = metric(window=3)
    for _ in range(6):
        watched.update(np.array([[1.0, 1.0]]))
    assert not watched.converged
    for _ in range(4):
        watched.update(np.array([[1.0, 1.0], [0.5, 2.0]]))
    assert watched.converged


def test_no_individual_is_evaluated_twice():
    """Duplicates take the place of other individuals, also where the best one is a corner."""
    seen = []

    def corner(points):
        seen.append(points.copy())
        return np.column_stack([points[:, 0] + points[:, 1], points[:, 0] + points[:, 2]])

    run(corner, population=40, generations=20)
    everyone = np.vstack(seen)
    for before, after in pairwise(seen):
        assert len(np.unique(after, axis=0)) == len(after)
        assert not np.any(np.all(before[:, None] == after, axis=2))
    assert np.min(everyone[-40:].sum(axis=1)) < 0.2
