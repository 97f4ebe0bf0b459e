"""Disturbance cases, composed of parts and realised from seeded generators.

Noise has a generator of its own, the other parts share one and draw from it in a fixed way: a part
that is added or left out does not change what the others realise.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from seatrial.models.notation import DOFS, PLANAR
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.derivatives import derivative_table
from seatrial.models.vessel.table import Vessel
from seatrial.models.weather.current import Current
from seatrial.models.weather.noise import MeasurementNoise, ProcessNoise
from seatrial.models.weather.waves import Waves
from seatrial.models.weather.weather import Weather
from seatrial.models.weather.wind import Wind


@dataclass(frozen=True)
class ConstantForce:
    """A force that is constant in NED. Jervan (2020), Table 4.16.

    A vessel that moves along one axis only meets its northward part.
    """

    north_n: float
    east_n: float
    moment_nm: float

    def ned(self, dofs: Sequence[str]) -> Array:
        """The force over `dofs` [N, Nm], shape (n_dof,)."""
        parts = {"surge": self.north_n, "sway": self.east_n, "yaw": self.moment_nm}
        return np.array([parts.get(dof, 0.0) for dof in dofs])

    def table(self, dofs: tuple[str, ...]) -> Vessel:
        """The same as terms of the force that a motion needs: tau = F(nu_dot, nu) - R(psi)' f."""
        force = self.ned(dofs)
        if dofs == DOFS:
            return derivative_table("constant force", dofs, self._spatial())
        if dofs != PLANAR:
            return Vessel("constant force", dofs, basis.terms(["1"]), -force[None, :])
        north, east, moment = force
        theta = [[0.0, 0.0, -moment], [-north, -east, 0.0], [-east, north, 0.0]]
        names = basis.terms(["1", "cos(psi)", "sin(psi)"])
        return Vessel("constant force", dofs, names, np.array(theta))

    def _spatial(self) -> dict[str, float]:
        """R' f as derivatives, in six degrees of freedom."""
        north, east, moment = self.north_n, self.east_n, self.moment_nm
        return {
            "X_cos(theta)cos(psi)": north, "X_cos(theta)sin(psi)": east,
            "Y_sin(phi)sin(theta)cos(psi)": north, "Y_cos(phi)sin(psi)": -north,
            "Y_sin(phi)sin(theta)sin(psi)": east, "Y_cos(phi)cos(psi)": east,
            "Z_cos(phi)sin(theta)cos(psi)": north, "Z_sin(phi)sin(psi)": north,
            "Z_cos(phi)sin(theta)sin(psi)": east, "Z_sin(phi)cos(psi)": -east,
            "K_sin(theta)": -moment, "M_sin(phi)cos(theta)": moment,
            "N_cos(phi)cos(theta)": moment,
        }  # fmt: skip


@dataclass(frozen=True)
class Disturbance:
    """A disturbance case, composed of parts; a part that is None is absent."""

    noise: MeasurementNoise | None = None
    force: ConstantForce | None = None
    wind: Wind | None = None
    current: Current | None = None
    waves: Waves | None = None
    process: ProcessNoise | None = None

    def check(self, dofs: Sequence[str], duration_s: float = 0.0) -> None:
        """Raise ConfigurationError for a part that a vessel of these dofs cannot meet so long."""
        if self.wind is not None:
            self.wind.check(dofs, duration_s)
        for part in (self.waves, self.process):
            if part is not None:
                part.check(dofs)

    def realise(
        self,
        n: int,
        dofs: Sequence[str],
        noise_rng: np.random.Generator,
        weather_rng: np.random.Generator | None = None,
        period_s: float | None = None,
    ) -> Weather:
        """One realisation of n control instants; the same generators give the same weather.

        `weather_rng` and the control period [s] are for wind, current, waves and process noise.
        """
        weather = self._steady(n, dofs, noise_rng)
        if not (self.wind or self.current or self.waves or self.process):
            return weather
        if weather_rng is None or period_s is None:
            raise TypeError("weather_rng and period_s are needed for what varies")
        seeds = weather_rng.integers(0, 2**63, size=4)
        wind_rng, current_rng, wave_rng, process_rng = (np.random.default_rng(s) for s in seeds)
        if self.wind is not None:
            deviation = 0.0 if self.noise is None else self.noise.wind_m_s
            weather = weather._replace(
                wind_ned=self.wind.realise(n, period_s, wind_rng),
                wind_noise=deviation * noise_rng.standard_normal((n, 2)),
            )
        if self.current is not None:
            weather = weather._replace(current_ned=self.current.realise(n, period_s, current_rng))
        if self.waves is not None:
            motion = self.waves.realise(n, period_s, wave_rng)
            weather = weather._replace(wave_motion=motion, pose_noise=weather.pose_noise + motion)
        if self.process is not None:
            weather = weather._replace(process=self.process.realise(n, process_rng))
        return weather

    def _steady(self, n: int, dofs: Sequence[str], noise_rng: np.random.Generator) -> Weather:
        """Measurement noise and the constant force."""
        deviations = np.zeros((3, len(dofs))) if self.noise is None else self.noise.deviations(dofs)
        draws = noise_rng.standard_normal((n, 3, len(dofs))) * deviations
        force = np.zeros(len(dofs)) if self.force is None else self.force.ned(dofs)
        pose, velocity, acceleration = (np.ascontiguousarray(draws[:, i]) for i in range(3))
        return Weather(pose, velocity, acceleration, np.tile(force, (n, 1)))

    def aerodynamics(self, dofs: tuple[str, ...]) -> Vessel:
        """The terms that the wind adds to the vessel that sails in it."""
        if self.wind is None:
            return Vessel("no wind", dofs, (), np.zeros((0, len(dofs))))
        return self.wind.table(dofs)

    def table(self, dofs: tuple[str, ...]) -> Vessel:
        """What the disturbance adds to the force a motion needs, as far as it is a table."""
        table = self.aerodynamics(dofs)
        return table if self.force is None else table + self.force.table(dofs)
