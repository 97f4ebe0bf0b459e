"""Least squares on the lack of fit, with standard errors.

    theta = argmin sum_i |epsilon_i - Phi_i' theta|^2,    epsilon = tau - F0(nu_dot, nu)

With the force passed through the thruster lag first this is exact on noise-free data.
"""

from dataclasses import dataclass

import numpy as np

from models.basis import Array
from models.identification.design import ResidualOptions, Samples
from models.identification.linear import LinearFit, fit
from models.identification.problem import Finding, Identified, Problem
from models.identification.uncertainty import hac_standard_errors
from models.vessel import Vessel


@dataclass(frozen=True)
class LeastSquares(ResidualOptions):
    """Ordinary least squares by SVD on standardised columns, the term 1 as intercept."""

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """The residual table with standard errors and the condition number of its columns."""
        samples = self.samples(problem.training, problem.nominal, problem.thruster)
        fitted = fit(samples, np.ones_like(samples.epsilon))
        residual = Vessel("residual", problem.nominal.dofs, samples.terms, fitted.theta)
        errors = standard_errors(fitted)
        findings = condition_findings(samples, fitted, problem.nominal.dofs)
        return Identified(problem.nominal + residual, residual, errors, findings)


def standard_errors(fitted: LinearFit) -> Array:
    """Standard errors of theta, shape (n_terms, n_dof); NaN for terms that do not vary."""
    n, n_terms, n_dof = fitted.influence.shape
    flat = fitted.influence.reshape(n, n_terms * n_dof)
    errors = hac_standard_errors(flat, n_terms).reshape(n_terms, n_dof)
    errors[~np.any(fitted.influence, axis=(0, 2))] = np.nan
    return errors


def condition_findings(
    samples: Samples, fitted: LinearFit, dofs: tuple[str, ...]
) -> tuple[Finding, ...]:
    """Condition number of the columns per degree of freedom, and the terms that do not vary."""
    found = [
        Finding("condition_number", dof, float(value))
        for dof, value in zip(dofs, fitted.condition, strict=True)
    ]
    kept = {*samples.varying.tolist(), samples.constant}
    dropped = [one.name for i, one in enumerate(samples.terms) if i not in kept]
    return (*found, *(Finding("dropped_term", "all", 1.0, label=name) for name in dropped))
