"""A sequence of a steered vessel: what its helm does in turn, with courses steered between.

It is sailed from a sheet: every step lasts a time that is known before.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from annotated_types import MinLen

from seatrial.models.excitation.commands import HEADING, HOLD, Piece, zigzag
from seatrial.models.excitation.helm import SteeredMission
from seatrial.models.planning.planner import shortest_arcs
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.recording.recording import Mask, Split, half
from seatrial.models.vessel.basis import Array


@dataclass(frozen=True)
class HelmStep:
    """What the helm does for `seconds`; `order` is its value [rad, or the unit of the input].

    `hold`: the order. `zigzag`: the order, to the other side whenever the heading has turned by
    `turn_deg`. `turn`: the order until the heading has turned by `turn_deg` (positive to
    starboard), then that course is steered; of 0 deg: the course is kept. Models are identified
    from the first two.
    """

    kind: Literal["hold", "zigzag", "turn"]
    seconds: Positive
    order: float = 0.0
    turn_deg: float = 0.0

    def __post_init__(self) -> None:
        check_ranges(self)


@dataclass(frozen=True, kw_only=True)
class HelmSequence(SteeredMission):
    """Steps in turn, from `start_pose` (north [m], east [m], heading [deg]) at approach speed.

    `expected` is what was expected of it: half the 90 % interval by purpose. `candidates` are what
    `seatrial next` chooses from: steps by name, whose `seconds` are in L / U and whose `order` is a
    share of the way from the start of the helm to its limits. `variants` are factors on both.
    """

    steps: Annotated[tuple[HelmStep, ...], MinLen(1)]
    start_pose: tuple[float, float, float] = (0.0, 0.0, 0.0)
    expected: Mapping[str, float] | None = None
    candidates: Mapping[str, tuple[HelmStep, ...]] | None = None
    variants: Mapping[str, tuple[float, ...]] | None = None

    @property
    def duration_s(self) -> float:
        """Length of all steps [s]."""
        return float(sum(step.seconds for step in self.steps))

    @property
    def start(self) -> Array:
        """The initial pose [m, m, rad], shape (3,)."""
        return np.array([*self.start_pose[:2], np.radians(self.start_pose[2])])

    @property
    def ends_s(self) -> Array:
        """End of every step [s]."""
        return np.cumsum([step.seconds for step in self.steps])

    def rows(self) -> Iterator[tuple[float, str]]:
        """Length [s] of each step, and what the helm does."""
        in_deg = self.helm == "delta"
        for step in self.steps:
            order = f"{np.degrees(step.order):.3g} deg" if in_deg else f"{step.order:.4g}"
            turn = f" {step.turn_deg:.0f} deg" if step.turn_deg else ""
            straight = step.kind == "turn" and not turn
            yield (
                step.seconds,
                "straight" if straight else f"{step.kind}{turn}, {self.helm} {order}",
            )

    def pieces(self, period_s: float) -> Sequence[Piece]:
        """The orders and the courses."""
        pieces: list[Piece] = []
        base = self.input_start[self.index]
        for step, end in zip(self.steps, self.ends_s, strict=True):
            until, turn = round(end / period_s), float(np.radians(step.turn_deg))
            if step.kind == "hold":
                pieces.append(Piece(step.order, until=until))
            elif step.kind == "zigzag":
                pieces += zigzag(step.order, turn, self.side(step.order - base), until, base)
            else:
                turned, side = abs(turn), float(np.sign(turn))
                pieces.append(Piece(step.order, HOLD, until, 2, turned, side))
                pieces.append(Piece(turn, HEADING, until))
        return [*pieces, Piece(0.0, HEADING)]

    def split(self, t: Array) -> Split:
        """Training: what the helm holds and zig-zags; testing: the turns, or the second half."""
        step = np.searchsorted(self.ends_s, t - t[0], side="right")
        train: Mask = np.array([*(each.kind != "turn" for each in self.steps), False])[step]
        return half(len(t), self.train_fraction) if np.all(train[:-1]) else Split(train, ~train)


def join(
    start: Array, end: Array, radius_m: float, speed_m_s: float, helm: Array, settle_s: float
) -> list[HelmStep]:
    """The shortest arc, line and arc between poses (3,) [m, m, rad], as turns with what follows.

    `helm` are the orders of the turns to port and to starboard, (2,), which have a radius [m] and
    a speed [m/s]; the last course is kept for `settle_s`.
    """
    arcs = shortest_arcs(start, end, radius_m)
    first, line, last = arcs.lengths / speed_m_s
    orders, degrees = helm[(arcs.turns > 0.0).astype(int)].tolist(), np.degrees(arcs.turns).tolist()
    rows = zip((first + line, last + settle_s), orders, degrees, strict=True)
    return [HelmStep("turn", float(t), order, turn) for t, order, turn in rows if t > 0.0]
