"""Linear least squares with an optional ridge, by SVD on standardised columns.

    minimise sum_k sum_i w_ik (y_ik - phi_i' theta_k - s_ik' f)^2 + penalty_k |scaled theta_k|^2

Each degree of freedom k has its own theta_k; f are unknowns that the degrees of freedom share. The
term 1 is the intercept and is not penalised; without it nothing is centred. Columns that do not
vary get a coefficient of zero.

Tall matrices, one row a sample, are factorised piece by piece. LAPACK sweeps over a whole matrix
once a column; a piece of some thousand rows stays in the processor's cache meanwhile, and most of
it need not be in memory. R of the rows so far with the next piece below it has the R of all of
them, and a product of factors with orthonormal columns has orthonormal columns: Golub and Van Loan
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

TOGETHER = 2048  # rows
SINGULAR = 1e-12


def turns(n: int) -> list[slice]:
    """n rows, `TOGETHER` at a time."""
    return [slice(a, min(a + TOGETHER, n)) for a in range(0, n, TOGETHER)]


def triangle(pieces: Iterable[Array]) -> Array:
    """R of the QR factorisation of the pieces below one another, one in memory at a time."""
    R: Array | None = None
    for piece in pieces:
        below = piece if R is None else np.vstack([R, piece])
        R = np.asarray(np.linalg.qr(below, mode="r"), dtype=np.float64)
    if R is None:
        raise ValueError("triangle: got no rows")
    return R


def qr(x: Array) -> tuple[Array, Array]:
    """Q (N, P) and R (P, P) of x (N, P), N at least P; Q may take the place of x."""
    rows = max(TOGETHER, 4 * x.shape[1])
    if len(x) < 2 * rows:
        Q, R = np.linalg.qr(x)
        return Q, R
    pieces = np.array_split(x, len(x) // rows)  # views
    factors = []
    for piece in pieces:
        piece[:], R = np.linalg.qr(piece)
        factors.append(R)
    turned, R = np.linalg.qr(np.vstack(factors))
    for piece, turn in zip(pieces, np.split(turned, len(pieces)), strict=True):
        piece[:] = piece @ turn
    return x, R


def svd(x: Array) -> tuple[Array, Array, Array]:
    """U (N, P), singular values (P,) and V' (P, P) of x (N, P); U may take the place of x."""
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
        """Largest over smallest singular value; infinite where columns are not independent."""
        if not len(self.s):
            return 1.0
        return float(self.s[0] / self.s[-1]) if self.s[-1] > 0.0 else float("inf")

    def shrinkage(self, penalty: float) -> Array:
        """s^2 / (s^2 + penalty), whose sum is the effective number of parameters."""
        return np.asarray(self.s**2 / (self.s**2 + penalty))

    def parameters(self, penalty: float) -> float:
        """Effective number of parameters, with the intercept."""
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
        """Weighted targets (N, m), centred where there is an intercept."""
        root = np.sqrt(self.weights)[:, None]
        return np.asarray(root * (targets - self._offset(targets)))

    def gains(self, penalty: float = 0.0) -> Array:
        """Weight of each sample's residual in each coefficient, shape (N, n_terms).

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
    """Decompose the columns of a regression, weights (N,) positive.

    Raises IdentificationError, naming the terms, when columns are not independent, unless a
    penalty shares their effect among them.
    """
    constant, columns = samples.constant, samples.varying
    if constant is None:
        columns = np.flatnonzero(np.any(samples.phi != 0.0, axis=0))
    x = samples.phi[:, columns]  # a copy, changed in place: it is the largest thing there is
    mean = np.zeros(len(columns))
    if constant is not None:
        mean = np.average(x, axis=0, weights=weights)
    x -= mean
    scale = np.sqrt(np.einsum("n,nj,nj->j", weights, x, x) / np.sum(weights))
    x /= scale
    x *= np.sqrt(weights)[:, None]
    u, s, vt = svd(x)
    if len(s) and s[-1] <= SINGULAR * s[0] and not penalised:
        names = [str(samples.terms[columns[i]]) for i in np.flatnonzero(np.abs(vt[-1]) > 0.1)]
        raise IdentificationError(
            f"the training part does not tell {', '.join(names)} from each other "
            f"(singular value ratio {s[-1] / s[0]:.1e})"
        )
    return Decomposition(samples.phi.shape[1], columns, constant, mean, scale, weights, u, s, vt)


@dataclass(frozen=True, eq=False)
class LinearFit:
    """A fit of every degree of freedom, and what the gains follow from that its errors need."""

    theta: Array  # (n_terms, n_dof)
    shared: Array  # (m,)
    rest: Array  # (N, n_dof) what the fit leaves
    parts: tuple[Decomposition, ...]  # of each degree of freedom; those of equal weights are one
    penalties: Array  # (n_dof,)
    cross: Array  # (n_dof, n_terms, m): the same of the shared columns
    shared_gains: Array  # (n_dof, N, m): what makes the shared unknowns of epsilon
    condition: Array  # (n_dof,)
    parameters: Array  # (n_dof,) effective number fitted

    def own_gains(self, dof: int) -> Array:
        """What makes theta of a degree of freedom of its epsilon, (N, n_terms)."""
        return self.parts[dof].gains(float(self.penalties[dof]))

    def gains(self, source: int, dof: int) -> Array:
        """Weight of each sample's residual in `source` in theta of `dof`, (N, n_terms)."""
        indirect = -self.shared_gains[source] @ self.cross[dof].T
        return np.asarray(self.own_gains(dof) + indirect if source == dof else indirect)

    @property
    def alike(self) -> list[list[int]]:
        """Degrees of freedom with the same own gains, which are computed once for all of them."""
        same: dict[tuple[int, float], list[int]] = {}
        for k, part in enumerate(self.parts):
            same.setdefault((id(part), float(self.penalties[k])), []).append(k)
        return list(same.values())


def fit(
    samples: Samples, weights: Array, penalties: Array | None = None, shared: Array | None = None
) -> LinearFit:
    """Fit all degrees of freedom; weights (N, n_dof), penalties (n_dof,), shared (n_dof, N, m).

    The shared unknowns follow by projecting the own columns out of their columns and targets
    (Frisch, Waugh and Lovell): sum_k S_k' W (I - H_k) S_k f = sum_k S_k' W (I - H_k) y_k.
    """
    y, phi = samples.epsilon, samples.phi
    n, n_dof = y.shape
    ridge = np.zeros(n_dof) if penalties is None else penalties
    s = np.zeros((n_dof, n, 0)) if shared is None else shared
    parts = decompositions(samples, weights, bool(np.all(ridge > 0.0)))
    own = [p.coefficients(y[:, [k]], ridge[k])[:, 0] for k, p in enumerate(parts)]
    cross = np.array([p.coefficients(s[k], ridge[k]) for k, p in enumerate(parts)])
    left = weights.T[:, :, None] * (s - phi @ cross)
    normal = np.einsum("knm,knl->ml", left, s)
    f = np.linalg.solve(normal, np.einsum("knm,nk->m", left, y))
    theta = np.stack(own, axis=1) - np.einsum("ktm,m->tk", cross, f)
    return LinearFit(
        theta=theta,
        shared=f,
        rest=y - phi @ theta - np.einsum("knm,m->nk", s, f),
        parts=tuple(parts),
        penalties=ridge,
        cross=cross,
        shared_gains=np.array([np.linalg.solve(normal, part.T).T for part in left]),
        condition=np.array([p.condition for p in parts]),
        parameters=np.array([p.parameters(ridge[k]) for k, p in enumerate(parts)]),
    )


def decompositions(
    samples: Samples, weights: Array, penalised: bool = False
) -> list[Decomposition]:
    """One decomposition a degree of freedom; those of equal weights are one."""
    first = decompose(samples, weights[:, 0], penalised)
    return [
        first if np.array_equal(w, weights[:, 0]) else decompose(samples, w, penalised)
        for w in weights.T
    ]


def standard_errors(fitted: LinearFit, kind: ErrorKind) -> tuple[Array, Array]:
    """Standard errors of theta (n_terms, n_dof) and of the shared unknowns (m,).

    `stationary` takes residuals of different degrees of freedom as independent. Terms that do not
    vary have NaN.
    """
    n, n_dof = fitted.rest.shape
    rest = fitted.rest * np.sqrt(n / np.maximum(n - fitted.parameters, 1.0))
    own = np.zeros((fitted.theta.shape[0], n_dof))
    if fitted.shared.size == 0:
        for together in fitted.alike:
            own[:, together] = _deviation(fitted.own_gains(together[0]), rest[:, together], kind)
        return _known(own, fitted), np.zeros(0)
    for k in range(n_dof):
        own[:, k] = _joint_deviation([fitted.gains(j, k) for j in range(n_dof)], rest, kind)
    return _known(own, fitted), _joint_deviation(list(fitted.shared_gains), rest, kind)


def _deviation(gain: Array, rest: Array, kind: ErrorKind) -> Array:
    """Standard deviation (P, K) of sum_i g_i e_i, for gains (N, P) and each residual of (N, K)."""
    if kind == "hac":
        variance = np.stack([hac_variance(gain * one[:, None]) for one in rest.T], axis=1)
    else:
        variance = stationary_variance(gain, rest)
    return np.sqrt(np.clip(variance, 0.0, None))


def _joint_deviation(gains: list[Array], rest: Array, kind: ErrorKind) -> Array:
    """The same of the sum over the degrees of freedom, each with its gains; shape (P,)."""
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
    """The same by drawing blocks of residuals again; the fit is linear in them."""
    n_terms, n_dof = fitted.theta.shape
    gains = {k: fitted.own_gains(same[0]) for same in fitted.alike for k in same}

    def refit(rest: Array) -> Array:
        f = np.einsum("knm,nk->m", fitted.shared_gains, rest)
        own = [gains[k].T @ rest[:, k] - fitted.cross[k] @ f for k in range(n_dof)]
        return np.concatenate([*own, f])

    errors = block_bootstrap(refit, fitted.rest, length, replicates, rng)
    theta = errors[: n_terms * n_dof].reshape(n_dof, n_terms).T
    return _known(theta, fitted), errors[n_terms * n_dof :]


def _known(errors: Array, fitted: LinearFit) -> Array:
    part = fitted.parts[0]
    varies = np.zeros(part.n_terms, dtype=bool)
    varies[part.columns] = True
    if part.constant is not None:
        varies[part.constant] = True
    return np.where(varies[:, None], errors, np.nan)
