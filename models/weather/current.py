"""Current: the velocity of the water over ground, and its moment."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.ranges import NotNegative, Positive, check_ranges
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.tuning import FromVessel
from seatrial.models.weather.noise import first_order
from seatrial.models.weather.weather import Stream, Weather


@dataclass(frozen=True)
class Current(Stream):
    """A horizontal current with a mean speed and the direction in which the water moves.

    `variation`: `constant`; `slow`, Gauss-Markov processes in north and east about the mean
    (Bargouth (2022), (2.7)-(2.8), with a time constant, since a random walk is unbounded);
    `white`, each component drawn uniformly from [0, max_m_s] at every sample, as in Bargouth's
    appendices (which use the unrealistic value 10 m/s). The speed is limited to `max_m_s`.

    A `slow` current also has a yaw moment that does not follow from its velocity: a process of
    the same form with zero mean, (2.9), of standard deviation `moment_deviation_nm`.
    """

    speed_m_s: Annotated[NotNegative, FromVessel("tuning.current.speed_m_s")]
    direction_deg: float
    variation: Literal["constant", "slow", "white"]
    deviation_m_s: Annotated[  # of each component, of `slow`
        NotNegative, FromVessel("tuning.current.deviation_m_s")
    ]
    time_constant_s: Positive  # of `slow`
    max_m_s: Annotated[Positive, FromVessel("tuning.current.max_m_s")]
    moment_deviation_nm: NotNegative = 0.0  # of `slow`

    air: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.speed_m_s > self.max_m_s:
            raise ConfigurationError(
                f"speed_m_s must not be above max_m_s = {self.max_m_s:g}, got {self.speed_m_s:g}"
            )
        if self.moment_deviation_nm and self.variation != "slow":
            got = f"got {self.moment_deviation_nm:g} with variation={self.variation}"
            raise ConfigurationError(f"moment_deviation_nm: {got}, expected variation=slow")

    def check(self, dofs: Sequence[str], duration_s: float = 0.0) -> None:
        """Raise ConfigurationError for a yaw moment on a vessel that does not turn."""
        if self.moment_deviation_nm and "yaw" not in dofs:
            raise ConfigurationError(
                f"disturbance.current.moment_deviation_nm: got {self.moment_deviation_nm:g}, "
                f"expected 0 for a vessel that moves in {', '.join(dofs)}"
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

    def added(
        self, weather: Weather, dofs: Sequence[str], period_s: float, rng: np.random.Generator
    ) -> Weather:
        """The weather with this stream and its yaw moment, which is drawn after the velocity."""
        weather = super().added(weather, dofs, period_s, rng)
        if self.moment_deviation_nm:
            force = weather.force_ned.copy()
            force[:, list(dofs).index("yaw")] += first_order(
                len(force), period_s, self.moment_deviation_nm, self.time_constant_s, rng
            )
            weather = weather._replace(force_ned=force)
        return weather
