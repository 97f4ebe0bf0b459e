"""Forces on the axes of a vessel: in open loop, or added to the commands of a closed loop."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.guidance import Reference
from seatrial.models.excitation.missions import Length, Mission, check_axes, steady_force
from seatrial.models.excitation.signals import Signal
from seatrial.models.notation import DOFS
from seatrial.models.ranges import Fraction, Positive, check_ranges
from seatrial.models.recording.recording import Split
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.tuning import FromVessel


@dataclass(frozen=True)
class Forcing(Mission):
    """An excitation by a force signal. An offset makes instruments stronger (Ljungberg).

    `amplitude` and `offset` [N, Nm] are by degree of freedom; the signal acts on `axes`. `order`:
    `together`, or `in_turn`, one axis after the other. `loop`: `open`; `closed`, added to the
    command of a controller that holds the starting pose or follows the mission `base`. The signal
    lasts `length_s` times `time_scale`, or as long as `base`. The first `train_fraction` of each
    signal is for training.
    """

    signal: Signal
    axes: tuple[str, ...]
    amplitude: Annotated[dict[str, float], FromVessel("tuning.excitation.amplitude")]
    offset: Annotated[
        dict[str, float] | None, FromVessel("tuning.excitation.surge_force_n", entry="surge")
    ]
    order: Literal["together", "in_turn"]
    loop: Literal["open", "closed"]
    length_s: Positive
    time_scale: Annotated[Positive, FromVessel("tuning.excitation.time_scale")]
    hold: Reference  # of the starting pose
    train_fraction: Fraction
    base: Mission | None = None

    def __post_init__(self) -> None:
        check_ranges(self)
        if not self.axes or not {*self.axes} <= {*self.amplitude} <= {*DOFS}:
            raise ConfigurationError(
                f"amplitude: got {', '.join(self.amplitude) or 'nothing'}, expected a number for "
                f"each of {', '.join(self.axes) or 'the axes'}, some of {', '.join(DOFS)}"
            )
        if self.base is not None and self.loop == "open":
            raise ConfigurationError("base: requires loop=closed, got loop=open")

    @property
    def open_loop(self) -> bool:
        """Whether the mission runs without a controller."""
        return self.loop == "open"

    @property
    def parts(self) -> int:
        """Number of repetitions of the signal."""
        return len(self.axes) if self.order == "in_turn" else 1

    @property
    def duration_s(self) -> float:
        """Length of all parts [s]."""
        if self.base is not None:
            return self.base.duration_s
        return self.parts * self.length_s * self.time_scale

    def length(self) -> Length:
        """The length of all parts, set by the signal or by the base mission."""
        if self.base is not None:
            base = self.base.length()
            return base._replace(option=f"base.{base.option}")
        option = "length_s" if self.length_s >= self.time_scale else "time_scale"
        return Length(option, getattr(self, option), self.duration_s)

    @property
    def reference_filter(self) -> Reference:
        """Filter between set-point and reference."""
        return self.hold if self.base is None else self.base.reference_filter

    def guidance(self, t: Array, start: Array) -> tuple[NamedTuple, Array]:
        """Hold the starting pose, or follow the base mission."""
        return super().guidance(t, start) if self.base is None else self.base.guidance(t, start)

    def force(self, t: Array, dofs: Sequence[str], rng: np.random.Generator) -> Array:
        """Force [N, Nm] at the times t [s], shape (N, n_dof)."""
        force = steady_force(self.steady(), len(t), dofs)
        if self.base is not None:
            force += steady_force(self.base.steady(), len(t), dofs)
        part_s, alone = self.duration_s / self.parts, self.order == "in_turn"
        part = np.minimum((t / part_s + 1e-9).astype(int), self.parts - 1)
        for i, axis in enumerate(self.axes):
            active = part == i if alone else np.ones(len(t), dtype=bool)
            signal_time = (t[active] - part_s * part[active]) / self.time_scale
            axis_and_count = (0, 1) if alone else (i, len(self.axes))
            shape = self.signal.sample(signal_time, *axis_and_count, rng)
            force[active, dofs.index(axis)] += self.amplitude[axis] * shape
        return force

    def split(self, t: Array) -> Split:
        """Training and testing samples: the first part of each signal, and the rest."""
        share = ((t - t[0]) / self.duration_s * self.parts + 1e-9) % 1.0
        train = share < self.train_fraction
        return Split(train, ~train)

    def check(self, dofs: Sequence[str]) -> None:
        """Raise ConfigurationError unless the axes are degrees of freedom of the vessel."""
        check_axes("axes", self.axes, dofs)
        check_axes("offset", self.steady(), dofs)
        if self.base is not None:
            self.base.check(dofs)
