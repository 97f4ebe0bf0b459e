"""Force signals of open-loop excitations, pure functions of time. Hoyer (2021), section 6.3.

The thesis calls its pulses ramps; only rectangular pulses of 20 s with 10 s of rest around them
reproduce its figures. Times t [s], forces [N].
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge, Le

from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation import signals
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.vessel.basis import Array

REST_S = 10.0
PULSE_S = 20.0
ROUNDING_S = 1e-9  # tolerance for rounding of the times
SINE_PERIODS_S = tuple(float(period) for period in range(1, 92, 10))


def pulses(t: Array, forces: Sequence[float]) -> Array:
    """One pulse of 20 s for each force, with 10 s of rest before, between and after; shape of t."""
    since = np.asarray(t) - REST_S + ROUNDING_S
    index = np.floor(since / (PULSE_S + REST_S)).astype(int)
    on = (since >= 0.0) & (since % (PULSE_S + REST_S) < PULSE_S) & (index < len(forces))
    return np.where(on, np.array(forces)[np.clip(index, 0, len(forces) - 1)], 0.0)


def single_ramp(t: Array) -> Array:
    """One pulse of 30 N; 40 s."""
    return pulses(t, (30.0,))


def triple_ramp(t: Array) -> Array:
    """Pulses of 10, 30 and 60 N; 100 s."""
    return pulses(t, (10.0, 30.0, 60.0))


def sines(t: Array, amplitudes: Sequence[float], periods_s: Sequence[float]) -> Array:
    """X = sum_i A_i sin(2 pi t / P_i), shape of t; eq. (6.6)."""
    phase = 2.0 * np.pi * np.asarray(t)[..., None] / np.asarray(periods_s)
    return np.asarray(np.sin(phase) @ np.asarray(amplitudes, dtype=np.float64))


def single_sine(t: Array) -> Array:
    """A sine of 60 N with a period of 5 s; 100 s."""
    return sines(t, (60.0,), (5.0,))


def many_sine(t: Array) -> Array:
    """Ten sines of 10 N with periods of 1, 11, ..., 91 s; 100 s."""
    return sines(t, (10.0,) * len(SINE_PERIODS_S), SINE_PERIODS_S)


class Signal(ABC):
    """A signal that can differ from axis to axis."""

    @abstractmethod
    def sample(self, t: Array, axis: int, count: int, rng: np.random.Generator) -> Array:
        """Values at the times t [s] from the start, shape (N,), for one of `count` axes."""


@dataclass(frozen=True)
class Pulses(Signal):
    """Pulses of the given heights, each after a rest, and a rest at the end.

    Hoyer (2021), section 6.3: the thesis calls them ramps, but only pulses of 20 s with 10 s of
    rest reproduce its figures.
    """

    heights: tuple[float, ...]

    def sample(self, t: Array, axis: int, count: int, rng: np.random.Generator) -> Array:
        """The same signal on every axis."""
        return signals.pulses(t, self.heights)


@dataclass(frozen=True)
class Sines(Signal):
    """sum_i a_i sin(2 pi t / P_i), the same on every axis. Hoyer (2021), eq. (6.6)."""

    amplitudes: tuple[float, ...]
    periods_s: tuple[float, ...]

    def __post_init__(self) -> None:
        if len(self.amplitudes) != len(self.periods_s) or min(self.periods_s, default=0.0) <= 0.0:
            raise ConfigurationError(
                f"periods_s must be {len(self.amplitudes)} positive numbers, "
                f"got {list(self.periods_s)}"
            )

    def sample(self, t: Array, axis: int, count: int, rng: np.random.Generator) -> Array:
        """The same signal on every axis."""
        return signals.sines(t, self.amplitudes, self.periods_s)


@dataclass(frozen=True)
class Prbs(Signal):
    """A pseudo-random binary signal, +-1 held for `shortest_s` to `longest_s`.

    Every axis has its own. Bargouth (2022), appendix O (`prbs1`).
    """

    shortest_s: Annotated[float, Ge(1e-3)]
    longest_s: float

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.shortest_s > self.longest_s:
            raise ConfigurationError(
                f"shortest_s must be at most longest_s = {self.longest_s:g}, "
                f"got {self.shortest_s:g}"
            )

    def sample(self, t: Array, axis: int, count: int, rng: np.random.Generator) -> Array:
        """Changes sign at the end of every interval; the first sign is random."""
        return prbs(t, self.shortest_s, self.longest_s, rng)


@dataclass(frozen=True)
class Multisine(Signal):
    """Sines of equal amplitude between two frequencies with a low crest factor; peak 1.

    The frequencies are multiples of 1 / length of the signal. Each of several axes has its own
    lines, so that their contributions to the response can be separated.
    """

    lowest_hz: float
    highest_hz: Annotated[float, Le(1000)]

    def __post_init__(self) -> None:
        check_ranges(self)
        if not 0.0 < self.lowest_hz < self.highest_hz:
            raise ConfigurationError(
                f"lowest_hz must be positive and below highest_hz = {self.highest_hz:g}, "
                f"got {self.lowest_hz:g}"
            )

    def sample(self, t: Array, axis: int, count: int, rng: np.random.Generator) -> Array:
        """Every `count`-th line from the `axis`-th on."""
        return multisine(t, self.lowest_hz, self.highest_hz, axis, count)


@dataclass(frozen=True)
class Steady(Signal):
    """A constant signal of one."""

    def sample(self, t: Array, axis: int, count: int, rng: np.random.Generator) -> Array:
        """The same signal on every axis."""
        return np.ones(len(t))


def prbs(t: Array, shortest_s: float, longest_s: float, rng: np.random.Generator) -> Array:
    """+-1, changing sign after random intervals between two lengths [s]; shape of t."""
    length = float(t[-1] - t[0]) if len(t) else 0.0
    intervals = rng.uniform(shortest_s, longest_s, int(length / shortest_s) + 2)
    changes = np.searchsorted(np.cumsum(intervals), t - t[0] + 1e-9, side="right")
    sign = 1.0 if rng.random() < 0.5 else -1.0
    return np.asarray(sign * np.where(changes % 2 == 0, 1.0, -1.0))


def multisine(t: Array, lowest_hz: float, highest_hz: float, first: int, every: int) -> Array:
    """A sum of equal sines at multiples of 1 / length, with Schroeder's phases, of peak 1.

    With the phases -pi k (k - 1) / K of the K lines the crest factor stays below 2, against
    sqrt(2 K) with equal phases. Schroeder (1970), IEEE Trans. Inf. Theory 16, 85-89.
    """
    length = (t[-1] - t[0]) * len(t) / (len(t) - 1)
    lines = np.arange(int(np.ceil(lowest_hz * length - 1e-9)), int(highest_hz * length + 1e-9) + 1)
    lines = lines[lines > 0][first::every]
    if not len(lines):
        raise ConfigurationError(
            f"excitation.signal: got {length:g} s, expected longer: there is no line "
            f"between {lowest_hz:g} and {highest_hz:g} Hz for axis {first + 1} of {every}"
        )
    k = np.arange(len(lines))
    phase = -np.pi * k * (k + 1) / len(lines)
    total = np.zeros(len(t))
    for line, shift in zip(lines, phase, strict=True):
        total += np.cos(2.0 * np.pi * line * (t - t[0]) / length + shift)
    return np.asarray(total / np.max(np.abs(total)))


# Force profiles of candidate manoeuvres: signals whose axes are moved in a pattern.


@dataclass(frozen=True)
class Legs(Signal):
    """Legs of equal length, each a push and its opposite: a 4-corner test without a controller.

    A leg is a share of the amplitude by axis, such as (1, 0, 0) ahead.
    """

    legs: tuple[tuple[float, ...], ...]
    length_s: float  # of all legs

    def __post_init__(self) -> None:
        if not self.legs or not self.length_s > 0.0:
            raise ConfigurationError(
                f"legs: got {len(self.legs)} in {self.length_s:g} s, expected some in a positive "
                "time"
            )

    def sample(self, t: Array, axis: int, count: int, rng: np.random.Generator) -> Array:
        """The push of every leg in its first half, its opposite in the second; then nothing."""
        pushes = np.array([leg[axis] for leg in self.legs])
        half = np.floor(t / self.length_s * 2.0 * len(pushes) + 1e-9).astype(int)
        on = half < 2 * len(pushes)
        leg = np.minimum(half // 2, len(pushes) - 1)
        return np.where(on, pushes[leg] * np.where(half % 2 == 0, 1.0, -1.0), 0.0)


@dataclass(frozen=True)
class Ramp(Signal):
    """A force that increases linearly from zero to its peak and decreases again."""

    length_s: Positive  # up and down

    def __post_init__(self) -> None:
        check_ranges(self)

    def sample(self, t: Array, axis: int, count: int, rng: np.random.Generator) -> Array:
        """A triangle over `length_s`, nothing after it; the same on every axis."""
        return np.asarray(np.maximum(1.0 - np.abs(2.0 * t / self.length_s - 1.0), 0.0))


@dataclass(frozen=True)
class SharedSignal(Signal):
    """A signal with a share of its amplitude on every axis."""

    signal: Signal
    shares: tuple[float, ...]

    def sample(self, t: Array, axis: int, count: int, rng: np.random.Generator) -> Array:
        """The signal times the axis's share."""
        return np.asarray(self.shares[axis] * self.signal.sample(t, axis, count, rng))
