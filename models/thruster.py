"""Thrusters: the lag between the commanded and the acting force."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from models.basis import Array
from models.compiled import kernel, lean_kernel
from models.errors import ConfigurationError


class LagTable(NamedTuple):
    """Exact step of the lag: x <- a x + b command, x = (force, rate) of each axis.

    `direct` means no lag: the force follows the command at once.
    """

    a: Array  # (2, 2)
    b: Array  # (2,)
    direct: bool


@dataclass(frozen=True)
class SecondOrderLag:
    """tau / tau_c = omega_n^2 / (s^2 + 2 zeta omega_n s + omega_n^2). Jervan (2020), eq. (4.3)."""

    natural_frequency_rad_s: float
    damping: float

    def __post_init__(self) -> None:
        for name in ("natural_frequency_rad_s", "damping"):
            if not getattr(self, name) > 0.0:
                raise ConfigurationError(f"{name} must be positive, got {getattr(self, name)}")

    def table(self, step_s: float) -> LagTable:
        """Zero-order-hold discretisation for a step [s]: exact while the command is held."""
        w, d = self.natural_frequency_rad_s, self.damping
        block = np.zeros((3, 3))
        block[:2, :2] = [[0.0, 1.0], [-w * w, -2.0 * d * w]]
        block[1, 2] = w * w
        exact = expm(block * step_s)
        return LagTable(np.ascontiguousarray(exact[:2, :2]), exact[:2, 2].copy(), False)


def no_lag() -> LagTable:
    """The table of a thruster that follows its command at once."""
    return LagTable(np.zeros((2, 2)), np.array([1.0, 0.0]), True)


def lag_table(thruster: SecondOrderLag | None, step_s: float) -> LagTable:
    """The table of a thruster, or of none, for a step [s]."""
    return no_lag() if thruster is None else thruster.table(step_s)


def step_lag(lag: LagTable, state: Array, command: Array) -> None:
    """Advance every axis by one step; state (n_dof, 2) is (force, rate), command (n_dof,)."""
    for i in range(state.shape[0]):
        force, rate = state[i, 0], state[i, 1]
        state[i, 0] = lag.a[0, 0] * force + lag.a[0, 1] * rate + lag.b[0] * command[i]
        state[i, 1] = lag.a[1, 0] * force + lag.a[1, 1] * rate + lag.b[1] * command[i]


step_lag_kernel = lean_kernel(step_lag)


@kernel
def _filter(lag: LagTable, commands: Array, forces: Array) -> None:
    state = np.zeros((commands.shape[1], 2))
    for k in range(commands.shape[0]):
        for i in range(commands.shape[1]):
            forces[k, i] = state[i, 0]
        step_lag_kernel(lag, state, commands[k])


def acting_force(thruster: SecondOrderLag | None, commands: Array, period_s: float) -> Array:
    """Force that acts at each sample, just before its new command; shape (N, n_dof), zero start.

    Each command [N, Nm] is held for one period, so the filter is exact.
    """
    forces = np.empty_like(commands)
    _filter(lag_table(thruster, period_s), np.ascontiguousarray(commands), forces)
    return forces
