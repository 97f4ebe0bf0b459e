"""Standard manoeuvres of a steered vessel, by the commands of its inputs.

Turning circle with pull-out, zig-zag, spiral, reverse spiral (Bech), Williamson turn, crash stop
and a binary sequence. The vessel approaches on a straight course at the values that its inputs
have at the start; then its helm, a rudder angle or another input, is used.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Le

from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.commands import (
    HEADING,
    HOLD,
    NEVER,
    NO_FEEDBACK,
    RATE,
    Feedback,
    Piece,
    Steering,
    command,
    zigzag,
)
from seatrial.models.excitation.guidance import Reference
from seatrial.models.excitation.missions import Mission, check_fraction
from seatrial.models.ranges import NotNegative, Positive, check_ranges
from seatrial.models.recording.recording import Split, half
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.tuning import FromVessel


@dataclass(frozen=True, kw_only=True)
class ShipMission(Mission):
    """A mission of a vessel with inputs, which begins ahead at its approach speed U."""

    input_names: Annotated[tuple[str, ...], FromVessel("input_names")]
    speed_m_s: Annotated[Positive, FromVessel("approach_speed_m_s")]
    length_m: Annotated[Positive, FromVessel("scales.length_m")]
    train_fraction: float = 0.5

    commands_inputs = True

    def __post_init__(self) -> None:
        check_ranges(self)
        check_fraction(self.train_fraction)

    @property
    def unit_s(self) -> float:
        """Time to sail one ship length, L / U [s]."""
        return self.length_m / self.speed_m_s

    def start_velocity(self, dofs: tuple[str, ...]) -> Array:
        """The approach speed ahead [m/s], shape (n_dof,)."""
        return np.where(np.array(dofs) == "surge", self.speed_m_s, 0.0)

    def split(self, t: Array) -> Split:
        """Training and testing samples: the first part, and the rest."""
        return half(len(t), self.train_fraction)


@dataclass(frozen=True, kw_only=True)
class SteeredMission(ShipMission):
    """A mission without a controller.

    The inputs keep the values that they have at the start for `approach_s`; then the input `helm`
    is used.
    """

    helm: Annotated[str, FromVessel("helm")] = "delta"
    approach_s: NotNegative = 0.0
    input_start: Annotated[tuple[float, ...], FromVessel("input_start")]
    input_signs: Annotated[tuple[float, ...], FromVessel("input_signs")]
    input_low: Annotated[tuple[float, ...], FromVessel("input_low")]
    input_high: Annotated[tuple[float, ...], FromVessel("input_high")]
    reference_filter: Reference

    open_loop = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.approach_s < self.duration_s:
            raise ConfigurationError(
                f"approach_s must be below duration_s = {self.duration_s:g}, "
                f"got {self.approach_s:g}"
            )

    @property
    def index(self) -> int:
        """Position of the helm among the inputs."""
        return self.input_names.index(self.helm)

    def feedback(self, period_s: float) -> Feedback:
        """The gains of pieces that are steered by heading or yaw rate."""
        return NO_FEEDBACK

    def in_turn(self, orders: Array, law: int, hold_s: float, period_s: float) -> Sequence[Piece]:
        """Orders of which each is held for a time [s], the last one to the end."""
        held = max(1, round(hold_s / period_s))
        pieces = [Piece(float(order), law, held * (i + 1)) for i, order in enumerate(orders)]
        return [*pieces[:-1], pieces[-1]._replace(until=NEVER)]

    def steering(self, dofs: Sequence[str], period_s: float) -> Steering:
        """The approach and the pieces of the manoeuvre, as orders of the helm."""
        base = np.array(self.input_start, dtype=np.float64)
        first = round(self.approach_s / period_s)
        shifted = (
            piece._replace(until=min(first + piece.until, NEVER)) for piece in self.pieces(period_s)
        )
        pieces = [Piece(base[self.index], until=first), *shifted]
        yaw = dofs.index("yaw") if "yaw" in dofs else 0
        return command(pieces, base, self.index, yaw, self.feedback(period_s))

    def check(self, dofs: Sequence[str], needed: str | None = "yaw") -> None:
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

    def pieces(self, period_s: float) -> Sequence[Piece]:
        """The helm to both sides in turn, or to one side and amidships."""
        helm = float(np.radians(self.helm_deg))
        side = self.input_signs[self.index] * float(np.sign(self.helm_deg))
        if self.manoeuvre == "zigzag":
            return zigzag(helm, float(np.radians(self.turn_deg)), side)
        if self.pull_out_deg is None:
            return (Piece(helm),)
        return Piece(helm, turned=float(np.radians(self.pull_out_deg)), side=0.0), Piece(0.0)


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
    bits: Annotated[int, Ge(2), Le(20)] = 7

    def __post_init__(self) -> None:
        if not self.values or (self.manoeuvre == "prbs" and len(self.values) != 2):
            raise ConfigurationError(
                f"values: got {len(self.values)}, expected "
                f"{'two' if self.manoeuvre == 'prbs' else 'at least one'}"
            )
        super().__post_init__()

    @property
    def duration_s(self) -> float:
        """Approach and all values [s]."""
        count = 2**self.bits - 1 if self.manoeuvre == "prbs" else len(self.values)
        return self.approach_s + count * self.hold_lengths * self.unit_s

    @property
    def orders(self) -> Array:
        """Values of the input in turn, in SI units."""
        values, start = np.array(self.values), self.input_start[self.index]
        if self.unit == "range":
            up, down = self.input_high[self.index] - start, start - self.input_low[self.index]
            values = start + np.where(values > 0.0, up, down) * values
        else:
            values = values * (np.pi / 180.0 if self.unit == "deg" else start)
        return np.asarray(values[register(self.bits)] if self.manoeuvre == "prbs" else values)

    def pieces(self, period_s: float) -> Sequence[Piece]:
        """The values in turn."""
        return self.in_turn(self.orders, HOLD, self.hold_lengths * self.unit_s, period_s)

    def check(self, dofs: Sequence[str], needed: str | None = None) -> None:
        """Raise ConfigurationError if a value is beyond the limits of the input."""
        super().check(dofs, needed)
        low, high = self.input_low[self.index], self.input_high[self.index]
        orders, start = self.orders, self.input_start[self.index]
        for value in orders:
            if not low - 1e-9 <= value <= high + 1e-9:
                unit = start if self.unit == "start" else np.pi / 180.0
                near = np.clip(orders, low, high) / unit
                near = np.clip(self.values, -1.0, 1.0) if self.unit == "range" else near
                within = [round(float(one), 6) for one in near]
                raise ConfigurationError(
                    f"values: got {value:.4g} for {self.helm}, for which the vessel has data from "
                    f"{low:.4g} to {high:.4g}; excitation.values={within} is within them"
                )


def register(bits: int) -> "np.ndarray[tuple[int], np.dtype[np.int64]]":
    """A maximum length sequence of zeros and ones, shape (2^bits - 1,)."""
    from scipy.signal import max_len_seq  # slow to import

    return np.asarray(max_len_seq(bits)[0], dtype=np.int64)


@dataclass(frozen=True, kw_only=True)
class HelmsmanMission(SteeredMission):
    """A manoeuvre in which the helm is steered by heading or yaw rate.

    The helmsman steers by first-order Nomoto, T r_dot + r = K delta, with both poles at
    `bandwidth` U / L.
    """

    bandwidth: Positive = 1.0
    nomoto_gain: Annotated[tuple[float, ...], FromVessel("nomoto_gain")]  # [1/s] by input
    nomoto_time_s: Annotated[tuple[float, ...], FromVessel("nomoto_time_s")]

    @property
    def gains(self) -> tuple[float, float]:
        """The helm for an error of the heading, and for one of the yaw rate [s]."""
        gain, time = self.nomoto_gain[self.index], self.nomoto_time_s[self.index]
        omega = self.bandwidth / self.unit_s
        return time * omega**2 / gain, (2.0 * omega * time - 1.0) / gain

    @property
    def helm_limits(self) -> tuple[float, float]:
        """Lowest and highest helm."""
        return self.input_low[self.index], self.input_high[self.index]

    def feedback(self, period_s: float) -> Feedback:
        """Control of the heading, and of the rate with the same poles, within the limits."""
        of_heading, of_rate, low, high = (np.array([x]) for x in (*self.gains, *self.helm_limits))
        return Feedback(of_heading, of_rate, low, high, period_s * float(of_heading[0]))


@dataclass(frozen=True, kw_only=True)
class Williamson(HelmsmanMission):
    """Back onto the own track: helm to one side, to the other, and the reciprocal course."""

    manoeuvre: Literal["williamson"] = "williamson"
    helm_deg: float
    away_deg: Positive  # change of heading at which the helm is put to the other side
    check_deg: Positive  # before the reciprocal course, where the helm is steered
    duration_lengths: Positive

    @property
    def duration_s(self) -> float:
        """Length [s]."""
        return self.approach_s + self.duration_lengths * self.unit_s

    def pieces(self, period_s: float) -> Sequence[Piece]:
        """Both sides, and the course over the side of the first helm."""
        helm = float(np.radians(self.helm_deg))
        side = self.input_signs[self.index] * float(np.sign(self.helm_deg))
        away, check = float(np.radians(self.away_deg)), float(np.radians(self.check_deg))
        return (
            Piece(helm, turned=away, side=side),
            Piece(-helm, turned=np.pi - check, side=-side),
            Piece(-side * np.pi, HEADING),
        )

    @property
    def helm_limits(self) -> tuple[float, float]:
        """The helm of the turn to both sides."""
        limit = abs(float(np.radians(self.helm_deg)))
        return -limit, limit


@dataclass(frozen=True, kw_only=True)
class ReverseSpiral(HelmsmanMission):
    """Yaw rates held in turn by the helm, each for `hold_lengths` L / U; in units of U / L."""

    manoeuvre: Literal["reverse_spiral"] = "reverse_spiral"
    largest_rate: Positive
    count: int
    hold_lengths: Positive

    @property
    def duration_s(self) -> float:
        """Length [s]."""
        return self.approach_s + self.count * self.hold_lengths * self.unit_s

    def pieces(self, period_s: float) -> Sequence[Piece]:
        """The yaw rates in turn."""
        rates = np.linspace(1.0, -1.0, self.count) * self.largest_rate / self.unit_s
        return self.in_turn(rates, RATE, self.hold_lengths * self.unit_s, period_s)
