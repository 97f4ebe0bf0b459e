"""Linear least squares with an optional ridge, by SVD on standardised columns.

    minimise sum_k sum_i w_ik (y_ik - phi_i' theta_k - s_ik' f)^2 + penalty_k |scaled theta_k|^2

Each degree of freedom k has its own theta_k; f are unknowns that the degrees of freedom share. The
term 1 is the intercept and is not penalised; without it nothing is centred. Columns that do not
vary get a coefficient of zero.

Tall matrices, with one row per sample, are factorised in blocks of rows. LAPACK passes over the
matrix once per column; a block of some thousand rows stays in the processor's cache, and only one
block has to be in memory. R of all rows is R of the last R stacked on the next block, and a product
of factors with orthonormal columns has orthonormal columns: Golub and Van Loan
(2013), Matrix Computations, section 5.2; Demmel, Grigori, Hoemmen and Langou (2012), SIAM J. Sci.
Comput. 34, A206-A239.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from seatrial.models.errors import IdentificationError
from seatrial.models.identification.residual import Samples
from seatrial.models.identification.uncertainty import (
    ErrorKind,
    block_bootstrap,
    hac_variance,
    stationary_variance,
)
from seatrial.models.vessel.basis import Array

TOGETHER = 2048  # rows in a block
SINGULAR_RATIO = 1e-12


def turns(n: int, together: int = TOGETHER) -> list[slice]:
    """Slices of n rows, `together` rows each."""
    return [slice(a, min(a + together, n)) for a in range(0, n, together)]


def triangle(pieces: Iterable[Array]) -> Array:
    """R of the QR factorisation of stacked blocks of rows, one in memory at a time."""
    R: Array | None = None
    for piece in pieces:
        below = piece if R is None else np.vstack([R, piece])
        R = np.asarray(np.linalg.qr(below, mode="r"), dtype=np.float64)
    if R is None:
        raise ValueError("triangle: got no rows")
    return R


def qr(x: Array) -> tuple[Array, Array]:
    """Q (N, P) and R (P, P) of x (N, P), N at least P; Q may overwrite x."""
    rows = max(TOGETHER, 4 * x.shape[1])
    if len(x) < 2 * rows:
        Q, R = np.linalg.qr(x)
        return Q, R
    pieces = np.array_split(x, len(x) // rows)  # views
    factors = []
    for piece in pieces:
        piece[:], R = np.linalg.qr(piece)
        factors.append(R)
    Q_of_R, R = np.linalg.qr(np.vstack(factors))
    for piece, rotation in zip(pieces, np.split(Q_of_R, len(pieces)), strict=True):
        piece[:] = piece @ rotation
    return x, R


def svd(x: Array) -> tuple[Array, Array, Array]:
    """U (N, P), singular values (P,) and V' (P, P) of x (N, P); U may overwrite x."""
    if len(x) < 2 * TOGETHER:
        u, s, vt = np.linalg.svd(x, full_matrices=False)
        return u, s, vt
    Q, R = qr(x)
    u, s, vt = np.linalg.svd(R)
    for turn in turns(len(Q)):
        Q[turn] = Q[turn] @ u
    return Q, s, vt


@dataclass(frozen=True, eq=False)
class Decomposition:
    """SVD of the weighted, standardised columns of a regression: U diag(s) V'."""

    n_terms: int
    columns: NDArray[np.int64]  # terms that vary
    constant: int | None  # index of the intercept
    mean: Array  # of the columns; zero without an intercept
    scale: Array  # standard deviation of the columns; root mean square without an intercept
    weights: Array  # (N,)
    u: Array  # (N, n_columns)
    s: Array
    vt: Array

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

    def coefficients(self, targets: Array, penalty: float = 0.0) -> Array:
        """Coefficients of the terms, shape (n_terms, m), of targets (N, m)."""
        along = self.u.T @ self.weighted(targets)
        scaled = self.vt.T @ ((self.shrinkage(penalty) / self.s)[:, None] * along)
        theta = np.zeros((self.n_terms, targets.shape[1]))
        theta[self.columns] = scaled / self.scale[:, None]
        if self.constant is not None:
            theta[self.constant] = self._offset(targets) - self.mean @ theta[self.columns]
        return theta

    def weighted(self, targets: Array) -> Array:
        """Weighted targets (N, m), centred if there is an intercept."""
        root = np.sqrt(self.weights)[:, None]
        return np.asarray(root * (targets - self._offset(targets)))

    def gains(self, penalty: float = 0.0) -> Array:
        """Derivative of the coefficients with respect to each target, shape (N, n_terms).

        The coefficients of targets are gains' targets.
        """
        share = np.zeros((len(self.s), self.n_terms))
        share[:, self.columns] = (self.shrinkage(penalty) / self.s)[:, None] * self.vt / self.scale
        if self.constant is not None:
            share[:, self.constant] = -share[:, self.columns] @ self.mean
        g = self.u @ share
        g *= np.sqrt(self.weights)[:, None]
        if self.constant is not None:
            g[:, self.constant] += self.weights / np.sum(self.weights)
        return np.asarray(g)

    def _offset(self, targets: Array) -> Array:
        if self.constant is None:
            return np.zeros(targets.shape[1])
        return np.asarray(np.average(targets, axis=0, weights=self.weights))


def decompose(samples: Samples, weights: Array, penalised: bool = False) -> Decomposition:
    """Decompose the columns of a regression with positive weights (N,).

    Raises IdentificationError with the names of the terms when the columns are dependent and no
    penalty makes the solution unique.
    """
    constant, columns = samples.constant, samples.varying
    if constant is None:
        columns = np.flatnonzero(np.any(samples.phi != 0.0, axis=0))
    x = samples.phi[:, columns]  # a copy, changed in place to save memory
    mean = np.zeros(len(columns))
    if constant is not None:
        mean = np.average(x, axis=0, weights=weights)
    x -= mean
    scale = np.sqrt(np.einsum("n,nj,nj->j", weights, x, x) / np.sum(weights))
    x /= scale
    x *= np.sqrt(weights)[:, None]
    u, s, vt = svd(x)
    if len(s) and s[-1] <= SINGULAR_RATIO * s[0] and not penalised:
        names = [str(samples.terms[columns[i]]) for i in np.flatnonzero(np.abs(vt[-1]) > 0.1)]
        raise IdentificationError(
            f"the training part does not distinguish {', '.join(names)} from each other: got a "
            f"singular value ratio of {s[-1] / s[0]:.1e}, expected more than {SINGULAR_RATIO:g}"
        )
    return Decomposition(samples.phi.shape[1], columns, constant, mean, scale, weights, u, s, vt)


@dataclass(frozen=True, eq=False)
class LinearFit:
    """A fit of every degree of freedom, with the data needed for its standard errors."""

    theta: Array  # (n_terms, n_dof)
    shared: Array  # (m,)
    rest: Array  # (N, n_dof) residuals
    parts: tuple[Decomposition, ...]  # of each degree of freedom; equal weights share one object
    penalties: Array  # (n_dof,)
    cross: Array  # (n_dof, n_terms, m) coefficients of the shared columns on the own columns
    shared_gains: Array  # (n_dof, N, m) derivative of the shared unknowns by epsilon
    condition: Array  # (n_dof,)
    parameters: Array  # (n_dof,) effective number of parameters

    def own_gains(self, dof: int) -> Array:
        """Derivative of theta of a degree of freedom by its own epsilon, (N, n_terms)."""
        return self.parts[dof].gains(float(self.penalties[dof]))

    def gains(self, source: int, dof: int) -> Array:
        """Derivative of theta of `dof` by the epsilon of `source`, (N, n_terms)."""
        indirect = -self.shared_gains[source] @ self.cross[dof].T
        return np.asarray(self.own_gains(dof) + indirect if source == dof else indirect)

    @property
    def alike(self) -> list[list[int]]:
        """Groups of degrees of freedom that have the same own gains."""
        same: dict[tuple[int, float], list[int]] = {}
        for k, part in enumerate(self.parts):
            same.setdefault((id(part), float(self.penalties[k])), []).append(k)
        return list(same.values())


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
    s = np.zeros((n_dof, n, 0)) if shared is None else shared
    parts = decompositions(samples, weights, bool(np.all(ridge > 0.0)))
    own = [p.coefficients(y[:, [k]], ridge[k])[:, 0] for k, p in enumerate(parts)]
    cross = np.array([p.coefficients(s[k], ridge[k]) for k, p in enumerate(parts)])
    projected = weights.T[:, :, None] * (s - phi @ cross)
    normal = np.einsum("knm,knl->ml", projected, s)
    f = np.linalg.solve(normal, np.einsum("knm,nk->m", projected, y))
    theta = np.stack(own, axis=1) - np.einsum("ktm,m->tk", cross, f)
    return LinearFit(
        theta=theta,
        shared=f,
        rest=y - phi @ theta - np.einsum("knm,m->nk", s, f),
        parts=tuple(parts),
        penalties=ridge,
        cross=cross,
        shared_gains=np.array([np.linalg.solve(normal, part.T).T for part in projected]),
        condition=np.array([p.condition for p in parts]),
        parameters=np.array([p.parameters(ridge[k]) for k, p in enumerate(parts)]),
    )


def decompositions(
    samples: Samples, weights: Array, penalised: bool = False
) -> list[Decomposition]:
    """One decomposition per degree of freedom; equal weights share one object."""
    first = decompose(samples, weights[:, 0], penalised)
    return [
        first if np.array_equal(w, weights[:, 0]) else decompose(samples, w, penalised)
        for w in weights.T
    ]


def standard_errors(fitted: LinearFit, kind: ErrorKind) -> tuple[Array, Array]:
    """Standard errors of theta (n_terms, n_dof) and of the shared unknowns (m,).

    `stationary` assumes that the residuals of different degrees of freedom are independent. The
    result is NaN for terms that do not vary.
    """
    n, n_dof = fitted.rest.shape
    rest = fitted.rest * np.sqrt(n / np.maximum(n - fitted.parameters, 1.0))
    own = np.zeros((fitted.theta.shape[0], n_dof))
    if fitted.shared.size == 0:
        for group in fitted.alike:
            own[:, group] = _deviation(fitted.own_gains(group[0]), rest[:, group], kind)
        return _nan_where_fixed(own, fitted), np.zeros(0)
    for k in range(n_dof):
        own[:, k] = _joint_deviation([fitted.gains(j, k) for j in range(n_dof)], rest, kind)
    return _nan_where_fixed(own, fitted), _joint_deviation(list(fitted.shared_gains), rest, kind)


def _deviation(gain: Array, rest: Array, kind: ErrorKind) -> Array:
    """Standard deviation (P, K) of sum_i g_i e_i, for gains (N, P) and each residual of (N, K)."""
    if kind == "hac":
        variance = np.stack([hac_variance(gain * residual[:, None]) for residual in rest.T], axis=1)
    else:
        variance = stationary_variance(gain, rest)
    return np.sqrt(np.clip(variance, 0.0, None))


def _joint_deviation(gains: list[Array], rest: Array, kind: ErrorKind) -> Array:
    """Standard deviation (P,) of the sum over the degrees of freedom, each with its gains."""
    if kind == "hac":
        series = [g * rest[:, [k]] for k, g in enumerate(gains)]
        variance = hac_variance(np.sum(series, axis=0))
    else:
        parts = [stationary_variance(g, rest[:, k]) for k, g in enumerate(gains)]
        variance = np.asarray(np.sum(parts, axis=0))
    return np.sqrt(np.clip(variance, 0.0, None))


def bootstrap_errors(
    fitted: LinearFit, length: int, replicates: int, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Standard errors, as `standard_errors`, by a block bootstrap of the residuals.

    `length` is the number of samples in a block.
    """
    n_terms, n_dof = fitted.theta.shape
    gains = {k: fitted.own_gains(same[0]) for same in fitted.alike for k in same}

    def refit(rest: Array) -> Array:
        f = np.einsum("knm,nk->m", fitted.shared_gains, rest)
        own = [gains[k].T @ rest[:, k] - fitted.cross[k] @ f for k in range(n_dof)]
        return np.concatenate([*own, f])

    errors = block_bootstrap(refit, fitted.rest, length, replicates, rng)
    theta = errors[: n_terms * n_dof].reshape(n_dof, n_terms).T
    return _nan_where_fixed(theta, fitted), errors[n_terms * n_dof :]


def _nan_where_fixed(errors: Array, fitted: LinearFit) -> Array:
    part = fitted.parts[0]
    varies = np.zeros(part.n_terms, dtype=bool)
    varies[part.columns] = True
    if part.constant is not None:
        varies[part.constant] = True
    return np.where(varies[:, None], errors, np.nan)
