"""The step between the force that is asked for and the one that thrusters give.

It is chosen by the type of a named tuple that holds the thrusters' geometry, so that a simulation
compiles the one it needs.
"""

from collections.abc import Callable
from typing import NamedTuple

from numba.extending import overload

from seatrial.models.compiled import LEAN, lean_kernel, tuple_of
from seatrial.models.vessel.basis import Array

ALLOCATIONS: dict[type, Callable[..., None]] = {}


class Direct(NamedTuple):
    """No allocation: every force can be given."""

    share: float = 1.0


@lean_kernel
def _pass_on(table: Direct, tau: Array, applied: Array) -> None:
    for i in range(tau.shape[0]):
        applied[i] = table.share * tau[i]


ALLOCATIONS[Direct] = _pass_on


def allocate_step(table: NamedTuple, tau: Array, applied: Array) -> None:
    """The force [N, Nm] that is given for the force tau that is asked for, both (n_dof,)."""
    ALLOCATIONS[type(table)](table, tau, applied)


@overload(allocate_step, jit_options=LEAN)
def _allocate_step(table: NamedTuple, tau: Array, applied: Array) -> Callable[..., None]:
    step = ALLOCATIONS[tuple_of(table)]

    def chosen(table: NamedTuple, tau: Array, applied: Array) -> None:
        step(table, tau, applied)

    return chosen
