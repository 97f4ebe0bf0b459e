"""Standard manoeuvres: turning circle, zig-zag, and runs at constant velocity."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.commands import Piece, zigzag
from seatrial.models.excitation.guidance import Reference
from seatrial.models.excitation.missions import Length, Mission, check_axes, steady_force
from seatrial.models.notation import DOFS
from seatrial.models.ranges import Fraction, Positive, check_ranges
from seatrial.models.recording.recording import Split
from seatrial.models.simulation.registry import Timetable
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.tuning import FromVessel


@dataclass(frozen=True)
class Steered(Mission):
    """A steady surge force, and after `approach_s` a yaw moment, in open loop.

    Without `turn_deg` the moment is constant: a turning circle. With it the moment changes sign
    whenever the heading has deviated by that angle from the approach: a zig-zag, such as 10/10 or
    20/20. `offset` [N, Nm] is a constant force by degree of freedom.
    """

    surge_force_n: Annotated[float, FromVessel("tuning.excitation.surge_force_n")]
    yaw_moment_nm: Annotated[float, FromVessel("tuning.excitation.yaw_moment_nm")]
    turn_deg: Positive | None
    approach_s: Annotated[float, FromVessel("tuning.excitation.approach_s")]
    duration_s: Annotated[float, FromVessel("tuning.excitation.manoeuvre_s")]
    reference_filter: Reference
    train_fraction: Fraction
    offset: dict[str, float] | None = None

    def __post_init__(self) -> None:
        check_ranges(self)
        if not 0.0 <= self.approach_s < self.duration_s:
            raise ConfigurationError(
                f"approach_s must lie between 0 and duration_s = {self.duration_s:g}, "
                f"got {self.approach_s:g}"
            )

    @property
    def open_loop(self) -> bool:
        """The mission runs without a controller."""
        return True

    def force(self, t: Array, dofs: Sequence[str], rng: np.random.Generator) -> Array:
        """Force [N, Nm] at the times t [s], shape (N, n_dof), without the moment of a zig-zag."""
        force = steady_force(self.steady(), len(t), dofs)
        force[:, dofs.index("surge")] += self.surge_force_n
        if self.turn_deg is None:
            force[t >= self.approach_s - 1e-9, dofs.index("yaw")] += self.yaw_moment_nm
        return force

    def pieces(self, period_s: float) -> Sequence[Piece]:
        """The moment that changes sign, first to starboard; none in a turning circle."""
        if self.turn_deg is None:
            return ()
        turn = float(np.radians(self.turn_deg))
        return Piece(until=round(self.approach_s / period_s)), *zigzag(
            self.yaw_moment_nm, turn, 1.0
        )

    def check(self, dofs: Sequence[str]) -> None:
        """Raise ConfigurationError unless the vessel has surge and yaw."""
        if not {"surge", "yaw"} <= set(dofs):
            what, got = "a turning circle or zig-zag", ", ".join(dofs)
            raise ConfigurationError(f"{what} needs a vessel in surge and yaw, got one in {got}")
        check_axes("offset", self.steady(), dofs)


@dataclass(frozen=True)
class ConstantVelocity(Mission):
    """Controlled runs at constant velocity in both directions. Hoyer (2021), Table 5.2.

    `velocities` [m/s, rad/s] are by degree of freedom, or by a combination such as `surge+sway`
    with one number for all or one for each; runs in axes that the vessel does not have are
    omitted. The set-point moves with the velocity for `run_s`, waits for `rest_s`, and returns. A
    share `train_fraction` of the pairs, evenly distributed, is for training.
    """

    velocities: dict[str, tuple[float | tuple[float, ...], ...]]
    velocity_scale: Annotated[Positive, FromVessel("tuning.excitation.velocity_scale")]
    run_s: Annotated[Positive, FromVessel("tuning.excitation.run_s")]
    rest_s: Annotated[Positive, FromVessel("tuning.excitation.rest_s")]
    axes: tuple[str, ...]  # of the vessel
    reference_filter: Reference
    train_fraction: Fraction
    offset: dict[str, float] | None = None  # [N, Nm], added to the command

    def __post_init__(self) -> None:
        check_ranges(self)
        for names, values in self.velocities.items():
            if unknown := [name for name in names.split("+") if name not in DOFS]:
                raise ConfigurationError(
                    f"velocities.{names}: got {unknown[0]!r}, expected some of {', '.join(DOFS)}"
                )
            for value in values:
                if isinstance(value, tuple) and len(value) != len(names.split("+")):
                    raise ConfigurationError(
                        f"velocities.{names}: got {list(value)}, expected a number or one for each"
                    )

    @property
    def runs(self) -> list[dict[str, float]]:
        """Velocities of each pair of runs, by axis."""
        return [
            {
                axis: self.velocity_scale * (value[i] if isinstance(value, tuple) else value)
                for i, axis in enumerate(names.split("+"))
            }
            for names, values in self.velocities.items()
            for value in values
            if set(names.split("+")) <= set(self.axes)
        ]

    @property
    def pair_s(self) -> float:
        """Duration of a pair of runs [s]."""
        return 2.0 * (self.run_s + self.rest_s)

    @property
    def duration_s(self) -> float:
        """Length of all runs [s]."""
        return len(self.runs) * self.pair_s

    def length(self) -> Length:
        """The length of all runs, set by the longer of run and rest."""
        option = "run_s" if self.run_s >= self.rest_s else "rest_s"
        return Length(option, getattr(self, option), self.duration_s)

    def guidance(self, t: Array, start: Array) -> tuple[NamedTuple, Array]:
        """The set-points as a timetable, from a level vessel that heads north."""
        setpoints = np.tile(start, (len(t), 1))
        pair = np.minimum((t / self.pair_s + 1e-9).astype(int), len(self.runs) - 1)
        since = t - self.pair_s * pair
        there = np.clip(since - 0.5 * self.rest_s, 0.0, self.run_s)
        back = np.clip(since - 1.5 * self.rest_s - self.run_s, 0.0, self.run_s)
        for i, velocities in enumerate(self.runs):
            for name, velocity in velocities.items():
                moved = velocity * (there - back) * (pair == i)
                setpoints[:, self.axes.index(name)] += moved
        return Timetable(setpoints), np.zeros(1)

    def split(self, t: Array) -> Split:
        """Training and testing samples, by pairs of runs."""
        pair = ((t - t[0]) / self.pair_s + 1e-9).astype(int)
        train = np.ceil((pair + 1) * self.train_fraction) > np.ceil(pair * self.train_fraction)
        return Split(train, ~train)

    def check(self, dofs: Sequence[str]) -> None:
        """Raise ConfigurationError unless there are pairs for training and for testing."""
        if tuple(dofs) != self.axes:
            raise ConfigurationError(
                f"excitation.axes: got {', '.join(self.axes)}, expected {', '.join(dofs)}"
            )
        check_axes("offset", self.steady(), dofs)
        if len(self.runs) < 2:
            raise ConfigurationError(
                f"excitation.velocities: {len(self.runs)} runs suit a vessel in {', '.join(dofs)}, "
                "expected at least 2"
            )
