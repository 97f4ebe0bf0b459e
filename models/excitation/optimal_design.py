"""An informative mix of sub-experiments. Ljungberg (slides), after his thesis.

Standard manoeuvres are simulated with the nominal model in calm water. The optimal mix for
estimating its coefficients is rounded to integer counts and executed, each sub-experiment from
rest, and then those that are held out for testing. A random mix is the baseline.

With a route the candidates are the motion primitives of a planner: each is the simulated track of
the nominal model with its stop, followed by a passage to the lattice. The plan is executed by
feedback along the planned poses plus the simulated force, so that the motion, and with it the
information, is close to the design, also for a vessel that differs from the nominal model.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Literal, NamedTuple

import numpy as np
from annotated_types import Ge, Lt

from seatrial.models.errors import ConfigurationError, Diverged
from seatrial.models.excitation import commands
from seatrial.models.excitation.commands import Piece, Steering
from seatrial.models.excitation.guidance import Reference
from seatrial.models.excitation.information import inseparable, largest_remainder, optimal, scaled
from seatrial.models.excitation.missions import Length, Mission, planar_only
from seatrial.models.planning.planner import Corners, Pace, PlannedPath, PlanningTask, Waters, plan
from seatrial.models.ranges import NotNegative, NotNegativeInt, Positive, PositiveInt, check_ranges
from seatrial.models.recording.recording import Mask, Split
from seatrial.models.simulation.loop import sail
from seatrial.models.simulation.registry import Timetable
from seatrial.models.simulation.voyage import Voyage, recording_of
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.parameters import Plant, VesselParameters
from seatrial.models.vessel.tuning import FromVessel
from seatrial.models.weather.weather import Weather

Role = Literal["training", "testing", "none"]


@dataclass(frozen=True, eq=False)
class Phase:
    """An interval of `count` control instants."""

    name: str
    kind: Literal["manoeuvre", "stop", "passage"]
    count: int
    role: Role = "none"
    force: Array | None = None  # (count, 3) [N, Nm]
    pieces: Sequence[Piece] = ()  # of a yaw moment, from its first instant
    poses: Array | None = None  # (count, 3) that were planned, followed [m, rad]


@dataclass(frozen=True)
class Gains:
    """Feedback that stops the vessel and follows a passage, by degree of freedom."""

    kp: Annotated[tuple[NotNegative, ...], FromVessel("tuning.pid.kp")]  # [N/m, N/m, Nm/rad]
    kd: Annotated[tuple[NotNegative, ...], FromVessel("tuning.pid.kd")]  # [N s/m, N s/m, Nm s/rad]

    def __post_init__(self) -> None:
        check_ranges(self)


@dataclass(frozen=True, eq=False)
class Schedule:
    """Phases on the instants of one control period, for a vessel in surge, sway and yaw."""

    phases: Sequence[Phase]
    period_s: float

    @property
    def edges(self) -> list[int]:
        """First instant of every phase, and the end."""
        return [0, *np.cumsum([phase.count for phase in self.phases]).tolist()]

    def __len__(self) -> int:
        return self.edges[-1]

    def mask(self, role: Role) -> Mask:
        """Instants of the manoeuvres of a role, shape (N,)."""
        return np.concatenate([np.full(phase.count, phase.role == role) for phase in self.phases])

    def force(self) -> Array:
        """Force of the manoeuvres [N, Nm], shape (N, 3)."""
        return np.concatenate(
            [np.zeros((p.count, 3)) if p.force is None else p.force for p in self.phases]
        )

    def steering(self, gains: Gains, limits: Array) -> Steering:
        """Parameters and initial state of the compiled step; `limits` [N, Nm] of the feedback."""
        poses, velocities = np.zeros((2, len(self), 3))
        pieces: list[Piece] = []
        for phase, first in zip(self.phases, self.edges, strict=False):
            end, acts = first + phase.count, phase.kind == "manoeuvre"
            own = list(phase.pieces) or [Piece(law=commands.HOLD if acts else commands.STOP)]
            if phase.poses is not None:
                poses[first:end] = phase.poses
                velocities[first:end] = commands.body_velocities(phase.poses, self.period_s)
                own = [Piece(law=commands.FOLLOW)]
            pieces += [piece._replace(until=min(first + piece.until, end)) for piece in own]
        pieces[-1] = pieces[-1]._replace(until=commands.NEVER)
        feedback = commands.Feedback(np.array(gains.kp), np.array(gains.kd), -limits, limits)
        return commands.command(pieces, np.zeros(3), 2, 2, feedback, poses, velocities)


STEP_S = 0.1  # longest integration step of the design's simulations
Pose = tuple[float, float, float]  # north [m], east [m], heading [deg]


@dataclass(frozen=True)
class Route:
    """The waters that a mix is to be sailed in; without an `area` there is no plan.

    Polygons are lists of (north, east) [m]. `goal` null is the start. `clearance_m` is kept from
    the vessel's reference point; passages are sailed at `speed_m_s` and `turn_rate_rad_s` between
    poses of a lattice of `cell_m`, by default the way of 4 s; after a manoeuvre the vessel rests
    for `hold_s`.
    """

    area: Corners | None
    obstacles: tuple[Corners, ...]
    start: Pose
    goal: Pose | None
    clearance_m: float
    cell_m: Positive | None
    speed_m_s: Annotated[Positive, FromVessel("tuning.reference.speed_m_s")]
    turn_rate_rad_s: Annotated[Positive, FromVessel("tuning.reference.turn_rate_rad_s")]
    hold_s: NotNegative

    def __post_init__(self) -> None:
        check_ranges(self)

    @property
    def waters(self) -> Waters:
        """The area with its obstacles."""
        return Waters(self.area or (), self.obstacles, self.clearance_m)


@dataclass(frozen=True)
class UncertainModel:
    """The model for the design: the nominal one, coefficients times uniform numbers about one."""

    error: Annotated[float, Ge(0), Lt(1)]  # the largest relative one of the coefficients
    seed: NotNegativeInt

    def __post_init__(self) -> None:
        check_ranges(self)


@dataclass(frozen=True)
class OptimalDesign(Mission):
    """`sub_experiments` of the candidates, each `length_s` x `time_scale` long.

    `design`: optimal, by the nominal model of `vessel`, or random, drawn with `draw_seed` from a
    pool of `repeats` of every candidate, or each candidate once. `stop_s` (x `time_scale`) of
    velocity feedback bring the vessel to rest after each. `held_out` are sailed last, for testing;
    without them what lies between manoeuvres is for testing. In the area of `route` the order and
    what lies between follow from a plan. `expected` is what was expected of the mix: half
    the 90 % interval by purpose. `variants` are factors by which `seatrial next` varies candidates.
    """

    candidates: dict[str, Mission]
    sub_experiments: PositiveInt
    design: Literal["optimal", "random", "each"]
    repeats: PositiveInt
    draw_seed: int
    held_out: tuple[str, ...]
    length_s: Positive
    stop_s: Positive
    time_scale: Annotated[Positive, FromVessel("tuning.excitation.time_scale")]
    vessel: VesselParameters
    nominal: UncertainModel
    feedback: Gains
    route: Route
    reference_filter: Reference
    period_s: Positive
    expected: Mapping[str, float] | None = None
    variants: Mapping[str, tuple[float, ...]] | None = None

    open_loop = True  # the vessel is stopped by feedback of the mission's own

    def __post_init__(self) -> None:
        check_ranges(self)
        pool = self.repeats * len(self.candidates)
        if self.design == "random" and self.sub_experiments > pool:
            raise ConfigurationError(
                f"sub_experiments must be at most the pool's {pool}, got {self.sub_experiments}"
            )
        unknown = [name for name in self.held_out if name not in self.candidates]
        if unknown or not (self.held_out or self.design == "each"):
            raise ConfigurationError(
                f"held_out: got {unknown[0] if unknown else 'none'}, expected some of "
                f"{', '.join(self.candidates)}"
            )

    @cached_property
    def plant(self) -> Plant:
        """The model for the design with the vessel's thrusters and limits."""
        model, rng = self.vessel.nominal(), np.random.default_rng(self.nominal.seed)
        error, shape = self.nominal.error, model.theta.shape
        theta = model.theta * rng.uniform(1.0 - error, 1.0 + error, shape)
        return self.vessel.plant(replace(model, theta=theta))

    @property
    def limits(self) -> Array:
        """Largest feedback by degree of freedom [N, Nm]."""
        known = self.vessel.limits_by_dof
        return np.array([known.get(dof, np.inf) for dof in self.vessel.dofs])

    @property
    def counts_of_parts(self) -> tuple[int, int]:
        """Instants of a candidate, and of the stop that brings the vessel to rest."""
        scale = self.time_scale / self.period_s
        return max(2, round(self.length_s * scale)), max(2, round(self.stop_s * scale))

    def sub_experiment(self, name: str, role: Role) -> list[Phase]:
        """A candidate, followed by its stop; repeated calls give equal forces."""
        mission, dofs, period_s = self.candidates[name], self.vessel.dofs, self.period_s
        count, stop = self.counts_of_parts
        t = period_s * np.arange(count, dtype=np.float64)
        rng = np.random.default_rng(list(self.candidates).index(name))
        force, pieces = mission.force(t, dofs, rng), mission.pieces(period_s)
        manoeuvre = Phase(name, "manoeuvre", count, role, force, pieces)
        return [manoeuvre, Phase(name, "stop", stop)]

    @cached_property
    def voyages(self) -> dict[str, Voyage]:
        """Every candidate and its stop by the nominal model, in calm water, at first at rest."""
        found, period_s = dict[str, Voyage](), self.period_s
        for name in self.candidates:
            schedule = Schedule(self.sub_experiment(name, "training"), period_s)
            still = np.zeros((len(schedule), len(self.vessel.dofs)))
            try:
                found[name] = sail(
                    self.plant, Weather(still, still, still, still),
                    (Timetable(still), np.zeros(1)), self.reference_filter.table(period_s),
                    schedule.steering(self.feedback, self.limits), still[0], period_s,
                    min(STEP_S, period_s), added=schedule.force(),
                )  # fmt: skip
            except (Diverged, ConfigurationError) as error:
                where = f"excitation.candidates.{name}: by the nominal model"
                raise ConfigurationError(f"{where}: {error}") from error
        return found

    @cached_property
    def gammas(self) -> Array:
        """Scaled information of every candidate without its stop, shape (Q, n, n)."""
        terms, (count, _) = self.plant.vessel.terms, self.counts_of_parts
        motions = [recording_of(each, each.weather).variables() for each in self.voyages.values()]
        phis = [basis.evaluate(terms, x)[:count] for x in motions]
        return scaled(np.array([phi.T @ phi / len(phi) for phi in phis]))

    @cached_property
    def weights(self) -> tuple[Array, float]:
        """The optimal shares of the candidates, and their optimality gap."""
        return optimal(self.gammas, [term.name for term in self.plant.vessel.terms])

    @cached_property
    def counts(self) -> dict[str, int]:
        """Sub-experiments of every candidate in the mix, without those held out."""
        if self.design == "each":
            return dict.fromkeys(self.candidates, 1)
        if self.design == "optimal":
            counts = largest_remainder(self.weights[0], self.sub_experiments)
            terms = [term.name for term in self.plant.vessel.terms]
            if names := inseparable(np.tensordot(counts, self.gammas, axes=1), terms):
                raise ConfigurationError(
                    f"excitation.sub_experiments: {self.sub_experiments} of the optimal mix do not "
                    f"separate {', '.join(names)}, expected more"
                )
        else:
            pool = np.repeat(np.arange(len(self.candidates)), self.repeats)
            rng = np.random.default_rng(self.draw_seed)
            drawn = rng.choice(pool, self.sub_experiments, replace=False)
            counts = np.bincount(drawn, minlength=len(self.candidates))
        return dict(zip(self.candidates, counts.tolist(), strict=True))

    @property
    def names(self) -> list[str]:
        """What is sailed: the mix in the order of the candidates, then what is held out."""
        return [*Counter(self.counts).elements(), *self.held_out]

    @cached_property
    def plan(self) -> PlannedPath | None:
        """The path of the manoeuvres through the area; None where there is none."""
        route = self.route
        if route.area is None and not route.obstacles:
            return None
        start, goal = np.array([route.start, route.goal or route.start]) * [1.0, 1.0, np.pi / 180.0]
        tracks = {name: voyage.log.eta for name, voyage in self.voyages.items()}
        cell_m = route.cell_m or 4.0 * route.speed_m_s
        pace = Pace(route.speed_m_s, route.turn_rate_rad_s, self.period_s)
        hold, counts = round(route.hold_s / self.period_s), Counter(self.names)
        return plan(PlanningTask(route.waters, tracks, counts, start, goal, cell_m, pace, hold))

    @cached_property
    def schedule(self) -> Schedule:
        """The mix and what is held out, of each candidate the last.

        On a plan a manoeuvre has the simulated force, and all poses are followed.
        """
        remaining, phases = Counter(self.names), list[Phase]()

        def sailed(name: str) -> list[Phase]:
            testing = remaining[name] <= self.held_out.count(name)
            remaining[name] -= 1
            return self.sub_experiment(name, "testing" if testing else "training")

        if self.plan is None:
            return Schedule([phase for name in self.names for phase in sailed(name)], self.period_s)
        for leg in self.plan.legs:
            first = 0
            for phase in sailed(leg.name) if leg.informative else ():
                here = slice(first, first + phase.count)
                force = self.voyages[leg.name].log.tau[here]
                phases.append(replace(phase, poses=leg.poses[here], force=force))
                first = here.stop
            rest = leg.poses[first:]
            phases.append(Phase(leg.name, "passage", len(rest), poses=rest))
        return Schedule(phases, self.period_s)

    @property
    def start(self) -> Array:
        """The pose that it begins at [m, m, rad], shape (3,)."""
        return np.zeros(3) if self.plan is None else self.plan.start

    @property
    def duration_s(self) -> float:
        """Length of all sub-experiments with their stops [s]."""
        return len(self.schedule) * self.period_s

    def rows(self) -> Iterator[tuple[float, str]]:
        """Length [s] of each phase, and what is done."""
        for phase in self.schedule.phases:
            yield self.period_s * phase.count, f"{phase.kind} {phase.name}"

    def length(self) -> Length:
        """The length of all sub-experiments with their stops, without the passages of a plan."""
        each = (self.length_s + self.stop_s) * self.time_scale
        seconds = each * (self.sub_experiments + len(self.held_out))
        options = "sub_experiments", "length_s", "stop_s", "time_scale"
        option = max(options, key=lambda name: getattr(self, name))
        return Length(option, getattr(self, option), seconds)

    def guidance(self, t: Array, start: Array) -> tuple[NamedTuple, Array]:
        """The poses of the plan as set-points; without a plan the starting pose."""
        if self.plan is None:
            return super().guidance(t, start)
        return Timetable(np.ascontiguousarray(self.plan.poses[: len(t)])), np.zeros(1)

    def force(self, t: Array, dofs: Sequence[str], rng: np.random.Generator) -> Array:
        """Force of the manoeuvres [N, Nm] at the times t [s], shape (N, n_dof)."""
        return self.schedule.force()[: len(t)]

    def steering(self, dofs: Sequence[str], period_s: float) -> Steering | None:
        """The step that replaces the controller."""
        return self.schedule.steering(self.feedback, self.limits)

    def split(self, t: Array) -> Split:
        """Training: the manoeuvres of the mix; testing: those held out, or what is between."""
        roles: tuple[Role, Role] = "training", "testing" if self.held_out else "none"
        return Split(*(self.schedule.mask(role)[: len(t)] for role in roles))

    def check(self, dofs: Sequence[str]) -> None:
        """Raise ConfigurationError unless the vessel is planar and the mix can be designed."""
        planar_only("a mix of manoeuvres", dofs)
        for name, candidate in self.candidates.items():
            candidate.check(dofs)
            if not candidate.open_loop or type(candidate).steering is not Mission.steering:
                raise ConfigurationError(
                    f"excitation.candidates.{name}: expected a mission by forces in an open loop"
                )
        if {len(self.feedback.kp), len(self.feedback.kd)} != {3}:
            raise ConfigurationError("excitation.feedback: expected three numbers for kp and kd")
        _ = self.schedule

    def check_limits(self, limits: Mapping[str, float], period_s: float) -> None:
        """Raise ConfigurationError if a force exceeds the limits of the thrusters [N, Nm]."""
        for name, candidate in self.candidates.items():
            try:
                candidate.check_limits(limits, period_s)
            except ConfigurationError as error:
                raise ConfigurationError(f"excitation.candidates.{name}: {error}") from error
