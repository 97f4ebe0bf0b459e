"""NSGA-II against pymoo's own class and on known fronts, and the running metric."""

import numpy as np
import pytest

from seatrial.models.identification.multiobjective_search import (
    Nsga2Search,
    Operators,
    ParameterSpace,
    RunningMetric,
    change,
    search,
    survivors,
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
    searcher = Nsga2Search(operators, 3, rng)
    return search(evaluate, BOX, np.full(2, floor), metric(**watch), searcher, generations)


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


def hypervolume(front):
    """Area that a front of two objectives dominates below (1.1, 1.1)."""
    inside = front[np.all(front < 1.1, axis=1)]
    f1, f2 = inside[np.argsort(inside[:, 0])].T
    lowest = np.minimum.accumulate(f2)
    return float(np.sum(np.diff(np.append(f1, 1.1)) * (1.1 - lowest)))


def ours(seed, population, generations):
    operators = Operators(population, 15.0, 0.9, 15.0, 1.0 / 3.0)
    found = Nsga2Search(operators, 3, np.random.default_rng(seed))
    for _ in range(generations):
        found.tell(convex(found.ask()))
    return found.front[1]


def theirs(seed, population, generations):
    from pymoo.algorithms.moo.nsga2 import NSGA2
    from pymoo.core.problem import Problem
    from pymoo.core.termination import NoTermination
    from pymoo.operators.crossover.sbx import SBX
    from pymoo.operators.mutation.pm import PM

    class Zdt(Problem):
        def _evaluate(self, x, out, *args, **kwargs):
            out["F"] = convex(x)

    algorithm = NSGA2(
        pop_size=population,
        crossover=SBX(eta=15.0, prob=0.9),
        mutation=PM(eta=15.0, prob=1.0, prob_var=1.0 / 3.0),
    )
    problem = Zdt(n_var=3, n_obj=2, xl=0.0, xu=1.0)
    algorithm.setup(problem, seed=seed, termination=NoTermination())
    for _ in range(generations):
        algorithm.next()
    return algorithm.opt.get("F")


def test_it_gains_on_the_front_as_pymoo_does():
    """Hypervolume after 5, 15 and 40 generations, mean of ten seeds."""
    for generations in (5, 15, 40):
        mine, peer = (
            np.array([hypervolume(search(seed, 40, generations)) for seed in range(10)])
            for search in (ours, theirs)
        )
        error = np.sqrt((np.var(mine) + np.var(peer)) / 10)
        assert np.mean(mine) == pytest.approx(np.mean(peer), abs=3.0 * error + 1e-3)


def test_survivors_are_whole_fronts_and_the_least_crowded_of_the_last():
    values = np.array([[0.0, 4.0], [4.0, 0.0], [2.0, 2.0], [1.0, 3.0], [1.1, 2.9], [5.0, 5.0]])
    kept = survivors(np.arange(6.0)[:, None], values, 4)
    assert set(kept.units[:, 0]) == {0.0, 1.0, 2.0, 3.0}
    assert kept.rank.tolist() == [0, 0, 0, 0]
    kept = survivors(np.arange(6.0)[:, None], np.vstack([values, values + 1.0])[:6], 6)
    assert sorted(kept.rank.tolist()) == [0, 0, 0, 0, 0, 1]
