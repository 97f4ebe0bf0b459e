"""Commands of an input that are known in advance: spiral, crash stop, and a binary sequence."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

import numpy as np
from annotated_types import Ge

from seatrial.models.compiled import lean_kernel
from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.helm import SteeredMission
from seatrial.models.excitation.open_loop import Steering
from seatrial.models.ranges import Positive
from seatrial.models.simulation.registry import CONTROLLERS
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.tuning import FromVessel

LONGEST_REGISTER = 20


class Commands(NamedTuple):
    """Commands of all inputs, one row an instant, shape (N, n_inputs); the last row is held."""

    rows: Array


@lean_kernel
def _follow(
    commands: Commands, state: Array, eta: Array, nu: Array, eta_d: Array, nu_d: Array,
    nu_dot_d: Array, tau: Array, tau_fb: Array,
) -> None:  # fmt: skip
    """state = (instant,)."""
    k = min(int(state[0]), commands.rows.shape[0] - 1)
    for i in range(tau.shape[0]):
        tau[i] = tau_fb[i] = commands.rows[k, i]
    state[0] += 1.0


CONTROLLERS[Commands] = _follow


@dataclass(frozen=True, kw_only=True)
class ScheduledInput(SteeredMission):
    """Values of the input `helm` in turn, each held for `hold_lengths` L / U of the approach.

    `spiral` and `stop` hold `values`; the last value is held to the end. `prbs` is a maximum
    length sequence of a shift register of `bits` that alternates between the first two values.
    Values are in degrees, or with `unit: start` relative to the input at the start, or with
    `unit: range` shares of the way from there to the limits: 1 the upper one, -1 the lower one.
    """

    manoeuvre: Literal["spiral", "stop", "prbs"]
    values: tuple[float, ...]
    unit: Literal["deg", "start", "range"] = "deg"
    hold_lengths: Positive
    end_lengths: float = 0.0  # beside the values
    bits: Annotated[int, Ge(2)] = 7
    length_m: Annotated[Positive, FromVessel("scales.length_m")]
    input_low: Annotated[tuple[float, ...], FromVessel("input_low")]
    input_high: Annotated[tuple[float, ...], FromVessel("input_high")]

    def __post_init__(self) -> None:
        if not self.values or (self.manoeuvre == "prbs" and len(self.values) != 2):
            raise ConfigurationError(
                f"values: got {len(self.values)}, expected "
                f"{'two' if self.manoeuvre == 'prbs' else 'at least one'}"
            )
        if self.bits > LONGEST_REGISTER:
            raise ConfigurationError(f"bits: got {self.bits}, expected at most {LONGEST_REGISTER}")
        super().__post_init__()

    @property
    def count(self) -> int:
        """Number of values that are held."""
        return 2**self.bits - 1 if self.manoeuvre == "prbs" else len(self.values)

    @property
    def hold_s(self) -> float:
        """How long a value is held [s]."""
        return self.hold_lengths * self.length_m / self.speed_m_s

    @property
    def duration_s(self) -> float:
        """Approach, all values, and the end [s]."""
        end = self.end_lengths * self.length_m / self.speed_m_s
        return self.approach_s + self.count * self.hold_s + end

    @property
    def orders(self) -> Array:
        """Values of the input in SI units, shape (count,)."""
        values, start = np.array(self.values), self.input_start[self.index]
        if self.unit == "range":
            up, down = self.input_high[self.index] - start, start - self.input_low[self.index]
            values = start + np.where(values > 0.0, up, down) * values
        else:
            values = values * (np.pi / 180.0 if self.unit == "deg" else start)
        if self.manoeuvre == "prbs":
            return np.asarray(values[register(self.bits)])
        return np.asarray(values)

    def check(self, dofs: Sequence[str]) -> None:
        """Raise ConfigurationError if a value is beyond the limits of the input."""
        self.check_helm(dofs)
        low, high = self.input_low[self.index], self.input_high[self.index]
        for value in self.orders:
            if not low - 1e-9 <= value <= high + 1e-9:
                raise ConfigurationError(
                    f"values: got {value:.4g} for {self.helm}, for which the vessel has data from "
                    f"{low:.4g} to {high:.4g}"
                )

    def steering(self, dofs: Sequence[str], period_s: float) -> Steering:
        """The commands by instant."""
        held, first = round(self.hold_s / period_s), round(self.approach_s / period_s)
        values = np.repeat(self.orders, max(1, held))
        rows = np.tile(self.base, (first + len(values), 1))
        rows[first:, self.index] = values
        return Commands(rows), np.zeros(1)


def register(bits: int) -> "np.ndarray[tuple[int], np.dtype[np.int64]]":
    """A maximum length sequence of zeros and ones, shape (2^bits - 1,)."""
    from scipy.signal import max_len_seq  # slow to import

    return np.asarray(max_len_seq(bits)[0], dtype=np.int64)
