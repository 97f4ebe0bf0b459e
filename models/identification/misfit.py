"""Fitting a free-run prediction: what the best initial states leave, and its minimum.

The identifiers `output_error` and `nsga2` (to polish) minimise

    sum_k sum_j ((y_j(k) - y_hat_j(k, theta, x0)) / sigma_j)^2

over the parameters theta and, where they are estimated, the initial states x0.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from models.basis import Array
from models.errors import IdentificationError
from models.identification.predictor import Predictor

STEP = 1e-7  # of the finite differences, relative to the size of the unknown
TOLERANCE, ROUGH = 1e-8, 1e-4  # relative change of unknowns and error; of all but the last fit
REWEIGHTINGS = 2
GAUSS_NEWTON_STEPS, GAIN = 4, 1e-6  # of the initial states at one point; relative to what is left
NO_NOISE = 1e-9  # of a state's spread: the least residual that counts as noise

InitialState = Literal["measured", "estimated"]


@dataclass(frozen=True, eq=False)
class Fit:
    """A converged fit; `jacobian` and `rest` are divided by sigma."""

    point: Array  # (m,)
    start: Array  # (n_starts, 2 n_dof) states that the predictions begin with
    jacobian: Array  # (N 2 n_dof, m) of what is predicted, without what the initial states explain
    rest: Array  # (N, 2 n_dof) measured - predicted
    sigma: Array  # (2 n_dof,)
    evaluations: int


class Misfit:
    """What the best initial states leave of a recording, as a function of scaled parameters.

    Estimated initial states are eliminated (variable projection, Golub and Pereyra (1973)): they
    are solved for at every point by Gauss-Newton steps, and what they explain is projected out of
    the Jacobian. Predictions that begin anew do not meet, so one state of all of them is moved at
    once, and each has its own normal equations.
    """

    def __init__(self, predictor: Predictor, size: Array, sigma: Array, estimated: bool) -> None:
        self.predictor, self.size, self.sigma, self.estimated = predictor, size, sigma, estimated
        restart = predictor.course.restart
        self.begin = np.flatnonzero(restart)
        self.group = np.cumsum(restart) - 1  # prediction that each sample belongs to
        self.start = predictor.course.start[restart]  # of the last accepted point

    def best(self, x: Array) -> tuple[Array, Array]:
        """The best initial states, and (measured - predicted) / sigma, shape (N, 2 n_dof)."""
        start, rest = self.start, self._rest(x, self.start)
        realistic = bool(np.isfinite(rest[0, 0]))
        for _ in range(GAUSS_NEWTON_STEPS if self.estimated and realistic else 0):
            slopes = self._slopes(x, start, rest)
            moved = start - self._explained(slopes, rest[:, :, None])[..., 0]
            left = self._rest(x, moved)
            before, after = float(np.sum(rest**2)), float(np.sum(left**2))
            if not after < before:
                break
            start, rest = moved, left
            if before - after <= GAIN * before:
                break
        return start, rest

    def jacobian(self, x: Array, start: Array, rest: Array) -> Array:
        """Derivative of `rest` by forward differences, shape (N 2 n_dof, m).

        Where a step ahead leaves the positive definite inertias, it is taken back.
        """
        columns = []
        for i in range(len(x)):
            column = self._slope(x, i, start, rest, STEP)
            ahead = np.isfinite(column[0, 0])
            columns.append(column if ahead else self._slope(x, i, start, rest, -STEP))
        jacobian = np.stack(columns, axis=2)
        if not np.all(np.isfinite(jacobian)):
            raise IdentificationError(
                "the fit has come to an inertia that is hardly positive definite: fewer "
                "parameters, or bounds, keep it away from there"
            )
        if self.estimated:
            slopes = self._slopes(x, start, rest)
            jacobian -= slopes @ self._explained(slopes, jacobian)[self.group]
        return np.asarray(jacobian.reshape(rest.size, -1))

    def _slope(self, x: Array, i: int, start: Array, rest: Array, step: float) -> Array:
        moved = x.copy()
        moved[i] += step * max(abs(x[i]), 1.0)
        return np.asarray((self._rest(moved, start) - rest) / (moved[i] - x[i]))

    def _rest(self, x: Array, start: Array) -> Array:
        predicted = self.predictor.predict(x * self.size, start)
        return np.asarray((self.predictor.course.measured - predicted) / self.sigma)

    def _slopes(self, x: Array, start: Array, rest: Array) -> Array:
        """Derivative of `rest` by the initial states, shape (N, 2 n_dof, 2 n_dof)."""
        slopes = []
        for j, spread in enumerate(self.predictor.spread):
            moved = start.copy()
            moved[:, j] += STEP * spread
            slopes.append((self._rest(x, moved) - rest) / (STEP * spread))
        return np.stack(slopes, axis=2)

    def _explained(self, slopes: Array, values: Array) -> Array:
        """Least-squares coefficients of values (N, 2 n_dof, m) on the slopes, per prediction."""
        turned = slopes.transpose(0, 2, 1)
        normal = np.add.reduceat(turned @ slopes, self.begin, axis=0)
        right = np.add.reduceat(turned @ values, self.begin, axis=0)
        return np.asarray(np.linalg.solve(normal, right))


def fit(
    predictor: Predictor,
    point: Array,
    box: tuple[Array, Array],
    sigma: Array | None = None,
    initial_state: InitialState = "estimated",
    final: bool = True,
) -> Fit:
    """Fit from a design point within bounds.

    An unknown sigma begins as the spread of the states; the `final` fit then takes it from what
    the fit leaves.
    """
    size = np.where(predictor.free.values != 0.0, np.abs(predictor.free.values), 1.0)
    weights = predictor.spread if sigma is None else sigma
    misfit = Misfit(predictor, size, weights, initial_state == "estimated")
    x = np.clip(point, *box) / size
    evaluations = 0
    for _ in range(1 + (REWEIGHTINGS if final and sigma is None else 0)):
        misfit.sigma = weights
        solved = _solve(misfit, x, (box[0] / size, box[1] / size), TOLERANCE if final else ROUGH)
        x, evaluations = solved.x, evaluations + int(solved.nfev)
        start, rest = misfit.best(x)
        if final and sigma is None:
            left = np.sqrt(np.mean((rest * weights) ** 2, axis=0))
            rest *= weights / np.maximum(left, NO_NOISE * predictor.spread)
            weights = np.maximum(left, NO_NOISE * predictor.spread)
            if np.all(weights == NO_NOISE * predictor.spread):
                break
    misfit.sigma = weights
    jacobian = -misfit.jacobian(x, start, rest) / size
    return Fit(x * size, start, jacobian, rest, weights, evaluations)


def _solve(misfit: Misfit, x: Array, box: tuple[Array, Array], tolerance: float) -> Any:
    """Trust-region least squares of scipy, on a problem of as many residuals as unknowns plus one.

    With the triangle R of (e, J) = Q R the residual e is |e| times the first column of Q, and
    J'J, J'e and |e| are those of the other columns of R and of (|e|, 0, ..., 0): scipy solves the
    same subproblems, but decomposes a matrix that does not grow with the recording. It refuses a
    step to where the residual is NaN.
    """
    from scipy.optimize import least_squares

    def residuals(x: Array) -> Array:
        _, rest = misfit.best(x)
        return np.array([float(np.linalg.norm(rest))] + [0.0] * len(x))

    def jacobian(x: Array) -> Array:
        misfit.start, rest = misfit.best(x)
        columns = np.column_stack([rest.ravel(), misfit.jacobian(x, misfit.start, rest)])
        triangle = np.asarray(np.linalg.qr(columns, mode="r"))
        return np.asarray(triangle[:, 1:] * np.copysign(1.0, triangle[0, 0]))

    return least_squares(
        residuals, x, jacobian, box, x_scale="jac", ftol=tolerance, xtol=tolerance,
        gtol=tolerance, max_nfev=200,
    )  # fmt: skip
