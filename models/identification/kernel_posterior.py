"""The posterior mean of a Gaussian process from all samples, by the subset of regressors.

    epsilon_k = phi' b_k + g_k(nu) + noise        b_k ~ N(0, S^2),  g_k ~ GP(0, kernel(nu, nu'))

With inducing points z the process is g(nu) = kernel(nu, z) w, w ~ N(0, kernel(z, z)^-1), and the
posterior mean of b and w is a ridge regression on all samples: Quinonero-Candela and Rasmussen
(2005), J. Mach. Learn. Res. 6, eq. (16). Away from the inducing points it returns to zero. The
noise counts for tau samples as for one, see `structured`. The mean is projected on the terms in the
velocities.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from seatrial.models.identification.physical_constraints import SCALES, sampled_velocities
from seatrial.models.identification.residual import Samples
from seatrial.models.identification.structured import inflation
from seatrial.models.notation import VELOCITIES
from seatrial.models.recording.recording import blocks
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array, Term
from seatrial.models.vessel.table import Vessel

ALL = (slice(None),)
LONGEST = 20_000  # samples in the posterior mean; of a longer recording every so many-th
ROUNDING = 1e-13  # least noise, relative to the mean square of the features
ROUNDS = 10  # of the noise that the base leaves
CHUNK = 50  # columns filtered together
JITTER = 1e-11  # of the kernel's diagonal, relative


class Prior(NamedTuple):
    """The prior of one degree of freedom: a kernel of scaled velocities, and the noise."""

    kernel: Any  # scikit-learn's, of velocities over their reach
    reach: Array  # (n_dof,) largest recorded velocities
    size: float  # [N, Nm] by which the lack of fit is divided
    noise: float  # variance over size^2

    def covariance(self, nu: Array, other: Array) -> Array:
        """Covariance [N^2] of the process between velocities (n, n_dof) and others (m, n_dof)."""
        return np.asarray(self.size**2 * self.kernel(nu / self.reach, other / self.reach))


class Base(NamedTuple):
    """The terms of one degree of freedom that are estimated beside the process."""

    rows: list[int]  # of the table
    size: Array  # prior standard deviation of their coefficients


class Posterior(NamedTuple):
    """The posterior mean of one degree of freedom: of all samples, and without each block."""

    alone: Array  # (n_base, 1 + folds) coefficients of the terms of the base without the process
    base: Array  # (n_base, 1 + folds) those beside the process
    weights: Array  # (m, 1 + folds) of the covariance with the inducing points
    noise: float  # [N^2] variance that counts for one sample
    left_out_r2: float  # 1 - square of the lack of fit over that of the nominal model


@dataclass(frozen=True, eq=False)
class ProcessData:
    """The samples of a recording, with the velocities as the kernels and the table see them."""

    samples: Samples
    nu: Array  # (N', n_dof) recorded velocities after the filter of the signals
    smooth: Callable[[Array], Array]  # the filter of the regressors, (N', c) to (N, c)
    subsample: NDArray[np.int64]  # (m,) of the samples
    inducing: Array  # (m, n_dof) velocities of the subsample
    reach: Array  # (n_dof,) largest recorded velocities, 1 where there is no motion

    def unexplained(self, base: Base, k: int) -> Array:
        """What the base alone leaves of the lack of fit of a degree of freedom, (N,)."""
        y, features = self.samples.epsilon[:, k], self.samples.phi[:, base.rows] * base.size
        return np.asarray(y - features @ without_process(features, y, ALL)[:, 0])

    def posterior(self, prior: Prior, base: Base, k: int, folds: int) -> Posterior:
        """The posterior mean of a degree of freedom from all samples, at most `LONGEST`.

        The features have a prior variance of one each: the base's terms times their size, and the
        covariance with the inducing points after a Cholesky factor of their own.
        """
        step = -(-len(self.samples) // LONGEST)
        file = self.samples.file
        parts = blocks(len(self.samples.phi[::step]), folds, None if file is None else file[::step])
        y = self.samples.epsilon[::step, k]
        K = prior.covariance(self.inducing, self.inducing)
        L = np.linalg.cholesky(K + JITTER * np.mean(np.diag(K)) * np.eye(len(K)))
        process = scipy.linalg.solve_triangular(L, self._columns(prior, step).T, lower=True).T
        features = np.hstack([self.samples.phi[::step, base.rows] * base.size, process])
        noise, n = prior.noise * prior.size**2, len(base.rows)
        noise *= inflation((y - features @ regress(features, y, noise, ALL)[:, 0])[:, None])
        weights = regress(features, y, noise, parts)
        rests = [y[part] - features[part] @ w for part, w in zip(parts, weights.T[1:], strict=True)]
        left_out, power = float(np.sum(np.concatenate(rests) ** 2)), float(np.sum(y**2))
        alone = without_process(features[:, :n], y, parts)
        return Posterior(
            base.size[:, None] * alone,
            base.size[:, None] * weights[:n],
            scipy.linalg.solve_triangular(L, weights[n:], lower=True, trans="T"),
            noise,
            1.0 - left_out / power if power > 0.0 else 0.0,
        )

    def _columns(self, prior: Prior, step: int) -> Array:
        """Covariance of every step-th sample with the inducing points, (n, m)."""
        parts = np.array_split(self.inducing, max(len(self.inducing) // CHUNK, 1))
        return np.hstack([self.smooth(prior.covariance(self.nu, p))[::step] for p in parts])


def regress(features: Array, y: Array, noise: float, parts: Sequence[slice]) -> Array:
    """Weights of features (N, p) with a prior variance of one: of all samples and without a block.

    `noise` is the variance of y (N,). The result has shape (p, 1 + n_parts); one part: (p, 1).
    """
    grams = np.array([features[part].T @ features[part] for part in parts])
    sides = np.array([features[part].T @ y[part] for part in parts])
    G, g = np.sum(grams, axis=0), np.sum(sides, axis=0)
    prior = max(noise, ROUNDING * float(np.trace(G))) * np.eye(len(g))
    kept = [(G - A, g - b) for A, b in zip(grams, sides, strict=True)] if len(parts) > 1 else []
    solved = [scipy.linalg.solve(A + prior, b, assume_a="pos") for A, b in [(G, g), *kept]]
    return np.stack(solved, axis=1)


def without_process(features: Array, y: Array, parts: Sequence[slice]) -> Array:
    """Weights as of `regress`, with the noise that they leave unexplained."""
    rest = y
    for _ in range(ROUNDS):
        noise = float(np.mean(rest**2)) * inflation(rest[:, None])
        rest = y - features @ regress(features, y, noise, ALL)[:, 0]
    return regress(features, y, noise, parts)


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
