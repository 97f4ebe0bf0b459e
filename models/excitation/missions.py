"""What a vessel is sent to do: way-points on a timetable, line of sight, the same again."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.guidance import (
    LineOfSight,
    ReferenceFilter,
    Timetable,
    step_setpoints,
    straight_line_setpoints,
)
from seatrial.models.notation import PLANAR
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.recording.recording import Split, half
from seatrial.models.vessel.basis import Array


class Mission(Protocol):
    """A guidance law with a reference filter and a duration."""

    @property
    def duration_s(self) -> float:
        """Length of the mission [s]."""
        ...

    @property
    def reference_filter(self) -> ReferenceFilter:
        """Filter between set-point and reference."""
        ...

    def guidance(self, t: Array, start: Array) -> tuple[NamedTuple, Array]:
        """Parameters and initial state of the compiled guidance step."""
        ...

    def check(self, dofs: Sequence[str]) -> None:
        """Raise ConfigurationError when a vessel of these degrees of freedom cannot do it."""
        ...


class Exciting(Protocol):
    """A mission that applies a force of its own, in an open loop or beside the controller."""

    @property
    def open_loop(self) -> bool:
        """Whether no controller takes part."""
        ...

    def force(self, t: Array, dofs: Sequence[str], rng: np.random.Generator) -> Array:
        """Force [N, Nm] at the times t [s], shape (N, n_dof)."""
        ...

    def steering(self, dofs: Sequence[str], period_s: float) -> tuple[NamedTuple, Array] | None:
        """Parameters and initial state of a step in the controller's place, where there is one."""
        ...

    def check_limits(self, limits: Mapping[str, float], period_s: float) -> None:
        """Raise ConfigurationError where a force exceeds what the thrusters can give [N, Nm]."""
        ...


def is_open_loop(mission: Mission) -> bool:
    """Whether a mission is sailed without a controller."""
    return bool(getattr(mission, "open_loop", False))


def added_force(
    mission: Mission, t: Array, dofs: Sequence[str], rng: np.random.Generator
) -> Array | None:
    """The force of a mission that has one, shape (N, n_dof)."""
    exciting: Any = mission
    if hasattr(mission, "force"):
        force: Array = exciting.force(t, dofs, rng)
        return force
    offset = getattr(mission, "offset", None)
    return steady_force(offset, len(t), dofs) if offset else None


def steady_force(offset: Mapping[str, float] | None, n: int, dofs: Sequence[str]) -> Array:
    """A constant force [N, Nm] given by degree of freedom, shape (n, n_dof)."""
    return np.tile([(offset or {}).get(dof, 0.0) for dof in dofs], (n, 1))


def check_offset(offset: Mapping[str, float] | None, dofs: Sequence[str]) -> None:
    """Refuse a constant force on a degree of freedom that the vessel does not have."""
    unknown = [axis for axis in offset or () if axis not in dofs]
    if unknown:
        raise ConfigurationError(
            f"excitation.offset: got {unknown[0]}, but the vessel moves in {', '.join(dofs)}"
        )


def within(name: str, value: float, limits: Mapping[str, float], dof: str) -> None:
    """Refuse a force [N, Nm] that exceeds what the thrusters can give."""
    if dof in limits and abs(value) > limits[dof] * (1.0 + 1e-9):
        raise ConfigurationError(
            f"excitation.{name}: got {value:g}, expected at most the thrusters' {limits[dof]:g} "
            f"in {dof}"
        )


def start_of(mission: Mission, dofs: Sequence[str]) -> Array:
    """The pose that a mission begins at, shape (n_dof,): the origin, unless it says otherwise."""
    return np.array(getattr(mission, "start", np.zeros(len(dofs))))


def steering(
    mission: Mission, dofs: Sequence[str], period_s: float
) -> tuple[NamedTuple, Array] | None:
    """What a mission puts in the controller's place."""
    exciting: Any = mission
    return exciting.steering(dofs, period_s) if hasattr(mission, "steering") else None


def accompanied(
    mission: Mission, dofs: Sequence[str], period_s: float, controller: tuple[Any, Any]
) -> tuple[Any, Any]:
    """A controller's parameters and state, with what a mission steers beside it."""
    exciting: Any = mission
    if not hasattr(mission, "accompany"):
        return controller
    both: tuple[Any, Any] = exciting.accompany(dofs, period_s, controller)
    return both


def check_limits(mission: Mission, limits: Mapping[str, float], period_s: float) -> None:
    """Refuse a mission whose force exceeds the thrusters' limits [N, Nm], by degree of freedom."""
    exciting: Any = mission
    if hasattr(mission, "check_limits"):
        exciting.check_limits(limits, period_s)
    else:
        for dof, value in (getattr(mission, "offset", None) or {}).items():
            within(f"offset.{dof}", value, limits, dof)


def _planar_only(what: str, dofs: Sequence[str]) -> None:
    if tuple(dofs) != PLANAR:
        raise ConfigurationError(
            f"{what} needs a vessel in {', '.join(PLANAR)}, got one in {', '.join(dofs)}"
        )


@dataclass(frozen=True)
class Waypoints:
    """A new way-point (north [m], east [m], heading [deg], unwrapped) every `interval_s`.

    `reference: line` moves the set-point on straight lines at the given speed and turn rate
    (whichever takes longer), and waits; `step` gives the way-points as steps. The recording's
    first `train_fraction` is for training, the rest for testing. Jervan (2020), section 4.1.3.
    """

    waypoints: tuple[tuple[float, ...], ...]
    interval_s: Positive
    reference: Literal["line", "step"]
    speed_m_s: Positive
    turn_rate_rad_s: Positive
    reference_filter: ReferenceFilter
    train_fraction: float
    offset: dict[str, float] | None = None  # [N, Nm], beside the controller

    def __post_init__(self) -> None:
        check_ranges(self)
        if not self.waypoints or any(len(point) != 3 for point in self.waypoints):
            raise ConfigurationError("waypoints: expected a list of (north, east, heading)")
        check_fraction(self.train_fraction)

    @property
    def duration_s(self) -> float:
        """Length of the lap [s]."""
        return len(self.waypoints) * self.interval_s

    def guidance(self, t: Array, start: Array) -> tuple[NamedTuple, Array]:
        """The set-points as a timetable; `start` is not used, the lap begins at the origin."""
        points = np.array(self.waypoints, dtype=np.float64)
        points[:, 2] = np.radians(points[:, 2])
        if self.reference == "step":
            setpoints = step_setpoints(points, self.interval_s, t)
        else:
            setpoints = straight_line_setpoints(
                points, self.interval_s, t, self.speed_m_s, self.turn_rate_rad_s
            )
        return Timetable(np.ascontiguousarray(setpoints)), np.zeros(1)

    def split(self, t: Array) -> Split:
        """Training and testing samples: the lap's first part, and the rest."""
        return half(len(t), self.train_fraction)

    def check(self, dofs: Sequence[str]) -> None:
        """Way-points are poses in the plane."""
        _planar_only("a lap of way-points", dofs)
        check_offset(self.offset, dofs)


@dataclass(frozen=True)
class Operation:
    """Line of sight through way-points with an unrolled heading. Jervan, section 4.5.4."""

    sight: LineOfSight
    reference_filter: ReferenceFilter
    duration_s: Positive

    def __post_init__(self) -> None:
        check_ranges(self)

    def guidance(self, t: Array, start: Array) -> tuple[NamedTuple, Array]:
        """Line of sight from the pose `start`."""
        return self.sight.build(start)

    def check(self, dofs: Sequence[str]) -> None:
        """Line of sight steers in the plane."""
        _planar_only("line of sight", dofs)


@dataclass(frozen=True)
class Replay:
    """The identification trajectory again, under the same weather."""

    def check(self, dofs: Sequence[str]) -> None:
        """What could be sailed once can be sailed again."""


def check_fraction(fraction: float) -> None:
    """Refuse a training share that leaves nothing to train or to test with."""
    if not 0.0 < fraction < 1.0:
        raise ConfigurationError(f"train_fraction must lie between 0 and 1, got {fraction}")
