"""Motion primitives: stretches of a path that lead from one pose of a lattice to another.

A primitive begins at the origin, heading along the first axis. Basic ones lead exactly to another
pose of the lattice: a cell ahead, a turn by 45 deg on an arc of (1 + sqrt(2)) cells, a turn on
the spot. An informative one ends where the vessel does; a passage to the nearest pose closes it.
"""

from dataclasses import dataclass

import numpy as np

from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import in_ned

HEADINGS = 8
STEP = 2.0 * np.pi / HEADINGS
ARC = 1.0 + np.sqrt(2.0)  # radius, in cells
RUN = np.sqrt(2.0) - 1.0  # straight stretch that takes an arc to a pose of the lattice, in cells


@dataclass(frozen=True, eq=False)
class Primitive:
    """A path from the origin; poses (N, 3) [m, m, rad] at the control instants after the start."""

    name: str
    path: Array
    informative: bool = False


@dataclass(frozen=True)
class Pace:
    """How fast passages are sailed, and the time of a control instant."""

    speed_m_s: float
    turn_rate_rad_s: float
    period_s: float

    def instants(self, length_m: float, turn_rad: float) -> int:
        """Control instants of a passage; at least one."""
        time = max(length_m / self.speed_m_s, abs(turn_rad) / self.turn_rate_rad_s)
        return max(1, int(np.ceil(time / self.period_s - 1e-9)))

    def line(self, start: Array, end: Array) -> Array:
        """A straight passage between poses (3,), at even speed, shape (N, 3)."""
        move = end - start
        n = self.instants(float(np.hypot(move[0], move[1])), float(move[2]))
        return np.asarray(start + np.linspace(0.0, 1.0, n + 1)[1:, None] * move)


def turned(path: Array, angle: float) -> Array:
    """A path (N, 3) turned about the origin."""
    return np.column_stack([in_ned(path[:, :2], angle), path[:, 2] + angle])


def nearest(pose: Array, cell_m: float) -> tuple[int, int, int]:
    """The pose of the lattice that is nearest to a pose (3,): cells and heading, not wrapped."""
    i, j = np.round(pose[:2] / cell_m).astype(int)
    return int(i), int(j), round(float(pose[2]) / STEP)


def place_pose(at: tuple[int, int, int], cell_m: float) -> Array:
    """The pose (3,) of a place on the lattice."""
    return np.array([at[0] * cell_m, at[1] * cell_m, at[2] * STEP])


def basic(heading: int, cell_m: float, pace: Pace) -> list[Primitive]:
    """The basic primitives from a heading of the lattice (a multiple of 45 deg)."""
    ahead = cell_m * (1.0 if heading % 2 == 0 else np.sqrt(2.0))
    moves = [Primitive("straight", pace.line(np.zeros(3), np.array([ahead, 0.0, 0.0])))]
    for side, name in ((1.0, "starboard"), (-1.0, "port")):
        arc = _arc(cell_m, heading % 2 == 1, pace)
        arc[:, 1:] *= side
        moves.append(Primitive(f"arc_{name}", arc))
        spot = np.array([0.0, 0.0, side * STEP])
        moves.append(Primitive(f"pivot_{name}", pace.line(np.zeros(3), spot)))
    return moves


def _arc(cell_m: float, run_first: bool, pace: Pace) -> Array:
    """A turn by 45 deg to starboard with its straight stretch before or after it, (N, 3)."""
    radius, run = ARC * cell_m, RUN * cell_m
    bow = radius * STEP
    n = pace.instants(run + bow, STEP)
    s = np.linspace(0.0, run + bow, n + 1)[1:]
    turn = np.clip((s - run if run_first else s) / radius, 0.0, STEP)
    ahead = s - radius * turn  # sailed straight so far
    along = 0.0 if run_first else STEP
    x = radius * np.sin(turn) + ahead * np.cos(along)
    y = radius * (1.0 - np.cos(turn)) + ahead * np.sin(along)
    return np.column_stack([x, y, turn])


def closed(free: Primitive, heading: int, cell_m: float, pace: Pace, hold: int) -> Primitive:
    """An informative primitive from a heading, with its passage to the lattice and a rest.

    The path is in the frame of the lattice and `hold` instants long at its end.
    """
    path = turned(free.path, heading * STEP)
    end = place_pose(nearest(path[-1], cell_m), cell_m)
    rest = np.tile(end, (hold, 1))
    whole = np.vstack([path, pace.line(path[-1], end), rest])
    return Primitive(free.name, whole, informative=True)
