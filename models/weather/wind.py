"""Wind: its variation in time, and its force on a vessel.

The direction beta is where the air moves *to* in NED, unless `direction` is `from`. With the
velocity through the air nu_q = nu - R(psi)' v_w and its norm V_q, Bargouth (2022), (2.2)-(2.6) are

    X = -d1 V_q u_q,    Y = -d2 V_q v_q,    N = 2 d3 u_q v_q

since V_q cos(gamma) = -u_q and V_q sin(gamma) = -v_q for the angle of attack gamma of the relative
wind: at rest gamma = beta - psi as printed. Wind force is a table like any other.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import PLANAR
from seatrial.models.ranges import NotNegative, Positive, check_ranges
from seatrial.models.recording.source import ReadOptions, column, read_sources
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.derivatives import derivative_table
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.tuning import FromVessel
from seatrial.models.weather.noise import first_order, smoothed_levels
from seatrial.models.weather.weather import Stream

# Bargouth (2022), Table 2.1: wind speeds [m/s] of the forces 1 to 12, first and last
BEAUFORT = (
    (0.5, 1.8), (1.9, 3.3), (3.4, 5.4), (5.5, 7.9), (8.0, 11.0), (11.1, 14.1), (14.2, 17.2),
    (17.3, 20.8), (20.9, 24.4), (24.5, 28.5), (28.6, 32.6), (32.6, 32.6),
)  # fmt: skip
NORSOK_EXPONENT = 0.468
NORSOK_BAND_HZ = (1.0 / 600.0, 0.5)  # range in which the spectrum is valid


class WindForce(ABC):
    """The force of the wind on a vessel, as a table."""

    @abstractmethod
    def table(self, dofs: tuple[str, ...]) -> Vessel:
        """The wind terms of the force that a motion requires."""


@dataclass(frozen=True)
class Windage(WindForce):
    """Wind areas and coefficients, eq. (2.2); cx is for a head wind, cy and cn for a beam wind."""

    frontal_area_m2: NotNegative
    lateral_area_m2: NotNegative
    length_m: Positive
    cx: NotNegative
    cy: NotNegative
    cn: NotNegative
    air_density_kg_m3: NotNegative

    def __post_init__(self) -> None:
        check_ranges(self)

    def coefficients(self) -> tuple[float, float, float]:
        """d1, d2 [N s^2/m^2] and d3 [Nm s^2/m^2] of eq. (2.6)."""
        pressure = 0.5 * self.air_density_kg_m3
        lateral = pressure * self.lateral_area_m2
        along = pressure * self.cx * self.frontal_area_m2
        return along, self.cy * lateral, self.cn * lateral * self.length_m

    def table(self, dofs: tuple[str, ...]) -> Vessel:
        """The terms V_q u_q, V_q v_q and u_q v_q.

        A vessel that rolls is heeled by the side force at the middle of the lateral area above the
        waterline, in which its origin lies. Fossen (2011), section 8.1, with C_K = C_Y.
        """
        d1, d2, d3 = self.coefficients()
        derivatives = {"X_V_qu_q": -d1, "Y_V_qv_q": -d2, "N_u_qv_q": 2.0 * d3}
        if "roll" in dofs:
            derivatives["K_V_qv_q"] = -0.5 * self.lateral_area_m2 / self.length_m * d2
        return derivative_table("wind", dofs, derivatives)


@dataclass(frozen=True)
class WindDerivatives(WindForce):
    """Wind force by derivatives in nu_q, such as X_|u_q|u_q: a second-order modulus model."""

    derivatives: dict[str, float]

    def __post_init__(self) -> None:
        self.table(PLANAR)

    def table(self, dofs: tuple[str, ...]) -> Vessel:
        """Table with entries that are minus the derivatives."""
        return derivative_table("wind", dofs, self.derivatives)


@dataclass(frozen=True)
class Wind(Stream):
    """Wind with a mean speed and direction, and a variation in time.

    `beaufort` (1 to 12, Table 2.1) selects the mean speed of a class and overrides
    `speed_m_s`. `variation`: `constant`; `slow`, smoothed random levels of speed and direction
    (Bargouth, appendix F: the mean speed is half of the largest); `gusting`, a first-order
    Gauss-Markov process of relative standard deviation `intensity`; `spectrum`, NORSOK N-003
    gusts at `height_m` above the sea; `file`, a CSV file with columns t [s], speed [m/s] and
    direction [deg] of the wind.
    """

    windage: Annotated[WindForce | None, FromVessel("tuning.windage")]
    speed_m_s: Annotated[NotNegative, FromVessel("tuning.wind.speed_m_s")]
    beaufort: int | None
    direction_deg: float
    direction: Literal["to", "from"]
    variation: Literal["constant", "slow", "gusting", "spectrum", "file"]
    direction_spread_deg: NotNegative  # of `slow`, width of the range of directions
    intensity: NotNegative  # of `gusting`
    time_constant_s: Annotated[  # of `gusting`
        Positive, FromVessel("tuning.wind.time_constant_s")
    ]
    height_m: Positive  # of `spectrum`
    file: str | None

    air: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.beaufort is not None and not 1 <= self.beaufort <= len(BEAUFORT):
            raise ConfigurationError(f"beaufort must be 1 to {len(BEAUFORT)}, got {self.beaufort}")
        if (self.variation == "file") != (self.file is not None):
            raise ConfigurationError(
                f"file: got {self.file}, expected a path with variation=file and null otherwise"
            )

    def check(self, dofs: Sequence[str], duration_s: float = 0.0) -> None:
        """Raise ConfigurationError unless the vessel turns and its wind forces are known.

        A file must cover the duration [s]. Raises RecordingError if the file cannot be read.
        """
        if not {*PLANAR} <= {*dofs}:
            raise ConfigurationError(
                f"disturbance.wind needs a vessel in {', '.join(PLANAR)}, "
                f"got one in {', '.join(dofs)}"
            )
        if self.windage is None:
            raise ConfigurationError(
                "disturbance.wind.windage: got null, expected wind areas or derivatives"
            )
        if self.variation == "file":
            self._recorded(np.array([0.0, duration_s]))

    def aerodynamics(self, dofs: tuple[str, ...]) -> Vessel:
        """The wind terms of the force that a motion requires."""
        if self.windage is None:
            raise ConfigurationError("disturbance.wind.windage: got null, expected areas")
        return self.windage.table(dofs)

    @property
    def mean_speed(self) -> float:
        """Mean speed [m/s], from `beaufort` if it is set."""
        if self.beaufort is None:
            return self.speed_m_s
        return float(np.mean(BEAUFORT[self.beaufort - 1]))

    def realise(self, n: int, period_s: float, rng: np.random.Generator) -> Array:
        """Velocity of the air (north, east) [m/s], shape (n, 2)."""
        if self.variation == "file":
            return self._recorded(period_s * np.arange(n, dtype=np.float64))
        speed, direction = np.full(n, self.mean_speed), np.full(n, self.direction_deg)
        if self.variation == "slow":
            speed = 2.0 * speed * smoothed_levels(n, rng)
            direction = direction + self.direction_spread_deg * (smoothed_levels(n, rng) - 0.5)
        elif self.variation == "gusting":
            deviation = self.intensity * self.mean_speed
            speed = speed + first_order(n, period_s, deviation, self.time_constant_s, rng)
        elif self.variation == "spectrum" and self.mean_speed > 0.0:
            speed = speed + gusts(n, period_s, self.mean_speed, self.height_m, rng)
        return self._north_east(np.maximum(speed, 0.0), direction)

    def _north_east(self, speed: Array, direction_deg: Array) -> Array:
        angle = np.radians(direction_deg) + (np.pi if self.direction == "from" else 0.0)
        return np.stack([speed * np.cos(angle), speed * np.sin(angle)], axis=1)

    def _recorded(self, t: Array) -> Array:
        sources = read_sources(Path(self.file or ""), ReadOptions())
        columns = {}
        for name in ("t", "speed", "direction"):
            source, plain = column(sources, name)
            columns[name] = source.numbers(plain)
        times = columns["t"]
        if times[0] > t[0] or times[-1] < t[-1] or np.any(np.diff(times) <= 0.0):
            raise ConfigurationError(
                f"file: got {self.file} from {times[0]:g} to {times[-1]:g} s, expected "
                f"increasing times that cover 0 to {t[-1]:g} s"
            )
        velocity = self._north_east(columns["speed"], columns["direction"])
        return np.stack([np.interp(t, times, column) for column in velocity.T], axis=1)


def gust_spectrum(frequency_hz: Array, mean_m_s: float, height_m: float) -> Array:
    """One-sided spectrum of the wind speed [m^2/s^2/Hz]. NORSOK N-003 (1999), section 6.3.2.

    S(f) = 320 (U/10)^2 (z/10)^0.45 / (1 + x^n)^(5/(3n)), x = 172 f (z/10)^(2/3) (U/10)^-0.75,
    n = 0.468, with the mean speed U at 10 m and the height z.
    """
    speed, height = mean_m_s / 10.0, height_m / 10.0
    x = 172.0 * frequency_hz * height ** (2.0 / 3.0) * speed**-0.75
    power = (1.0 + x**NORSOK_EXPONENT) ** (5.0 / (3.0 * NORSOK_EXPONENT))
    return np.asarray(320.0 * speed**2 * height**0.45 / power, dtype=np.float64)


def gusts(
    n: int, period_s: float, mean_m_s: float, height_m: float, rng: np.random.Generator
) -> Array:
    """Deviations from the mean speed with the spectrum above [m/s], shape (n,).

    A sum of 200 waves sqrt(2 S(f) df) cos(2 pi f t + phase) in bands of equal ratio. Frequency and
    phase are random, so the sum is not periodic.
    """
    edges = np.geomspace(*NORSOK_BAND_HZ, 201)
    frequency = rng.uniform(edges[:-1], edges[1:])
    amplitude = np.sqrt(2.0 * gust_spectrum(frequency, mean_m_s, height_m) * np.diff(edges))
    phase = rng.uniform(0.0, 2.0 * np.pi, len(frequency))
    t = period_s * np.arange(n)
    total = np.zeros(n)
    for f, a, p in zip(frequency, amplitude, phase, strict=True):
        total += a * np.cos(2.0 * np.pi * f * t + p)
    return total
