"""Fit of a free-run prediction, with standard errors and covariance.

The identifiers `output_error` and `nsga2` (for the refinement) minimise

    sum_k sum_j ((y_j(k) - y_hat_j(k, theta, x0)) / sigma_j)^2

over the parameters theta and, where they are estimated, the initial states x0, with a prior if
there is one. The standard errors
follow from

    theta_hat - theta = sum_k G_k e_k,   G = (J'J)^-1 J'

with the Jacobian J of the predictions and the noise e_k of the states. `white` assumes that the
noise of each state is white; `stationary` and `hac` estimate its autocorrelation from the
residuals; a block bootstrap resamples the residuals. A replicate is one Gauss-Newton step from the
fit, not a new fit.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
import scipy

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.models.identification.free_parameters import FreeParameters
from seatrial.models.identification.free_run import Course
from seatrial.models.identification.free_run import deviations as state_deviations
from seatrial.models.identification.linear import triangle, turns
from seatrial.models.identification.predictor import Predictor
from seatrial.models.identification.structured import inflation
from seatrial.models.identification.uncertainty import (
    block_bootstrap,
    check_bootstrap,
    hac_variance,
    stationary_variance,
)
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.plant_table import Flags
from seatrial.models.vessel.pose import state_of

DIFFERENCE_STEP = 1e-7  # of the finite differences, relative to the size of the unknown
FIT_TOLERANCE = 1e-8  # relative change of unknowns and error in the final fit
ROUGH = 1e-4  # the same in the fits before
REWEIGHTINGS = 2
GAUSS_NEWTON_STEPS = 4  # of the initial states at one point
GAIN = 1e-6  # relative decrease of the sum of squares below which these steps end
NO_NOISE = 1e-9  # least residual that counts as noise, relative to the spread of a state
SMOOTH_S = 2.0  # [s] over which measured states are smoothed, by a polynomial of degree `CUBIC`
CUBIC = 3
InitialState = Literal["measured", "smoothed", "estimated"]


@dataclass(frozen=True, eq=False)
class Fit:
    """A converged fit; `jacobian` and `rest` are divided by sigma."""

    point: Array  # (m,)
    start: Array  # (n_starts, 2 n_dof) initial minus measured states of the predictions
    jacobian: Array  # (N n, m) of what is compared, projected off the initial states
    rest: Array  # (N, n) measured - predicted
    sigma: Array  # (n,), or (N, n) where it differs by file
    evaluations: int
    precision: Array  # (m,) of the prior: weight of (p - p_nominal)^2 beside the residuals
    inflation: float  # samples that say as much as one independent sample, in this weight


class Misfit:
    """Residuals with the best initial states, as a function of scaled parameters.

    Estimated initial states are eliminated (variable projection, Golub and Pereyra (1973)): they
    are solved for at every point by Gauss-Newton steps, and their effect is projected out of the
    Jacobian. Successive predictions are independent, so one finite difference perturbs a state of
    all predictions at once, and each prediction has its own normal equations.
    """

    def __init__(self, predictor: Predictor, size: Array, sigma: Array, estimated: bool) -> None:
        self.predictor, self.size, self.sigma, self.estimated = predictor, size, sigma, estimated
        restart = predictor.course.restart
        self.begin = np.flatnonzero(restart)
        self.group = np.cumsum(restart) - 1  # index of the prediction of each sample
        states = predictor.course.measured.shape[1]
        self.start = np.zeros((len(self.begin), states))  # last accepted offset of the states
        self.nominal = predictor.free.values / size
        self.prior = np.zeros(len(size))  # weight of x - nominal

    def best(self, x: Array) -> tuple[Array, Array]:
        """The best initial states, and (measured - predicted) / sigma, shape (N, n).

        x (m,) are the scaled parameters.
        """
        start, rest = self.start, self._rest(x, self.start)
        realistic = bool(np.isfinite(rest[0, 0]))
        for _ in range(GAUSS_NEWTON_STEPS if self.estimated and realistic else 0):
            slopes = self._slopes(x, start, rest)
            moved = start - self._project(slopes, rest[:, :, None])[..., 0]
            moved_rest = self._rest(x, moved)
            before, after = float(np.sum(rest**2)), float(np.sum(moved_rest**2))
            if not after < before:
                break
            start, rest = moved, moved_rest
            if before - after <= GAIN * before:
                break
        return start, rest

    def jacobian(self, x: Array, start: Array, rest: Array) -> Array:
        """Derivative of `rest` by forward differences, shape (N n, m).

        If the inertia after a forward step is not positive definite, a backward step is used.
        Raises IdentificationError when neither is.
        """
        sizes = DIFFERENCE_STEP * np.maximum(np.abs(x), 1.0)
        points = x + np.diag(sizes)
        after = self._rests(points, start)
        refused = np.flatnonzero(~np.isfinite(after[:, 0, 0]))
        if len(refused):
            sizes[refused] *= -1.0
            points[refused, refused] = x[refused] + sizes[refused]
            after[refused] = self._rests(points[refused], start)
        moved = np.diag(points) - x
        jacobian = np.stack(
            [self._change(rest, own) / size for own, size in zip(after, moved, strict=True)], axis=2
        )
        if not np.all(np.isfinite(jacobian)):
            raise IdentificationError(
                "the fit has reached an inertia that is hardly positive definite: use fewer "
                "parameters, or bounds"
            )
        if self.estimated:
            slopes = self._slopes(x, start, rest)
            jacobian -= slopes @ self._project(slopes, jacobian)[self.group]
        return np.asarray(jacobian.reshape(rest.size, -1))

    def _rest(self, x: Array, start: Array) -> Array:
        return np.asarray(-self.predictor.mismatch(x * self.size, start) / self.sigma)

    def _rests(self, points: Array, starts: Array) -> Array:
        """`_rest` of scaled parameters (n, m), with starts of all or of each; (n, N, n_outputs)."""
        starts = np.broadcast_to(starts, (len(points), *starts.shape[-2:]))
        return np.asarray(-self.predictor.mismatches(points * self.size, starts) / self.sigma)

    def _change(self, rest: Array, moved: Array) -> Array:
        """moved - rest, corrected for rotation vectors that jump at half a turn."""
        after = moved * self.sigma
        for columns in self.predictor.attitudes:
            turn = after[:, columns]
            size = np.linalg.norm(turn, axis=1, keepdims=True)
            jumped = np.linalg.norm(turn - (rest * self.sigma)[:, columns], axis=1) > np.pi
            full = 2.0 * np.pi / np.where(size > 0.0, size, 1.0)
            after[:, columns] = np.where(jumped[:, None], turn - full * turn, turn)
        return np.asarray(after / self.sigma - rest)

    def _slopes(self, x: Array, start: Array, rest: Array) -> Array:
        """Derivative of `rest` by the initial states, shape (N, n, 2 n_dof)."""
        sizes = DIFFERENCE_STEP * self.predictor.spread
        starts = start + np.diag(sizes)[:, None, :]
        after = self._rests(np.tile(x, (len(sizes), 1)), starts)
        slopes = [self._change(rest, own) / size for own, size in zip(after, sizes, strict=True)]
        return np.stack(slopes, axis=2)

    def _project(self, slopes: Array, values: Array) -> Array:
        """Least-squares coefficients of values (N, n, m) on the slopes, per prediction."""
        turned = slopes.transpose(0, 2, 1)
        normal = np.add.reduceat(turned @ slopes, self.begin, axis=0)
        right = np.add.reduceat(turned @ values, self.begin, axis=0)
        if self.predictor.outputs is not None:  # a position has no effect on velocities
            return np.asarray(np.linalg.pinv(normal, hermitian=True) @ right)
        return np.asarray(np.linalg.solve(normal, right))


def fit(
    predictor: Predictor,
    point: Array,
    box: tuple[Array, Array],
    sigma: Array | None = None,
    initial_state: InitialState = "estimated",
    prior: Array | None = None,
    final: bool = True,
    starts: Array | None = None,
) -> Fit:
    """Fit from a design point (m,) within bounds, box = (lower (m,), upper (m,)).

    `prior` (m,) are standard deviations of the parameters about the nominal ones, `starts`
    (n_starts, 2 n_dof) the initial minus the measured states, at first.
    If `sigma` (n,) is None, the spread of the states is used first, and the `final` fit then
    estimates it from the residuals.
    """
    size = np.where(predictor.free.values != 0.0, np.abs(predictor.free.values), 1.0)
    weights = predictor.spread if sigma is None else sigma
    misfit = Misfit(predictor, size, weights, initial_state == "estimated")
    misfit.start = misfit.start if starts is None else starts
    x = np.clip(point, *box) / size
    deviation = np.full(len(size), np.inf) if prior is None else prior
    evaluations, tau = 0, 1.0
    for _ in range(1 + (REWEIGHTINGS if final and sigma is None else 0)):
        misfit.sigma, misfit.prior = weights, np.sqrt(tau) * size / deviation
        solved = _solve(
            misfit, x, (box[0] / size, box[1] / size), FIT_TOLERANCE if final else ROUGH
        )
        x, evaluations = solved.x, evaluations + int(solved.nfev)
        start, rest = misfit.best(x)
        if final and sigma is None:
            rms = np.sqrt(np.mean((rest * weights) ** 2, axis=0))
            rest *= weights / np.maximum(rms, NO_NOISE * predictor.spread)
            weights = np.maximum(rms, NO_NOISE * predictor.spread)
            tau = inflation(rest)
            if np.all(weights == NO_NOISE * predictor.spread):
                break
    misfit.sigma = weights
    jacobian = -misfit.jacobian(x, start, rest) / size
    precision = tau / np.square(deviation)
    return Fit(x * size, start, jacobian, rest, weights, evaluations, precision, tau)


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
    return state_deviations(course.kinematics, course.reached, states)[course.restart]


def _solve(
    misfit: Misfit, x: Array, box: tuple[Array, Array], tolerance: float
) -> "scipy.optimize.OptimizeResult":
    """Trust-region least squares of scipy on a compressed problem of m + 1 residuals.

    With (e, J) = Q R the residual e is |e| times the first column of Q. The residual
    (|e|, 0, ..., 0) with the other columns of R as Jacobian has the same J'J, J'e and |e|, so scipy
    solves the same subproblems with a matrix that does not grow with the recording. It rejects a
    step to a point where the residual is NaN.
    """

    nominal = misfit.nominal
    last: tuple[Array, Array, Array] | None = None  # a point with its initial states and residuals

    def residuals(x: Array) -> Array:
        nonlocal last
        last = (x.copy(), *misfit.best(x))
        size = np.hypot(np.linalg.norm(last[2]), np.linalg.norm(misfit.prior * (x - nominal)))
        return np.array([float(size)] + [0.0] * len(x))

    def jacobian(x: Array) -> Array:
        # scipy asks for the Jacobian at the accepted point, nearly always the last one
        known = last is not None and np.array_equal(last[0], x)
        misfit.start, rest = last[1:] if last is not None and known else misfit.best(x)
        columns = np.column_stack([rest.ravel(), misfit.jacobian(x, misfit.start, rest)])
        if np.any(misfit.prior):
            own = np.column_stack([misfit.prior * (x - nominal), np.diag(misfit.prior)])
            columns = np.vstack([columns, own])
        R = triangle(columns[rows] for rows in turns(len(columns)))
        return np.asarray(R[:, 1:] * np.copysign(1.0, R[0, 0]))

    return scipy.optimize.least_squares(
        residuals, x, jacobian, box, x_scale="jac", ftol=tolerance, xtol=tolerance,
        gtol=tolerance, max_nfev=200,
    )  # fmt: skip


Errors = Literal["white", "stationary", "hac"]


@dataclass(frozen=True)
class Uncertainty:
    """How standard errors are computed: by `errors`, or by `bootstrap` replicates if set."""

    errors: Errors
    bootstrap: int | None
    block_s: float

    def __post_init__(self) -> None:
        check_bootstrap(self.bootstrap, self.block_s)
        if self.errors not in ("white", "stationary", "hac"):
            raise ConfigurationError(
                f"errors: got {self.errors!r}, expected white, stationary or hac"
            )

    def of(
        self, free: FreeParameters, fit_result: Fit, step_s: float, rng: np.random.Generator | None
    ) -> tuple[Array, dict[str, float], Array]:
        """Standard errors of the residual table, NaN for fixed entries, of devices; cov(p) (m, m).

        `step_s` [s] is the sample time, `rng` the generator of the bootstrap.
        """
        m = len(free)
        directions = np.vstack([free.directions, np.eye(m)])
        J, precision = fit_result.jacobian, fit_result.precision
        inverse = np.linalg.pinv(J.T @ J + np.diag(precision))
        solved = inverse @ J.T if np.any(precision) else np.linalg.pinv(J)
        gain = np.asarray(directions @ solved).reshape(-1, *fit_result.rest.shape)
        if self.bootstrap is None:
            spread = deviations(gain, fit_result.rest, self.errors)
        else:
            flat = gain.reshape(len(gain), -1)
            length = round(self.block_s / step_s)
            spread = block_bootstrap(
                lambda e: flat @ e.ravel(), fit_result.rest, length, self.bootstrap,
                rng or np.random.default_rng(0),
            )  # fmt: skip
        unknowns = len(fit_result.point) + fit_result.start.size
        spread = spread * np.sqrt(fit_result.rest.size / max(fit_result.rest.size - unknowns, 1))
        if np.any(precision):  # the share of the prior
            share = np.square(directions @ inverse) @ precision
            spread = np.sqrt(np.square(spread) + fit_result.inflation * share)
        free_entries = np.any(free.directions != 0.0, axis=1)
        table = np.where(free_entries, spread[:-m], np.nan).reshape(free.shape)
        own = free.device_errors(spread[-m:])
        return table, own, covariance_of(fit_result, spread[-m:])


def deviations(gain: Array, rest: Array, errors: Errors) -> Array:
    """Standard deviation (n,) of sum_k G_k e_k for gains (n, N, states), residuals (N, states)."""
    if errors == "hac":
        variance = hac_variance(np.einsum("eks,ks->ke", gain, rest))
    else:
        variance = np.zeros(len(gain))
        for j in range(rest.shape[1]):
            own = np.asarray(gain[:, :, j])
            if errors == "stationary":
                variance += stationary_variance(np.asarray(own.T), rest[:, j])
            else:
                variance += np.sum(own**2, axis=1) * np.mean(rest[:, j] ** 2)
    return np.sqrt(np.maximum(variance, 0.0))


def covariance_of(fit_result: Fit, deviation: Array) -> Array:
    """Covariance (m, m) of the parameters.

    The correlations are those of (J'J)^-1, with the prior's precision in it, the standard
    deviations are `deviation` (m,).
    """
    J = fit_result.jacobian
    inverse = np.linalg.pinv(J.T @ J + np.diag(fit_result.precision))
    root = np.sqrt(np.diag(inverse))
    return np.asarray(inverse / np.outer(root, root) * np.outer(deviation, deviation))


def covariance_diagnostics(free: FreeParameters, covariance: Array) -> list[Diagnostic]:
    """Covariance (m, m) of every pair of parameters, i and j counted from 1, j up to i."""
    diagnostics = []
    for i, j in zip(*np.tril_indices(len(free)), strict=True):
        unit, label = (f"{names[i]} {names[j]}" for names in (free.units, free.labels))
        value = float(covariance[i, j])
        diagnostics.append(
            Diagnostic("covariance", "all", value, unit, int(i) + 1, int(j) + 1, label)
        )
    return diagnostics
