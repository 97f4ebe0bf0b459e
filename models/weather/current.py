"""Current: the velocity of the water over ground."""

from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.ranges import NotNegative, Positive, check_ranges
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.tuning import FromVessel
from seatrial.models.weather.noise import first_order
from seatrial.models.weather.weather import Stream


@dataclass(frozen=True)
class Current(Stream):
    """A horizontal current with a mean speed and the direction in which the water moves.

    `variation`: `constant`; `slow`, Gauss-Markov processes in north and east about the mean
    (Bargouth (2022), (2.7)-(2.8), with a time constant, since a random walk is unbounded);
    `white`, each component drawn uniformly from [0, max_m_s] at every sample, as in Bargouth's
    appendices (which use the unrealistic value 10 m/s). The speed is limited to `max_m_s`.
    """

    speed_m_s: Annotated[NotNegative, FromVessel("tuning.current.speed_m_s")]
    direction_deg: float
    variation: Literal["constant", "slow", "white"]
    deviation_m_s: Annotated[  # of each component, of `slow`
        NotNegative, FromVessel("tuning.current.deviation_m_s")
    ]
    time_constant_s: Positive  # of `slow`
    max_m_s: Positive

    air: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.speed_m_s > self.max_m_s:
            raise ConfigurationError(
                f"speed_m_s must not be above max_m_s = {self.max_m_s:g}, got {self.speed_m_s:g}"
            )

    def realise(self, n: int, period_s: float, rng: np.random.Generator) -> Array:
        """Velocity of the water (north, east) [m/s], shape (n, 2)."""
        if self.variation == "white":
            return np.asarray(rng.uniform(0.0, self.max_m_s, (n, 2)))
        angle = np.radians(self.direction_deg)
        mean = self.speed_m_s * np.array([np.cos(angle), np.sin(angle)])
        velocity = np.tile(mean, (n, 1))
        if self.variation == "slow":
            for column in range(2):
                velocity[:, column] += first_order(
                    n, period_s, self.deviation_m_s, self.time_constant_s, rng
                )
        speed = np.hypot(*velocity.T)[:, None]
        return np.asarray(velocity * np.minimum(1.0, self.max_m_s / np.maximum(speed, 1e-12)))
