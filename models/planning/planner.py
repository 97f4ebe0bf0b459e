"""Plans a path with a prescribed number of each manoeuvre, between two poses, clear of obstacles.

    min sum_k J(m_k),  x_0 = x_s,  x_M = x_f,  x_k+1 = f(x_k, m_k),  c(m_k, x_k) in X_free

Ljungberg (slides), "Obtaining an experiment trajectory". J is time. Counters of the remaining
manoeuvres in the state of the search ensure the composition of the mix.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.planning.lattice import (
    HEADING_STEP,
    HEADINGS,
    Integers,
    Lattice,
    Pace,
    Placed,
    Waters,
    clear,
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
    """A task on its lattice; `start` and `goal` are numbers of places."""

    task: PlanningTask
    lattice: Lattice
    board: Placed
    start: int
    goal: int

    @cached_property
    def sizes(self) -> Integers:
        """Count of each primitive plus one; 1 for the basic ones, (P,)."""
        counts = [self.task.counts[name] for name in self.task.used]
        rest = len(self.board.names) - len(counts)
        return np.array([*counts, *[0] * rest], dtype=np.int64) + 1

    def bounds(self) -> tuple[Integers, Integers]:
        """Lower bounds of the cost to go [instants]: by remaining counts, and by place."""
        n, moves = len(self.task.used), self.board.moves
        digits = np.indices(tuple(self.sizes[:n].tolist())).reshape(n, -1 if n else 1)
        left = np.min(moves.cost[:n], axis=1) @ digits
        return left, relaxed(moves, np.arange(len(self.board.names)) < n, self.goal)


def plan(task: PlanningTask) -> PlannedPath:
    """The path of least time; raises ConfigurationError with the reason if there is none."""
    setting = set_up(task)
    ends = setting.start, setting.goal
    steps, cost = shortest(setting.board.moves, setting.sizes, *setting.bounds(), *ends)
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
        obstacle = waters.in_the_way(pose[:2].tolist())
        if obstacle is not None:
            raise ConfigurationError(f"{name} at ({pose[0]:g}, {pose[1]:g}) m: {obstacle}")
    lattice = Lattice.over(waters, task.start, task.cell_m)
    cells, counts = math.prod(lattice.shape), [task.counts[name] for name in task.used]
    states = cells * HEADINGS * math.prod(n + 1 for n in counts)
    if states > MOST_STATES:
        raise ConfigurationError(
            f"the search has {states:.2g} states ({cells} cells, {HEADINGS} headings, counts "
            f"{counts}), expected at most {MOST_STATES:.2g}; use a larger cell_m or fewer "
            "sub-experiments"
        )
    board = placed(lattice, waters, task.used, counts, task.pace, task.hold)
    for p, name in enumerate(board.names[: len(counts)]):
        if not np.any(board.moves.valid[p]):
            along, across = np.ptp(board.paths[p][0][:, :2], axis=0)
            raise ConfigurationError(
                f"{name} takes {along:.3g} m along and {across:.3g} m across its first heading and "
                "does not fit anywhere in the area between the obstacles"
            )
    start = lattice.number(lattice.nearest(task.start))
    return Setting(task, lattice, board, start, _arrival(task, lattice))


def _arrival(task: PlanningTask, lattice: Lattice) -> int:
    """The place nearest to the goal with a clear straight passage to it."""
    free, goal = task.waters.free(), task.goal[:2]
    h, i, j = lattice.nearest(task.goal)
    rows, columns = (
        range(max(k - 1, 0), min(k + 2, n)) for k, n in zip((i, j), lattice.shape, strict=True)
    )
    around = [(lattice.centres[k, m], (h, k, m)) for k in rows for m in columns]
    for at, place in sorted(around, key=lambda each: float(np.hypot(*(each[0] - goal)))):
        if clear(free, np.vstack([np.zeros(2), goal - at]), at[None, :])[0]:
            return lattice.number(place)
    raise ConfigurationError(
        f"goal at ({goal[0]:g}, {goal[1]:g}) m: there is no clear passage from a neighbouring "
        f"pose of the lattice, expected a cell_m smaller than {task.cell_m:g}"
    )


def _legs(setting: Setting, steps: Integers) -> list[Leg]:
    """The primitives of a path in NED with unwrapped headings, the final passage and the rest."""
    task, board, lattice = setting.task, setting.board, setting.lattice
    h, i, j = (int(k) for k in np.unravel_index(setting.start, board.moves.valid.shape[1:]))
    pose, legs = task.start.copy(), []
    for p in steps:
        path, moves = board.paths[p][h], board.moves
        position = lattice.pose(h, i, j)[:2] + in_ned(path[:, :2], task.start[2])
        poses = np.column_stack([position, pose[2] + path[:, 2] - h * HEADING_STEP])
        legs.append(Leg(board.names[p], p < len(task.used), poses))
        pose = poses[-1]
        h, i, j = int(moves.to[p, h]), i + int(moves.di[p, h]), j + int(moves.dj[p, h])
    end = task.goal.copy()
    end[2] = pose[2] + wrap(end[2] - pose[2])
    rest = np.tile(end, (task.hold, 1))
    passage = task.pace.line(pose, end) if np.max(np.abs(end - pose)) > 1e-9 else rest[:0]
    if len(passage) + len(rest):
        legs.append(Leg("arrival", False, np.vstack([passage, rest])))
    return legs
