"""Plans a path with a prescribed number of each manoeuvre, between two poses, clear of obstacles.

    min sum_k J(m_k),  x_0 = x_s,  x_M = x_f,  x_k+1 = f(x_k, m_k),  c(m_k, x_k) in X_free

Ljungberg (slides), "Obtaining an experiment trajectory". J is time in control instants. Counters of
the remaining manoeuvres ensure the composition of the mix: a state of the search, A* of Hart,
Nilsson and Raphael (1968), is (remaining counts, heading, cell).

The origin of the lattice is the starting pose: its cells are squares along and across the starting
heading, and its headings are multiples of 45 deg from it. A primitive is a path from the origin,
heading along the first axis: poses (N, 3) [m, m, rad] at the control instants after the start.
Basic primitives end at another pose of the lattice: a cell ahead, a turn by 45 deg on an arc of
(1 + sqrt(2)) cells, or a turn on the spot. An informative primitive ends where the vessel stops,
and a passage to the nearest pose of the lattice is appended.

Positions are (north, east) [m]. The clearance is the distance of the vessel's reference point from
the edge of the area and from obstacles: half its length and a margin. Rounded corners are
approximated by polygons outside the arcs, so a path that counts as clear is never closer.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import product
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
ROUNDING = 1e-9  # [rad] by which a turn may fall short of none
STRAY = 0.02  # tolerance of path simplification, in cells; added to the clearance
MOST_CELLS, MOST_STATES = 250_000, 30_000_000


class Moves(NamedTuple):
    """P primitives, the informative Q first, from S places h I J + i J + j of the lattice."""

    end: Integers  # (P, S) the place that each leads to; -1: it is not clear
    cost: Integers  # (P, H) control instants
    size: Integers  # (Q,) count plus one
    stride: Integers  # (Q,) of the counter in the index of the counts


def bounds(moves: Moves, goal: int) -> tuple[Integers, Integers]:
    """Lower bounds of the cost to go [instants]: by remaining counts (C,), and by place (S,).

    The first is the cost of the remaining manoeuvres, the second that of the passages if
    manoeuvres had no cost and no limit, by Dijkstra's method.
    """
    count = np.arange(np.prod(moves.size)) // moves.stride[:, None] % moves.size[:, None]  # (Q, C)
    left = np.min(moves.cost[: len(count)], axis=1) @ count
    p, start = np.nonzero(moves.end >= 0)
    end, places = moves.end[p, start], moves.end.shape[1]
    cost = np.where(p < len(count), 0, moves.cost[p, start * HEADINGS // places])
    order = np.argsort(cost)  # of several from place to place the cheapest counts
    back, first = np.unique((end * places + start)[order], return_index=True)
    graph = scipy.sparse.csr_array((cost[order][first], divmod(back, places)), (places, places))
    ahead = scipy.sparse.csgraph.dijkstra(graph, indices=goal)
    return left, np.where(np.isinf(ahead), UNREACHED, ahead).astype(np.int64)


@kernel
def shortest(
    moves: Moves, left: Integers, ahead: Integers, start: int, goal: int
) -> tuple[Integers, int]:
    """Primitives of the path of least cost, and the cost [instants]; empty and -1 if none exists.

    The path from place to place uses all counts. The sum of `bounds` is consistent, so no state is
    expanded twice. Of several paths of equal cost the one that was reached first is returned.
    """
    (n_p, places), n_q = moves.end.shape, len(moves.size)
    n_c, cells = len(left), places // HEADINGS
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
        for p in range(n_p):
            to, left_c = moves.end[p, place], c - (moves.stride[p] if p < n_q else 0)
            used_up = p < n_q and c // moves.stride[p] % moves.size[p] == 0
            if used_up or to < 0 or ahead[to] >= UNREACHED:
                continue
            t = left_c * places + to
            total = cost[s] + moves.cost[p, place // cells]
            if not done[t] and total < cost[t]:
                cost[t], parent[t], via[t] = total, s, p
                heappush(heap, (total + left[left_c] + ahead[to], np.int64(t)))
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
            pairs = len(corners) > 2 and all(len(corner) == 2 for corner in corners)
            if not (pairs and shapely.Polygon(corners).is_valid):
                raise ConfigurationError(
                    f"{name}: expected at least three corners (north, east) of a polygon that does "
                    "not cross or touch itself"
                )

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
        return None if inside(self.free(), point) else (
            f"it is {self.distance(point):.3g} m from the nearest edge or obstacle (0: no water), "
            f"expected at least the clearance_m of {self.clearance_m:g}"
        )  # fmt: skip

    def distance(self, points: Array) -> Array:
        """Distance [m], (...), of points (..., 2) to the nearest obstacle or edge; 0 on land."""
        area, *solid = map(shapely.Polygon, self.named.values())
        at, free = shapely.points(points), shapely.difference(area, shapely.union_all(solid))
        return np.where(shapely.covers(free, at), shapely.distance(free.boundary, at), 0.0)


def simplified(path: Array, tolerance_m: float) -> Array:
    """The corners (n, 2) of a path (N, 2) [m] simplified within a tolerance [m]."""
    line = shapely.remove_repeated_points(shapely.LineString(path))  # those of a turn on the spot
    return np.asarray(shapely.get_coordinates(line.simplify(tolerance_m)))


def inside(free: "shapely.Geometry", points: Array) -> NDArray[np.bool_]:
    """Whether points (..., 2) [m] lie in a free geometry, shape (...)."""
    return np.asarray(shapely.intersects_xy(free, points[..., 0], points[..., 1]))


def clear(free: "shapely.Geometry", path: Array, origins: Array) -> NDArray[np.bool_]:
    """Whether a path (n, 2) from each of the origins (M, 2) stays in a free geometry, (M,)."""
    return np.asarray(shapely.covers(free, shapely.linestrings(origins[:, None, :] + path)))


@dataclass(frozen=True)
class Pace:
    """Speeds of passages, and the control period."""

    speed_m_s: float
    turn_rate_rad_s: float
    period_s: float

    def shares(self, length_m: float, turn_rad: float) -> Array:
        """Shares of a passage at the control instants after its start, the last 1, shape (N,)."""
        time = max(length_m / self.speed_m_s, abs(turn_rad) / self.turn_rate_rad_s)
        count = max(1, int(np.ceil(time / self.period_s - 1e-9)))
        return np.linspace(0.0, 1.0, count + 1)[1:]

    def line(self, start: Array, end: Array) -> Array:
        """A straight passage between poses (3,) [m, m, rad] at constant speed, shape (N, 3)."""
        move = end - start
        return start + self.shares(float(np.hypot(*move[:2])), move[2])[:, None] * move


def turned(path: Array, angle: float) -> Array:
    """A path (N, 3) rotated about the origin by an angle [rad]."""
    return np.column_stack([in_ned(path[:, :2], angle), path[:, 2] + angle])


def nearest(pose: Array, cell_m: float) -> Integers:
    """The pose of the lattice nearest to poses (..., 3): cell and heading index, not wrapped."""
    return np.round(pose / (cell_m, cell_m, HEADING_STEP)).astype(np.int64)


class Arcs(NamedTuple):
    """An arc, a line and an arc of the same radius."""

    turns: Array  # (2,) [rad], positive to starboard
    line_m: float
    radius_m: float

    @property
    def lengths(self) -> Array:
        """Of the three parts [m], shape (3,)."""
        first, last = self.radius_m * np.abs(self.turns)
        return np.array([first, self.line_m, last])

    def poses(self, shares: Array) -> Array:
        """Poses (N, 3) [m, m, rad] at shares (N,) of the whole length, from the origin."""
        lengths = self.lengths
        s = shares[:, None] * np.sum(lengths) - (np.cumsum(lengths) - lengths)
        first, last = np.sign(self.turns) / self.radius_m
        turned = np.clip(s, 0.0, lengths) * (first, 0.0, last)
        chord = np.clip(s, 0.0, lengths) * np.sinc(turned / (2.0 * np.pi))
        course = np.cumsum(turned, axis=1) - 0.5 * turned
        moves = chord * np.cos(course), chord * np.sin(course), turned
        return np.asarray(np.sum(moves, axis=2).T)


def shortest_arcs(start: Array, end: Array, radius_m: float) -> Arcs:
    """The shortest arc, line and arc between poses (3,) [m, m, rad].

    Of the paths of Dubins (1957), On curves of minimal length, those without a third arc. With c =
    p + i s R exp(i psi), the centre of a turn to the side s (1 to starboard, -1 to port), and p =
    north + i east, the line of length L and course theta between turns to s and e has

        c_e - c_s = (L + i (e - s) R) exp(i theta)
    """
    paths, R = list[Arcs](), radius_m
    for s, e in product((1, -1), repeat=2):
        sides = R * (e * np.exp(1j * end[2]) - s * np.exp(1j * start[2]))
        apart, aside = complex(*(end - start)[:2]) + 1j * sides, (e - s) * R
        if abs(apart) < abs(aside):
            continue
        line = np.sqrt(abs(apart) ** 2 - aside**2)
        course = np.angle(apart) - np.arctan2(aside, line)
        turns = np.array([s * (course - start[2]), e * (end[2] - course)]) + ROUNDING
        angles = np.maximum(turns % (2.0 * np.pi) - ROUNDING, 0.0)
        paths.append(Arcs(angles * [s, e], float(line), R))
    return min(paths, key=lambda path: float(np.sum(path.lengths)))


def basic(heading: int, cell_m: float, pace: Pace) -> dict[str, Array]:
    """The basic primitives from a heading of the lattice (a multiple of 45 deg), by name."""
    still, diagonal = np.zeros(3), heading % 2 == 1
    ahead, far, aside = np.sqrt(0.5) * np.array([2.0, 3.0, 1.0]) if diagonal else (1.0, 2.0, 1.0)
    moves = {"straight": pace.line(still, np.array([cell_m * ahead, 0.0, 0.0]))}
    for side, name in ((1, "starboard"), (-1, "port")):
        end = np.array([cell_m * far, side * cell_m * aside, side * HEADING_STEP])
        arcs = shortest_arcs(still, end, ARC * cell_m)
        shares = pace.shares(float(np.sum(arcs.lengths)), HEADING_STEP)
        moves[f"arc_{name}"] = arcs.poses(shares)
        moves[f"pivot_{name}"] = pace.line(still, np.array([0.0, 0.0, side * HEADING_STEP]))
    return moves


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

    def positions(self, cells: Integers) -> Array:
        """Centres in NED [m] of cells (..., 2) that are counted from the start."""
        relative = np.asarray(self.cell_m * cells, dtype=np.float64)
        return np.asarray(self.start[:2] + in_ned(relative, self.start[2]))

    def paths(self, heading: int) -> dict[str, Array]:
        """The primitives with a positive count from a heading, followed by the basic ones.

        They are in the frame of the lattice. An informative one is closed by a passage to the
        nearest pose, and a rest there.
        """
        angle, paths = heading * HEADING_STEP, dict[str, Array]()
        unit = np.array([self.cell_m, self.cell_m, HEADING_STEP])
        for name, free in self.primitives.items():
            if self.counts.get(name, 0):
                path = turned(free, angle)
                end = nearest(path[-1], self.cell_m) * unit
                rest = np.tile(end, (self.hold, 1))
                paths[name] = np.vstack([path, self.pace.line(path[-1], end), rest])
        moves = basic(heading, self.cell_m, self.pace)
        return paths | {name: turned(path, angle) for name, path in moves.items()}


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


class Setting(NamedTuple):
    """A task on a lattice about its start, in the frame of which cells are counted."""

    paths: Sequence[Mapping[str, Array]]  # by heading, as of PlanningTask.paths
    cells: Integers  # (I J, 2)
    moves: Moves
    start: int  # place
    goal: int


def plan(task: PlanningTask) -> PlannedPath:
    """The path of least time; raises ConfigurationError with the reason if there is none."""
    setting = set_up(task)
    moves, start, goal = setting.moves, setting.start, setting.goal
    steps, cost = shortest(moves, *bounds(moves, goal), start, goal)
    if cost < 0:
        raise ConfigurationError(
            "no sequence of the manoeuvres with arcs and turns between them connects start and "
            f"goal with a cell_m of {task.cell_m:g} and a clearance_m of "
            f"{task.waters.clearance_m:g}, expected smaller ones, or a way between the obstacles"
        )
    return PlannedPath(tuple(_legs(task, setting, steps)), task.start, cost)


def set_up(task: PlanningTask) -> Setting:
    """Place the primitives, the start and the goal of a task on its lattice.

    Raises ConfigurationError where one of them does not fit.
    """
    waters = task.waters
    for name, pose in (("start", task.start), ("goal", task.goal)):
        if (obstacle := waters.in_the_way(pose[:2])) is not None:
            raise ConfigurationError(f"{name} at ({pose[0]:g}, {pose[1]:g}) m: {obstacle}")
    edges = in_body(np.array(waters.area) - task.start[:2], task.start[2]) / task.cell_m
    low = np.ceil(edges.min(axis=0)).astype(np.int64)
    rows, columns = (np.floor(edges.max(axis=0)).astype(np.int64) - low + 1).tolist()
    counts = [task.counts[name] for name in task.primitives if task.counts.get(name, 0)]
    states = rows * columns * HEADINGS * math.prod(n + 1 for n in counts)
    if rows * columns > MOST_CELLS or states > MOST_STATES:
        raise ConfigurationError(
            f"cell_m: got {task.cell_m:g} m, with {rows} x {columns} cells and {states:.2g} states "
            f"for counts {counts}, expected at most {MOST_CELLS:.2g} and {MOST_STATES:.2g}; use a "
            "larger cell_m or fewer sub-experiments"
        )
    cells = np.indices((rows, columns)).reshape(2, -1).T + low
    paths = [task.paths(heading) for heading in range(HEADINGS)]
    moves = _moves(task, cells, paths, counts)
    for (name, path), ends in zip(paths[0].items(), moves.end, strict=True):
        if np.all(ends < 0):
            along, across = np.ptp(path[:, :2], axis=0)
            raise ConfigurationError(
                f"{name} takes {along:.3g} m along and {across:.3g} m across its first heading and "
                "does not fit anywhere in the area between the obstacles"
            )
    start = int(-low @ (columns, 1))
    return Setting(paths, cells, moves, start, _arrival(task, cells))


def _moves(
    task: PlanningTask, cells: Integers, paths: Sequence[Mapping[str, Array]], counts: list[int]
) -> Moves:
    """The moves of paths by heading, of which the first ones are informative and have counts."""
    margin, turn, (rows, columns) = STRAY * task.cell_m, task.start[2], cells[-1] - cells[0] + 1
    free, centres = task.waters.free(margin), task.positions(cells)

    def ends(path: Array) -> Integers:  # of the path from every cell
        north, east, heading = nearest(path[-1], task.cell_m)
        to = cells - cells[0] + (north, east)
        inner = np.asarray(np.all((to >= 0) & (to < (rows, columns)), axis=-1))
        corners = in_ned(simplified(np.vstack([np.zeros(2), path[:, :2]]), margin), turn)
        for corner in corners:  # a cheap test that excludes most cells
            inner[inner] = inside(free, centres[inner] + corner)
        inner[inner] = clear(free, corners, centres[inner])
        place = (heading % HEADINGS * rows + to[:, 0]) * columns + to[:, 1]
        return np.where(inner, place, -1)

    by_name = [[own[name] for own in paths] for name in paths[0]]
    end = np.array([np.concatenate([*map(ends, row)]) for row in by_name])
    cost = np.array([[len(path) for path in row] for row in by_name])
    size = np.array(counts, dtype=np.int64) + 1
    return Moves(end, cost, size, np.cumprod(size[::-1])[::-1] // size)


def _arrival(task: PlanningTask, cells: Integers) -> int:
    """The place of cells (N, 2) nearest to the goal with a clear straight passage to it."""
    goal, centres = task.goal[:2], task.positions(cells)
    near = np.argsort(np.hypot(*(centres - goal).T), kind="stable")[:9]
    lines = shapely.linestrings([[centres[k], goal] for k in near])
    near = near[shapely.covers(task.waters.free(), lines)]
    if not len(near):
        raise ConfigurationError(
            f"goal at ({goal[0]:g}, {goal[1]:g}) m: there is no clear passage from a neighbouring "
            f"pose of the lattice, expected a cell_m smaller than {task.cell_m:g}"
        )
    heading = round((task.goal[2] - task.start[2]) / HEADING_STEP) % HEADINGS
    return int(heading * len(cells) + near[0])


def _legs(task: PlanningTask, setting: Setting, steps: Integers) -> list[Leg]:
    """The primitives of a path in NED with unwrapped headings, the final passage and the rest."""
    moves, turn, cells = setting.moves, task.start[2], setting.cells
    place, pose, legs = setting.start, task.start, list[Leg]()
    for p in steps:
        h, cell = divmod(place, len(cells))
        name, path = [*setting.paths[h].items()][p]
        position = task.positions(cells[cell]) + in_ned(path[:, :2], turn)
        poses = np.column_stack([position, pose[2] + path[:, 2] - h * HEADING_STEP])
        legs.append(Leg(name, bool(p < len(moves.size)), poses))
        pose, place = poses[-1], int(moves.end[p, place])
    end = task.goal.copy()
    end[2] = pose[2] + wrap(end[2] - pose[2])
    rest = np.tile(end, (task.hold, 1))
    passage = task.pace.line(pose, end) if np.max(np.abs(end - pose)) > 1e-9 else rest[:0]
    if len(passage) + len(rest):
        legs.append(Leg("arrival", False, np.vstack([passage, rest])))
    return legs
