"""Guidance: way-points on a timetable, line of sight, and the reference filter."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
import scipy

from seatrial.models.compiled import lean_kernel
from seatrial.models.errors import ConfigurationError
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.simulation.registry import GUIDANCE, FilterTable
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import wrap_kernel
from seatrial.models.vessel.tuning import FromVessel


class Reference(ABC):
    """A reference model between set-point and reference."""

    @abstractmethod
    def table(self, period_s: float) -> NamedTuple:
        """Parameters of the registered step for a control period [s]."""

    def check(self, dofs: Sequence[str]) -> None:  # noqa: B027 - every vessel is accepted
        """Raise ConfigurationError if it does not suit these degrees of freedom."""


@dataclass(frozen=True)
class ReferenceFilter(Reference):
    """Third-order filter of every axis, Jervan (2020), eq. (2.15).

    eta''' + (2 D + 1) W eta'' + (2 D + 1) W^2 eta' + W^3 eta = W^3 r, bandwidth W [rad/s] and
    damping D.
    """

    bandwidth_rad_s: Annotated[Positive, FromVessel("tuning.reference.bandwidth_rad_s")]
    damping: Positive
    axis: int = -1  # the only one that is filtered; -1: all

    def __post_init__(self) -> None:
        check_ranges(self)

    def table(self, period_s: float) -> FilterTable:
        """Exact zero-order-hold discretisation for a control period [s]."""
        w, gain = self.bandwidth_rad_s, 2.0 * self.damping + 1.0
        block = np.zeros((4, 4))
        block[0, 1] = block[1, 2] = 1.0
        block[2] = [-(w**3), -gain * w * w, -gain * w, w**3]
        exact = scipy.linalg.expm(block * period_s)
        return FilterTable(np.ascontiguousarray(exact[:3, :3]), exact[:3, 3].copy(), self.axis)


class SightTable(NamedTuple):
    """Parameters of line-of-sight guidance; way-points (n, 2) in NED [m], radius [m]."""

    waypoints: Array
    radius: float


@lean_kernel
def _sight_step(table: SightTable, state: Array, k: int, eta: Array, setpoint: Array) -> None:
    """Set-point at the circle around the vessel on the leg. Jervan (2020), eqs. (2.16)-(2.18).

    state = (next way-point, unwrapped heading). If the circle does not reach the leg, its radius
    is increased to the distance from the leg.
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


def check_waypoints(waypoints: Sequence[Sequence[float]]) -> None:
    """Raise ConfigurationError for fewer than two way-points, or two equal ones in succession."""
    points = np.array(waypoints, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2:
        raise ConfigurationError("waypoints: expected at least two of (north, east)")
    if np.min(np.hypot(*np.diff(points, axis=0).T)) == 0.0:
        raise ConfigurationError(
            "waypoints: got two equal consecutive points, expected distinct ones"
        )


@dataclass(frozen=True)
class LineOfSight:
    """Line-of-sight guidance through way-points (north, east) [m]; acceptance radius [m]."""

    waypoints: tuple[tuple[float, ...], ...]
    radius_m: Positive

    def __post_init__(self) -> None:
        check_ranges(self)
        check_waypoints(self.waypoints)

    def build(self, start: Array) -> tuple[SightTable, Array]:
        """Parameters and initial state of the compiled step, from a starting pose (3,)."""
        points = np.array(self.waypoints, dtype=np.float64)
        return SightTable(points, self.radius_m), np.array([1.0, start[2]])


def straight_line_setpoints(
    waypoints: Array, interval_s: float, t: Array, speed_m_s: float, turn_rate_rad_s: float
) -> Array:
    """Set-points that move on straight lines between way-points, shape (N, 3).

    A new way-point (x, y, psi; unwrapped) [m, m, rad] starts every `interval_s` from t = 0; the
    first leg starts at the origin. The set-point moves to it in T = max(distance / speed, |turn| /
    turn rate), x, y and psi simultaneously, and then waits.
    """
    points = np.vstack([np.zeros(3), waypoints])
    leg = np.minimum((t / interval_s + 1e-9).astype(int), len(waypoints) - 1)
    change = np.diff(points, axis=0)[leg]
    distance, turn = np.hypot(change[:, 0], change[:, 1]), np.abs(change[:, 2])
    duration = np.maximum(distance / speed_m_s, turn / turn_rate_rad_s)
    share = np.clip((t - leg * interval_s) / np.maximum(duration, 1e-12), 0.0, 1.0)
    return np.asarray(points[leg] + share[:, None] * change, dtype=np.float64)


def step_setpoints(waypoints: Array, interval_s: float, t: Array) -> Array:
    """Set-points that step to a new way-point every `interval_s` [s], shape (N, 3)."""
    leg = np.minimum((t / interval_s + 1e-9).astype(int), len(waypoints) - 1)
    return np.asarray(waypoints[leg], dtype=np.float64)
