"""`seatrial next`: what is known of a vessel, what is to be predicted, and a sequence for it.

Runs are identified once more, all recordings together, by the identifier of the last one.
Candidates of a steered vessel are those of `excitation=helm_sequence`. It sails from one to the
next on paths of Dubins, and back to its start, with what is really turned simulated each time. A
vessel that is commanded by forces has those of `excitation=optimal_design` at several sizes and
speeds, which that excitation plans. Without an area there are no joins.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import islice, product
from typing import Any, NamedTuple

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.helm_sequence import HelmSequence, HelmStep, join_steps
from seatrial.models.excitation.missions import Mission
from seatrial.models.excitation.next_experiment import (
    DRAWS,
    SIMULATED,
    Belief,
    Purpose,
    believed,
    doubted,
    ranked,
    residual_deviation,
    scale_of,
)
from seatrial.models.excitation.optimal_design import OptimalDesign
from seatrial.models.identification.problem import Problem
from seatrial.models.notation import MEASURES, OrderedManoeuvre
from seatrial.models.planning.dubins import Arc, dubins, poses_along
from seatrial.models.planning.dubins import length_of as length_of_path
from seatrial.models.planning.planner import Waters, clear, inside, simplified
from seatrial.models.recording.recording import Recording, end_to_end
from seatrial.models.simulation.manoeuvre_sheet import DEVIATION_SHARE, Measures, Track, sheet
from seatrial.models.simulation.voyage import recording_of
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import in_ned
from seatrial.models.vessel.table import Vessel
from seatrial.runner.configuration.config import Trial, build_as
from seatrial.runner.trials.closed_loop import Streams, prepare
from seatrial.runner.trials.deployment_metrics import tracking_metrics
from seatrial.runner.trials.manoeuvre_results import UNABLE, sailed
from seatrial.runner.trials.trial import evaluated, excite, identify

APPROACH = 3.0  # on a straight course before a manoeuvre [L / U]
CIRCLE, ZIGZAG = 40.0, 60.0  # lengths of the manoeuvres that are measured [L / U]
ZIGZAG_DEG = 10.0  # of the zig-zag that is measured; its share of a helm that is no angle
ZIGZAG_SHARE = 0.3
STEERED = 0.02  # of the largest helm, below which it keeps a course
EVERY = 25  # samples of a circle of which one is predicted
JOIN_SHARE = 0.6  # of the largest helm, in joins
GRID, HEADINGS = 9, 8  # of poses at which a candidate may begin
TRIED, PLACES = 12, 3  # candidates, and beginnings of each, that are simulated in turn
STRAY, DETAIL = 0.5, 0.05  # [L] from a path of Dubins, and of a simplified track
ORIGIN = np.zeros((1, 2))
Node = Mapping[str, object]


@dataclass(frozen=True, eq=False)
class Known:
    """What is known: the distribution, and the errors of accelerations by which more is learnt."""

    trial: Trial  # of the vessel in calm water; its excitation is the family of the candidates
    belief: Belief
    deviation: Array  # (n_dof,) [m/s^2, rad/s^2]
    scale: float  # of independent samples in one

    def information(self, motion: Recording) -> Array:
        """What a motion tells, shape (m, m)."""
        return self.scale * self.belief.information(motion, self.deviation)

    def sailed(self, mission: Mission, model: Vessel | None = None) -> Recording:
        """The motion of a model in calm water, by default of the one that is known."""
        return sailed(self.trial, mission, self.belief.model if model is None else model)


def after_runs(trials: Sequence[Trial], calm: Trial) -> Known:
    """What is known after the recordings of trials; raises SeatrialError if nothing can be."""
    last, seeds = trials[-1], [Streams(trial.seed) for trial in trials]
    data = [excite(*each).recording for each in zip(trials, seeds, strict=True)]
    recording = end_to_end(data) if len(data) > 1 else data[0]
    problem = Problem(recording, recording, last.vessel.nominal(), last.vessel.thruster)
    result, _ = identify(last, problem, seeds[-1])
    if result.spread is None:
        name = last.names["identifier"]
        raise ConfigurationError(
            f"next: identifier={name} gives no joint distribution, expected robust or auto"
        )
    belief = believed(result.model, [*result.draws(DRAWS, DEVIATION_SHARE)], DEVIATION_SHARE)
    deviation = residual_deviation(result.model, recording)
    return Known(calm, belief, deviation, scale_of(belief.information(recording, deviation)))


def nominal(calm: Trial, noisy: Trial, doubt: float) -> Known:
    """The nominal model with a doubt, half the 90 % interval of its parameters over their size."""
    rng, model = np.random.default_rng(0), calm.vessel.nominal()
    draws = [doubted(model, doubt, rng, DEVIATION_SHARE) for _ in range(DRAWS)]
    assert noisy.disturbance.noise is not None
    deviation = noisy.disturbance.noise.deviations(calm.vessel.dofs)[2]
    return Known(calm, believed(model, draws, DEVIATION_SHARE), deviation, 1.0)


def purpose_of(known: Known, name: str, percent: bool, tracked: Trial | None = None) -> Purpose:
    """What is to be predicted, with its gradient over the draws.

    `name` is a measure of a manoeuvre such as tactical_diameter, `coefficients`, one of them such
    as `sway.v`, `FIT` of a turning circle, or `e_pos` of the trial `tracked`; half widths are in
    `percent` of the value, or in its unit. Raises ConfigurationError if there is no such measure.
    """
    belief = known.belief
    if name == "coefficients" or name in belief.labels:
        rows = np.any(belief.basis != 0.0, axis=1) & (belief.values != 0.0)
        if name != "coefficients":
            rows &= np.array(belief.labels) == name
        if not np.any(rows):
            raise ConfigurationError(f"next: {name} is not uncertain, expected coefficients")
        size = np.abs(belief.values[rows, None]) / 100.0 if percent else 1.0
        unit = "%" if percent else ""
        return Purpose(name, unit, belief.basis[rows] / size, median=True)
    value, unit = value_of(known, name, tracked)
    own = value(belief.model)
    if not np.all(np.isfinite(own)):
        raise ConfigurationError(f"next: the model that is known does not reach {name}")
    drawn = np.full((len(belief.draws[:SIMULATED]), len(own)), np.nan)
    for row, model in zip(drawn, belief.draws, strict=False):
        try:
            row[:] = value(model)
        except UNABLE:
            continue
    gradient, text = belief.gradient(drawn, own), ""
    if len(own) == 1:
        text = f"{own[0]:.4g} {unit}"
        if percent:
            gradient, unit = 100.0 * gradient / np.abs(own), "%"
    return Purpose(name, unit, gradient, text)


def value_of(
    known: Known, name: str, tracked: Trial | None = None
) -> tuple[Callable[[Vessel], Array], str]:
    """What is predicted, of a model (raises what one cannot do), and its unit."""
    if name == "e_pos":
        if tracked is None or tracked.controller is None:
            raise ConfigurationError(
                "next: e_pos: expected --after RUNS, the last with a controller"
            )
        return partial(_tracking, known, tracked), "m"
    manoeuvres, quantity = reference_manoeuvres(known), name.replace("_", " ")
    if name == "FIT" and manoeuvres:
        size = np.std(known.sailed(manoeuvres["turn"]).nu, axis=0)
        size = np.where(size > 0.0, size, np.inf) / 100.0
        return lambda m: (known.sailed(manoeuvres["turn"], m).nu[::EVERY] / size).ravel(), "%"
    kinds = dict[str, str]()
    for kind in manoeuvres:
        for own, value in _measures(known, kind, known.belief.model).items():
            if np.isfinite(value):
                kinds.setdefault(own, kind)
    if quantity in kinds:
        return lambda model: np.array(
            [_measures(known, kinds[quantity], model).get(quantity, np.nan)]
        ), MEASURES[quantity]
    names = ", ".join(kinds).replace(" ", "_").replace(",_", ", ") or "no other"
    raise ConfigurationError(
        f"next: {known.trial.vessel.name} has no measure {name}, expected coefficients, FIT, e_pos "
        f"or one of {names}"
    )


def reference_manoeuvres(known: Known) -> dict[str, Mission]:
    """The turning circle of the largest helm and the zig-zag whose measures are predicted."""
    family = known.trial.excitation
    if isinstance(family, OptimalDesign):
        return {"turn": family.candidates["circle"]}
    assert isinstance(family, HelmSequence)
    angle, unit_s = family.helm == "delta", family.unit_s
    small = float(np.radians(ZIGZAG_DEG)) if angle else family.order(ZIGZAG_SHARE)
    steps = {
        "turn": HelmStep("hold", CIRCLE * unit_s, family.order(1.0)),
        "zigzag": HelmStep("zigzag", ZIGZAG * unit_s, small, ZIGZAG_DEG),
    }
    approach = HelmStep("turn", APPROACH * unit_s)
    return {kind: replace(family, steps=(approach, step)) for kind, step in steps.items()}


def _measures(known: Known, kind: str, model: Vessel) -> Measures:
    """The sheet of a reference manoeuvre of a model; empty if it cannot carry it out."""
    length, family = known.trial.vessel.scales.length_m, known.trial.excitation
    try:
        run = known.sailed(reference_manoeuvres(known)[kind], model)
        helm = run.tau[:, 2]
        if isinstance(family, HelmSequence) and run.inputs is not None:
            helm = run.inputs[:, family.index]
        away = helm - helm[0]
        away = np.where(np.abs(away) >= STEERED * np.max(np.abs(away)), away, 0.0)
        north, east, psi = run.eta.T
        track = Track(run.t, north, east, psi, away, np.hypot(*run.nu[:, :2].T), length)
        return sheet(track, OrderedManoeuvre(kind, turn_deg=ZIGZAG_DEG)).values  # type: ignore[arg-type]
    except UNABLE:
        return {}


def _tracking(known: Known, trial: Trial, plant: Vessel) -> Array:
    """The mean absolute position error of a plant under the controller on the model known."""
    setup = prepare(trial, Streams(0), known.belief.model, evaluated(trial), True, plant)
    rows = tracking_metrics(setup.sail().voyage, "identified", trial.sample_time_s)
    return np.array([next(row.value or 0.0 for row in rows if row.name == "e_pos_mae")])


class Candidate(NamedTuple):
    """A manoeuvre that can be sailed: its steps, or its node, and its motion."""

    name: str
    seconds: float
    motion: Recording
    steps: tuple[HelmStep, ...] = ()
    node: Node | None = None


class Sailed(NamedTuple):
    """The candidates with the instants [s] at which they begin, and how they are sailed."""

    chosen: tuple[tuple[float, int], ...] = ()
    mission: Mission | None = None
    motion: Recording | None = None
    steps: tuple[HelmStep, ...] = ()  # of a steered vessel, without its return

    @property
    def seconds(self) -> float:
        """Its length."""
        return 0.0 if self.mission is None else self.mission.duration_s


@dataclass(frozen=True, eq=False)
class Sea:
    """What is known of a vessel, its waters, if they are limited, its start (3,) and the time."""

    known: Known
    waters: Waters | None
    start: Array
    seconds: float

    @property
    def node_of_family(self) -> dict[str, Any]:
        """The options of the excitation that all candidates are of."""
        node: Any = self.known.trial.config["excitation"]
        return {**node}


@dataclass(frozen=True, eq=False)
class SteeredPlanner(Sea):
    """The candidates of a steered vessel, and how they are added to a sequence."""

    def __post_init__(self) -> None:
        if self.waters is None:
            return
        if (reason := self.waters.in_the_way(self.start[:2])) is not None:
            raise ConfigurationError(f"next: the start: {reason}")
        radius, speed = self.circle
        if self.waters.free(radius).is_empty:
            raise ConfigurationError(
                f"next: area: no turning circle fits, expected room for one of {2.0 * radius:.3g} m"
                f" at {speed:.2g} m/s and a clearance of {self.waters.clearance_m:g} m"
            )

    @cached_property
    def family(self) -> HelmSequence:
        """A mission of the vessel from the start."""
        family, (north, east, heading) = self.known.trial.excitation, self.start
        assert isinstance(family, HelmSequence)
        return replace(family, start_pose=(north, east, float(np.degrees(heading))))

    @cached_property
    def candidates(self) -> list[Candidate]:
        """What the vessel can sail, by the model that is known; what it cannot is left out."""
        family, found = self.known.trial.excitation, []
        assert isinstance(family, HelmSequence)
        approach = HelmStep("turn", round(APPROACH * family.unit_s, 1), train=False)
        for name, steps in family.manoeuvres():
            mission = replace(family, steps=(approach, *steps), approach_s=0.0)
            try:
                mission.check(self.known.trial.vessel.dofs)
                motion = self.known.sailed(mission)
            except UNABLE:
                continue
            found.append(Candidate(name, mission.duration_s, motion, mission.steps))
        return found

    @cached_property
    def helms(self) -> Array:
        """Orders in joins to port and to starboard, (2,)."""
        sign = self.family.input_signs[self.family.index]
        return np.array([self.family.order(side * sign * JOIN_SHARE) for side in (-1.0, 1.0)])

    @cached_property
    def circle(self) -> tuple[float, float]:
        """Radius [m] and speed [m/s] of the wider of the steady turns at these orders."""
        found = []
        for helm in self.helms:
            step = HelmStep("hold", CIRCLE * self.family.unit_s, float(helm))
            run = self.known.sailed(replace(self.family, steps=(step,)))
            last = run.nu[-len(run) // 4 :]
            speed = float(np.mean(np.hypot(last[:, 0], last[:, 1])))
            found.append((speed / max(float(np.mean(np.abs(last[:, 2]))), 1e-9), speed))
        return max(found)

    def added(self, so_far: Sailed, number: int) -> Sailed | None:
        """The sequence with one candidate more and the return; None: it does not fit."""
        candidate, free = self.candidates[number], self.waters and self.waters.free()
        for join in self._joins(so_far.steps, candidate.motion):
            begins = float(sum(step.seconds for step in (*so_far.steps, *join)))
            if begins + candidate.seconds > self.seconds:
                continue
            steps = (*so_far.steps, *join, *candidate.steps)
            mission = replace(self.family, steps=steps)
            try:
                motion = self.known.sailed(mission)
                if free is not None:
                    back = self._join(dubins(motion.eta[-1], self.start, self.circle[0]), 1.0)
                    mission = replace(mission, steps=(*steps, *back))
                    motion = self.known.sailed(mission)
            except UNABLE:
                continue
            in_waters = free is None or clear(free, self._track(motion), ORIGIN)[0]
            if in_waters and mission.duration_s <= self.seconds:
                return Sailed((*so_far.chosen, (begins, number)), mission, motion, steps)
        return None

    def _track(self, motion: Recording) -> Array:
        return simplified(motion.eta[:, :2], DETAIL * self.family.length_m)

    def _join(self, path: tuple[Arc, ...], settle: float) -> list[HelmStep]:
        """A path as steps, with a time [L / U] on the last course."""
        return join_steps(path, *self.circle, self.helms, settle * self.family.unit_s)

    def _joins(self, steps: tuple[HelmStep, ...], motion: Recording) -> Iterator[list[HelmStep]]:
        """No join, then the shortest ones to poses on a grid at which a motion is clear."""
        yield []
        if self.waters is None:
            return
        free, track = self.waters.free(STRAY * self.family.length_m), self._track(motion)
        if free.is_empty:
            return
        end, radius, found = self.start, self.circle[0], []
        if steps:
            end = self.known.sailed(replace(self.family, steps=steps)).eta[-1]
        south, west, north, east = free.bounds
        grid = np.meshgrid(np.linspace(south, north, GRID), np.linspace(west, east, GRID))
        points = np.stack(grid, axis=-1).reshape(-1, 2)
        points = points[inside(free, points)]
        for heading in 2.0 * np.pi * np.arange(HEADINGS) / HEADINGS:
            turned = in_ned(track, heading)
            for point in points[clear(free, turned, points)]:
                last = np.array([*(point + turned[-1]), heading + motion.eta[-1, 2]])
                there = dubins(end, np.array([*point, heading]), radius)
                back = dubins(last, self.start, radius)
                found.append((length_of_path(there) + length_of_path(back), there))
        possible = (
            path for _, path in sorted(found, key=lambda each: each[0])
            if clear(free, poses_along(end, path, radius, 0.25 * radius)[:, :2], ORIGIN)[0]
        )  # fmt: skip
        yield from (self._join(path, APPROACH) for path in islice(possible, PLACES))

    def node(self, sailed: Sailed, expected: Mapping[str, float]) -> dict[str, object]:
        """The excitation that sails a sequence."""
        steps = [vars(step) for step in getattr(sailed.mission, "steps", ())]
        pose = [*map(float, self.family.start_pose)]
        own = {"steps": steps, "start_pose": pose, "expected": expected, "candidates": []}
        return self.node_of_family | own

    def rows(self, sailed: Sailed) -> Iterator[tuple[float, str]]:
        """Begin [s] of each step of the helm, and what it does."""
        mission = sailed.mission
        assert isinstance(mission, HelmSequence)
        for begin, step in zip(mission.edges_s, mission.steps, strict=False):
            degrees = f"{np.degrees(step.order):.1f} deg"
            text = f"{mission.helm} {degrees if mission.helm == 'delta' else f'{step.order:.4g}'}"
            if step.kind == "zigzag":
                text += f", to the other side at {step.turn_deg:g} deg"
            if step.kind == "turn":
                text += f" for a turn by {step.turn_deg:.0f} deg, then straight"
            yield float(begin), text if step.kind != "turn" or step.turn_deg else "straight"


class ForcePlanner(Sea):
    """The candidates of a vessel that is commanded by forces, and how they are added."""

    def design(self, nodes: Mapping[str, Node]) -> OptimalDesign:
        """The mission that sails each of some candidates once."""
        return build_as(OptimalDesign, self._node(nodes), "excitation")

    def _node(self, nodes: Mapping[str, Node], expected: Node | None = None) -> dict[str, object]:
        base, waters = self.node_of_family, self.waters
        north, east, heading = map(float, self.start)
        route = {**base["route"], "start": [north, east, float(np.degrees(heading))]}
        if waters is not None:
            route |= {"area": waters.area, "obstacles": waters.obstacles}
            route["clearance_m"] = waters.clearance_m
        own: Node = {"candidates": dict(nodes), "design": "each", "held_out": [], "variants": None}
        return {**base, **own, "expected": expected, "route": route}

    @cached_property
    def candidates(self) -> list[Candidate]:
        """Those of the excitation at other sizes and speeds, as far as the vessel can sail them."""
        trial, found = self.known.trial, []
        for name, node in self._varied():
            design = replace(self, waters=None).design({name: node})
            try:
                design.check(trial.vessel.dofs)
                design.check_limits(trial.vessel.limits_by_dof, trial.sample_time_s)
                voyage = design.voyages[name]
            except UNABLE:
                continue
            motion = recording_of(voyage, voyage.weather)
            found.append(Candidate(name, float(voyage.t[-1]), motion, node=node))
        return found

    def _varied(self) -> Iterator[tuple[str, Node]]:
        """Names and nodes of the candidates at other sizes and speeds."""
        base = self.node_of_family
        for name, own in base["candidates"].items():
            steered = "turn_deg" in own
            slowness = (1.0,) if steered else base["variants"]["slowness"]
            for size, slow in product(base["variants"]["size"], slowness):
                changes = {"yaw_moment_nm": size * own["yaw_moment_nm"]} if steered else {
                    "amplitude": {axis: size * most for axis, most in own["amplitude"].items()},
                    "time_scale": slow * own["time_scale"],
                }  # fmt: skip
                pace = f", slower x {slow:g}" if slow != 1.0 else ""
                yield f"{name}, {100.0 * size:g} %{pace}", {**own, **changes}

    def _nodes(self, numbers: Sequence[int]) -> dict[str, Node]:
        """The nodes of candidates by name, repeated ones by a number."""
        chosen = [self.candidates[number] for number in numbers]
        return {f"{i}: {own.name}": own.node or {} for i, own in enumerate(chosen, 1)}

    def added(self, so_far: Sailed, number: int) -> Sailed | None:
        """The sequence with one candidate more; None if it does not fit."""
        numbers = [*(n for _, n in so_far.chosen), number]
        nodes = self._nodes(numbers)
        try:
            mission = self.design(nodes)
            if mission.duration_s > self.seconds:
                return None
            motion = self.known.sailed(mission)
        except UNABLE:
            return None
        phases, edges = mission.schedule.phases, mission.schedule.edges
        begins = {phase.name: mission.period_s * k for phase, k in zip(phases, edges, strict=False)
                  if phase.role == "training"}  # fmt: skip
        chosen = tuple((begins[name], n) for name, n in zip(nodes, numbers, strict=True))
        return Sailed(chosen, mission, motion)

    def node(self, sailed: Sailed, expected: Mapping[str, float]) -> dict[str, object]:
        """The excitation that sails a sequence."""
        own = {"vessel": "${vessel}", "period_s": "${sample_time_s}", "draw_seed": "${seed}"}
        return self._node(self._nodes([n for _, n in sailed.chosen]), expected) | own

    def rows(self, sailed: Sailed) -> Iterator[tuple[float, str]]:
        """Begin [s] of each phase, and its kind."""
        mission = sailed.mission
        assert isinstance(mission, OptimalDesign)
        for edge, phase in zip(mission.schedule.edges, mission.schedule.phases, strict=False):
            yield edge * mission.period_s, phase.kind


def planner_of(
    known: Known, waters: Waters | None, start: Array, seconds: float
) -> SteeredPlanner | ForcePlanner:
    """The candidates of the vessel of what is known."""
    kind = SteeredPlanner if isinstance(known.trial.excitation, HelmSequence) else ForcePlanner
    return kind(known, waters, start, seconds)


def sequence(
    purpose: Purpose, target: float, informations: Array, planner: SteeredPlanner | ForcePlanner
) -> tuple[Sailed, list[float]]:
    """Candidates added by what they save in a second, until the target is reached or none fits.

    Also returns half the interval before the sequence and after each of its candidates as they are
    sailed, which a planned route may do in another order than that in which they were chosen.
    Raises ConfigurationError if not one of them fits.
    """
    sailed, known = Sailed(), np.zeros_like(informations[0])
    times = np.array([candidate.seconds for candidate in planner.candidates])
    while purpose.width(known) > target:
        order, _ = ranked(purpose, known, informations, times)
        usable = [int(n) for n in order if sailed.seconds + times[n] <= planner.seconds][:TRIED]
        more = next((m for n in usable if (m := planner.added(sailed, n)) is not None), None)
        if more is None:
            break
        sailed, known = more, known + informations[more.chosen[-1][1]]
    if not sailed.chosen:
        fits = f"{planner.seconds / 60.0:g} min{'' if planner.waters is None else ' and the area'}"
        raise ConfigurationError(f"next: none of {len(times)} manoeuvres fits into {fits}")
    told = [informations[number] for _, number in sorted(sailed.chosen)]
    return sailed, [purpose.width(*told[:k]) for k in range(len(told) + 1)]
