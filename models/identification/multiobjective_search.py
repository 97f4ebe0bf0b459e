"""Multi-objective search in a box of parameters. Hoyer (2021), sections 3.5.5 to 3.5.7.

NSGA-II in the unit cube of the bounds, which ends by the running metric; a generation is evaluated
in one call.

NSGA-II on arrays, from the operators of pymoo. Hoyer (2021), section 3.5.7 and Table 6.1.

The same algorithm as pymoo's class of that name, Deb et al. (2002): random initial sampling,
binary tournament by rank and crowding distance, simulated binary crossover, polynomial mutation,
survival of the best fronts. pymoo's class stores each individual as an object, and the access to
its attributes takes most of the time of a search. Here a population is two arrays, and duplicates
are found by sorting.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pymoo.operators.crossover.sbx import cross_sbx
from pymoo.operators.mutation.pm import mut_pm
from pymoo.operators.survival.rank_and_crowding.metrics import calc_crowding_distance
from pymoo.util.nds.non_dominated_sorting import NonDominatedSorting
from scipy.spatial import cKDTree

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


# Running performance metric, the change of the front per generation. Blank & Deb (2020b).
#
#     d z*_t   = max_i (z*_i(t-1) - z*_i(t)) / (z_nad_i(t) - z*_i(t))    Hoyer (3.9)
#     d znad_t = max_i (z_nad_i(t-1) - z_nad_i(t)) / (z_nad_i(t) - z*_i(t))
#     phi_t    = mean over the points of P_t of the distance to the nearest one of P_(t-1)
#
# with ideal point z*, nadir point z_nad, and objectives normalised by both at t. The search has
# converged when the magnitudes of all three are below a threshold for `window` generations,
# Hoyer (3.10).


RESOLUTION = 1e-12  # smallest extent of a front, relative to the objectives' scale


class Change(NamedTuple):
    """Change of a front over one generation, normalised."""

    ideal: float
    nadir: float
    front: float


@dataclass
class RunningMetric:
    """History of the changes of a front; scale (n_objectives,) is the size of each objective."""

    scale: Array
    window: int
    threshold: float
    changes: list[Change] = field(default_factory=list)
    last: Array | None = None

    def update(self, front: Array) -> None:
        """Add the front of the next generation, shape (n, n_objectives)."""
        if self.last is not None:
            self.changes.append(change(self.last, front, RESOLUTION * self.scale))
        self.last = front

    @property
    def converged(self) -> bool:
        """Whether all changes of the last `window` generations are below the threshold.

        A front of one point has no extent, so it never counts as converged.
        """
        recent = self.changes[-self.window :]
        if self.last is None or len(self.last) < 2 or len(recent) < self.window:
            return False
        return max(map(max, recent)) < self.threshold


def change(before: Array, after: Array, least: Array) -> Change:
    """Change between the fronts (n, n_objectives) of two generations.

    The extents are at least `least` (n_objectives,).
    """
    ideal, nadir = after.min(axis=0), after.max(axis=0)
    extent = np.maximum(nadir - ideal, least)
    distance = cKDTree((before - ideal) / extent).query((after - ideal) / extent)[0]
    return Change(
        float(np.max(np.abs(before.min(axis=0) - ideal) / extent)),
        float(np.max(np.abs(before.max(axis=0) - nadir) / extent)),
        float(np.mean(distance)),
    )


Evaluate = Callable[[Array], Array]


@dataclass(frozen=True, eq=False)
class ParameterSpace:
    """Box of the m parameters; those with `log` have a logarithmic scale."""

    lower: Array  # (m,)
    upper: Array  # (m,)
    log: NDArray[np.bool_]  # (m,)

    def points(self, unit: Array) -> Array:
        """Design points (n, m) from points (n, m) in the unit cube."""
        linear = self.lower + unit * (self.upper - self.lower)
        ratio = np.where(self.log, self.upper / np.where(self.log, self.lower, 1.0), 1.0)
        return np.where(self.log, self.lower * ratio**unit, linear)


@dataclass(frozen=True, eq=False)
class SearchResult:
    """The result of a search; the front has no duplicates and no dominated point."""

    points: Array  # (n, m)
    front: Array  # (n, n_objectives)
    metric: RunningMetric
    generations: int
    reason: str  # why the search ended: running_metric, generations or floor


def search(
    evaluate: Evaluate,
    space: ParameterSpace,
    floor: Array,
    metric: RunningMetric,
    searcher: Nsga2Search,
    generations: int,
) -> SearchResult:
    """Search until the running metric converges, a point reaches the floor, or for `generations`.

    `floor` (n_objectives,) are the values of the objectives that count as zero.
    """
    reason, generation = "generations", 0
    units = front = np.zeros((0, 0))
    while reason == "generations" and generation < generations:
        generation += 1
        searcher.tell(evaluate(space.points(searcher.ask())))
        units, front = nondominated(*searcher.front)
        metric.update(front)
        if np.any(np.all(front <= floor, axis=1)):
            reason = "floor"
        elif metric.converged:
            reason = "running_metric"
    return SearchResult(space.points(units), front, metric, generation, reason)


def nondominated(units: Array, values: Array) -> tuple[Array, Array]:
    """The non-dominated points without duplicates, sorted by the first objective.

    units (n, m), values (n, n_objectives).
    """
    _, first = np.unique(values, axis=0, return_index=True)
    best = NonDominatedSorting().do(values[first], only_non_dominated_front=True)
    indices = first[np.sort(best)]
    return units[indices], values[indices]
