"""The lattice of poses in restricted waters, and the motion primitives between its poses.

The origin of the lattice is the starting pose: its cells are squares along and across the starting
heading, and its headings are multiples of 45 deg from it.

A primitive is a path from the origin, heading along the first axis: poses (N, 3) [m, m, rad] at the
control instants after the start. Basic primitives end exactly at
another pose of the lattice: a cell ahead, a turn by 45 deg on an arc of (1 + sqrt(2)) cells, or a
turn on the spot. An informative primitive ends where the vessel stops, and a passage to the
nearest pose of the lattice is appended.

Restricted waters: an area, polygonal obstacles in it, and a clearance from both.

Positions are (north, east) [m]. The clearance is the distance of the vessel's reference point:
half its length and a margin. Rounded corners are approximated by polygons outside the arcs, so a
path that counts as clear is never closer than the clearance.

A* search over the lattice. A state is (remaining counts, heading, cell); costs are integer numbers
of control instants. Ljungberg (slides), "Obtaining an experiment trajectory"; Hart, Nilsson and
Raphael (1968).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from heapq import heappop, heappush
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.models.compiled import kernel
from seatrial.models.errors import ConfigurationError
from seatrial.models.ranges import NotNegative, check_ranges
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import in_body, in_ned

if TYPE_CHECKING:
    import shapely
else:
    import lazy_loader

    shapely = lazy_loader.load("shapely")  # slow to import


Integers = NDArray[np.int64]
UNREACHED = np.int64(2**62)


class Moves(NamedTuple):
    """P primitives from H headings on a lattice of I x J cells."""

    di: Integers  # (P, H) displacement in cells
    dj: Integers
    to: Integers  # (P, H) final heading
    cost: Integers  # (P, H) control instants
    stride: Integers  # (P,) of its counter in the index of the counts; 0 for a basic primitive
    valid: NDArray[np.bool_]  # (P, H, I, J) whether the path from the cell is clear


@kernel
def relaxed(moves: Moves, free: NDArray[np.bool_], goal: int) -> Integers:
    """Instants from every place to the goal, by Dijkstra's method, shape (H, I, J).

    Primitives that are `free` (P,) have no cost and may be used any number of times.
    """
    n_p, n_h, n_i, n_j = moves.valid.shape
    best = np.full(n_h * n_i * n_j, UNREACHED)
    done = np.zeros(n_h * n_i * n_j, dtype=np.bool_)
    best[goal] = 0
    heap = [(np.int64(0), np.int64(goal))]
    while len(heap) > 0:
        cost, s = heappop(heap)
        if done[s]:
            continue
        done[s] = True
        h, i, j = s // (n_i * n_j), s // n_j % n_i, s % n_j
        for p in range(n_p):
            for a in range(n_h):
                k, m = i - moves.di[p, a], j - moves.dj[p, a]
                if moves.to[p, a] != h or k < 0 or m < 0 or k >= n_i or m >= n_j:
                    continue
                t = (a * n_i + k) * n_j + m
                total = cost + (np.int64(0) if free[p] else moves.cost[p, a])
                if moves.valid[p, a, k, m] and total < best[t]:
                    best[t] = total
                    heappush(heap, (total, np.int64(t)))
    return best.reshape((n_h, n_i, n_j))


@kernel
def shortest(
    moves: Moves, sizes: Integers, left: Integers, ahead: Integers, start: int, goal: int
) -> tuple[Integers, int]:
    """Primitives of the path of least cost, and the cost [instants]; empty and -1 if none exists.

    `start` and `goal` are places, h I J + i J + j; the path uses all counts. `sizes` (P,) is the
    count of an informative primitive plus one. The cost to go is at least that of the remaining
    manoeuvres, `left` (C,) by their counts, and of the passages if manoeuvres had no cost and no
    limit, `ahead` (H, I, J) by place; this bound is consistent, so no state is expanded twice. Of
    several paths of equal cost the one that was reached first is returned.
    """
    n_p, n_h, n_i, n_j = moves.valid.shape
    places = n_h * n_i * n_j
    n_c = len(left)
    cost = np.full(n_c * places, 2**31 - 1, dtype=np.int32)
    parent = np.full(n_c * places, -1, dtype=np.int32)
    via = np.full(n_c * places, -1, dtype=np.int16)
    done = np.zeros(n_c * places, dtype=np.bool_)
    first = (n_c - 1) * places + start
    cost[first] = 0
    heap = [(np.int64(0), np.int64(first))]
    while len(heap) > 0:
        _, s = heappop(heap)
        if done[s]:
            continue
        done[s] = True
        if s == goal:
            steps, end = [], int(cost[s])
            while parent[s] >= 0:
                steps.append(np.int64(via[s]))
                s = np.int64(parent[s])
            return np.array(steps[::-1], dtype=np.int64), end
        c, place = s // places, s % places
        h, i, j = place // (n_i * n_j), place // n_j % n_i, place % n_j
        for p in range(n_p):
            stride = moves.stride[p]
            if not moves.valid[p, h, i, j] or (stride > 0 and c // stride % sizes[p] == 0):
                continue
            k, m, b = i + moves.di[p, h], j + moves.dj[p, h], moves.to[p, h]
            if ahead[b, k, m] >= UNREACHED:
                continue
            t = (c - stride) * places + (b * n_i + k) * n_j + m
            total = cost[s] + moves.cost[p, h]
            if not done[t] and total < cost[t]:
                cost[t], parent[t], via[t] = total, s, p
                heappush(heap, (total + left[c - stride] + ahead[b, k, m], np.int64(t)))
    return np.zeros(0, dtype=np.int64), -1


Corners = tuple[tuple[float, ...], ...]
QUARTER = 16  # sides of the polygon in a quarter of a circle
OUTSIDE = 1.0 / np.cos(np.pi / (4.0 * QUARTER))  # relative radius of a polygon around the circle


@dataclass(frozen=True)
class Waters:
    """An area and the obstacles in it, each a polygon of (north, east) [m]."""

    area: Corners
    obstacles: tuple[Corners, ...]
    clearance_m: NotNegative

    def __post_init__(self) -> None:
        check_ranges(self)
        for name, corners in self.named.items():
            if len(corners) < 3 or any(len(corner) != 2 for corner in corners):
                raise ConfigurationError(
                    f"{name}: expected at least three corners, each (north, east)"
                )
            if not _polygon(corners).is_valid:
                raise ConfigurationError(f"{name}: the polygon crosses or touches itself")

    @property
    def named(self) -> dict[str, Corners]:
        """Every polygon by the name of its option."""
        return {"area": self.area} | {
            f"obstacles[{i}]": corners for i, corners in enumerate(self.obstacles)
        }

    def free(self, margin_m: float = 0.0) -> "shapely.Geometry":
        """The positions with the clearance and a margin [m], as a shapely geometry."""
        distance = (self.clearance_m + margin_m) * OUTSIDE
        area = shapely.buffer(_polygon(self.area), -distance, quad_segs=QUARTER)
        occupied = shapely.buffer([*map(_polygon, self.obstacles)], distance, quad_segs=QUARTER)
        free = shapely.difference(area, shapely.union_all(occupied)) if self.obstacles else area
        shapely.prepare(free)
        return free

    def in_the_way(self, point: Sequence[float]) -> str | None:
        """Why a vessel cannot be at a point (north, east) [m], in words; None if it can."""
        at, area = shapely.Point(point[0], point[1]), _polygon(self.area)
        if not area.contains(at):
            return "it lies outside area"
        if self.free().covers(at):
            return None
        gaps = {f"obstacles[{i}]": _polygon(c).distance(at) for i, c in enumerate(self.obstacles)}
        gaps["the edge of area"] = area.exterior.distance(at)
        nearest = min(gaps, key=lambda name: gaps[name])
        if gaps[nearest] <= 0.0:
            return f"it lies inside {nearest}"
        return (
            f"it is {gaps[nearest]:.3g} m from {nearest}, expected at least the clearance_m of "
            f"{self.clearance_m:g}"
        )

    def distance(self, points: Array) -> Array:
        """Distance [m], (N,), of points (N, 2) to the nearest obstacle or edge; 0 if not free."""
        area = _polygon(self.area)
        at = shapely.points(points)
        occupied = shapely.union_all([_polygon(corners) for corners in self.obstacles])
        edge = np.where(shapely.covers(area, at), shapely.distance(area.exterior, at), 0.0)
        obstacle = shapely.distance(occupied, at) if self.obstacles else edge
        return np.asarray(np.minimum(edge, obstacle))


def _polygon(corners: Corners) -> "shapely.Polygon":
    return shapely.Polygon(corners)


def simplified(path: Array, tolerance_m: float) -> Array:
    """The corners (n, 2) of a path (N, 2) [m] simplified within a tolerance [m]."""
    if not np.any(path != path[0]):
        return path[:1]
    return np.asarray(shapely.get_coordinates(shapely.LineString(path).simplify(tolerance_m)))


def inside(free: "shapely.Geometry", points: Array) -> NDArray[np.bool_]:
    """Whether points (..., 2) [m] lie in a free geometry, shape (...)."""
    return np.asarray(shapely.intersects_xy(free, points[..., 0], points[..., 1]))


def clear(free: "shapely.Geometry", path: Array, origins: Array) -> NDArray[np.bool_]:
    """Whether a path (n, 2) from each of the origins (M, 2) stays in a free geometry, (M,)."""
    if len(path) == 1:
        return inside(free, origins + path[0])
    lines = shapely.linestrings(origins[:, None, :] + path)
    return np.asarray(shapely.covers(free, lines))


HEADINGS = 8
HEADING_STEP = 2.0 * np.pi / HEADINGS
ARC = 1.0 + np.sqrt(2.0)  # radius, in cells
RUN = np.sqrt(2.0) - 1.0  # straight line between an arc and a pose of the lattice, in cells
STRAY = 0.02  # tolerance of path simplification, in cells; added to the clearance
MOST_CELLS = 250_000
AT_ONCE = 20_000  # paths tested in one call


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


def nearest(pose: Array, cell_m: float) -> Integers:
    """The pose of the lattice nearest to poses (..., 3): cell and heading index, not wrapped."""
    return np.round(pose / (cell_m, cell_m, HEADING_STEP)).astype(np.int64)


def basic(heading: int, cell_m: float, pace: Pace) -> dict[str, Array]:
    """The basic primitives from a heading of the lattice (a multiple of 45 deg), by name."""
    ahead = cell_m * (1.0 if heading % 2 == 0 else np.sqrt(2.0))
    moves = {"straight": pace.line(np.zeros(3), np.array([ahead, 0.0, 0.0]))}
    for side, name in ((1.0, "starboard"), (-1.0, "port")):
        mirrored = np.array([1.0, side, side])
        moves[f"arc_{name}"] = _arc(cell_m, heading % 2 == 1, pace) * mirrored
        moves[f"pivot_{name}"] = pace.line(np.zeros(3), HEADING_STEP * mirrored * [0.0, 0.0, 1.0])
    return moves


def _arc(cell_m: float, run_first: bool, pace: Pace) -> Array:
    """A turn by 45 deg to starboard with a straight line before or after it, (N, 3)."""
    radius, run = ARC * cell_m, RUN * cell_m
    arc = radius * HEADING_STEP
    n = pace.instants(run + arc, HEADING_STEP)
    s = np.linspace(0.0, run + arc, n + 1)[1:]
    turn = np.clip((s - run if run_first else s) / radius, 0.0, HEADING_STEP)
    ahead = s - radius * turn  # sailed straight so far
    along = 0.0 if run_first else HEADING_STEP
    x = radius * np.sin(turn) + ahead * np.cos(along)
    y = radius * (1.0 - np.cos(turn)) + ahead * np.sin(along)
    return np.column_stack([x, y, turn])


def closed(free: Array, heading: int, cell_m: float, pace: Pace, hold: int) -> Array:
    """An informative primitive from a heading, with its passage to the lattice and a rest.

    The path is in the frame of the lattice; the vessel rests for `hold` instants at its end.
    """
    path = turned(free, heading * HEADING_STEP)
    end = nearest(path[-1], cell_m) * np.array([cell_m, cell_m, HEADING_STEP])
    return np.vstack([path, pace.line(path[-1], end), np.tile(end, (hold, 1))])


@dataclass(frozen=True, eq=False)
class Lattice:
    """I x J cells of `cell_m` about the pose `anchor` (north, east, heading) [m, m, rad].

    A place is (heading, row, column); it has a number, h I J + i J + j.
    """

    anchor: Array
    cell_m: float
    first: Integers  # (2,) cell of the first row and column, counted from the anchor
    shape: tuple[int, int]

    @classmethod
    def over(cls, waters: Waters, anchor: Array, cell_m: float) -> "Lattice":
        """The lattice that covers an area."""
        ends = np.transpose([np.min(waters.area, axis=0), np.max(waters.area, axis=0)])
        corners = np.stack(np.meshgrid(*ends), axis=-1).reshape(-1, 2)
        corners_m = in_body(corners - anchor[:2], anchor[2]) / cell_m
        low, high = np.ceil(corners_m.min(axis=0)), np.floor(corners_m.max(axis=0))
        shape = (int(high[0] - low[0] + 1), int(high[1] - low[1] + 1))
        if shape[0] * shape[1] > MOST_CELLS:
            raise ConfigurationError(
                f"cell_m: got {cell_m:g} m, which divides the area into {shape[0]} x {shape[1]} "
                f"cells, expected at most {MOST_CELLS} cells"
            )
        return cls(anchor, cell_m, low.astype(np.int64), shape)

    def nearest(self, pose: Array) -> tuple[int, int, int]:
        """The place nearest to a pose (3,) [m, m, rad]."""
        ahead = in_body(pose[:2] - self.anchor[:2], self.anchor[2])
        *cell, h = nearest(np.array([*ahead, pose[2] - self.anchor[2]]), self.cell_m)
        row, column = cell - self.first
        return int(h) % HEADINGS, int(row), int(column)

    def number(self, place: tuple[int, int, int]) -> int:
        """Number of a place."""
        return int(np.ravel_multi_index(place, (HEADINGS, *self.shape)))

    def pose(self, h: int, row: int, column: int) -> Array:
        """The pose (north, east, heading) [m, m, rad] of a place."""
        return np.array([*self.centres[row, column], self.anchor[2] + h * HEADING_STEP])

    @cached_property
    def centres(self) -> Array:
        """Positions of the cell centres in NED [m], shape (I, J, 2)."""
        cells = np.moveaxis(np.indices(self.shape), 0, -1) + self.first
        relative = np.asarray(self.cell_m * cells, dtype=np.float64)
        return np.asarray(self.anchor[:2] + in_ned(relative, self.anchor[2]))


class Placed(NamedTuple):
    """P primitives from every heading on a lattice: names, paths, and moves between its places."""

    names: tuple[str, ...]
    paths: tuple[tuple[Array, ...], ...]  # P x H, (N, 3) in the frame of the lattice, absolute
    moves: Moves


def placed(
    lattice: Lattice, waters: Waters, informative: Mapping[str, Array], counts: Sequence[int],
    pace: Pace, hold: int,
) -> Placed:  # fmt: skip
    """The informative primitives with their counts, followed by the basic ones, on a lattice."""
    cell_m = lattice.cell_m
    by_heading = [
        {name: closed(path, h, cell_m, pace, hold) for name, path in informative.items()}
        | {name: turned(path, h * HEADING_STEP) for name, path in basic(h, cell_m, pace).items()}
        for h in range(HEADINGS)
    ]
    paths = tuple(zip(*(row.values() for row in by_heading), strict=True))
    ends = nearest(np.array([[path[-1] for path in row] for row in paths]), cell_m)
    margin = STRAY * cell_m
    free = waters.free(margin)
    stride = np.zeros(len(paths), dtype=np.int64)
    stride[: len(counts)] = [math.prod(n + 1 for n in counts[q + 1 :]) for q in range(len(counts))]
    moves = Moves(
        di=ends[..., 0].copy(),
        dj=ends[..., 1].copy(),
        to=ends[..., 2] % HEADINGS,
        cost=np.array([[len(path) for path in row] for row in paths], dtype=np.int64),
        stride=stride,
        valid=np.array([[_valid(lattice, free, path, margin) for path in row] for row in paths]),
    )
    return Placed(tuple(by_heading[0]), paths, moves)


def _valid(
    lattice: Lattice, free: "shapely.Geometry", path: Array, margin: float
) -> NDArray[np.bool_]:
    """Whether a path from each cell is clear and ends on the lattice, shape (I, J)."""
    ends = np.moveaxis(np.indices(lattice.shape), 0, -1) + nearest(path[-1], lattice.cell_m)[:2]
    inner = np.asarray(np.all((ends >= 0) & (ends < lattice.shape), axis=-1))
    centres = lattice.centres
    track = np.vstack([np.zeros((1, 2)), path[:, :2]])
    corners = in_ned(simplified(track, margin), lattice.anchor[2])
    for corner in corners:  # a cheap test that excludes most cells
        inner[inner] = inside(free, centres[inner] + corner)
    cells = np.flatnonzero(inner)
    for block in np.split(cells, range(AT_ONCE, len(cells), AT_ONCE)):
        inner.ravel()[block] = clear(free, corners, centres.reshape(-1, 2)[block])
    return inner
