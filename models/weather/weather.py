"""The weather that a vessel meets in one trial, and what every part of a disturbance is asked."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import numpy as np

from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel


class Weather(NamedTuple):
    """Realised disturbances, one row a control instant; SI units. What is absent has no rows."""

    pose_noise: Array  # (N, n_dof), added to the measured pose
    velocity_noise: Array  # (N, n_dof)
    acceleration_noise: Array  # (N, n_dof), in the log only
    force_ned: Array  # (N, n_dof), NED [N, N, Nm]; along the axis where there is no heading
    current_ned: Array = np.zeros((0, 2))  # (N, 2) velocity of the water, north and east
    wind_ned: Array = np.zeros((0, 2))  # (N, 2) velocity of the air
    wind_noise: Array = np.zeros((0, 2))  # (N, 2), added to the measured wind, body axes
    process: Array = np.zeros((0, 0))  # (N, n_dof) accelerations [m/s^2, rad/s^2]
    wind_body: Array = np.zeros((0, 2))  # (N, 2) velocity of the air in body axes, as recorded
    wave_motion: Array = np.zeros((0, 0))  # (N, n_dof), the part of pose_noise that waves make


class Part(ABC):
    """A part of a disturbance: a force, a stream of air or water, or a noise.

    `varies`: its realisation draws from a generator.
    """

    varies: ClassVar[bool] = True

    def check(self, dofs: Sequence[str], duration_s: float = 0.0) -> None:  # noqa: B027
        """Raise ConfigurationError for a vessel that cannot meet it, or not for so long [s]."""

    @abstractmethod
    def added(
        self, weather: Weather, dofs: Sequence[str], period_s: float, rng: np.random.Generator
    ) -> Weather:
        """The weather with this part realised at all its control instants."""

    def aerodynamics(self, dofs: tuple[str, ...]) -> Vessel | None:
        """The terms that it adds to the vessel that meets it, where it does."""
        return None

    def table(self, dofs: tuple[str, ...]) -> Vessel | None:
        """What it adds to the force that a motion needs, as far as that is a table."""
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
        force = self.realise(len(weather.force_ned), dofs, period_s, rng)
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
        velocity = self.realise(n, period_s, rng)
        if self.air:
            return weather._replace(wind_ned=_sum(weather.wind_ned, velocity))
        return weather._replace(current_ned=_sum(weather.current_ned, velocity))


class Noise(Part):
    """What disturbs the measurements, or the motion without a cause that a model could have."""


def _sum(before: Array, more: Array) -> Array:
    return before + more if len(before) else more
