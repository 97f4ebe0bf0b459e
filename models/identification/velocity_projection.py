"""Projection of the posterior mean of a Gaussian process on the terms in the velocities."""

from dataclasses import dataclass

import numpy as np
import scipy

from seatrial.models.identification.kernel_posterior import Posterior, Prior, ProcessData
from seatrial.models.identification.physical_constraints import SCALES, sampled_velocities
from seatrial.models.notation import VELOCITIES
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array, Term
from seatrial.models.vessel.table import Vessel

AROUND = 0.1  # weight of the velocities around the recorded ones
SHRINKAGE = 1e-8  # ridge per sample, on standardised terms
RECORDED = 2000  # recorded velocities


def of_velocities(term: Term) -> bool:
    """Whether a term is a function of the velocities of the hull alone, or the constant."""
    names = (basis.VARIABLES[code % basis.N_VARIABLES] for code in term.codes)
    return all(name in ("1", *VELOCITIES) for name in names)


@dataclass(frozen=True, eq=False)
class Projection:
    """Least squares of a posterior mean on the terms in the velocities."""

    rows: list[int]  # of the table
    nu: Array  # (n, n_dof) velocities, the recorded ones first
    n_recorded: int
    inducing: Array  # (m, n_dof)
    phi: Array  # (n, n_terms) weighted and standardised
    scale: Array  # (n_terms,) of the columns
    weight: Array  # (n, 1) root of the weight of a velocity

    @classmethod
    def of(cls, table: Vessel, data: ProcessData) -> "Projection":
        """The projection on a table's terms."""
        rows = [i for i, term in enumerate(table.terms) if of_velocities(term)]
        recorded = data.nu[:: -(-len(data.nu) // RECORDED)]
        around = sampled_velocities(data.nu, None, SCALES[:-1])  # not far beyond them
        nu = np.vstack([recorded, around])
        shares = [1.0 / len(recorded), AROUND / len(around)]
        weight = np.sqrt(np.repeat(shares, [len(recorded), len(around)]))[:, None]
        motion = table.variables(np.zeros_like(nu), nu)
        phi = weight * basis.evaluate([table.terms[i] for i in rows], motion)
        scale = np.linalg.norm(phi, axis=0)
        scale[scale == 0.0] = 1.0
        return cls(rows, nu, len(recorded), data.inducing, phi / scale, scale, weight)

    def coefficients(self, prior: Prior, posterior: Posterior, base: Array) -> tuple[Array, float]:
        """Coefficients (n_terms, 1 + folds) of the mean, and R^2 = 1 - |rest|^2 / |f|^2.

        f is the mean and the force of the terms' coefficients in the base (n_terms,), as recorded.
        """
        mean = self.weight * (prior.covariance(self.nu, self.inducing) @ posterior.weights)
        gram = self.phi.T @ self.phi + SHRINKAGE * np.eye(len(self.scale))
        theta = scipy.linalg.solve(gram, self.phi.T @ mean, assume_a="pos")
        recorded = slice(self.n_recorded)
        rest = (mean - self.phi @ theta)[recorded, 0]
        power = float(np.sum((mean[:, 0] + self.phi @ (self.scale * base))[recorded] ** 2))
        r2 = 1.0 - float(np.sum(rest**2)) / power if power > 0.0 else 1.0
        return theta / self.scale[:, None], r2
