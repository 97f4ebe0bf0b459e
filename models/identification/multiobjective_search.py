"""Multi-objective search in a box of parameters. Hoyer (2021), sections 3.5.5 to 3.5.7.

NSGA-II; NSGA-III of pymoo for many objectives; CMA-ES of pymoo on the sum of the objectives, each
divided by its scale. All use the ask-and-tell interface in the unit cube of the bounds, and a
generation is evaluated in one call.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from math import comb
from typing import Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray
from pymoo.algorithms.moo.nsga3 import NSGA3
from pymoo.algorithms.soo.nonconvex.cmaes import SimpleCMAES
from pymoo.config import Config
from pymoo.core.algorithm import Algorithm as PymooAlgorithm
from pymoo.core.evaluator import Evaluator
from pymoo.core.population import Population
from pymoo.core.problem import Problem
from pymoo.core.termination import NoTermination
from pymoo.operators.crossover.sbx import SBX
from pymoo.operators.mutation.pm import PM
from pymoo.operators.selection.rnd import RandomSelection
from pymoo.problems.static import StaticProblem
from pymoo.util.nds.non_dominated_sorting import NonDominatedSorting
from pymoo.util.ref_dirs import get_reference_directions
from scipy.spatial import cKDTree

from seatrial.models.identification.genetic_algorithm import Nsga2Search, Operators
from seatrial.models.vessel.basis import Array

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


Algorithm = Literal["nsga2", "nsga3", "cmaes"]
Evaluate = Callable[[Array], Array]
CMAES_STEP = 0.3  # initial step size in the unit cube


@dataclass(frozen=True, eq=False)
class Space:
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
    reason: str  # why the search ended: running_metric, generations, floor or algorithm


class Searcher(Protocol):
    """A search algorithm with the ask-and-tell interface, in the unit cube."""

    @property
    def front(self) -> tuple[Array, Array]:
        """Individuals that may be on the front, and their objectives."""
        ...

    @property
    def ended(self) -> bool:
        """Whether the termination criterion of the algorithm itself is met."""
        ...

    def ask(self) -> Array:
        """Individuals to evaluate, shape (n, m)."""
        ...

    def tell(self, values: Array) -> None:
        """Objectives of the individuals asked for, shape (n, n_objectives)."""
        ...


def search(
    evaluate: Evaluate,
    space: Space,
    floor: Array,
    metric: RunningMetric,
    searcher: Searcher,
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
        elif searcher.ended:
            reason = "algorithm"
    return SearchResult(space.points(units), front, metric, generation, reason)


def nondominated(units: Array, values: Array) -> tuple[Array, Array]:
    """The non-dominated points without duplicates, sorted by the first objective.

    units (n, m), values (n, n_objectives).
    """
    _, first = np.unique(values, axis=0, return_index=True)
    best = NonDominatedSorting().do(values[first], only_non_dominated_front=True)
    indices = first[np.sort(best)]
    return units[indices], values[indices]


def searcher(
    algorithm: Algorithm, operators: Operators, scale: Array, m: int, rng: np.random.Generator
) -> Searcher:
    """A search in m variables for objectives of the given scale (n_objectives,)."""
    if algorithm == "nsga2":
        return Nsga2Search(operators, m, rng)
    seed = int(rng.integers(2**31))
    if algorithm == "nsga3":
        return PymooSearch(_nsga3(operators, len(scale)), m, len(scale), None, seed)
    cmaes = PymooSearch(_cmaes(operators), m, 1, scale, seed)
    # by default cma seeds numpy's global generator and draws from it
    cmaes.algorithm.opts["seed"] = np.nan
    cmaes.algorithm.opts["randn"] = lambda *shape: rng.standard_normal(shape)
    return cmaes


class PymooSearch:
    """A search with an algorithm of pymoo.

    With a `scale` (n_objectives,) it minimises the sum of the objectives divided by the scale.
    """

    def __init__(
        self, algorithm: PymooAlgorithm, m: int, objectives: int, scale: Array | None, seed: int
    ) -> None:
        Config.warnings["not_compiled"] = False
        self.cube = Problem(n_var=m, n_obj=objectives, xl=0.0, xu=1.0)
        self.algorithm, self.scale = algorithm, scale
        self.algorithm.setup(self.cube, seed=seed, termination=NoTermination())
        self.individuals = Population()
        self.best: tuple[Array, Array] | None = None

    def ask(self) -> Array:
        """Individuals to evaluate, within the cube."""
        self.individuals = self.algorithm.ask()
        return self._candidates()

    def tell(self, values: Array) -> None:
        """Pass the objectives to pymoo, and store the best of all individuals."""
        units, objectives = self._candidates(), values
        if self.scale is not None:
            objectives = np.sum(values / self.scale, axis=1, keepdims=True)
        Evaluator().eval(StaticProblem(self.cube, F=objectives), self.individuals)
        self.algorithm.tell(infills=self.individuals)
        if self.best is not None:
            units, values = np.vstack([self.best[0], units]), np.vstack([self.best[1], values])
        self.best = nondominated(units, values)

    def _candidates(self) -> Array:
        return np.clip(np.asarray(self.individuals.get("X"), dtype=np.float64), 0.0, 1.0)

    @property
    def front(self) -> tuple[Array, Array]:
        """The population of NSGA-III, or the best of all individuals of CMA-ES."""
        if self.scale is None:
            units, values = self.algorithm.pop.get("X", "F")
            return units.astype(np.float64), values.astype(np.float64)
        assert self.best is not None
        return self.best

    @property
    def ended(self) -> bool:
        """Whether pymoo's termination criterion is met."""
        return bool(self.algorithm.termination.force_termination)


def _nsga3(operators: Operators, objectives: int) -> NSGA3:
    """NSGA-III with at most as many reference directions (Das and Dennis) as individuals."""
    partitions = 1
    while comb(objectives + partitions, partitions + 1) <= operators.population:
        partitions += 1
    directions = get_reference_directions("das-dennis", objectives, n_partitions=partitions)
    return NSGA3(
        directions,
        pop_size=max(operators.population, len(directions)),
        selection=RandomSelection(),
        crossover=SBX(eta=operators.crossover_eta, prob=operators.crossover_probability),
        mutation=PM(eta=operators.mutation_eta, prob=1.0, prob_var=operators.mutation_probability),
    )


def _cmaes(operators: Operators) -> SimpleCMAES:
    """CMA-ES with its default settings except for the population size."""
    return SimpleCMAES(sigma=CMAES_STEP, opts={"popsize": operators.population})
