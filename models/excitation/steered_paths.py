"""Missions of a steered vessel with a controller: changes of heading, and a path.

Line of sight with integral action (ILOS) on the leg of direction pi_p, with the cross-track error
y_e and a look-ahead distance Delta:

    psi_d = pi_p - atan((y_e + sigma y_int) / Delta),
    y_int' = Delta y_e / (Delta^2 + (y_e + sigma y_int)^2)

Without sigma it is line of sight (LOS). Borhaug, Pavlov and Pettersen (2008); Fossen (2021),
section 12.5. Lengths are in ship lengths, times in L / U.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar, NamedTuple

import numpy as np

from seatrial.models.compiled import lean_kernel
from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.guidance import Reference, ReferenceFilter, check_waypoints
from seatrial.models.excitation.helm import ShipMission
from seatrial.models.notation import PLANAR
from seatrial.models.ranges import NotNegative, Positive
from seatrial.models.simulation.registry import GUIDANCE, FilterTable
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import wrap_kernel
from seatrial.models.vessel.tuning import FromVessel


@dataclass(frozen=True)
class HeadingReference(ReferenceFilter):
    """The filter of the heading alone; the other set-points are the reference."""

    yaw: int

    def table(self, period_s: float) -> FilterTable:
        """Exact zero-order-hold discretisation for a control period [s]."""
        return super().table(period_s)._replace(axis=self.yaw)


class Courses(NamedTuple):
    """Headings [rad] in turn, each for a number of instants; positions are where the vessel is."""

    yaw: int
    headings: Array
    held: int


@lean_kernel
def _give_course(table: Courses, state: Array, k: int, eta: Array, setpoint: Array) -> None:
    for i in range(setpoint.shape[0]):
        setpoint[i] = eta[i]
    setpoint[table.yaw] = table.headings[min(k // table.held, len(table.headings) - 1)]


GUIDANCE[Courses] = _give_course


class Path(NamedTuple):
    """Parameters of the line of sight; SI units."""

    yaw: int
    waypoints: Array  # (n, 2) in NED
    radius: float  # of acceptance of a way-point
    ahead: float  # Delta
    sigma: float  # 0: without integral action
    period_s: float


@lean_kernel
def _on_leg(points: Array, leg: int, eta: Array) -> tuple[float, float, float, float, float]:
    """Direction (north, east) of a leg, its length, and the way along it and to its side [m]."""
    north, east = points[leg + 1, 0] - points[leg, 0], points[leg + 1, 1] - points[leg, 1]
    ahead, aside = eta[0] - points[leg, 0], eta[1] - points[leg, 1]
    length = np.hypot(north, east)
    along = (ahead * north + aside * east) / length
    return north, east, length, along, (aside * north - ahead * east) / length


@lean_kernel
def _follow_path(table: Path, state: Array, k: int, eta: Array, setpoint: Array) -> None:
    """Heading of the sight, and the nearest point of the leg; state = (leg, y_int, heading)."""
    leg, points = int(state[0]), table.waypoints
    north, east, length, along, aside = _on_leg(points, leg, eta)
    if along > length - table.radius and leg < points.shape[0] - 2:
        leg += 1
        state[0], state[1] = leg, 0.0
        north, east, length, along, aside = _on_leg(points, leg, eta)
    wanted = aside + table.sigma * state[1]
    heading = np.arctan2(east, north) - np.arctan(wanted / table.ahead)
    if table.sigma > 0.0:
        state[1] += table.period_s * table.ahead * aside / (table.ahead**2 + wanted**2)
    state[2] += wrap_kernel(heading - state[2])
    for i in range(setpoint.shape[0]):
        setpoint[i] = eta[i]
    setpoint[0] = points[leg, 0] + along * north / length
    setpoint[1] = points[leg, 1] + along * east / length
    setpoint[table.yaw] = state[2]


GUIDANCE[Path] = _follow_path


@dataclass(frozen=True, kw_only=True)
class SteeredClosedLoop(ShipMission):
    """A mission in which a controller steers a vessel by its inputs, from its approach speed.

    `bandwidth` is that of the filter of the heading, in units of U / L.
    """

    bandwidth: Positive
    damping: Positive = 1.0
    dofs: Annotated[tuple[str, ...], FromVessel("dofs")]

    needed: ClassVar[tuple[str, ...]] = PLANAR  # degrees of freedom

    @property
    def yaw(self) -> int:
        """Position of the heading in a pose."""
        return self.dofs.index("yaw")

    @property
    def reference_filter(self) -> Reference:
        """The filter of the heading."""
        return HeadingReference(self.bandwidth / self.unit_s, self.damping, self.yaw)

    def check(self, dofs: Sequence[str]) -> None:
        """Raise ConfigurationError unless the vessel moves as needed by inputs."""
        if not self.input_names or not {*self.needed} <= {*dofs}:
            raise ConfigurationError(
                f"a course needs a vessel in {', '.join(self.needed)} with inputs, got "
                f"{', '.join(self.input_names) or 'none'} in {', '.join(dofs)}"
            )


@dataclass(frozen=True, kw_only=True)
class HeadingChanges(SteeredClosedLoop):
    """Headings [deg] in turn, each for `hold_lengths`."""

    headings_deg: tuple[float, ...]
    hold_lengths: Positive

    needed: ClassVar[tuple[str, ...]] = ("yaw",)

    def __post_init__(self) -> None:
        if not self.headings_deg:
            raise ConfigurationError("headings_deg: got none, expected at least one")
        super().__post_init__()

    @property
    def duration_s(self) -> float:
        """Length [s]."""
        return len(self.headings_deg) * self.hold_lengths * self.unit_s

    def guidance(self, t: Array, start: Array) -> tuple[NamedTuple, Array]:
        """The headings by instant."""
        held = max(1, round(len(t) / len(self.headings_deg)))
        return Courses(self.yaw, np.radians(self.headings_deg), held), np.zeros(1)


@dataclass(frozen=True, kw_only=True)
class PathFollowing(SteeredClosedLoop):
    """Way-points (north, east) in ship lengths, by line of sight with integral action `sigma`.

    A way-point is passed within `radius`, the line of sight looks `ahead`, both in ship lengths;
    `sigma` is in units of U.
    """

    waypoints: tuple[tuple[float, ...], ...]
    radius: Positive
    ahead: Positive
    sigma: NotNegative

    def __post_init__(self) -> None:
        super().__post_init__()
        check_waypoints(self.waypoints)

    @property
    def duration_s(self) -> float:
        """Time along all legs at the approach speed [s]."""
        legs = np.hypot(*np.diff(np.array(self.waypoints, dtype=np.float64), axis=0).T)
        return float(np.sum(legs)) * self.unit_s

    def guidance(self, t: Array, start: Array) -> tuple[NamedTuple, Array]:
        """The line of sight; the last leg is followed beyond its end."""
        period = float(t[1] - t[0]) if len(t) > 1 else 0.0
        points = self.length_m * np.array(self.waypoints, dtype=np.float64)
        path = Path(
            self.yaw, points, self.radius * self.length_m, self.ahead * self.length_m,
            self.sigma * self.speed_m_s, period,
        )  # fmt: skip
        return path, np.array([0.0, 0.0, start[self.yaw]])
