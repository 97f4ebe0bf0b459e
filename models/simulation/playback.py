"""A vessel that is left to given forces: no controller, no guidance, no reference."""

from typing import NamedTuple

from seatrial.models.compiled import lean_kernel
from seatrial.models.simulation.registry import CONTROLLERS, GUIDANCE, REFERENCES
from seatrial.models.vessel.basis import Array


class Playback(NamedTuple):
    """Forces [N, Nm] that are applied one after the other, shape (N, n_dof)."""

    forces: Array


class Adrift(NamedTuple):
    """Guidance and reference of an uncontrolled vessel."""

    gain: float = 0.0


@lean_kernel
def _apply_given_force(
    table: Playback, state: Array, eta: Array, nu: Array, eta_d: Array, nu_d: Array,
    nu_dot_d: Array, tau: Array, tau_fb: Array,
) -> None:  # fmt: skip
    """Apply the next force; state (1,) is the number of forces applied."""
    k = int(state[0])
    for i in range(tau.shape[0]):
        tau[i], tau_fb[i] = table.forces[k, i], 0.0
    state[0] = k + 1.0


@lean_kernel
def _constant_setpoint(table: Adrift, state: Array, k: int, eta: Array, setpoint: Array) -> None:
    for i in range(setpoint.shape[0]):
        setpoint[i] = table.gain


@lean_kernel
def _hold_setpoint(table: Adrift, state: Array, setpoint: Array) -> None:
    for i in range(state.shape[0]):
        state[i, 0] = setpoint[i]


CONTROLLERS[Playback] = _apply_given_force
GUIDANCE[Adrift] = _constant_setpoint
REFERENCES[Adrift] = _hold_setpoint
