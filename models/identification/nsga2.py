"""Identification by multi-objective search. Hoyer (2021), chapter 6.

Step 1: objectives between measured and predicted states, section 6.2.1. Step 2: their Pareto
front by NSGA-II, section 6.2.2. Step 3: one point of the front, section 6.2.3. Beyond the thesis
the chosen point can be polished by least squares (`output_error`), which also gives standard
errors; a front has none.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.findings import Finding
from seatrial.models.identification.free_parameters import NED
from seatrial.models.identification.genetic_algorithm import Operators
from seatrial.models.identification.multiobjective_search import (
    Algorithm,
    RunningMetric,
    Searched,
    Space,
    search,
    searcher,
)
from seatrial.models.identification.objectives import Metric, Objectives, objective_findings
from seatrial.models.identification.output_error import (
    check_determined,
    check_horizons,
    fit_findings,
    fit_through,
)
from seatrial.models.identification.pareto_selection import Decision, choose
from seatrial.models.identification.prediction_fit import Errors, Uncertainty
from seatrial.models.identification.predictor import PredictionOptions, Predictor
from seatrial.models.identification.problem import Identified, Identifier, Problem
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag


@dataclass(frozen=True)
class Nsga2(PredictionOptions):
    """Pareto front of the prediction errors, and one point of it.

    `objective` is the error of a state, `grouped` makes two objectives of all states. The
    parameters in `log_scale` (`all` for every one whose bounds have one sign) are searched by
    their logarithm. The population is `population`, or (null) 10^m for m parameters, at most
    `population_cap`. The search ends when the running metric stays below `threshold` for `window`
    generations, after `generations`, or when all objectives of one point are below
    `objective_floor` times the spread of the measured states. `mutation_probability` of each
    parameter is by default 1/m. `decision` chooses the point, with `weights` of the objectives for
    pseudo_weights; `polish: least_squares` goes on from it, through `polish_horizons` (samples).
    `errors`, `bootstrap` and `block_s` are about the standard errors of a polished point.
    """

    objective: Metric
    grouped: bool
    log_scale: tuple[str, ...]
    algorithm: Algorithm
    population: int | None
    population_cap: int
    generations: int
    crossover_eta: float
    crossover_probability: float
    mutation_eta: float
    mutation_probability: float | None
    window: int
    threshold: float
    objective_floor: float
    decision: Decision
    weights: tuple[float, ...] | None
    polish: Literal["least_squares"] | None
    polish_horizons: tuple[int, ...]
    errors: Errors
    bootstrap: int | None
    block_s: float

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, least in (("population_cap", 4), ("generations", 1), ("window", 1)):
            if getattr(self, name) < least:
                raise ConfigurationError(
                    f"{name} must be at least {least}, got {getattr(self, name)}"
                )
        if self.population is not None and self.population < 4:
            raise ConfigurationError(f"population must be at least 4, got {self.population}")
        for name in ("crossover_eta", "mutation_eta", "threshold"):
            if not getattr(self, name) > 0.0:
                raise ConfigurationError(f"{name} must be positive, got {getattr(self, name)}")
        for name in ("crossover_probability", "mutation_probability"):
            value = getattr(self, name)
            if value is not None and not 0.0 <= value <= 1.0:
                raise ConfigurationError(f"{name} must lie in [0, 1], got {value}")
        check_horizons(self.polish_horizons)
        if self.uncertainty.bootstrap is not None and self.polish is None:
            raise ConfigurationError("bootstrap needs polish=least_squares: a front has no errors")
        if not self.objective_floor >= 0.0:
            raise ConfigurationError(
                f"objective_floor must not be negative, got {self.objective_floor}"
            )
        if self.weights is not None and not min(self.weights, default=0.0) > 0.0:
            raise ConfigurationError(f"weights must be positive, got {list(self.weights)}")

    def check(self, nominal: Vessel, thruster: SecondOrderLag | None, measured: bool) -> None:
        """Refuse parameters without bounds, and weights for other objectives."""
        free = self.free(nominal)
        lower, upper = self.box(free)
        for label, low, high in zip(free.labels, lower, upper, strict=True):
            if label not in NED and not np.isfinite(high - low):
                raise ConfigurationError(
                    f"identifier.bounds.{label} is missing: a search needs bounds"
                )
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
        """The residual table of the chosen (and polished) point; the front as findings."""
        self.check(problem.nominal, problem.thruster, measured=False)
        predictor = self.predictor(problem)
        objectives = Objectives(predictor, self.objective, self.grouped)
        space = self._space(predictor)
        found = self._search(objectives, space, rng)
        chosen, rule = choose(found.front, self.decision, self.weights)
        findings = front_findings(predictor, objectives, found)
        findings.append(Finding("pareto_chosen", "all", float(chosen), i=chosen, label=rule))
        point, errors = found.points[chosen], None
        if self.polish is not None:
            box = (space.lower, space.upper)
            predictor, polished = fit_through(
                self, problem, point, box, self.polish_horizons, None, "estimated"
            )
            condition = check_determined(predictor, polished)
            step_s, free = predictor.course.step_s, predictor.free
            errors, covariance = self.uncertainty.of(free, polished, step_s, rng)
            findings += [Finding("condition_number", "all", condition), *covariance]
            findings += fit_findings(predictor, polished)
            point = polished.point
        findings += objective_findings(objectives, point)
        residual = predictor.free.residual(point)
        return Identified(problem.nominal + residual, residual, errors, tuple(findings))

    def without_bootstrap(self) -> Identifier:
        """The same without replicates."""
        return replace(self, bootstrap=None)

    @property
    def uncertainty(self) -> Uncertainty:
        """How the standard errors of a polished point are found."""
        return Uncertainty(self.errors, self.bootstrap, self.block_s)

    def _space(self, predictor: Predictor) -> Space:
        """Bounds of the search; those of the constant force are the largest force recorded."""
        lower, upper = self.box(predictor.free)
        largest = float(np.max(np.abs(predictor.course.force)))
        for i, label in enumerate(predictor.free.labels):
            if label in NED and label not in self.bounds:
                lower[i], upper[i] = -largest, largest
        one_sign = lower * upper > 0.0
        named = np.isin(predictor.free.labels, self.log_scale)
        return Space(lower, upper, one_sign if "all" in self.log_scale else named)

    def _search(self, objectives: Objectives, space: Space, rng: np.random.Generator) -> Searched:
        m = len(space.lower)
        size = self.population or min(10 ** min(m, 9), self.population_cap)
        probability = 1.0 / m if self.mutation_probability is None else self.mutation_probability
        operators = Operators(
            size, self.crossover_eta, self.crossover_probability, self.mutation_eta, probability
        )
        scale = objectives.floor
        metric = RunningMetric(scale, self.window, self.threshold)
        by = searcher(self.algorithm, operators, scale, m, rng)
        floor = self.objective_floor * scale
        return search(objectives, space, floor, metric, by, self.generations)


def front_findings(predictor: Predictor, objectives: Objectives, found: Searched) -> list[Finding]:
    """The whole Pareto set, point by point, and the history of the running metric."""
    free = predictor.free
    findings = []
    for i, (point, values) in enumerate(zip(found.points, found.front, strict=True)):
        for j, (label, unit) in enumerate(zip(free.labels, free.units, strict=True)):
            dof = label.partition(".")[0] if "." in label else "all"
            findings.append(Finding("pareto_parameter", dof, float(point[j]), unit, i, j, label))
        for j, (dof, name, unit) in enumerate(objectives.labels):
            findings.append(Finding("pareto_objective", dof, float(values[j]), unit, i, j, name))
    for i, step in enumerate(found.metric.changes, start=2):
        for j, (name, value) in enumerate(step._asdict().items()):
            findings.append(Finding("running_metric", "all", value, "", i, j, name))
    ended = Finding("generations", "all", float(found.generations), label=found.reason)
    return [*findings, ended]
