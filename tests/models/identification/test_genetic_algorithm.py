"""NSGA-II on arrays against pymoo's own class, and its parts by hand."""

import numpy as np
import pytest

from seatrial.models.identification.multiobjective_search import (
    Nsga2Search,
    Operators,
    Population,
    crossed,
    mutated,
    offspring,
    survivors,
    tournament,
)

OPERATORS = Operators(100, 15.0, 0.9, 15.0, 1.0 / 3.0)


def convex(points):
    """ZDT1 in three variables: the front is f2 = 1 - sqrt(f1)."""
    g = 1.0 + 9.0 * points[:, 1:].mean(axis=1)
    return np.column_stack([points[:, 0], g * (1.0 - np.sqrt(points[:, 0] / g))])


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


def test_tournament_takes_lower_rank_then_wider_crowding():
    rng = np.random.default_rng(0)
    values = np.zeros((3, 2))
    pop = Population(np.zeros((3, 1)), values, np.array([0, 1, 0]), np.array([1.0, 9.0, 2.0]))
    wins = np.bincount(tournament(pop, 6000, rng).ravel(), minlength=3) / 6000
    # pairs of one permutation after the other: 2 wins all its pairs with others, 1 none
    assert wins[2] > wins[0] > wins[1]
    even = pop._replace(rank=np.zeros(3, dtype=int), crowding=np.ones(3))
    shares = np.bincount(tournament(even, 6000, rng).ravel(), minlength=3) / 6000
    np.testing.assert_allclose(shares, 1.0 / 3.0, atol=0.03)


@pytest.mark.parametrize("children", [1, 2, 99, 100])
def test_offspring_differ_from_each_other_and_their_parents(children):
    rng = np.random.default_rng(0)
    operators = Operators(children, 15.0, 0.0, 15.0, 1.0 / 3.0)  # without crossover many are equal
    units = rng.random((100, 3))
    pop = survivors(units, convex(units), 100)
    born = offspring(pop, operators, rng)
    assert born.shape == (children, 3)
    everyone = np.vstack([units, born])
    assert len(np.unique(everyone, axis=0)) == len(everyone)
    assert np.all((born >= 0.0) & (born <= 1.0))


def test_offspring_end_where_nothing_new_can_be_born():
    rng = np.random.default_rng(0)
    operators = Operators(10, 15.0, 0.0, 15.0, 0.0)
    units = rng.random((10, 2))
    assert len(offspring(survivors(units, units, 10), operators, rng)) == 0


def test_crossover_keeps_the_mean_of_the_parents():
    rng = np.random.default_rng(0)
    parents = 0.5 + 0.1 * rng.standard_normal((2, 500, 2))
    children = crossed(parents, OPERATORS, rng).reshape(2, 500, 2)
    np.testing.assert_allclose(children.mean(axis=0), parents.mean(axis=0), atol=0.02)
    assert np.mean(np.any(children != parents, axis=(0, 2))) == pytest.approx(0.68, abs=0.05)


def test_mutation_changes_one_variable_on_average():
    rng = np.random.default_rng(0)
    units = np.full((3000, 3), 0.5)
    changed = mutated(units, OPERATORS, rng) != units
    assert np.mean(changed.sum(axis=1)) == pytest.approx(1.0, abs=0.06)
