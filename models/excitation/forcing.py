"""Force signals on the axes of a vessel: open loop, or added to a closed loop.

A signal is a function of time without a unit; an axis gets offset + amplitude x signal [N, Nm].
Axes are excited together, or one after the other, each for the whole length of the signal.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol

import numpy as np

from models.basis import Array
from models.errors import ConfigurationError
from models.excitation import signals
from models.excitation.guidance import ReferenceFilter, Timetable
from models.excitation.mission import Mission, check_fraction, check_offset, steady_force
from models.excitation.steering import open_loop
from models.splits import Split


class Signal(Protocol):
    """A signal that can differ from axis to axis."""

    def sample(self, t: Array, axis: int, count: int, rng: np.random.Generator) -> Array:
        """Values at the times t [s] from the start, shape (N,), for one of `count` axes."""
        ...


@dataclass(frozen=True)
class Pulses:
    """Pulses of the given heights, each after a rest, and a rest at the end.

    Hoyer (2021), section 6.3: the thesis calls them ramps, but only pulses of 20 s with 10 s of
    rest reproduce its figures.
    """

    heights: tuple[float, ...]

    def sample(self, t: Array, axis: int, count: int, rng: np.random.Generator) -> Array:
        """The same on every axis."""
        return signals.pulses(t, self.heights)


@dataclass(frozen=True)
class Sines:
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
        """The same on every axis."""
        return signals.sines(t, self.amplitudes, self.periods_s)


@dataclass(frozen=True)
class Prbs:
    """A pseudo-random binary signal, +-1 held for `shortest_s` to `longest_s`.

    Every axis has its own. Bargouth (2022), appendix O (`prbs1`).
    """

    shortest_s: float
    longest_s: float

    def __post_init__(self) -> None:
        if not 0.0 < self.shortest_s <= self.longest_s:
            raise ConfigurationError(
                f"shortest_s must be positive and at most longest_s = {self.longest_s:g}, "
                f"got {self.shortest_s:g}"
            )

    def sample(self, t: Array, axis: int, count: int, rng: np.random.Generator) -> Array:
        """Changes sign at the end of every interval; the first sign is random."""
        return prbs(t, self.shortest_s, self.longest_s, rng)


@dataclass(frozen=True)
class Multisine:
    """Sines of equal size between two frequencies, of a low crest factor; peak 1.

    The lines are multiples of one over the signal's length; of several axes each has its own
    lines, so that their parts in the response can be told apart.
    """

    lowest_hz: float
    highest_hz: float

    def __post_init__(self) -> None:
        if not 0.0 < self.lowest_hz < self.highest_hz:
            raise ConfigurationError(
                f"lowest_hz must be positive and below highest_hz = {self.highest_hz:g}, "
                f"got {self.lowest_hz:g}"
            )

    def sample(self, t: Array, axis: int, count: int, rng: np.random.Generator) -> Array:
        """Every `count`-th line from the `axis`-th on."""
        return multisine(t, self.lowest_hz, self.highest_hz, axis, count)


@dataclass(frozen=True)
class Steady:
    """One, all the time."""

    def sample(self, t: Array, axis: int, count: int, rng: np.random.Generator) -> Array:
        """The same on every axis."""
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
            f"excitation.signal: {length:g} s have no line between {lowest_hz:g} and "
            f"{highest_hz:g} Hz for axis {first + 1} of {every}"
        )
    k = np.arange(len(lines))
    phase = -np.pi * k * (k + 1) / len(lines)
    total = np.zeros(len(t))
    for line, shift in zip(lines, phase, strict=True):
        total += np.cos(2.0 * np.pi * line * (t - t[0]) / length + shift)
    return np.asarray(total / np.max(np.abs(total)))


@dataclass(frozen=True)
class Forcing:
    """An excitation by a force signal. Ljungberg: with an offset, instruments are stronger.

    `amplitude` and `offset` [N, Nm] are by degree of freedom; `axes` are those that the signal is
    on. `order`: `together`, or `in_turn`, one axis after the other. `loop`: `open`; `closed`,
    added to the controller's command while it holds the starting pose, or while it sails `base`.
    The signal is given for `length_s` of its own time, which runs slower by `time_scale`; with
    `base` for as long as that takes. The first `train_fraction` of each signal is for training.
    """

    signal: Signal
    axes: tuple[str, ...]
    amplitude: dict[str, float]
    offset: dict[str, float] | None
    order: Literal["together", "in_turn"]
    loop: Literal["open", "closed"]
    length_s: float
    time_scale: float
    hold: ReferenceFilter  # of the starting pose
    train_fraction: float
    base: Mission | None = None

    def __post_init__(self) -> None:
        for name in ("length_s", "time_scale"):
            if not getattr(self, name) > 0.0:
                raise ConfigurationError(f"{name} must be positive, got {getattr(self, name)}")
        missing = [axis for axis in self.axes if axis not in self.amplitude]
        if not self.axes or missing:
            raise ConfigurationError(
                f"amplitude: got {', '.join(self.amplitude) or 'nothing'}, expected a number for "
                f"each of {', '.join(self.axes) or 'the axes'}"
            )
        if self.base is not None and self.loop == "open":
            raise ConfigurationError("base: is sailed in a closed loop, got loop=open")
        check_fraction(self.train_fraction)

    @property
    def open_loop(self) -> bool:
        """Whether no controller takes part."""
        return self.loop == "open"

    @property
    def parts(self) -> int:
        """How often the signal is given."""
        return len(self.axes) if self.order == "in_turn" else 1

    @property
    def part_s(self) -> float:
        """Length of one part [s]."""
        if self.base is not None:
            return self.base.duration_s / self.parts
        return self.length_s * self.time_scale

    @property
    def duration_s(self) -> float:
        """Length of all parts [s]."""
        return self.parts * self.part_s

    @property
    def reference_filter(self) -> ReferenceFilter:
        """Filter between set-point and reference."""
        return self.hold if self.base is None else self.base.reference_filter

    def guidance(self, t: Array, start: Array) -> tuple[NamedTuple, Array]:
        """Hold the starting pose, or sail the base mission."""
        if self.base is not None:
            return self.base.guidance(t, start)
        return Timetable(np.tile(start, (len(t), 1))), np.zeros(1)

    def force(self, t: Array, dofs: Sequence[str], rng: np.random.Generator) -> Array:
        """Force [N, Nm] at the times t [s], shape (N, n_dof)."""
        force = steady_force(self.offset, len(t), dofs)
        force += steady_force(getattr(self.base, "offset", None), len(t), dofs)
        part = np.minimum((t / self.part_s + 1e-9).astype(int), self.parts - 1)
        alone = self.order == "in_turn"
        for i, axis in enumerate(self.axes):
            on = part == i if alone else np.ones(len(t), dtype=bool)
            own = (t[on] - self.part_s * part[on]) / self.time_scale
            place = (0, 1) if alone else (i, len(self.axes))
            shape = self.signal.sample(own, *place, rng)
            force[on, dofs.index(axis)] += self.amplitude[axis] * shape
        return force

    def steering(self, dofs: Sequence[str], period_s: float) -> tuple[NamedTuple, Array] | None:
        """What stands in for the controller: nothing, in an open loop."""
        return open_loop() if self.open_loop else None

    def split(self, t: Array) -> Split:
        """Training and testing samples: the first part of each signal, and the rest."""
        share = ((t - t[0]) / self.part_s + 1e-9) % 1.0
        train = share < self.train_fraction
        return Split(train, ~train)

    def check(self, dofs: Sequence[str]) -> None:
        """The axes have to be degrees of freedom of the vessel."""
        unknown = [axis for axis in self.axes if axis not in dofs]
        if unknown:
            raise ConfigurationError(
                f"excitation.axes: got {unknown[0]}, but the vessel moves in {', '.join(dofs)}"
            )
        check_offset(self.offset, dofs)
        if self.base is not None:
            self.base.check(dofs)

    def check_limits(self, limits: Mapping[str, float], period_s: float) -> None:
        """Raise ConfigurationError where a force exceeds what the thrusters can give."""
        dofs = tuple(dict.fromkeys((*self.axes, *(self.offset or ()))))
        t = period_s * np.arange(round(self.duration_s / period_s), dtype=np.float64)
        peak = np.max(np.abs(self.force(t, dofs, np.random.default_rng(0))), axis=0)
        for dof, value in zip(dofs, peak, strict=True):
            if dof in limits and value > limits[dof] * (1.0 + 1e-9):
                raise ConfigurationError(
                    f"excitation.amplitude.{dof}: the signal reaches {value:g}, expected at most "
                    f"the thrusters' {limits[dof]:g}"
                )
