"""Commands over time, in pieces: what is ordered, until when, and what follows.

A piece ends at an instant, or when the heading has changed by an angle from what it was when the
last piece ended at an instant. It holds an order of one input or force, or steers by feedback:

    heading    base + kp (psi_0 + order - psi) - kd r            psi_0 + order: the course wanted
    rate       kd (order - r) + ki integral of (order - r)       r: the yaw rate
    stop       -Kd nu
    follow     R(psi)' Kp (eta_d - eta) - Kd (nu - nu_d)         eta_d: planned poses
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from seatrial.models.compiled import lean_kernel
from seatrial.models.simulation.registry import CONTROLLERS, Parameters, State
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import in_body, wrap_kernel

Steering = tuple[Parameters, State]  # of a step in the controller's place
HOLD, HEADING, RATE, STOP, FOLLOW = range(5)
NEVER = 2**62
NO_POSES = np.zeros((0, 3))


class Piece(NamedTuple):
    """A piece of a command; SI units, radians."""

    order: float = 0.0
    law: int = HOLD
    until: int = NEVER  # first instant after it
    after: int = 1  # pieces on to the one that follows then
    turned: float = np.inf  # change of heading that ends it
    side: float = 1.0  # of that change: 1 to starboard, -1 to port, 0 to either side
    then: int = 1  # pieces on to the one that follows then


class Feedback(NamedTuple):
    """Gains of the feedback in pieces, and the limits of its orders, each (n,)."""

    kp: Array
    kd: Array
    low: Array
    high: Array
    ki: float = 0.0  # over an instant


NO_FEEDBACK = Feedback(np.zeros(0), np.zeros(0), np.zeros(0), np.zeros(0))


class Command(NamedTuple):
    """The pieces and what they act on."""

    base: Array  # (n_commands,) beside the order
    channel: int  # of the order
    yaw: int  # the degree of freedom
    feedback: Feedback
    poses: Array  # (N, 3) planned ones, by instant [m, rad]
    velocities: Array  # (N, 3) of them, in body axes
    pieces: Any  # a Piece whose fields are columns (P,)


@lean_kernel
def _give_command(
    table: Command, state: Array, eta: Array, nu: Array, eta_d: Array, nu_d: Array,
    nu_dot_d: Array, tau: Array, tau_fb: Array,
) -> None:  # fmt: skip
    """Write the command of the piece of this instant; what feedback orders counts as such.

    state = (instant, piece, heading before it, integral)
    """
    k, p, heading = int(state[0]), int(state[1]), eta[table.yaw]
    pieces, gains = table.pieces, table.feedback
    if k == 0:
        state[2] = heading
    while k >= pieces.until[p]:
        p += pieces.after[p]
        state[2] = heading
    change, side = heading - state[2], pieces.side[p]
    if (side * change if side != 0.0 else abs(change)) >= pieces.turned[p]:
        p += pieces.then[p]
    state[0], state[1] = k + 1.0, p
    order, law = pieces.order[p], pieces.law[p]
    for i in range(tau.shape[0]):
        tau[i], tau_fb[i] = table.base[i], 0.0
    if law >= STOP:
        _follow_poses(table, k, eta, nu, tau, law == FOLLOW)
        for i in range(tau.shape[0]):
            tau_fb[i] = tau[i]
        return
    if law == HEADING:
        order = gains.kp[0] * wrap_kernel(state[2] + order - heading) - gains.kd[0] * nu[table.yaw]
        order += table.base[table.channel]
        order = min(max(order, gains.low[0]), gains.high[0])
    elif law == RATE:
        error = order - nu[table.yaw]
        wanted = gains.kd[0] * error + state[3]
        order = min(max(wanted, gains.low[0]), gains.high[0])
        if order == wanted:  # otherwise the integral would wind up
            state[3] += gains.ki * error
    tau[table.channel] = order
    if law != HOLD:
        tau_fb[table.channel] = order


@lean_kernel
def _follow_poses(table: Command, k: int, eta: Array, nu: Array, tau: Array, follow: bool) -> None:
    """Feedback of the pose and the velocity in surge, sway and yaw, within the limits."""
    gains, north, east, turn = table.feedback, 0.0, 0.0, 0.0
    c, s = np.cos(eta[2]), np.sin(eta[2])
    if follow:
        north, east = table.poses[k, 0] - eta[0], table.poses[k, 1] - eta[1]
        turn = wrap_kernel(table.poses[k, 2] - eta[2])
    tau[0], tau[1], tau[2] = c * north + s * east, -s * north + c * east, turn
    for i in range(3):
        wanted = gains.kp[i] * tau[i] - gains.kd[i] * (nu[i] - table.velocities[k, i])
        tau[i] = min(max(wanted, gains.low[i]), gains.high[i])


CONTROLLERS[Command] = _give_command


def command(
    pieces: Sequence[Piece], base: Array, channel: int, yaw: int,
    feedback: Feedback = NO_FEEDBACK, poses: Array = NO_POSES, velocities: Array = NO_POSES,
) -> Steering:  # fmt: skip
    """Parameters and initial state of the compiled step; the last piece lasts."""
    columns: Any = (np.array(column) for column in zip(*pieces, strict=True))
    table = Command(base, channel, yaw, feedback, poses, velocities, Piece(*columns))
    return table, np.zeros(4)


def zigzag(
    order: float, turn: float, side: float, until: int = NEVER, about: float = 0.0
) -> tuple[Piece, Piece]:
    """An order to both sides of another whenever the heading has deviated by `turn`."""
    return (
        Piece(order, until=until, after=2, turned=turn, side=side),
        Piece(2.0 * about - order, until=until, turned=turn, side=-side, then=-1),
    )


def body_velocities(poses: Array, period_s: float) -> Array:
    """Velocity in body axes [m/s, rad/s] of sampled poses (N, 3), by differences, (N, 3)."""
    if len(poses) < 2:
        return np.zeros_like(poses)
    rate = np.gradient(poses, period_s, axis=0)
    rate[:, :2] = in_body(rate[:, :2], poses[:, 2])
    return rate
