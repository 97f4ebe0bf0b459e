"""Identification by multi-objective search. Hoyer (2021), chapter 6.

Step 1: objectives between measured and predicted states, section 6.2.1. Step 2: their Pareto
front, section 6.2.2, by pymoo's NSGA-II, Deb et al. (2002), in the unit cube of the bounds; a
generation is evaluated in one call. It ends by the running performance metric, the change of the
front per generation, Blank & Deb (2020b):

    d z*_t   = max_i (z*_i(t-1) - z*_i(t)) / (z_nad_i(t) - z*_i(t))    Hoyer (3.9)
    d znad_t = max_i (z_nad_i(t-1) - z_nad_i(t)) / (z_nad_i(t) - z*_i(t))
    phi_t    = mean over the points of P_t of the distance to the nearest one of P_(t-1)

with ideal point z*, nadir point z_nad, and objectives normalised by both at t. The search has
converged when the magnitudes of all three are below a threshold for `window` generations, (3.10).

Step 3: one point of the front, section 6.2.3. Beyond the thesis, the fit of `output_error` can
polish it, which also gives standard errors; the front itself has none.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import scipy
from annotated_types import Ge, Le
from numpy.typing import NDArray
from pymoo.algorithms.moo.nsga2 import NSGA2
from pymoo.core.duplicate import DuplicateElimination
from pymoo.core.problem import Problem as DesignProblem
from pymoo.core.termination import NoTermination
from pymoo.operators.crossover.sbx import SBX
from pymoo.operators.mutation.pm import PM

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError
from seatrial.models.identification.free_parameters import FreeParameters
from seatrial.models.identification.objectives import Metric, Objectives, objective_diagnostics
from seatrial.models.identification.output_error import check_horizons, fit_through, model_of
from seatrial.models.identification.predictor import PredictionOptions, active_bounds
from seatrial.models.identification.problem import Identified, Problem
from seatrial.models.ranges import NotNegative, Positive, PositiveInt
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

FRONT_RESOLUTION = 1e-12  # smallest extent of a front, relative to the objectives' scale
CROSSOVER, ETA = 0.9, 15.0  # probability, and index of both operators: Hoyer (2021), Table 6.1
Decision = Literal["knee", "ideal", "pseudo_weights"]


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


def change(before: Array, after: Array, least: Array) -> Change:
    """Change between the fronts (n, n_objectives) of two generations.

    The extents are at least `least` (n_objectives,).
    """
    ideal, nadir = after.min(axis=0), after.max(axis=0)
    extent = np.maximum(nadir - ideal, least)
    distance = scipy.spatial.cKDTree((before - ideal) / extent).query((after - ideal) / extent)[0]
    return Change(
        float(np.max(np.abs(before.min(axis=0) - ideal) / extent)),
        float(np.max(np.abs(before.max(axis=0) - nadir) / extent)),
        float(np.mean(distance)),
    )


class SearchResult(NamedTuple):
    """The result of a search; the front has no duplicates and no dominated point."""

    points: Array  # (n, m)
    front: Array  # (n, n_objectives)
    changes: list[Change]  # in every generation but the first
    reason: str  # why the search ended: running_metric, generations or floor


def search(
    evaluate: Callable[[Array], Array], box: tuple[Array, Array], scale: Array, floor: float,
    window: int, threshold: float, population: int, generations: int, rng: np.random.Generator,
) -> SearchResult:  # fmt: skip
    """Search for a number of generations, or until one of two things happens before.

    A point reaches `floor` times the `scale` (n_objectives,) of the objectives, or the front has
    changed by less than `threshold` in the last `window` generations; one point never has. The
    objectives (n, n_objectives) are those of design points (n, m) in the `box` of bounds (m,).
    """
    (lower, upper), m = box, len(box[0])

    class Objectives(DesignProblem):  # type: ignore[misc]
        def _evaluate(self, x: Array, out: dict[str, Array], *_: Any, **__: Any) -> None:
            out["F"] = evaluate(lower + x * (upper - lower))

    algorithm = NSGA2(
        pop_size=population, crossover=SBX(eta=ETA, prob=CROSSOVER),
        mutation=PM(eta=ETA, prob=1.0, prob_var=1.0 / m), eliminate_duplicates=_Distinct(),
    )  # fmt: skip
    problem, seed = Objectives(n_var=m, n_obj=len(scale), xl=0.0, xu=1.0), int(rng.integers(2**31))
    algorithm.setup(problem, seed=seed, termination=NoTermination())
    reason, changes = "generations", list[Change]()
    units, front = np.zeros((0, m)), np.zeros((0, len(scale)))
    for _ in range(generations):
        if not algorithm.has_next():
            break
        algorithm.next()
        before = front
        front, first = np.unique(algorithm.opt.get("F"), axis=0, return_index=True)
        units = algorithm.opt.get("X")[first]
        if len(before):
            changes.append(change(before, front, FRONT_RESOLUTION * scale))
        recent = changes[-window:] if len(front) > 1 else []
        if np.any(np.all(front <= floor * scale, axis=1)):
            reason = "floor"
            break
        if len(recent) == window and max(map(max, recent)) < threshold:
            reason = "running_metric"
            break
    return SearchResult(lower + units * (upper - lower), front, changes, reason)


def normalised(front: Array) -> Array:
    """(f - ideal) / (nadir - ideal), shape (n, n_objectives)."""
    ideal, nadir = front.min(axis=0), front.max(axis=0)
    return np.asarray((front - ideal) / np.where(nadir > ideal, nadir - ideal, 1.0))


def knees(front: Array) -> NDArray[np.int64]:
    """Indices of the high trade-off points of a front (n, n_objectives). Blank & Deb (2020a).

    mu_i = min over neighbours j of sum max(0, f_j - f_i) / sum max(0, f_i - f_j): the least
    sacrifice per gain when moving from point i to a neighbour. A knee is an outlier: mu exceeds its
    mean by two standard deviations, or it is the largest one and exceeds it by one.
    """
    if len(front) < 3:
        return np.zeros(0, dtype=np.int64)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pymoo imports what scipy has renamed, and sets a filter
        from pymoo.mcdm.high_tradeoff import HighTradeoffPoints

        found = HighTradeoffPoints().do(normalised(front))
    return np.array([] if found is None else found, dtype=np.int64)


def pseudo_weights(front: Array) -> Array:
    """Pseudo-weights w_ij: share of objective j in the distance of point i from the nadir."""
    distance = 1.0 - normalised(front)
    total = distance.sum(axis=1, keepdims=True)
    return np.asarray(distance / np.where(total > 0.0, total, 1.0))


def choose(front: Array, decision: Decision, weights: tuple[float, ...] | None) -> tuple[int, str]:
    """Index of the chosen point and the rule that chose it.

    `knee` chooses the knee nearest to the ideal point, or else the nearest point; `pseudo_weights`
    that whose pseudo-weights are nearest to `weights` (null: equal ones).
    """
    if decision == "pseudo_weights":
        target = np.ones(front.shape[1]) if weights is None else np.array(weights)
        target = target / np.sum(target)
        return int(np.argmin(np.abs(pseudo_weights(front) - target).sum(axis=1))), decision
    indices = knees(front) if decision == "knee" else np.zeros(0, dtype=np.int64)
    rule = "knee" if len(indices) else "ideal"
    indices = indices if len(indices) else np.arange(len(front))
    return int(indices[np.argmin(np.linalg.norm(normalised(front)[indices], axis=1))]), rule


@dataclass(frozen=True)
class Nsga2(PredictionOptions):
    """Pareto front of the prediction errors, and one point of it.

    It ends as `search` does; `objective_floor` is relative to the spread of the measured states.
    """

    objective: Metric
    grouped: bool
    population: Annotated[int, Ge(4), Le(10_000)] | None
    population_cap: Annotated[int, Ge(4), Le(10_000)]
    generations: PositiveInt
    window: PositiveInt
    threshold: Positive
    objective_floor: NotNegative
    decision: Decision
    weights: tuple[Positive, ...] | None
    polish: Literal["output_error"] | None
    polish_horizons: tuple[int, ...]

    def check(self, nominal: Vessel, thruster: SecondOrderLag | None, measured: bool) -> None:
        """Raise ConfigurationError for missing bounds or a wrong number of weights."""
        check_horizons(self.polish_horizons)
        for label in self.unknowns(nominal, windy=True).labels:
            if self.inertia_factor is None and label not in self.bounds:
                raise ConfigurationError(f"bounds.{label}: got none, expected [lower, upper]")
        count = 2 if self.grouped else 2 * len(nominal.dofs)
        if self.weights is not None and len(self.weights) != count:
            raise ConfigurationError(
                f"identifier.weights: got {len(self.weights)}, expected {count}"
            )

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """The residual table of the chosen (and polished) point, with the front as diagnostics."""
        self.check(problem.nominal, problem.thruster, measured=False)
        predictor = self.predictor(problem)
        free, objectives = predictor.free, Objectives(predictor, self.objective, self.grouped)
        box = self.box(free, problem.training)
        population = self.population or min(10 ** min(len(free), 9), self.population_cap)
        result = search(
            objectives, box, objectives.floor, self.objective_floor, self.window, self.threshold,
            population, self.generations, rng,
        )  # fmt: skip
        chosen, rule = choose(result.front, self.decision, self.weights)
        diagnostics = front_diagnostics(free, objectives, result)
        diagnostics.append(Diagnostic("pareto_chosen", "all", float(chosen), i=chosen, label=rule))
        point, note = result.points[chosen], f"nsga2: point {chosen} of its front by `{rule}`"
        if self.polish is None:
            identified = Identified(
                free.model(problem.nominal, point), free.residual(point),
                diagnostics=tuple(active_bounds(free, point, box)),
            )  # fmt: skip
        else:
            polished = fit_through(self, problem, point, self.polish_horizons, "estimated")
            identified = model_of(self, problem, polished)
            points = np.array([point, polished.parameters])
            squares = Objectives(predictor, "mse", grouped=True)(points)
            misfits = np.sqrt(np.mean(squares, axis=1)).tolist()  # of free runs, over the spread
            for label, misfit in zip(("before", "after"), misfits, strict=True):
                diagnostics.append(Diagnostic("polish_misfit", "all", misfit, label=label))
            point, gain = points[1], "misfit {:.3g} -> {:.3g} of the spread".format(*misfits)
            note += f", polished from there: {gain}"
        diagnostics += objective_diagnostics(objectives, point)
        notes, diagnostics = (note, *identified.notes), [*diagnostics, *identified.diagnostics]
        return replace(identified, notes=notes, diagnostics=tuple(diagnostics))


def front_diagnostics(
    free: FreeParameters, objectives: Objectives, result: SearchResult
) -> list[Diagnostic]:
    """All points of the Pareto set, and the history of the running metric."""
    parameters = list(zip(free.dofs, free.labels, free.units, strict=True))
    diagnostics = []
    for i, pair in enumerate(zip(result.points, result.front, strict=True)):
        names = ("pareto_parameter", parameters), ("pareto_objective", objectives.labels)
        for (name, rows), values in zip(names, pair, strict=True):
            diagnostics += [
                Diagnostic(name, dof, float(value), unit, i, j, label)
                for j, ((dof, label, unit), value) in enumerate(zip(rows, values, strict=True))
            ]
    for i, step in enumerate(result.changes, start=2):
        for j, (label, value) in enumerate(step._asdict().items()):
            diagnostics.append(Diagnostic("running_metric", "all", value, "", i, j, label))
    count = float(len(result.changes) + 1)
    return [*diagnostics, Diagnostic("generations", "all", count, label=result.reason)]
