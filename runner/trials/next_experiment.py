"""What is known of a vessel by stored runs, its candidates, and what is to be predicted.

The runs are identified once more, all recordings together, by the identifier of the last one. The
candidates are turns, zig-zags and binary sequences of the helm with their parameters, or for a
vessel that is commanded by forces those of `excitation=optimal_design` at several sizes and speeds.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from seatrial.models.errors import ConfigurationError, Diverged, IdentificationError, RecordingError
from seatrial.models.excitation.helm import register
from seatrial.models.excitation.helm_sequence import HelmSequence, HelmStep
from seatrial.models.excitation.missions import Mission
from seatrial.models.excitation.next_experiment import (
    DRAWS,
    SIMULATED,
    Belief,
    Purpose,
    doubted,
    middle,
    residual_deviation,
    root_mean_square,
    scale_of,
)
from seatrial.models.excitation.optimal_design import OptimalDesign
from seatrial.models.identification.auto import identified as protected
from seatrial.models.identification.calibration import calibrated
from seatrial.models.identification.problem import Problem
from seatrial.models.notation import MEASURES, OrderedManoeuvre
from seatrial.models.recording.recording import Recording, end_to_end
from seatrial.models.simulation.manoeuvre_measures import Measures, Track
from seatrial.models.simulation.manoeuvre_sheet import DEVIATION_SHARE, sheet
from seatrial.models.simulation.voyage import recording_of
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from seatrial.runner.configuration.config import Trial, build_as
from seatrial.runner.trials.closed_loop import Streams, prepare
from seatrial.runner.trials.deployment_metrics import tracking_metrics
from seatrial.runner.trials.manoeuvre_results import length_of
from seatrial.runner.trials.trial import excite

UNABLE = (ConfigurationError, Diverged, IdentificationError, RecordingError)
SHARES = (-1.0, -0.75, -0.5, -0.25, 0.25, 0.5, 0.75, 1.0)  # of the way from the start to the limits
LENGTHS = (10.0, 20.0, 30.0)  # of a manoeuvre [L / U]
TURNS_DEG = (10.0, 20.0, 30.0)  # of a zig-zag
HOLDS = (1.5, 3.0)  # of a binary sequence [L / U]
ONES = 5  # at the beginning of the sequence, which is left out
APPROACH = 3.0  # on a straight course before a manoeuvre [L / U]
SIZES, SLOWNESS = (0.25, 0.5, 0.75, 1.0), (0.5, 1.0, 2.0)  # of the forces of a candidate, its time
ZIGZAG_DEG = 10.0  # of the zig-zag that is measured
STEERED = 0.02  # of the largest helm, below which it keeps a course
INSTANTS = 50  # of a simulation in L / U, at most
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
        model = self.belief.model if model is None else model
        nominal = self.trial.vessel.nominal()
        setup = prepare(self.trial, Streams(0), nominal, mission, true=model)
        voyage = setup.sail().voyage
        return recording_of(voyage, voyage.weather)


def after_runs(trials: Sequence[Trial], calm: Trial) -> Known:
    """What is known after the recordings of trials; raises SeatrialError if nothing can be."""
    last, seeds = trials[-1], [Streams(trial.seed) for trial in trials]
    data = [excite(*each).recording for each in zip(trials, seeds, strict=True)]
    recording = end_to_end(data) if len(data) > 1 else data[0]
    problem = Problem(recording, recording, last.vessel.nominal(), last.vessel.thruster)
    result = protected(last.identifier, problem, seeds[-1].generator("identifier"))
    if last.model_error:
        result = calibrated(last.identifier, problem, result)
    if result.spread is None:
        name = last.names["identifier"]
        raise ConfigurationError(
            f"next: identifier={name} gives no joint distribution, expected robust or auto"
        )
    draws = tuple(result.draws(DRAWS, DEVIATION_SHARE))
    belief = Belief(result.model, draws, DEVIATION_SHARE)
    deviation = residual_deviation(result.model, recording)
    return Known(calm, belief, deviation, scale_of(belief.information(recording, deviation)))


def nominal(calm: Trial, noisy: Trial, doubt: float) -> Known:
    """The nominal model with a doubt, half the 90 % interval of its parameters over their size."""
    rng, model = np.random.default_rng(0), calm.vessel.nominal()
    draws = tuple(doubted(model, doubt, rng, DEVIATION_SHARE) for _ in range(DRAWS))
    assert noisy.disturbance.noise is not None
    deviation = noisy.disturbance.noise.deviations(calm.vessel.dofs)[2]
    return Known(calm, Belief(model, draws, DEVIATION_SHARE), deviation, 1.0)


@dataclass(frozen=True, eq=False)
class Candidate:
    """A manoeuvre that can be sailed: its steps, or its node and mission, and its motion."""

    name: str
    seconds: float
    motion: Recording
    steps: tuple[HelmStep, ...] = ()
    node: Node | None = None


def step_lists(base: HelmSequence) -> Iterator[tuple[str, tuple[HelmStep, ...]]]:
    """Names and steps of the candidates of a steered vessel, without their approach."""
    low, high, start = (x[base.index] for x in (base.input_low, base.input_high, base.input_start))
    unit = base.unit_s

    def order(share: float) -> float:
        return float(start + share * (high - start if share > 0.0 else start - low))

    def said(share: float) -> str:
        angle = base.helm == "delta"
        return f"{np.degrees(order(share)):.0f} deg" if angle else f"{order(share):.3g}"

    for share, length in product(SHARES, LENGTHS):
        step = HelmStep("hold", round(length * unit, 1), order(share))
        yield f"turn, {said(share)}, {step.seconds:g} s", (step,)
    for share, turn, length in product(SHARES, TURNS_DEG, LENGTHS):
        step = HelmStep("zigzag", round(length * unit, 1), order(share), turn)
        yield f"zig-zag, {said(share)} / {turn:g} deg, {step.seconds:g} s", (step,)
    for share, hold, length in product(SHARES, HOLDS, LENGTHS):
        seconds = round(hold * unit, 1)
        signs = 2.0 * np.roll(register(6), -ONES)[: round(length / hold)] - 1.0
        steps = tuple(HelmStep("hold", seconds, order(share * sign)) for sign in signs)
        yield f"binary, {said(share)} for {seconds:g} s, {len(steps)} times", steps


def candidates_of(known: Known) -> list[Candidate]:
    """What the vessel can sail, by the model that is known; what it cannot is left out."""
    family, found = known.trial.excitation, []
    if isinstance(family, HelmSequence):
        approach = HelmStep("turn", round(APPROACH * family.unit_s, 1), train=False)
        for name, steps in step_lists(family):
            mission = replace(family, steps=(approach, *steps), approach_s=0.0)
            try:
                mission.check(known.trial.vessel.dofs)
                motion = known.sailed(mission)
            except UNABLE:
                continue
            found.append(Candidate(name, mission.duration_s, motion, mission.steps))
        return found
    assert isinstance(family, OptimalDesign)
    for name, node in varied(known.trial.config["excitation"]):
        design = chosen_design(known, {name: node})
        try:
            design.check(known.trial.vessel.dofs)
            design.check_limits(known.trial.vessel.limits_by_dof, known.trial.sample_time_s)
            voyage = design.voyages[name]
        except UNABLE:
            continue
        motion = recording_of(voyage, voyage.weather)
        found.append(Candidate(name, float(voyage.t[-1]), motion, node=node))
    return found


def varied(node: object) -> Iterator[tuple[str, Node]]:
    """Names and nodes of the candidates of `optimal_design` at other sizes and speeds."""
    assert isinstance(node, Mapping)
    for name, own in node["candidates"].items():
        steered = "turn_deg" in own
        for size, slow in product(SIZES, (1.0,) if steered else SLOWNESS):
            changed = deepcopy(own)
            if steered:
                changed["yaw_moment_nm"] *= size
            else:
                changed["amplitude"] = {k: size * v for k, v in own["amplitude"].items()}
                changed["time_scale"] *= slow
            pace = f", slower x {slow:g}" if slow != 1.0 else ""
            yield f"{name}, {100.0 * size:g} %{pace}", changed


def chosen_design(
    known: Known, nodes: Mapping[str, Node], route: Node | None = None,
    expected: Mapping[str, float] | None = None,
) -> OptimalDesign:  # fmt: skip
    """The mission that sails each of some candidates once."""
    return build_as(OptimalDesign, chosen_node(known, nodes, route, expected), "excitation")


def chosen_node(
    known: Known, nodes: Mapping[str, Node], route: Node | None = None,
    expected: Mapping[str, float] | None = None,
) -> dict[str, object]:  # fmt: skip
    """Its node of the configuration."""
    base = known.trial.config["excitation"]
    assert isinstance(base, Mapping)
    changes: Node = {
        "candidates": dict(nodes),
        "design": "each",
        "held_out": [],
        "expected": expected,
    }
    return {**base, **changes, "route": {**base["route"], **(route or {})}}


def purpose_of(known: Known, name: str, percent: bool, tracked: Trial | None = None) -> Purpose:
    """What is to be predicted, with its gradient over the draws.

    `name` is a measure of a manoeuvre such as tactical_diameter, `coefficients`, one of them such
    as `sway.v`, `FIT` of a turning circle, or `e_pos` of the trial `tracked`; half widths are in
    `percent` of the value, or in its unit.

    Raises:
        ConfigurationError: the vessel has no such measure.
    """
    belief = known.belief
    if name == "coefficients" or name in belief.labels:
        uncertain = np.any(belief.basis != 0.0, axis=1) & (belief.values != 0.0)
        rows = uncertain if name == "coefficients" else np.array(belief.labels) == name
        if not np.any(rows & uncertain):
            raise ConfigurationError(f"next: {name} is not uncertain, expected coefficients")
        gradient = belief.basis[rows & uncertain]
        if percent:
            gradient = 100.0 * gradient / np.abs(belief.values[rows & uncertain, None])
        return Purpose(name, "%" if percent else "", gradient, middle)
    value, unit = _value(known, name, tracked)
    own = value(belief.model)
    if not np.all(np.isfinite(own)):
        raise ConfigurationError(f"next: the model that is known does not reach {name}")
    gradient = belief.gradient(np.array([value(d) for d in belief.draws[:SIMULATED]]), own)
    text = f"{own[0]:.4g} {unit}" if len(own) == 1 else ""
    if percent and text:
        gradient, unit = 100.0 * gradient / np.abs(own), "%"
    return Purpose(name, unit, gradient, root_mean_square, text)


def _value(known: Known, name: str, tracked: Trial | None) -> tuple[Callable[[Vessel], Array], str]:
    """z of a model, and its unit."""
    quantity = name.replace("_", " ")
    if name == "e_pos" and tracked is not None and tracked.controller is not None:
        return _tracking(known, tracked), "m"
    if name == "e_pos":
        raise ConfigurationError("next: e_pos: expected --after RUNS, the last with a controller")
    manoeuvres = reference_manoeuvres(known)
    if name == "FIT" and "turn" in manoeuvres:
        size = np.std(known.sailed(manoeuvres["turn"]).nu, axis=0)

        def motion(model: Vessel) -> Array:
            try:
                run = known.sailed(manoeuvres["turn"], model).nu[:: INSTANTS // 2]
            except UNABLE:
                return np.array([np.nan])
            return np.asarray(100.0 * (run / np.where(size > 0.0, size, np.inf)).ravel())

        return motion, "%"
    measures = dict[str, None]()
    for kind, mission in manoeuvres.items():
        own = _measures(known, kind, mission, known.belief.model)
        if np.isfinite(own.get(quantity, np.nan)):

            def value(model: Vessel, kind: str = kind, mission: Mission = mission) -> Array:
                return np.array([_measures(known, kind, mission, model).get(quantity, np.nan)])

            return value, MEASURES[quantity]
        measures |= {key.replace(" ", "_"): None for key, n in own.items() if np.isfinite(n)}
    raise ConfigurationError(
        f"next: {known.trial.vessel.name} has no measure {name}, expected coefficients, FIT, e_pos "
        f"or one of {', '.join(measures) or 'no other'}"
    )


def reference_manoeuvres(known: Known) -> dict[str, Mission]:
    """The turning circle of the largest helm and the zig-zag whose measures are predicted."""
    family = known.trial.excitation
    if length_of(known.trial) is None:
        return {}
    if isinstance(family, OptimalDesign):
        return {"turn": family.candidates["circle"]}
    assert isinstance(family, HelmSequence)
    high, start = family.input_high[family.index], family.input_start[family.index]
    small = (
        float(np.radians(ZIGZAG_DEG)) if family.helm == "delta" else start + 0.3 * (high - start)
    )
    approach = HelmStep("turn", APPROACH * family.unit_s)
    steps = {
        "turn": HelmStep("hold", 40.0 * family.unit_s, high),
        "zigzag": HelmStep("zigzag", 60.0 * family.unit_s, small, ZIGZAG_DEG),
    }
    return {kind: replace(family, steps=(approach, step)) for kind, step in steps.items()}


def _measures(known: Known, kind: str, mission: Mission, model: Vessel) -> Measures:
    """The sheet of a manoeuvre of a model; empty if it cannot carry it out."""
    length, family = length_of(known.trial), known.trial.excitation
    assert length is not None
    try:
        run = known.sailed(mission, model)
        helm = run.tau[:, 2]
        if isinstance(family, HelmSequence) and run.inputs is not None:
            helm = run.inputs[:, family.index]
        away = helm - helm[0]
        away = np.where(np.abs(away) >= STEERED * np.max(np.abs(away)), away, 0.0)
        speed = np.hypot(*run.nu[:, :2].T)
        north, east, psi = run.eta.T
        track = Track(run.t, north, east, psi, away, speed, length)
        ordered = OrderedManoeuvre(kind, turn_deg=ZIGZAG_DEG)  # type: ignore[arg-type]
        return sheet(track, ordered).values
    except UNABLE:
        return {}


def _tracking(known: Known, trial: Trial) -> Callable[[Vessel], Array]:
    """The mean absolute position error of a plant under the controller on the model known."""
    evaluation, excitation = trial.evaluation, trial.excitation
    assert evaluation is not None
    mission = evaluation if isinstance(evaluation, Mission) else evaluation.mission(excitation)  # type: ignore[arg-type]

    def value(plant: Vessel) -> Array:
        try:
            setup = prepare(trial, Streams(0), known.belief.model, mission, True, plant)
            rows = tracking_metrics(setup.sail().voyage, "identified", trial.sample_time_s)
        except UNABLE:
            return np.array([np.nan])
        return np.array([next(row.value or 0.0 for row in rows if row.name == "e_pos_mae")])

    return value
