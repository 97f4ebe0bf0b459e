"""Partial least squares regression of the lack of fit. Jervan (2020), sections 3.3 and 4.5.

    E = (X - mean X) / (beta std X),   F = (Y - mean Y) / std Y                 (3.3)-(3.4), (4.8)
    E = T P' + rest,   F = T Q' + rest,   T chosen for the largest covariance    (3.5)-(3.10)
    Theta_pre = W (P' W)^-1 Q'                                                   (3.11)
    Theta = Theta_pre std Y / (beta std X),   constant = mean Y - mean X Theta   (3.12)-(3.14)

beta is the number of variables multiplied in a term; (3.12) prints 2 for it. All orders are
computed from the covariances E'E and E'F by the improved kernel algorithm of Dayal and MacGregor
(1997), J. Chemometrics 11, 73-85, which deflates E'F only and gives the results of NIPALS.

Covariances are stored as moment matrices Z'Z of Z = [1, X, Y], which are additive: those of all
samples, or of all but a block, are sums of those of the blocks. The order of each degree of freedom
has the least mean squared error on left-out data (`Selection`): blocks, not single samples, since
neighbouring samples are correlated.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.models.compiled import kernel, lean_kernel
from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import IdentificationError
from seatrial.models.identification.constrained_table import finished
from seatrial.models.identification.problem import Identified, Needs, Problem
from seatrial.models.identification.residual import CONSTANT, ResidualOptions, Samples, thruster_of
from seatrial.models.identification.uncertainty import block_bootstrap
from seatrial.models.notation import SQUARE_UNIT
from seatrial.models.ranges import Folds, Positive, PositiveInt, Replicates
from seatrial.models.recording.recording import blocks
from seatrial.models.vessel.basis import Array, Term
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

EXHAUSTED = 1e-15  # fraction of a variance below which the remainder is rounding
SQUARINGS = 40
Selection = Literal["blocked", "test"]  # of the training part; the held-out one, as in the thesis


@lean_kernel
def _product(a: Array, b: Array) -> float:
    """a'b, without the copies that NumPy's expressions make."""
    total = 0.0
    for i in range(a.shape[0]):
        total += a[i] * b[i]
    return total


@kernel
def _dominant(left: Array, w: Array) -> float:
    """Write the dominant left singular vector of E'F (J, K) to w; return the singular value.

    The eigenvector of (E'F)'(E'F), shape (K, K), is computed by repeated squaring of the matrix.
    """
    n_x, n_y = left.shape
    power, square = np.empty((2, n_y, n_y))
    for k, m in np.ndindex(n_y, n_y):
        power[k, m] = _product(left[:, k], left[:, m])
    for _ in range(SQUARINGS if n_y > 1 else 0):
        trace = np.trace(power)
        if trace <= 0.0:
            return 0.0
        for k, m in np.ndindex(n_y, n_y):
            square[k, m] = _product(power[k], power[:, m]) / (trace * trace)
        power, square = square, power
    column = power[:, np.argmax(np.diag(power))]
    for i in range(n_x):
        w[i] = _product(left[i], column)
    length, norm = _product(w, w), _product(column, column)
    if length <= 0.0:
        return 0.0
    w /= np.sqrt(length)
    return float(np.sqrt(length / norm))


@kernel
def partial_least_squares(
    xx: Array, xy: Array, weights: Array, loadings: Array, output: Array, coefficients: Array
) -> int:
    """Write W, P, Q and Theta_pre of all orders from E'E (J, J) and E'F (J, K).

    w is the dominant left singular vector of E'F; r = w - sum_j (p_j' w) r_j, so that t = E r;
    p = E'E r / t't, q = (E'F)' r / t't; E'F is deflated by t't p q'. Returns the number of orders
    computed; the coefficients of higher orders, which explain no more, equal the last ones. What is
    written must be zero on entry.
    """
    orders, n_x, n_y = coefficients.shape
    left, r, e, w = xy.copy(), np.zeros((orders, n_x)), np.empty(n_x), np.empty(n_x)
    first, found, exhausted = 0.0, 0, False
    for a in range(orders):
        theta, own = coefficients[a], r[a]
        theta += coefficients[max(a - 1, 0)]
        if exhausted:
            continue
        length = _dominant(left, w)
        first = max(first, length)
        own += w
        for j in range(a):
            along = _product(loadings[:, j], w)
            for i in range(n_x):
                own[i] -= along * r[j, i]
        for i in range(n_x):
            e[i] = _product(xx[i], own)
        variance = _product(own, e)
        least = EXHAUSTED * np.trace(xx) * _product(own, own)
        exhausted = length <= EXHAUSTED * first or variance <= least
        if exhausted:
            continue
        found += 1
        for k in range(n_y):
            q = _product(left[:, k], own) / variance
            for i in range(n_x):
                left[i, k] -= e[i] * q
                theta[i, k] += own[i] * q
            output[k, a] = q
        weights[:, a], loadings[:, a] = w, e / variance
    return found


@dataclass(frozen=True, eq=False)
class Columns:
    """Z = [1, X, Y] of some samples, X and Y standardised for good conditioning.

    X has the terms that vary; the constant is the first column.
    """

    z: Array  # (N, 1 + J + K)
    n_terms: int  # of the samples
    constant: int  # index of the term 1 among them
    terms: NDArray[np.int64]  # indices of the J terms that vary
    beta: Array  # (J,) order of each term, its divisor in (4.8)
    mean: Array  # (J + K,)
    scale: Array  # (J + K,)

    @property
    def n_x(self) -> int:
        """J, the number of terms."""
        return len(self.terms)

    @property
    def y_scale(self) -> Array:
        """Standard deviation of the K outputs."""
        return self.scale[self.n_x :]

    @property
    def x(self) -> Array:
        """The constant and the terms, (N, 1 + J)."""
        return self.z[:, : 1 + self.n_x]

    @property
    def y(self) -> Array:
        """The outputs, (N, K)."""
        return self.z[:, 1 + self.n_x :]

    def like(self, samples: Samples) -> Array:
        """Z of other samples with the same means and scales, (N, 1 + J + K)."""
        xy = np.hstack([samples.phi[:, self.terms], samples.epsilon])
        return np.hstack([np.ones((len(xy), 1)), (xy - self.mean) / self.scale])

    def table(self, theta: Array) -> Array:
        """Coefficients in the units of the samples (n_terms, K) from those on Z (1 + J, K)."""
        coefficients = np.zeros((self.n_terms, theta.shape[1]))
        coefficients[self.terms] = theta[1:] * self.y_scale / self.scale[: self.n_x, None]
        offset = self.mean[self.n_x :] + theta[0] * self.y_scale
        coefficients[self.constant] = offset - self.mean[: self.n_x] @ coefficients[self.terms]
        return coefficients


def columns(samples: Samples) -> Columns:
    """Standardised columns of the samples, which have the constant among their terms."""
    assert samples.constant is not None
    low, high = np.min(samples.phi, axis=0), np.max(samples.phi, axis=0)
    terms = np.flatnonzero(high - low > 1e-12 * np.maximum(-low, high))  # the others are constant
    z = np.hstack([np.ones((len(samples), 1)), samples.phi[:, terms], samples.epsilon])
    xy = z[:, 1:]  # changed in place to save memory
    mean = np.mean(xy, axis=0)
    xy -= mean
    scale = np.sqrt(np.einsum("nj,nj->j", xy, xy) / len(xy))
    scale = np.where(scale > 0.0, scale, 1.0)
    xy /= scale
    beta = np.array([float(samples.terms[i].order) for i in terms])
    return Columns(z, len(samples.terms), samples.constant, terms, beta, mean, scale)


class Covariances(NamedTuple):
    """Means and covariances from a moment matrix, and the divisors of (3.3), (3.4), (4.8)."""

    x_mean: Array  # (J,)
    y_mean: Array  # (K,)
    xx: Array  # E'E / N, (J, J)
    xy: Array  # E'F / N, (J, K)
    x_gain: Array  # (J,) 1 / (beta std X); zero where a column does not vary
    y_scale: Array  # (K,) std Y


def covariances(moment: Array, beta: Array) -> Covariances:
    """Standardised covariances from Z'Z, whose first column is the constant."""
    n_x = len(beta)
    mean = moment[0] / moment[0, 0]
    spread = (moment / moment[0, 0] - np.outer(mean, mean))[1:, 1:]
    deviation = np.sqrt(np.clip(np.diag(spread), 0.0, None))
    x_scale, y_scale = deviation[:n_x], deviation[n_x:]
    varies = x_scale > 1e-9
    gain = np.where(varies, 1.0 / np.where(varies, x_scale * beta, 1.0), 0.0)
    y_scale = np.where(y_scale > 0.0, y_scale, 1.0)
    xx = spread[:n_x, :n_x] * np.outer(gain, gain)
    xy = spread[:n_x, n_x:] * gain[:, None] / y_scale
    return Covariances(mean[1 : 1 + n_x], mean[1 + n_x :], xx, xy, gain, y_scale)


def all_orders(moment: Array, beta: Array, orders: int) -> Array:
    """Coefficients on Z of every order up to `orders`, shape (orders, 1 + J, K)."""
    c, shape = covariances(moment, beta), (len(beta), orders)
    pre = np.zeros((orders, *c.xy.shape))
    partial_least_squares(
        np.ascontiguousarray(c.xx), np.ascontiguousarray(c.xy), np.zeros(shape), np.zeros(shape),
        np.zeros((len(c.y_mean), orders)), pre,
    )  # fmt: skip
    theta = pre * c.x_gain[:, None] * c.y_scale
    constant = c.y_mean - np.einsum("j,ajk->ak", c.x_mean, theta)
    return np.concatenate([constant[:, None, :], theta], axis=1)


def output_moment(moment: Array, n_x: int, k: int) -> Array:
    """The moments of Z with the k-th output only."""
    rows = np.r_[: 1 + n_x, 1 + n_x + k]
    return np.asarray(moment[np.ix_(rows, rows)])


def mean_squares(moment: Array, theta: Array) -> Array:
    """Mean squared error on the samples of a moment matrix, (..., K) for theta (..., 1 + J, K)."""
    n_x = theta.shape[-2]
    normal, cross = moment[:n_x, :n_x], moment[:n_x, n_x:]
    square = np.diag(moment)[n_x:]
    fitted = np.sum(theta * (normal @ theta - 2.0 * cross), axis=-2)
    return np.asarray(np.clip(square + fitted, 0.0, None) / moment[0, 0])


Pair = tuple[Array, Array]  # moment matrices Z'Z of a training part and of what it leaves out


class Block(NamedTuple):
    """Regressors of consecutive samples, the constant first, and their X'X."""

    rows: slice
    x: Array
    xx: Array

    @classmethod
    def of(cls, x: Array, rows: slice) -> "Block":
        """Some rows of the regressors of all samples (N, 1 + J)."""
        return cls(rows, x[rows], x[rows].T @ x[rows])

    def moment(self, outputs: Array) -> Array:
        """Z'Z of Z = [X, Y] for outputs of all samples (N, K)."""
        y = outputs[self.rows]
        xy = self.x.T @ y
        n, k = xy.shape
        moment = np.empty((n + k, n + k))  # np.block would take longer than the products
        moment[:n, :n], moment[:n, n:] = self.xx, xy
        moment[n:, :n], moment[n:, n:] = xy.T, y.T @ y
        return moment


@dataclass(frozen=True, eq=False)
class LeftOut:
    """What models are judged on, for any outputs on the same regressors.

    Each of the `blocks` by a model of the others; or other data, by a model of all.
    """

    blocks: tuple[Block, ...]
    other: Array | None  # Z'Z of the other data

    def moments(self, outputs: Array) -> list[Array]:
        """Z'Z of every block, for outputs (N, K)."""
        return [block.moment(outputs) for block in self.blocks]

    def pairs(self, moments: list[Array]) -> list[Pair]:
        """Moments of what a model is fitted to and of what it is judged on."""
        if self.other is not None:
            return [(np.asarray(sum(moments)), self.other)]
        others = (moments[:k] + moments[k + 1 :] for k in range(len(moments)))
        return [(np.asarray(sum(kept)), left) for kept, left in zip(others, moments, strict=True)]


def left_out_mse(pairs: list[Pair], score: Callable[[Array, Array], Array]) -> Array:
    """Mean squared error over all left-out samples; score(training, left out) gives one part's."""
    sizes = np.array([left[0, 0] for _, left in pairs])
    return np.asarray(np.tensordot(sizes / np.sum(sizes), [score(*pair) for pair in pairs], axes=1))


@dataclass(frozen=True)
class PartialLeastSquares(ResidualOptions):
    """Common options of the regressions by partial least squares.

    The constant is in the basis. Standard errors do not include the bias towards the nominal model.
    """

    folds: Folds
    bootstrap: Replicates | None
    block_s: Positive

    def needs(self) -> Needs:
        """The data of the residual, and two samples for each fold."""
        return super().needs()._replace(samples=2 * self.folds)

    def terms(self, nominal: Vessel) -> tuple[Term, ...]:
        """The basis for a vessel, with the constant."""
        terms = super().terms(nominal)
        return terms if CONSTANT in terms else (CONSTANT, *terms)

    def columns(self, samples: Samples) -> Columns:
        """Standardised columns of the samples."""
        return columns(samples)

    def left_out(
        self, selection: Selection, problem: Problem, lag: SecondOrderLag | None, samples: Samples,
        z: Columns,
    ) -> LeftOut:  # fmt: skip
        """What the models of the training part, `samples` and their columns z, are judged on.

        Raises IdentificationError when there are fewer than two samples per block.
        """
        if selection == "test":
            held_out = z.like(self.samples(problem.validation, problem.nominal, lag, samples.terms))
            return LeftOut((Block.of(z.x, slice(None)),), held_out.T @ held_out)
        if len(z.z) < 2 * self.folds:
            raise IdentificationError(
                f"{selection} selection: got {len(z.z)} samples for {self.folds} folds, expected "
                f"at least {2 * self.folds}"
            )
        parts = blocks(len(z.z), self.folds, samples.file)
        return LeftOut(tuple(Block.of(z.x, rows) for rows in parts), None)

    def bootstrap_errors(
        self, problem: Problem, z: Columns, theta: Callable[[Array], Array],
        rng: np.random.Generator,
    ) -> Array | None:  # fmt: skip
        """Standard errors of the table of theta(outputs), (n_terms, K); None without a bootstrap.

        The residuals are resampled in blocks; the regressors stay the same.
        """
        if self.bootstrap is None or problem.compared:
            return None
        fitted = z.x @ theta(z.y)
        length = round(self.block_s / problem.training.period_s)
        errors = block_bootstrap(
            lambda rest: z.table(theta(fitted + rest)), z.y - fitted, length, self.bootstrap, rng
        )
        errors[np.setdiff1d(np.arange(z.n_terms), [*z.terms, z.constant])] = np.nan
        return errors


@dataclass(frozen=True)
class Plsr(PartialLeastSquares):
    """PLSR over all degrees of freedom together.

    `max_order` null is the number of terms. Each bootstrap replicate chooses its own order.
    """

    max_order: PositiveInt | None
    selection: Selection

    def estimated(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """Identify the residual table of the chosen orders, with the MSE of every order."""
        lag, diagnostics = thruster_of(self, problem)
        samples = self.samples(problem.training, problem.nominal, lag)
        z = self.columns(samples)
        left_out = self.left_out(self.selection, problem, lag, samples, z)
        orders = min(self.max_order or z.n_x, z.n_x)

        def chosen(outputs: Array) -> tuple[Array, Array]:
            """The coefficients of the best order, and the errors of every order."""
            moments = left_out.moments(outputs)
            every = all_orders(np.asarray(sum(moments)), z.beta, orders)
            mse = left_out_mse(
                left_out.pairs(moments),
                lambda used, left: mean_squares(left, all_orders(used, z.beta, orders)),
            )
            best = enumerate(np.argmin(mse, axis=0))
            return np.stack([every[a, :, k] for k, a in best], axis=1), mse

        theta, mse = chosen(z.y)
        mse = mse * z.y_scale**2
        residual = Vessel("residual", problem.nominal.dofs, samples.terms, z.table(theta))
        errors = self.bootstrap_errors(problem, z, lambda y: chosen(y)[0], rng)
        for dof, own in zip(residual.dofs, mse.T.tolist(), strict=True):
            unit, best, kind = SQUARE_UNIT[dof], float(np.argmin(own) + 1), self.selection
            for i, value in enumerate(own, start=1):
                diagnostics += (Diagnostic("order_mse", dof, value, unit, i, label=kind),)
            diagnostics += (Diagnostic("selected_order", dof, best, label=kind),)
        diagnostics += scaled_coefficients(z, theta, residual)
        result = Identified(problem.nominal + residual, residual, errors, diagnostics)
        return finished(self, problem, lag, samples, result)


def scaled_coefficients(z: Columns, theta: Array, residual: Vessel) -> tuple[Diagnostic, ...]:
    """Theta_pre, the coefficients between scaled regressors and scaled outputs. Jervan, (3.11).

    They have no unit, so their magnitudes say how much each term contributes to the output.
    `theta` (1 + J, K) are those on Z of the table `residual`; dropped terms are left out.
    """
    scaled = theta[1:] * z.beta[:, None]  # Z has unit variance, E has 1 / beta
    return tuple(
        Diagnostic("scaled_coefficient", dof, float(value), label=residual.terms[i].name)
        for i, row in zip(z.terms, scaled, strict=True)
        for dof, value in zip(residual.dofs, row, strict=True)
        if value
    )
