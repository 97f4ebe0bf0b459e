"""Measurement and process noise, and the coloured noise used by wind and current."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
import scipy

from seatrial.models.compiled import kernel
from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import DOFS
from seatrial.models.ranges import NotNegative, check_ranges
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.tuning import FromVessel
from seatrial.models.weather.weather import Noise, Weather

LEVELS = 4  # of a smoothed sequence


@dataclass(frozen=True)
class MeasurementNoise:
    """Standard deviations of white Gaussian noise, drawn once per sample. Jervan, Table 4.14."""

    position_m: Annotated[NotNegative, FromVessel("tuning.noise.position_m")]
    angle_deg: Annotated[NotNegative, FromVessel("tuning.noise.angle_deg")]
    velocity_m_s: Annotated[NotNegative, FromVessel("tuning.noise.velocity_m_s")]
    angular_rate_deg_s: Annotated[NotNegative, FromVessel("tuning.noise.angular_rate_deg_s")]
    acceleration_m_s2: Annotated[NotNegative, FromVessel("tuning.noise.acceleration_m_s2")]
    angular_acceleration_deg_s2: Annotated[
        NotNegative, FromVessel("tuning.noise.angular_acceleration_deg_s2")
    ]
    wind_m_s: Annotated[  # of each body component of the measured wind
        NotNegative, FromVessel("tuning.noise.wind_m_s")
    ] = 0.0

    def __post_init__(self) -> None:
        check_ranges(self)

    def deviations(self, dofs: Sequence[str]) -> Array:
        """Standard deviations of pose, velocity and acceleration, shape (3, n_dof), SI units."""
        linear = [self.position_m, self.velocity_m_s, self.acceleration_m_s2]
        angular = [self.angle_deg, self.angular_rate_deg_s, self.angular_acceleration_deg_s2]
        columns = [linear if dof in DOFS[:3] else np.radians(angular) for dof in dofs]
        return np.array(columns).T


@dataclass(frozen=True)
class ProcessNoise(Noise):
    """White accelerations, constant over a sample: eta of Bargouth (2022), (2.24)-(2.26).

    `size` [m/s^2, rad/s^2], one number per degree of freedom, is the standard deviation, or half
    the width of a uniform distribution about zero.
    """

    size: Annotated[tuple[NotNegative, ...], FromVessel("tuning.process")]
    distribution: Literal["normal", "uniform"]

    def __post_init__(self) -> None:
        check_ranges(self)

    def check(self, dofs: Sequence[str], duration_s: float = 0.0) -> None:
        """Raise ConfigurationError unless there is one size per degree of freedom."""
        if len(self.size) != len(dofs):
            raise ConfigurationError(
                f"disturbance.process.size: got {len(self.size)} numbers, expected {len(dofs)} "
                f"for {', '.join(dofs)}"
            )

    def realise(self, n: int, rng: np.random.Generator) -> Array:
        """Accelerations [m/s^2, rad/s^2], shape (n, n_dof)."""
        shape = (n, len(self.size))
        normal = self.distribution == "normal"
        draws = rng.standard_normal(shape) if normal else rng.uniform(-1.0, 1.0, shape)
        return np.asarray(draws * np.array(self.size), dtype=np.float64)

    def added(
        self, weather: Weather, dofs: Sequence[str], period_s: float, rng: np.random.Generator
    ) -> Weather:
        """The weather with these accelerations."""
        return weather._replace(process=self.realise(len(weather.force_ned), rng))


@kernel
def _filter(transition: Array, draws: Array, states: Array) -> None:
    """x_{k+1} = transition x_k + draws_k, in place from states[0]; all (N, m) but (m, m)."""
    for k in range(states.shape[0] - 1):
        for i in range(states.shape[1]):
            total = draws[k, i]
            for j in range(states.shape[1]):
                total += transition[i, j] * states[k, j]
            states[k + 1, i] = total


def gauss_markov(
    n: int, period_s: float, system: Array, deviation: Array, rng: np.random.Generator
) -> Array:
    """A stationary Gaussian process dx = system x dt + noise, shape (n, m), sampled exactly.

    `deviation` (m, m) is a Cholesky factor of the covariance P. With Phi = exp(system h) a step is
    x_{k+1} = Phi x_k + w_k, cov w = P - Phi P Phi'. The first sample is drawn from P.
    """
    transition = scipy.linalg.expm(system * period_s)
    covariance = deviation @ deviation.T
    innovation = covariance - transition @ covariance @ transition.T
    draws = rng.standard_normal((n, len(system)))
    states = np.empty((n, len(system)))
    states[0] = deviation @ draws[0]
    _filter(np.ascontiguousarray(transition), draws[1:] @ _square_root(innovation).T, states)
    return states


def _square_root(covariance: Array) -> Array:
    """L with L L' = covariance, nearly singular for a step much shorter than a period."""
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)), dtype=np.float64)


def first_order(
    n: int, period_s: float, deviation: float, time_constant_s: float, rng: np.random.Generator
) -> Array:
    """First-order Gauss-Markov process, x_dot = -x / T + noise, shape (n,)."""
    system, spread = np.array([[-1.0 / time_constant_s]]), np.array([[deviation]])
    return gauss_markov(n, period_s, system, spread, rng)[:, 0]


def smoothed_levels(n: int, rng: np.random.Generator) -> Array:
    """Random levels in (0, 1), each for an equal part of n samples, smoothed. Bargouth, appendix F.

    The smoothing is a centred moving average over half of the samples, and over fewer samples near
    the ends (MATLAB's `smooth(A, 0.5)`). Shape (n,).
    """
    steps = rng.random(LEVELS)[np.minimum(np.arange(n) * LEVELS // max(n, 1), LEVELS - 1)]
    reach = max((n // 2 - 1 + n // 2 % 2) // 2, 0)  # an odd span of about n / 2
    index = np.arange(n)
    half = np.minimum(np.minimum(index, n - 1 - index), reach)
    total = np.concatenate([[0.0], np.cumsum(steps)])
    return np.asarray((total[index + half + 1] - total[index - half]) / (2 * half + 1))
