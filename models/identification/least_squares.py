"""Least squares and ridge regression of the lack of fit, with standard errors.

    theta = argmin sum_i w_i |epsilon_i - Phi_i' theta|^2 + penalty |scaled theta|^2

epsilon = tau - F0(nu_dot, nu). If the force is first filtered by the thruster lag, least squares
is exact on noise-free data. Ridge regression shrinks the estimate towards the nominal model; its
penalty minimises the generalised cross-validation of Golub, Heath and Wahba (1979), Technometrics
21, 215-223.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError
from seatrial.models.identification.constrained_table import finished
from seatrial.models.identification.linear import (
    Decomposition,
    LinearFit,
    bootstrap_errors,
    condition_diagnostics,
    decompositions,
    fit,
    standard_errors,
    turns,
)
from seatrial.models.identification.problem import Identified, Identifier, Problem
from seatrial.models.identification.residual import (
    NED_COLUMNS,
    ResidualOptions,
    Samples,
    ned_columns,
    ned_table,
    thruster_of,
)
from seatrial.models.identification.spread import TableSpread, table_spread
from seatrial.models.identification.uncertainty import ErrorKind, check_bootstrap
from seatrial.models.notation import PLANAR
from seatrial.models.ranges import NotNegative, Positive
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

HUBER = 1.345  # 95 % as efficient as least squares on Gaussian residuals
NORMAL_MAD = 1.4826  # standard deviation over median absolute deviation of a Gaussian
MAX_ROUNDS = 30


@dataclass(frozen=True)
class LeastSquares(ResidualOptions):
    """Weighted least squares by SVD on standardised columns, the term 1 as intercept.

    `ned_force` adds a force (north, east) that is constant in NED, shared between surge and sway.
    `weighting: huber` reduces the weight of outliers, `half_life_s` [s] that of old samples.
    `bootstrap` is the number of block-bootstrap replicates for standard errors; null uses `errors`.
    """

    ned_force: bool
    weighting: Literal["uniform", "huber"]
    half_life_s: Positive | None
    errors: ErrorKind
    bootstrap: int | None
    block_s: float

    def __post_init__(self) -> None:
        super().__post_init__()
        check_bootstrap(self.bootstrap, self.block_s)

    def check(self, nominal: Vessel, thruster: SecondOrderLag | None, measured: bool) -> None:
        """Raise ConfigurationError for options that do not fit the vessel."""
        super().check(nominal, thruster, measured)
        if self.ned_force and nominal.dofs != PLANAR:
            raise ConfigurationError(
                f"identifier.ned_force needs a vessel in {', '.join(PLANAR)}, "
                f"got one in {', '.join(nominal.dofs)}"
            )
        repeated = [term.name for term in NED_COLUMNS if term in self.terms(nominal)]
        if self.ned_force and repeated:
            raise ConfigurationError(
                f"identifier.ned_force already has {repeated[0]}: remove it from the basis or from "
                f"extra_terms"
            )

    def estimated(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """Identify the residual table with standard errors and condition numbers."""
        lag, diagnostics = thruster_of(self, problem)
        samples = self.samples(problem.training, problem.nominal, lag)
        result = self.regression(problem, samples, rng)
        result = replace(result, diagnostics=diagnostics + result.diagnostics)
        return finished(self, problem, lag, samples, result)

    def regression(
        self, problem: Problem, samples: Samples, rng: np.random.Generator
    ) -> Identified:
        """The residual table of the regression alone."""
        dofs = problem.nominal.dofs
        fitted, penalty_diagnostics = self.solve(samples, dofs)
        if problem.compared:
            errors, f_errors = (np.full_like(x, np.nan) for x in (fitted.theta, fitted.shared))
        elif self.bootstrap is None:
            errors, f_errors = standard_errors(fitted, self.errors)
        else:
            length = round(self.block_s / samples.period_s)
            errors, f_errors = bootstrap_errors(fitted, length, self.bootstrap, rng)
        residual = Vessel("residual", dofs, samples.terms, fitted.theta)
        conditions = [part.condition for part in fitted.parts]
        diagnostics = condition_diagnostics(samples.terms, fitted.varies, conditions, dofs)
        diagnostics += penalty_diagnostics
        if self.ned_force:
            residual += Vessel("force", dofs, NED_COLUMNS, ned_table(fitted.shared))
            shares = np.where(ned_table(np.ones(2)) != 0.0, np.abs(ned_table(f_errors)), np.nan)
            errors = np.vstack([errors, shares])
            diagnostics += ned_diagnostics(fitted.shared, f_errors)
        spread = None if problem.compared or self.ned_force else spread_of(fitted)
        model = problem.nominal + residual
        return Identified(model, residual, errors, diagnostics, spread=spread)

    def without_bootstrap(self) -> Identifier:
        """This identifier without bootstrap replicates."""
        return replace(self, bootstrap=None)

    def solve(
        self, samples: Samples, dofs: tuple[str, ...]
    ) -> tuple[LinearFit, tuple[Diagnostic, ...]]:
        """The fit, and the diagnostics about its penalty.

        Weights that depend on the residual (Huber's; the precision of each degree of freedom if
        they share unknowns) are computed from the last fit, until they converge.
        """
        shared = ned_columns(samples.heading) if self.ned_force else None
        base = recency(len(samples), samples.period_s, self.half_life_s)[:, None]
        weights = np.broadcast_to(base, samples.epsilon.shape)
        penalties, diagnostics = self.penalise(samples, weights, shared, dofs)
        fitted = fit(samples, weights, penalties, shared)
        depends = self.ned_force or self.weighting == "huber"
        for _ in range(MAX_ROUNDS if depends else 0):
            last, weights = weights, base * self.reweight(fitted.rest, samples)
            fitted = fit(samples, weights, penalties, shared)
            if np.max(np.abs(weights - last)) < 1e-4 * np.max(weights):
                break
        return fitted, diagnostics

    def reweight(self, rest: Array, samples: Samples) -> Array:
        """Weights from the residual `rest` (N, n_dof), shape (N, n_dof), at most 1."""
        floor = 1e-9 * np.std(samples.force, axis=0) + np.finfo(float).tiny
        weights = np.ones_like(rest)
        if self.weighting == "huber":
            scale = NORMAL_MAD * np.median(np.abs(rest), axis=0) + floor
            weights = np.minimum(1.0, HUBER * scale / np.maximum(np.abs(rest), floor))
        if self.ned_force:
            precision = 1.0 / (np.mean(weights * rest**2, axis=0) + floor**2)
            weights = weights * precision / np.max(precision)
        return weights

    def penalise(
        self, samples: Samples, weights: Array, shared: Array | None, dofs: tuple[str, ...]
    ) -> tuple[Array | None, tuple[Diagnostic, ...]]:
        """Penalty of each degree of freedom (n_dof,), None for no penalty, and its diagnostics."""
        return None, ()


@dataclass(frozen=True)
class Ridge(LeastSquares):
    """Least squares with a penalty on the standardised coefficients.

    `penalty` is per sample: sum of squares + penalty N |theta|^2. With null it minimises the
    generalised cross-validation of each degree of freedom.
    """

    penalty: NotNegative | None

    def penalise(
        self, samples: Samples, weights: Array, shared: Array | None, dofs: tuple[str, ...]
    ) -> tuple[Array, tuple[Diagnostic, ...]]:
        """Penalty of each degree of freedom (n_dof,), after the shared unknowns are subtracted."""
        f = np.zeros(0) if shared is None else fit(samples, weights, None, shared).shared
        parts, n = decompositions(samples, weights, self.penalty != 0.0, shared), len(samples)
        if self.penalty is not None:
            penalties = [self.penalty * n for _ in dofs]
        else:
            penalties = [least_gcv(part, k, f, n) for k, part in enumerate(parts)]
        diagnostics = []
        for dof, part, value in zip(dofs, parts, penalties, strict=True):
            diagnostics.append(Diagnostic("ridge_penalty", dof, value / n))
            diagnostics.append(Diagnostic("effective_parameters", dof, part.parameters(value)))
        return np.array(penalties), tuple(diagnostics)


def spread_of(fitted: LinearFit) -> TableSpread:
    """The distribution of a table without shared unknowns."""
    own = turns(fitted.theta.size, len(fitted.theta))
    return table_spread([fitted.covariance[each, each] for each in own], fitted.rest)


def gcv(part: Decomposition, k: int, f: Array, n: int, penalties: Array) -> Array:
    """Generalised cross-validation n |rest|^2 / (n - parameters)^2 for each penalty, their shape.

    The target is that of degree of freedom k after what the shared unknowns f (m,) explain; n is
    the number of samples.
    """
    change = np.append(-f, np.eye(part.along.shape[1] - len(f))[k])
    along, orthogonal = part.along @ change, float(np.sum((part.left @ change) ** 2))
    shrinkage = penalties[:, None] / (part.s**2 + penalties[:, None])
    square = orthogonal + np.sum((shrinkage * along) ** 2, axis=1)
    parameters = np.array([part.parameters(penalty) for penalty in penalties])
    return np.asarray(n * square / (n - parameters) ** 2)


def least_gcv(part: Decomposition, k: int, f: Array, n: int) -> float:
    """The penalty of the least generalised cross-validation, by three successively finer grids."""
    low, high = 1e-16 * part.s[0] ** 2, 1e3 * part.s[0] ** 2
    for _ in range(3):
        grid = np.geomspace(low, high, 61)
        best = int(np.argmin(gcv(part, k, f, n, grid)))
        low, high = grid[max(best - 1, 0)], grid[min(best + 1, 60)]
    return float(grid[best])


def recency(n: int, period_s: float, half_life_s: float | None) -> Array:
    """Weights (n,) that halve every `half_life_s` [s] before the last sample; None gives ones."""
    if half_life_s is None:
        return np.ones(n)
    age = period_s * np.arange(n - 1, -1, -1.0)
    return np.asarray(np.exp2(-age / half_life_s))


def ned_diagnostics(force: Array, errors: Array) -> tuple[Diagnostic, ...]:
    """The constant force (north, east) [N] and its standard errors."""
    diagnostics = []
    for label, value, error in zip(("north", "east"), force, errors, strict=True):
        diagnostics.append(Diagnostic("ned_force", "all", float(value), "N", label=label))
        diagnostics.append(Diagnostic("ned_force_std_error", "all", float(error), "N", label=label))
    return tuple(diagnostics)
