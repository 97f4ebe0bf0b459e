"""Least squares and ridge regression of the lack of fit, with standard errors.

    minimise |epsilon_k - Phi theta_k|^2 + penalty_k |scaled theta_k|^2,   epsilon = tau - F0

for each degree of freedom k. The term 1 is the intercept and is not penalised; without it nothing
is centred. Columns that do not vary get a coefficient of zero. With [1, X, Y] = Q R everything
follows from R: its first row holds the means, the others are those of centred columns. R is
computed in blocks of rows that stay in the processor's cache. Golub and Van Loan (2013), Matrix
Computations, section 5.2; Demmel et al. (2012), SIAM J. Sci. Comput. 34, A206-A239.

If the force is first filtered by the thruster lag, least squares is exact on noise-free data. Ridge
regression shrinks the estimate towards the nominal model.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import IdentificationError
from seatrial.models.identification.constrained_table import finished
from seatrial.models.identification.problem import Identified, Problem
from seatrial.models.identification.residual import ResidualOptions, Samples, thruster_of, turns
from seatrial.models.identification.uncertainty import (
    TableSpread,
    correlation,
    factor_of,
    long_run_covariances,
)
from seatrial.models.ranges import NotNegative
from seatrial.models.vessel.basis import Array, Term
from seatrial.models.vessel.table import Vessel

TRAINING = "training part does not distinguish"
SINGULAR_RATIO = 1e-12


def triangle(pieces: Iterable[Array]) -> Array:
    """R of the QR factorisation of stacked blocks of rows, one in memory at a time."""
    R: Array | None = None
    for piece in pieces:
        below = piece if R is None else np.vstack([R, piece])
        R = np.asarray(np.linalg.qr(below, mode="r"), dtype=np.float64)
    assert R is not None, "got no rows"
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
    """A table that is linear in its targets, with what its standard errors need.

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

        Raises IdentificationError for dependent columns without a penalty.
        """
        samples, s = self.samples, self.s
        ridge = np.zeros(samples.epsilon.shape[1]) if penalties is None else penalties
        if not np.all(ridge > 0.0):
            names = [str(samples.terms[i]) for i in self.columns]
            check_distinguished(s, self.vt, names, TRAINING, SINGULAR_RATIO)
        shares = np.array([self.share(penalty) for penalty in ridge])
        theta = np.stack([(each[1:].T @ self.along)[:, k] for k, each in enumerate(shares)], axis=1)
        if samples.constant is not None:
            theta[samples.constant] += self.offset
        varies = np.isin(range(len(samples.terms)), self.columns)
        varies[[] if samples.constant is None else samples.constant] = True
        condition = 1.0 if not len(s) else float(s[0] / s[-1]) if s[-1] > 0.0 else float("inf")
        return LinearFit(
            samples.terms, theta, samples.epsilon - samples.phi @ theta, self.rows, shares,
            np.array([self.parameters(penalty) for penalty in ridge]), varies, condition,
        )  # fmt: skip


@dataclass(frozen=True)
class LeastSquares(ResidualOptions):
    """Least squares by SVD on standardised columns, the term 1 as intercept."""

    def estimated(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """Identify the residual table with standard errors and condition numbers."""
        lag, diagnostics = thruster_of(self, problem)
        samples, dofs = self.samples(problem.training, problem.nominal, lag), problem.nominal.dofs
        part = Decomposition.of(samples)
        penalties = self.penalties(part)
        fitted = part.fit(penalties)
        errors, spread = np.full_like(fitted.theta, np.nan), None
        if not problem.compared:
            errors, spread = fitted.standard_errors(), fitted.spread()
        diagnostics += fitted.diagnostics(dofs)
        if penalties is not None:
            for dof, penalty in zip(dofs, penalties.tolist(), strict=True):
                diagnostics += (
                    Diagnostic("ridge_penalty", dof, penalty / len(samples)),
                    Diagnostic("effective_parameters", dof, part.parameters(penalty)),
                )
        residual = fitted.residual(dofs)
        model = problem.nominal + residual
        result = Identified(model, residual, errors, diagnostics, spread=spread)
        return finished(self, problem, lag, samples, result)

    def penalties(self, part: Decomposition) -> Array | None:
        """Penalty of each degree of freedom (n_dof,); None: there is none."""
        return None


@dataclass(frozen=True)
class Ridge(LeastSquares):
    """Least squares with a penalty on the standardised coefficients.

    `penalty` is per sample: sum of squares + penalty N |theta|^2. With null it minimises the
    generalised cross-validation of each degree of freedom.
    """

    penalty: NotNegative | None

    def penalties(self, part: Decomposition) -> Array:
        """Penalty of each degree of freedom (n_dof,)."""
        n, n_dof = part.samples.epsilon.shape
        if self.penalty is not None:
            return np.full(n_dof, self.penalty * n)
        return np.array([least_gcv(part, k) for k in range(n_dof)])


def least_gcv(part: Decomposition, k: int) -> float:
    """The penalty of the least generalised cross-validation of degree of freedom k.

    n |rest|^2 / (n - parameters)^2 for n samples, by three successively finer grids. Golub, Heath
    and Wahba (1979), Technometrics 21, 215-223.
    """
    n, orthogonal = len(part.samples), float(np.sum(part.left[:, k] ** 2))
    low, high = 1e-16 * part.s[0] ** 2, 1e3 * part.s[0] ** 2
    for _ in range(3):
        grid = np.geomspace(low, high, 61)
        shrinkage = grid[:, None] / (part.s**2 + grid[:, None])
        square = orthogonal + np.sum((shrinkage * part.along[:, k]) ** 2, axis=1)
        parameters = np.array([part.parameters(penalty) for penalty in grid])
        best = int(np.argmin(n * square / (n - parameters) ** 2))
        low, high = grid[max(best - 1, 0)], grid[min(best + 1, 60)]
    return float(grid[best])
