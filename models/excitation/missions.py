"""Missions: way-points on a timetable, line-of-sight guidance, and replay of the excitation."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.commands import Piece, Steering, command
from seatrial.models.excitation.guidance import (
    LineOfSight,
    Reference,
    step_setpoints,
    straight_line_setpoints,
)
from seatrial.models.notation import PLANAR
from seatrial.models.ranges import Fraction, Positive, check_ranges
from seatrial.models.recording.recording import Split, half
from seatrial.models.simulation.registry import Timetable
from seatrial.models.simulation.voyage import Outlook
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.tuning import FromVessel

NO_REFERENCE = "evaluation=replay has no reference in an open loop: deployment is skipped"


class Evaluation(ABC):
    """The evaluation of a controller: a mission, or a replay of the excitation."""

    def check(self, dofs: Sequence[str]) -> None:  # noqa: B027 - every vessel is accepted
        """Raise ConfigurationError if it does not suit a vessel with these degrees of freedom."""

    @abstractmethod
    def mission(self, excitation: "Mission") -> "Mission":
        """The mission that evaluates the controller after this excitation."""

    def skip_reason(self, excitation: "Mission") -> str | None:
        """Why there is no evaluation after this excitation; None if there is one."""
        return None


class Length(NamedTuple):
    """Length [s] of a mission, and the option that sets it."""

    option: str
    got: float
    seconds: float


class Mission(Evaluation):
    """A mission: a guidance law with a reference model, and forces added to the command.

    It excites a vessel, evaluates a controller, or both. `duration_s` [s] is its length,
    `reference_filter` the reference model between set-point and reference.
    """

    if TYPE_CHECKING:  # a property would be taken for the default of a field of that name

        @property
        def duration_s(self) -> float:
            """Length of the mission [s]."""
            ...

        @property
        def reference_filter(self) -> Reference:
            """The reference model between set-point and controller."""
            ...

    def __post_init__(self) -> None:
        """Check the ranges of the options."""
        check_ranges(self)

    def length(self) -> Length:
        """The length, known before a plan: at least `duration_s`, but for passages of a plan."""
        return Length("duration_s", self.duration_s, self.duration_s)

    def drawn(self, rng: np.random.Generator) -> "Mission":
        """The mission with what it draws for a seed, such as its start."""
        return self

    def foreseen(self, outlook: Outlook) -> Outlook:
        """The preview for a controller, with what else is known of the surroundings."""
        return outlook

    def guidance(self, t: Array, start: Array) -> tuple[NamedTuple, Array]:
        """Parameters and initial state of the guidance step, for times t [s] from a pose.

        Without set-points the pose is held.
        """
        return Timetable(np.tile(start, (len(t), 1))), np.zeros(1)

    @property
    def open_loop(self) -> bool:
        """Whether the mission runs without a controller."""
        return False

    @property
    def start(self) -> Array | None:
        """The initial pose [m, rad], shape (n_dof,); None means the origin."""
        return None

    @property
    def commands_inputs(self) -> bool:
        """Whether it commands the inputs of a vessel; otherwise forces on its axes."""
        return False

    def start_velocity(self, dofs: tuple[str, ...]) -> Array | None:
        """The initial velocity [m/s, rad/s], shape (n_dof,); None means rest."""
        return None

    def steady(self) -> Mapping[str, float]:
        """A constant force [N, Nm] by degree of freedom: the option `offset`, if there is one."""
        offset = getattr(self, "offset", None)
        return offset if isinstance(offset, Mapping) else {}

    def force(self, t: Array, dofs: Sequence[str], rng: np.random.Generator) -> Array | None:
        """Force [N, Nm] added to the command at the times t [s], shape (N, n_dof); None: none."""
        steady = self.steady()
        return steady_force(steady, len(t), dofs) if steady else None

    def pieces(self, period_s: float) -> Sequence[Piece]:
        """The pieces of a yaw moment that the heading decides on; empty if there is none."""
        return ()

    def steering(self, dofs: Sequence[str], period_s: float) -> Steering | None:
        """The step that replaces the controller in an open loop; None in a closed loop."""
        if not self.open_loop:
            return None
        yaw = dofs.index("yaw") if "yaw" in dofs else 0
        return command(self.pieces(period_s) or [Piece()], np.zeros(len(dofs)), yaw, yaw)

    def split(self, t: Array) -> Split:
        """Which samples are for training and which for testing: by default the first part is."""
        return half(len(t), getattr(self, "train_fraction", 0.5))

    def check_limits(self, limits: Mapping[str, float], period_s: float) -> None:
        """Raise ConfigurationError if a force exceeds the limits of the thrusters [N, Nm].

        `limits` are those of all degrees of freedom of the vessel, if they are known.
        """
        if self.commands_inputs or not limits:
            return
        t = period_s * np.arange(round(self.duration_s / period_s), dtype=np.float64)
        force = self.force(t, tuple(limits), np.random.default_rng(0))
        peak = np.zeros(len(limits)) if force is None else np.max(np.abs(force), axis=0)
        moment = max((abs(piece.order) for piece in self.pieces(period_s)), default=0.0)
        for (dof, limit), value in zip(limits.items(), peak, strict=True):
            reached = value + moment * (dof == "yaw")
            if limit * (1.0 + 1e-9) < reached < np.inf:  # the trial refuses what is not finite
                raise ConfigurationError(
                    f"the force reaches {reached:g} in {dof}, expected at most the thrusters' "
                    f"{limit:g}"
                )

    def mission(self, excitation: "Mission") -> "Mission":
        """The mission itself, for any excitation."""
        return self


def steady_force(offset: Mapping[str, float], n: int, dofs: Sequence[str]) -> Array:
    """A constant force [N, Nm] given by degree of freedom, shape (n, n_dof)."""
    return np.tile([offset.get(dof, 0.0) for dof in dofs], (n, 1))


def check_axes(option: str, axes: Iterable[str], dofs: Sequence[str]) -> None:
    """Raise ConfigurationError for a force on an axis that does not exist."""
    if unknown := [axis for axis in axes if axis not in dofs]:
        raise ConfigurationError(
            f"excitation.{option}: got {unknown[0]}, but the vessel moves in {', '.join(dofs)}"
        )


def planar_only(what: str, dofs: Sequence[str]) -> None:
    """Raise ConfigurationError unless the vessel moves in the plane."""
    if tuple(dofs) != PLANAR:
        raise ConfigurationError(
            f"{what} needs a vessel in {', '.join(PLANAR)}, got one in {', '.join(dofs)}"
        )


@dataclass(frozen=True)
class Waypoints(Mission):
    """A new way-point (north [m], east [m], heading [deg], unwrapped) every `interval_s`.

    `reference: line` moves the set-point on straight lines at the given speed and turn rate
    (whichever takes longer), and waits; `step` gives the way-points as steps. The recording's
    first `train_fraction` is for training, the rest for testing. Jervan (2020), section 4.1.3.
    """

    waypoints: tuple[tuple[float, ...], ...]
    interval_s: Annotated[Positive, FromVessel("tuning.reference.interval_s")]
    reference: Literal["line", "step"]
    speed_m_s: Annotated[Positive, FromVessel("tuning.reference.speed_m_s")]
    turn_rate_rad_s: Annotated[Positive, FromVessel("tuning.reference.turn_rate_rad_s")]
    reference_filter: Reference
    train_fraction: Fraction
    offset: dict[str, float] | None = None  # [N, Nm], beside the controller

    def __post_init__(self) -> None:
        check_ranges(self)
        if not self.waypoints or any(len(point) != 3 for point in self.waypoints):
            raise ConfigurationError("waypoints: expected a list of (north, east, heading)")

    @property
    def duration_s(self) -> float:
        """Length of the lap [s]."""
        return len(self.waypoints) * self.interval_s

    def length(self) -> Length:
        """The length of the lap."""
        return Length("interval_s", self.interval_s, self.duration_s)

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

    def check(self, dofs: Sequence[str]) -> None:
        """Raise ConfigurationError unless the vessel is planar."""
        planar_only("a lap of way-points", dofs)
        check_axes("offset", self.steady(), dofs)


@dataclass(frozen=True)
class Operation(Mission):
    """Line of sight through way-points with an unrolled heading. Jervan, section 4.5.4."""

    sight: LineOfSight
    reference_filter: Reference
    duration_s: Positive

    def guidance(self, t: Array, start: Array) -> tuple[NamedTuple, Array]:
        """Line of sight from the pose `start`."""
        return self.sight.build(start)

    def check(self, dofs: Sequence[str]) -> None:
        """Raise ConfigurationError unless the vessel is planar."""
        planar_only("line of sight", dofs)


@dataclass(frozen=True)
class Replay(Evaluation):
    """The identification trajectory repeated in the same weather."""

    def mission(self, excitation: Mission) -> Mission:
        """The excitation itself."""
        return excitation

    def skip_reason(self, excitation: Mission) -> str | None:
        """An open loop has no reference for an evaluation."""
        return NO_REFERENCE if excitation.open_loop else None
