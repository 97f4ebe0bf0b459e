"""Standard manoeuvres of a steered vessel: turning circle with pull-out, and zig-zag.

The commands are those of the inputs. The vessel approaches on a straight course at the values that
its inputs have at the start; then its helm, a rudder angle, is put over.

Commands of an input that are known in advance: spiral, crash stop, and a binary sequence.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

import numpy as np
from annotated_types import Ge

from seatrial.models.compiled import lean_kernel
from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.guidance import Reference
from seatrial.models.excitation.missions import Mission, Steering, check_fraction, counter_steer
from seatrial.models.ranges import NotNegative, Positive, check_ranges
from seatrial.models.recording.recording import Split, half
from seatrial.models.simulation.registry import CONTROLLERS, Timetable
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.tuning import FromVessel


class Helm(NamedTuple):
    """Commands of a manoeuvre; SI units, radians."""

    base: Array  # (n_inputs,) of the approach
    helm: int  # the input
    yaw: int  # the degree of freedom
    angle: float  # of the helm that turns the vessel to starboard
    turn: float  # heading at which a zig-zag changes sides
    pull_out: float  # change of heading after which the helm of a turn is put amidships
    zigzag: bool
    first: int  # instant of the first steering


@lean_kernel
def _step(
    helm: Helm, state: Array, eta: Array, nu: Array, eta_d: Array, nu_d: Array, nu_dot_d: Array,
    tau: Array, tau_fb: Array,
) -> None:  # fmt: skip
    """state = (instant, side of the turn or 0 after the pull-out, heading of the approach)."""
    for i in range(tau.shape[0]):
        tau[i] = tau_fb[i] = helm.base[i]
    heading = eta[helm.yaw]
    if state[0] <= helm.first:
        state[2] = heading
    if state[0] >= helm.first:
        if helm.zigzag:
            tau[helm.helm] = counter_steer(state, heading, helm.angle, helm.turn)
        else:
            if abs(heading - state[2]) >= helm.pull_out:
                state[1] = 0.0
            tau[helm.helm] = state[1] * helm.angle
        tau_fb[helm.helm] = tau[helm.helm]
    state[0] += 1.0


CONTROLLERS[Helm] = _step


@dataclass(frozen=True, kw_only=True)
class SteeredMission(Mission):
    """A mission of a vessel with inputs, which begins ahead at its approach speed.

    The inputs keep the values that they have at the start for `approach_s`; then the input `helm`
    is used.
    """

    helm: Annotated[str, FromVessel("helm")] = "delta"
    approach_s: NotNegative = 0.0
    input_names: Annotated[tuple[str, ...], FromVessel("input_names")]
    input_start: Annotated[tuple[float, ...], FromVessel("input_start")]
    input_signs: Annotated[tuple[float, ...], FromVessel("input_signs")]
    speed_m_s: Annotated[Positive, FromVessel("approach_speed_m_s")]
    reference_filter: Reference
    train_fraction: float = 0.5

    def __post_init__(self) -> None:
        check_ranges(self)
        check_fraction(self.train_fraction)
        if not self.approach_s < self.duration_s:
            raise ConfigurationError(
                f"approach_s must be below duration_s = {self.duration_s:g}, "
                f"got {self.approach_s:g}"
            )

    @property
    def commands_inputs(self) -> bool:
        """A helm is an input."""
        return True

    @property
    def open_loop(self) -> bool:
        """A manoeuvre has no controller."""
        return True

    def guidance(self, t: Array, start: Array) -> tuple[NamedTuple, Array]:
        """No set-points: the initial pose."""
        return Timetable(np.tile(start, (len(t), 1))), np.zeros(1)

    def start_velocity(self, dofs: tuple[str, ...]) -> Array:
        """The approach speed ahead [m/s], shape (n_dof,)."""
        return np.where(np.array(dofs) == "surge", self.speed_m_s, 0.0)

    def split(self, t: Array) -> Split:
        """Training and testing samples: the first part, and the rest."""
        return half(len(t), self.train_fraction)

    @property
    def index(self) -> int:
        """Position of the helm among the inputs."""
        return self.input_names.index(self.helm)

    @property
    def sign(self) -> float:
        """Sign of the helm that turns the vessel to starboard."""
        return self.input_signs[self.index]

    @property
    def base(self) -> Array:
        """Inputs of the approach, shape (n_inputs,)."""
        return np.array(self.input_start, dtype=np.float64)

    def check(self, dofs: Sequence[str]) -> None:
        """Raise ConfigurationError unless the vessel has the helm, and yaws."""
        self.check_helm(dofs, "yaw")

    def check_helm(self, dofs: Sequence[str], needed: str | None = None) -> None:
        """Raise ConfigurationError unless the vessel has the helm, and a degree of freedom."""
        if self.helm not in self.input_names or (needed and needed not in dofs):
            raise ConfigurationError(
                f"helm: needs a vessel {f'in {needed} ' if needed else ''}with an input "
                f"{self.helm}, got inputs {', '.join(self.input_names) or 'none'} in "
                f"{', '.join(dofs)}"
            )


@dataclass(frozen=True, kw_only=True)
class HelmManoeuvre(SteeredMission):
    """A turning circle or a zig-zag by a rudder; the other inputs keep their start.

    After `approach_s` the input `helm` is put to `helm_deg` (negative: to the other side first).
    `zigzag`: it is put to the other side whenever the heading has deviated by `turn_deg` from the
    approach. `turn`: it is held, until the heading has changed by `pull_out_deg` (null: to the
    end).
    """

    manoeuvre: Literal["turn", "zigzag"]
    helm_deg: float
    turn_deg: Positive
    pull_out_deg: Positive | None
    duration_s: Positive

    def steering(self, dofs: Sequence[str], period_s: float) -> Steering:
        """The commands of the manoeuvre."""
        pull_out = np.inf if self.pull_out_deg is None else np.radians(self.pull_out_deg)
        table = Helm(
            self.base, self.index, dofs.index("yaw"),
            self.sign * float(np.radians(abs(self.helm_deg))), float(np.radians(self.turn_deg)),
            float(pull_out), self.manoeuvre == "zigzag", round(self.approach_s / period_s),
        )  # fmt: skip
        return table, np.array([0.0, self.sign * np.sign(self.helm_deg), 0.0])


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
