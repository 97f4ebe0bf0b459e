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

from seatrial.models.errors import ConfigurationError
from seatrial.models.planning.lattice import (
    HEADING_STEP,
    HEADINGS,
    UNREACHED,
    CostBounds,
    Integers,
    Lattice,
    Moves,
    Pace,
    Placed,
    Primitive,
    Waters,
    clear,
    heuristic,
    placed,
    relaxed,
    shortest,
)
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import in_ned, wrap

MOST_STATES = 30_000_000


@dataclass(frozen=True, eq=False)
class PlanningTask:
    """A planning task: the waters, the informative primitives and their counts, start and goal.

    `start` and `goal` are (north, east, heading) [m, m, rad]. The vessel rests for `hold` control
    instants after each manoeuvre.
    """

    waters: Waters
    primitives: Sequence[Primitive]
    counts: Mapping[str, int]
    start: Array
    goal: Array
    cell_m: float
    pace: Pace
    hold: int = 0

    def __post_init__(self) -> None:
        known = {primitive.name for primitive in self.primitives}
        unknown = [name for name in self.counts if name not in known]
        if unknown:
            raise ConfigurationError(
                f"counts: got {unknown[0]}, expected some of {', '.join(sorted(known))}"
            )

    @property
    def used(self) -> list[Primitive]:
        """The primitives with a positive count."""
        return [
            primitive for primitive in self.primitives if self.counts.get(primitive.name, 0) > 0
        ]


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
    bound: int  # value of the heuristic at the start [instants]

    @property
    def poses(self) -> Array:
        """All poses from the start to the goal, (N + 1, 3) [m, m, rad]."""
        return np.vstack([self.start[None, :], *(leg.poses for leg in self.legs)])


@dataclass(frozen=True, eq=False)
class Setting:
    """A task on its lattice."""

    task: PlanningTask
    lattice: Lattice
    board: Placed
    moves: Moves
    sizes: Integers
    start: int
    goal: int

    def bounds(self) -> CostBounds:
        """Tables of the heuristic."""
        n, board = len(self.task.used), self.board
        size = np.hypot(board.di, board.dj)
        sizes = self.sizes[:n]
        digits = np.indices(tuple(sizes.tolist())).reshape(n, int(np.prod(sizes)))
        least, reach = np.min(board.cost[:n], axis=1), np.max(size[:n], axis=1)
        free = np.arange(len(board.names)) < n
        row, column = divmod(
            self.goal % (self.lattice.shape[0] * self.lattice.shape[1]), self.lattice.shape[1]
        )
        return CostBounds(
            manoeuvres=(least @ digits).astype(np.int64),
            reach=(reach @ digits).astype(np.float64),
            pace=float(np.max(size[n:] / board.cost[n:])),
            relaxed=relaxed(self.moves, free, self.goal, True),
            goal=np.array([row, column], dtype=np.int64),
        )


def plan(task: PlanningTask) -> PlannedPath:
    """The path of least time; raises ConfigurationError with the reason if there is none."""
    setting = set_up(task)
    bounds = setting.bounds()
    steps, cost = shortest(setting.moves, setting.sizes, bounds, setting.start, setting.goal)
    if cost < 0:
        raise ConfigurationError(_no_path_message(setting))
    legs = _legs(setting, steps)
    at = (int(k) for k in np.unravel_index(setting.start, (HEADINGS, *setting.lattice.shape)))
    bound = int(heuristic(bounds, len(bounds.manoeuvres) - 1, *at))
    return PlannedPath(tuple(legs), task.start, cost, bound)


def set_up(task: PlanningTask) -> Setting:
    """Place the primitives, the start and the goal of a task on its lattice."""
    for name, pose in (("start", task.start), ("goal", task.goal)):
        obstacle = task.waters.in_the_way(pose[:2].tolist())
        if obstacle is not None:
            raise ConfigurationError(f"{name} at ({pose[0]:g}, {pose[1]:g}) m: {obstacle}")
    obstacles = task.waters.separated_by(task.start[:2].tolist(), task.goal[:2].tolist())
    if obstacles is not None:
        raise ConfigurationError(
            f"goal at ({task.goal[0]:g}, {task.goal[1]:g}) m: {obstacles} and the clearance_m of "
            f"{task.waters.clearance_m:g} separate it from the start"
        )
    lattice = Lattice.over(task.waters, task.start, task.cell_m)
    _check_size(task, lattice)
    board = placed(lattice, task.waters, task.used, task.pace, task.hold)
    n = len(task.used)
    for name, valid in zip(board.names[:n], board.valid, strict=False):
        if not np.any(valid):
            along, across = np.ptp(board.paths[board.names.index(name)][0][:, :2], axis=0)
            raise ConfigurationError(
                f"{name} takes {along:.3g} m along and {across:.3g} m across its first heading and "
                "does not fit anywhere in the area between the obstacles"
            )
    sizes = np.array([task.counts[primitive.name] + 1 for primitive in task.used], dtype=np.int64)
    stride = np.array([int(np.prod(sizes[q + 1 :])) for q in range(n)], dtype=np.int64)
    basics = np.zeros(len(board.names) - n, dtype=np.int64)
    moves = Moves(
        board.di, board.dj, board.to, board.cost, np.concatenate([stride, basics]), board.valid
    )
    start, goal = lattice.place(task.start.copy()), _arrival(task, lattice)
    return Setting(task, lattice, board, moves, np.concatenate([sizes, basics + 1]), start, goal)


def _check_size(task: PlanningTask, lattice: Lattice) -> None:
    cells = lattice.shape[0] * lattice.shape[1]
    counts = math.prod(task.counts[primitive.name] + 1 for primitive in task.used)
    states = cells * HEADINGS * counts
    if states > MOST_STATES:
        raise ConfigurationError(
            f"the search has {states:.2g} states ({cells} cells, {HEADINGS} headings, {counts} "
            f"counts), expected at most {MOST_STATES:.2g}; use a larger cell_m or fewer "
            "sub-experiments"
        )


def _arrival(task: PlanningTask, lattice: Lattice) -> int:
    """The place nearest to the goal with a clear straight passage to it."""
    free = task.waters.free()
    at = lattice.place(task.goal.copy())
    h, i, j = (int(k) for k in np.unravel_index(at, (HEADINGS, *lattice.shape)))
    around = [
        (np.hypot(*(lattice.pose(place) - task.goal)[:2]), place)
        for k in range(max(i - 1, 0), min(i + 2, lattice.shape[0]))
        for m in range(max(j - 1, 0), min(j + 2, lattice.shape[1]))
        for place in ((h * lattice.shape[0] + k) * lattice.shape[1] + m,)
    ]
    for _, place in sorted(around):
        pose = lattice.pose(place)[:2]
        if clear(free, np.vstack([np.zeros(2), task.goal[:2] - pose]), pose[None, :])[0]:
            return place
    raise ConfigurationError(
        f"goal at ({task.goal[0]:g}, {task.goal[1]:g}) m: there is no clear passage from a "
        f"neighbouring pose of the lattice, expected a cell_m smaller than {task.cell_m:g}"
    )


def _no_path_message(setting: Setting) -> str:
    """Why no path exists for a task whose start and goal are connected."""
    n, names = len(setting.task.used), setting.board.names
    blocked = np.zeros(len(names), dtype=np.bool_)
    reached = relaxed(setting.moves, blocked, setting.start, False) < UNREACHED
    back = relaxed(setting.moves, blocked, setting.goal, True) < UNREACHED
    if not reached.ravel()[setting.goal]:
        return (
            "the goal cannot be reached: no sequence of manoeuvres, arcs and turns connects start "
            f"and goal with a cell_m of {setting.task.cell_m:g}; use a smaller cell_m or "
            "clearance_m"
        )
    for p in range(n):
        if not np.any(setting.board.valid[p] & reached):
            return f"{names[p]} fits only at places that cannot be reached from the start"
    isolated = [names[p] for p in range(n) if not np.any(setting.board.valid[p] & reached & back)]
    manoeuvre = isolated[0] if isolated else "some manoeuvre"
    return (
        f"no order of the manoeuvres ends at the goal: the goal cannot be reached from {manoeuvre}"
    )


def _legs(setting: Setting, steps: Integers) -> list[Leg]:
    """The primitives of a path in NED with unwrapped headings, the final passage and the rest."""
    task, board, lattice = setting.task, setting.board, setting.lattice
    place, pose, legs = setting.start, task.start.copy(), []
    for p in steps:
        h, i, j = (int(k) for k in np.unravel_index(place, (HEADINGS, *lattice.shape)))
        path = board.paths[p][h]
        position = lattice.pose(place)[:2] + in_ned(path[:, :2], task.start[2])
        poses = np.column_stack([position, pose[2] + path[:, 2] - h * HEADING_STEP])
        legs.append(Leg(board.names[p], p < len(task.used), poses))
        pose = poses[-1]
        row, column = i + int(board.di[p, h]), j + int(board.dj[p, h])
        place = (int(board.to[p, h]) * lattice.shape[0] + row) * lattice.shape[1] + column
    end = task.goal.copy()
    end[2] = pose[2] + wrap(end[2] - pose[2])
    rest = np.tile(end, (task.hold, 1))
    passage = task.pace.line(pose, end) if np.max(np.abs(end - pose)) > 1e-9 else rest[:0]
    if len(passage) + len(rest):
        legs.append(Leg("arrival", False, np.vstack([passage, rest])))
    return legs
