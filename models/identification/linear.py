"""Linear least squares with an optional ridge, from the triangular factor of the columns.

    minimise |y_k - Phi theta_k|^2 + penalty_k |scaled theta_k|^2

for each degree of freedom k. The term 1 is the intercept and is not penalised; without it nothing
is centred. Columns that do not vary get a coefficient of zero.

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
from seatrial.models.identification.residual import Samples
from seatrial.models.identification.spread import TableSpread, correlation, factor_of
from seatrial.models.identification.uncertainty import (
    PIECE,
    autocovariances,
    bandwidth,
    bartlett_weights,
)
from seatrial.models.vessel.basis import Array, Term
from seatrial.models.vessel.table import Vessel

BLOCK_ROWS = 2048  # rows in a block
TRAINING = "training part does not distinguish"
SINGULAR_RATIO = 1e-12


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
class LinearFit:
    """A table that is linear in its targets, with the data needed for its standard errors.

    Its derivative by the target of k is rows(i) @ shares[k] for the samples i.
    """

    terms: tuple[Term, ...]
    theta: Array  # (n_terms, n_dof)
    rest: Array  # (N, n_dof) residuals
    rows: Callable[[slice], Array]  # (n, q)
    shares: Array  # (n_dof, q, n_terms)
    parameters: Array  # (n_dof,) effective number of parameters
    varies: NDArray[np.bool_]  # (n_terms,) terms that have a coefficient
    condition: float  # largest over smallest singular value of the scaled columns

    @cached_property
    def covariances(self) -> Array:
        """Covariance (n_dof, n_terms, n_terms) of theta for stationary residuals."""
        inflated = len(self.rest) / np.maximum(len(self.rest) - self.parameters, 1.0)
        own = long_run_covariances(self.rows, self.rest)
        every = zip(inflated, self.shares, own, strict=True)
        return np.array([factor * share.T @ each @ share for factor, share, each in every])

    def standard_errors(self) -> Array:
        """Standard errors of theta (n_terms, n_dof), NaN for terms without a coefficient."""
        variances = np.diagonal(self.covariances, axis1=1, axis2=2).T
        return np.where(self.varies[:, None], np.sqrt(np.clip(variances, 0.0, None)), np.nan)

    def spread(self) -> TableSpread:
        """The distribution of the coefficients."""
        within = tuple(factor_of(correlation(each)) for each in self.covariances)
        return TableSpread(within, factor_of(correlation(self.rest.T @ self.rest)))

    def residual(self, dofs: tuple[str, ...]) -> Vessel:
        """The residual table."""
        return Vessel("residual", dofs, self.terms, self.theta)

    def diagnostics(self, dofs: Sequence[str]) -> tuple[Diagnostic, ...]:
        """Condition number of each degree of freedom, and the terms without a coefficient."""
        dropped = [self.terms[i].name for i in np.flatnonzero(~self.varies)]
        return (
            *(Diagnostic("condition_number", dof, self.condition) for dof in dofs),
            *(Diagnostic("dropped_term", "all", 1.0, label=name) for name in dropped),
        )


@dataclass(frozen=True, eq=False)
class Decomposition:
    """SVD of the standardised columns of a regression, U diag(s) V', and its targets."""

    samples: Samples
    columns: NDArray[np.int64]  # terms that vary, P of them
    mean: Array  # (P,) of the columns; zero without an intercept
    scale: Array  # (P,) standard deviations; root mean squares without an intercept
    offset: Array  # (n_dof,) mean of the targets; zero without an intercept
    s: Array
    vt: Array
    along: Array  # (P, n_dof) U' of the targets
    left: Array  # (n, n_dof) R of what the columns leave of them

    @classmethod
    def of(cls, samples: Samples) -> "Decomposition":
        """The decomposition of samples, whose lack of fit is the target."""
        constant, every = samples.constant, range(len(samples.terms))
        order = np.array([i for i in every if i != constant], dtype=np.int64)
        first, y = int(constant is not None), samples.epsilon
        R = triangle(
            np.hstack([np.ones((len(y[turn]), first)), samples.phi[turn][:, order], y[turn]])
            for turn in turns(len(samples))
        )
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

    def parameters(self, penalty: float) -> float:
        """Effective number of parameters, including the intercept."""
        return float(np.sum(self.s**2 / (self.s**2 + penalty))) + (
            self.samples.constant is not None
        )

    def rows(self, rows: slice) -> Array:
        """1 / N and U of some samples, (n, 1 + P)."""
        x = (self.samples.phi[rows][:, self.columns] - self.mean) / self.scale
        least = SINGULAR_RATIO * np.max(self.s, initial=0.0)  # below it a penalty leaves nothing
        u = x @ (self.vt.T / np.maximum(self.s, least))
        return np.hstack([np.full((len(x), 1), 1.0 / len(self.samples)), u])

    def share(self, penalty: float) -> Array:
        """Derivative of the coefficients by the mean and U' of a target, (1 + P, n_terms)."""
        constant = self.samples.constant
        share = np.zeros((1 + len(self.s), len(self.samples.terms)))
        shrunk = self.s / (self.s**2 + penalty)
        share[1:, self.columns] = shrunk[:, None] * self.vt / self.scale
        if constant is not None:
            share[1:, constant] = -share[1:, self.columns] @ self.mean
            share[0, constant] = 1.0
        return share

    def fit(self, penalties: Array | None = None) -> LinearFit:
        """Fit all degrees of freedom with penalties (n_dof,).

        Raises IdentificationError when the columns are dependent and no penalty makes the solution
        unique.
        """
        samples, s = self.samples, self.s
        ridge = np.zeros(samples.epsilon.shape[1]) if penalties is None else penalties
        if not np.all(ridge > 0.0):
            names = [str(samples.terms[i]) for i in self.columns]
            check_distinguished(s, self.vt, names, TRAINING, SINGULAR_RATIO)
        shares = np.array([self.share(penalty) for penalty in ridge])
        columns = ((each[1:].T @ self.along)[:, k] for k, each in enumerate(shares))
        theta = np.stack(list(columns), axis=1)
        if samples.constant is not None:
            theta[samples.constant] += self.offset
        varies = np.isin(range(len(samples.terms)), self.columns)
        varies[[] if samples.constant is None else samples.constant] = True
        condition = 1.0 if not len(s) else float(s[0] / s[-1]) if s[-1] > 0.0 else float("inf")
        return LinearFit(
            samples.terms, theta, samples.epsilon - samples.phi @ theta, self.rows, shares,
            np.array([self.parameters(penalty) for penalty in ridge]), varies, condition,
        )  # fmt: skip


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
