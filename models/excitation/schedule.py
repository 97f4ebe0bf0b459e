"""A sequence of manoeuvres; the vessel is brought to rest between them.

A part is an interval of control instants: a manoeuvre with its own force, a stop by velocity
feedback, or a passage. Planned poses are followed by feedback; the force of a manoeuvre and its
stop is then the force of the simulation that was used for planning.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

import numpy as np

from seatrial.models.compiled import lean_kernel
from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.missions import Beside, Mission, OpenLoop, counter_steer
from seatrial.models.ranges import NotNegative, check_ranges
from seatrial.models.recording.recording import Mask
from seatrial.models.simulation.registry import CONTROLLERS
from seatrial.models.vessel.basis import Array, Codes
from seatrial.models.vessel.kinematics import in_body, wrap_kernel
from seatrial.models.vessel.tuning import FromVessel

OPEN, ZIGZAG, STOP, FOLLOW = 0, 1, 2, 3
Kind = Literal["manoeuvre", "stop", "passage"]
Role = Literal["training", "testing", "none"]


@dataclass(frozen=True, eq=False)
class Interval:
    """An interval of `count` control instants."""

    name: str
    kind: Kind
    count: int
    role: Role = "none"
    poses: Array | None = None  # (count, n_dof) that were planned, followed [m, rad]
    force: Array | None = None  # (count, n_dof) that was planned [N, Nm], where poses are followed


class SequenceTable(NamedTuple):
    """The control mode and its values at every control instant; SI units, radians."""

    mode: Codes  # (N,)
    moment: Array  # (N,) of a zig-zag
    turn: Array  # (N,) at which it changes sign
    poses: Array  # (N, n_dof) that are followed
    velocities: Array  # (N, n_dof) with which
    kp: Array  # (n_dof,)
    kd: Array
    limits: Array  # of the feedback
    yaw: int


@lean_kernel
def _feedback(
    table: SequenceTable, k: int, eta: Array, nu: Array, tau: Array, follow: bool
) -> None:
    """tau = R(psi)' Kp e - Kd (nu - nu_d) within the limits, e the error of the pose."""
    c, s = np.cos(eta[2]), np.sin(eta[2])
    north, east, turn = 0.0, 0.0, 0.0
    if follow:
        north, east = table.poses[k, 0] - eta[0], table.poses[k, 1] - eta[1]
        turn = wrap_kernel(table.poses[k, 2] - eta[2])
    tau[0] = table.kp[0] * (c * north + s * east) - table.kd[0] * (nu[0] - table.velocities[k, 0])
    tau[1] = table.kp[1] * (-s * north + c * east) - table.kd[1] * (nu[1] - table.velocities[k, 1])
    tau[2] = table.kp[2] * turn - table.kd[2] * (nu[2] - table.velocities[k, 2])
    for i in range(3):
        tau[i] = min(max(tau[i], -table.limits[i]), table.limits[i])


@lean_kernel
def _sequence(
    table: SequenceTable, state: Array, eta: Array, nu: Array, eta_d: Array, nu_d: Array,
    nu_dot_d: Array, tau: Array, tau_fb: Array,
) -> None:  # fmt: skip
    """state = (instant, sign of a zig-zag's moment, heading before it, whether it has begun)."""
    k = int(state[0])
    mode = table.mode[k]
    for i in range(tau.shape[0]):
        tau[i] = tau_fb[i] = 0.0
    if mode == ZIGZAG:
        if state[3] == 0.0:
            state[1], state[2], state[3] = 1.0, eta[table.yaw], 1.0
        tau[table.yaw] = counter_steer(state, eta[table.yaw], table.moment[k], table.turn[k])
    else:
        state[3] = 0.0
    if mode >= STOP:
        _feedback(table, k, eta, nu, tau, mode == FOLLOW)
        for i in range(tau.shape[0]):
            tau_fb[i] = tau[i]
    state[0] = k + 1.0


CONTROLLERS[SequenceTable] = _sequence


@dataclass(frozen=True)
class Gains:
    """Feedback that stops the vessel and follows a passage, by degree of freedom."""

    kp: Annotated[tuple[NotNegative, ...], FromVessel("tuning.pid.kp")]  # [N/m, N/m, Nm/rad]
    kd: Annotated[tuple[NotNegative, ...], FromVessel("tuning.pid.kd")]  # [N s/m, N s/m, Nm s/rad]

    def __post_init__(self) -> None:
        check_ranges(self)


@dataclass(frozen=True, eq=False)
class Schedule:
    """Parts on the instants of one control period, for a vessel in surge, sway and yaw."""

    parts: tuple[Interval, ...]
    manoeuvres: dict[str, Mission]
    dofs: tuple[str, ...]
    period_s: float

    @property
    def edges(self) -> list[int]:
        """First instant of every part, and the end."""
        return [0, *np.cumsum([part.count for part in self.parts]).tolist()]

    def __len__(self) -> int:
        return self.edges[-1]

    def mask(self, role: Role) -> Mask:
        """Instants of the manoeuvres of a role, shape (N,)."""
        on = [np.full(part.count, part.role == role) for part in self.parts]
        return np.concatenate(on)

    def force(self) -> Array:
        """Force of the manoeuvres [N, Nm], shape (N, n_dof); repeated calls give equal forces."""
        pieces = []
        for part in self.parts:
            if part.kind != "manoeuvre" or part.force is not None:
                still = np.zeros((part.count, len(self.dofs)))
                pieces.append(still if part.force is None else part.force)
                continue
            t = self.period_s * np.arange(part.count, dtype=np.float64)
            seed = list(self.manoeuvres).index(part.name)
            rng = np.random.default_rng(seed)
            force = self.manoeuvres[part.name].force(t, self.dofs, rng)
            pieces.append(np.zeros((part.count, len(self.dofs))) if force is None else force)
        return np.ascontiguousarray(np.concatenate(pieces))

    def steering(self, gains: Gains, limits: Array) -> tuple[SequenceTable, Array]:
        """Parameters and initial state of the compiled step; `limits` [N, Nm] of the feedback."""
        n = len(self)
        mode, moment, turn = np.zeros(n, dtype=np.int64), np.zeros(n), np.zeros(n)
        poses, velocities = np.zeros((n, len(self.dofs))), np.zeros((n, len(self.dofs)))
        for part, first in zip(self.parts, self.edges, strict=False):
            here = slice(first, first + part.count)
            if part.poses is not None:
                poses[here], mode[here] = part.poses, FOLLOW
                velocities[here] = body_velocities(part.poses, self.period_s)
                continue
            if part.kind != "manoeuvre":
                mode[here] = STOP
                continue
            zigzag = self.manoeuvres[part.name].zigzag(self.dofs, self.period_s)
            if zigzag is not None:
                from_here = slice(first + zigzag.first, first + part.count)
                mode[from_here] = ZIGZAG
                moment[from_here], turn[from_here] = zigzag.moment, zigzag.turn
        table = SequenceTable(
            mode, moment, turn, poses, velocities, np.array(gains.kp), np.array(gains.kd), limits,
            self.dofs.index("yaw"),
        )  # fmt: skip
        return table, np.array([0.0, 1.0, 0.0, 0.0])


def body_velocities(poses: Array, period_s: float) -> Array:
    """Velocity in body axes [m/s, rad/s] of sampled poses (N, 3), by differences, (N, 3)."""
    if len(poses) < 2:
        return np.zeros_like(poses)
    rate = np.gradient(poses, period_s, axis=0)
    rate[:, :2] = in_body(rate[:, :2], poses[:, 2])
    return rate


def check_open(name: str, manoeuvre: Mission, dofs: Sequence[str], period_s: float) -> None:
    """Raise ConfigurationError for a candidate that requires a controller."""
    manoeuvre.check(dofs)
    steered = manoeuvre.steering(dofs, period_s)
    if steered is None or not isinstance(steered[0], OpenLoop | Beside):
        raise ConfigurationError(
            f"excitation.candidates.{name}: is sailed by a controller, expected an open loop"
        )
