"""All that can be said of a recording before anything is identified from it.

Where pose and velocity are inconsistent, changes of the map are tried: the recording is read
again with each, and the one with which its axes agree best is taken, the simplest of those that are
as good. That is repeated until nothing gains. The problems are the changes that were taken, and
what the correlations tell but no change fixes. What is no unit of the field is asked, not scaled.
"""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np

from seatrial.models.errors import RecordingError
from seatrial.models.notation import DOFS, PLANAR
from seatrial.models.recording import column_map, consistency, recorded_file
from seatrial.models.recording.column_map import (
    BEARINGS,
    Column,
    ColumnMap,
    factor,
    si_factor,
    targets_of,
    words_of,
)
from seatrial.models.recording.consistency import AS_GOOD, SAME_SCALE, SURE
from seatrial.models.recording.quantities import quantity
from seatrial.models.recording.recorded_file import RecordedFile
from seatrial.models.recording.recording import Recording, piece_edges
from seatrial.models.recording.signals import original_rate, sampling
from seatrial.models.recording.source import Source

NEAR_SCALE = 1.25  # a scale is that of a unit within this factor
UNNAMED = 2.0  # a scale within this factor that is of no unit is that of a filter or sensor
SAMPLES_APART = 2.0  # a smaller delay is that of a filter or of sampling
SAME_RATE = 1.05  # of the rate of the original samples
MOST_CHANGES = 6
ASIDE, AHEAD = 0.5, 0.87  # shares of the way ahead: of a wrong heading, and of a right one
MOST_SAMPLES, BLOCKS = 50_000, 10  # of a longer recording, as many even blocks are compared
LARGE = {  # hardly rad, or 1/s
    **dict.fromkeys(BEARINGS, 6.0 * np.pi), "position.roll": np.pi, "position.pitch": np.pi,
    "inputs.delta": 0.5 * np.pi, "inputs.n": 30.0,
}  # fmt: skip
SMALL_ANGLE = 0.05  # [rad] by which a heading is easily wrong
PULSE_US = (800.0, 2300.0)  # widths that are sent to servos and speed controllers
LINEAR, ANGLES, YAW, DEGREES = DOFS[:3], DOFS[3:], ("yaw",), 180.0 / np.pi
UNITS = {  # that people record, by that of SI
    "m/s": ("m/s", "knot", "km/h", "ft/s", "cm/s", "mm/s"),
    "rad/s": ("rad/s", "deg/s", "rpm", "mrad/s", "deg/min"),
    "m": ("m", "mm", "cm", "ft", "km"), "rad": ("rad", "deg"),
    "s": ("s", "ms", "us", "ns", "min"),
}  # fmt: skip
OTHER = {"body": "earth", "earth": "body", "NED": "ENU", "ENU": "NED", "FRD": "FLU", "FLU": "FRD",
         "clockwise": "anticlockwise", "anticlockwise": "clockwise"}  # fmt: skip
# Of the frames and the sense of a heading: the kind of a problem, its axes, what another one means.
SENSES = {
    "velocity": ("earth", LINEAR, "the velocities are along the axes of the {}"),
    "position": ("frame", LINEAR, "the positions are {}"),
    "body": ("frame", column_map.FLIPPED, "the axes of the body are {}"),
    "attitude": ("heading", YAW, "the attitude is of {}"),
    "positive": ("heading", YAW, "the heading counts {}"),
}
# Those that may be the other ones, which no correlation of one axis tells.
TURNS = (
    ("velocity",), ("position",), ("body",), ("attitude",), ("body", "attitude"),
    ("position", "attitude"), ("velocity", "position"), ("positive",), ("position", "positive"),
)  # fmt: skip
Change = Mapping[str, Any]  # options of excitation, such as columns.velocity.surge, and values


@dataclass(frozen=True)
class RecordingDefect:
    """What is wrong with some axes of a recording, and the change of options that fixes it."""

    # scale | sign | swap | earth | frame | heading | clock | resampled | question | unknown
    kind: str
    axes: tuple[str, ...]
    message: str
    change: Change = field(default_factory=dict)  # empty: none that was tried fixes it
    value: float | None = None  # the factor, the lag [s], the angle [deg] or the rate [Hz]

    @property
    def fix(self) -> str:
        """The change as it is written in a configuration."""
        parts = []
        for path, value in self.change.items():
            if isinstance(value, Mapping):
                text = f": {{{', '.join(f'{key}: {item}' for key, item in value.items())}}}"
            else:
                text = f"={value:g}" if isinstance(value, float) else f"={value}"
            parts.append(f"excitation.{path}{text}")
        return ", ".join(parts)

    def __str__(self) -> str:
        axes = f"{', '.join(self.axes)}: " if self.axes else ""
        return f"{axes}{self.message}; {self.fix or 'no change of the map that was tried fixes it'}"


@dataclass(frozen=True)
class Examination:
    """The comparison of pose and velocity with all problems, and the recording as it was read.

    `questions` are what only the user knows, `not_compared` what is missing for a comparison.
    """

    result: consistency.Consistency
    problems: tuple[RecordingDefect, ...]
    recording: Recording
    questions: tuple[str, ...] = ()
    not_compared: tuple[str, ...] = ()


def with_option(node: Any, path: Sequence[str], value: object) -> Any:
    """Options, as an object or as they are written, with the one at a path replaced."""
    name, *rest = path
    if isinstance(node, Mapping):
        return {**node, name: with_option(node.get(name, {}), rest, value) if rest else value}
    return replace(node, **{name: with_option(getattr(node, name), rest, value) if rest else value})


def changed(file: RecordedFile, change: Change) -> RecordedFile:
    """The reader of a recording with some options changed."""
    for path, value in change.items():
        new = Column(**value) if isinstance(value, Mapping) else value
        file = with_option(file, path.split("."), new)
    return file


def examine(file: RecordedFile, dofs: Sequence[str]) -> Examination | None:
    """Examine a recording with all degrees of freedom that it holds, else with those of a vessel.

    None if the recording cannot be read in any of them. Of a long one, changes are tried on blocks.
    """
    columns, poses, speeds = file.columns, set(file.columns.posed), set(file.columns.moving)
    for own in (poses & (speeds | set(PLANAR)), poses & speeds, set(dofs)):
        known = tuple(dof for dof in DOFS if dof in own)
        with suppress(*column_map.FAULTS):
            if known:
                whole, sources = file.recording(known), file.sources()
                break
    else:
        return None
    case = _Case(file, whole, sources)
    if (blocks := _blocks(sources, columns)) is not None:
        rate = file.resample_hz or 1.0 / whole.period_s
        part = replace(file, resample_hz=rate, at_gap="split")
        with suppress(*column_map.FAULTS):
            case = _Case(part, part.recording(known, blocks), sources, blocks)
    turned = poses & set(ANGLES) and speeds & set(LINEAR) & set(known)
    lacking = {
        "velocity": [dof for dof in known if dof not in speeds],
        "pose": [dof for dof in DOFS if dof in speeds - poses],
        "pose or force": [dof for dof in PLANAR if turned and dof not in known],
    }
    needed = "is recorded, which comparing pose and velocity needs"
    lines = [f"no {what} in {' and '.join(x)} {needed}" for what, x in lacking.items() if x]
    return replace(_examined(case, whole), not_compared=tuple(lines))


def _examined(case: "_Case", whole: Recording) -> Examination:
    """What is wrong with a recording, with the changes that were tried."""
    plain = case.result
    if (slower := case.slower()) is not None:
        case = case.read(slower) or case
    for _ in range(MOST_CHANGES):
        told = list(case.told())
        if (best := case.best(told)) is None:
            break
        case = replace(best, cutoff_hz=None)  # where it agrees best
    axes, problems = case.result.axes, list(case.problems)
    good = {axis.dof for axis in axes if axis.correlation > SURE and not axis.off}
    sure = {f"position.{dof}" for dof in good | ({"yaw"} if good & set(LINEAR) else set())}
    doubtful = doubts(case.sources, case.file.columns).items()
    questions = [line for option, line in doubtful if option not in sure]
    questions += [defect.message for defect in told if defect.kind == "question"]
    delay = sum(problem.value or 0.0 for problem in problems if problem.kind == "clock")
    result = replace(plain, lag_s=case.result.lag_s + delay)
    problems += [replace(defect, change={}) for defect in told if defect.kind != "question"]
    named = {dof for defect in problems if not defect.change for dof in defect.axes}
    problems += [
        RecordingDefect("unknown", (axis.dof,), "the velocity and the derivative have a "
                        f"correlation of {axis.correlation:.2f}", value=axis.correlation)
        for axis in case.result.untrusted if axis.dof not in named
    ]  # fmt: skip
    return Examination(result, tuple(problems), whole, tuple(questions))


@dataclass(frozen=True)
class _Case:
    """A recording, all of it or blocks of its sources, as it is read with some options."""

    file: RecordedFile
    recording: Recording
    sources: Mapping[str, Source]
    blocks: Mapping[str, Source] | None = None
    cutoff_hz: float | None = None  # below which it is compared; None: where it agrees best
    problems: tuple[RecordingDefect, ...] = ()  # with which it is read

    def read(self, defect: RecordingDefect, cutoff_hz: float | None = None) -> "_Case | None":
        """The recording read with the change of a problem; None if it cannot be."""
        with suppress(*column_map.FAULTS):
            file, problems = changed(self.file, defect.change), (*self.problems, defect)
            recording = file.recording(self.recording.dofs, self.blocks)
            return replace(self, file=file, recording=recording, problems=problems,
                           cutoff_hz=cutoff_hz)  # fmt: skip
        return None

    @cached_property
    def result(self) -> consistency.Consistency:
        """How pose and velocity agree."""
        moving = tuple(self.file.columns.moving)
        return consistency.consistency(self.recording, moving, self.cutoff_hz)

    @cached_property
    def readings(self) -> Mapping[str, column_map.ColumnReading]:
        """How the columns of motion are read, by option."""
        used = dict.fromkeys(column_map.wanted(self.file.columns, DOFS), False)
        known = column_map.readings(self.sources, self.file.columns, used)
        kinds = ("position.", "velocity.", "ground.", "wind.")
        return {option: reading for option, reading in known.items() if option.startswith(kinds)}

    @property
    def along(self) -> bool:
        """Whether velocities along the body are recorded, which tell the heading."""
        columns = self.file.columns
        return columns.frames.velocity == "body" and bool({"surge", "sway"} & set(columns.velocity))

    @property
    def ahead(self) -> float:
        """Share of the way in the direction of the bow; 1 where there is no plane."""
        if not set(PLANAR) <= set(self.recording.dofs):
            return 1.0
        u, v = (self.recording.nu[:, self.recording.dofs.index(dof)] for dof in LINEAR[:2])
        return float(np.sum(u) / (np.sum(np.hypot(u, v)) or 1.0))

    @property
    def aside(self) -> bool:
        """Whether the vessel hardly moves ahead, and no velocity along the body tells why."""
        agree = all(axis.correlation > SURE for axis in self.result.axes if axis.dof in LINEAR[:2])
        return agree and not self.along and self.ahead < ASIDE

    def best(self, told: Sequence[RecordingDefect]) -> "_Case | None":
        """The first of the changes that are as good as the best one; None if none gains enough.

        A vessel that hardly moves ahead gains what it moves ahead.
        """
        fine, tried = not self.result.axes or self.result.quality > 1.0 - AS_GOOD, []
        guesses = [] if fine and not self.aside else list(self._guesses())
        for defect in (*(defect for defect in told if defect.change), *guesses):
            if (after := self.read(defect, self.result.cutoff_hz)) is None:
                continue
            ahead = after.ahead if self.aside and after.ahead > AHEAD else 0.0
            gain = after.result.quality - self.result.quality + ahead
            worse = after.ahead < ASIDE and self.ahead > AHEAD
            pairs = zip(self.result.axes, after.result.axes, strict=True)
            worse |= any(b.quality < a.quality - AS_GOOD and a.correlation > SURE for a, b in pairs)
            if gain > (defect in guesses) * AS_GOOD and not worse:
                tried.append((gain, after))
        most = max((gain for gain, _ in tried), default=0.0)
        return next((after for gain, after in tried if gain >= most - AS_GOOD), None)

    def _guesses(self) -> Iterator[RecordingDefect]:
        """What no correlation of one axis tells; two guesses together where the bow tells it."""
        degrees, specs = list(self._degrees()), self.file.columns.specs
        for pair in (pair for kind in (LINEAR, ANGLES) for pair in combinations(kind, 2)):
            a, b = (f"velocity.{dof}" for dof in pair)
            if {a, b} <= specs.keys():
                change = _change({a: specs[b], b: specs[a]})
                yield RecordingDefect("swap", pair, "the velocities are exchanged", change)
        if not any(problem.kind in ("earth", "frame", "heading") for problem in self.problems):
            yield from self._turns(self.file)
        yield from degrees
        for first in degrees[:1] if self.aside else ():
            for turn in self._turns(changed(self.file, first.change)):
                text, both = f"{first.message}, and {turn.message}", {**first.change, **turn.change}
                yield replace(turn, message=text, change=both)

    def _turns(self, file: RecordedFile) -> Iterator[RecordingDefect]:
        """Other axes and headings than those with which a file is read."""
        heading, x = (file.columns.specs.get(f"position.{dof}") for dof in ("yaw", "surge"))
        free = vars(file.columns.frames) | ({"positive": heading.positive} if heading else {})
        if file.columns.geodetic or (x and {"n", "north", "northing"} & set(words_of(x.name))):
            del free["position"]
        if not (self.along or self.aside):
            free = {option: now for option, now in free.items() if SENSES[option][0] != "heading"}
        flat = set(PLANAR) <= set(self.recording.dofs)
        for options in TURNS if flat else ():
            if not set(options) <= free.keys():
                continue
            new = {option: OTHER[free[option]] for option in options}
            text = ", ".join(SENSES[option][2].format(value) for option, value in new.items())
            change = {f"columns.frames.{k}": v for k, v in new.items() if k != "positive"}
            if "positive" in new:
                turned = with_option(heading, ["positive"], new["positive"])
                change |= _change({"position.yaw": turned})
            axes = (axis.dof for axis in self.result.axes
                    if any(axis.dof in SENSES[option][1] for option in options))  # fmt: skip
            yield RecordingDefect(SENSES[options[0]][0], tuple(axes), text, change)
        for off in (90.0, 180.0, -90.0) if flat and self.along else ():
            degrees = (file.heading_deg - off + 179.0) % 360.0 - 179.0
            text = f"the heading is {-off:g} degrees off the positions"
            yield RecordingDefect("heading", YAW, text, {"heading_deg": degrees}, off)

    def _degrees(self) -> Iterator[RecordingDefect]:
        """Degrees of angles, and of rates beside them, whose unit is not stated."""
        free = {option: self.file.columns.specs[option] for option, reading in self.readings.items()
                if reading.known_from == column_map.SI_ASSUMED}  # fmt: skip
        angles = [option for option in BEARINGS if option in free]
        yaw = {"position.yaw"} & set(angles)
        rates = [option for dof in ANGLES if (option := f"velocity.{dof}") in free]
        groups = angles, [o for o in angles if o not in yaw], yaw, [*angles, *rates]
        for group in filter(None, groups):
            new = {o: replace(free[o], unit="deg/s" if o in rates else "deg") for o in group}
            axes = tuple(dof for dof in ANGLES if f"position.{dof}" in group)
            yield RecordingDefect("scale", axes, "the angles are in degrees", _change(new), DEGREES)

    def told(self) -> Iterator[RecordingDefect]:
        """What correlations and scales tell, with changes that may mend it."""
        result, columns = self.result, self.file.columns
        axes = [axis for axis in result.axes if axis.certain]
        for axis in (axis for axis in axes if axis.correlation < 0.0):
            option, text = f"velocity.{axis.dof}", "the velocity has the wrong sign"
            new = {o: replace(spec, column=f"-{spec.column}".removeprefix("--"))
                   for o, spec in columns.specs.items() if o == option}  # fmt: skip
            yield RecordingDefect("sign", (axis.dof,), text, _change(new), -1.0)
        lag, delay = result.lag_s, columns.delay_s.get("velocity", 0.0)
        least = consistency.CERTAIN * result.lag_error_s
        if abs(lag) >= max(SAMPLES_APART * self.recording.period_s, least):
            where = "behind" if lag > 0.0 else "ahead of"
            text = f"the velocities are {abs(lag):.3g} s {where} the pose"
            change = {"columns.delay_s.velocity": float(f"{lag + delay:.3g}")}
            yield RecordingDefect("clock", (), text, change, lag)
        yield from self._scales(axes)

    def _scales(self, axes: Sequence[consistency.Agreement]) -> Iterator[RecordingDefect]:
        """Certain axes in another unit, those in the same one together; others are a question.

        One factor on the rates of positions and of angles is one on time. A small angle between bow
        and heading explains the scale of an axis aside.
        """
        text, columns = "the derivative of the pose is {:.3g} times the velocity", self.file.columns
        specs = {**columns.specs, "time": columns.clock}
        nu = dict(zip(self.recording.dofs, self.recording.nu.T, strict=True))
        ahead = any(axis.dof == "surge" and not axis.off for axis in self.result.axes)
        median = float(np.median([abs(axis.scale) for axis in axes] or [1.0]))
        near = (a.off and 1.0 / SAME_SCALE < abs(a.scale) / median < SAME_SCALE for a in axes)
        same = len({axis.dof in ANGLES for axis in axes}) == 2 and all(near)
        units = defaultdict[tuple[str, float], dict[str, str]](dict)  # option by axis
        for axis in (axis for axis in axes if axis.off):
            size, own = median if same else abs(axis.scale), f"velocity.{axis.dof}"
            own = "ground.speed" if columns.ground and axis.dof in LINEAR[:2] else own
            error = abs(size - 1.0) * np.std(nu[axis.dof])
            if ahead and axis.dof in LINEAR and error < SMALL_ANGLE * abs(np.mean(nu["surge"])):
                line = f"{text.format(size)}, as by a lever arm or a late or turned heading"
                yield RecordingDefect("unknown", (axis.dof,), line, value=size)
                continue
            time = [("time", 1)] if same else []
            for option, sense in (*time, (own, 1), (f"position.{axis.dof}", -1)):
                now = columns.clock if option == "time" else self.readings.get(option)
                unit, value = _unit(now.unit, option, size**sense) if now else ("", 1.0)
                if unit:
                    units[unit, value**sense][axis.dof] = option
                    break
            else:
                if own in specs and not 1.0 / UNNAMED < size < UNNAMED:
                    pose = "attitude" if axis.dof in ANGLES else "position"
                    line = f"{specs[own].name} is {1.0 / size:.2f} of d({pose})/dt: which unit?"
                    yield RecordingDefect("question", (), line)
        for (unit, value), options in units.items():
            change = _change({o: replace(specs[o], unit=unit) for o in options.values()})
            yield RecordingDefect("scale", tuple(options), text.format(value), change, value)

    def slower(self) -> RecordingDefect | None:
        """Whether all columns of motion of a source were interpolated from slower ones."""
        times = recorded_file.clocks(self.sources, self.file.columns)
        motion = defaultdict[str, Any](lambda: defaultdict(list))
        for option, reading in self.readings.items():
            kind, _, dof = option.partition(".")
            if kind in column_map.MOTION:  # by itself: a heading and its rate may have no noise
                motion[reading.source.name][kind, dof in ANGLES].append(reading.values)
        for name, groups in motion.items():
            t, own = times[name], sampling(times[name]).rate_hz
            edges = piece_edges(t, 1.0 / own) if own else [0, len(t)]
            longest = int(np.argmax(np.diff(edges)))  # without a gap
            rows = slice(edges[longest], min(edges[longest + 1], edges[longest] + MOST_SAMPLES))
            rates = [original_rate(np.column_stack(x)[rows], own) for x in groups.values()]
            if None in rates:
                continue
            rate = max(filter(None, rates))  # columns that stand still have fewer samples
            nice = float(round(rate) if abs(rate - round(rate)) < rate / 20 else f"{rate:.2g}")
            if nice * self.recording.period_s < 1.0 / SAME_RATE:
                text = f"the columns are interpolated from {nice:g} Hz, the file has {own:.3g} Hz"
                return RecordingDefect("resampled", (), text, {"resample_hz": nice}, nice)
        return None


def _blocks(sources: Mapping[str, Source], columns: ColumnMap) -> dict[str, Source] | None:
    """Even blocks of the time of long sources; None if they are short."""
    clocks = recorded_file.clocks(sources, columns)
    longest = max(map(len, clocks.values()), default=0)
    if longest <= MOST_SAMPLES:
        return None
    every, result = np.concatenate([*clocks.values()]), dict(sources)
    start, end = float(np.nanmin(every)), float(np.nanmax(every))
    for name, t in clocks.items():
        rows = (t - start) / (end - start) * BLOCKS % 1.0 < MOST_SAMPLES / longest  # none of NaN
        cells = {title: cells[rows] for title, cells in sources[name].columns.items()}
        result[name] = replace(sources[name], columns=cells)
    return result


def doubts(sources: Mapping[str, Source], columns: ColumnMap) -> dict[str, str]:
    """Questions about columns without a stated unit whose values reach far, by option."""
    result, speed = dict[str, str](), columns.specs.get("ground.speed")
    for option, reading in column_map.readings(sources, columns).items():
        (kind, _, key), name = option.partition("."), reading.column.removeprefix("-")
        of = ((kind == "inputs" and quantity(reading.name)) or reading).option
        values = np.empty(0)
        with suppress(RecordingError):
            values = reading.values[~np.isnan(reading.values)]
        driven = option.startswith("inputs.pwm") and columns.specs[option].full is None
        if not len(values) or not (driven or reading.known_from == column_map.SI_ASSUMED):
            continue
        least, most = float(np.min(values)), float(np.max(values))
        largest, steps = max(-least, most), np.abs(np.diff(values))
        jumps = option in BEARINGS and np.any(np.abs(steps - 360.0) < 36.0)
        asked, answer = "in which unit?", ""
        if kind == "inputs" and PULSE_US[0] <= least and most <= PULSE_US[1]:
            asked, answer = "in which unit, or which value is full?", "neutral: 1500, full: 1900"
        elif option in ("water.speed", "wind.speed") and speed and speed.unit not in (None, "m/s"):
            answer = f"unit: {speed.unit}"
        elif driven and largest * si_factor(option, reading.unit) > 1.0:
            asked, answer = "which value is full?", f"neutral: 0, full: {largest:.3g}"
        elif not driven and (largest > LARGE.get(of, np.inf) or jumps):
            answer = f"unit: {'rpm' if of == 'inputs.n' else 'deg'}"
        if answer:
            line = f"{kind}: {{{key}: {{column: {name}, {answer}}}}}"
            result[option] = f"{name} ranges from {least:.4g} to {most:.4g}: {asked} {line}"
    return result


def _unit(now: str | None, option: str, ratio: float) -> tuple[str, float]:
    """The unit that gives `ratio` times the values in `now`, and its ratio; empty: none does."""
    si = next(iter(targets_of(option)), "s")
    ratios = {unit: factor(unit, si) / factor(now or si, si) for unit in UNITS[si]}
    unit = min(ratios, key=lambda unit: abs(np.log(ratio / ratios[unit])))
    near = abs(np.log(ratio / ratios[unit])) < np.log(NEAR_SCALE)
    return (unit, ratios[unit]) if near else ("", 1.0)


def _change(specs: Mapping[str, Column]) -> dict[str, Any]:
    """The change of a map that puts columns at options."""
    return {f"columns.{option}": spec.written for option, spec in specs.items()}
