"""Linear least squares with an optional ridge, from the triangular factor of the columns.

    minimise sum_k sum_i w_ik (y_ik - phi_i' theta_k - s_ik' f)^2 + penalty_k |scaled theta_k|^2

Each degree of freedom k has its own theta_k; f are unknowns that the degrees of freedom share. The
term 1 is the intercept and is not penalised; without it nothing is centred. Columns that do not
vary get a coefficient of zero.

With root(w) [1, X, Y] = Q R everything follows from R: its first row holds the means, the others
are those of centred columns. R is computed in blocks of rows, as R of all rows is R of the last R
stacked on the next block; a block stays in the processor's cache, and Q is never stored. Golub and
Van Loan (2013), Matrix Computations, section 5.2; Demmel, Grigori, Hoemmen and Langou (2012), SIAM
J. Sci. Comput. 34, A206-A239.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import IdentificationError
from seatrial.models.identification.residual import CONSTANT, Samples
from seatrial.models.identification.uncertainty import (
    PIECE,
    ErrorKind,
    autocovariances,
    bandwidth,
    bartlett_weights,
    block_bootstrap,
    hac_variance,
)
from seatrial.models.vessel.basis import Array, Term

TOGETHER = 2048  # rows in a block
SINGULAR_RATIO = 1e-12


def turns(n: int, together: int | None = None) -> list[slice]:
    """Slices of n rows, `together` rows each (None: TOGETHER)."""
    rows = together or TOGETHER
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


def check_distinguished(
    s: Array, vt: Array, names: Sequence[str], what: str, ratio: float
) -> None:
    """Raise IdentificationError with the names of dependent columns.

    s (P,) and vt (P, P) are singular values and right singular vectors, the least ones last.
    """
    if not len(s) or s[-1] > ratio * s[0]:
        return
    found = np.flatnonzero(np.abs(vt[-1]) > 0.1)
    alike = [names[int(i)] for i in found] if names else ["the terms"]
    raise IdentificationError(
        f"the {what} {', '.join(alike)} from each other: got a singular value ratio of "
        f"{s[-1] / s[0]:.1e}, expected more than {ratio:g}"
    )


@dataclass(frozen=True, eq=False)
class Decomposition:
    """SVD of the weighted, standardised columns of a regression, U diag(s) V', and its targets."""

    n_terms: int
    columns: NDArray[np.int64]  # terms that vary, P of them
    constant: int | None  # index of the intercept
    mean: Array  # (P,) of the columns; zero without an intercept
    scale: Array  # (P,) standard deviations; root mean squares without an intercept
    offset: Array  # (m,) mean of the targets; zero without an intercept
    s: Array
    vt: Array
    along: Array  # (P, m) U' of the weighted targets
    left: Array  # (n, m) R of what the columns leave of them

    @classmethod
    def of(
        cls, R: Array, terms: tuple[Term, ...], order: list[int], total: float, penalised: bool
    ) -> "Decomposition":
        """The decomposition by R of the terms in an `order`, the intercept first, and targets.

        `total` is the sum of the weights. Raises IdentificationError with the names of the terms
        when the columns are dependent and no penalty makes the solution unique.
        """
        first, P = int(CONSTANT in [terms[i] for i in order[:1]]), len(order)
        mean = R[0] / R[0, 0] if first else np.zeros(R.shape[1])
        size = np.linalg.norm(R[first:, first:P], axis=0)
        varies = size > SINGULAR_RATIO * np.linalg.norm(R[:, first:P], axis=0)
        if not np.all(varies):
            kept = np.concatenate([np.full(first, True), varies])
            used = np.concatenate([kept, np.full(R.shape[1] - P, True)])
            fewer = np.asarray(np.linalg.qr(R[:, used], mode="r"), dtype=np.float64)
            return cls.of(fewer, terms, np.array(order)[kept].tolist(), total, penalised)
        scale = size / np.sqrt(total)
        u, s, vt = np.linalg.svd(R[first:P, first:P] / scale)
        if not penalised:
            names = [str(terms[i]) for i in order[first:]]
            what = "training part does not distinguish"
            check_distinguished(s, vt, names, what, SINGULAR_RATIO)
        return cls(
            len(terms), np.array(order[first:], dtype=np.int64), order[0] if first else None,
            mean[first:P], scale, mean[P:], s, vt, u.T @ R[first:P, P:], R[P:, P:],
        )  # fmt: skip

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
        return float(np.sum(self.shrinkage(penalty))) + (self.constant is not None)

    def coefficients(self, penalty: float = 0.0) -> Array:
        """Coefficients of the terms for each of the targets, shape (n_terms, m)."""
        theta = self.share(penalty).T @ self.along
        if self.constant is not None:
            theta[self.constant] += self.offset
        return theta

    def share(self, penalty: float) -> Array:
        """Derivative of the coefficients by U' of a target, shape (P, n_terms)."""
        share = np.zeros((len(self.s), self.n_terms))
        shrunk = self.s / (self.s**2 + penalty)
        share[:, self.columns] = shrunk[:, None] * self.vt / self.scale
        if self.constant is not None:
            share[:, self.constant] = -share[:, self.columns] @ self.mean
        return share


def columns_of(samples: Samples) -> list[int]:
    """The terms in the order of R: the intercept first."""
    others = [i for i in range(len(samples.terms)) if i != samples.constant]
    return others if samples.constant is None else [samples.constant, *others]


def factor(samples: Samples, rows: slice, weights: Array | None, *targets: Array) -> Array:
    """R of root(w) [terms in the order of `columns_of`, targets] of some rows."""
    order, start = columns_of(samples), rows.indices(len(samples))[0]

    def blocks() -> Iterable[Array]:
        for turn in turns(len(samples.phi[rows])):
            own = slice(start + turn.start, start + turn.stop)
            block = np.hstack([samples.phi[own][:, order], *(target[own] for target in targets)])
            if samples.constant is not None:
                block[:, 0] = 1.0
            yield block if weights is None else np.sqrt(weights[own])[:, None] * block

    return triangle(blocks())


def decompositions(
    samples: Samples, weights: Array, penalised: bool = False, shared: Array | None = None
) -> tuple[Decomposition, ...]:
    """A decomposition for each degree of freedom, with weights (N, n_dof).

    The targets are its shared columns (n_dof, N, m), then the lack of fit of all degrees of
    freedom. Where nothing is shared, equal weights have one object.
    """
    parts: list[Decomposition] = []
    for k, w in enumerate(weights.T):
        if k and shared is None and np.array_equal(w, weights[:, 0]):
            parts.append(parts[0])
            continue
        targets = (samples.epsilon,) if shared is None else (shared[k], samples.epsilon)
        R = factor(samples, slice(None), w, *targets)
        order, total = columns_of(samples), float(np.sum(w))
        parts.append(Decomposition.of(R, samples.terms, order, total, penalised))
    return tuple(parts)


@dataclass(frozen=True, eq=False)
class LinearFit:
    """A fit of every degree of freedom, with the data needed for its standard errors.

    The unknowns are theta of one degree of freedom after the other, then f. They are linear in the
    targets: their derivatives by the target of k are `rows` of k times `share` of k.
    """

    samples: Samples
    weights: Array  # (N, n_dof)
    columns: Array  # (n_dof, N, m) of the shared unknowns
    parts: tuple[Decomposition, ...]  # of each degree of freedom; equal weights share one object
    penalties: Array  # (n_dof,)
    normal: Array  # (m, m) of the shared unknowns
    theta: Array  # (n_terms, n_dof)
    shared: Array  # (m,)
    rest: Array  # (N, n_dof) residuals

    @property
    def parameters(self) -> Array:
        """Effective number of parameters (n_dof,)."""
        pairs = zip(self.parts, self.penalties, strict=True)
        return np.array([part.parameters(penalty) for part, penalty in pairs])

    @property
    def varies(self) -> NDArray[np.bool_]:
        """Terms that have a coefficient, (n_terms,)."""
        part = self.parts[0]
        used = [*part.columns, *([] if part.constant is None else [part.constant])]
        return np.isin(np.arange(part.n_terms), used)

    def rows(self, source: int, rows: slice) -> Array:
        """w / sum(w), and root(w) times U and what it leaves of the shared columns, (n, q)."""
        part, w = self.parts[source], self.weights[rows, source][:, None]
        x = (self.samples.phi[rows][:, part.columns] - part.mean) / part.scale
        least = SINGULAR_RATIO * np.max(part.s, initial=0.0)  # below it a penalty leaves nothing
        u = w * (x @ (part.vt.T / np.maximum(part.s, least)))
        m = len(self.shared)
        s = w * (self.columns[source, rows] - part.offset[:m]) - u @ part.along[:, :m]
        return np.hstack([w / np.sum(self.weights[:, source]), u, s])

    def share(self, source: int) -> Array:
        """Derivative of the unknowns by the target of `source` along its rows, (q, n_unknowns)."""
        part, m = self.parts[source], len(self.shared)
        kept = (1.0 - part.shrinkage(self.penalties[source]))[:, None] * part.along[:, :m]
        side = np.vstack([np.zeros((1, m)), kept, np.eye(m)])
        f = np.linalg.solve(self.normal, side.T).T
        pairs = zip(self.parts, self.penalties, strict=True)
        own = [-f @ part.coefficients(penalty)[:, :m].T for part, penalty in pairs]
        own[source][1 : 1 + len(part.s)] += part.share(self.penalties[source])
        if part.constant is not None:
            own[source][0, part.constant] += 1.0
        return np.hstack([*own, f])

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the unknowns, (n_unknowns, n_unknowns).

        For stationary residuals that are independent between the degrees of freedom.
        """
        inflated = len(self.rest) / np.maximum(len(self.rest) - self.parameters, 1.0)
        total = np.zeros((self.theta.size + len(self.shared),) * 2)
        for part in {id(part): part for part in self.parts}.values():
            alike = [k for k, other in enumerate(self.parts) if other is part]
            rows = partial(self.rows, alike[0])
            for k, own in zip(alike, long_run_covariances(rows, self.rest[:, alike]), strict=True):
                total += inflated[k] * self.share(k).T @ own @ self.share(k)
        return total

    def unstacked(self, unknowns: Array) -> tuple[Array, Array]:
        """Values of the unknowns as theta, NaN for terms that do not vary, and f."""
        theta = unknowns[: self.theta.size].reshape(self.theta.shape[::-1]).T
        return np.where(self.varies[:, None], theta, np.nan), unknowns[self.theta.size :]


def fit(
    samples: Samples, weights: Array, penalties: Array | None = None, shared: Array | None = None
) -> LinearFit:
    """Fit all degrees of freedom; weights (N, n_dof), penalties (n_dof,), shared (n_dof, N, m).

    For the shared unknowns f the own columns are projected out of the shared columns and the
    targets (Frisch, Waugh and Lovell): sum_k S_k' W (I - H_k) S_k f = sum_k S_k' W (I - H_k) y_k.
    Raises IdentificationError when the columns are dependent.
    """
    y, phi = samples.epsilon, samples.phi
    n, n_dof = y.shape
    ridge = np.zeros(n_dof) if penalties is None else penalties
    parts = decompositions(samples, weights, bool(np.all(ridge > 0.0)), shared)
    s = np.zeros((n_dof, n, 0)) if shared is None else shared
    m = s.shape[2]
    normal, side = np.zeros((m, m)), np.zeros(m)
    for k, part in enumerate(parts):
        kept = (1.0 - part.shrinkage(ridge[k]))[:, None] * part.along[:, :m]
        normal += part.left[:, :m].T @ part.left[:, :m] + part.along[:, :m].T @ kept
        side += part.left[:, :m].T @ part.left[:, m + k] + kept.T @ part.along[:, m + k]
    f = np.asarray(np.linalg.solve(normal, side), dtype=np.float64)
    own = [part.coefficients(ridge[k]) for k, part in enumerate(parts)]
    theta = np.stack([each[:, m + k] - each[:, :m] @ f for k, each in enumerate(own)], axis=1)
    rest = y - phi @ theta - np.einsum("knm,m->nk", s, f)
    return LinearFit(samples, weights, s, parts, ridge, normal, theta, f, rest)


def standard_errors(fitted: LinearFit, kind: ErrorKind) -> tuple[Array, Array]:
    """Standard errors of theta (n_terms, n_dof) and of the shared unknowns (m,).

    `stationary` assumes that the residuals of different degrees of freedom are independent. The
    result is NaN for terms that do not vary.
    """
    if kind == "stationary":
        return fitted.unstacked(np.sqrt(np.clip(np.diag(fitted.covariance), 0.0, None)))
    n, variances = len(fitted.rest), []
    rest = fitted.rest * np.sqrt(n / np.maximum(n - fitted.parameters, 1.0))
    shares = [fitted.share(k) for k in range(rest.shape[1])]
    for turn in turns(shares[0].shape[1], len(fitted.theta)):
        sources = [k for k, share in enumerate(shares) if np.any(share[:, turn])]
        series = [
            (fitted.rows(k, slice(n)) @ shares[k][:, turn]) * rest[:, [k]] for k in sources
        ]
        variances.append(hac_variance(np.sum(series, axis=0)))
    return fitted.unstacked(np.sqrt(np.clip(np.concatenate(variances), 0.0, None)))


def bootstrap_errors(
    fitted: LinearFit, length: int, replicates: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Standard errors, as `standard_errors`, by a block bootstrap of the residuals.

    `length` is the number of samples in a block.
    """
    n, parts = len(fitted.rest), fitted.parts
    rows = {id(part): fitted.rows(k, slice(n)) for k, part in reversed([*enumerate(parts)])}
    shares = [fitted.share(k) for k in range(len(parts))]

    def refit(rest: Array) -> Array:
        along = [rows[id(part)].T @ rest[:, k] for k, part in enumerate(parts)]
        return np.asarray(sum(a @ share for a, share in zip(along, shares, strict=True)))

    return fitted.unstacked(block_bootstrap(refit, fitted.rest, length, replicates, rng))


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
