"""A sequence of a steered vessel: what its helm does in turn, with courses steered between.

It is sailed from a sheet: every step lasts a time that is known before. Joins between manoeuvres
are paths of Dubins, an arc at a helm until the heading has changed, then the new course.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.commands import HEADING, HOLD, Piece, zigzag
from seatrial.models.excitation.helm import SteeredMission
from seatrial.models.planning.dubins import Arc
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.recording.recording import Mask, Split, half
from seatrial.models.vessel.basis import Array


@dataclass(frozen=True)
class HelmStep:
    """What the helm does for `seconds`; `order` is its value [rad, or the unit of the input].

    `hold`: the order. `zigzag`: the order, to the other side whenever the heading has turned by
    `turn_deg`. `turn`: the order until the heading has turned by `turn_deg` (positive to
    starboard), then that course is steered; of 0 deg: the course is kept. `train` marks what a
    model is identified from.
    """

    kind: Literal["hold", "zigzag", "turn"]
    seconds: Positive
    order: float = 0.0
    turn_deg: float = 0.0
    train: bool = True

    def __post_init__(self) -> None:
        check_ranges(self)


@dataclass(frozen=True, kw_only=True)
class HelmSequence(SteeredMission):
    """Steps in turn, from `start_pose` (north [m], east [m], heading [deg]) at approach speed.

    `expected` is what was expected of it: half the 90 % interval by purpose. `candidates` are what
    `seatrial next` chooses from: steps by name, whose `seconds` are in L / U and whose `order` is a
    share of the way from the start of the helm to its limits. `variants` are factors on both.
    """

    steps: tuple[HelmStep, ...]
    start_pose: tuple[float, float, float] = (0.0, 0.0, 0.0)
    expected: Mapping[str, float] | None = None
    candidates: Mapping[str, tuple[HelmStep, ...]] | None = None
    variants: Mapping[str, tuple[float, ...]] | None = None

    def __post_init__(self) -> None:
        if not self.steps:
            raise ConfigurationError("steps: got none, expected at least one")
        super().__post_init__()

    @property
    def duration_s(self) -> float:
        """Length of all steps [s]."""
        return float(sum(step.seconds for step in self.steps))

    @property
    def start(self) -> Array:
        """The initial pose [m, m, rad], shape (3,)."""
        return np.array([*self.start_pose[:2], np.radians(self.start_pose[2])])

    @cached_property
    def edges_s(self) -> Array:
        """Beginning of every step and the end [s]."""
        return np.concatenate([[0.0], np.cumsum([step.seconds for step in self.steps])])

    def order(self, share: float) -> float:
        """The helm at a share of the way from its start to the upper limit, or the lower one."""
        start, limits = self.input_start[self.index], (self.input_low, self.input_high)
        return float(start + abs(share) * (limits[share > 0.0][self.index] - start))

    def variant(self, name: str, size: float, slowness: float) -> tuple[HelmStep, ...]:
        """The steps of a candidate, its orders times `size` and its times `slowness`."""
        return tuple(
            replace(
                step, seconds=round(slowness * step.seconds * self.unit_s, 1),
                order=self.order(size * step.order),
            )
            for step in (self.candidates or {})[name]
        )  # fmt: skip

    def rows(self) -> Iterator[tuple[float, str]]:
        """Begin [s] of each step, and what the helm does."""
        for begin, step in zip(self.edges_s, self.steps, strict=False):
            in_deg, turn = self.helm == "delta", step.turn_deg
            order = f"{np.degrees(step.order):.3g} deg" if in_deg else f"{step.order:.4g}"
            text = f"{self.helm} {order}"
            if step.kind == "zigzag":
                text += f", to the other side at {turn:g} deg"
            elif step.kind == "turn":
                text = f"{text} for a turn by {turn:.0f} deg, then straight" if turn else "straight"
            yield float(begin), text

    def pieces(self, period_s: float) -> Sequence[Piece]:
        """The orders and the courses."""
        pieces: list[Piece] = []
        base = self.input_start[self.index]
        for step, end in zip(self.steps, self.edges_s[1:], strict=True):
            until, turn = round(end / period_s), float(np.radians(step.turn_deg))
            if step.kind == "hold":
                pieces.append(Piece(step.order, until=until))
            elif step.kind == "zigzag":
                there, back = zigzag(step.order, turn, self.side(step.order - base), until)
                pieces += [there, back._replace(order=2.0 * base - step.order)]
            else:
                if turn:
                    turned, side = abs(turn), float(np.sign(turn))
                    pieces.append(Piece(step.order, HOLD, until, 2, turned, side))
                pieces.append(Piece(turn, HEADING, until))
        return [*pieces, Piece(0.0, HEADING)]

    def split(self, t: Array) -> Split:
        """Training: the steps that say so; testing: the others, or else the second half."""
        step = np.searchsorted(self.edges_s[1:], t - t[0], side="right")
        train: Mask = np.array([*(each.train for each in self.steps), False])[step]
        return half(len(t), self.train_fraction) if np.all(train[:-1]) else Split(train, ~train)


def join_steps(
    path: Sequence[Arc], radius_m: float, speed_m_s: float, helm: Array, settle_s: float
) -> list[HelmStep]:
    """A path of Dubins as turns of at least a degree, each with the straight line after it.

    `helm` are the orders of the turns to port and to starboard, (2,), which have a radius [m] and
    a speed [m/s]; the last course is kept for `settle_s`.
    """
    turns: list[list[float]] = [[0.0, 0.0]]  # heading [deg], seconds
    for side, length in path:
        angle = side * float(np.degrees(length / radius_m))
        if abs(angle) >= 1.0:
            turns.append([angle, 0.0])
        turns[-1][1] += length / speed_m_s
    turns[-1][1] += settle_s
    return [
        HelmStep("turn", seconds, float(helm[int(angle > 0.0)]), angle, False)
        for angle, seconds in turns
        if seconds > 0.0
    ]
