"""First-order wave-induced motion, added to the measured pose. Fossen (2011), section 8.2.6.

The source documents neglect waves. Here the motion of each measured coordinate is white noise
through h(s) = K s / (s^2 + 2 lambda omega_0 s + omega_0^2), with the spectrum's peak at omega_0;
K follows from the specified standard deviation, sigma^2 = K^2 / (4 lambda omega_0).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import PLANAR
from seatrial.models.ranges import NotNegative, Positive, check_ranges
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.tuning import FromVessel
from seatrial.models.weather.noise import gauss_markov
from seatrial.models.weather.weather import Noise, Weather


@dataclass(frozen=True)
class Waves(Noise):
    """First-order wave motion of position and heading, added to the measured pose.

    Parameters are the standard deviations, the peak period and the relative damping lambda.
    """

    position_m: Annotated[NotNegative, FromVessel("tuning.waves.position_m")]
    heading_deg: Annotated[NotNegative, FromVessel("tuning.waves.heading_deg")]
    peak_period_s: Annotated[Positive, FromVessel("tuning.waves.peak_period_s")]
    damping: Positive

    def __post_init__(self) -> None:
        check_ranges(self)

    def check(self, dofs: Sequence[str], duration_s: float = 0.0) -> None:
        """Raise ConfigurationError unless the vessel is a surface vessel in the plane."""
        if tuple(dofs) != PLANAR:
            raise ConfigurationError(
                f"disturbance.waves needs a vessel in {', '.join(PLANAR)}, "
                f"got one in {', '.join(dofs)}"
            )

    def added(
        self, weather: Weather, dofs: Sequence[str], period_s: float, rng: np.random.Generator
    ) -> Weather:
        """The weather with this motion added to the noise of the measured pose."""
        motion = self.realise(len(weather.force_ned), period_s, rng)
        return weather._replace(wave_motion=motion, pose_noise=weather.pose_noise + motion)

    def realise(self, n: int, period_s: float, rng: np.random.Generator) -> Array:
        """Independent motions of x, y [m] and psi [rad], shape (n, 3)."""
        w = 2.0 * np.pi / self.peak_period_s
        system = np.array([[0.0, 1.0], [-w * w, -2.0 * self.damping * w]])
        unit = np.diag(
            [1.0 / w, 1.0]
        )  # stationary: the output state has w times the standard deviation
        sizes = (self.position_m, self.position_m, np.radians(self.heading_deg))
        motions = [size * gauss_markov(n, period_s, system, unit, rng)[:, 1] for size in sizes]
        return np.stack(motions, axis=1)
