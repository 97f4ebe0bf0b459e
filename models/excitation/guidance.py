"""Guidance and reference models: way-points, line of sight, set-points, and how a reference moves.

A reference model stands between set-point and controller. `ReferenceFilter` (Jervan) is linear;
`AccelerationLimited` moves every axis with a limited speed and acceleration and arrives without
overshoot; `Step` takes the set-point as it is, one control period later.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from scipy.linalg import expm

from seatrial.models.compiled import lean_kernel
from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import PLANAR
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.simulation.registry import GUIDANCE, REFERENCES, FilterTable
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import wrap_kernel


@dataclass(frozen=True)
class ReferenceFilter:
    """Third-order filter of every axis, Jervan (2020), eq. (2.15).

    eta''' + (2 D + 1) W eta'' + (2 D + 1) W^2 eta' + W^3 eta = W^3 r, bandwidth W [rad/s] and
    damping D.
    """

    bandwidth_rad_s: Positive
    damping: Positive

    def __post_init__(self) -> None:
        check_ranges(self)

    def table(self, period_s: float) -> FilterTable:
        """Exact zero-order-hold discretisation for a control period [s]."""
        w, gain = self.bandwidth_rad_s, 2.0 * self.damping + 1.0
        block = np.zeros((4, 4))
        block[0, 1] = block[1, 2] = 1.0
        block[2] = [-(w**3), -gain * w * w, -gain * w, w**3]
        exact = expm(block * period_s)
        return FilterTable(np.ascontiguousarray(exact[:3, :3]), exact[:3, 3].copy())


class Timetable(NamedTuple):
    """Set-points known in advance, one row a control instant, shape (N, n_dof)."""

    setpoints: Array


@lean_kernel
def _follow_timetable(table: Timetable, state: Array, k: int, eta: Array, setpoint: Array) -> None:
    for i in range(setpoint.shape[0]):
        setpoint[i] = table.setpoints[k, i]


GUIDANCE[Timetable] = _follow_timetable


class SightTable(NamedTuple):
    """Parameters of line-of-sight guidance; way-points (n, 2) in NED [m], radius [m]."""

    waypoints: Array
    radius: float


@lean_kernel
def _sight_step(table: SightTable, state: Array, k: int, eta: Array, setpoint: Array) -> None:
    """Where the circle about the vessel cuts the leg ahead. Jervan (2020), eqs. (2.16)-(2.18).

    state = (next way-point, unrolled heading). The circle grows to the distance from the leg
    when it does not reach it.
    """
    last = table.waypoints.shape[0] - 1
    target = int(state[0])
    goal = table.waypoints[target]
    if target < last and np.hypot(goal[0] - eta[0], goal[1] - eta[1]) <= table.radius:
        target += 1
        state[0] = target
        goal = table.waypoints[target]
    origin = table.waypoints[target - 1]
    length = np.hypot(goal[0] - origin[0], goal[1] - origin[1])
    north, east = (goal[0] - origin[0]) / length, (goal[1] - origin[1]) / length
    along = (eta[0] - origin[0]) * north + (eta[1] - origin[1]) * east
    across = (eta[1] - origin[1]) * north - (eta[0] - origin[0]) * east
    ahead = along + np.sqrt(max(table.radius**2 - across**2, 0.0))
    if ahead < length:
        setpoint[0], setpoint[1] = origin[0] + ahead * north, origin[1] + ahead * east
        heading = np.arctan2(setpoint[1] - eta[1], setpoint[0] - eta[0])
    else:  # arrived: stand at the last way-point, along the last leg
        setpoint[0], setpoint[1] = goal[0], goal[1]
        heading = np.arctan2(east, north)
    state[1] += wrap_kernel(heading - state[1])
    setpoint[2] = state[1]


GUIDANCE[SightTable] = _sight_step


@dataclass(frozen=True)
class LineOfSight:
    """Line-of-sight guidance through way-points (north, east) [m]; acceptance radius [m]."""

    waypoints: tuple[tuple[float, ...], ...]
    radius_m: Positive

    def __post_init__(self) -> None:
        check_ranges(self)
        points = np.array(self.waypoints, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2:
            raise ConfigurationError("waypoints: expected at least two of (north, east)")
        if np.min(np.hypot(*np.diff(points, axis=0).T)) == 0.0:
            raise ConfigurationError("waypoints: two that follow each other are equal")

    def build(self, start: Array) -> tuple[SightTable, Array]:
        """Parameters and initial state of the compiled step, from a starting pose (3,)."""
        points = np.array(self.waypoints, dtype=np.float64)
        return SightTable(points, self.radius_m), np.array([1.0, start[2]])


def straight_line_setpoints(
    waypoints: Array, interval_s: float, t: Array, speed_m_s: float, turn_rate_rad_s: float
) -> Array:
    """Set-points that move on straight lines between way-points, shape (N, 3).

    A new way-point (x, y, psi; unwrapped) is given every `interval_s` from t = 0, the first
    reached from the origin. The set-point moves there in T = max(distance / speed, |turn| /
    turn rate), x, y and psi together, and waits.
    """
    points = np.vstack([np.zeros(3), waypoints])
    leg = np.minimum((t / interval_s + 1e-9).astype(int), len(waypoints) - 1)
    change = np.diff(points, axis=0)[leg]
    distance, turn = np.hypot(change[:, 0], change[:, 1]), np.abs(change[:, 2])
    duration = np.maximum(distance / speed_m_s, turn / turn_rate_rad_s)
    share = np.clip((t - leg * interval_s) / np.maximum(duration, 1e-12), 0.0, 1.0)
    return np.asarray(points[leg] + share[:, None] * change, dtype=np.float64)


def step_setpoints(waypoints: Array, interval_s: float, t: Array) -> Array:
    """Way-points given as steps, one every `interval_s`, shape (N, 3)."""
    leg = np.minimum((t / interval_s + 1e-9).astype(int), len(waypoints) - 1)
    return np.asarray(waypoints[leg], dtype=np.float64)


class StepTable(NamedTuple):
    """The reference is the set-point times a gain of one."""

    gain: float


@lean_kernel
def _take(table: StepTable, state: Array, setpoint: Array) -> None:
    for i in range(state.shape[0]):
        state[i, 0], state[i, 1], state[i, 2] = table.gain * setpoint[i], 0.0, 0.0


REFERENCES[StepTable] = _take


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
        wanted = min(abs(distance) / ((m + 1.0) * h) + 0.5 * m * a * h, table.speed[i])
        wanted = wanted if distance > 0.0 else -wanted
        change = min(max(wanted - v, -a * h), a * h)
        state[i, 1] = v + change
        state[i, 0] += h * state[i, 1]
        state[i, 2] = change / h


REFERENCES[LimitTable] = _approach


@dataclass(frozen=True)
class Step:
    """The set-point as it is: what a positioning controller with a preview is asked for."""

    def table(self, period_s: float) -> StepTable:
        """Parameters of the compiled step."""
        return StepTable(1.0)


@dataclass(frozen=True)
class AccelerationLimited:
    """Speed [m/s, rad/s] and acceleration [m/s^2, rad/s^2] of the reference, by axis, in NED."""

    speed: tuple[float, ...]
    acceleration: tuple[float, ...]

    def __post_init__(self) -> None:
        for name in ("speed", "acceleration"):
            values = getattr(self, name)
            if len(values) != len(self.speed) or min(values, default=0.0) <= 0.0:
                raise ConfigurationError(
                    f"{name} must be {len(self.speed)} positive numbers, got {list(values)}"
                )

    def table(self, period_s: float) -> LimitTable:
        """Parameters of the compiled step for a control period [s]."""
        return LimitTable(np.array(self.speed), np.array(self.acceleration), period_s)


class Reference(Protocol):
    """A reference model: this module's, or the linear filter."""

    def table(self, period_s: float) -> NamedTuple:
        """Parameters of the compiled step for a control period [s]."""
        ...


@dataclass(frozen=True)
class Setpoints:
    """A pose (north [m], east [m], heading [deg], unwrapped) at each share of the duration.

    `schedules` are lists of poses by name, `schedule` the one that is sailed: its poses share the
    duration equally. Positions are multiplied by `scale`. A vessel that moves in surge alone is
    given the northward part.
    """

    schedule: str
    schedules: dict[str, tuple[tuple[float, ...], ...]]
    scale: Positive
    duration_s: Positive
    reference_filter: Reference

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.schedule not in self.schedules:
            raise ConfigurationError(
                f"schedule: got {self.schedule!r}, expected one of {', '.join(self.schedules)}"
            )
        points = self.schedules[self.schedule]
        if not points or any(len(point) != 3 for point in points):
            raise ConfigurationError(
                f"schedules.{self.schedule}: expected a list of (north, east, heading)"
            )

    def poses(self, n_dof: int) -> Array:
        """The poses of the schedule, shape (n, n_dof) [m, rad]: in the plane, or north alone."""
        points = np.array(self.schedules[self.schedule], dtype=np.float64)
        points[:, :2] *= self.scale
        points[:, 2] = np.radians(points[:, 2])
        return points[:, :n_dof]

    def guidance(self, t: Array, start: Array) -> tuple[NamedTuple, Array]:
        """The set-points as a timetable."""
        poses = self.poses(len(start))
        interval = self.duration_s / len(poses)
        return Timetable(np.ascontiguousarray(step_setpoints(poses, interval, t))), np.zeros(1)

    def check(self, dofs: Sequence[str]) -> None:
        """Poses are in the plane, or along the way; the reference model is of as many axes."""
        if tuple(dofs) not in (PLANAR, ("surge",)):
            raise ConfigurationError(
                f"evaluation={self.schedule} needs a vessel in surge, or in {', '.join(PLANAR)}, "
                f"got one in {', '.join(dofs)}"
            )
        limits = self.reference_filter
        if isinstance(limits, AccelerationLimited) and len(limits.speed) != len(dofs):
            raise ConfigurationError(
                f"evaluation.reference_filter.speed: got {len(limits.speed)} numbers, "
                f"expected {len(dofs)} for {', '.join(dofs)}"
            )
