"""Missions of a controller: positioning by set-points, and the courses and paths of a ship.

A reference model stands between set-point and controller. `ReferenceFilter` (Jervan) is linear;
`AccelerationLimited` moves every axis with a limited speed and acceleration and arrives without
overshoot; `Step` passes the set-point on unchanged, one control period later.

A path is followed by line of sight with integral action (ILOS) on the leg of direction pi_p, with
the cross-track error y_e and a look-ahead distance Delta:

    psi_d = pi_p - atan((y_e + sigma y_int) / Delta),
    y_int' = Delta y_e / (Delta^2 + (y_e + sigma y_int)^2)

Without sigma it is line of sight (LOS). Borhaug, Pavlov and Pettersen (2008); Fossen (2021),
section 12.5. Lengths of ships' missions are in ship lengths, times in L / U.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, ClassVar, NamedTuple

import numpy as np

from seatrial.models.compiled import lean_kernel
from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.guidance import (
    Reference,
    ReferenceFilter,
    check_waypoints,
    step_setpoints,
)
from seatrial.models.excitation.helm import ShipMission
from seatrial.models.excitation.missions import Mission, planar_only
from seatrial.models.notation import PLANAR
from seatrial.models.ranges import NotNegative, Positive, check_ranges
from seatrial.models.simulation.registry import GUIDANCE, REFERENCES, FilterTable, Timetable
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import wrap_kernel
from seatrial.models.vessel.tuning import FromVessel

# The filter that passes the set-point on: x <- (r, 0, 0)
UNFILTERED = FilterTable(np.zeros((3, 3)), np.array([1.0, 0.0, 0.0]))


class LimitTable(NamedTuple):
    """Limits of every axis, shape (n_dof,), and the control period [s]."""

    speed: Array
    acceleration: Array
    period_s: float


@lean_kernel
def _approach(table: LimitTable, state: Array, setpoint: Array) -> None:
    """x <- x + h v with the largest v that still stops in time; state (x, v, v_dot).

    Braking with a in steps of h from v takes h (v + (v - a h) + (v - 2 a h) + ...). With m whole
    steps that is the distance d for v = d / ((m + 1) h) + m a h / 2, the largest m for which
    a h^2 m (m + 1) / 2 <= d.
    """
    h = table.period_s
    for i in range(state.shape[0]):
        a, distance, v = table.acceleration[i], setpoint[i] - state[i, 0], state[i, 1]
        m = np.floor(0.5 * (np.sqrt(1.0 + 8.0 * abs(distance) / (a * h * h)) - 1.0))
        velocity = min(abs(distance) / ((m + 1.0) * h) + 0.5 * m * a * h, table.speed[i])
        velocity = velocity if distance > 0.0 else -velocity
        change = min(max(velocity - v, -a * h), a * h)
        state[i, 1] = v + change
        state[i, 0] += h * state[i, 1]
        state[i, 2] = change / h


REFERENCES[LimitTable] = _approach


@dataclass(frozen=True)
class Step(Reference):
    """The set-point without filtering, for a positioning controller with a preview."""

    def table(self, period_s: float) -> FilterTable:
        """Parameters of the compiled step."""
        return UNFILTERED


@dataclass(frozen=True)
class AccelerationLimited(Reference):
    """Speed [m/s, rad/s] and acceleration [m/s^2, rad/s^2] of the reference, by axis, in NED."""

    speed: Annotated[tuple[Positive, ...], FromVessel("tuning.control.mission.speed")]
    acceleration: Annotated[tuple[Positive, ...], FromVessel("tuning.control.mission.acceleration")]

    def __post_init__(self) -> None:
        check_ranges(self)

    def check(self, dofs: Sequence[str]) -> None:
        """Raise ConfigurationError unless there is a limit for every axis."""
        if {len(self.speed), len(self.acceleration)} != {len(dofs)}:
            raise ConfigurationError(
                f"reference_filter: expected speed and acceleration in each of {', '.join(dofs)}"
            )

    def table(self, period_s: float) -> LimitTable:
        """Parameters of the compiled step for a control period [s]."""
        return LimitTable(np.array(self.speed), np.array(self.acceleration), period_s)


@dataclass(frozen=True)
class Setpoints(Mission):
    """A pose (north [m], east [m], heading [deg], unwrapped) at each share of the duration.

    `schedules` are lists of poses by name, `schedule` the one that is sailed: its poses share the
    duration equally. Positions are multiplied by `scale`. A vessel that moves in surge only uses
    the northward component.
    """

    schedule: str
    schedules: dict[str, tuple[tuple[float, float, float], ...]]
    scale: Annotated[Positive, FromVessel("tuning.control.mission.side_m")]
    duration_s: Annotated[  # the vessel has that of `square` and `four_corner`
        Positive, FromVessel(lambda own: f"tuning.control.mission.{own.get('schedule')}_s")
    ]
    reference_filter: Reference

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.schedules.get(self.schedule):
            raise ConfigurationError(
                f"schedule: got {self.schedule!r}, expected one of {', '.join(self.schedules)}"
            )

    def guidance(self, t: Array, start: Array) -> tuple[NamedTuple, Array]:
        """The poses as a timetable, in the plane or north alone."""
        poses = np.array(self.schedules[self.schedule], dtype=np.float64)
        poses *= [self.scale, self.scale, np.pi / 180.0]
        interval = self.duration_s / len(poses)
        setpoints = step_setpoints(poses[:, : len(start)], interval, t)
        return Timetable(np.ascontiguousarray(setpoints)), np.zeros(1)

    def check(self, dofs: Sequence[str]) -> None:
        """Raise ConfigurationError unless the vessel is planar or moves in surge only."""
        if tuple(dofs) != ("surge",):
            planar_only("a schedule of set-points", dofs)
        self.reference_filter.check(dofs)


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

    `bandwidth` is that of the filter of the heading, in units of U / L; the other set-points are
    not filtered.
    """

    bandwidth: Positive
    damping: Positive = 1.0
    dofs: Annotated[tuple[str, ...], FromVessel("dofs")]

    needed: ClassVar[tuple[str, ...]] = PLANAR  # degrees of freedom

    @property
    def reference_filter(self) -> Reference:
        """The filter of the heading."""
        return ReferenceFilter(self.bandwidth / self.unit_s, self.damping, self.dofs.index("yaw"))

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

    @property
    def duration_s(self) -> float:
        """Length [s]."""
        return len(self.headings_deg) * self.hold_lengths * self.unit_s

    def guidance(self, t: Array, start: Array) -> tuple[NamedTuple, Array]:
        """The headings by instant."""
        held = max(1, round(len(t) / len(self.headings_deg)))
        headings = np.radians(self.headings_deg)
        return Courses(self.dofs.index("yaw"), headings, held), np.zeros(1)


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
        period, yaw = float(t[1] - t[0]) if len(t) > 1 else 0.0, self.dofs.index("yaw")
        points = self.length_m * np.array(self.waypoints, dtype=np.float64)
        path = Path(
            yaw, points, self.radius * self.length_m, self.ahead * self.length_m,
            self.sigma * self.speed_m_s, period,
        )  # fmt: skip
        return path, np.array([0.0, 0.0, start[yaw]])
