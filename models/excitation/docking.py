"""Docking: from a pose drawn in a harbour to a berth, along a planned path and straight into it.

The set-points follow the path of least time that keeps the hull's circle clear of the land, to an
approach pose beside the berth, wait there, and move straight to the quay. Every controller gets the
same timetable, so the times to berth can be compared; a controller that knows the obstacles
(`Outlook.obstacles`) may leave it. Lengths are in lengths of the vessel.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, NamedTuple

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.guidance import ReferenceFilter
from seatrial.models.excitation.missions import Length, Mission, planar_only
from seatrial.models.planning.harbour import Harbour, distances, harbour_of, hull_outline
from seatrial.models.planning.planner import Pace, PlanningTask, Waters, inside, plan
from seatrial.models.ranges import NotNegative, Positive, check_ranges
from seatrial.models.simulation.registry import Timetable
from seatrial.models.simulation.voyage import Outlook
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.parameters import VesselParameters
from seatrial.models.vessel.scales import SLENDERNESS
from seatrial.models.vessel.tuning import FromVessel

WAY = 2.0  # longest passage that is expected, in widths of the harbour, north and east
APPROACHES = 100  # distances from the quay at which an approach is looked for
TRIES = 1000  # positions that are drawn for a start
ROOM = 0.2  # [L] beyond the nearest free approach, to keep away from what surrounds it


@dataclass(frozen=True)
class Docking(Mission):
    """Docking in one of several harbours, drawn for each seed like the start.

    `harbour` names GeoJSON files, then holds their texts by name. Passages are sailed at the shares
    `passage` and `berthing` of the speeds ahead and across in `speed` [m/s, m/s, rad/s], with turns
    at the third. `rests` are the times at the approach pose and in the berth, in time constants of
    the reference filter. A vessel is berthed while its errors are in `within` [L], `within_deg`.
    """

    harbour: str | tuple[str, ...] | dict[str, str]
    speed: Annotated[tuple[Positive, ...], FromVessel("tuning.control.mission.speed")]
    passage: Positive
    berthing: Positive
    rests: tuple[NotNegative, NotNegative]
    gap: Positive  # between the berthed hull and the quay [L]
    clearance: Positive  # of the middle of the hull on the way to the approach pose [L]
    cell: Positive  # of the planner's lattice [L]
    within: Positive
    within_deg: Positive
    vessel: VesselParameters
    reference_filter: ReferenceFilter
    period_s: Positive
    poses: Any = None  # set-points (N, 3) at the control instants, once they are drawn

    def __post_init__(self) -> None:
        check_ranges(self)
        _ = self.harbours
        most, got = self.vessel.scales.speeds, self.speed
        if self.vessel.planar and (len(got) != 3 or np.any(np.array(got) > most)):
            raise ConfigurationError(
                f"speed: got {list(got)}, expected three numbers and at most the "
                f"{np.round(most, 3).tolist()} that {self.vessel.name} attains with full thrust"
            )

    @cached_property
    def harbours(self) -> dict[str, Harbour]:
        """The harbours by name."""
        if not isinstance(self.harbour, dict) or not self.harbour:
            raise ConfigurationError("harbour: got no name, expected at least one")
        found = {}
        for name, text in self.harbour.items():
            try:
                found[name] = harbour_of(text, self.vessel.scales.length_m)
            except (ConfigurationError, ValueError, TypeError) as error:
                raise ConfigurationError(f"harbour: {name}: {error}") from error
        return found

    @property
    def hull(self) -> Array:
        """Corners of the hull, (5, 2) [m], body axes."""
        length = self.vessel.scales.length_m
        return hull_outline(length, self.vessel.beam_m or length / SLENDERNESS)

    @property
    def pace(self) -> Pace:
        """Speeds on the way to the approach pose."""
        return Pace(self.passage * self.speed[0], self.speed[-1], self.period_s)

    @property
    def duration_s(self) -> float:
        """Length [s]; before the draw an upper bound: of a passage around the harbour."""
        if self.poses is not None:
            return len(self.poses) * self.period_s
        way = WAY * max(float(np.sum(np.ptp(one.area, axis=0))) for one in self.harbours.values())
        turn = 2.0 * np.pi / self.pace.turn_rate_rad_s
        rest = sum(self.rests) / self.reference_filter.bandwidth_rad_s
        return float(way / self.pace.speed_m_s + turn + rest)

    def length(self) -> Length:
        """The upper bound of the length, which the speed ahead decides on."""
        return Length("speed", self.speed[0], self.duration_s)

    def check(self, dofs: Sequence[str]) -> None:
        """Raise ConfigurationError unless the vessel is planar."""
        planar_only("a berth", dofs)

    def drawn(self, rng: np.random.Generator) -> "Docking":
        """The docking in a harbour from a start; ConfigurationError with what is in the way."""
        self.check(self.vessel.dofs)
        assert isinstance(self.harbour, dict)
        name = [*self.harbours][int(rng.integers(len(self.harbours)))]
        try:
            poses = self._setpoints(self.harbours[name], rng)
        except ConfigurationError as error:
            raise ConfigurationError(f"harbour: {name}: {error}") from error
        return replace(self, harbour={name: self.harbour[name]}, poses=poses)

    @property
    def start(self) -> Array | None:
        """The drawn pose (3,) [m, m, rad]."""
        return None if self.poses is None else np.asarray(self.poses[0])

    def guidance(self, t: Array, start: Array) -> tuple[NamedTuple, Array]:
        """The set-points as a timetable."""
        return Timetable(np.ascontiguousarray(self.poses[: len(t)])), np.zeros(1)

    def foreseen(self, outlook: Outlook) -> Outlook:
        """The preview with the land and the hull."""
        [harbour] = self.harbours.values()
        return outlook._replace(obstacles=harbour.parts, hull=self.hull)

    def _setpoints(self, harbour: Harbour, rng: np.random.Generator) -> Array:
        """Draw the start in a harbour and plan the set-points, (N, 3) [m, m, rad].

        The planner's lattice lies along the berth, so that a narrow basin can be entered: the plan
        leaves the berth with the bow where the stern is, and is sailed in reverse.
        """
        length, hull, turned = self.vessel.scales.length_m, self.hull, np.array([0.0, 0.0, np.pi])
        beam = float(np.ptp(hull[:, 1]))
        target = harbour.face + (0.5 * beam + self.gap * length) * harbour.away
        if distances(harbour.land, hull, target[None, :])[0] <= 0.0:
            raise ConfigurationError(
                f"it does not contain the target: the hull, {length:.3g} m by {beam:.3g} m, meets "
                f"the land at ({target[0]:.3g}, {target[1]:.3g}) m, or is wider than the basin"
            )
        waters = Waters(harbour.area, harbour.parts, self.clearance * length)
        away = np.linspace(0.0, 0.5 * float(np.ptp(harbour.area)), APPROACHES)
        beside = harbour.face + away[:, None] * harbour.away
        room = waters.distance(beside[:, :2])
        free = np.flatnonzero(room > waters.clearance_m)
        if not len(free):
            raise ConfigurationError(f"no approach is {waters.clearance_m:.3g} m from the land")
        near = free[away[free] <= away[free[0]] + ROOM * length]
        approach = beside[near[np.argmax(room[near])]]
        heading = float(rng.uniform(*harbour.headings))
        low, high = np.reshape(harbour.start.bounds, (2, 2))
        drawn = rng.uniform(low, high, (TRIES, 2))
        good = drawn[inside(harbour.start, drawn) & inside(waters.free(), drawn)]
        if not len(good):
            raise ConfigurationError("it does not contain the start with room to turn")
        start = np.array([*good[0], heading])
        path = plan(PlanningTask(waters, {}, {}, approach + turned, start + turned,
                                 self.cell * length, self.pace))  # fmt: skip
        across = replace(self.pace, speed_m_s=self.berthing * self.speed[1])
        rests_s = np.array(self.rests) / self.reference_filter.bandwidth_rad_s
        before, after = np.round(rests_s / self.period_s).astype(int)
        still, rest = np.tile(approach, (before, 1)), np.tile(target, (after, 1))
        return np.vstack([path.poses[::-1] - turned, still, across.line(approach, target), rest])
