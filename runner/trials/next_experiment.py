"""`seatrial next`: what is known of a vessel, what is to be predicted, and a sequence for it.

Runs are identified once more, all recordings together, by the identifier of the last one.
Candidates of a steered vessel are those of `excitation=helm_sequence`. It sails from one to the
next on paths of Dubins, and back to its start, with what is really turned simulated each time. A
vessel that is commanded by forces has those of `excitation=optimal_design` at several sizes and
speeds, which that excitation plans. Without an area there are no joins.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain, product
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.helm_sequence import HelmSequence, HelmStep, join_steps
from seatrial.models.excitation.missions import Mission
from seatrial.models.excitation.next_experiment import (
    Belief,
    Purpose,
    acceleration,
    believed,
    doubted,
    parameters,
    ranked,
    scale_of,
)
from seatrial.models.excitation.optimal_design import OptimalDesign
from seatrial.models.identification.problem import Problem
from seatrial.models.notation import MEASURES, OrderedManoeuvre
from seatrial.models.planning.dubins import Arc, dubins, length_of
from seatrial.models.planning.planner import Waters
from seatrial.models.recording.recording import Recording, end_to_end
from seatrial.models.simulation.manoeuvre_sheet import DEVIATION_SHARE, Measures, sheet, track_of
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import in_ned
from seatrial.models.vessel.table import Vessel
from seatrial.models.weather.disturbance import Disturbance
from seatrial.runner.configuration.config import Trial
from seatrial.runner.trials.checks import evaluated
from seatrial.runner.trials.closed_loop import Streams, prepare
from seatrial.runner.trials.deployment_metrics import mission_metrics
from seatrial.runner.trials.manoeuvre_results import UNABLE, sailed
from seatrial.runner.trials.trial import excite, identify

if TYPE_CHECKING:
    import shapely
else:
    import lazy_loader

    shapely = lazy_loader.load("shapely")  # slow to import

DRAWS = 400  # of which the whitened coordinates are found
SIMULATED = 120  # of them that carry a manoeuvre out
APPROACH = 3.0  # on a straight course before a manoeuvre [L / U]
CIRCLE, ZIGZAG = 40.0, 60.0  # lengths of the manoeuvres that are measured [L / U]
ZIGZAG_DEG = 10.0  # of the zig-zag that is measured; its share of a helm that is no angle
ZIGZAG_SHARE = 0.3
STEERED = 0.02  # of the largest helm, below which it keeps a course
EVERY = 25  # samples of a circle of which one is predicted
JOIN_SHARE = 0.6  # of the largest helm, in joins
HEADINGS = 8  # at which a candidate may begin
TRIED = 12  # candidates that are simulated in turn
EACH: dict[str, Any] = {"design": "each", "held_out": (), "variants": None}  # of a mix
OF_TRIAL = {"vessel": "${vessel}", "period_s": "${sample_time_s}", "draw_seed": "${seed}"}
Value = Callable[[Vessel], Array]  # (k,) of what is predicted; raises what a model cannot do


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
        return sailed(self.trial, mission, model or self.belief.model)


def after_runs(trials: Sequence[Trial], calm: Trial) -> Known:
    """What is known after the recordings of trials; raises SeatrialError if nothing can be."""
    last, seeds = trials[-1], [Streams(trial.seed) for trial in trials]
    data = [excite(*each).recording for each in zip(trials, seeds, strict=True)]
    recording = end_to_end(data) if len(data) > 1 else data[0]
    problem = Problem(recording, recording, last.vessel.nominal(), last.vessel.thruster)
    result = identify(last, problem, seeds[-1])
    if result.spread is None:
        raise ConfigurationError(
            f"next: identifier={last.names['identifier']} gives no joint distribution, expected "
            "robust or auto"
        )
    belief = believed(result.model, [*result.draws(DRAWS, DEVIATION_SHARE)], DEVIATION_SHARE)
    error = recording.nu_dot - acceleration(result.model, recording)
    deviation = np.sqrt(np.mean(error**2, axis=0))
    return Known(calm, belief, deviation, scale_of(belief.information(recording, deviation)))


def nominal(noisy: Trial, doubt: float) -> Known:
    """The nominal model with a doubt, half the 90 % interval of its parameters over their size."""
    rng, model, noise = np.random.default_rng(0), noisy.vessel.nominal(), noisy.disturbance.noise
    draws = [doubted(model, doubt, rng, DEVIATION_SHARE) for _ in range(DRAWS)]
    assert noise is not None
    calm, deviation = replace(noisy, disturbance=Disturbance()), noise.deviations(model.dofs)[2]
    return Known(calm, believed(model, draws, DEVIATION_SHARE), deviation, 1.0)


def purpose_of(known: Known, name: str, tracked: Trial | None = None) -> Purpose:
    """What is to be predicted, as of `value_of`, with its gradient over the draws."""
    belief = known.belief
    value, size = value_of(known, name, tracked)
    own = value(belief.model)
    if not np.all(np.isfinite(own)):
        raise ConfigurationError(f"next: the model that is known does not reach {name}")
    drawn = np.full((len(belief.draws[:SIMULATED]), len(own)), np.nan)
    for row, model in zip(drawn, belief.draws, strict=False):
        with suppress(*UNABLE):
            row[:] = value(model)
    size = np.abs(own) if size is None else size
    unit = MEASURES.get(name.replace("_", " "), "m" if name == "e_pos" else "")
    text = f"{name} {own[0]:.4g} {unit}".strip() if len(own) == 1 else name
    return Purpose(name, 100.0 * belief.gradient(drawn, own) / size[:, None], text)


def value_of(known: Known, name: str, tracked: Trial | None = None) -> tuple[Value, Array | None]:
    """What is predicted, k numbers of a model, and the sizes that are 100 %; None: their own.

    `name` is a measure of a manoeuvre such as tactical_diameter, `coefficients`, one of them such
    as `sway.v`, `FIT` of a turning circle, or `e_pos` of the trial `tracked`. Raises
    ConfigurationError if there is no such measure.
    """
    belief, family, kinds = known.belief, known.trial.excitation, dict[str, str]()
    references = _references(family)
    if name == "coefficients" or name in belief.labels:
        rows = np.any(belief.basis != 0.0, axis=1) & (belief.values != 0.0)
        rows &= (name == "coefficients") | (np.array(belief.labels) == name)
        if not np.any(rows):
            raise ConfigurationError(f"next: {name} is not uncertain, expected coefficients")
        return lambda model: parameters(model, belief.draws[0])[rows], None
    if name == "e_pos":
        if tracked is None or tracked.controller is None:
            raise ConfigurationError("next: e_pos needs --after RUNS, the last with a controller")
        return partial(_tracking, known, tracked), None
    if name == "FIT":
        nu = known.sailed(references["turn"]).nu
        size = np.where(np.std(nu, axis=0) > 0.0, np.std(nu, axis=0), np.inf)
        sizes = np.broadcast_to(size, nu[::EVERY].shape).ravel()
        return lambda model: known.sailed(references["turn"], model).nu[::EVERY].ravel(), sizes
    for kind in references if isinstance(family, HelmSequence) else ():
        with suppress(*UNABLE):
            own = _measures(known, kind, belief.model).items()
            reached = [quantity.replace(" ", "_") for quantity, value in own if np.isfinite(value)]
            kinds = dict.fromkeys(reached, kind) | kinds
    if name in kinds:
        kind, quantity = kinds[name], name.replace("_", " ")
        return lambda m: np.array([_measures(known, kind, m).get(quantity, np.nan)]), None
    raise ConfigurationError(
        f"next: {known.trial.vessel.name} has no measure {name}, expected one of "
        f"{', '.join(['coefficients', 'FIT', 'e_pos', *kinds])}"
    )


def _references(family: Any) -> dict[str, Mission]:
    """The turning circle of the largest helm, and of a steered vessel the zig-zag, to measure."""
    if isinstance(family, OptimalDesign):
        return {"turn": family.candidates["circle"]}
    small = np.radians(ZIGZAG_DEG) if family.helm == "delta" else family.order(ZIGZAG_SHARE)
    approach = HelmStep("turn", APPROACH * family.unit_s)
    steps = {
        "turn": HelmStep("hold", CIRCLE * family.unit_s, family.order(1.0)),
        "zigzag": HelmStep("zigzag", ZIGZAG * family.unit_s, float(small), ZIGZAG_DEG),
    }
    return {kind: replace(family, steps=(approach, step)) for kind, step in steps.items()}


def _measures(known: Known, kind: Any, model: Vessel) -> Measures:
    """The sheet of a reference manoeuvre of a model; raises what it cannot do."""
    family: Any = known.trial.excitation
    run = known.sailed(_references(family)[kind], model)
    track = track_of(run, family.helm, family.length_m)
    helm = track.helm - track.helm[0]
    helm = np.where(np.abs(helm) < STEERED * np.max(np.abs(helm)), 0.0, helm)
    ordered = OrderedManoeuvre(kind, turn_deg=ZIGZAG_DEG)
    return sheet(replace(track, helm=helm), ordered).values


def _tracking(known: Known, trial: Trial, plant: Vessel) -> Array:
    """The mean absolute position error of a plant under the controller on the model known."""
    setup = prepare(trial, Streams(0), known.belief.model, evaluated(trial), True, plant)
    rows = mission_metrics(setup.sail(), "identified")
    return np.array([next(row.value or 0.0 for row in rows if row.name == "e_pos_mae")])


class Candidate(NamedTuple):
    """A manoeuvre that can be sailed, and its motion."""

    name: str
    seconds: float
    motion: Recording
    own: Any  # its steps (HelmStep), or what it is a variant of and the changes


class Sailed(NamedTuple):
    """The candidates with the instants [s] at which they begin, and how they are sailed."""

    chosen: tuple[tuple[float, int], ...] = ()
    mission: Any = None
    motion: Any = None
    steps: tuple[HelmStep, ...] = ()  # of a steered vessel, without its return
    end: Array | None = None  # its pose (3,) after them

    @property
    def seconds(self) -> float:
        """Its length."""
        return float(self.mission.duration_s) if self.mission else 0.0


@dataclass(frozen=True, eq=False)
class SequencePlanner:
    """The candidates of a vessel, and how they are added to a sequence.

    `waters` are None if they are not limited, `start` is (north [m], east [m], heading [deg]),
    `seconds` is the time.
    """

    known: Known
    waters: Waters | None
    start: tuple[float, ...]
    seconds: float

    variant: ClassVar[Any]  # (name, size, slowness) of a candidate of the excitation: its `own`
    mission: ClassVar[Any]  # (`own` by name): a mission of manoeuvres
    added: ClassVar[Any]  # (Sailed, number): with one candidate more; None: it does not fit
    node: ClassVar[Any]  # (Sailed): the YAML of an excitation that sails it

    @property
    def family(self) -> Any:
        """The excitation that candidates are of."""
        return self.known.trial.excitation

    @cached_property
    def candidates(self) -> list[Candidate]:
        """What the vessel can sail, by the model that is known; what it cannot is left out."""
        trial, found, anywhere = self.known.trial, list[Candidate](), replace(self, waters=None)
        variants = (self.family.variants[factor] for factor in ("size", "slowness"))
        for name, size, slow in product(self.family.candidates, *variants):
            if (own := self.variant(name, size, slow)) is None:
                continue
            text = f"{name}, {100.0 * size:g} %{f', slower x {slow:g}' if slow != 1.0 else ''}"
            mission = anywhere.mission({text: own})
            with suppress(*UNABLE):
                mission.check(trial.vessel.dofs)
                mission.check_limits(trial.vessel.limits_by_dof, trial.sample_time_s)
                motion = self.known.sailed(mission)
                found.append(Candidate(text, mission.duration_s, motion, own))
        return found


@dataclass(frozen=True, eq=False)
class SteeredPlanner(SequencePlanner):
    """Steps of the helm, joined by paths of Dubins that are simulated."""

    def __post_init__(self) -> None:
        if self.waters is None:
            return
        if (reason := self.waters.in_the_way(np.array(self.start[:2]))) is not None:
            raise ConfigurationError(f"next: the start: {reason}")
        radius, speed, _ = self.circle
        if self.waters.free(radius).is_empty:
            raise ConfigurationError(
                f"next: area: no turning circle fits, expected room for one of {2.0 * radius:.3g} m"
                f" at {speed:.2g} m/s and a clearance of {self.waters.clearance_m:g} m"
            )

    def variant(self, name: str, size: float, slowness: float) -> tuple[HelmStep, ...]:
        """The steps, after an approach."""
        approach = HelmStep("turn", round(APPROACH * self.family.unit_s, 1), train=False)
        return approach, *self.family.variant(name, size, slowness)

    def mission(self, own: Mapping[str, Any]) -> Any:
        """Manoeuvres in turn."""
        return replace(self.family, steps=tuple(chain(*own.values())))

    def node(self, sailed: Sailed) -> dict[str, Any]:
        """The steps from the start."""
        steps = [*map(vars, sailed.mission.steps)]
        chosen = {"steps": steps, "start_pose": self.start, "candidates": None, "variants": None}
        return {**self.known.trial.config["excitation"], **chosen}  # type: ignore[dict-item]

    @cached_property
    def circle(self) -> tuple[float, float, Array]:
        """Radius [m] and speed [m/s] of the wider of the steady turns of joins, and their orders.

        The orders are those to port and to starboard, (2,).
        """
        family, found = self.family, []
        share = JOIN_SHARE * family.input_signs[family.index]
        helms = np.array([family.order(-share), family.order(share)])
        for helm in helms.tolist():
            step = HelmStep("hold", CIRCLE * family.unit_s, helm)
            nu = self.known.sailed(replace(family, steps=(step,))).nu
            u, v, r = nu[-len(nu) // 4 :].T
            speed = float(np.mean(np.hypot(u, v)))
            found.append((speed / max(float(np.mean(np.abs(r))), 1e-9), speed))
        return *max(found), helms

    def added(self, so_far: Sailed, number: int) -> Sailed | None:
        """The steps with a join to the candidate and a return, simulated."""
        candidate, free = self.candidates[number], self.waters and self.waters.free()
        start, end = replace(self.family, start_pose=self.start), so_far.end
        for join in self._joins(start.start if end is None else end, candidate.motion):
            begins = float(sum(step.seconds for step in (*so_far.steps, *join)))
            steps = (*so_far.steps, *join, *candidate.own)
            mission = replace(start, steps=steps)
            if mission.duration_s > self.seconds:
                continue
            try:
                motion = self.known.sailed(mission)
                end = motion.eta[-1]
                if free is not None:
                    back = self._join(dubins(end, start.start, self.circle[0]), 1.0)
                    mission = replace(start, steps=(*steps, *back))
                    motion = self.known.sailed(mission)
            except UNABLE:
                continue
            in_waters = free is None or shapely.LineString(motion.eta[:, :2]).within(free)
            if in_waters and mission.duration_s <= self.seconds:
                return Sailed((*so_far.chosen, (begins, number)), mission, motion, steps, end)
        return None

    def _join(self, path: tuple[Arc, ...], settle: float) -> list[HelmStep]:
        """A path as steps, with a time [L / U] on the last course."""
        return join_steps(path, *self.circle, settle * self.family.unit_s)

    def _joins(self, end: Array, motion: Recording) -> Iterator[list[HelmStep]]:
        """No join, then paths, the shortest first, to where a motion is amid the widest water."""
        yield []
        if self.waters is None:
            return
        widest = shapely.get_coordinates(shapely.maximum_inscribed_circle(self.waters.free()))[0]
        middle = 0.5 * (np.min(motion.eta[:, :2], axis=0) + np.max(motion.eta[:, :2], axis=0))
        paths = [
            dubins(end, np.array([*(widest - in_ned(middle, heading)), heading]), self.circle[0])
            for heading in 2.0 * np.pi * np.arange(HEADINGS) / HEADINGS
        ]
        yield from (self._join(path, APPROACH) for path in sorted(paths, key=length_of))


class ForcePlanner(SequencePlanner):
    """A mix in which each of some candidates is sailed once, as its route is planned."""

    def variant(self, name: str, size: float, slowness: float) -> Any:
        """The name of the candidate and the changes; None: a moment that is held has no time."""
        own = self.family.candidates[name]
        if hasattr(own, "yaw_moment_nm"):
            changes = {"yaw_moment_nm": size * own.yaw_moment_nm}
            return (name, changes) if slowness == 1.0 else None
        amplitude = {dof: size * most for dof, most in own.amplitude.items()}
        return name, {"amplitude": amplitude, "time_scale": slowness * own.time_scale}

    def mission(self, own: Mapping[str, Any]) -> Any:
        """The mix; raises ConfigurationError if there is no route."""
        candidates = {text: replace(self.family.candidates[name], **changes)
                      for text, (name, changes) in own.items()}  # fmt: skip
        route = replace(self.family.route, **self._route)
        return replace(self.family, candidates=candidates, route=route, **EACH)

    @property
    def _route(self) -> dict[str, Any]:
        return {"start": self.start, **(vars(self.waters) if self.waters else {})}

    def _own(self, numbers: Iterable[int]) -> dict[str, Any]:
        chosen = [self.candidates[number] for number in numbers]
        return {f"{i}: {each.name}": each.own for i, each in enumerate(chosen, 1)}

    def node(self, sailed: Sailed) -> dict[str, Any]:
        """The mix; of the vessel and the trial it has what they have."""
        base: Any = self.known.trial.config["excitation"]
        own = self._own(number for _, number in sailed.chosen)
        candidates = {text: {**base["candidates"][name], **changes}
                      for text, (name, changes) in own.items()}  # fmt: skip
        route = {**base["route"], **self._route}
        return {**base, "candidates": candidates, "route": route, **EACH, **OF_TRIAL}

    def added(self, so_far: Sailed, number: int) -> Sailed | None:
        """The mix as it is planned anew."""
        numbers = [*(n for _, n in so_far.chosen), number]
        own = self._own(numbers)
        try:
            mission = self.mission(own)
            if mission.duration_s > self.seconds:
                return None
            motion = self.known.sailed(mission)
        except UNABLE:
            return None
        schedule = mission.schedule
        begins = {phase.name: mission.period_s * k
                  for phase, k in zip(schedule.phases, schedule.edges, strict=False)
                  if phase.role == "training"}  # fmt: skip
        chosen = tuple((begins[name], n) for name, n in zip(own, numbers, strict=True))
        return Sailed(chosen, mission, motion)


def planner_of(
    known: Known, waters: Waters | None, start: tuple[float, ...], seconds: float
) -> SequencePlanner:
    """The candidates of the vessel of what is known."""
    kind = SteeredPlanner if isinstance(known.trial.excitation, HelmSequence) else ForcePlanner
    return kind(known, waters, start, seconds)


def sequence(
    purpose: Purpose, target: float, informations: Array, planner: SequencePlanner
) -> tuple[Sailed, list[float]]:
    """Candidates added by what they save in a second, until the target is reached or none fits.

    Also returns half the interval before the sequence and after each of its candidates as they are
    sailed, which a planned route may do in another order than that in which they were chosen.
    Raises ConfigurationError if not one of them fits.
    """
    sailed, known = Sailed(), np.zeros_like(informations[0])
    times = np.array([candidate.seconds for candidate in planner.candidates])
    while purpose.width(known) > target:
        order = ranked(purpose, known, informations, times)
        usable = [n for n in order if sailed.seconds + times[n] <= planner.seconds][:TRIED]
        more = next((m for n in usable if (m := planner.added(sailed, n)) is not None), None)
        if more is None:
            break
        sailed, known = more, known + informations[more.chosen[-1][1]]
    if not sailed.chosen:
        fits = f"{planner.seconds / 60.0:g} min{'' if planner.waters is None else ' and the area'}"
        raise ConfigurationError(f"next: none of {len(times)} manoeuvres fits into {fits}")
    told = [informations[number] for _, number in sorted(sailed.chosen)]
    return sailed, [purpose.width(*told[:k]) for k in range(len(told) + 1)]
