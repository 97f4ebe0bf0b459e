"""Force profiles of candidate manoeuvres: signals whose axes are moved in a pattern."""

from dataclasses import dataclass

import numpy as np

from models.basis import Array
from models.errors import ConfigurationError
from models.excitation.forcing import Signal


@dataclass(frozen=True)
class Legs:
    """Legs of equal length, each a push and a counter-push: a 4-corner test without a controller.

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
class Ramp:
    """A force that grows from nothing to its peak and falls back, linearly."""

    length_s: float  # up and down

    def __post_init__(self) -> None:
        if not self.length_s > 0.0:
            raise ConfigurationError(f"length_s must be positive, got {self.length_s}")

    def sample(self, t: Array, axis: int, count: int, rng: np.random.Generator) -> Array:
        """A triangle over `length_s`, nothing after it; the same on every axis."""
        return np.asarray(np.maximum(1.0 - np.abs(2.0 * t / self.length_s - 1.0), 0.0))


@dataclass(frozen=True)
class Shared:
    """A signal with a share of its amplitude on every axis."""

    signal: Signal
    shares: tuple[float, ...]

    def sample(self, t: Array, axis: int, count: int, rng: np.random.Generator) -> Array:
        """The signal times the axis's share."""
        return np.asarray(self.shares[axis] * self.signal.sample(t, axis, count, rng))
