"""A sequence of candidates, chosen one by one, that fits into a time and an area.

A steered vessel sails from candidate to candidate on paths of Dubins, and back to its start, with
what is really turned simulated each time. A vessel that is commanded by forces is planned by
`excitation=optimal_design`. Without an area there are no joins.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.helm_sequence import HelmSequence, HelmStep, join_steps
from seatrial.models.excitation.missions import Mission
from seatrial.models.excitation.next_experiment import Purpose, ranked
from seatrial.models.planning.dubins import dubins, length_of, poses_along
from seatrial.models.planning.lattice import Waters, clear, inside, simplified
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import in_ned
from seatrial.runner.trials.next_experiment import APPROACH, UNABLE, Candidate, Known, chosen_design

JOIN_SHARE, CIRCLE = 0.6, 40.0  # of the largest helm in joins; length of the circle [L / U]
GRID, HEADINGS = 9, 8  # of poses at which a candidate may begin
TRIED, PLACES = 12, 3  # candidates, and beginnings of each, that are simulated in turn
STRAY = 0.5  # of a ship length or cell, by which a path of Dubins is not followed


@dataclass(frozen=True, eq=False)
class Sea:
    """The waters, if they are limited, the pose (3,) [m, m, rad] at the start and the time."""

    waters: Waters | None
    start: Array
    seconds: float


class Sailed(NamedTuple):
    """The candidates with the instants [s] at which they begin, and how they are sailed."""

    chosen: tuple[tuple[float, int], ...]
    mission: Mission | None = None
    motion: Recording | None = None
    steps: tuple[HelmStep, ...] = ()  # of a steered vessel, without its return

    @property
    def seconds(self) -> float:
        """Its length."""
        return 0.0 if self.mission is None else self.mission.duration_s


@dataclass(frozen=True, eq=False)
class SteeredPlanner:
    """Adds candidates of a steered vessel to a sequence."""

    known: Known
    candidates: Sequence[Candidate]
    sea: Sea

    def __post_init__(self) -> None:
        waters = self.sea.waters
        if waters is None:
            return
        if (reason := waters.in_the_way(self.sea.start[:2])) is not None:
            raise ConfigurationError(f"next: the start: {reason}")
        radius, speed = self.circle
        if waters.free(radius).is_empty:
            raise ConfigurationError(
                f"next: area: no turning circle fits, expected room for one of {2.0 * radius:.3g} m"
                f" at {speed:.2g} m/s and a clearance of {waters.clearance_m:g} m"
            )

    @cached_property
    def family(self) -> HelmSequence:
        """A mission of the vessel from the start."""
        family = self.known.trial.excitation
        assert isinstance(family, HelmSequence)
        north, east, heading = self.sea.start
        return replace(family, start_pose=(north, east, float(np.degrees(heading))))

    @cached_property
    def helms(self) -> Array:
        """Orders in joins to port and to starboard, (2,)."""
        own, i = self.family, self.family.index
        start = own.input_start[i]
        both = start + JOIN_SHARE * np.array([own.input_low[i] - start, own.input_high[i] - start])
        return both if own.input_signs[i] > 0.0 else both[::-1]

    @cached_property
    def circle(self) -> tuple[float, float]:
        """Radius [m] and speed [m/s] of the wider of the steady turns at these orders."""
        found = []
        for helm in self.helms:
            step = HelmStep("hold", CIRCLE * self.family.unit_s, float(helm))
            run = self.known.sailed(replace(self.family, steps=(step,)))
            last = run.nu[-len(run) // 4 :]
            speed = float(np.mean(np.hypot(last[:, 0], last[:, 1])))
            rate = float(np.mean(np.abs(last[:, 2])))
            found.append((speed / max(rate, 1e-9), speed))
        return max(found)

    def added(self, so_far: Sailed, number: int) -> Sailed | None:
        """The sequence with one candidate more and the return; None: it does not fit."""
        candidate = self.candidates[number]
        limit = self.sea.seconds
        for join in self._joins(so_far, candidate):
            begins = float(sum(step.seconds for step in (*so_far.steps, *join)))
            if begins + candidate.seconds > limit:
                continue
            steps = (*so_far.steps, *join, *candidate.steps)
            found = self._sailed(steps, ((*so_far.chosen, (begins, number))))
            if found is not None and found.seconds <= limit:
                return found
        return None

    def _sailed(
        self, steps: tuple[HelmStep, ...], chosen: tuple[tuple[float, int], ...]
    ) -> Sailed | None:
        """Simulate steps and the return; None if the vessel leaves the waters or cannot."""
        back: list[HelmStep] = []
        try:
            mission = replace(self.family, steps=steps)
            motion = self.known.sailed(mission)
            if self.sea.waters is not None:
                radius, speed = self.circle
                path = dubins(motion.eta[-1], self.sea.start, radius)
                back = join_steps(path, radius, speed, self.helms, self.family.unit_s)
                mission = replace(self.family, steps=(*steps, *back))
                motion = self.known.sailed(mission)
                track = simplified(motion.eta[:, :2], 0.05 * self.family.length_m)
                if not clear(self.sea.waters.free(), track, np.zeros((1, 2)))[0]:
                    return None
        except UNABLE:
            return None
        return Sailed(chosen, mission, motion, steps)

    def _joins(self, so_far: Sailed, candidate: Candidate) -> list[list[HelmStep]]:
        """No join, then the shortest ones to where the candidate is clear of the limits."""
        if self.sea.waters is None:
            return [[]]
        end = self.sea.start
        if so_far.steps:
            end = self.known.sailed(replace(self.family, steps=so_far.steps)).eta[-1]
        radius, speed = self.circle
        settle = APPROACH * self.family.unit_s
        free = self.sea.waters.free(STRAY * self.family.length_m)
        track = simplified(candidate.motion.eta[:, :2], 0.05 * self.family.length_m)
        found = []
        for pose in self._beginnings(track):
            turned = pose[2] + candidate.motion.eta[-1, 2]
            last = np.array([*(pose[:2] + in_ned(track[-1:], pose[2])[0]), turned])
            there, back = dubins(end, pose, radius), dubins(last, self.sea.start, radius)
            found.append((length_of(there) + length_of(back), there))
        joins: list[list[HelmStep]] = [[]]
        for _, path in sorted(found, key=lambda each: each[0]):
            points = poses_along(end, path, radius, 0.25 * radius)[:, :2]
            if clear(free, points, np.zeros((1, 2)))[0]:
                joins.append(join_steps(path, radius, speed, self.helms, settle))
            if len(joins) > PLACES:
                break
        return joins

    def _beginnings(self, track: Array) -> list[Array]:
        """Poses on a grid at which a track (n, 2) that begins at the origin is clear."""
        assert self.sea.waters is not None
        free = self.sea.waters.free(STRAY * self.family.length_m)
        if free.is_empty:
            return []
        south, west, north, east = free.bounds
        grid = np.meshgrid(np.linspace(south, north, GRID), np.linspace(west, east, GRID))
        points = np.stack(grid, axis=-1).reshape(-1, 2)
        points = points[inside(free, points)]
        poses: list[Array] = []
        for heading in 2.0 * np.pi * np.arange(HEADINGS) / HEADINGS:
            fits = clear(free, in_ned(track, heading), points)
            poses += [np.array([*point, heading]) for point in points[fits]]
        return poses


@dataclass(frozen=True, eq=False)
class ForcePlanner:
    """Adds candidates of a vessel that is commanded by forces to a sequence."""

    known: Known
    candidates: Sequence[Candidate]
    sea: Sea

    def route(self) -> Mapping[str, object]:
        """Options of the route."""
        north, east, heading = map(float, self.sea.start)
        start = [north, east, float(np.degrees(heading))]
        waters = self.sea.waters
        if waters is None:
            return {"start": start}
        own = {"area": waters.area, "obstacles": waters.obstacles}
        return {**own, "start": start, "clearance_m": waters.clearance_m}

    def nodes(self, numbers: Sequence[int]) -> dict[str, Mapping[str, object]]:
        """The nodes of candidates by name, repeated ones by a number."""
        found: dict[str, Mapping[str, object]] = {}
        for i, number in enumerate(numbers):
            own = self.candidates[number]
            assert own.node is not None
            found[f"{i + 1}: {own.name}"] = own.node
        return found

    def added(self, so_far: Sailed, number: int) -> Sailed | None:
        """The sequence with one candidate more; None if it does not fit."""
        numbers = [*(n for _, n in so_far.chosen), number]
        nodes = self.nodes(numbers)
        try:
            mission = chosen_design(self.known, nodes, self.route())
            if mission.duration_s > self.sea.seconds:
                return None
            motion = self.known.sailed(mission)
        except UNABLE:
            return None
        period, names = mission.period_s, list(nodes)
        phases, edges = mission.schedule.phases, mission.schedule.edges
        begins = {p.name: period * k for p, k in zip(phases, edges, strict=False) if p.name in nodes
                  and p.role == "training"}  # fmt: skip
        chosen = tuple((begins[name], n) for name, n in zip(names, numbers, strict=True))
        return Sailed(chosen, mission, motion)


def sequence(
    purpose: Purpose, target: float, informations: Array,
    planner: SteeredPlanner | ForcePlanner, seconds: float,
) -> tuple[Sailed, list[float]]:  # fmt: skip
    """Candidates added by what they save in a second, until the target is reached or none fits.

    Returns:
        The sequence, and half the interval before it and after each of its candidates as they are
        sailed, which a planned route may do in another order than that in which they were chosen.
    """
    sailed, known = Sailed(()), np.zeros_like(informations[0])
    times = np.array([candidate.seconds for candidate in planner.candidates])
    while purpose.width(known[None]) > target:
        order, _ = ranked(purpose, known, informations, times)
        usable = [n for n in order if sailed.seconds + times[n] <= seconds]
        more = next(
            (m for n in usable[:TRIED] if (m := planner.added(sailed, int(n))) is not None), None
        )
        if more is None:
            break
        sailed = more
        known = known + informations[more.chosen[-1][1]]
    told = [np.zeros_like(known), *(informations[number] for _, number in sorted(sailed.chosen))]
    return sailed, [purpose.width(np.array(told[: k + 1])) for k in range(len(told))]
