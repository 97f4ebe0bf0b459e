"""A feasible trajectory of the mix: the candidates as motion primitives of a planner.

A candidate's primitive is its track in the believed model's calm water, with its stop, closed by a
passage to the lattice. What was planned is sailed by feedback along the planned poses, with the
force that the believed vessel needed; the motion, and with it the information, is then near what
was designed. Without feedback in the manoeuvres (`follow: passages`) a vessel that is not the
believed one strays from the plan until the next passage.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.candidates import Design
from seatrial.models.excitation.schedule import Part
from seatrial.models.planning.planner import Plan, Task, plan
from seatrial.models.planning.primitives import Pace, Primitive
from seatrial.models.planning.waters import Corners, Waters
from seatrial.models.ranges import NotNegative, Positive, check_ranges
from seatrial.models.vessel.basis import Array

Pose = tuple[float, float, float]  # north [m], east [m], heading [deg]


@dataclass(frozen=True)
class Route:
    """The waters that a mix is to be sailed in; without an `area` there is no plan.

    Polygons are lists of (north, east) [m]. `goal` null is the start. `clearance_m` is kept from
    the vessel's reference point; passages are sailed at `speed_m_s` and `turn_rate_rad_s` between
    poses of a lattice of `cell_m`; after a manoeuvre the vessel rests for `hold_s`. `follow`: the
    plan is followed by feedback everywhere, or on the passages between manoeuvres only.
    """

    area: Corners | None
    obstacles: tuple[Corners, ...]
    start: Pose
    goal: Pose | None
    clearance_m: float
    cell_m: Positive | None
    speed_m_s: Positive
    turn_rate_rad_s: Positive
    hold_s: NotNegative
    follow: Literal["everywhere", "passages"]

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.area is not None:
            _ = self.waters
        elif self.obstacles:
            raise ConfigurationError("obstacles: got some without an area")

    @property
    def waters(self) -> Waters:
        """The area with its obstacles."""
        return Waters(self.area or (), self.obstacles, self.clearance_m)

    def plan(self, design: Design, names: Sequence[str]) -> Plan | None:
        """The path that sails the named candidates; None without an area.

        Raises ConfigurationError with what stands in the way.
        """
        if self.area is None:
            return None
        pace = Pace(self.speed_m_s, self.turn_rate_rad_s, design.period_s)
        tracks = {name: voyage.log.eta for name, voyage in design.voyages.items()}
        task = Task(
            waters=self.waters,
            primitives=[Primitive(name, track, True) for name, track in tracks.items()],
            counts=Counter(names),
            start=_pose(self.start),
            goal=_pose(self.start if self.goal is None else self.goal),
            cell_m=4.0 * self.speed_m_s if self.cell_m is None else self.cell_m,
            pace=pace,
            hold=round(self.hold_s / design.period_s),
        )
        try:
            return plan(task)
        except ConfigurationError as error:
            raise ConfigurationError(f"excitation.route: {error}") from error


def _pose(pose: Pose) -> Array:
    return np.array([pose[0], pose[1], np.radians(pose[2])])


def parts_of(found: Plan, design: Design, held_out: Sequence[str], everywhere: bool) -> list[Part]:
    """What is sailed along a plan; of each candidate the last ones are held out for testing.

    Poses are followed `everywhere`, or on the passages.
    """
    left = Counter(leg.name for leg in found.legs if leg.informative)
    kept, own = Counter(held_out), design.count + design.stop
    parts: list[Part] = []
    for leg in found.legs:
        poses = leg.poses
        if leg.informative:
            testing = left[leg.name] <= kept[leg.name]
            left[leg.name] -= 1
            pair = design.sub_experiment(leg.name, "testing" if testing else "training")
            if everywhere:
                pair = _followed(pair, poses[:own], design.voyages[leg.name].log.tau)
            parts += pair
            poses = poses[own:]
        parts.append(Part(leg.name, "passage", len(poses), poses=poses))
    return parts


def _followed(pair: list[Part], poses: Array, force: Array) -> list[Part]:
    """A manoeuvre and its stop with the poses and the force that were planned, (N, n_dof)."""
    edges = np.cumsum([0, *(part.count for part in pair)])
    return [
        replace(part, poses=poses[a:b], force=force[a:b])
        for part, a, b in zip(pair, edges[:-1], edges[1:], strict=True)
    ]
