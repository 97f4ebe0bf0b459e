"""NSGA-II on arrays, from the operators of pymoo. Hoyer (2021), section 3.5.7 and Table 6.1.

The same algorithm as pymoo's class of that name, Deb et al. (2002): random initial sampling,
binary tournament by rank and crowding distance, simulated binary crossover, polynomial mutation,
survival of the best fronts. pymoo's class stores each individual as an object, and the access to
its attributes takes most of the time of a search. Here a population is two arrays, and duplicates
are found by sorting.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pymoo.operators.crossover.sbx import cross_sbx
from pymoo.operators.mutation.pm import mut_pm
from pymoo.operators.survival.rank_and_crowding.metrics import calc_crowding_distance
from pymoo.util.nds.non_dominated_sorting import NonDominatedSorting

from seatrial.models.vessel.basis import Array

Indices = NDArray[np.int64]
ATTEMPTS = 100  # to fill a generation with distinct individuals


@dataclass(frozen=True)
class Operators:
    """Population size and operator settings; `mutation_probability` applies to each variable."""

    population: int
    crossover_eta: float
    crossover_probability: float
    mutation_eta: float
    mutation_probability: float


class Population(NamedTuple):
    """Individuals in the unit cube with their objectives, rank and crowding distance."""

    units: Array  # (n, m)
    values: Array  # (n, n_objectives)
    rank: Indices  # (n,) number of the front, 0: not dominated
    crowding: Array  # (n,)


class Nsga2Search:
    """NSGA-II by ask and tell in the unit cube of m variables."""

    def __init__(self, operators: Operators, m: int, rng: np.random.Generator) -> None:
        self.operators, self.rng = operators, rng
        self.population: Population | None = None
        self.individuals = rng.random((operators.population, m))

    def ask(self) -> Array:
        """Individuals to evaluate, shape (n, m)."""
        if self.population is not None:
            self.individuals = offspring(self.population, self.operators, self.rng)
        return self.individuals

    def tell(self, values: Array) -> None:
        """Objectives of the individuals asked for, shape (n, n_objectives)."""
        units, size = self.individuals, self.operators.population
        if self.population is not None:
            units = np.vstack([self.population.units, units])
            values = np.vstack([self.population.values, values])
        self.population = survivors(units, values, size)

    @property
    def front(self) -> tuple[Array, Array]:
        """Individuals that no other dominates, and their objectives."""
        assert self.population is not None
        best = self.population.rank == 0
        return self.population.units[best], self.population.values[best]


def survivors(units: Array, values: Array, size: int) -> Population:
    """The best `size` individuals: complete fronts, and the least crowded of the last front.

    units (n, m), values (n, n_objectives).
    """
    indices, ranks, crowdings = [], [], []
    remaining = size
    for rank, front in enumerate(NonDominatedSorting().do(values, n_stop_if_ranked=size)):
        crowding = np.full(len(front), np.inf)
        if len(front) > 2:
            crowding = calc_crowding_distance(values[front])
        if len(front) > remaining:
            least_crowded = np.argsort(-crowding, kind="stable")[:remaining]
            front, crowding = front[least_crowded], crowding[least_crowded]
        indices.append(front)
        crowdings.append(crowding)
        ranks.append(np.full(len(front), rank))
        remaining -= len(front)
        if remaining == 0:
            break
    index = np.concatenate(indices)
    return Population(units[index], values[index], np.concatenate(ranks), np.concatenate(crowdings))


def offspring(population: Population, operators: Operators, rng: np.random.Generator) -> Array:
    """New distinct individuals, as many as the population has, shape (n, m)."""
    parents_units, size = population.units, operators.population
    children = np.zeros((0, parents_units.shape[1]))
    for _ in range(ATTEMPTS):
        pairs = tournament(population, size - len(children), rng)
        candidates = mutated(crossed(parents_units[pairs], operators, rng), operators, rng)
        units = np.vstack([parents_units, children, candidates])
        _, first = np.unique(units, axis=0, return_index=True)
        new = np.sort(first[first >= len(parents_units) + len(children)])
        children = np.vstack([children, units[new]])[:size]
        if len(children) == size:
            break
    return children


def tournament(population: Population, children: int, rng: np.random.Generator) -> Indices:
    """Winners of random pairs as parents, shape (2, children / 2): lower rank, then less crowded.

    Every individual takes part equally often, except in the last round.
    """
    matings = -(-children // 2)
    rounds = -(-4 * matings // len(population.rank))
    order = np.concatenate([rng.permutation(len(population.rank)) for _ in range(rounds)])
    a, b = order[: 4 * matings].reshape(2, -1)
    rank, crowding = population.rank, population.crowding
    random_choice = rng.random(len(a)) < 0.5
    prefer_first = np.where(crowding[a] == crowding[b], random_choice, crowding[a] > crowding[b])
    wins = np.where(rank[a] == rank[b], prefer_first, rank[a] < rank[b])
    return np.where(wins, a, b).reshape(2, matings)


def crossed(parents: Array, operators: Operators, rng: np.random.Generator) -> Array:
    """Children of pairs of parents (2, n, m) by simulated binary crossover, shape (2 n, m)."""
    _, n, m = parents.shape
    eta, half = np.full((n, 1), operators.crossover_eta), np.full((n, 1), 0.5)
    # pymoo's defaults: half of the variables are crossed, half of these are exchanged
    children = cross_sbx(parents, np.zeros(m), np.ones(m), eta, half, half, random_state=rng)
    mates = np.asarray(rng.random(n) < operators.crossover_probability)
    return np.where(mates[:, None], children, parents).reshape(2 * n, m)


def mutated(units: Array, operators: Operators, rng: np.random.Generator) -> Array:
    """Individuals after polynomial mutation, shape (n, m)."""
    n, m = units.shape
    eta = np.full(n, operators.mutation_eta)
    probability = np.full(n, operators.mutation_probability)
    return np.asarray(
        mut_pm(
            units, np.zeros(m), np.ones(m), eta, probability, at_least_once=False, random_state=rng
        )
    )
