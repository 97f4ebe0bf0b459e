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
from seatrial.models.identification.constrained_table import finished
from seatrial.models.identification.linear import Decomposition
from seatrial.models.identification.problem import Identified, Problem
from seatrial.models.identification.residual import ResidualOptions, thruster_of
from seatrial.models.ranges import NotNegative
from seatrial.models.vessel.basis import Array


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

    n |rest|^2 / (n - parameters)^2 for n samples, by three successively finer grids.
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
