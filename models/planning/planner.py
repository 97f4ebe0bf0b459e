"""Plans a path with a prescribed number of each manoeuvre, between two poses, clear of obstacles.

    min sum_k J(m_k),  x_0 = x_s,  x_M = x_f,  x_k+1 = f(x_k, m_k),  c(m_k, x_k) in X_free

Ljungberg (slides), "Obtaining an experiment trajectory". J is time. Counters of the remaining
manoeuvres in the state of the search ensure the composition of the mix: a state is (remaining
counts, heading, cell), the search is A*, costs are integer numbers of control instants; Hart,
Nilsson and Raphael (1968).

The origin of the lattice is the starting pose: its cells are squares along and across the starting
heading, and its headings are multiples of 45 deg from it. A primitive is a path from the origin,
heading along the first axis: poses (N, 3) [m, m, rad] at the control instants after the start.
Basic primitives end exactly at another pose of the lattice: a cell ahead, a turn by 45 deg on an
arc of (1 + sqrt(2)) cells, or a turn on the spot. An informative primitive ends where the vessel
stops, and a passage to the nearest pose of the lattice is appended.

Positions are (north, east) [m]. The clearance is the distance of the vessel's reference point from
the edge of the area and from obstacles: half its length and a margin. Rounded corners are
approximated by polygons outside the arcs, so a path that counts as clear is never closer.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy
from numpy.typing import NDArray

from seatrial.models.compiled import kernel
from seatrial.models.errors import ConfigurationError
from seatrial.models.ranges import NotNegative, check_ranges
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import in_body, in_ned, wrap

if TYPE_CHECKING:
    import shapely
else:
    import lazy_loader

    shapely = lazy_loader.load("shapely")  # slow to import

Integers = NDArray[np.int64]
Corners = tuple[tuple[float, ...], ...]
UNREACHED = np.int64(2**62)
QUARTER = 16  # sides of the polygon in a quarter of a circle
OUTSIDE = 1.0 / np.cos(np.pi / (4.0 * QUARTER))  # relative radius of a polygon around the circle
HEADINGS = 8
HEADING_STEP = 2.0 * np.pi / HEADINGS
ARC = 1.0 + np.sqrt(2.0)  # radius, in cells
RUN = np.sqrt(2.0) - 1.0  # straight line between an arc and a pose of the lattice, in cells
STRAY = 0.02  # tolerance of path simplification, in cells; added to the clearance
MOST_CELLS, MOST_STATES = 250_000, 30_000_000


class Moves(NamedTuple):
    """P primitives from H headings on a lattice of I x J cells."""

    di: Integers  # (P, H) displacement in cells
    dj: Integers
    to: Integers  # (P, H) final heading
    cost: Integers  # (P, H) control instants
    size: Integers  # (P,) count of an informative primitive plus one; 1 for a basic one
    stride: Integers  # (P,) of its counter in the index of the counts; 0 for a basic primitive
    valid: NDArray[np.bool_]  # (P, H, I, J) whether the path from the cell is clear


def relaxed(moves: Moves, free: NDArray[np.bool_], goal: int) -> Integers:
    """Instants from every place to the goal, by Dijkstra's method, shape (H, I, J).

    Primitives that are `free` (P,) have no cost and may be used any number of times.
    """
    p, h, i, j = np.nonzero(moves.valid)
    shape = moves.valid.shape[1:]
    count = int(np.prod(shape))
    start = np.ravel_multi_index((h, i, j), shape)
    end = np.ravel_multi_index((moves.to[p, h], i + moves.di[p, h], j + moves.dj[p, h]), shape)
    cost = np.where(free[p], 0, moves.cost[p, h])
    order = np.argsort(cost)  # of several from place to place the cheapest counts
    back, first = np.unique((end * count + start)[order], return_index=True)
    graph = scipy.sparse.csr_array((cost[order][first], divmod(back, count)), (count, count))
    instants = scipy.sparse.csgraph.dijkstra(graph, indices=goal)
    instants[np.isinf(instants)] = UNREACHED
    return np.asarray(instants.reshape(shape), dtype=np.int64)


@kernel
def shortest(
    moves: Moves, left: Integers, ahead: Integers, start: int, goal: int
) -> tuple[Integers, int]:
    """Primitives of the path of least cost, and the cost [instants]; empty and -1 if none exists.

    `start` and `goal` are places, h I J + i J + j; the path uses all counts. The cost to go is at
    least that of the remaining manoeuvres, `left` (C,) by their counts, and of the passages if
    manoeuvres had no cost and no limit, `ahead` (H, I, J) by place; this bound is consistent, so no
    state is expanded twice. Of several paths of equal cost the one that was reached first is
    returned.
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
            if not moves.valid[p, h, i, j] or (stride > 0 and c // stride % moves.size[p] == 0):
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


@dataclass(frozen=True, eq=False)
class Waters:
    """An area and the obstacles in it, each a polygon of (north, east) [m]."""

    area: Corners | Array
    obstacles: Sequence[Corners | Array]
    clearance_m: NotNegative

    def __post_init__(self) -> None:
        check_ranges(self)
        for name, corners in self.named.items():
            if len(corners) < 3 or any(len(corner) != 2 for corner in corners):
                raise ConfigurationError(
                    f"{name}: expected at least three corners, each (north, east)"
                )
            if not shapely.Polygon(corners).is_valid:
                raise ConfigurationError(f"{name}: the polygon crosses or touches itself")

    @property
    def named(self) -> dict[str, Corners | Array]:
        """Every polygon by the name of its option."""
        solid = {f"obstacles[{i}]": corners for i, corners in enumerate(self.obstacles)}
        return {"area": self.area, **solid}

    def free(self, margin_m: float = 0.0) -> "shapely.Geometry":
        """The positions with the clearance and a margin [m], as a shapely geometry."""
        distance = (self.clearance_m + margin_m) * OUTSIDE
        area, *solid = map(shapely.Polygon, self.named.values())
        occupied = shapely.union_all(shapely.buffer(solid, distance, quad_segs=QUARTER))
        area = shapely.buffer(area, -distance, quad_segs=QUARTER)
        free = shapely.difference(area, occupied)
        shapely.prepare(free)
        return free

    def in_the_way(self, point: Array) -> str | None:
        """Why a vessel cannot be at a point (north, east) [m], in words; None if it can."""
        if inside(self.free(), point):
            return None
        if not (room := self.distance(point)):
            return "it lies outside area or inside an obstacle"
        return (
            f"it is {room:.3g} m from the nearest edge or obstacle, expected at least the "
            f"clearance_m of {self.clearance_m:g}"
        )

    def distance(self, points: Array) -> Array:
        """Distance [m], (...), of points (..., 2) to the nearest obstacle or edge; 0 on land."""
        area, *solid = map(shapely.Polygon, self.named.values())
        at, free = shapely.points(points), shapely.difference(area, shapely.union_all(solid))
        return np.where(shapely.covers(free, at), shapely.distance(free.boundary, at), 0.0)


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
class PlanningTask:
    """A planning task: the waters, the informative primitives and their counts, start and goal.

    `start` and `goal` are (north, east, heading) [m, m, rad]. The vessel rests for `hold` control
    instants after each manoeuvre.
    """

    waters: Waters
    primitives: Mapping[str, Array]
    counts: Mapping[str, int]
    start: Array
    goal: Array
    cell_m: float
    pace: Pace
    hold: int = 0

    @property
    def used(self) -> dict[str, Array]:
        """The primitives with a positive count."""
        return {name: path for name, path in self.primitives.items() if self.counts.get(name, 0)}

    def positions(self, cells: Integers) -> Array:
        """Centres in NED [m] of cells (..., 2) that are counted from the start."""
        relative = np.asarray(self.cell_m * cells, dtype=np.float64)
        return np.asarray(self.start[:2] + in_ned(relative, self.start[2]))


class Leg(NamedTuple):
    """A primitive of a plan, with its poses (N, 3) [m, m, rad] at the instants after its start."""

    name: str
    informative: bool
    poses: Array


@dataclass(frozen=True, eq=False)
class PlannedPath:
    """The planned path."""

    legs: tuple[Leg, ...]
    start: Array
    cost: int  # control instants, without the passage from the lattice to the goal and the rest

    @property
    def poses(self) -> Array:
        """All poses from the start to the goal, (N + 1, 3) [m, m, rad]."""
        return np.vstack([self.start[None, :], *(leg.poses for leg in self.legs)])


@dataclass(frozen=True, eq=False)
class Setting:
    """A task on a lattice of I x J cells about its start, in the frame of which paths are given.

    A place is (heading, row, column); it has a number, h I J + i J + j, as `start` and `goal`.
    """

    task: PlanningTask
    names: tuple[str, ...]  # of P primitives, the informative ones first
    paths: tuple[tuple[Array, ...], ...]  # P x H, (N, 3) from a heading
    moves: Moves
    start: int
    goal: int

    def bounds(self) -> tuple[Integers, Integers]:
        """Lower bounds of the cost to go [instants]: by remaining counts, and by place."""
        n, moves = len(self.task.used), self.moves
        digits = np.indices(moves.size[:n].tolist()).reshape(n, -1 if n else 1)
        left = np.min(moves.cost[:n], axis=1) @ digits
        return left, relaxed(moves, np.arange(len(self.names)) < n, self.goal)


def plan(task: PlanningTask) -> PlannedPath:
    """The path of least time; raises ConfigurationError with the reason if there is none."""
    setting = set_up(task)
    steps, cost = shortest(setting.moves, *setting.bounds(), setting.start, setting.goal)
    if cost < 0:
        raise ConfigurationError(
            "no sequence of the manoeuvres with arcs and turns between them connects start and "
            f"goal with a cell_m of {task.cell_m:g} and a clearance_m of "
            f"{task.waters.clearance_m:g}, expected smaller ones, or a way between the obstacles"
        )
    return PlannedPath(tuple(_legs(setting, steps)), task.start, cost)


def set_up(task: PlanningTask) -> Setting:
    """Place the primitives, the start and the goal of a task on its lattice.

    Raises ConfigurationError where one of them does not fit.
    """
    waters = task.waters
    for name, pose in (("start", task.start), ("goal", task.goal)):
        obstacle = waters.in_the_way(pose[:2])
        if obstacle is not None:
            raise ConfigurationError(f"{name} at ({pose[0]:g}, {pose[1]:g}) m: {obstacle}")
    edges = in_body(np.array(waters.area) - task.start[:2], task.start[2]) / task.cell_m
    low = np.ceil(edges.min(axis=0)).astype(np.int64)
    shape = (np.floor(edges.max(axis=0)).astype(np.int64) - low + 1).tolist()
    counts = [task.counts[name] for name in task.used]
    states = math.prod(shape) * HEADINGS * math.prod(n + 1 for n in counts)
    if math.prod(shape) > MOST_CELLS or states > MOST_STATES:
        raise ConfigurationError(
            f"cell_m: got {task.cell_m:g} m, for which the area has {shape[0]} x {shape[1]} cells "
            f"and the search {states:.2g} states with counts {counts}, expected at most "
            f"{MOST_CELLS:.2g} and {MOST_STATES:.2g}; use a larger cell_m or fewer sub-experiments"
        )
    by_heading = [primitives(task, h) for h in range(HEADINGS)]
    paths = tuple(zip(*(row.values() for row in by_heading), strict=True))
    cells = np.moveaxis(np.indices(shape), 0, -1) + low
    moves = _moves(paths, task.cell_m, counts, _valid(task, cells, paths))
    for name, own, valid in zip(task.used, paths, moves.valid, strict=False):
        if not np.any(valid):
            along, across = np.ptp(own[0][:, :2], axis=0)
            raise ConfigurationError(
                f"{name} takes {along:.3g} m along and {across:.3g} m across its first heading and "
                "does not fit anywhere in the area between the obstacles"
            )
    ends = np.array([(0, 0, 0), _arrival(task, cells)]) - (0, *low)
    start, goal = np.ravel_multi_index(ends.T, (HEADINGS, *shape)).tolist()
    return Setting(task, tuple(by_heading[0]), paths, moves, start, goal)


def _moves(
    paths: Sequence[Sequence[Array]], cell_m: float, counts: Sequence[int],
    valid: NDArray[np.bool_],
) -> Moves:  # fmt: skip
    """The moves of primitives, of which the first ones are informative and have counts."""
    ends = nearest(np.array([[path[-1] for path in row] for row in paths]), cell_m)
    own, rest = [n + 1 for n in counts], len(paths) - len(counts)
    strides = [math.prod(own[q + 1 :]) for q in range(len(own))]
    size, stride = np.array([[*own, *[1] * rest], [*strides, *[0] * rest]], dtype=np.int64)
    cost = np.array([[len(path) for path in row] for row in paths], dtype=np.int64)
    di, dj, to = np.moveaxis(ends, -1, 0).copy()
    return Moves(di, dj, to % HEADINGS, cost, size, stride, valid)


def primitives(task: PlanningTask, heading: int) -> dict[str, Array]:
    """The informative primitives from a heading of the lattice, followed by the basic ones."""
    cell_m, pace = task.cell_m, task.pace
    own = {name: closed(path, heading, cell_m, pace, task.hold) for name, path in task.used.items()}
    moves = basic(heading, cell_m, pace)
    return own | {name: turned(path, heading * HEADING_STEP) for name, path in moves.items()}


def _valid(
    task: PlanningTask, cells: Integers, paths: Sequence[Sequence[Array]]
) -> NDArray[np.bool_]:
    """Whether paths from cells (I, J, 2) are clear and end on the lattice, (P, H, I, J)."""
    margin, turn = STRAY * task.cell_m, task.start[2]
    free, centres = task.waters.free(margin), task.positions(cells)

    def from_cells(path: Array) -> NDArray[np.bool_]:
        ends = cells + nearest(path[-1], task.cell_m)[:2]
        inner = np.asarray(np.all((ends >= cells[0, 0]) & (ends <= cells[-1, -1]), axis=-1))
        corners = in_ned(simplified(np.vstack([np.zeros(2), path[:, :2]]), margin), turn)
        for corner in corners:  # a cheap test that excludes most cells
            inner[inner] = inside(free, centres[inner] + corner)
        inner[inner] = clear(free, corners, centres[inner])
        return inner

    return np.array([[from_cells(path) for path in row] for row in paths])


def _arrival(task: PlanningTask, cells: Integers) -> tuple[int, int, int]:
    """Heading and cell nearest to the goal with a clear straight passage to it."""
    free, goal = task.waters.free(), task.goal[:2]
    ahead = in_body(goal - task.start[:2], task.start[2])
    *cell, h = nearest(np.array([*ahead, task.goal[2] - task.start[2]]), task.cell_m)
    around = cells[np.max(np.abs(cells - cell), axis=-1) <= 1]
    centres = task.positions(around)
    for k in np.argsort(np.hypot(*(centres - goal).T), kind="stable"):
        if clear(free, np.vstack([np.zeros(2), goal - centres[k]]), centres[k][None])[0]:
            return int(h) % HEADINGS, *around[k].tolist()
    raise ConfigurationError(
        f"goal at ({goal[0]:g}, {goal[1]:g}) m: there is no clear passage from a neighbouring "
        f"pose of the lattice, expected a cell_m smaller than {task.cell_m:g}"
    )


def _legs(setting: Setting, steps: Integers) -> list[Leg]:
    """The primitives of a path in NED with unwrapped headings, the final passage and the rest."""
    task, moves, turn = setting.task, setting.moves, setting.task.start[2]
    h, cell, pose, legs = 0, np.zeros(2), task.start.copy(), []
    for p in steps:
        path = setting.paths[p][h]
        position = task.start[:2] + in_ned(task.cell_m * cell + path[:, :2], turn)
        poses = np.column_stack([position, pose[2] + path[:, 2] - h * HEADING_STEP])
        legs.append(Leg(setting.names[p], p < len(task.used), poses))
        pose, cell = poses[-1], cell + np.array([moves.di[p, h], moves.dj[p, h]])
        h = int(moves.to[p, h])
    end = task.goal.copy()
    end[2] = pose[2] + wrap(end[2] - pose[2])
    rest = np.tile(end, (task.hold, 1))
    passage = task.pace.line(pose, end) if np.max(np.abs(end - pose)) > 1e-9 else rest[:0]
    if len(passage) + len(rest):
        legs.append(Leg("arrival", False, np.vstack([passage, rest])))
    return legs
