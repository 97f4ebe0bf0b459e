"""Lag and limits between a command and what acts: forces of thrusters, or inputs of a ship."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from seatrial.models.compiled import kernel, lean_kernel
from seatrial.models.errors import ConfigurationError
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.vessel.basis import Array

Flags = NDArray[np.bool_]

PARTS = 8  # steps per period with which a limited lag is filtered


class LagTable(NamedTuple):
    """Exact step of the lag: x <- a x + b command, x = (value, rate) of each of n axes.

    A value is a force [N, Nm] or an input. On an axis that is `direct` it follows the command
    immediately. If `limited`, it stays between `low` and `high` and changes by at most `change` per
    step.
    """

    a: Array  # (n, 2, 2)
    b: Array  # (n, 2)
    direct: Flags  # (n,)
    limited: bool
    low: Array  # (n,)
    high: Array  # (n,)
    change: Array  # (n,)
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

    def exact(self, step_s: float) -> tuple[Array, Array]:
        """Matrices a (2, 2), b (2,) of a step [s], exact for a piecewise constant command."""
        exact = _exact(self.natural_frequency_rad_s, self.damping, step_s)
        return exact[:2, :2].copy(), exact[:2, 2].copy()

    def table(self, step_s: float, n: int) -> LagTable:
        """The lag of n axes for a step [s]; a limit that is not configured is infinite."""
        a, b = self.exact(step_s)
        amplitude = np.array(self.amplitude_limit or (np.inf,) * n)
        change = step_s * np.array(self.rate_limit or (np.inf,) * n)
        return LagTable(
            np.tile(a, (n, 1, 1)), np.tile(b, (n, 1)), np.zeros(n, dtype=np.bool_), self.limited,
            -amplitude, amplitude, change, step_s,
        )  # fmt: skip


@lru_cache(maxsize=64)
def _exact(w: float, d: float, step_s: float) -> Array:
    """Force, its rate and the command, (3, 3), after a step [s] of a second-order lag."""
    block = np.zeros((3, 3))
    block[:2, :2] = [[0.0, 1.0], [-w * w, -2.0 * d * w]]
    block[1, 2] = w * w
    return np.asarray(scipy.linalg.expm(block * step_s))


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

    def exact(self, step_s: float) -> tuple[Array, Array]:
        """Matrices of a step [s]; the rate of the force is not a state."""
        decay = float(np.exp(-step_s / self.time_constant_s))
        return np.array([[decay, 0.0], [0.0, 0.0]]), np.array([1.0 - decay, 0.0])


def no_lag(n: int) -> LagTable:
    """The table of n thrusters that follow their command immediately."""
    infinite, b = np.full(n, np.inf), np.tile([1.0, 0.0], (n, 1))
    direct = np.ones(n, dtype=np.bool_)
    return LagTable(np.zeros((n, 2, 2)), b, direct, False, -infinite, infinite, infinite, 0.0)


def lag_table(thruster: SecondOrderLag | None, step_s: float, n: int) -> LagTable:
    """The table of the thrusters of n axes for a step [s]; None means no lag."""
    return no_lag(n) if thruster is None else thruster.table(step_s, n)


@dataclass(frozen=True)
class Input:
    """An input of a vessel: what is commanded, such as a rudder angle or a shaft speed.

    It lies between `low` and `high`, changes by at most `rate_limit` in a second and follows its
    command as a first-order lag; null: immediately. `start` is its value before the first command.
    """

    low: float
    high: float
    rate_limit: Positive | None = None
    time_constant_s: Positive | None = None
    start: float = 0.0

    @property
    def immediate(self) -> bool:
        """Whether it follows its command at once."""
        return self.rate_limit is None and self.time_constant_s is None

    def __post_init__(self) -> None:
        check_ranges(self)
        if not self.low <= self.start <= self.high or self.low == self.high:
            raise ConfigurationError(
                f"start: got {self.start:g}, expected a number from low = {self.low:g} to "
                f"high = {self.high:g}"
            )


def input_lag(inputs: Sequence[Input], step_s: float) -> LagTable:
    """The lag and the limits of inputs for a step [s]."""
    table = no_lag(len(inputs))
    rates = np.array([np.inf if i.rate_limit is None else i.rate_limit for i in inputs])
    table.direct[:] = [i.immediate for i in inputs]
    for k, of_input in enumerate(inputs):
        if of_input.time_constant_s is not None:
            lag = FirstOrderLag(time_constant_s=of_input.time_constant_s)
            table.a[k], table.b[k] = lag.exact(step_s)
    low, high = np.array([(i.low, i.high) for i in inputs]).reshape(-1, 2).T.copy()
    return table._replace(limited=True, low=low, high=high, change=step_s * rates, step_s=step_s)


def step_lag(lag: LagTable, state: Array, command: Array) -> None:
    """Advance every axis by one step; state (n, 2) is (value, rate), command (n,)."""
    for i in range(state.shape[0]):
        force, rate = state[i, 0], state[i, 1]
        target = command[i]
        if lag.limited:
            target = min(max(target, lag.low[i]), lag.high[i])
        state[i, 0] = lag.a[i, 0, 0] * force + lag.a[i, 0, 1] * rate + lag.b[i, 0] * target
        state[i, 1] = lag.a[i, 1, 0] * force + lag.a[i, 1, 1] * rate + lag.b[i, 1] * target
        if lag.limited:
            limit_force_kernel(lag, i, force, state)


def step_direct(lag: LagTable, state: Array, command: Array) -> None:
    """Set the axes that follow their command immediately."""
    for i in range(state.shape[0]):
        if lag.direct[i]:
            state[i, 0] = min(max(command[i], lag.low[i]), lag.high[i])


def limit_force(lag: LagTable, i: int, before: float, state: Array) -> None:
    """Limit the value of axis i and its change over a step; the rate follows from the change."""
    force = state[i, 0]
    outside = force < lag.low[i] or force > lag.high[i]
    if outside or abs(force - before) > lag.change[i]:
        change = min(max(force - before, -lag.change[i]), lag.change[i])
        state[i, 0] = min(max(before + change, lag.low[i]), lag.high[i])
        state[i, 1] = (state[i, 0] - before) / lag.step_s


limit_force_kernel = lean_kernel(limit_force)
step_lag_kernel = lean_kernel(step_lag)
step_direct_kernel = lean_kernel(step_direct)


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
    _filter(lag_table(thruster, period_s / parts, commands.shape[1]), held, forces)
    return forces[::parts]
