"""A sequence of manoeuvres; the vessel is brought to rest between them.

A phase is a manoeuvre with its own force, a stop by velocity feedback, or a passage. Planned poses
are followed by feedback; the force of a manoeuvre and its stop is then that of the simulation that
was used for planning.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from seatrial.models.excitation import commands
from seatrial.models.excitation.commands import Piece, Steering
from seatrial.models.ranges import NotNegative, check_ranges
from seatrial.models.recording.recording import Mask
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.tuning import FromVessel

Role = Literal["training", "testing", "none"]


@dataclass(frozen=True, eq=False)
class Phase:
    """An interval of `count` control instants."""

    name: str
    kind: Literal["manoeuvre", "stop", "passage"]
    count: int
    role: Role = "none"
    force: Array | None = None  # (count, 3) [N, Nm]
    pieces: Sequence[Piece] = ()  # of a yaw moment, from its first instant
    poses: Array | None = None  # (count, 3) that were planned, followed [m, rad]


@dataclass(frozen=True)
class Gains:
    """Feedback that stops the vessel and follows a passage, by degree of freedom."""

    kp: Annotated[tuple[NotNegative, ...], FromVessel("tuning.pid.kp")]  # [N/m, N/m, Nm/rad]
    kd: Annotated[tuple[NotNegative, ...], FromVessel("tuning.pid.kd")]  # [N s/m, N s/m, Nm s/rad]

    def __post_init__(self) -> None:
        check_ranges(self)


@dataclass(frozen=True, eq=False)
class Schedule:
    """Phases on the instants of one control period, for a vessel in surge, sway and yaw."""

    phases: Sequence[Phase]
    period_s: float

    @property
    def edges(self) -> list[int]:
        """First instant of every phase, and the end."""
        return [0, *np.cumsum([phase.count for phase in self.phases]).tolist()]

    def __len__(self) -> int:
        return self.edges[-1]

    def mask(self, role: Role) -> Mask:
        """Instants of the manoeuvres of a role, shape (N,)."""
        return np.concatenate([np.full(phase.count, phase.role == role) for phase in self.phases])

    def force(self) -> Array:
        """Force of the manoeuvres [N, Nm], shape (N, 3)."""
        return np.concatenate(
            [np.zeros((p.count, 3)) if p.force is None else p.force for p in self.phases]
        )

    def steering(self, gains: Gains, limits: Array) -> Steering:
        """Parameters and initial state of the compiled step; `limits` [N, Nm] of the feedback."""
        poses, velocities = np.zeros((2, len(self), 3))
        pieces: list[Piece] = []
        for phase, first in zip(self.phases, self.edges, strict=False):
            end, acts = first + phase.count, phase.kind == "manoeuvre"
            own = list(phase.pieces) or [Piece(law=commands.HOLD if acts else commands.STOP)]
            if phase.poses is not None:
                poses[first:end] = phase.poses
                velocities[first:end] = commands.body_velocities(phase.poses, self.period_s)
                own = [Piece(law=commands.FOLLOW)]
            pieces += [piece._replace(until=min(first + piece.until, end)) for piece in own]
        pieces[-1] = pieces[-1]._replace(until=commands.NEVER)
        feedback = commands.Feedback(np.array(gains.kp), np.array(gains.kd), -limits, limits)
        return commands.command(pieces, np.zeros(3), 2, 2, feedback, poses, velocities)
