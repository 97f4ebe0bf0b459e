"""Linear least squares with an optional ridge, from the triangular factor of the columns.

    minimise sum_k w_k |y_k - Phi theta_k - H T_k f|^2 + penalty_k |scaled theta_k|^2

Each degree of freedom k has its own theta_k; f is a force (north, east) that is constant in NED and
common to them, H = [cos psi, sin psi]. The term 1 is the intercept and is not penalised; without it
nothing is centred. Columns that do not vary get a coefficient of zero.

With [1, X, Y] = Q R everything follows from R: its first row holds the means, the others are those
of centred columns. R is computed in blocks of rows, as R of all rows is R of the last R stacked on
the next block; a block stays in the processor's cache, and Q is never stored. Golub and Van Loan
(2013), Matrix Computations, section 5.2; Demmel, Grigori, Hoemmen and Langou (2012), SIAM J. Sci.
Comput. 34, A206-A239.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import NDArray

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import IdentificationError
from seatrial.models.identification.free_parameters import ned_forces
from seatrial.models.identification.residual import HEADING, Samples
from seatrial.models.identification.uncertainty import (
    PIECE,
    autocovariances,
    bandwidth,
    bartlett_weights,
)
from seatrial.models.notation import PLANAR
from seatrial.models.vessel.basis import Array, Term

BLOCK_ROWS = 2048  # rows in a block
SINGULAR_RATIO = 1e-12
# T (n_dof, 2, 2): coefficients of cos(psi) and sin(psi) by a force of 1 N to the north or east
NED = np.stack([one.on(HEADING).theta for one in ned_forces(PLANAR).values()], -1).swapaxes(0, 1)


def turns(n: int, together: int | None = None) -> list[slice]:
    """Slices of n rows, `together` rows each (None: BLOCK_ROWS)."""
    rows = together or BLOCK_ROWS
    return [slice(a, min(a + rows, n)) for a in range(0, n, rows)]


def triangle(pieces: Iterable[Array]) -> Array:
    """R of the QR factorisation of stacked blocks of rows, one in memory at a time."""
    R: Array | None = None
    for piece in pieces:
        below = piece if R is None else np.vstack([R, piece])
        R = np.asarray(np.linalg.qr(below, mode="r"), dtype=np.float64)
    if R is None:
        raise ValueError("triangle: got no rows")
    return R


def check_distinguished(s: Array, vt: Array, names: Sequence[str], what: str, ratio: float) -> None:
    """Raise IdentificationError with the names of dependent columns.

    s (P,) and vt (P, P) are singular values and right singular vectors, the least ones last.
    """
    if not len(s) or s[-1] > ratio * s[0]:
        return
    far = np.flatnonzero(np.abs(vt[-1]) > 0.1).tolist()
    alike = [names[i] for i in far] if names else ["the terms"]
    raise IdentificationError(
        f"the {what} {', '.join(alike)} from each other: got a singular value ratio of "
        f"{s[-1] / s[0]:.1e}, expected more than {ratio:g}"
    )


@dataclass(frozen=True, eq=False)
class Decomposition:
    """SVD of the standardised columns of a regression, U diag(s) V', and its m targets.

    The targets are H if a force in NED is estimated, then the lack of fit of every axis.
    """

    samples: Samples
    columns: NDArray[np.int64]  # terms that vary, P of them
    mean: Array  # (P,) of the columns; zero without an intercept
    scale: Array  # (P,) standard deviations; root mean squares without an intercept
    offset: Array  # (m,) mean of the targets; zero without an intercept
    s: Array
    vt: Array
    along: Array  # (P, m) U' of the targets
    left: Array  # (n, m) R of what the columns leave of them

    @classmethod
    def of(cls, samples: Samples, ned_force: bool = False) -> "Decomposition":
        """The decomposition of samples; with `ned_force` the columns H are among the targets."""
        constant, every = samples.constant, range(len(samples.terms))
        order = np.array([i for i in every if i != constant], dtype=np.int64)
        first = int(constant is not None)
        y = np.hstack([samples.heading, samples.epsilon]) if ned_force else samples.epsilon

        def blocks() -> Iterable[Array]:
            for turn in turns(len(samples)):
                ones = np.ones((len(y[turn]), first))
                yield np.hstack([ones, samples.phi[turn][:, order], y[turn]])

        R = triangle(blocks())
        varying = slice(first, first + len(order))
        varies = np.linalg.norm(R[first:, varying], axis=0) > SINGULAR_RATIO * np.linalg.norm(
            R[:, varying], axis=0
        )
        if not np.all(varies):
            order, used = order[varies], np.full(R.shape[1], True)
            used[varying] = varies
            R = np.asarray(np.linalg.qr(R[:, used], mode="r"), dtype=np.float64)
        P = first + len(order)
        mean = R[0] / R[0, 0] if first else np.zeros(R.shape[1])
        scale = np.linalg.norm(R[first:, first:P], axis=0) / np.sqrt(len(samples))
        u, s, vt = np.linalg.svd(R[first:P, first:P] / scale)
        return cls(
            samples, order, mean[first:P], scale, mean[P:], s, vt, u.T @ R[first:P, P:], R[P:, P:]
        )

    @property
    def varies(self) -> NDArray[np.bool_]:
        """Terms that have a coefficient, (n_terms,)."""
        varies = np.isin(np.arange(len(self.samples.terms)), self.columns)
        if self.samples.constant is not None:
            varies[self.samples.constant] = True
        return varies

    @property
    def condition(self) -> float:
        """Largest over smallest singular value; infinite if the columns are dependent."""
        if not len(self.s):
            return 1.0
        return float(self.s[0] / self.s[-1]) if self.s[-1] > 0.0 else float("inf")

    def shrinkage(self, penalty: float) -> Array:
        """s^2 / (s^2 + penalty), whose sum is the effective number of parameters."""
        return np.asarray(self.s**2 / (self.s**2 + penalty))

    def parameters(self, penalty: float) -> float:
        """Effective number of parameters, including the intercept."""
        return float(np.sum(self.shrinkage(penalty))) + (self.samples.constant is not None)

    def coefficients(self, penalty: float = 0.0) -> Array:
        """Coefficients of the terms for each of the targets, shape (n_terms, m)."""
        theta = self.share(penalty).T @ self.along
        if self.samples.constant is not None:
            theta[self.samples.constant] += self.offset
        return theta

    def share(self, penalty: float) -> Array:
        """Derivative of the coefficients by U' of a target, shape (P, n_terms)."""
        share = np.zeros((len(self.s), len(self.samples.terms)))
        shrunk = self.s / (self.s**2 + penalty)
        share[:, self.columns] = shrunk[:, None] * self.vt / self.scale
        if self.samples.constant is not None:
            share[:, self.samples.constant] = -share[:, self.columns] @ self.mean
        return share


@dataclass(frozen=True, eq=False)
class LinearFit:
    """A fit of every degree of freedom, with the data needed for its standard errors.

    The unknowns are theta of one degree of freedom after the other, then f. They are linear in the
    targets: their derivatives by the target of k are `rows` times `share` of k.
    """

    part: Decomposition
    weights: Array  # (n_dof,)
    penalties: Array  # (n_dof,) over the weights
    turned: Array  # T (n_dof, m, m); m = 0: f is not estimated
    normal: Array  # (m, m) of f
    theta: Array  # (n_terms, n_dof)
    force: Array  # f (m,) [N]
    rest: Array  # (N, n_dof) residuals

    @property
    def parameters(self) -> Array:
        """Effective number of parameters (n_dof,)."""
        return np.array([self.part.parameters(penalty) for penalty in self.penalties])

    def rows(self, rows: slice) -> Array:
        """1 / N, U, and what it leaves of H, (n, q)."""
        part, samples, m = self.part, self.part.samples, len(self.force)
        x = (samples.phi[rows][:, part.columns] - part.mean) / part.scale
        least = SINGULAR_RATIO * np.max(part.s, initial=0.0)  # below it a penalty leaves nothing
        u = x @ (part.vt.T / np.maximum(part.s, least))
        h = samples.heading[rows, :m] - part.offset[:m] - u @ part.along[:, :m]
        return np.hstack([np.full((len(x), 1), 1.0 / len(samples)), u, h])

    def share(self, k: int) -> Array:
        """Derivative of the unknowns by the target of k along the rows, (q, n_unknowns)."""
        part, m = self.part, len(self.force)
        kept = (1.0 - part.shrinkage(self.penalties[k]))[:, None] * part.along[:, :m]
        side = self.weights[k] * np.vstack([np.zeros((1, m)), kept, np.eye(m)]) @ self.turned[k]
        f = np.linalg.solve(self.normal, side.T).T
        own = [
            -f @ (part.coefficients(penalty)[:, :m] @ turned).T
            for penalty, turned in zip(self.penalties, self.turned, strict=True)
        ]
        own[k][1 : 1 + len(part.s)] += part.share(self.penalties[k])
        if part.samples.constant is not None:
            own[k][0, part.samples.constant] += 1.0
        return np.hstack([*own, f])

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the unknowns, (n_unknowns, n_unknowns).

        For stationary residuals that are independent between the degrees of freedom.
        """
        inflated = len(self.rest) / np.maximum(len(self.rest) - self.parameters, 1.0)
        own = long_run_covariances(self.rows, self.rest)
        shares = map(self.share, range(len(own)))
        return np.asarray(
            sum(
                factor * share.T @ each @ share
                for factor, share, each in zip(inflated, shares, own, strict=True)
            )
        )

    def standard_errors(self) -> tuple[Array, Array]:
        """Standard errors of theta (n_terms, n_dof), NaN for terms that do not vary, and of f."""
        errors = np.sqrt(np.clip(np.diag(self.covariance), 0.0, None))
        theta = errors[: self.theta.size].reshape(self.theta.shape[::-1]).T
        return np.where(self.part.varies[:, None], theta, np.nan), errors[self.theta.size :]


def fit(
    part: Decomposition, penalties: Array | None = None, weights: Array | None = None
) -> LinearFit:
    """Fit all degrees of freedom; penalties (n_dof,) and weights (n_dof,).

    For f the own columns are projected out of H and the targets (Frisch, Waugh and Lovell):
    sum_k w_k T_k' H' (I - P_k) H T_k f = sum_k w_k T_k' H' (I - P_k) y_k. Raises
    IdentificationError when the columns are dependent and no penalty makes the solution unique.
    """
    samples, n_dof = part.samples, part.samples.epsilon.shape[1]
    m = part.along.shape[1] - n_dof
    weights = np.ones(n_dof) if weights is None else weights
    ridge = np.zeros(n_dof) if penalties is None else penalties / weights
    if not np.all(ridge > 0.0):
        names = [str(samples.terms[i]) for i in part.columns]
        what = "training part does not distinguish"
        check_distinguished(part.s, part.vt, names, what, SINGULAR_RATIO)
    turned = NED if m else np.zeros((n_dof, 0, 0))
    normal, side = np.zeros((m, m)), np.zeros(m)
    for k, T in enumerate(turned):
        along, left = part.along[:, :m] @ T, part.left[:, :m] @ T
        kept = (1.0 - part.shrinkage(ridge[k]))[:, None] * along
        normal += weights[k] * (left.T @ left + along.T @ kept)
        side += weights[k] * (left.T @ part.left[:, m + k] + kept.T @ part.along[:, m + k])
    f = np.asarray(np.linalg.solve(normal, side), dtype=np.float64)
    own = [part.coefficients(penalty) for penalty in ridge]
    theta = np.stack(
        [each[:, m + k] - each[:, :m] @ turned[k] @ f for k, each in enumerate(own)], axis=1
    )
    rest = samples.epsilon - samples.phi @ theta - samples.heading[:, :m] @ (turned @ f).T
    return LinearFit(part, weights, ridge, turned, normal, theta, f, rest)


def condition_diagnostics(
    terms: Sequence[Term], varies: NDArray[np.bool_], conditions: Sequence[float],
    dofs: Sequence[str],
) -> tuple[Diagnostic, ...]:  # fmt: skip
    """Condition number of each degree of freedom, and the terms (n_terms,) that do not vary."""
    dropped = [term.name for term, kept in zip(terms, varies, strict=True) if not kept]
    return (
        *(Diagnostic("condition_number", *row) for row in zip(dofs, conditions, strict=True)),
        *(Diagnostic("dropped_term", "all", 1.0, label=name) for name in dropped),
    )


def long_run_covariances(rows: Callable[[slice], Array], rest: Array) -> Array:
    """Covariances (K, q, q) of sum_i r_i e_ik for rows (N, q) and stationary residuals (N, K).

    sum_lag w(lag) gamma_k(lag) sum_i r_i r_(i+lag)', as of `uncertainty`. `rows` gives those of a
    slice, so that a long record is in memory piece by piece; each is convolved by FFT with the
    weighted autocovariances and multiplied with its inner part, both in the frequency domain.
    """
    n, (widths, K) = len(rest), (bandwidth(autocovariances(rest, 2), len(rest)), rest.shape[1])
    lags = min(n, int(np.ceil(np.max(widths))) + 1)
    weighted = bartlett_weights(widths, lags) * autocovariances(rest, lags) / n
    piece, reach = min(n, max(PIECE, 12 * lags)), lags - 1
    size = scipy.fft.next_fast_len(piece + 2 * reach, real=True)
    kernel = np.zeros((size, K))
    kernel[:lags] += 0.5 * weighted
    kernel[-np.arange(lags)] += 0.5 * weighted
    spectrum = scipy.fft.rfft(kernel, axis=0).real / size
    spectrum[1 : (size + 1) // 2] *= 2.0  # for the negative frequencies
    spectrum = np.concatenate([spectrum, spectrum])  # of real and imaginary parts
    total: Array | None = None
    for a in range(0, n, piece):
        begin = max(a - reach, 0)
        outer = rows(slice(begin, min(a + piece + reach, n)))
        inner = np.zeros_like(outer)
        inner[a - begin : a - begin + piece] = outer[a - begin : a - begin + piece]
        parts = [scipy.fft.rfft(values, size, axis=0) for values in (inner, outer)]
        left, right = (np.concatenate([values.real, values.imag]) for values in parts)
        found = np.stack([left.T @ (weight[:, None] * right) for weight in spectrum.T])
        total = found if total is None else total + found
    assert total is not None
    return np.asarray(0.5 * (total + total.transpose(0, 2, 1)))
