"""Regression of the free parameters of a nominal model, with a prior and physical constraints.

The acceleration, the velocity and the force of every sample give one equation per degree of
freedom that is linear in the parameters dp = p - p_nominal (`free_parameters`). One quadratic
program holds all of them together,

    minimise sum_k |W (epsilon_k - Phi_k L dp)|^2 + tau sum_j (dp_j / s_j)^2.

W is one over the root mean square of each residual, found in a few rounds. s_j is the nominal size
of a parameter, so one that the recording does not determine stays at its nominal value;
tau = (1 + rho) / (1 - rho), with rho the lag-1 correlation of the residual, is the number of
samples that say as much as one independent sample.
"""

import numpy as np

from seatrial.models.identification.free_parameters import FreeParameters, free_parameters
from seatrial.models.identification.physical_constraints import PhysicalConstraints, solve
from seatrial.models.identification.residual import Samples
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel

WEIGHTING_ROUNDS = 4  # of reweighting
ZERO_FORCE = 1e-9  # of the force, below which a residual is rounding
MAX_CORRELATION = 0.999  # of a correlation


def prior_deviation(free: FreeParameters, phi: Array, force: Array) -> Array:
    """s (m,): the nominal size of each parameter, or what would explain the force if it is zero.

    phi (N, n_terms) over the terms of `free.nominal`, force (N, n_dof) [N, Nm].
    """
    columns = np.sqrt(np.einsum("nj,nj->j", phi, phi) / len(phi))  # no copy of a long record
    effect = np.max(columns[:, None, None] * np.abs(free.slopes), axis=0)  # (n_dof, m)
    share = np.full(effect.shape, np.inf)
    np.divide(np.std(force, axis=0)[:, None], effect, out=share, where=effect > 0.0)
    size = np.where(free.values != 0.0, np.abs(free.values), np.min(share, axis=0))
    return np.asarray(np.where(np.isfinite(size) & (size > 0.0), size, 1.0))


def inflation(rest: Array) -> float:
    """tau: samples that say as much as one independent sample of residuals (N, n_dof)."""
    centred = rest - np.mean(rest, axis=0)
    power = np.sum(centred**2, axis=0)
    lagged = np.sum(centred[1:] * centred[:-1], axis=0)
    rho = np.divide(lagged, power, out=np.zeros_like(power), where=power > 0.0)
    rho = np.clip(rho, 0.0, MAX_CORRELATION)
    return float(np.mean((1.0 + rho) / (1.0 - rho)))


def noise_scale(rest: Array, force: Array) -> Array:
    """Root mean square of residuals (N, n_dof), above what is rounding of the force; (n_dof,).

    It is one where there is neither a force nor a residual.
    """
    floor = ZERO_FORCE * np.std(force, axis=0)
    scale = np.maximum(np.sqrt(np.mean(rest**2, axis=0)), floor)
    return np.asarray(np.where(scale > 0.0, scale, 1.0))


class Structure:
    """The parameters of a table, the samples over its terms, the prior, and the constraints.

    nu (N, n_dof) are the recorded velocities; `inertia_factor` bounds the inertia, None: there are
    no physical constraints.
    """

    def __init__(
        self, free: FreeParameters, samples: Samples, nu: Array, inertia_factor: float | None
    ) -> None:
        self.free, self.samples = free, samples
        self.size = prior_deviation(free, samples.phi, samples.force)  # (m,)
        self.constraints: PhysicalConstraints | None = None
        if inertia_factor is not None:
            self.constraints = PhysicalConstraints(free, nu, inertia_factor, self.size)

    def regress(self, prior: float) -> tuple[Array, tuple[str, ...]]:
        """The change (m,) of the nominal parameters, and the names of the active constraints.

        `prior` is the deviation over the size. Raises IdentificationError without a solution.
        """
        samples, slopes = self.samples, self.free.slopes
        grams, sides = self._moments(samples.epsilon)
        scale, tau = noise_scale(samples.epsilon, samples.force), inflation(samples.epsilon)
        change, active = np.zeros(len(self.free)), tuple[str, ...]()
        for _ in range(WEIGHTING_ROUNDS):
            H = np.einsum("d,dij->ij", scale**-2, grams) + np.diag(tau / (prior * self.size) ** 2)
            g = np.einsum("d,dj->j", scale**-2, sides)
            change, active = solve(H, g, self.constraints, np.zeros(len(self.free)))
            rest = samples.epsilon - samples.phi @ (slopes @ change)
            scale, tau = noise_scale(rest, samples.force), inflation(rest)
        return change, active

    def nearest(self, table: Array) -> tuple[Array, tuple[str, ...]]:
        """The change (m,) that meets the constraints and explains the forces as a table does best.

        `table` (n_terms, n_dof) is identified - nominal. Returns the names of the constraints that
        it violates too; if there are none, the change is that of the table. Directions that the
        samples do not determine stay where they are.
        """
        change = self.free.change(table)
        away = table - self.free.slopes @ change
        broken = self.constraints.violated(change) if self.constraints else ()
        if np.any(np.abs(away) > ZERO_FORCE * np.max(np.abs(table), initial=0.0)):
            broken = ("symmetry", *broken)
        if self.constraints is None or not broken:
            return change, ()
        samples = self.samples
        rest = samples.epsilon - samples.phi @ table
        grams, sides = self._moments(samples.phi @ away)
        scale = noise_scale(rest, samples.force)
        H = np.einsum("d,dij->ij", scale**-2, grams) + np.diag(1.0 / self.size**2)
        step, _ = solve(H, np.einsum("d,dj->j", scale**-2, sides), self.constraints, change)
        return change + step, broken

    def _moments(self, epsilon: Array) -> tuple[Array, Array]:
        """Moments of the regressors (n_dof, m, m) and of them with epsilon (n_dof, m)."""
        phi, slopes = self.samples.phi, self.free.slopes
        gram, along = phi.T @ phi, phi.T @ epsilon
        dofs = range(epsilon.shape[1])
        return (
            np.array([slopes[:, d].T @ gram @ slopes[:, d] for d in dofs]),
            np.array([slopes[:, d].T @ along[:, d] for d in dofs]),
        )


def entries_of(table: Vessel, nominal: Vessel) -> FreeParameters:
    """Every coefficient of an estimated `table` as a parameter about the `nominal` model.

    They are those of the table's terms that are nonzero in either. Two entries of the inertia that
    mirror each other are one parameter where the nominal ones are equal.
    """
    both = nominal.on(nominal.terms + tuple(t for t in table.terms if t not in nominal.terms))
    nonzero = (table.on(both.terms).theta != 0.0) | (both.theta != 0.0)
    labels = [
        f"{dof}.{term}"
        for term, row in zip(both.terms, nonzero, strict=True)
        for dof, own in zip(both.dofs, row, strict=True)
        if own and term in table.terms
    ]
    return free_parameters(both, labels, "free", False, symmetric=True)
