"""An informative mix of sub-experiments. Ljungberg (slides), after his thesis.

Standard manoeuvres are simulated with the nominal model in calm water. The optimal mix for
estimating its coefficients is rounded to integer counts and executed, each sub-experiment from
rest. Further sub-experiments follow, held out for testing. A random mix, drawn from a pool with
the same number of every manoeuvre, is the baseline.

With a route the candidates are the motion primitives of a planner: each is the simulated track of
the nominal model with its stop, followed by a passage to the lattice. The plan is executed by
feedback along the planned poses plus the simulated force, so that the motion, and with it the
information, is close to the design, also for a vessel that differs from the nominal model.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Literal, NamedTuple

import numpy as np

from seatrial.models.errors import ConfigurationError, Diverged
from seatrial.models.excitation.commands import Command, Steering
from seatrial.models.excitation.guidance import Reference
from seatrial.models.excitation.information import (
    Integers,
    Weights,
    information,
    inseparable,
    largest_remainder,
    log_det,
    optimal,
    scaled,
)
from seatrial.models.excitation.missions import Length, Mission
from seatrial.models.excitation.schedule import Gains, Phase, Role, Schedule
from seatrial.models.notation import PLANAR
from seatrial.models.planning.planner import Corners, Pace, PlannedPath, PlanningTask, Waters, plan
from seatrial.models.ranges import NotNegative, NotNegativeInt, Positive, PositiveInt, check_ranges
from seatrial.models.recording.recording import Split
from seatrial.models.simulation.loop import sail
from seatrial.models.simulation.registry import Timetable
from seatrial.models.simulation.voyage import Voyage
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array, Term
from seatrial.models.vessel.parameters import Plant, VesselParameters
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.tuning import FromVessel
from seatrial.models.weather.weather import Weather

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
        if self.area is not None:
            _ = self.waters
        elif self.obstacles:
            raise ConfigurationError("obstacles: got obstacles without an area, expected an area")

    @property
    def waters(self) -> Waters:
        """The area with its obstacles."""
        return Waters(self.area or (), self.obstacles, self.clearance_m)

    def plan(self, mix: "OptimalDesign", names: Sequence[str]) -> PlannedPath | None:
        """The path that sails the named candidates of a mix; None without an area.

        Raises ConfigurationError with what stands in the way.
        """
        if self.area is None:
            return None
        task = PlanningTask(
            waters=self.waters,
            primitives={name: voyage.log.eta for name, voyage in mix.voyages.items()},
            counts=Counter(names),
            start=_pose(self.start),
            goal=_pose(self.start if self.goal is None else self.goal),
            cell_m=4.0 * self.speed_m_s if self.cell_m is None else self.cell_m,
            pace=Pace(self.speed_m_s, self.turn_rate_rad_s, mix.period_s),
            hold=round(self.hold_s / mix.period_s),
        )
        try:
            return plan(task)
        except ConfigurationError as error:
            raise ConfigurationError(f"excitation.route: {error}") from error


def _pose(pose: Pose) -> Array:
    return np.array([pose[0], pose[1], np.radians(pose[2])])


@dataclass(frozen=True)
class UncertainModel:
    """The model for the design of a mix; `error` is the relative error of its coefficients."""

    error: float
    seed: NotNegativeInt

    def __post_init__(self) -> None:
        check_ranges(self)
        if not 0.0 <= self.error < 1.0:
            raise ConfigurationError(f"error must lie between 0 and 1, got {self.error}")

    def model(self, nominal: Vessel) -> Vessel:
        """The nominal model with coefficients multiplied by uniform numbers about one."""
        rng = np.random.default_rng(self.seed)
        factors = rng.uniform(1.0 - self.error, 1.0 + self.error, nominal.theta.shape)
        return replace(nominal, theta=nominal.theta * factors)


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
        """The nominal model with the vessel's thrusters and limits."""
        return self.vessel.plant(self.nominal.model(self.vessel.nominal()))

    @property
    def limits(self) -> Array:
        """Largest feedback by degree of freedom [N, Nm]."""
        known = self.vessel.limits_by_dof
        return np.array([known.get(dof, np.inf) for dof in self.vessel.dofs])

    @property
    def terms(self) -> tuple[Term, ...]:
        """The terms of the nominal model."""
        return self.plant.vessel.terms

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

    def voyage(self, name: str) -> Voyage:
        """Simulate a candidate and its stop in calm water, from rest at the origin."""
        period_s = self.period_s
        plan = Schedule(self.sub_experiment(name, "training"), period_s)
        still = np.zeros((len(plan), len(self.vessel.dofs)))
        try:
            return sail(
                self.plant, Weather(still, still, still, still), (Timetable(still), np.zeros(1)),
                self.reference_filter.table(period_s),
                plan.steering(self.feedback, self.limits), still[0], period_s,
                min(STEP_S, period_s), added=plan.force(),
            )  # fmt: skip
        except (Diverged, ConfigurationError) as error:
            raise ConfigurationError(
                f"excitation.candidates.{name}: simulation of the nominal model failed: {error}"
            ) from error

    @cached_property
    def voyages(self) -> dict[str, Voyage]:
        """The simulation of every candidate with the nominal model."""
        return {name: self.voyage(name) for name in self.candidates}

    @cached_property
    def gammas(self) -> Array:
        """Scaled information of every candidate without its stop, shape (Q, n, n)."""
        matrices, (count, _) = [], self.counts_of_parts
        for voyage in self.voyages.values():
            nu_dot, nu = voyage.log.nu_dot[:count], voyage.log.nu[:count]
            attitude = np.zeros((count, 3))
            attitude[:, 2] = voyage.log.eta[:count, 2]
            x = basis.variables(nu_dot, nu, attitude, voyage.dofs)
            matrices.append(information(basis.evaluate(self.terms, x)))
        return scaled(np.array(matrices))

    @cached_property
    def weights(self) -> Weights:
        """The optimal shares of the candidates."""
        return optimal(self.gammas, [term.name for term in self.terms])

    def log_det(self, counts: Array | Integers) -> float:
        """log det of the mean information of a mix; -inf where it is singular."""
        return log_det(self.gammas, np.asarray(counts, dtype=np.float64) / float(np.sum(counts)))

    @cached_property
    def counts(self) -> dict[str, int]:
        """Sub-experiments of every candidate in the mix, without those held out."""
        if self.design == "each":
            return dict.fromkeys(self.candidates, 1)
        if self.design == "optimal":
            counts = largest_remainder(self.weights.share, self.sub_experiments)
            terms, share = [term.name for term in self.terms], counts / self.sub_experiments
            if names := inseparable(np.tensordot(share, self.gammas, axes=1), terms):
                raise ConfigurationError(
                    f"excitation.sub_experiments: {self.sub_experiments} of the optimal mix do not "
                    f"separate {', '.join(names)}, expected more"
                )
        else:
            pool = np.repeat(np.arange(len(self.candidates)), self.repeats)
            rng = np.random.default_rng(self.draw_seed)
            drawn = rng.choice(pool, self.sub_experiments, replace=False)
            counts = np.bincount(drawn, minlength=len(self.candidates)).astype(np.int64)
        return {name: int(n) for name, n in zip(self.candidates, counts, strict=True)}

    @cached_property
    def plan(self) -> PlannedPath | None:
        """The path of the manoeuvres through the area; None where there is none."""
        return self.route.plan(self, self._to_be_sailed)

    @property
    def _to_be_sailed(self) -> list[str]:
        """The mix in the order of the candidates, then what is held out."""
        return [*(name for name, n in self.counts.items() for _ in range(n)), *self.held_out]

    @cached_property
    def schedule(self) -> Schedule:
        """The mix and what is held out, of each candidate the last.

        On a plan a manoeuvre has the simulated force, and all poses are followed.
        """
        names = self._to_be_sailed
        remaining, phases = Counter(names), list[Phase]()

        def sailed(name: str) -> list[Phase]:
            testing = remaining[name] <= self.held_out.count(name)
            remaining[name] -= 1
            return self.sub_experiment(name, "testing" if testing else "training")

        if self.plan is None:
            return Schedule([phase for name in names for phase in sailed(name)], self.period_s)
        for leg in self.plan.legs:
            first = 0
            for phase in sailed(leg.name) if leg.informative else ():
                force = self.voyages[leg.name].log.tau
                here = slice(first, first + phase.count)
                phases.append(replace(phase, poses=leg.poses[here], force=force[here]))
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

    def length(self) -> Length:
        """The length of all sub-experiments with their stops, without the passages of a plan."""
        each = (self.length_s + self.stop_s) * self.time_scale
        count = self.sub_experiments + len(self.held_out)
        if count > self.length_s:
            return Length("sub_experiments", self.sub_experiments, count * each)
        option = max(("length_s", "stop_s", "time_scale"), key=lambda name: getattr(self, name))
        return Length(option, getattr(self, option), count * each)

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
        train = self.schedule.mask("training")[: len(t)].copy()
        test = self.schedule.mask("testing" if self.held_out else "none")[: len(t)].copy()
        return Split(train, test)

    def check(self, dofs: Sequence[str]) -> None:
        """Raise ConfigurationError unless the vessel is planar and the mix can be designed."""
        if tuple(dofs) != PLANAR:
            raise ConfigurationError(
                f"excitation=optimal_design needs a vessel in {', '.join(PLANAR)}, got one in "
                f"{', '.join(dofs)}"
            )
        for name, candidate in self.candidates.items():
            candidate.check(dofs)
            steered = candidate.steering(dofs, self.period_s)
            step = None if steered is None else steered[0]
            forced = isinstance(step, Command) and not len(step.feedback.kp)
            if candidate.commands_inputs or not forced:
                raise ConfigurationError(
                    f"excitation.candidates.{name}: is sailed by a controller, expected an open "
                    "loop"
                )
        if len(self.feedback.kp) != 3 or len(self.feedback.kd) != 3:
            raise ConfigurationError(
                f"excitation.feedback: got {len(self.feedback.kp)} and {len(self.feedback.kd)} "
                "numbers, expected 3 each"
            )
        _ = self.schedule

    def check_limits(self, limits: Mapping[str, float], period_s: float) -> None:
        """Raise ConfigurationError if a force exceeds the limits of the thrusters [N, Nm]."""
        for name, candidate in self.candidates.items():
            try:
                candidate.check_limits(limits, period_s)
            except ConfigurationError as error:
                what = str(error).removeprefix("excitation.")
                raise ConfigurationError(f"excitation.candidates.{name}.{what}") from error
