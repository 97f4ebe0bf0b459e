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
    RATE,
    Feedback,
    Piece,
    Steering,
    command,
    zigzag,
)
from seatrial.models.excitation.guidance import Reference
from seatrial.models.excitation.missions import Mission
from seatrial.models.ranges import Fraction, NotNegative, Positive
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.tuning import FromVessel


@dataclass(frozen=True, kw_only=True)
class ShipMission(Mission):
    """A mission of a vessel with inputs, which begins ahead at its approach speed U."""

    input_names: Annotated[tuple[str, ...], FromVessel("input_names")]
    speed_m_s: Annotated[Positive, FromVessel("approach_speed_m_s")]
    length_m: Annotated[Positive, FromVessel("scales.length_m")]
    train_fraction: Fraction = 0.5

    commands_inputs = True

    @property
    def unit_s(self) -> float:
        """Time to sail one ship length, L / U [s]."""
        return self.length_m / self.speed_m_s

    def start_velocity(self, dofs: tuple[str, ...]) -> Array:
        """The approach speed ahead [m/s], shape (n_dof,)."""
        return np.where(np.array(dofs) == "surge", self.speed_m_s, 0.0)


@dataclass(frozen=True, kw_only=True)
class SteeredMission(ShipMission):
    """A mission without a controller.

    The inputs keep the values that they have at the start for `approach_s`; then the input `helm`
    is used. Where it is steered by heading or yaw rate, it is by first-order Nomoto, T r_dot + r =
    K delta, with both poles at U / L.
    """

    helm: Annotated[str, FromVessel("helm")] = "delta"
    approach_s: NotNegative = 0.0
    input_start: Annotated[tuple[float, ...], FromVessel("input_start")]
    input_signs: Annotated[tuple[float, ...], FromVessel("input_signs")]
    input_low: Annotated[tuple[float, ...], FromVessel("input_low")]
    input_high: Annotated[tuple[float, ...], FromVessel("input_high")]
    nomoto_gain: Annotated[tuple[float, ...], FromVessel("nomoto_gain")]  # [1/s] by input
    nomoto_time_s: Annotated[tuple[float, ...], FromVessel("nomoto_time_s")]
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

    @property
    def limits(self) -> tuple[float, float]:
        """Lowest and highest helm."""
        return self.input_low[self.index], self.input_high[self.index]

    def at(self, share: float) -> float:
        """The helm at a share of the way from its start to the upper limit, or the lower one."""
        start = self.input_start[self.index]
        return start + abs(share) * (self.limits[int(share > 0.0)] - start)

    def side(self, order: float) -> float:
        """The side that an order turns to: 1 starboard, -1 port."""
        return self.input_signs[self.index] * float(np.sign(order))

    def steering(self, dofs: Sequence[str], period_s: float) -> Steering:
        """The approach and the pieces of the manoeuvre, as orders of the helm."""
        index, first = self.index, round(self.approach_s / period_s)
        base = np.array(self.input_start, dtype=np.float64)
        pieces = [Piece(base[index], until=first)]
        for piece in self.pieces(period_s):
            pieces.append(piece._replace(until=min(first + piece.until, NEVER)))
        gain, time = self.nomoto_gain[index] or np.inf, self.nomoto_time_s[index]
        omega = 1.0 / self.unit_s
        gains = time * omega**2 / gain, (2.0 * omega * time - 1.0) / gain
        kp, kd, low, high = np.array([*gains, *self.limits])[:, None]
        yaw = dofs.index("yaw") if "yaw" in dofs else 0
        feedback = Feedback(kp, kd, low, high, period_s * gains[0])
        return command(pieces, base, index, yaw, feedback)

    def check(self, dofs: Sequence[str], needed: str | None = "yaw") -> None:
        """Raise ConfigurationError unless the vessel has the helm, and a degree of freedom."""
        if self.helm not in self.input_names or (needed and needed not in dofs):
            ones = [n for n, k in zip(self.input_names, self.nomoto_gain, strict=True) if k]
            cure = f"; excitation.helm={ones[0]} turns it" if ones and self.helm == "delta" else ""
            raise ConfigurationError(
                f"helm: needs a vessel {f'in {needed} ' if needed else ''}with an input "
                f"{self.helm}, got inputs {', '.join(self.input_names) or 'none'} in "
                f"{', '.join(dofs)}{cure}"
            )
        if not self.nomoto_gain[self.index] and any(p.law != HOLD for p in self.pieces(1.0)):
            raise ConfigurationError(f"helm: got {self.helm}, which gives no steady turn")


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
        if self.manoeuvre == "zigzag":
            return zigzag(helm, float(np.radians(self.turn_deg)), self.side(helm))
        if self.pull_out_deg is None:
            return (Piece(helm),)
        return Piece(helm, turned=float(np.radians(self.pull_out_deg)), side=0.0), Piece(0.0)


@dataclass(frozen=True, kw_only=True)
class Williamson(SteeredMission):
    """Back onto the own track: helm to one side, to the other, and the reciprocal course.

    The course is over the side of the first helm, and steered by at most this helm.
    """

    manoeuvre: Literal["williamson"] = "williamson"
    helm_deg: float
    away_deg: Positive  # change of heading at which the helm is put to the other side
    check_deg: Positive  # before the reciprocal course, where the helm is steered
    duration_lengths: Positive

    @property
    def duration_s(self) -> float:
        """Length [s]."""
        return self.approach_s + self.duration_lengths * self.unit_s

    @property
    def limits(self) -> tuple[float, float]:
        """The helm of the turn to both sides."""
        limit = abs(float(np.radians(self.helm_deg)))
        return -limit, limit

    def pieces(self, period_s: float) -> Sequence[Piece]:
        """Both sides, and the course."""
        degrees = self.helm_deg, self.away_deg, 180.0 - self.check_deg
        helm, away, check = np.radians(degrees).tolist()
        side = self.side(helm)
        return (
            Piece(helm, turned=away, side=side),
            Piece(-helm, turned=check, side=-side),
            Piece(-side * np.pi, HEADING),
        )


@dataclass(frozen=True, kw_only=True)
class ScheduledInput(SteeredMission):
    """Values in turn, each for `hold_lengths` L / U of the approach and the last one to the end.

    They are values of the input `helm`: in degrees, or with `unit: start` relative to the input at
    the start, or with `unit: range` shares of the way from there to the limits: 1 the upper one, -1
    the lower one. With `unit: rate` they are yaw rates in U / L, which the helm holds. `prbs` is a
    maximum length sequence of a shift register of `bits` that alternates between two values.
    """

    manoeuvre: Literal["spiral", "reverse_spiral", "stop", "prbs"]
    values: tuple[float, ...]
    unit: Literal["deg", "start", "range", "rate"] = "deg"
    hold_lengths: Positive
    bits: Annotated[int, Ge(2), Le(20)] = 7

    def __post_init__(self) -> None:
        if not self.values or (self.manoeuvre == "prbs" and len(self.values) != 2):
            got = len(self.values)
            raise ConfigurationError(f"values: got {got}, expected some, and two for prbs")
        super().__post_init__()

    @property
    def duration_s(self) -> float:
        """Approach and all values [s]."""
        count = 2**self.bits - 1 if self.manoeuvre == "prbs" else len(self.values)
        return self.approach_s + count * self.hold_lengths * self.unit_s

    @property
    def orders(self) -> Array:
        """The values in SI units, (n,)."""
        if self.unit == "range":
            return np.array([self.at(value) for value in self.values])
        start = self.input_start[self.index]
        units = {"deg": np.pi / 180.0, "start": start, "rate": 1.0 / self.unit_s}
        return np.array(self.values) * units[self.unit]

    def pieces(self, period_s: float) -> Sequence[Piece]:
        """The values in turn."""
        orders, law = self.orders, RATE if self.unit == "rate" else HOLD
        if self.manoeuvre == "prbs":
            orders = orders[register(self.bits)]
        held = max(1, round(self.hold_lengths * self.unit_s / period_s))
        until = [*(held * np.arange(1, len(orders))).tolist(), NEVER]
        return [Piece(order, law, end) for order, end in zip(orders.tolist(), until, strict=True)]

    def check(self, dofs: Sequence[str], needed: str | None = None) -> None:
        """Raise ConfigurationError if a value is beyond the limits of the input."""
        super().check(dofs, "yaw" if self.unit == "rate" else needed)
        (low, high), start = self.limits, self.input_start[self.index]
        beyond = [x for x in self.orders if not low - 1e-9 <= x <= high + 1e-9]
        if self.unit != "rate" and beyond:
            unit = start if self.unit == "start" else np.pi / 180.0
            ends = (-1.0, 1.0) if self.unit == "range" else sorted((low / unit, high / unit))
            near = np.clip(self.values, *ends).round(6).tolist()
            raise ConfigurationError(
                f"values: got {beyond[0]:.4g} for {self.helm}, for which the vessel has data from "
                f"{low:.4g} to {high:.4g}; excitation.values={near} is within them"
            )


def register(bits: int) -> "np.ndarray[tuple[int], np.dtype[np.int64]]":
    """A maximum length sequence of zeros and ones, shape (2^bits - 1,)."""
    from scipy.signal import max_len_seq  # slow to import

    return np.asarray(max_len_seq(bits)[0], dtype=np.int64)
