"""The joint distribution of what was identified, of which models are drawn.

Standard errors alone say too little: coefficients of a ship are strongly correlated, and what is
predicted with all of them is known far better than each of them. So the deviations and the
correlations that are drawn are of one covariance, which allows for residuals that depend on each
other: those of the standard errors with the correlations for white residuals are too wide.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from seatrial.models.identification.free_parameters import FreeParameters
from seatrial.models.identification.problem import Identified, Spread
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel


@dataclass(frozen=True, eq=False)
class TableSpread(Spread):
    """Normal distribution of a table that a regression has found; variances of zero are fixed.

    `within` holds a factor A (n_terms, n_terms) of the correlation A A' of the coefficients of
    every degree of freedom, `across` one (n_dof, n_dof) of that of their residuals.
    """

    within: tuple[Array, ...]
    across: Array

    def draw(
        self, result: Identified, rng: np.random.Generator, share: float = 1.0, kappa2: float = 1.0
    ) -> Vessel:
        """The model with coefficients drawn from the distribution; fixed ones stay."""
        residual = result.residual
        assert result.std_error is not None
        z = rng.standard_normal((len(self.within[0]), len(self.across))) @ self.across.T
        units = np.stack([A @ z[:, k] for k, A in enumerate(self.within)], axis=1)
        change = share * np.sqrt(kappa2) * np.nan_to_num(result.std_error) * units
        return result.model + Vessel("drawn", residual.dofs, residual.terms, change)


@dataclass(frozen=True, eq=False)
class ParameterSpread(Spread):
    """Normal distribution of free parameters (m,), those of devices among them."""

    nominal: Vessel
    free: FreeParameters
    point: Array
    covariance: Array  # (m, m)
    prior: Array | None = None  # (m,) precision of the prior, which inv(covariance) contains

    def draw(
        self, result: Identified, rng: np.random.Generator, share: float = 1.0, kappa2: float = 1.0
    ) -> Vessel:
        """The model with parameters drawn from the distribution, devices in plausible ranges."""
        change = self.factor(kappa2) @ rng.standard_normal(len(self.point))
        return self.free.model(self.nominal, self.point + share * change)

    def factor(self, kappa2: float) -> Array:
        """B (m, m) with B B' = ((inv(covariance) - P) / kappa2 + P)^-1, P the prior's precision.

        With A A' = covariance and the eigenvalues and vectors of A'PA = V diag(b) V', the shares of
        the prior in what is known, B is A V diag((1 - b) / kappa2 + b)^(-1/2) V'.
        """
        if kappa2 not in self._factors:
            A = factor_of(self.covariance)
            P = np.zeros(len(A)) if self.prior is None else self.prior
            share, V = np.linalg.eigh(A.T @ (P[:, None] * A))
            share = np.clip(share, 0.0, 1.0)
            self._factors[kappa2] = A @ (V / np.sqrt((1.0 - share) / kappa2 + share)) @ V.T
        return self._factors[kappa2]

    @cached_property
    def _factors(self) -> dict[float, Array]:
        return {}


def correlation(covariance: Array) -> Array:
    """Correlations (n, n) of a covariance; zero where there is no variance."""
    deviation = np.sqrt(np.diag(covariance))
    inverse = np.divide(1.0, deviation, out=np.zeros_like(deviation), where=deviation > 0.0)
    return np.asarray(covariance * np.outer(inverse, inverse))


def factor_of(covariance: Array) -> Array:
    """A with A A' = covariance (n, n), which may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.clip(values, 0.0, None)))
