"""What to sail next: the interval of a prediction that is expected after a candidate.

What is known of a model is a normal distribution of its parameters p. Their whitened coordinates u
follow from draws by a singular value decomposition, p_s - p_hat = B u_s, (1/S) sum_s u_s u_s' = I.
Along the motion of a candidate q the accelerations depend on u by J_k, and a prediction z (a
measure, the coefficients) by G: regressions over the draws, for coefficients of a table and for
parameters of devices alike. By Bayes' rule for linear models with normal errors of covariance Sigma
(Chaloner and Verdinelli (1995), section 2; for terms of a table J_k are those of `information.py`)

    I_q = sum_k J_k' Sigma^-1 J_k,  P = (I + sum_q I_q)^-1,  cov z = G P G'

Errors of accelerations depend on each other, so samples count by a scale, which is that of the
recordings from which the distribution was identified (`scale_of`).
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
        """J (m, N, n_dof) at up to `most` samples of a motion, and how many each stands for."""
        stride = max(1, -(-len(motion) // most))
        part = motion.part(np.arange(len(motion)) % stride == 0)
        own, few = acceleration(self.model, part), SPARE + self.u.shape[1]  # draws that it takes
        change = np.array([(acceleration(m, part) - own).ravel() for m in self.draws[:few]])
        J = (np.linalg.pinv(self.u[:few]) @ change).reshape(-1, *own.shape)
        return J, len(motion) / len(part)

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
    own = parameters(model, draws[0])
    change = (np.array([parameters(each, draws[0]) for each in draws]) - own) / share
    size, root = np.sqrt(np.mean(change**2, axis=0)), np.sqrt(len(change))
    if not np.any(size):
        raise ConfigurationError(
            f"{model.name}: nothing of the model is uncertain, expected a model with a distribution"
        )
    scaled = np.divide(change, size, out=np.zeros_like(change), where=size > 0.0)
    left, deviation, right = np.linalg.svd(scaled, full_matrices=False)
    kept = deviation > LEAST_DEVIATION * deviation[0]
    basis = size[:, None] * (right[kept].T * deviation[kept] / root)
    return Belief(model, draws, share * root * left[:, kept], basis)


def acceleration(model: Vessel, motion: Recording) -> Array:
    """nu_dot (N, n_dof) of a model under what acts in a motion [m/s^2, rad/s^2]."""
    force = motion.tau if model.inputs else motion.force(None)
    return model.forward(force, motion.nu, motion.attitude, motion.wind, motion.inputs)


def scale_of(information: Array) -> float:
    """Independent samples in one sample, by the information (m, m) of the identified recordings.

    In coordinates that their distribution whitens it is s I, less where a prior told more than the
    recordings. So the largest eigenvalues are 1 / s.
    """
    return 1.0 / float(np.quantile(np.linalg.eigvalsh(information), 0.75))


@dataclass(frozen=True, eq=False)
class Purpose:
    """What is to be predicted: k numbers with G (k, m) in percent, and what they are in words.

    The width of their intervals is the root mean square, or of `coefficients` the median, since
    some cannot be told at all.
    """

    name: str
    gradient: Array
    text: str = ""

    def width(self, *informations: Array) -> float:
        """Half of the 90 % interval expected after candidates with information (m, m) each [%]."""
        posterior = np.linalg.inv(np.eye(self.gradient.shape[1]) + sum(informations))
        variance = np.einsum("ki,ij,kj->k", self.gradient, posterior, self.gradient)
        widths = NORMAL_90 * np.sqrt(np.maximum(variance, 0.0))
        median = self.name == "coefficients"
        return float(np.median(widths) if median else np.sqrt(np.mean(widths**2)))


def ranked(purpose: Purpose, known: Array, informations: Array, seconds: Array) -> list[int]:
    """Order of candidates by the logarithm of the width that they save in a second, the best first.

    `known` is the information (m, m) of what is chosen already, `informations` (q, m, m) those of
    the candidates, `seconds` their time (q,).
    """
    now, widths = purpose.width(known), [purpose.width(known, told) for told in informations]
    gain = np.log(now / np.maximum(widths, 1e-12 * now)) / seconds
    return [int(number) for number in np.argsort(-gain, kind="stable")]


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
