"""Positioning missions: set-points on a timetable, and the reference models between them.

A reference model stands between set-point and controller. `ReferenceFilter` (Jervan) is linear;
`AccelerationLimited` moves every axis with a limited speed and acceleration and arrives without
overshoot; `Step` passes the set-point on unchanged, one control period later.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np

from seatrial.models.compiled import lean_kernel
from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.guidance import Reference, step_setpoints
from seatrial.models.excitation.missions import Mission
from seatrial.models.notation import PLANAR
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.simulation.registry import REFERENCES, FilterTable, Timetable
from seatrial.models.vessel.basis import Array
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
        for name in ("speed", "acceleration"):
            if len(getattr(self, name)) != len(dofs):
                raise ConfigurationError(
                    f"evaluation.reference_filter.{name}: got {len(getattr(self, name))} numbers, "
                    f"expected {len(dofs)} for {', '.join(dofs)}"
                )

    def table(self, period_s: float) -> LimitTable:
        """Parameters of the compiled step for a control period [s]."""
        return LimitTable(np.array(self.speed), np.array(self.acceleration), period_s)


def _duration_of(options: Mapping[str, object]) -> str:
    """The duration of a schedule that the vessel gives: of `square` and `four_corner`."""
    return f"tuning.control.mission.{options.get('schedule')}_s"


@dataclass(frozen=True)
class Setpoints(Mission):
    """A pose (north [m], east [m], heading [deg], unwrapped) at each share of the duration.

    `schedules` are lists of poses by name, `schedule` the one that is sailed: its poses share the
    duration equally. Positions are multiplied by `scale`. A vessel that moves in surge only uses
    the northward component.
    """

    schedule: str
    schedules: dict[str, tuple[tuple[float, ...], ...]]
    scale: Annotated[Positive, FromVessel("tuning.control.mission.side_m")]
    duration_s: Annotated[Positive, FromVessel(_duration_of)]
    reference_filter: Reference

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.schedule not in self.schedules:
            raise ConfigurationError(
                f"schedule: got {self.schedule!r}, expected one of {', '.join(self.schedules)}"
            )
        for name, points in self.schedules.items():  # those that are not sailed as well
            if not points or any(len(point) != 3 for point in points):
                raise ConfigurationError(
                    f"schedules.{name}: expected a list of (north, east, heading)"
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
        """Raise ConfigurationError unless the vessel is planar or moves in surge only."""
        if tuple(dofs) not in (PLANAR, ("surge",)):
            raise ConfigurationError(
                f"a schedule of set-points needs a vessel in surge, or in {', '.join(PLANAR)}, "
                f"got one in {', '.join(dofs)}"
            )
        self.reference_filter.check(dofs)
