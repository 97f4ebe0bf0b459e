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

from collections.abc import Callable
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


@dataclass(frozen=True, eq=False)
class Belief:
    """What is known of a model: it and draws that deviate by `share` of their deviations.

    `known` are the coordinates of the draws and B, if they are known already.
    """

    model: Vessel
    draws: tuple[Vessel, ...]
    share: float
    known: tuple[Array, Array] | None = None

    def __post_init__(self) -> None:
        if len(self.draws) < 2 or not self.coordinates.shape[1]:
            raise ConfigurationError(
                f"{self.model.name}: nothing of the model is uncertain, expected a model with a "
                "distribution"
            )

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """Names of the parameters p, such as `surge.u` and `rudder.gamma_R`."""
        table = [f"{dof}.{term.name}" for term in self.draws[0].terms for dof in self.model.dofs]
        return (*table, *self.model.installed.labels)

    @cached_property
    def values(self) -> Array:
        """p_hat, shape (n,), SI units."""
        return self.parameters(self.model)

    @cached_property
    def _decomposed(self) -> tuple[Array, Array]:
        if self.known is not None:
            return self.known
        change = np.array([self.parameters(each) - self.values for each in self.draws])
        change /= self.share
        size = np.sqrt(np.mean(change**2, axis=0))
        scaled = np.divide(change, size, out=np.zeros_like(change), where=size > 0.0)
        left, deviation, right = np.linalg.svd(scaled, full_matrices=False)
        kept = deviation > LEAST_DEVIATION * deviation[0]
        root = np.sqrt(len(change))
        return left[:, kept] * root, size[:, None] * (right[kept].T * deviation[kept] / root)

    @property
    def coordinates(self) -> Array:
        """u of every draw at its whole deviation, shape (S, m)."""
        return self._decomposed[0]

    @property
    def basis(self) -> Array:
        """B, shape (n, m)."""
        return self._decomposed[1]

    def parameters(self, model: Vessel) -> Array:
        """p of a model, shape (n,)."""
        table = model.on(self.draws[0].terms).theta.ravel()
        return np.concatenate([table, model.installed.parameters])

    def at(self, u: Array) -> Vessel:
        """The model with coordinates u (m,)."""
        values, terms = self.values + self.basis @ u, self.draws[0].terms
        count = len(terms) * len(self.model.dofs)
        table = replace(
            self.model.on(terms), theta=values[:count].reshape(-1, len(self.model.dofs))
        )
        return replace(table, devices=with_parameters(self.model.devices, values[count:].tolist()))

    def about(self, u: Array) -> "Belief":
        """Draws with the same deviations about other coordinates u (m,)."""
        near = self.coordinates[: 2 * self.few]  # some may not reach what is asked for
        draws = tuple(self.at(u + self.share * each) for each in near)
        return Belief(self.at(u), draws, self.share, (near, self.basis))

    @property
    def few(self) -> int:
        """Draws that a linear function needs."""
        return min(len(self.draws), SPARE + int(self.coordinates.shape[1]))

    def gradient(self, values: Array, own: Array) -> Array:
        """G by regression of values over draws.

        Args:
            values: z of the first S draws, shape (S, k); draws with NaN are left out.
            own: z of the model itself, shape (k,).

        Returns:
            dz/du, shape (k, m).

        Raises:
            ConfigurationError: too few draws have values to find it.
        """
        u = self.share * self.coordinates[: len(values)]
        known = np.all(np.isfinite(values), axis=1)
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
        used = self.draws[: self.few]
        own = acceleration(self.model, part)
        change = np.array([(acceleration(each, part) - own).ravel() for each in used])
        found = np.linalg.pinv(self.share * self.coordinates[: len(used)]) @ change
        return found.reshape(-1, *own.shape), len(motion) / len(part)

    def information(self, motion: Recording, deviation: Array) -> Array:
        """I_q (m, m) of a motion, for errors of the accelerations with deviations (n_dof,)."""
        J, count = self.sensitivity(motion)
        weighted = (J / deviation).reshape(len(J), -1)
        return np.asarray(count * weighted @ weighted.T)


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


def covariance(informations: Array) -> Array:
    """P (m, m) after candidates with information (q, m, m)."""
    m = informations.shape[-1]
    return np.asarray(np.linalg.inv(np.eye(m) + np.sum(informations, axis=0)))


def half_widths(gradient: Array, posterior: Array) -> Array:
    """Half of the 90 % intervals of predictions with G (k, m) after P (m, m), shape (k,)."""
    variance = np.einsum("ki,ij,kj->k", gradient, posterior, gradient)
    return np.asarray(NORMAL_90 * np.sqrt(np.maximum(variance, 0.0)))


@dataclass(frozen=True, eq=False)
class Purpose:
    """What is to be predicted: G (k, m) in the unit of the target, and one number of k widths."""

    name: str
    unit: str
    gradient: Array
    whole: Callable[[Array], float]  # of the half widths (k,)
    text: str = ""  # the value that is predicted, if it is one

    def width(self, informations: Array) -> float:
        """Half of the 90 % interval expected after candidates with information (q, m, m)."""
        return self.whole(half_widths(self.gradient, covariance(informations)))


def root_mean_square(widths: Array) -> float:
    """Of a prediction along a motion."""
    return float(np.sqrt(np.mean(widths**2)))


def middle(widths: Array) -> float:
    """The median, of coefficients of which some cannot be told at all."""
    return float(np.median(widths))


def ranked(
    purpose: Purpose, known: Array, informations: Array, seconds: Array
) -> tuple["np.ndarray[tuple[int], np.dtype[np.int64]]", Array]:
    """Order of candidates by the logarithm of the width that they save in a second, and widths.

    Args:
        purpose: what is predicted.
        known: information (m, m) of what is chosen already.
        informations: those of the candidates, shape (q, m, m).
        seconds: their time, shape (q,).

    Returns:
        Numbers of the candidates, the best first, and the width after each of them, shape (q,).
    """
    widths = np.array([purpose.width(np.array([known, each])) for each in informations])
    now = purpose.width(known[None])
    gain = np.log(now / np.maximum(widths, 1e-12 * now)) / seconds
    return np.argsort(-gain, kind="stable"), widths


KNOWN_UNITS = ("m", "m^2", "kg/m^3")  # of parameters of devices that nobody doubts


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
