"""Output error: the parameters whose free-run prediction is nearest to the recording.

    minimise sum_k sum_j ((y_j(k) - y_hat_j(k, theta)) / sigma_j)^2

over pose and velocity of every degree of freedom; maximum likelihood for white measurement noise
of standard deviation sigma (Ljung (1987)). The predictions are those of `nsga2`, Hoyer (2021),
section 6.1. A free run over a long recording has many local minima far from the truth, one over
a short stretch has few: the fit goes through horizons of growing length (`horizons`, samples),
each beginning where the last one ended.
"""

from dataclasses import dataclass, replace

import numpy as np

from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.models.findings import Finding
from seatrial.models.identification.prediction_fit import (
    Errors,
    Fit,
    InitialState,
    Uncertainty,
    fit,
)
from seatrial.models.identification.predictor import PredictionOptions, Predictor
from seatrial.models.identification.problem import Identified, Identifier, Problem
from seatrial.models.ranges import Positive
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

SINGULAR = 1e-7  # ratio of singular values that finite differences cannot tell from zero


def check_determined(predictor: Predictor, found: Fit) -> float:
    """Condition number of the scaled Jacobian, every state over its spread.

    What is determined does not depend on the noise, nor on parameters to which a long free run is
    exponentially sensitive: a parameter counts as idle where all of it moves the predictions by
    less than SINGULAR of their spread. Raises IdentificationError, naming the parameters, when
    the predictions do not determine them.
    """
    rows = np.tile(found.sigma / predictor.spread, len(found.rest))
    jacobian = found.jacobian * rows[:, None]
    norms = np.linalg.norm(jacobian, axis=0)
    labels = np.array(predictor.free.labels)
    size = np.where(predictor.free.values != 0.0, np.abs(predictor.free.values), 1.0)
    dead = norms * size <= SINGULAR * np.sqrt(found.rest.size)
    if np.any(dead):
        raise IdentificationError(
            f"the training part does not determine {', '.join(labels[dead])}: "
            "the prediction does not depend on it"
        )
    _, s, vt = np.linalg.svd(jacobian / norms, full_matrices=False)
    if s[-1] <= SINGULAR * s[0]:
        names = labels[np.abs(vt[-1]) > 0.1]
        raise IdentificationError(
            f"the training part does not tell {', '.join(names)} from each other "
            f"(singular value ratio {s[-1] / s[0]:.1e})"
        )
    return float(s[0] / s[-1])


@dataclass(frozen=True)
class OutputError(PredictionOptions):
    """Least squares on the free-run prediction, from the nominal parameters.

    `horizons` (samples) are gone through before `horizon`. `sigma` are the standard deviations
    of the measured poses and velocities (null: from what the fit leaves). `initial_state:
    estimated` makes the states that the last horizon begins with unknowns too. `errors` are
    standard errors for noise that is `white`, or autocorrelated (`stationary`, `hac`), or, where it
    is given, from so many replicates of a block `bootstrap`.
    """

    horizons: tuple[int, ...]
    sigma: tuple[Positive, ...] | None
    initial_state: InitialState
    errors: Errors
    bootstrap: int | None
    block_s: float

    def __post_init__(self) -> None:
        super().__post_init__()
        check_horizons(self.horizons)
        Uncertainty(self.errors, self.bootstrap, self.block_s)

    def check(self, nominal: Vessel, thruster: SecondOrderLag | None, measured: bool) -> None:
        """Refuse parameters, bounds and sigma that do not fit the vessel."""
        self.free(nominal)
        states = 2 * len(nominal.dofs)
        if self.sigma is not None and len(self.sigma) != states:
            raise ConfigurationError(
                f"identifier.sigma: got {len(self.sigma)} numbers, expected {states}: "
                "poses, then velocities"
            )

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """The residual table of the best parameters, with standard errors and their covariance.

        `rng` serves the bootstrap alone.
        """
        predictor, found = self.fitted(problem)
        condition = check_determined(predictor, found)
        residual = predictor.free.residual(found.point)
        uncertainty = Uncertainty(self.errors, self.bootstrap, self.block_s)
        errors, covariance = uncertainty.of(predictor.free, found, predictor.course.step_s, rng)
        findings = [Finding("condition_number", "all", condition), *covariance]
        findings += fit_findings(predictor, found)
        return Identified(problem.nominal + residual, residual, errors, tuple(findings))

    def without_bootstrap(self) -> Identifier:
        """The same without replicates."""
        return replace(self, bootstrap=None)

    def fitted(self, problem: Problem) -> tuple[Predictor, Fit]:
        """The fit over the last horizon, and its predictor."""
        free = self.free(problem.nominal)
        sigma = None if self.sigma is None else np.array(self.sigma)
        return fit_through(
            self, problem, free.values, self.box(free), self.horizons, sigma, self.initial_state
        )


def check_horizons(horizons: tuple[int, ...]) -> None:
    """Refuse horizons that predict nothing."""
    if any(horizon < 2 for horizon in horizons):
        raise ConfigurationError(f"horizons must be at least 2 samples, got {list(horizons)}")


def fit_through(
    options: PredictionOptions,
    problem: Problem,
    point: Array,
    box: tuple[Array, Array],
    horizons: tuple[int, ...],
    sigma: Array | None,
    initial_state: InitialState,
) -> tuple[Predictor, Fit]:
    """Fit through growing horizons to that of the options; the last predictor and its fit.

    The last fit begins with whichever of its own last point and the first one predicts better.
    """
    last = options.predictor(problem)
    box = (np.asarray(box[0]), np.asarray(box[1]))
    now, evaluations = np.clip(point, *box), 0
    for horizon in horizons:
        if horizon < (options.horizon or len(problem.training)):
            predictor = options.predictor(problem, horizon)
            found = fit(predictor, now, box, sigma, initial_state, final=False)
            now, evaluations = found.point, evaluations + found.evaluations
    candidates = [np.clip(point, *box), now]
    start = min(candidates, key=lambda candidate: _distance(last, candidate, sigma))
    found = fit(last, start, box, sigma, initial_state)
    return last, replace(found, evaluations=evaluations + found.evaluations)


def _distance(predictor: Predictor, point: Array, sigma: Array | None) -> float:
    """Sum of squares of the prediction errors from the measured initial states."""
    scale = predictor.spread if sigma is None else sigma
    return float(np.sum((predictor.deviation(point) / scale) ** 2))


def fit_findings(predictor: Predictor, found: Fit) -> list[Finding]:
    """What the fit leaves of each state, and how often the predictions were evaluated."""
    rms = np.sqrt(np.mean((found.rest * found.sigma) ** 2, axis=0))
    states = zip(predictor.dofs, predictor.states, predictor.units, rms, strict=True)
    findings = [
        Finding("prediction_rms", dof, float(value), unit, label=name)
        for dof, name, unit, value in states
    ]
    return [*findings, Finding("evaluations", "all", float(found.evaluations))]
