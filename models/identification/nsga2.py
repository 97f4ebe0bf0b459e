"""Identification by multi-objective search. Hoyer (2021), chapter 6.

Step 1: objectives between measured and predicted states, section 6.2.1. Step 2: their Pareto
front by NSGA-II, section 6.2.2. Step 3: one point of the front, section 6.2.3: objectives are
normalised to [0, 1] over the front; an objective in which the front has no extent is 0 for every
point. Beyond the thesis, the fit of `output_error` can polish the chosen point, which also gives
standard errors; the front itself has none. The result is the chosen point or what the polish has
made of it, and nothing else.
"""

from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError
from seatrial.models.identification.free_parameters import FreeParameters
from seatrial.models.identification.multiobjective_search import (
    Operators,
    ParameterSpace,
    RunningMetric,
    SearchResult,
    search,
)
from seatrial.models.identification.objectives import Metric, Objectives, objective_diagnostics
from seatrial.models.identification.output_error import check_horizons, fit_through, model_of
from seatrial.models.identification.predictor import PredictionOptions, active_bounds
from seatrial.models.identification.problem import Identified, Problem
from seatrial.models.ranges import NotNegative, Positive, PositiveInt
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

RADIUS = 0.125  # of the neighbourhood in which trade-offs are compared, in normalised objectives
KNEE_DEVIATIONS = 2.0  # standard deviations above the mean trade-off that make a knee
Decision = Literal["knee", "ideal", "pseudo_weights"]


def normalised(front: Array) -> Array:
    """(f - ideal) / (nadir - ideal), shape (n, n_objectives)."""
    ideal, nadir = front.min(axis=0), front.max(axis=0)
    extent = np.where(nadir > ideal, nadir - ideal, 1.0)
    return np.asarray((front - ideal) / extent)


def nearest_to_ideal(front: Array) -> int:
    """The point with the smallest normalised distance to the ideal point."""
    return int(np.argmin(np.linalg.norm(normalised(front), axis=1)))


def knees(front: Array) -> NDArray[np.int64]:
    """Indices of the high trade-off points of a front (n, n_objectives). Blank & Deb (2020a).

    mu_i = min over neighbours j of sum max(0, f_j - f_i) / sum max(0, f_i - f_j): the least
    sacrifice per gain when moving from point i to a neighbour. A knee is an outlier: mu exceeds its
    mean by two standard deviations, or it is the largest one and exceeds it by one. The result may
    be empty, and is for fewer than three points.
    """
    points = normalised(front)
    n, m = points.shape
    if n < 3:
        return np.zeros(0, dtype=np.int64)
    tree, least = cKDTree(points), min(2 * m, n - 1)
    mu = np.full(n, np.nan)
    for i, point in enumerate(points):
        near = tree.query_ball_point(point, RADIUS)
        if len(near) < least:
            near = tree.query(point, k=least + 1)[1]
        change = points[near] - point
        sacrifice = np.maximum(change, 0.0).sum(axis=1)
        gain = np.maximum(-change, 0.0).sum(axis=1)
        useful = gain > 0.0
        if np.any(useful):
            mu[i] = np.min(sacrifice[useful] / gain[useful])
    finite = np.flatnonzero(np.isfinite(mu))
    if len(finite) < 2 or np.ptp(mu[finite]) == 0.0:
        return np.zeros(0, dtype=np.int64)
    deviation = (mu[finite] - np.mean(mu[finite])) / np.std(mu[finite])
    if np.max(deviation) >= KNEE_DEVIATIONS:
        return np.asarray(finite[deviation >= KNEE_DEVIATIONS])
    return finite[[np.argmax(deviation)]] if np.max(deviation) > 1.0 else finite[:0]


def pseudo_weights(front: Array) -> Array:
    """Pseudo-weights w_ij: share of objective j in the distance of point i from the nadir."""
    distance = 1.0 - normalised(front)
    total = distance.sum(axis=1, keepdims=True)
    return np.asarray(distance / np.where(total > 0.0, total, 1.0))


def choose(front: Array, decision: Decision, weights: tuple[float, ...] | None) -> tuple[int, str]:
    """Index of the chosen point and the rule that chose it.

    `knee` chooses the knee nearest to the ideal point; if there is none, the nearest point of the
    front. `pseudo_weights` chooses the point whose pseudo-weights are nearest to `weights` (null:
    equal weights).
    """
    if decision == "pseudo_weights":
        target = np.ones(front.shape[1]) if weights is None else np.array(weights)
        target = target / np.sum(target)
        return int(np.argmin(np.abs(pseudo_weights(front) - target).sum(axis=1))), decision
    indices = knees(front) if decision == "knee" else np.zeros(0, dtype=np.int64)
    if len(indices):
        distance = np.linalg.norm(normalised(front)[indices], axis=1)
        return int(indices[np.argmin(distance)]), "knee"
    return nearest_to_ideal(front), "ideal"


@dataclass(frozen=True)
class Nsga2(PredictionOptions):
    """Pareto front of the prediction errors, and one point of it.

    `objective` is the error of a state, `grouped` combines the states into two objectives. The
    parameters in `log_scale` (`all` for every one whose bounds have one sign) have a logarithmic
    scale. The population size is `population`, or (null) 10^m for m parameters, at most
    `population_cap`. The search ends when the running metric stays below `threshold` for `window`
    generations, after `generations`, or when all objectives of one point are below
    `objective_floor` times the spread of the measured states. `mutation_probability` of each
    parameter is by default 1/m. `decision` chooses the point, with `weights` of the objectives for
    pseudo_weights. `polish: output_error` fits the free run from it, with the `polish_horizons`
    (samples) first.
    """

    objective: Metric
    grouped: bool
    log_scale: tuple[str, ...]
    population: Annotated[int, Ge(4), Le(10_000)] | None
    population_cap: Annotated[int, Ge(4), Le(10_000)]
    generations: PositiveInt
    crossover_eta: Positive
    crossover_probability: float
    mutation_eta: Positive
    mutation_probability: float | None
    window: PositiveInt
    threshold: Positive
    objective_floor: NotNegative
    decision: Decision
    weights: tuple[Positive, ...] | None
    polish: Literal["output_error"] | None
    polish_horizons: tuple[int, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("crossover_probability", "mutation_probability"):
            value = getattr(self, name)
            if value is not None and not 0.0 <= value <= 1.0:
                raise ConfigurationError(f"{name} must lie in [0, 1], got {value}")
        check_horizons(self.polish_horizons)

    def check(self, nominal: Vessel, thruster: SecondOrderLag | None, measured: bool) -> None:
        """Raise ConfigurationError for missing bounds or a wrong number of weights."""
        free = self.unknowns(nominal, windy=True)
        self.check_bounded(free)
        lower, upper = self.box(free)
        for label in self.log_scale:
            if label not in ("all", *free.labels):
                raise ConfigurationError(
                    f"identifier.log_scale: got {label!r}, expected all or some of "
                    f"{', '.join(free.labels)}"
                )
            i = free.labels.index(label) if label in free.labels else None
            if i is not None and not lower[i] * upper[i] > 0.0:
                raise ConfigurationError(
                    f"identifier.log_scale: the bounds of {label} must have one sign"
                )
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
        space = self._space(free, problem)
        result = self._search(objectives, space, rng)
        chosen, rule = choose(result.front, self.decision, self.weights)
        diagnostics = front_diagnostics(free, objectives, result)
        diagnostics.append(Diagnostic("pareto_chosen", "all", float(chosen), i=chosen, label=rule))
        point = result.points[chosen]
        if self.polish is None:
            bounds = active_bounds(free, point, (space.lower, space.upper))
            model, residual = free.model(problem.nominal, point), free.residual(point)
            identified = Identified(model, residual, diagnostics=tuple(bounds))
        else:
            polished = fit_through(self, problem, point, self.polish_horizons, None, "estimated")
            identified = model_of(self, problem, polished)
            points = np.array([point, polished.parameters])
            diagnostics += polish_diagnostics(objectives, points)
            point = points[1]
        diagnostics += objective_diagnostics(objectives, point)
        return replace(identified, diagnostics=(*diagnostics, *identified.diagnostics))

    def _space(self, free: FreeParameters, problem: Problem) -> ParameterSpace:
        """Bounds and scales of the search."""
        lower, upper = self.box(free, problem.training)
        one_sign = lower * upper > 0.0
        listed = np.isin(free.labels, self.log_scale)
        return ParameterSpace(lower, upper, one_sign if "all" in self.log_scale else listed)

    def _search(
        self, objectives: Objectives, space: ParameterSpace, rng: np.random.Generator
    ) -> SearchResult:
        m = len(space.lower)
        size = self.population or min(10 ** min(m, 9), self.population_cap)
        probability = 1.0 / m if self.mutation_probability is None else self.mutation_probability
        operators = Operators(
            size, self.crossover_eta, self.crossover_probability, self.mutation_eta, probability
        )
        scale = objectives.floor
        metric = RunningMetric(scale, self.window, self.threshold)
        floor = self.objective_floor * scale
        return search(objectives, space, floor, metric, operators, self.generations, rng)


def polish_diagnostics(objectives: Objectives, points: Array) -> list[Diagnostic]:
    """The misfit of the chosen point and of what the polish has made of it, points (2, m).

    It is the error of the free run from the measured state, root mean square over the spread of
    each state.
    """
    squares = Objectives(objectives.predictor, "mse", grouped=True)(points)
    before, after = np.sqrt(np.mean(squares, axis=1)).tolist()
    return [
        Diagnostic("polish_misfit", "all", before, label="before"),
        Diagnostic("polish_misfit", "all", after, label="after"),
    ]


def front_diagnostics(
    free: FreeParameters, objectives: Objectives, result: SearchResult
) -> list[Diagnostic]:
    """All points of the Pareto set, and the history of the running metric."""
    diagnostics = []
    for i, (point, values) in enumerate(zip(result.points, result.front, strict=True)):
        for j, (dof, label, unit) in enumerate(
            zip(free.dofs, free.labels, free.units, strict=True)
        ):
            diagnostics.append(
                Diagnostic("pareto_parameter", dof, float(point[j]), unit, i, j, label)
            )
        for j, (dof, name, unit) in enumerate(objectives.labels):
            diagnostics.append(
                Diagnostic("pareto_objective", dof, float(values[j]), unit, i, j, name)
            )
    for i, step in enumerate(result.metric.changes, start=2):
        for j, (name, value) in enumerate(step._asdict().items()):
            diagnostics.append(Diagnostic("running_metric", "all", value, "", i, j, name))
    generations = Diagnostic("generations", "all", float(result.generations), label=result.reason)
    return [*diagnostics, generations]
