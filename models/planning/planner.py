"""Plans a path with a prescribed number of each manoeuvre, between two poses, clear of obstacles.

    min sum_k J(m_k),  x_0 = x_s,  x_M = x_f,  x_k+1 = f(x_k, m_k),  c(m_k, x_k) in X_free

Ljungberg (slides), "Obtaining an experiment trajectory". J is time. Counters of the remaining
manoeuvres in the state of the search ensure the composition of the mix.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError
from seatrial.models.planning.lattice import (
    HEADING_STEP,
    HEADINGS,
    Integers,
    Moves,
    Pace,
    Waters,
    basic,
    clear,
    closed,
    inside,
    nearest,
    relaxed,
    shortest,
    simplified,
    turned,
)
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import in_body, in_ned, wrap

STRAY = 0.02  # tolerance of path simplification, in cells; added to the clearance
MOST_CELLS, MOST_STATES = 250_000, 30_000_000


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
