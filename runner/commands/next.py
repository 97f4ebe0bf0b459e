"""`seatrial next`: what to sail next, for a purpose, from what is known by now.

Runs are identified once more, all recordings together, by the identifier of the last one.
Candidates of a steered vessel are those of `excitation=helm_sequence`, joined by arcs of its
turning circle, with what is really turned simulated each time. A vessel that is commanded by forces
has those of `excitation=optimal_design`, which that excitation plans. Without an area there are no
joins. Files have positions in metres, x east and y north, or with an origin in degrees.
"""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain, product
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import pymap3d
import shapely
import typer
import yaml

from seatrial.models.errors import ConfigurationError, SeatrialError
from seatrial.models.excitation.helm_sequence import HelmSequence, HelmStep, join
from seatrial.models.excitation.missions import Mission, planar_only
from seatrial.models.identification import next_experiment as experiment
from seatrial.models.identification.next_experiment import Belief, Purpose, Value
from seatrial.models.identification.problem import Problem
from seatrial.models.notation import MEASURES, OrderedManoeuvre
from seatrial.models.planning.geojson import in_metres, shapes_of
from seatrial.models.planning.planner import Waters
from seatrial.models.recording.recording import Recording, end_to_end
from seatrial.models.simulation.manoeuvre_sheet import DEVIATION_SHARE, Measures, sheet, track_of
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import in_ned
from seatrial.runner.compare.cli import run_typer
from seatrial.runner.compare.frame import open_results
from seatrial.runner.configuration.config import Trial, build_trial
from seatrial.runner.configuration.invocation import DEFAULT_DATABASE
from seatrial.runner.interface.shell import part_of
from seatrial.runner.record.vocabulary import GROUPS
from seatrial.runner.sweeps import in_process
from seatrial.runner.trials.checks import evaluated, skipped
from seatrial.runner.trials.closed_loop import Streams, prepare
from seatrial.runner.trials.deployment_metrics import mission_metrics
from seatrial.runner.trials.manoeuvre_results import UNABLE, sailed
from seatrial.runner.trials.trial import excite, identify

app = typer.Typer(name="seatrial next", pretty_exceptions_enable=False, add_completion=False)
main = partial(run_typer, app)  # of the words that follow `seatrial next`
DRAWS = 400  # of the distribution of runs
APPROACH = 3.0  # on a straight course before a manoeuvre [L / U]
MEASURED = {"zigzag": 60.0, "turn": 40.0}  # how long they are sailed [L / U]
ZIGZAG_DEG, ZIGZAG_SHARE = 10.0, 0.3  # of it: its helm, or the share of one that is no angle
EVERY = 25  # samples of a circle of which one is predicted
JOIN_SHARE = 0.6  # of the largest helm, in joins
HEADINGS = 0.25 * np.pi * np.arange(8)  # [rad] at which a candidate may begin
TRIED = 12  # candidates that are simulated in turn
OF_TRIAL = {"vessel": "${vessel}", "period_s": "${sample_time_s}", "draw_seed": "${seed}"}
FOR = (
    "What is to be predicted and half its 90 % interval over its value: tactical_diameter=3%, "
    "first_overshoot=10%, coefficients=10%, sway.v=5%, FIT=2%, e_pos=5%."
)
GPX = "http://www.topografix.com/GPX/1/1"
Origin = tuple[float, ...] | None  # latitude, longitude [deg]


@app.command("next")
def next_experiment(
    purpose: Annotated[str, typer.Option("--for", help=FOR)],
    after: Annotated[str, typer.Option(help="Numbers of stored runs: 17,18.")] = "",
    vessel: Annotated[str, typer.Option(help="Without runs: its nominal model.")] = "",
    doubt: Annotated[float, typer.Option(help="Half the interval of nominal parameters.")] = 0.2,
    minutes: Annotated[float, typer.Option(help="Time at sea, with joins and return.")] = 15.0,
    area: Annotated[Path | None, typer.Option(help="GeoJSON: area, then what to avoid.")] = None,
    origin: Annotated[str, typer.Option(help="LAT,LON: area in degrees; else in metres.")] = "",
    start: Annotated[str, typer.Option(help="NORTH,EAST,HEADING [m, m, deg].")] = "0,0,0",
    clearance: Annotated[float, typer.Option(help="From the edge of the area [m].")] = 0.0,
    output: Annotated[Path, typer.Option(help="Folder of the files.")] = Path("results/next"),
    database: Annotated[str, typer.Option(help="Of the runs.")] = DEFAULT_DATABASE,
) -> None:
    """Choose what to sail next, and write its track and its YAML."""
    match = re.fullmatch(r"\s*([^=]+?)\s*=\s*(\d+\.?\d*|\.\d+)\s*%?\s*", purpose)
    if match is None or not (target := float(match[2])):
        raise ConfigurationError(f"next: --for {purpose}: expected PURPOSE=WIDTH such as FIT=2%")
    where, pose = _numbers("origin", origin, 2) if origin else None, _numbers("start", start, 3)
    waters = None if area is None else read_waters(area, where, clearance)
    if bool(after) == bool(vessel) or not 0.0 < doubt < 1.0:
        raise ConfigurationError("next: expected --after RUNS, or --vessel NAME and --doubt < 1")
    trials = _stored(after, database) if after else []
    known = after_runs(trials) if after else nominal(vessel, doubt)
    last = trials[-1] if trials else None
    wanted = purpose_of(known, match[1], last)
    now, expected = wanted.width(), (last and getattr(last.excitation, "expected", None)) or {}
    came = expected.get(wanted.name)
    lines = [] if came is None else [f"expected ± {came:.3g} %, came ± {now:.3g} %"]
    source = f"runs {after}" if after else f"nominal model, doubt {100.0 * doubt:g} %"
    lines.append(f"{known.trial.vessel.name}, {source}: {wanted.text} ± {now:.3g} %")
    if now <= target:
        typer.echo("\n".join([*lines, f"{target:g} % reached: nothing is to be sailed"]))
        return
    plan, width = sequence(wanted, target, Planner(known, waters, pose, 60.0 * minutes))
    begin = 0.0
    for seconds, text in [*plan.mission.rows(), (0.0, "end")]:
        lines.append(f"{int(begin // 60):3d}:{begin % 60:04.1f}  {text}")
        begin += seconds
    best = f"is not reached in {minutes:g} min: the best that was found is ± {width:.3g} %"
    reached = f"reached after {begin / 60.0:.1f} min: then ± {width:.3g} %"
    typer.echo("\n".join([*lines, f"{target:g} % {best if width > target else reached}"]))
    own = {name: option for name, option in OF_TRIAL.items() if hasattr(plan.mission, name)}
    node = part_of(replace(plan.mission, expected={wanted.name: width}, **own), "excitation")
    try:
        files = write_files(output, node, plan.motion, waters, where)
    except OSError as error:
        raise ConfigurationError(f"{output}: cannot be written: {error.strerror}") from error
    typer.echo("wrote " + ", ".join(map(str, files)))


def _numbers(option: str, text: str, count: int) -> tuple[float, ...]:
    try:
        values = tuple(map(float, text.split(",")))
    except ValueError:
        values = ()
    if len(values) != count:
        raise ConfigurationError(f"next: --{option} {text}: expected {count} numbers with commas")
    return values


def _stored(after: str, database: str) -> list[Trial]:
    """The trials of runs of one vessel."""
    trials = []
    with open_results(database) as results:
        for number in map(int, _numbers("after", after, after.count(",") + 1)):
            run = results.reader.run(number)
            names = {group: str(getattr(run.summary, group)) for group in GROUPS}
            stored = {"database": {"url": None}, "results_dir": "results"}
            trials.append(build_trial({**run.config, **stored}, names))
    if len(vessels := dict.fromkeys(trial.names["vessel"] for trial in trials)) > 1:
        raise ConfigurationError(
            f"next: runs {after} are of {' and '.join(vessels)}, expected one vessel"
        )
    return trials


def trial_of(vessel: str, disturbance: str = "calm") -> Trial:
    """A trial of the vessel whose excitation is the family of its candidates."""
    words = [f"vessel={vessel}", f"disturbance={disturbance}", "controller=none", "evaluation=none"]
    try:
        order = in_process.composed([*words, "excitation=helm_sequence"])
    except SeatrialError:  # it is not steered
        order = in_process.composed([*words, "excitation=optimal_design"])
    trial = build_trial(order.config, order.names)
    planar_only("seatrial next", trial.vessel.dofs)
    return trial


@dataclass(frozen=True, eq=False)
class Known:
    """What is known: the distribution, and the errors of velocities by which more is learnt.

    The trial is of the vessel in calm water; its excitation is the family of the candidates.
    `deviation` is that of independent errors, (n_dof,) [m/s, rad/s].
    """

    trial: Trial
    belief: Belief
    deviation: Array

    def sailed(self, mission: Mission, u: Array | float = 0.0) -> Recording:
        """The motion of the model at u (m,), by default of the one that is known, in calm water."""
        return sailed(self.trial, mission, self.belief.at(self.zero + u))

    @property
    def zero(self) -> Array:
        """Coordinates u (m,) of the model that is known."""
        return np.zeros(self.belief.basis.shape[1])


def after_runs(trials: Sequence[Trial]) -> Known:
    """What is known after the recordings of trials; raises SeatrialError if nothing can be.

    Errors are those with which their information would be the one that was identified, I: a prior
    told more than the recordings in some directions, so by the largest eigenvalues.
    """
    last, seeds = trials[-1], [Streams(trial.seed) for trial in trials]
    recording = end_to_end([excite(*each).recording for each in zip(trials, seeds, strict=True)])
    problem = Problem(recording, recording, last.vessel.nominal(), last.vessel.thruster)
    result = identify(last, problem, seeds[-1])
    if result.spread is None:
        raise ConfigurationError(
            f"next: identifier={last.names['identifier']} gives no joint distribution, expected "
            "robust or auto"
        )
    belief = experiment.learnt(
        result.model, [*result.draws(DRAWS, DEVIATION_SHARE)], DEVIATION_SHARE
    )
    deviation = np.ones(len(recording.dofs))
    for _ in range(2):
        J, rest = belief.free_runs(recording, last.vessel.thruster, deviation)
        deviation = np.sqrt(np.mean(rest**2, axis=0))
    deviation *= np.sqrt(
        np.quantile(np.linalg.eigvalsh(experiment.information(J, deviation)), 0.75)
    )
    return Known(trial_of(last.names["vessel"]), belief, deviation)


def nominal(vessel: str, doubt: float) -> Known:
    """The nominal model with a doubt, half the 90 % interval of its parameters over their size."""
    noise, trial = trial_of(vessel, "noise").disturbance.noise, trial_of(vessel)
    assert noise is not None
    belief = experiment.doubted(trial.vessel.nominal(), doubt)
    return Known(trial, belief, noise.deviations(trial.vessel.dofs)[1])


def purpose_of(
    known: Known, name: str, tracked: Trial | None = None, u: Array | float = 0.0
) -> Purpose:
    """What is to be predicted, as of `value_of`, with its gradient over draws about u (m,)."""
    own, gradient = known.belief.gradient(value_of(known, name, tracked), known.zero + u)
    unit = MEASURES.get(name.replace("_", " "), "m" if name == "e_pos" else "")
    text = f"{name} {own[0]:.4g} {unit}".strip() if len(own) == 1 else name
    return Purpose(name, 100.0 * gradient / np.abs(own)[:, None], text)


def value_of(known: Known, name: str, tracked: Trial | None = None) -> Value:
    """What is predicted, k numbers at u (m,).

    `name` is a measure of a manoeuvre such as tactical_diameter, `coefficients`, one of them such
    as `sway.v`, `FIT` of a turning circle (1 and the changes of its velocities over their
    deviations), or the mean absolute position error `e_pos` of the trial `tracked` under its
    controller on the known model. Raises ConfigurationError if there is no such measure.
    """
    belief, free, kinds = known.belief, known.belief.free, dict[str, str]()
    family: Any = known.trial.excitation
    steered = isinstance(family, HelmSequence)
    own = (free.values != 0.0) & [name in (experiment.ALL, label) for label in free.labels]
    if np.any(own):
        return lambda u: (free.values + belief.basis @ u)[own]
    if name == "e_pos":
        why = None if tracked is None else skipped(tracked)
        if tracked is None or why is not None:
            need = "next: e_pos needs --after RUNS, the last with a controller"
            raise ConfigurationError(need if why is None else f"{need}: {why}")
        mission, model = evaluated(tracked), belief.at(known.zero)

        def tracking(u: Array) -> Array:
            setup = prepare(tracked, Streams(0), model, mission, True, belief.at(u))
            rows = mission_metrics(setup.sail(), "identified")
            return np.array([row.value for row in rows if row.name == "e_pos_mae"], dtype=float)

        return tracking
    if name == "FIT":
        circle = _reference(family, "turn") if steered else family.candidates["circle"]
        nu = known.sailed(circle).nu
        size = np.where(np.std(nu, axis=0) > 0.0, np.std(nu, axis=0), np.inf)
        return lambda u: (1.0 + (known.sailed(circle, u).nu - nu) / size)[::EVERY].ravel()

    def measures(kind: Any, u: Array | float) -> Measures:
        track = track_of(known.sailed(_reference(family, kind), u), family.helm, family.length_m)
        ordered = OrderedManoeuvre(kind, turn_deg=ZIGZAG_DEG)
        return sheet(replace(track, helm=track.helm - track.helm[0]), ordered).values

    for kind in MEASURED if steered else ():
        with suppress(*UNABLE):
            reached = [each for each, value in measures(kind, 0.0).items() if np.isfinite(value)]
            kinds |= {each.replace(" ", "_"): kind for each in reached}
    if name in kinds:
        return lambda u: np.array([measures(kinds[name], u).get(name.replace("_", " "), np.nan)])
    raise ConfigurationError(
        f"next: {known.trial.vessel.name} has no measure {name}, expected one of "
        f"{', '.join([experiment.ALL, 'FIT', 'e_pos', *kinds])}"
    )


def _reference(family: HelmSequence, kind: str) -> Mission:
    """The turning circle of the largest helm, or the zig-zag, to measure."""
    approach = HelmStep("hold", APPROACH * family.unit_s, family.at(0.0))
    seconds, angle = round(MEASURED[kind] * family.unit_s, 1), float(np.radians(ZIGZAG_DEG))
    own = HelmStep("hold", seconds, family.at(1.0))
    if kind == "zigzag":
        share = angle / family.limits[1] if family.helm == "delta" else ZIGZAG_SHARE
        own = HelmStep("zigzag", seconds, family.at(share), ZIGZAG_DEG)
    return replace(family, steps=(approach, own))


class Candidate(NamedTuple):
    """A manoeuvre that can be sailed, its motion, and what that tells (m, m).

    The time is with the way back to where it began, if there are joins.
    """

    name: str
    seconds: float
    motion: Recording
    information: Array
    own: Any  # as of `Planner.variant`


class Sailed(NamedTuple):
    """A sequence of candidates, and how it is sailed."""

    parts: tuple[Any, ...]  # `own` of each, and joins
    end: Array  # pose (3,) after them
    mission: Any = None
    motion: Any = None


@dataclass(frozen=True, eq=False)
class Planner:
    """The candidates of a vessel, and how they are added to a sequence.

    `waters` are None if they are not limited, `start` is (north [m], east [m], heading [deg]),
    `seconds` is the time.
    """

    known: Known
    waters: Waters | None
    start: tuple[float, ...]
    seconds: float

    def __post_init__(self) -> None:
        if self.waters is None or not self.steered:
            return
        if (reason := self.waters.in_the_way(np.array(self.start[:2]))) is not None:
            raise ConfigurationError(f"next: the start: {reason}")
        radius, speed, _ = self.circle
        if self.waters.free(radius).is_empty:
            raise ConfigurationError(
                f"next: area: no turning circle fits, expected room for one of {2.0 * radius:.3g} m"
                f" at {speed:.2g} m/s and a clearance of {self.waters.clearance_m:g} m"
            )

    @property
    def family(self) -> Any:
        """The excitation that candidates are of."""
        return self.known.trial.excitation

    @property
    def steered(self) -> bool:
        """Whether parts are steps of the helm; otherwise candidates of a mix, each sailed once."""
        return isinstance(self.family, HelmSequence)

    def variant(self, text: str, name: str, size: float, slowness: float) -> list[Any]:
        """A candidate of the excitation: steps of the helm; or what it is called, and a mission.

        Raises ConfigurationError for a moment that is held: it has no time.
        """
        family, own = self.family, self.family.candidates[name]
        if self.steered:
            steps = [HelmStep("turn", round(APPROACH * family.unit_s, 1))]
            for step in own:
                seconds = round(slowness * step.seconds * family.unit_s, 1)
                steps.append(replace(step, seconds=seconds, order=family.at(size * step.order)))
            return steps
        if not hasattr(own, "yaw_moment_nm"):
            amplitude = {dof: size * most for dof, most in own.amplitude.items()}
            return [(text, replace(own, amplitude=amplitude, time_scale=slowness * own.time_scale))]
        if slowness != 1.0:
            raise ConfigurationError(f"{name}: cannot be slower")
        return [(text, replace(own, yaw_moment_nm=size * own.yaw_moment_nm))]

    def sailing(self, parts: Sequence[Sequence[Any]]) -> Any:
        """The excitation that sails parts in turn."""
        family, own = replace(self.family, variants=None), tuple(chain(*parts))
        if self.steered:
            return replace(family, steps=own, start_pose=self.start, candidates=None)
        candidates = {f"{i}: {text}": mission for i, (text, mission) in enumerate(own, 1)}
        waters: Mapping[str, Any] = vars(self.waters) if self.waters else {}
        route = replace(family.route, start=self.start, **waters)
        return replace(family, candidates=candidates, route=route, design="each", held_out=())

    @cached_property
    def free(self) -> Any:
        """Where arcs may lead, a geometry; None: anywhere, and there are none."""
        return self.waters.free() if self.waters and self.steered else None

    @cached_property
    def candidates(self) -> list[Candidate]:
        """What the vessel can sail, by the model that is known; what it cannot is left out."""
        trial, found, anywhere = self.known.trial, list[Candidate](), replace(self, waters=None)
        factors = (self.family.variants[factor] for factor in ("size", "slowness"))
        for name, size, slow in product(self.family.candidates, *factors):
            text = f"{name}, {100.0 * size:g} %{f', slower x {slow:g}' if slow != 1.0 else ''}"
            with suppress(*UNABLE):
                mission = anywhere.sailing([own := self.variant(text, name, size, slow)])
                mission.check(trial.vessel.dofs)
                mission.check_limits(trial.vessel.limits_by_dof, trial.sample_time_s)
                motion = self.known.sailed(mission)
                J, _ = self.known.belief.free_runs(
                    motion, trial.vessel.thruster, self.known.deviation
                )
                told = experiment.information(J, self.known.deviation)
                seconds = mission.duration_s + self._back(motion.eta[-1], motion.eta[0])[1]
                found.append(Candidate(text, seconds, motion, told, own))
        return found

    @cached_property
    def circle(self) -> tuple[float, float, Array]:
        """Radius [m] and speed [m/s] of the wider of the steady turns of joins, and their orders.

        The orders are those to port and to starboard, (2,).
        """
        family, found = self.family, []
        sides = JOIN_SHARE * family.input_signs[family.index] * np.array([-1.0, 1.0])
        seconds = round(MEASURED["turn"] * family.unit_s, 1)
        for share in sides:
            turn = replace(family, steps=(HelmStep("hold", seconds, family.at(share)),))
            u, v, r = self.known.sailed(turn).nu[-1]
            found.append((float(np.hypot(u, v) / max(abs(r), 1e-9)), float(np.hypot(u, v))))
        return *max(found), np.array([family.at(share) for share in sides])

    def added(self, so_far: Sailed, candidate: Candidate) -> Sailed | None:
        """A sequence with one candidate more and a return, simulated; None: it does not fit."""
        for joined in self._joins(so_far.end, candidate.motion):
            parts = (*so_far.parts, joined, candidate.own)
            with suppress(*UNABLE):
                motion = self.known.sailed(mission := self.sailing(parts))
                end, inside = motion.eta[-1], True
                if self.free is not None:
                    back, _ = self._back(end, mission.start)
                    motion = self.known.sailed(mission := self.sailing((*parts, back)))
                    inside = shapely.LineString(motion.eta[:, :2]).within(self.free)
                if inside and mission.duration_s <= self.seconds:
                    return Sailed(parts, end, mission, motion)
        return None

    def _back(self, end: Array, start: Array) -> tuple[list[HelmStep], float]:
        """The steps of the way from an end to a start, and their time [s]; none without joins."""
        steps = [] if self.free is None else join(end, start, *self.circle, self.family.unit_s)
        return steps, sum(step.seconds for step in steps)

    def _joins(self, end: Array, motion: Recording) -> Iterator[list[HelmStep]]:
        """No join, then paths, the shortest first, to where a motion is amid the widest water."""
        yield []
        if self.free is None:
            return
        widest = shapely.get_coordinates(shapely.maximum_inscribed_circle(self.free))[0]
        middle = 0.5 * (np.min(motion.eta[:, :2], axis=0) + np.max(motion.eta[:, :2], axis=0))
        begins = (np.array([*(widest - in_ned(middle, psi)), psi]) for psi in HEADINGS)
        settle_s = APPROACH * self.family.unit_s
        ways = [join(end, begin, *self.circle, settle_s) for begin in begins]
        yield from sorted(ways, key=lambda steps: sum(step.seconds for step in steps))


def sequence(purpose: Purpose, target: float, planner: Planner) -> tuple[Sailed, float]:
    """Candidates added as `ranked`, until the target is reached or none fits.

    Also returns half the interval after them. Raises ConfigurationError if not one of them fits.
    """
    candidates = planner.candidates
    sailed = Sailed((), np.array(planner.start) * [1.0, 1.0, np.pi / 180.0])
    told = np.array([candidate.information for candidate in candidates])
    times, spent = np.array([candidate.seconds for candidate in candidates]), 0.0
    lengths = [candidate.motion.t[-1] for candidate in candidates]
    known = np.zeros(told.shape[1:])
    while purpose.width(known) > target:
        order = experiment.ranked(purpose, known, told, times, target)
        for number in [n for n in order if spent + lengths[n] <= planner.seconds][:TRIED]:
            if (more := planner.added(sailed, candidates[number])) is not None:
                sailed, known, spent = more, known + told[number], more.mission.duration_s
                break
        else:
            break
    if sailed.mission is None:
        fits = f"{planner.seconds / 60.0:g} min{'' if planner.waters is None else ' and the area'}"
        raise ConfigurationError(f"next: none of {len(times)} manoeuvres fits into {fits}")
    return sailed, purpose.width(known)


def read_waters(path: Path, origin: Origin, clearance_m: float) -> Waters:
    """The area of a GeoJSON file: its first polygon; its holes and the others are obstacles.

    Raises ConfigurationError for a file without a polygon, or positions that are no positions.
    """
    try:
        shapes = shapes_of(path.read_text(encoding="utf-8"))[1]
        placed = [in_metres(shape, origin and origin[::-1]) for _, shape in shapes]
    except (OSError, ConfigurationError) as error:
        raise ConfigurationError(f"{path}: cannot be read: {error}") from error
    polygons = [part for part in shapely.get_parts(placed) if part.geom_type == "Polygon"]
    rings = [
        tuple(ring.coords[:-1]) for each in polygons for ring in (each.exterior, *each.interiors)
    ]
    if not rings:
        raise ConfigurationError(f"{path}: got no polygon, expected one of the area")
    return Waters(rings[0], rings[1:], clearance_m)


def positions(track: Array, origin: Origin) -> Array:
    """(x, y) of a track (N, 2) of (north, east) [m]: metres, or longitude and latitude [deg]."""
    if origin is None:
        return np.round(track[:, ::-1], 2)
    return np.round(np.column_stack(pymap3d.ned2geodetic(*track.T, 0.0, *origin, 0.0)[1::-1]), 7)


def write_files(
    folder: Path, node: Any, motion: Recording, waters: Waters | None, origin: Origin
) -> list[Path]:
    """Write the excitation and the expected track: GeoJSON, a figure, and GPX with an origin."""
    from matplotlib.figure import Figure  # slow to import

    text = yaml.safe_dump(json.loads(json.dumps(node)), sort_keys=False, width=100)  # no aliases
    line = positions(motion.eta[:: max(1, round(1.0 / motion.period_s)), :2], origin).tolist()
    track = shapely.to_geojson(shapely.LineString(line))
    texts = {"excitation.yaml": f"# Chosen by seatrial next.\n{text}", "track.geojson": track}
    if origin is not None:
        points = "".join(f'<trkpt lat="{lat}" lon="{lon}"/>' for lon, lat in line)
        head = f'<gpx version="1.1" creator="seatrial" xmlns="{GPX}">'
        texts["track.gpx"] = f"{head}<trk><trkseg>{points}</trkseg></trk></gpx>\n"
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    figure = Figure(figsize=(6.0, 6.0), layout="constrained")
    axes = figure.add_subplot(xlabel="east [m]", ylabel="north [m]", aspect="equal")
    for name, ring in ({} if waters is None else waters.named).items():
        axes.fill(*np.array(ring)[:, ::-1].T, fill=name != "area", color="0.7")
    axes.plot(motion.eta[:, 1], motion.eta[:, 0], marker="o", markevery=[0])  # from there
    figure.savefig(picture := folder / "track.svg")
    return [*(folder / name for name in texts), picture]
