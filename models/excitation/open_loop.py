"""Steps in place of a controller: an open loop, and a zig-zag, alone or with a controller."""

from typing import NamedTuple

import numpy as np

from seatrial.models.compiled import is_compiled, lean_kernel
from seatrial.models.simulation.registry import CONTROLLERS, Parameters, State, control_step
from seatrial.models.vessel.basis import Array

Steering = tuple[Parameters, State]  # of a step in the controller's place


class OpenLoop(NamedTuple):
    """No controller."""

    force: float = 0.0


@lean_kernel
def _open_loop_step(
    table: OpenLoop, state: Array, eta: Array, nu: Array, eta_d: Array, nu_d: Array,
    nu_dot_d: Array, tau: Array, tau_fb: Array,
) -> None:  # fmt: skip
    for i in range(tau.shape[0]):
        tau[i] = tau_fb[i] = table.force


CONTROLLERS[OpenLoop] = _open_loop_step


def open_loop() -> Steering:
    """Parameters and initial state of the compiled step."""
    return OpenLoop(), np.zeros(1)


class ZigZag(NamedTuple):
    """A moment that changes sign when the heading deviates by an angle; SI units, radians."""

    yaw: int  # the degree of freedom
    moment: float
    turn: float
    first: int  # instant of the first steering


@lean_kernel
def counter_steer(state: Array, heading: float, moment: float, turn: float) -> float:
    """The moment of a zig-zag; state[1] is its sign, state[2] the heading before it began."""
    if state[1] * (heading - state[2]) >= turn:
        state[1] = -state[1]
    return float(state[1]) * moment


@lean_kernel
def _add_moment(zigzag: ZigZag, state: Array, eta: Array, tau: Array) -> None:
    """state = (instant, sign of the moment, heading before the first steering)."""
    if state[0] <= zigzag.first:
        state[2] = eta[zigzag.yaw]
    if state[0] >= zigzag.first:
        tau[zigzag.yaw] += counter_steer(state, eta[zigzag.yaw], zigzag.moment, zigzag.turn)
    state[0] += 1.0


class Beside(NamedTuple):
    """The moment of a zig-zag with a compiled controller; state = (controller's, zig-zag's)."""

    controller: Parameters
    zigzag: ZigZag


class BesidePython(NamedTuple):
    """The moment of a zig-zag with a controller that runs in Python."""

    controller: Parameters
    zigzag: ZigZag


def _both(
    table: Beside | BesidePython, state: State, eta: Array, nu: Array, eta_d: Array, nu_d: Array,
    nu_dot_d: Array, tau: Array, tau_fb: Array,
) -> None:  # fmt: skip
    control_step(table.controller, state[0], eta, nu, eta_d, nu_d, nu_dot_d, tau, tau_fb)
    _add_moment(table.zigzag, state[1], eta, tau)


CONTROLLERS[Beside] = lean_kernel(_both)
CONTROLLERS[BesidePython] = _both


def beside(controller: Steering, zigzag: ZigZag) -> Steering:
    """Parameters and state of a controller with the moment of a zig-zag added to its command.

    The first turn is to starboard.
    """
    parameters, state = controller
    both = Beside if is_compiled(CONTROLLERS[type(parameters)]) else BesidePython
    return both(parameters, zigzag), (state, np.array([0.0, 1.0, 0.0]))
