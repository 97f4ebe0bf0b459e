"""Least squares and ridge regression of the lack of fit, with standard errors.

    theta = argmin sum_i |epsilon_i - Phi_i' theta|^2 + penalty |scaled theta|^2

epsilon = tau - F0(nu_dot, nu). If the force is first filtered by the thruster lag, least squares
is exact on noise-free data. Ridge regression shrinks the estimate towards the nominal model; its
penalty minimises the generalised cross-validation of Golub, Heath and Wahba (1979), Technometrics
21, 215-223.
"""

from dataclasses import dataclass

import numpy as np

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError
from seatrial.models.identification.constrained_table import finished
from seatrial.models.identification.linear import (
    NED,
    Decomposition,
    LinearFit,
    condition_diagnostics,
    fit,
    turns,
)
from seatrial.models.identification.problem import Identified, Problem
from seatrial.models.identification.residual import HEADING, ResidualOptions, thruster_of
from seatrial.models.identification.spread import table_spread
from seatrial.models.notation import PLANAR
from seatrial.models.ranges import NotNegative
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

MAX_ROUNDS = 30


@dataclass(frozen=True)
class LeastSquares(ResidualOptions):
    """Least squares by SVD on standardised columns, the term 1 as intercept.

    `ned_force` adds a force (north, east) that is constant in NED, shared between surge and sway.
    """

    ned_force: bool

    def check(self, nominal: Vessel, thruster: SecondOrderLag | None, measured: bool) -> None:
        """Raise ConfigurationError for options that do not fit the vessel."""
        super().check(nominal, thruster, measured)
        if self.ned_force and nominal.dofs != PLANAR:
            raise ConfigurationError(
                f"identifier.ned_force needs a vessel in {', '.join(PLANAR)}, "
                f"got one in {', '.join(nominal.dofs)}"
            )
        repeated = [term.name for term in HEADING if term in self.terms(nominal)]
        if self.ned_force and repeated:
            raise ConfigurationError(
                f"identifier.ned_force already has {repeated[0]}: remove it from the basis or from "
                f"extra_terms"
            )

    def estimated(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """Identify the residual table with standard errors and condition numbers."""
        lag, diagnostics = thruster_of(self, problem)
        samples, dofs = self.samples(problem.training, problem.nominal, lag), problem.nominal.dofs
        part = Decomposition.of(samples, self.ned_force)
        penalties = self.penalties(part)
        fitted = fit(part, penalties)
        if self.ned_force:
            fitted = weighted(fitted, penalties)
        errors, f_errors = (np.full_like(x, np.nan) for x in (fitted.theta, fitted.force))
        spread = None
        if not problem.compared:
            errors, f_errors = fitted.standard_errors()
        if not (problem.compared or self.ned_force):
            blocks = turns(fitted.theta.size, len(fitted.theta))
            spread = table_spread([fitted.covariance[own, own] for own in blocks], fitted.rest)
        conditions = [part.condition] * len(dofs)
        diagnostics += condition_diagnostics(samples.terms, part.varies, conditions, dofs)
        if penalties is not None:
            for dof, penalty in zip(dofs, penalties.tolist(), strict=True):
                diagnostics += (
                    Diagnostic("ridge_penalty", dof, penalty / len(samples)),
                    Diagnostic("effective_parameters", dof, part.parameters(penalty)),
                )
        residual = Vessel("residual", dofs, samples.terms, fitted.theta)
        if self.ned_force:
            residual += Vessel("force", dofs, HEADING, (NED @ fitted.force).T)
            shares = np.where(NED.any(axis=2), np.abs(NED @ f_errors), np.nan)
            errors = np.vstack([errors, shares.T])
            diagnostics += ned_diagnostics(fitted.force, f_errors)
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
        """Penalty of each degree of freedom (n_dof,), after what the force in NED explains."""
        n, n_dof = part.samples.epsilon.shape
        if self.penalty is not None:
            return np.full(n_dof, self.penalty * n)
        explained = np.zeros((n_dof, 0))
        if self.ned_force:
            explained = NED @ fit(part).force
        return np.array([least_gcv(part, k, f, n) for k, f in enumerate(explained)])


def weighted(fitted: LinearFit, penalties: Array | None) -> LinearFit:
    """The fit with each degree of freedom weighted by the precision of its residuals."""
    floor = 1e-9 * np.std(fitted.part.samples.force, axis=0) + np.finfo(float).tiny
    for _ in range(MAX_ROUNDS):
        precision = 1.0 / (np.mean(fitted.rest**2, axis=0) + floor**2)
        last, weights = fitted.weights, precision / np.max(precision)
        fitted = fit(fitted.part, penalties, weights)
        if np.max(np.abs(weights - last)) < 1e-4 * np.max(weights):
            break
    return fitted


def gcv(part: Decomposition, k: int, f: Array, n: int, penalties: Array) -> Array:
    """Generalised cross-validation n |rest|^2 / (n - parameters)^2 for each penalty, their shape.

    The target is that of degree of freedom k after f (m,) times the shared columns; n is the number
    of samples.
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


def ned_diagnostics(force: Array, errors: Array) -> tuple[Diagnostic, ...]:
    """The constant force (north, east) [N] and its standard errors."""
    diagnostics = []
    for label, value, error in zip(("north", "east"), force, errors, strict=True):
        diagnostics.append(Diagnostic("ned_force", "all", float(value), "N", label=label))
        diagnostics.append(Diagnostic("ned_force_std_error", "all", float(error), "N", label=label))
    return tuple(diagnostics)
