"""The weather of a trial, and the interfaces of the parts of a disturbance."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import numpy as np

from seatrial.models.returned import checked_array
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel


class Weather(NamedTuple):
    """Realised disturbances, one row per control instant; SI units. Absent parts have no rows."""

    pose_noise: Array  # (N, n_dof), added to the measured pose
    velocity_noise: Array  # (N, n_dof)
    acceleration_noise: Array  # (N, n_dof), in the log only
    force_ned: Array  # (N, n_dof), NED [N, N, Nm]; along the axes if there is no heading
    current_ned: Array = np.zeros((0, 2))  # (N, 2) velocity of the water, north and east
    wind_ned: Array = np.zeros((0, 2))  # (N, 2) velocity of the air
    wind_noise: Array = np.zeros((0, 2))  # (N, 2), added to the measured wind, body axes
    process: Array = np.zeros((0, 0))  # (N, n_dof) accelerations [m/s^2, rad/s^2]
    wind_body: Array = np.zeros((0, 2))  # (N, 2) velocity of the air in body axes, as recorded
    wave_motion: Array = np.zeros((0, 0))  # (N, n_dof), the part of pose_noise that is due to waves


class Part(ABC):
    """A part of a disturbance: a force, a stream of air or water, or noise.

    `varies` states whether its realisation draws from a generator.
    """

    varies: ClassVar[bool] = True

    def check(self, dofs: Sequence[str], duration_s: float = 0.0) -> None:  # noqa: B027
        """Raise ConfigurationError if the part does not suit the vessel or the duration [s]."""

    @abstractmethod
    def added(
        self, weather: Weather, dofs: Sequence[str], period_s: float, rng: np.random.Generator
    ) -> Weather:
        """The weather with this part realised at all its control instants."""

    def aerodynamics(self, dofs: tuple[str, ...]) -> Vessel | None:
        """The terms that it adds to the table of the vessel, if any."""
        return None

    def table(self, dofs: tuple[str, ...]) -> Vessel | None:
        """The part of its force that is a table of the force that a motion requires."""
        return self.aerodynamics(dofs)


class Force(Part):
    """A force on the vessel."""

    @abstractmethod
    def realise(
        self, n: int, dofs: Sequence[str], period_s: float, rng: np.random.Generator
    ) -> Array:
        """Force in NED [N, Nm], shape (n, n_dof)."""

    def added(
        self, weather: Weather, dofs: Sequence[str], period_s: float, rng: np.random.Generator
    ) -> Weather:
        """The weather with this force."""
        n = len(weather.force_ned)
        force = checked_array(self, "realise", self.realise(n, dofs, period_s, rng), (n, len(dofs)))
        return weather._replace(force_ned=weather.force_ned + force)


class Stream(Part):
    """A stream of air or of water that the vessel moves through."""

    air: ClassVar[bool]

    @abstractmethod
    def realise(self, n: int, period_s: float, rng: np.random.Generator) -> Array:
        """Velocity of the stream (north, east) [m/s], shape (n, 2)."""

    def added(
        self, weather: Weather, dofs: Sequence[str], period_s: float, rng: np.random.Generator
    ) -> Weather:
        """The weather with this stream."""
        n = len(weather.force_ned)
        velocity = checked_array(self, "realise", self.realise(n, period_s, rng), (n, 2))
        if self.air:
            return weather._replace(wind_ned=_sum(weather.wind_ned, velocity))
        return weather._replace(current_ned=_sum(weather.current_ned, velocity))


class Noise(Part):
    """Noise in the measurements, or process noise in the motion."""


def _sum(before: Array, more: Array) -> Array:
    return before + more if len(before) else more
