"""A sequence of a steered vessel: what its helm does in turn, with courses steered between.

It is sailed from a sheet: every step lasts a time that is known before.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Literal

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.commands import HEADING, HOLD, Piece, zigzag
from seatrial.models.excitation.helm import SteeredMission
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.recording.recording import Mask, Split, half
from seatrial.models.vessel.basis import Array

ROUNDING = 1e-9  # [rad] by which a turn may fall short of none


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

    @property
    def ends_s(self) -> Array:
        """End of every step [s]."""
        return np.cumsum([step.seconds for step in self.steps])

    def order(self, share: float) -> float:
        """The helm at a share of the way from its start to the upper limit, or the lower one."""
        start = self.input_start[self.index]
        return float(start + abs(share) * (self.limits[int(share > 0.0)] - start))

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
        in_deg = self.helm == "delta"
        for step, end in zip(self.steps, self.ends_s, strict=True):
            order = f"{np.degrees(step.order):.3g} deg" if in_deg else f"{step.order:.4g}"
            turn = f" {step.turn_deg:.0f} deg" if step.turn_deg else ""
            straight = step.kind == "turn" and not turn
            text = "straight" if straight else f"{step.kind}{turn}, {self.helm} {order}"
            yield float(end - step.seconds), text

    def pieces(self, period_s: float) -> Sequence[Piece]:
        """The orders and the courses."""
        pieces: list[Piece] = []
        base = self.input_start[self.index]
        for step, end in zip(self.steps, self.ends_s, strict=True):
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
        """Training: what the helm holds and zig-zags; testing: the turns, or the second half."""
        step = np.searchsorted(self.ends_s, t - t[0], side="right")
        train: Mask = np.array([*(each.kind != "turn" for each in self.steps), False])[step]
        return half(len(t), self.train_fraction) if np.all(train[:-1]) else Split(train, ~train)


def join(
    start: Array, end: Array, radius_m: float, speed_m_s: float, helm: Array, settle_s: float
) -> list[HelmStep]:
    """The shortest arc, line and arc between poses (3,) [m, m, rad], as turns with what follows.

    Of the paths of Dubins (1957), On curves of minimal length, those without a third arc. With c =
    p + i s R exp(i psi), the centre of a turn to the side s (1 to starboard, -1 to port), and p =
    north + i east, the line of length L and course theta between turns to s and e has

        c_e - c_s = (L + i (e - s) R) exp(i theta)

    `helm` are the orders of the turns to port and to starboard, (2,), which have a radius [m] and
    a speed [m/s]; the last course is kept for `settle_s`.
    """
    paths, R = list[list[HelmStep]](), radius_m
    for s, e in product((1, -1), repeat=2):
        sides = R * (e * np.exp(1j * end[2]) - s * np.exp(1j * start[2]))
        apart, aside = complex(*(end - start)[:2]) + 1j * sides, (e - s) * R
        if abs(apart) < abs(aside):
            continue
        line = np.sqrt(abs(apart) ** 2 - aside**2)
        course = np.angle(apart) - np.arctan2(aside, line)
        turns = np.array([s * (course - start[2]), e * (end[2] - course)]) + ROUNDING
        angles = np.maximum(turns % (2.0 * np.pi) - ROUNDING, 0.0)
        seconds = (R * angles + [line, 0.0]) / speed_m_s + [0.0, settle_s]
        degrees = np.degrees(angles * [s, e])
        rows = zip(seconds.tolist(), helm[[int(s > 0), int(e > 0)]], degrees.tolist(), strict=True)
        paths.append([HelmStep("turn", t, float(order), turn) for t, order, turn in rows if t > 0])
    return min(paths, key=lambda steps: sum(step.seconds for step in steps))
