"""Multi-objective search in a box of parameters. Hoyer (2021), sections 3.5.5 to 3.5.7.

pymoo's NSGA-II (Deb et al. (2002); Hoyer, Table 6.1) in the unit cube of the bounds; a generation
is evaluated in one call. It ends by the running performance metric, the change of the front per
generation, Blank & Deb (2020b):

    d z*_t   = max_i (z*_i(t-1) - z*_i(t)) / (z_nad_i(t) - z*_i(t))    Hoyer (3.9)
    d znad_t = max_i (z_nad_i(t-1) - z_nad_i(t)) / (z_nad_i(t) - z*_i(t))
    phi_t    = mean over the points of P_t of the distance to the nearest one of P_(t-1)

with ideal point z*, nadir point z_nad, and objectives normalised by both at t. The search has
converged when the magnitudes of all three are below a threshold for `window` generations,
Hoyer (3.10).
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pymoo.algorithms.moo.nsga2 import NSGA2
from pymoo.core.duplicate import DuplicateElimination
from pymoo.core.problem import Problem
from pymoo.core.termination import NoTermination
from pymoo.operators.crossover.sbx import SBX
from pymoo.operators.mutation.pm import PM
from pymoo.util.nds.non_dominated_sorting import NonDominatedSorting
from scipy.spatial import cKDTree

from seatrial.models.vessel.basis import Array

RESOLUTION = 1e-12  # smallest extent of a front, relative to the objectives' scale
Evaluate = Callable[[Array], Array]


@dataclass(frozen=True)
class Operators:
    """Population size and operator settings; `mutation_probability` applies to each variable."""

    population: int
    crossover_eta: float
    crossover_probability: float
    mutation_eta: float
    mutation_probability: float

    def algorithm(self) -> NSGA2:
        """The algorithm of pymoo."""
        return NSGA2(
            pop_size=self.population,
            crossover=SBX(eta=self.crossover_eta, prob=self.crossover_probability),
            mutation=PM(eta=self.mutation_eta, prob=1.0, prob_var=self.mutation_probability),
            eliminate_duplicates=_Distinct(),
        )


class _Distinct(DuplicateElimination):  # type: ignore[misc]
    """Equal individuals found by sorting: pymoo's distances of all pairs need 2 GB for 10,000."""

    def _do(self, pop: Any, other: Any, is_duplicate: NDArray[np.bool_]) -> NDArray[np.bool_]:
        before = np.zeros((0, pop[0].X.size)) if other is None else other.get("X")
        _, first = np.unique(np.vstack([before, pop.get("X")]), axis=0, return_index=True)
        is_duplicate[:] = True
        is_duplicate[first[first >= len(before)] - len(before)] = False
        return is_duplicate


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
    operators: Operators,
    generations: int,
    rng: np.random.Generator,
) -> SearchResult:
    """Search until the running metric converges, a point reaches the floor, or for `generations`.

    `floor` (n_objectives,) are the values of the objectives that count as zero.
    """

    class Objectives(Problem):  # type: ignore[misc]
        def _evaluate(self, x: Array, out: dict[str, Array], *_: Any, **__: Any) -> None:
            out["F"] = evaluate(space.points(x))

    algorithm, seed = operators.algorithm(), int(rng.integers(2**31))
    problem = Objectives(n_var=len(space.lower), n_obj=len(floor), xl=0.0, xu=1.0)
    algorithm.setup(problem, seed=seed, termination=NoTermination())
    reason, generation = "generations", 0
    units = front = np.zeros((0, 0))
    while reason == "generations" and generation < generations and algorithm.has_next():
        generation += 1
        algorithm.next()
        units, front = nondominated(algorithm.opt.get("X"), algorithm.opt.get("F"))
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
