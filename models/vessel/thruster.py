"""Thruster dynamics: the lag between the commanded and the acting force, and the limits."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from seatrial.models.compiled import kernel, lean_kernel
from seatrial.models.errors import ConfigurationError
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.vessel.basis import Array

PARTS = 8  # steps per period with which a limited lag is filtered


class LagTable(NamedTuple):
    """Exact step of the lag: x <- a x + b command, x = (force, rate) of each axis.

    `direct` means no lag: the force follows the command immediately. If `limited`, the force stays
    within +-amplitude and changes by at most `change` per step.
    """

    a: Array  # (2, 2)
    b: Array  # (2,)
    direct: bool
    limited: bool
    amplitude: Array  # (n_dof,) [N, Nm]; empty if it is not limited
    change: Array  # (n_dof,) [N, Nm]
    step_s: float


@dataclass(frozen=True)
class SecondOrderLag:
    """tau / tau_c = omega_n^2 / (s^2 + 2 zeta omega_n s + omega_n^2). Jervan (2020), eq. (4.3).

    The force of each degree of freedom can be limited in size [N, Nm] and rate [N/s, Nm/s].
    """

    natural_frequency_rad_s: Positive
    damping: Positive
    amplitude_limit: tuple[Positive, ...] | None = None
    rate_limit: tuple[Positive, ...] | None = None

    def __post_init__(self) -> None:
        check_ranges(self)

    @property
    def limited(self) -> bool:
        """Whether the force is limited; the lag is then nonlinear."""
        return self.amplitude_limit is not None or self.rate_limit is not None

    @property
    def delay_s(self) -> float:
        """Delay of the force for a slowly varying command: 2 zeta / omega_n [s]."""
        return 2.0 * self.damping / self.natural_frequency_rad_s

    def check(self, dofs: Sequence[str]) -> None:
        """Raise ConfigurationError unless there is one limit per degree of freedom."""
        for name in ("amplitude_limit", "rate_limit"):
            limits = getattr(self, name)
            if limits is not None and len(limits) != len(dofs):
                raise ConfigurationError(
                    f"thruster.{name}: got {len(limits)} numbers, expected {len(dofs)} "
                    f"for {', '.join(dofs)}"
                )

    def table(self, step_s: float) -> LagTable:
        """Zero-order-hold discretisation for a step [s], exact for a piecewise constant command."""
        w, d = self.natural_frequency_rad_s, self.damping
        block = np.zeros((3, 3))
        block[:2, :2] = [[0.0, 1.0], [-w * w, -2.0 * d * w]]
        block[1, 2] = w * w
        exact = expm(block * step_s)
        return self._limits(np.ascontiguousarray(exact[:2, :2]), exact[:2, 2].copy(), step_s)

    def _limits(self, a: Array, b: Array, step_s: float) -> LagTable:
        """The table with the limits; a limit that is not configured is infinite."""
        if not self.limited:
            return LagTable(a, b, False, False, np.zeros(0), np.zeros(0), step_s)
        n = len(self.amplitude_limit or self.rate_limit or ())
        amplitude = np.array(self.amplitude_limit or (np.inf,) * n)
        change = step_s * np.array(self.rate_limit or (np.inf,) * n)
        return LagTable(a, b, False, True, amplitude, change, step_s)


@dataclass(frozen=True)
class FirstOrderLag(SecondOrderLag):
    """tau / tau_c = 1 / (T s + 1): a second-order lag whose other pole is infinitely fast."""

    natural_frequency_rad_s: float = field(init=False, default=np.inf)
    damping: float = field(init=False, default=np.inf)
    time_constant_s: Positive = field(kw_only=True)

    @property
    def delay_s(self) -> float:
        """Delay of the force for a slowly varying command: T [s]."""
        return self.time_constant_s

    def table(self, step_s: float) -> LagTable:
        """Zero-order-hold discretisation for a step [s]; the rate of the force is not a state."""
        decay = float(np.exp(-step_s / self.time_constant_s))
        a = np.array([[decay, 0.0], [0.0, 0.0]])
        return self._limits(a, np.array([1.0 - decay, 0.0]), step_s)


def no_lag() -> LagTable:
    """The table of a thruster that follows its command immediately."""
    empty = np.zeros(0)
    return LagTable(np.zeros((2, 2)), np.array([1.0, 0.0]), True, False, empty, empty, 0.0)


def lag_table(thruster: SecondOrderLag | None, step_s: float) -> LagTable:
    """The table of a thruster for a step [s]; None means no lag."""
    return no_lag() if thruster is None else thruster.table(step_s)


def step_lag(lag: LagTable, state: Array, command: Array) -> None:
    """Advance every axis by one step; state (n_dof, 2) is (force, rate), command (n_dof,)."""
    for i in range(state.shape[0]):
        force, rate = state[i, 0], state[i, 1]
        target = command[i]
        if lag.limited:
            target = min(max(target, -lag.amplitude[i]), lag.amplitude[i])
        state[i, 0] = lag.a[0, 0] * force + lag.a[0, 1] * rate + lag.b[0] * target
        state[i, 1] = lag.a[1, 0] * force + lag.a[1, 1] * rate + lag.b[1] * target
        if lag.limited:
            limit_force_kernel(lag, i, force, state)


def limit_force(lag: LagTable, i: int, before: float, state: Array) -> None:
    """Limit the force of axis i and its change over a step; the rate follows from the change."""
    force = state[i, 0]
    if abs(force - before) > lag.change[i] or abs(force) > lag.amplitude[i]:
        change = min(max(force - before, -lag.change[i]), lag.change[i])
        state[i, 0] = min(max(before + change, -lag.amplitude[i]), lag.amplitude[i])
        state[i, 1] = (state[i, 0] - before) / lag.step_s


limit_force_kernel = lean_kernel(limit_force)
step_lag_kernel = lean_kernel(step_lag)


@kernel
def _filter(lag: LagTable, commands: Array, forces: Array) -> None:
    state = np.zeros((commands.shape[1], 2))
    for k in range(commands.shape[0]):
        for i in range(commands.shape[1]):
            forces[k, i] = state[i, 0]
        step_lag_kernel(lag, state, commands[k])


def acting_force(thruster: SecondOrderLag | None, commands: Array, period_s: float) -> Array:
    """Acting force [N, Nm] at each sample, just before the new command; shape (N, n_dof).

    The force is zero at the start. Each command [N, Nm], shape (N, n_dof), is held for one period
    [s], so the filter is exact; for a limited thruster it takes `PARTS` steps per period.
    """
    parts = PARTS if thruster is not None and thruster.limited else 1
    held = np.ascontiguousarray(np.repeat(commands, parts, axis=0))
    forces = np.empty_like(held)
    _filter(lag_table(thruster, period_s / parts), held, forces)
    return forces[::parts]
