"""What excites a vessel by steering it: nothing, or a zig-zag, alone or beside a controller."""

from typing import Any, NamedTuple

import numpy as np

from seatrial.models.compiled import lean_kernel
from seatrial.models.simulation.registry import CONTROLLERS, control_step
from seatrial.models.vessel.basis import Array


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
def _add_moment(table: ZigZagTable, state: Array, eta: Array, tau: Array) -> None:
    """state = (instant, sign of the moment, heading before the first steering)."""
    if state[0] <= table.first:
        state[2] = eta[table.yaw]
    if state[0] >= table.first:
        if state[1] * (eta[table.yaw] - state[2]) >= table.turn:
            state[1] = -state[1]
        tau[table.yaw] += state[1] * table.moment
    state[0] += 1.0


@lean_kernel
def _zigzag(
    table: ZigZagTable, state: Array, eta: Array, nu: Array, eta_d: Array, nu_d: Array,
    nu_dot_d: Array, tau: Array, tau_fb: Array,
) -> None:  # fmt: skip
    for i in range(tau.shape[0]):
        tau[i] = tau_fb[i] = 0.0
    _add_moment(table, state, eta, tau)


CONTROLLERS[ZigZagTable] = _zigzag


class Beside(NamedTuple):
    """A zig-zag's moment beside a compiled controller; state = (controller's, zig-zag's)."""

    controller: Any
    zigzag: ZigZagTable


class BesidePython(NamedTuple):
    """The same beside a controller that runs in Python."""

    controller: Any
    zigzag: ZigZagTable


def _both(
    table: Any, state: Any, eta: Array, nu: Array, eta_d: Array, nu_d: Array, nu_dot_d: Array,
    tau: Array, tau_fb: Array,
) -> None:  # fmt: skip
    control_step(table.controller, state[0], eta, nu, eta_d, nu_d, nu_dot_d, tau, tau_fb)
    _add_moment(table.zigzag, state[1], eta, tau)


CONTROLLERS[Beside] = lean_kernel(_both)
CONTROLLERS[BesidePython] = _both


def beside(controller: tuple[Any, Any], steered: tuple[ZigZagTable, Array]) -> tuple[Any, Any]:
    """Parameters and state of a controller with the moment of a zig-zag added to its command."""
    (parameters, state), (table, own) = controller, steered
    compiled = hasattr(CONTROLLERS[type(parameters)], "py_func")
    both = Beside if compiled else BesidePython
    return both(parameters, table), (state, own)


def zigzag(yaw: int, moment: float, turn: float, first: int) -> tuple[ZigZagTable, Array]:
    """Parameters and initial state of the compiled step; steers to starboard first."""
    return ZigZagTable(yaw, moment, turn, first), np.array([0.0, 1.0, 0.0])
