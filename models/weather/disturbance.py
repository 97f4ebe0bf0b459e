"""Disturbance cases, composed of parts and realised from seeded generators.

The measurement noise has its own generator. The seeds of the other parts are drawn from a second
generator in a fixed order, so adding or removing a part does not change the realisation of others.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np

from seatrial.models.errors import PartError
from seatrial.models.notation import DOFS, PLANAR
from seatrial.models.returned import checked_array, name_of
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.derivatives import derivative_table
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.tuning import FromVessel
from seatrial.models.weather.noise import MeasurementNoise
from seatrial.models.weather.weather import Force, Noise, Part, Stream, Weather


@dataclass(frozen=True)
class ConstantForce(Force):
    """A force that is constant in NED. Jervan (2020), Table 4.16.

    A vessel that moves along one axis only is affected by the northward component.
    """

    north_n: Annotated[float, FromVessel("tuning.constant_force.north_n")]
    east_n: Annotated[float, FromVessel("tuning.constant_force.east_n")]
    moment_nm: Annotated[float, FromVessel("tuning.constant_force.moment_nm")]

    varies: ClassVar[bool] = False

    def realise(
        self, n: int, dofs: Sequence[str], period_s: float, rng: np.random.Generator
    ) -> Array:
        """The same force [N, Nm] at every instant, shape (n, n_dof)."""
        return np.tile(self.ned(dofs), (n, 1))

    def ned(self, dofs: Sequence[str]) -> Array:
        """The force over `dofs` [N, Nm], shape (n_dof,)."""
        parts = {"surge": self.north_n, "sway": self.east_n, "yaw": self.moment_nm}
        return np.array([parts.get(dof, 0.0) for dof in dofs])

    def table(self, dofs: tuple[str, ...]) -> Vessel:
        """The force as terms of the required force: tau = F(nu_dot, nu) - R(psi)' f."""
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
    """A disturbance case composed of parts; None means that a part is absent.

    `others` are additional parts, by name.
    """

    noise: MeasurementNoise | None = None
    force: Force | None = None
    wind: Stream | None = None
    current: Stream | None = None
    waves: Noise | None = None
    process: Noise | None = None
    others: dict[str, Part] | None = None

    @property
    def parts(self) -> tuple[Part | None, ...]:
        """All parts except the measurement noise, in the order of their generators."""
        named = (self.wind, self.current, self.waves, self.process, self.force)
        return (*named, *(self.others or {}).values())

    def check(self, dofs: Sequence[str], duration_s: float = 0.0) -> None:
        """Raise ConfigurationError if a part does not suit the vessel or the duration [s]."""
        for part in self.parts:
            if part is not None:
                part.check(dofs, duration_s)

    def realise(
        self,
        n: int,
        dofs: Sequence[str],
        noise_rng: np.random.Generator,
        weather_rng: np.random.Generator | None = None,
        period_s: float | None = None,
    ) -> Weather:
        """A realisation over n control instants; the same generators give the same weather.

        `weather_rng` and the control period [s] are required for every varying part except the
        measurement noise. A generator stays as it was if nothing random depends on it.
        """
        weather = self._measured(n, dofs, noise_rng)
        parts = self.parts
        if weather_rng is None or period_s is None:
            if any(part is not None and part.varies for part in parts):
                raise TypeError("weather_rng and period_s are required by a part that varies")
            weather_rng, period_s = np.random.default_rng(0), 0.0
        before, used = weather_rng.bit_generator.state, False
        seeds = weather_rng.integers(0, 2**63, size=len(parts))
        for part, seed in zip(parts, seeds, strict=True):
            if part is not None:
                rng = np.random.default_rng(seed)
                fresh = rng.bit_generator.state
                weather = _checked(part, part.added(weather, dofs, period_s, rng), n)
                used = used or rng.bit_generator.state != fresh
        if not used:
            weather_rng.bit_generator.state = before
        if len(weather.wind_ned):
            wind_noise = np.zeros((n, 2))
            if self.noise is not None and self.noise.wind_m_s:
                wind_noise = self.noise.wind_m_s * noise_rng.standard_normal((n, 2))
            weather = weather._replace(wind_noise=wind_noise)
        return weather

    def _measured(self, n: int, dofs: Sequence[str], noise_rng: np.random.Generator) -> Weather:
        """Weather with the measurement noise and zero force."""
        draws = np.zeros((n, 3, len(dofs)))
        if self.noise is not None:
            deviations, wind = self.noise.deviations(dofs), self.noise.wind_m_s
            if np.any(deviations) or wind:  # a generator that gives nothing is left as it was
                draws = noise_rng.standard_normal((n, 3, len(dofs))) * deviations
        pose, velocity, acceleration = (np.ascontiguousarray(draws[:, i]) for i in range(3))
        return Weather(pose, velocity, acceleration, np.zeros((n, len(dofs))))

    def aerodynamics(self, dofs: tuple[str, ...]) -> Vessel:
        """The terms that the parts add to the table of the vessel, such as the wind forces."""
        zero = Vessel("no wind", dofs, (), np.zeros((0, len(dofs))))
        return _total(
            zero, (None if part is None else part.aerodynamics(dofs) for part in self.parts)
        )

    def table(self, dofs: tuple[str, ...]) -> Vessel:
        """The part of the disturbance that is a table of the force that a motion requires."""
        zero = Vessel("no wind", dofs, (), np.zeros((0, len(dofs))))
        return _total(zero, (None if part is None else part.table(dofs) for part in self.parts))


def _checked(part: Part, weather: Weather, n: int) -> Weather:
    """The weather that a part has returned; raises PartError if it cannot be used."""
    if not isinstance(weather, Weather):
        got = type(weather).__name__
        raise PartError(f"{name_of(part)}.added: got a {got}, expected the weather")
    for name, rows in weather._asdict().items():
        columns = np.shape(rows)[1:]
        checked_array(part, f"added: {name}", rows, (n if len(rows) else 0, *columns))
    return weather


def _total(zero: Vessel, tables: Iterable[Vessel | None]) -> Vessel:
    """The sum of tables; `zero` if there is none."""
    first, *more = [table for table in tables if table is not None] or [zero]
    return sum(more, start=first)
