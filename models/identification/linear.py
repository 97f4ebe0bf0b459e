"""Linear least squares with an optional ridge, by SVD on standardised columns.

    minimise sum_k sum_i w_ik (y_ik - phi_i' theta_k - s_ik' f)^2 + penalty_k |scaled theta_k|^2

Each degree of freedom k has its own theta_k; f are unknowns that the degrees of freedom share. The
term 1 is the intercept and is not penalised; without it nothing is centred. Columns that do not
vary get a coefficient of zero.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.basis import Array
from models.errors import IdentificationError
from models.identification.design import Samples

SINGULAR = 1e-12


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
        """Largest over smallest singular value."""
        return float(self.s[0] / self.s[-1]) if len(self.s) else 1.0

    def shrinkage(self, penalty: float) -> Array:
        """s^2 / (s^2 + penalty), whose sum is the effective number of parameters."""
        return np.asarray(self.s**2 / (self.s**2 + penalty))

    def coefficients(self, targets: Array, penalty: float = 0.0) -> Array:
        """Coefficients of the terms, shape (n_terms, m), of targets (N, m)."""
        offset = self._mean(targets)
        weighted = np.sqrt(self.weights)[:, None] * (targets - offset)
        scaled = self.vt.T @ ((self.shrinkage(penalty) / self.s)[:, None] * (self.u.T @ weighted))
        theta = np.zeros((self.n_terms, targets.shape[1]))
        theta[self.columns] = scaled / self.scale[:, None]
        if self.constant is not None:
            theta[self.constant] = offset - self.mean @ theta[self.columns]
        return theta

    def influence(self, rest: Array, penalty: float = 0.0) -> Array:
        """What each sample adds to the error of the coefficients, shape (N, n_terms).

        rest (N,) is what the fit leaves; the sum over samples is zero without a penalty.
        """
        weighted = (np.sqrt(self.weights) * rest)[:, None] * self.u
        share = (weighted * (self.shrinkage(penalty) / self.s)) @ self.vt / self.scale
        psi = np.zeros((len(rest), self.n_terms))
        psi[:, self.columns] = share
        if self.constant is not None:
            intercept = self.weights * rest / np.sum(self.weights)
            psi[:, self.constant] = intercept - share @ self.mean
        return psi

    def _mean(self, values: Array) -> Array:
        if self.constant is None:
            return np.zeros(values.shape[1])
        return np.asarray(np.average(values, axis=0, weights=self.weights))


def decompose(samples: Samples, weights: Array) -> Decomposition:
    """Decompose the columns of a regression, weights (N,) positive.

    Raises IdentificationError, naming the terms, when columns are not independent.
    """
    constant, columns = samples.constant, samples.varying
    if constant is None:
        columns = np.flatnonzero(np.any(samples.phi != 0.0, axis=0))
    x = samples.phi[:, columns]
    mean = np.zeros(len(columns))
    if constant is not None:
        mean = np.average(x, axis=0, weights=weights)
    x = x - mean
    scale = np.sqrt(np.average(x**2, axis=0, weights=weights))
    u, s, vt = np.linalg.svd(np.sqrt(weights)[:, None] * (x / scale), full_matrices=False)
    if len(s) and s[-1] <= SINGULAR * s[0]:
        names = [str(samples.terms[columns[i]]) for i in np.flatnonzero(np.abs(vt[-1]) > 0.1)]
        raise IdentificationError(
            f"the training part does not tell {', '.join(names)} from each other "
            f"(singular value ratio {s[-1] / s[0]:.1e})"
        )
    return Decomposition(samples.phi.shape[1], columns, constant, mean, scale, weights, u, s, vt)


@dataclass(frozen=True, eq=False)
class LinearFit:
    """A fit of every degree of freedom, and what each sample adds to its error."""

    theta: Array  # (n_terms, n_dof)
    shared: Array  # (m,)
    rest: Array  # (N, n_dof) what the fit leaves
    influence: Array  # (N, n_terms, n_dof)
    shared_influence: Array  # (N, m)
    condition: Array  # (n_dof,)


def fit(
    samples: Samples, weights: Array, penalties: Array | None = None, shared: Array | None = None
) -> LinearFit:
    """Fit all degrees of freedom; weights (N, n_dof), penalties (n_dof,), shared (n_dof, N, m).

    The shared unknowns follow by projecting the own columns out of their columns and targets
    (Frisch, Waugh and Lovell): sum_k S_k' W (I - H_k) S_k f = sum_k S_k' W (I - H_k) y_k.
    """
    y = samples.epsilon
    n, n_dof = y.shape
    ridge = np.zeros(n_dof) if penalties is None else penalties
    columns = np.zeros((n_dof, n, 0)) if shared is None else shared
    m = columns.shape[2]
    parts = decompositions(samples, weights)
    own = [
        part.coefficients(np.column_stack([y[:, k], columns[k]]), ridge[k])
        for k, part in enumerate(parts)
    ]
    left = [np.column_stack([y[:, k], columns[k]]) - samples.phi @ own[k] for k in range(n_dof)]
    normal = sum(
        ((weights[:, k, None] * columns[k]).T @ left[k] for k in range(n_dof)), np.zeros((m, 1 + m))
    )
    f = np.linalg.solve(normal[:, 1:], normal[:, 0]) if m else np.zeros(0)
    theta = np.stack([b[:, 0] - b[:, 1:] @ f for b in own], axis=1)
    rest = np.stack([r[:, 0] - r[:, 1:] @ f for r in left], axis=1)
    scores = sum(
        (weights[:, k, None] * left[k][:, 1:] * rest[:, k, None] for k in range(n_dof)),
        np.zeros((n, m)),
    )
    f_influence = np.linalg.solve(normal[:, 1:], scores.T).T if m else scores
    influence = np.stack(
        [
            part.influence(rest[:, k], ridge[k]) - f_influence @ own[k][:, 1:].T
            for k, part in enumerate(parts)
        ],
        axis=2,
    )
    condition = np.array([part.condition for part in parts])
    return LinearFit(theta, f, rest, influence, f_influence, condition)


def decompositions(samples: Samples, weights: Array) -> list[Decomposition]:
    """One decomposition a degree of freedom; equal weights share one."""
    first = decompose(samples, weights[:, 0])
    return [first if np.array_equal(w, weights[:, 0]) else decompose(samples, w) for w in weights.T]
