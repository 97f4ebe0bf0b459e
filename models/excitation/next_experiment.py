"""What to sail next: the interval of a prediction that is expected after a candidate.

What is known of a model is a normal distribution of its parameters p, of which models are drawn.
Their whitened coordinates u follow from the draws by a singular value decomposition:

    p_s - p_hat = B u_s,  (1/S) sum_s u_s u_s' = I

so that u has the covariance I. Along the motion of a candidate q the accelerations depend on u by
J_k, and a prediction z (a measure of a manoeuvre, the coefficients) by G. Both are regressions over
the draws, for coefficients of a table and for parameters of devices alike. By Bayes' rule for
linear models with normal errors of covariance Sigma,

    I_q = sum_k J_k' Sigma^-1 J_k,  P = (I + sum_q I_q)^-1,  cov z = G P G'

For terms of a table J_k are the regressors of `information.py`, with the covariance of what is
known as a prior (Chaloner and Verdinelli (1995), section 2). Errors of accelerations depend on each
other, so samples count by a scale, which is that of the recordings from which the distribution was
identified (`scale_of`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import ACCELERATIONS
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.devices.device import with_parameters
from seatrial.models.vessel.table import Vessel

NORMAL_90 = 1.6449  # half the width of a 90 % interval over the standard deviation
LEAST_DEVIATION = 1e-6  # of a whitened direction, relative to the largest
MOST_SAMPLES = 100  # of a motion, of which J is computed
DRAWS = 400  # of which the whitened coordinates are found
SIMULATED = 120  # of them that carry a manoeuvre out
SPARE = 10  # draws beside those that the unknowns of a linear function take
KNOWN_UNITS = ("m", "m^2", "kg/m^3")  # of parameters of devices that nobody doubts


@dataclass(frozen=True, eq=False)
class Belief:
    """What is known of a model: it, and draws at coordinates u (S, m) with B (n, m)."""

    model: Vessel
    draws: Sequence[Vessel]
    u: Array
    basis: Array

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """Names of the parameters p, such as `surge.u` and `rudder.gamma_R`."""
        table = [f"{dof}.{term.name}" for term in self.draws[0].terms for dof in self.model.dofs]
        return (*table, *self.model.installed.labels)

    @cached_property
    def values(self) -> Array:
        """p_hat, shape (n,), SI units."""
        return parameters(self.model, self.draws[0])

    def gradient(self, values: Array, own: Array) -> Array:
        """G = dz/du (k, m) by regression of z of the first S draws (S, k) and of the model (k,).

        Draws with NaN are left out; raises ConfigurationError if too few are left.
        """
        u, known = self.u[: len(values)], np.all(np.isfinite(values), axis=1)
        if np.sum(known) < u.shape[1] + 1 or not np.all(np.isfinite(own)):
            raise ConfigurationError(
                f"{np.sum(known)} of {len(values)} models near {self.model.name} reach what is "
                f"asked for, expected more than {u.shape[1]}"
            )
        return np.asarray(np.linalg.lstsq(u[known], values[known] - own, rcond=None)[0].T)

    def sensitivity(self, motion: Recording, most: int = MOST_SAMPLES) -> tuple[Array, float]:
        """J (m, N, n_dof) at up to `most` samples of a motion, and how many each stands for.

        Raises the errors of `Vessel.forward`.
        """
        stride = max(1, -(-len(motion) // most))
        part = motion.part(np.arange(len(motion)) % stride == 0)
        own, few = acceleration(self.model, part), SPARE + self.u.shape[1]  # draws that it takes
        change = np.array([(acceleration(m, part) - own).ravel() for m in self.draws[:few]])
        found = np.linalg.pinv(self.u[:few]) @ change
        return found.reshape(-1, *own.shape), len(motion) / len(part)

    def information(self, motion: Recording, deviation: Array) -> Array:
        """I_q (m, m) of a motion, for errors of the accelerations with deviations (n_dof,)."""
        J, count = self.sensitivity(motion)
        weighted = (J / deviation).reshape(len(J), -1)
        return np.asarray(count * weighted @ weighted.T)


def parameters(model: Vessel, like: Vessel) -> Array:
    """p of a model, shape (n,), with the terms of another one."""
    return np.concatenate([model.on(like.terms).theta.ravel(), model.installed.parameters])


def believed(model: Vessel, draws: Sequence[Vessel], share: float) -> Belief:
    """What draws tell that deviate by `share` of their deviations.

    Raises ConfigurationError if nothing is uncertain.
    """
    values = [parameters(each, draws[0]) for each in (model, *draws)]
    change = (np.array(values[1:]) - values[0]) / share
    size = np.sqrt(np.mean(change**2, axis=0))
    if not np.any(size):
        raise ConfigurationError(
            f"{model.name}: nothing of the model is uncertain, expected a model with a distribution"
        )
    scaled = np.divide(change, size, out=np.zeros_like(change), where=size > 0.0)
    left, deviation, right = np.linalg.svd(scaled, full_matrices=False)
    kept, root = deviation > LEAST_DEVIATION * deviation[0], np.sqrt(len(change))
    basis = size[:, None] * (right[kept].T * deviation[kept] / root)
    return Belief(model, draws, share * root * left[:, kept], basis)


def acceleration(model: Vessel, motion: Recording) -> Array:
    """nu_dot (N, n_dof) of a model under what acts in a motion [m/s^2, rad/s^2]."""
    force = motion.tau if model.inputs else motion.force(None)
    return model.forward(force, motion.nu, motion.attitude, motion.wind, motion.inputs)


def residual_deviation(model: Vessel, motion: Recording) -> Array:
    """Root mean square (n_dof,) of measured minus modelled accelerations."""
    error = motion.nu_dot - acceleration(model, motion)
    return np.asarray(np.sqrt(np.mean(error**2, axis=0)))


def scale_of(information: Array) -> float:
    """Independent samples in one sample, by the information (m, m) of the identified recordings.

    In coordinates that their distribution whitens it is s I, less where a prior told more than the
    recordings. So the largest eigenvalues are 1 / s.
    """
    return 1.0 / float(np.quantile(np.linalg.eigvalsh(information), 0.75))


def half_widths(gradient: Array, posterior: Array) -> Array:
    """Half of the 90 % intervals of predictions with G (k, m) after P (m, m), shape (k,)."""
    variance = np.einsum("ki,ij,kj->k", gradient, posterior, gradient)
    return np.asarray(NORMAL_90 * np.sqrt(np.maximum(variance, 0.0)))


@dataclass(frozen=True, eq=False)
class Purpose:
    """What is to be predicted: G (k, m) in the unit of the target.

    The width of k predictions is their root mean square, or the `median` of parameters of which
    some cannot be told at all.
    """

    name: str
    unit: str
    gradient: Array
    text: str = ""  # the value that is predicted, if it is one
    median: bool = False

    def width(self, *informations: Array) -> float:
        """Half of the 90 % interval expected after candidates with information (m, m) each."""
        told = np.eye(self.gradient.shape[1]) + sum(informations)
        widths = half_widths(self.gradient, np.asarray(np.linalg.inv(told)))
        return float(np.median(widths) if self.median else np.sqrt(np.mean(widths**2)))


def ranked(
    purpose: Purpose, known: Array, informations: Array, seconds: Array
) -> tuple["np.ndarray[tuple[int], np.dtype[np.int64]]", Array]:
    """Order of candidates by the logarithm of the width that they save in a second, the best first.

    `known` is the information (m, m) of what is chosen already, `informations` (q, m, m) those of
    the candidates, `seconds` their time (q,). Also returns the width after each of them, (q,).
    """
    widths = np.array([purpose.width(known, each) for each in informations])
    now = purpose.width(known)
    gain = np.log(now / np.maximum(widths, 1e-12 * now)) / seconds
    return np.argsort(-gain, kind="stable"), widths


def doubted(model: Vessel, doubt: float, rng: np.random.Generator, share: float) -> Vessel:
    """A model whose parameters deviate from those of `model` by `share` of a normal doubt.

    `doubt` is half the 90 % interval of every parameter over its size. Accelerations, dimensions
    and densities are taken as known; parameters of devices stay in their ranges.
    """
    installed, size = model.installed, share * doubt / NORMAL_90
    free = np.array([[term.name not in ACCELERATIONS] for term in model.terms])
    theta = model.theta * (1.0 + size * free * rng.standard_normal(model.theta.shape))
    unsure = np.array([bounds.unit not in KNOWN_UNITS for bounds in installed.bounds], dtype=bool)
    drawn = 1.0 + size * unsure * rng.standard_normal(len(unsure))
    values = (installed.parameters * drawn).tolist()
    return replace(model, theta=theta, devices=with_parameters(model.devices, values))
