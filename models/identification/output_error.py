"""Output error: the parameters whose free-run prediction fits the recording best.

    minimise sum_k sum_j ((y_j(k) - y_hat_j(k, theta)) / sigma_j)^2

over pose and velocity of every degree of freedom, or over weighted outputs; maximum likelihood for
white measurement noise of standard deviation sigma, Ljung (1999), section 7.4. The predictions are
those of `nsga2`, Hoyer (2021), section 6.1, the fit is `free_run_fit`, with horizons of growing
length, each from the last one.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
import scipy

from seatrial.models.diagnostics import INTERVAL_OF_ESTIMATE, Diagnostic
from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.models.identification.free_run import Course, deviations
from seatrial.models.identification.free_run_fit import Effort, Fit, FreeRuns, Stage, grown
from seatrial.models.identification.least_squares import TRAINING, check_distinguished
from seatrial.models.identification.physical_constraints import feasible
from seatrial.models.identification.predictor import PredictionOptions, active_bounds, check_outputs
from seatrial.models.identification.problem import Identified, Problem
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.plant_table import Flags
from seatrial.models.vessel.pose import state_of
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

ROUGH, FINE = Effort(1, 100, 1e-4), Effort(3, 100, 1e-10)
SINGULAR_RATIO = 1e-7  # ratio of singular values that finite differences cannot tell from zero
SMOOTH_S = 2.0  # [s] over which measured states are smoothed, by a polynomial of degree `CUBIC`
CUBIC = 3
SLOW_SHARE = 1.3  # of the slow part of a residual, which chance hardly exceeds
InitialState = Literal["measured", "smoothed", "estimated"]


@dataclass(frozen=True)
class OutputError(PredictionOptions):
    """Least squares on the free-run prediction, starting from the nominal parameters.

    The fit uses the `horizons` (samples), then `horizon`. A prior adds sum_i ((p_i - p_0i) / s_i)^2
    times the number of samples that say as much as one independent sample (`structured.inflation`),
    or once for weighted `outputs`.
    """

    horizons: tuple[int, ...]
    initial_state: InitialState
    outputs: dict[str, float] | None = None

    @property
    def output_weights(self) -> dict[str, float] | None:
        """The option `outputs`."""
        return self.outputs

    @property
    def interval_covers(self) -> bool:
        """Only the output is fitted, so that measurement noise does not bias the estimate.

        This does not hold for a fit whose residual is not the noise (`model_of`).
        """
        return True

    def check(self, nominal: Vessel, thruster: SecondOrderLag | None, measured: bool) -> None:
        """Raise ConfigurationError for parameters or bounds that do not fit the vessel."""
        check_horizons(self.horizons)
        self.unknowns(nominal, windy=True)
        if self.outputs is not None:
            check_outputs(self.outputs, nominal)

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """The table of the best parameters; raises IdentificationError if there is no best one."""
        fit = fit_through(self, problem, None, self.horizons, self.initial_state)
        return model_of(self, problem, fit)


def check_horizons(horizons: tuple[int, ...]) -> None:
    """Raise ConfigurationError for horizons of fewer than two samples."""
    if min(horizons, default=2) < 2:
        raise ConfigurationError(f"horizons must be at least 2 samples, got {list(horizons)}")


def fit_through(
    options: PredictionOptions, problem: Problem, point: Array | None, horizons: tuple[int, ...],
    initial_state: InitialState,
) -> Fit:  # fmt: skip
    """Fit with growing `horizons` [samples] up to that of the options.

    The fit begins at the `point` (m,); None: at the nominal parameters.
    """
    training = problem.training
    free = options.unknowns(problem.nominal, training.wind is not None)
    deviation, constraints = options.prior_of(free, training), options.constraints(free, training)
    longest = options.horizon or len(training)

    def stage(horizon: int | None, last: bool) -> Stage:
        predictor = options.predictor(problem, horizon)
        own = None
        if initial_state == "smoothed":
            own = smoothed_starts(predictor.course, training.piece_starts)
        estimated = range(len(predictor.spread)) if initial_state == "estimated" else ()
        runs, scale = FreeRuns(predictor, constraints.scale, estimated), predictor.compared.scale
        if last:
            return Stage(runs, FINE, scale, own, SLOW_SHARE)
        return Stage(runs, ROUGH, predictor.spread if scale is None else scale, own)

    first = np.zeros(len(free)) if point is None else point - free.values
    first = feasible(first, constraints)
    lengths = [*(h for h in horizons if h < longest), None]
    return grown(lengths, stage, first, first, deviation, constraints)


def smoothed_starts(course: Course, pieces: Flags) -> Array:
    """Smoothed minus measured initial states of the predictions, shape (n_starts, 2 n_dof).

    By the polynomials of Savitzky and Golay; `pieces` (N,) is true at the first sample of a piece.
    """
    n = course.measured.shape[1] // 2
    length = 2 * round(0.5 * SMOOTH_S / course.step_s) + 1
    smooth = course.measured.copy()
    for a, b in pairwise([*np.flatnonzero(pieces).tolist(), len(smooth)]):
        if CUBIC < length <= b - a:
            smooth[a:b] = scipy.signal.savgol_filter(smooth[a:b], length, CUBIC, axis=0)
    states = np.hstack([state_of(course.kinematics, smooth[:, :n]), smooth[:, n:]])
    return deviations(course.kinematics, course.reached, states)[course.restart]


def model_of(options: PredictionOptions, problem: Problem, result: Fit) -> Identified:
    """The model of a fit, with its standard errors, their distribution, and diagnostics.

    Raises IdentificationError when the predictions do not determine the parameters.
    """
    predictor, training = result.runs.predictor, problem.training
    free, outputs, condition = predictor.free, predictor.compared, condition_of(result)
    point, covariance = result.parameters, result.covariance
    rms = np.sqrt(np.mean(result.point.rest**2, axis=0))
    rows = zip(outputs.dofs, outputs.names, outputs.units, rms, strict=True)
    bounds = active_bounds(free, point, options.box(free, training))
    known = {diagnostic.label for diagnostic in bounds}
    active = [name for name in result.active if name not in known]
    diagnostics = [
        Diagnostic("condition_number", "all", condition),
        *(Diagnostic("prediction_rms", dof, float(v), unit, label=n) for dof, n, unit, v in rows),
        Diagnostic("evaluations", "all", float(result.evaluations)),
        *bounds,
        *(Diagnostic("active_constraint", "all", 1.0, label=name) for name in active),
    ]
    if bounds or active or result.slow > SLOW_SHARE:
        diagnostics.append(Diagnostic(INTERVAL_OF_ESTIMATE, "all", 1.0))
    return Identified(
        free.model(problem.nominal, point), free.residual(point), free.std_error(covariance),
        tuple(diagnostics), device_errors=free.device_errors(np.sqrt(np.diag(covariance))),
        spread=result.spread(problem.nominal), notes=result.notes,
    )  # fmt: skip


def condition_of(result: Fit) -> float:
    """Condition number of the scaled Jacobian, every output over its spread.

    A parameter has no effect if its nominal value changes the predictions by less than
    SINGULAR_RATIO of their spread. Raises IdentificationError with the names of the parameters that
    the predictions do not determine.
    """
    predictor = result.runs.predictor
    relative = result.scale / predictor.compared.spread
    rows = np.broadcast_to(relative, result.rest.shape).ravel()
    prior = result.tau * result.prior
    jacobian = result.jacobian * rows[:, None]
    if np.any(prior > 0.0):  # in the same scale
        jacobian = np.vstack([jacobian, np.median(relative) * np.diag(np.sqrt(prior))])
    norms = np.linalg.norm(jacobian, axis=0)
    labels, values = predictor.free.labels, predictor.free.values
    size = np.where(values != 0.0, np.abs(values), 1.0)
    unused = norms * size <= SINGULAR_RATIO * np.sqrt(result.rest.size)
    if np.any(unused):
        raise IdentificationError(
            f"the training part does not determine {', '.join(np.array(labels)[unused])}: "
            "the prediction does not depend on them"
        )
    _, s, vt = np.linalg.svd(jacobian / norms, full_matrices=False)
    check_distinguished(s, vt, labels, TRAINING, SINGULAR_RATIO)
    return float(s[0] / s[-1])
