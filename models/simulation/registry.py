"""The steps of the closed loop, registered for the type of their parameters.

The loop does not depend on any controller, guidance law or reference model. Each of them registers
its compiled step for its own named tuple of parameters (`CONTROLLERS`, `GUIDANCE`, `REFERENCES`).
The compiled loop calls these steps through an address (`seatrial.models.bound`); it runs in Python
if a step cannot be compiled.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numba import types
from numba.extending import overload

from seatrial.models.bound import ROW, TABLE, Bound, bound, entry, is_lean
from seatrial.models.compiled import LEAN, in_python, kernel, lean_kernel, tuple_of
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import reference_in_body, reference_in_body_kernel

Parameters: TypeAlias = Any  # the named tuple that a step is registered for; compiled by its type
State: TypeAlias = Any  # state of a step: an array, or a named tuple of arrays
CONTROLLERS: dict[type, Callable[..., None]] = {}
GUIDANCE: dict[type, Callable[..., None]] = {}
REFERENCES: dict[type, Callable[..., None]] = {}
NO_STATE = np.zeros(0)


class FilterTable(NamedTuple):
    """Exact step of the reference filter: x <- a x + b r, x = (position, rate, acceleration)."""

    a: Array  # (3, 3)
    b: Array  # (3,)
    axis: int = -1  # the only one that is filtered; -1: all


class Timetable(NamedTuple):
    """Set-points known in advance, one row a control instant, shape (N, n_dof)."""

    setpoints: Array


def control_step(
    parameters: Parameters, state: Array, eta: Array, nu: Array, eta_d: Array, nu_d: Array,
    nu_dot_d: Array, tau: Array, tau_fb: Array,
) -> None:  # fmt: skip
    """One step of the controller registered for the type of `parameters`; writes tau, tau_fb."""
    CONTROLLERS[type(parameters)](parameters, state, eta, nu, eta_d, nu_d, nu_dot_d, tau, tau_fb)


@overload(control_step, jit_options=LEAN)
def _control_step(
    parameters: Parameters, state: State, eta: Array, nu: Array, eta_d: Array, nu_d: Array,
    nu_dot_d: Array, tau: Array, tau_fb: Array,
) -> Callable[..., None]:  # fmt: skip
    step = CONTROLLERS[tuple_of(parameters)]

    def kernel(
        parameters: Parameters, state: State, eta: Array, nu: Array, eta_d: Array, nu_d: Array,
        nu_dot_d: Array, tau: Array, tau_fb: Array,
    ) -> None:  # fmt: skip
        step(parameters, state, eta, nu, eta_d, nu_d, nu_dot_d, tau, tau_fb)

    return kernel


def guide_step(parameters: Parameters, state: Array, k: int, eta: Array, setpoint: Array) -> None:
    """One step of the guidance law registered for the type of `parameters`; writes setpoint."""
    GUIDANCE[type(parameters)](parameters, state, k, eta, setpoint)


@overload(guide_step, jit_options=LEAN)
def _guide_step(
    parameters: Parameters, state: State, k: int, eta: Array, setpoint: Array
) -> Callable[..., None]:
    step = GUIDANCE[tuple_of(parameters)]

    def kernel(parameters: Parameters, state: State, k: int, eta: Array, setpoint: Array) -> None:
        step(parameters, state, k, eta, setpoint)

    return kernel


def reference_step(
    table: Parameters, state: Array, setpoint: Array, planar: bool, eta_d: Array, nu_d: Array,
    nu_dot_d: Array,
) -> None:  # fmt: skip
    """Write the reference in body axes, then advance the model registered for the type of `table`.

    `state` is that of the model, shape (n_dof, 3); `bound` steps do both.
    """
    if isinstance(table, Bound):
        _bound_reference_step(table, state, setpoint, planar, eta_d, nu_d, nu_dot_d)
        return
    reference_in_body(planar, state, eta_d, nu_d, nu_dot_d)
    REFERENCES[type(table)](table, state, setpoint)


@overload(reference_step, jit_options=LEAN, strict=False)  # types in signatures may differ
def _reference_step(table: Parameters, *others: object) -> Callable[..., None]:
    if tuple_of(table) is Bound:
        return in_python(_bound_reference_step)
    step = REFERENCES[tuple_of(table)]

    def kernel(
        table: Parameters, state: State, setpoint: Array, planar: bool, eta_d: Array, nu_d: Array,
        nu_dot_d: Array,
    ) -> None:  # fmt: skip
        reference_in_body_kernel(planar, state, eta_d, nu_d, nu_dot_d)
        step(table, state, setpoint)

    return kernel


_controller, _call_controller = entry(control_step, *[ROW] * 7)
_guidance, _call_guidance = entry(guide_step, types.int64, ROW, ROW)
_reference, _call_reference = entry(reference_step, TABLE, ROW, types.boolean, ROW, ROW, ROW)


@lean_kernel
def _bound_control_step(
    parameters: Bound, state: State, eta: Array, nu: Array, eta_d: Array, nu_d: Array,
    nu_dot_d: Array, tau: Array, tau_fb: Array,
) -> None:  # fmt: skip
    arguments = eta, nu, eta_d, nu_d, nu_dot_d, tau, tau_fb
    _call_controller(parameters.address, parameters.memory, arguments)


@lean_kernel
def _bound_guide_step(parameters: Bound, state: State, k: int, eta: Array, setpoint: Array) -> None:
    _call_guidance(parameters.address, parameters.memory, (k, eta, setpoint))


@lean_kernel
def _bound_reference_step(
    table: Bound, state: Array, setpoint: Array, planar: bool, eta_d: Array, nu_d: Array,
    nu_dot_d: Array,
) -> None:  # fmt: skip
    arguments = state, setpoint, planar, eta_d, nu_d, nu_dot_d
    _call_reference(table.address, table.memory, arguments)


CONTROLLERS[Bound] = _bound_control_step
GUIDANCE[Bound] = _bound_guide_step


@kernel
def _bind_controller(memory: Array, parts: Any) -> int:
    return _controller(memory, parts)  # type: ignore[no-any-return]


@kernel
def _bind_guidance(memory: Array, parts: Any) -> int:
    return _guidance(memory, parts)  # type: ignore[no-any-return]


@kernel
def _bind_reference(memory: Array, parts: Any) -> int:
    return _reference(memory, parts)  # type: ignore[no-any-return]


def bound_controller(parameters: Parameters, state: State) -> tuple[Parameters, State]:
    """What compiled code takes as parameters and state of a controller; see `bound`."""
    if not is_lean(CONTROLLERS[type(parameters)]):
        return parameters, state
    return bound(_bind_controller, parameters, state), NO_STATE


def bound_guidance(
    parameters: Parameters, state: State, table: Parameters
) -> tuple[Parameters, State, Parameters]:
    """What compiled code takes as parameters and state of guidance, and as reference model."""
    if is_lean(GUIDANCE[type(parameters)]):
        parameters, state = bound(_bind_guidance, parameters, state), NO_STATE
    if is_lean(REFERENCES[type(table)]):
        table = bound(_bind_reference, table)
    return parameters, state, table


@lean_kernel
def step_filter(table: FilterTable, state: Array, setpoint: Array) -> None:
    """Advance the reference filter; state (n_dof, 3)."""
    for i in range(state.shape[0]):
        if table.axis >= 0 and i != table.axis:
            state[i, 0], state[i, 1], state[i, 2] = setpoint[i], 0.0, 0.0
            continue
        x0, x1, x2 = state[i, 0], state[i, 1], state[i, 2]
        for j in range(3):
            a = table.a[j]
            state[i, j] = a[0] * x0 + a[1] * x1 + a[2] * x2 + table.b[j] * setpoint[i]


REFERENCES[FilterTable] = step_filter


@lean_kernel
def _follow_timetable(table: Timetable, state: Array, k: int, eta: Array, setpoint: Array) -> None:
    for i in range(setpoint.shape[0]):
        setpoint[i] = table.setpoints[k, i]


GUIDANCE[Timetable] = _follow_timetable
