"""What stands in for a controller while a vessel is excited: nothing, or the law of a zig-zag."""

from typing import NamedTuple

import numpy as np

from models.basis import Array
from models.compiled import lean_kernel
from models.simulation import CONTROLLERS


class OpenLoop(NamedTuple):
    """No controller."""

    force: float = 0.0


@lean_kernel
def _let_go(
    table: OpenLoop, state: Array, eta: Array, nu: Array, eta_d: Array, nu_d: Array,
    nu_dot_d: Array, tau: Array, tau_fb: Array,
) -> None:  # fmt: skip
    for i in range(tau.shape[0]):
        tau[i] = tau_fb[i] = table.force


CONTROLLERS[OpenLoop] = _let_go


def open_loop() -> tuple[OpenLoop, Array]:
    """Parameters and initial state of the compiled step."""
    return OpenLoop(), np.zeros(1)


class ZigZagTable(NamedTuple):
    """A moment that changes sign when the heading has turned far enough; SI units, radians."""

    yaw: int  # the degree of freedom
    moment: float
    turn: float
    first: int  # instant of the first steering


@lean_kernel
def _zigzag(
    table: ZigZagTable, state: Array, eta: Array, nu: Array, eta_d: Array, nu_d: Array,
    nu_dot_d: Array, tau: Array, tau_fb: Array,
) -> None:  # fmt: skip
    """state = (instant, sign of the moment, heading before the first steering)."""
    for i in range(tau.shape[0]):
        tau[i] = tau_fb[i] = 0.0
    if state[0] <= table.first:
        state[2] = eta[table.yaw]
    if state[0] >= table.first:
        if state[1] * (eta[table.yaw] - state[2]) >= table.turn:
            state[1] = -state[1]
        tau[table.yaw] = state[1] * table.moment
    state[0] += 1.0


CONTROLLERS[ZigZagTable] = _zigzag


def zigzag(yaw: int, moment: float, turn: float, first: int) -> tuple[ZigZagTable, Array]:
    """Parameters and initial state of the compiled step; steers to starboard first."""
    return ZigZagTable(yaw, moment, turn, first), np.array([0.0, 1.0, 0.0])
