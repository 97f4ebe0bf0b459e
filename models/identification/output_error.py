"""Output error: the parameters whose free-run prediction fits the recording best.

    minimise sum_k sum_j ((y_j(k) - y_hat_j(k, theta)) / sigma_j)^2

over pose and velocity of every degree of freedom; maximum likelihood for white measurement noise
of standard deviation sigma (Ljung (1987)). The predictions are those of `nsga2`, Hoyer (2021),
section 6.1. A free run over a long recording has many local minima far from the true parameters,
one over a short horizon has few. So the model is fitted with horizons of growing length
(`horizons`, in samples), each fit starting from the last one.

Bootstrap of an output-error fit over the files that it was trained on.

A replicate draws as many files as there are, with repetition, and takes one Gauss-Newton step from
the fit:

    p = p_hat + (sum_f c_f J_f'J_f + P)^-1 (sum_f c_f J_f'e_f - P (p_hat - p_0))

with c_f the times that file f was drawn, and the precision P of the prior about p_0. The files,
not the samples, are the independent units: Efron and Tibshirani (1993), An Introduction to the
Bootstrap, chapter 8.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from seatrial.models.diagnostics import INTERVAL_OF_ESTIMATE, Diagnostic
from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.models.identification.free_parameters import FreeParameters
from seatrial.models.identification.prediction_fit import (
    Errors,
    Fit,
    InitialState,
    Uncertainty,
    covariance_diagnostics,
    fit,
    smoothed_starts,
)
from seatrial.models.identification.predictor import (
    PredictionOptions,
    Predictor,
    active_bounds,
    check_outputs,
)
from seatrial.models.identification.problem import Identified, Identifier, Problem
from seatrial.models.identification.spread import ParameterSpread, ReplicateSpread
from seatrial.models.identification.uncertainty import long_run_share
from seatrial.models.ranges import Positive
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

MIN_FILES = 3  # files


def file_bootstrap(
    fit: Fit, nominal: Array, box: tuple[Array, Array], file: NDArray[np.int64] | None,
    count: int, rng: np.random.Generator,
) -> Array:  # fmt: skip
    """Design points (count, m) of the replicates.

    Args:
        fit: the fit, whose Jacobian and residuals are in units of their deviations.
        nominal: the parameters that the prior is about, shape (m,).
        box: lower and upper bounds of the parameters, shape (m,) each.
        file: number of the file of each sample, shape (N,).
        count: replicates.
        rng: draws the files.

    Returns:
        The parameters of the replicates, shape (count, m).

    Raises:
        IdentificationError: there are fewer than three files.
    """
    numbers = np.zeros(0) if file is None else np.unique(file)
    if len(numbers) < MIN_FILES:
        raise IdentificationError(
            f"identifier.resample=files: got {max(len(numbers), 1)} files to train on, expected at "
            f"least {MIN_FILES}"
        )
    outputs, m = fit.rest.shape[1], len(fit.point)
    jacobian = fit.jacobian.reshape(-1, outputs, m)
    parts = [(jacobian[file == f].reshape(-1, m), fit.rest[file == f].ravel()) for f in numbers]
    normals = np.stack([J.T @ J for J, _ in parts])
    right = np.stack([J.T @ e for J, e in parts])
    pull = fit.precision * (fit.point - nominal)
    points = np.empty((count, m))
    for k in range(count):
        drawn = rng.multinomial(len(parts), np.full(len(parts), 1.0 / len(parts)))
        normal = np.tensordot(drawn, normals, axes=1) + np.diag(fit.precision)
        step = np.linalg.lstsq(normal, drawn @ right - pull, rcond=None)[0]
        points[k] = np.clip(fit.point + step, *box)
    return points


def errors_of_replicates(
    free: FreeParameters, points: Array
) -> tuple[Array, dict[str, float], Array]:
    """Standard errors of the table and of devices, and the covariance, of points (count, m)."""
    covariance = np.atleast_2d(np.cov(points.T))
    own = free.device_errors(np.sqrt(np.diag(covariance)))
    return free.std_error(covariance), own, covariance


SLOW_S = 3.0  # [s] beyond which residuals of white noise do not depend on each other
SLOW_SHARE = 1.3  # variance at low frequency, over that of white noise, which chance hardly exceeds
SINGULAR_RATIO = 1e-7  # ratio of singular values that finite differences cannot tell from zero


def check_determined(predictor: Predictor, fit_result: Fit) -> float:
    """Condition number of the scaled Jacobian, every state over its spread.

    The check does not depend on the noise, nor on parameters to which a long free run is
    exponentially sensitive: a parameter has no effect if its nominal value changes the predictions
    by less than SINGULAR of their spread. Raises IdentificationError with the names of the
    parameters when the predictions do not determine them.
    """
    relative = fit_result.sigma / predictor.compared_spread
    rows = np.broadcast_to(relative, fit_result.rest.shape).ravel()
    jacobian = fit_result.jacobian * rows[:, None]
    if np.any(fit_result.precision > 0.0):  # of a prior, in the same scale
        scale = np.median(relative)
        jacobian = np.vstack([jacobian, scale * np.diag(np.sqrt(fit_result.precision))])
    norms = np.linalg.norm(jacobian, axis=0)
    labels = np.array(predictor.free.labels)
    size = np.where(predictor.free.values != 0.0, np.abs(predictor.free.values), 1.0)
    unused = norms * size <= SINGULAR_RATIO * np.sqrt(fit_result.rest.size)
    if np.any(unused):
        raise IdentificationError(
            f"the training part does not determine {', '.join(labels[unused])}: "
            "the prediction does not depend on them"
        )
    _, s, vt = np.linalg.svd(jacobian / norms, full_matrices=False)
    if s[-1] <= SINGULAR_RATIO * s[0]:
        names = labels[np.abs(vt[-1]) > 0.1]
        raise IdentificationError(
            f"the training part does not distinguish {', '.join(names)} from each other: got a "
            f"singular value ratio of {s[-1] / s[0]:.1e}, expected more than {SINGULAR_RATIO:g}"
        )
    return float(s[0] / s[-1])


@dataclass(frozen=True)
class OutputError(PredictionOptions):
    """Least squares on the free-run prediction, starting from the nominal parameters.

    The fit uses the `horizons` (samples), then `horizon`. `sigma` are the standard deviations of
    the measured poses and velocities (null: from the residuals). Instead, `outputs` are the weights
    of what is compared, each divided by its standard deviation in its file (`outputs.py`); the
    prior then counts beside such residuals as it is. `initial_state: estimated` also estimates the
    initial states of the predictions, `smoothed` takes smoothed measured ones. A prior adds
    sum_i ((p_i - p_0i) / s_i)^2, times the number of samples that say as much as one independent
    sample (`structured.inflation`) where sigma is estimated. `errors` selects standard errors for
    `white` or autocorrelated (`stationary`, `hac`) noise; `bootstrap`, if set, is the number of
    replicates of a bootstrap to use instead, of blocks or, by `resample`, of the files trained on.
    """

    horizons: tuple[int, ...]
    sigma: tuple[Positive, ...] | None
    initial_state: InitialState
    errors: Errors
    bootstrap: int | None
    block_s: float
    outputs: dict[str, float] | None = None
    resample: Literal["blocks", "files"] = "blocks"

    def __post_init__(self) -> None:
        super().__post_init__()
        check_horizons(self.horizons)
        Uncertainty(self.errors, self.bootstrap, self.block_s)

    @property
    def output_weights(self) -> dict[str, float] | None:
        """The option `outputs`."""
        return self.outputs

    @property
    def interval_covers(self) -> bool:
        """Only the output is fitted, so that measurement noise does not bias the estimate.

        This does not hold for a fit whose residual is not the noise (`identify`).
        """
        return True

    def check(self, nominal: Vessel, thruster: SecondOrderLag | None, measured: bool) -> None:
        """Raise ConfigurationError for parameters, bounds or sigma that do not fit the vessel."""
        self.unknowns(nominal)
        if self.outputs is not None:
            check_outputs(self.outputs, nominal)
        states = 2 * len(nominal.dofs)
        if self.sigma is not None and len(self.sigma) != states:
            raise ConfigurationError(
                f"identifier.sigma: got {len(self.sigma)} numbers, expected {states}: "
                "poses, then velocities"
            )

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """The residual table of the best parameters, with standard errors and their covariance.

        `rng` is used by the bootstrap only. Raises IdentificationError when the predictions do
        not determine the parameters.
        """
        predictor, fit_result = self.fitted(problem)
        condition = check_determined(predictor, fit_result)
        residual = predictor.free.residual(fit_result.point)
        box = self.box(predictor.free, problem.training)
        points = self.replicates(problem, predictor.free, fit_result, box, rng)
        if points is None:
            uncertainty = Uncertainty(self.errors, self.bootstrap, self.block_s)
            errors, own, covariance = uncertainty.of(
                predictor.free, fit_result, predictor.course.step_s, rng
            )
        else:
            errors, own, covariance = errors_of_replicates(predictor.free, points)
        diagnostics = [Diagnostic("condition_number", "all", condition)]
        diagnostics += covariance_diagnostics(predictor.free, covariance)
        diagnostics += fit_diagnostics(predictor, fit_result)
        bounds = active_bounds(predictor.free, fit_result.point, box)
        diagnostics += bounds
        if bounds or slow_residual(fit_result, predictor.course.step_s):
            diagnostics.append(Diagnostic(INTERVAL_OF_ESTIMATE, "all", 1.0))
        model = predictor.free.model(problem.nominal, fit_result.point)
        spread = (
            ParameterSpread(
                problem.nominal, predictor.free, fit_result.point, covariance,
                fit_result.precision / fit_result.inflation,
            )
            if points is None
            else ReplicateSpread(problem.nominal, predictor.free, fit_result.point, points)
        )
        return Identified(
            model, residual, errors, tuple(diagnostics), device_errors=own, spread=spread
        )

    def replicates(
        self, problem: Problem, free: FreeParameters, fit_result: Fit, box: tuple[Array, Array],
        rng: np.random.Generator,
    ) -> Array | None:  # fmt: skip
        """Design points (bootstrap, m) of a bootstrap over the files; None: there is none."""
        if self.bootstrap is None or self.resample != "files":
            return None
        file = problem.training.file
        return file_bootstrap(fit_result, free.values, box, file, self.bootstrap, rng)

    def without_bootstrap(self) -> Identifier:
        """This identifier without bootstrap replicates."""
        return replace(self, bootstrap=None)

    def fitted(self, problem: Problem) -> tuple[Predictor, Fit]:
        """The fit over the last horizon, and its predictor."""
        free = self.unknowns(problem.nominal)
        sigma = None if self.sigma is None else np.array(self.sigma)
        box = self.box(free, problem.training)
        return fit_through(
            self, problem, free.values, box, self.horizons, sigma, self.initial_state
        )


def slow_residual(fit_result: Fit, step_s: float) -> bool:
    """Whether the residual has a slow part, so that it is not the noise of the measurement.

    The fit has then ended in a minimum far from the truth, or a disturbance is not in the model.
    """
    return bool(np.any(long_run_share(fit_result.rest, SLOW_S / step_s) > SLOW_SHARE))


def check_horizons(horizons: tuple[int, ...]) -> None:
    """Raise ConfigurationError for horizons of fewer than two samples."""
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
    """Fit with growing horizons up to that of the options; return the last predictor and fit.

    point (m,), box (lower (m,), upper (m,)), sigma (2 n_dof,). The last fit starts from the
    initial or the last point, whichever predicts better.
    """
    last = options.predictor(problem)
    sigma = sigma if last.outputs is None else last.outputs.scale

    def starts(predictor: Predictor) -> Array | None:
        if initial_state != "smoothed":
            return None
        return smoothed_starts(predictor.course, problem.training.piece_starts)

    prior = options.prior_of(last.free, problem.training)
    box = (np.asarray(box[0]), np.asarray(box[1]))
    x, evaluations = np.clip(point, *box), 0
    for horizon in horizons:
        if horizon < (options.horizon or len(problem.training)):
            predictor = options.predictor(problem, horizon)
            own = starts(predictor)
            fit_result = fit(predictor, x, box, sigma, initial_state, prior, False, own)
            x, evaluations = fit_result.point, evaluations + fit_result.evaluations
    candidates = [np.clip(point, *box), x]
    best = min(candidates, key=lambda candidate: _distance(last, candidate, sigma))
    fit_result = fit(last, best, box, sigma, initial_state, prior, starts=starts(last))
    return last, replace(fit_result, evaluations=evaluations + fit_result.evaluations)


def _distance(predictor: Predictor, point: Array, sigma: Array | None) -> float:
    """Sum of squares of the prediction errors from the measured initial states."""
    scale = predictor.spread if sigma is None else sigma
    return float(np.sum((predictor.mismatch(point) / scale) ** 2))


def fit_diagnostics(predictor: Predictor, fit_result: Fit) -> list[Diagnostic]:
    """Root mean square residual of each state, and the number of evaluations."""
    rms = np.sqrt(np.mean((fit_result.rest * fit_result.sigma) ** 2, axis=0))
    compared = predictor.outputs
    names = predictor.states if compared is None else compared.names
    dofs, units = (
        (predictor.dofs, predictor.units) if compared is None else (compared.dofs, compared.units)
    )
    states = zip(dofs, names, units, rms, strict=True)
    diagnostics = [
        Diagnostic("prediction_rms", dof, float(value), unit, label=name)
        for dof, name, unit, value in states
    ]
    return [*diagnostics, Diagnostic("evaluations", "all", float(fit_result.evaluations))]
