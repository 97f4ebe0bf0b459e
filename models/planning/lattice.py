"""The lattice of poses in restricted waters, and the motion primitives between its poses.

The origin of the lattice is the starting pose: its cells are squares along and across the starting
heading, and its headings are multiples of 45 deg from it.

A primitive starts at the origin, heading along the first axis. Basic primitives end exactly at
another pose of the lattice: a cell ahead, a turn by 45 deg on an arc of (1 + sqrt(2)) cells, or a
turn on the spot. An informative primitive ends where the vessel stops, and a passage to the
nearest pose of the lattice is appended.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError
from seatrial.models.planning.a_star import Integers
from seatrial.models.planning.waters import Waters, clear, inside, simplified
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import in_body, in_ned

if TYPE_CHECKING:
    import shapely

HEADINGS = 8
STEP = 2.0 * np.pi / HEADINGS
ARC = 1.0 + np.sqrt(2.0)  # radius, in cells
RUN = np.sqrt(2.0) - 1.0  # straight line between an arc and a pose of the lattice, in cells
STRAY = 0.02  # tolerance of path simplification, in cells; added to the clearance
MOST_CELLS = 250_000
AT_ONCE = 20_000  # paths tested in one call


@dataclass(frozen=True, eq=False)
class Primitive:
    """A path from the origin; poses (N, 3) [m, m, rad] at the control instants after the start."""

    name: str
    path: Array
    informative: bool = False


@dataclass(frozen=True)
class Pace:
    """Speeds of passages, and the control period."""

    speed_m_s: float
    turn_rate_rad_s: float
    period_s: float

    def instants(self, length_m: float, turn_rad: float) -> int:
        """Control instants of a passage; at least one."""
        time = max(length_m / self.speed_m_s, abs(turn_rad) / self.turn_rate_rad_s)
        return max(1, int(np.ceil(time / self.period_s - 1e-9)))

    def line(self, start: Array, end: Array) -> Array:
        """A straight passage between poses (3,) [m, m, rad] at constant speed, shape (N, 3)."""
        move = end - start
        n = self.instants(float(np.hypot(move[0], move[1])), float(move[2]))
        return np.asarray(start + np.linspace(0.0, 1.0, n + 1)[1:, None] * move)


def turned(path: Array, angle: float) -> Array:
    """A path (N, 3) rotated about the origin by an angle [rad]."""
    return np.column_stack([in_ned(path[:, :2], angle), path[:, 2] + angle])


def nearest(pose: Array, cell_m: float) -> tuple[int, int, int]:
    """The pose of the lattice nearest to a pose (3,): cell and heading index, not wrapped."""
    i, j = np.round(pose[:2] / cell_m).astype(int)
    return int(i), int(j), round(float(pose[2]) / STEP)


def place_pose(at: tuple[int, int, int], cell_m: float) -> Array:
    """The pose (3,) [m, m, rad] of a place on the lattice."""
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
    """A turn by 45 deg to starboard with a straight line before or after it, (N, 3)."""
    radius, run = ARC * cell_m, RUN * cell_m
    arc = radius * STEP
    n = pace.instants(run + arc, STEP)
    s = np.linspace(0.0, run + arc, n + 1)[1:]
    turn = np.clip((s - run if run_first else s) / radius, 0.0, STEP)
    ahead = s - radius * turn  # sailed straight so far
    along = 0.0 if run_first else STEP
    x = radius * np.sin(turn) + ahead * np.cos(along)
    y = radius * (1.0 - np.cos(turn)) + ahead * np.sin(along)
    return np.column_stack([x, y, turn])


def closed(free: Primitive, heading: int, cell_m: float, pace: Pace, hold: int) -> Primitive:
    """An informative primitive from a heading, with its passage to the lattice and a rest.

    The path is in the frame of the lattice; the vessel rests for `hold` instants at its end.
    """
    path = turned(free.path, heading * STEP)
    end = place_pose(nearest(path[-1], cell_m), cell_m)
    rest = np.tile(end, (hold, 1))
    poses = np.vstack([path, pace.line(path[-1], end), rest])
    return Primitive(free.name, poses, informative=True)


@dataclass(frozen=True, eq=False)
class Lattice:
    """I x J cells of `cell_m` about the pose `anchor` (north, east, heading) [m, m, rad]."""

    anchor: Array
    cell_m: float
    first: tuple[int, int]  # cell of the first row and column, counted from the anchor
    shape: tuple[int, int]

    @classmethod
    def over(cls, waters: Waters, anchor: Array, cell_m: float) -> "Lattice":
        """The lattice that covers an area."""
        n0, n1, e0, e1 = waters.bounds
        corners = np.array([(n, e) for n in (n0, n1) for e in (e0, e1)])
        corners_m = in_body(corners - anchor[:2], anchor[2]) / cell_m
        low, high = np.ceil(corners_m.min(axis=0)), np.floor(corners_m.max(axis=0))
        shape = (int(high[0] - low[0] + 1), int(high[1] - low[1] + 1))
        if shape[0] * shape[1] > MOST_CELLS:
            raise ConfigurationError(
                f"cell_m: got {cell_m:g} m, which divides the area into {shape[0]} x {shape[1]} "
                f"cells, expected at most {MOST_CELLS} cells"
            )
        return cls(anchor, cell_m, (int(low[0]), int(low[1])), shape)

    def place(self, pose: Array) -> int:
        """Number of the place nearest to a pose (north, east, heading) [m, m, rad]."""
        relative = pose - self.anchor
        relative[:2] = in_body(relative[:2], self.anchor[2])
        return self.number(*nearest(relative, self.cell_m))

    def number(self, i: int, j: int, h: int) -> int:
        """Number of the place in a cell, counted from the anchor, and a heading."""
        row, column = i - self.first[0], j - self.first[1]
        return ((h % HEADINGS) * self.shape[0] + row) * self.shape[1] + column

    def pose(self, place: int) -> Array:
        """The pose (north, east, heading) [m, m, rad] of a place."""
        h, i, j = np.unravel_index(place, (HEADINGS, *self.shape))
        relative = np.array([i + self.first[0], j + self.first[1]], dtype=np.float64) * self.cell_m
        return np.array(
            [*(self.anchor[:2] + in_ned(relative, self.anchor[2])), self.anchor[2] + h * STEP]
        )

    @property
    def centres(self) -> Array:
        """Positions of the cell centres in NED [m], shape (I, J, 2)."""
        i, j = (np.arange(n) + first for n, first in zip(self.shape, self.first, strict=True))
        relative = self.cell_m * np.stack(np.meshgrid(i, j, indexing="ij"), axis=-1).astype(
            np.float64
        )
        return np.asarray(self.anchor[:2] + in_ned(relative, self.anchor[2]))


@dataclass(frozen=True, eq=False)
class Placed:
    """P primitives from every heading: paths, final places, and the cells where they are clear."""

    names: tuple[str, ...]
    paths: tuple[tuple[Array, ...], ...]  # P x H, (N, 3) in the frame of the lattice, absolute
    di: Integers  # (P, H)
    dj: Integers
    to: Integers
    cost: Integers
    valid: NDArray[np.bool_]  # (P, H, I, J)


def placed(
    lattice: Lattice, waters: Waters, informative: Sequence[Primitive], pace: Pace, hold: int
) -> Placed:
    """The informative primitives, followed by the basic ones, on a lattice."""
    by_heading = [
        [closed(primitive, h, lattice.cell_m, pace, hold) for primitive in informative]
        + [
            replace(primitive, path=turned(primitive.path, h * STEP))
            for primitive in basic(h, lattice.cell_m, pace)
        ]
        for h in range(HEADINGS)
    ]
    paths = tuple(zip(*([primitive.path for primitive in row] for row in by_heading), strict=True))
    ends = np.array([[nearest(path[-1], lattice.cell_m) for path in row] for row in paths])
    margin = STRAY * lattice.cell_m
    free = waters.free(margin)
    return Placed(
        names=tuple(primitive.name for primitive in by_heading[0]),
        paths=paths,
        di=ends[..., 0].astype(np.int64),
        dj=ends[..., 1].astype(np.int64),
        to=(ends[..., 2] % HEADINGS).astype(np.int64),
        cost=np.array([[len(path) for path in row] for row in paths], dtype=np.int64),
        valid=np.array([[_valid(lattice, free, path, margin) for path in row] for row in paths]),
    )


def _valid(
    lattice: Lattice, free: "shapely.Geometry", path: Array, margin: float
) -> NDArray[np.bool_]:
    """Whether a path from each cell is clear and ends on the lattice, shape (I, J)."""
    i, j, _ = nearest(path[-1], lattice.cell_m)
    rows, columns = np.indices(lattice.shape)
    inner = (rows + i >= 0) & (rows + i < lattice.shape[0])
    inner &= (columns + j >= 0) & (columns + j < lattice.shape[1])
    centres = lattice.centres
    track = np.vstack([np.zeros((1, 2)), path[:, :2]])
    corners = in_ned(simplified(track, margin), lattice.anchor[2])
    for corner in corners:  # a cheap test that excludes most cells
        inner[inner] = inside(free, centres[inner] + corner)
    cells = np.flatnonzero(inner)
    origins = centres.reshape(-1, 2)[cells]
    for a in range(0, len(cells), AT_ONCE):
        block = slice(a, a + AT_ONCE)
        inner.ravel()[cells[block]] = clear(free, corners, origins[block])
    return inner
