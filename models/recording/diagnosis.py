"""All that can be said of a recording before anything is identified from it.

Where pose and velocity do not belong together, changes of the map are tried: the recording is read
again with each, and the one with which its axes agree best is taken, the simplest of those that are
as good. That is repeated until nothing gains. The problems are the changes that were taken, and
what the correlations tell but no change fixes. What is no unit of the field is asked, not scaled.
"""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from seatrial.models.errors import RecordingError
from seatrial.models.notation import DOFS, PLANAR
from seatrial.models.recording.column_map import (
    BEARINGS,
    Column,
    ColumnMap,
    factor,
    si_factor,
    targets_of,
    words_of,
)
from seatrial.models.recording.consistency import (
    AS_GOOD,
    CERTAIN,
    SAME_SCALE,
    SURE,
    Agreement,
    Consistency,
    consistency,
)  # fmt: skip
from seatrial.models.recording.quantities import quantity
from seatrial.models.recording.reader import FAULTS, FLIPPED, SI_ASSUMED, clock_of, readings
from seatrial.models.recording.recorded_file import RecordedFile
from seatrial.models.recording.recording import Recording, piece_edges
from seatrial.models.recording.sampling import original_rate, sampling
from seatrial.models.recording.source import Source
from seatrial.models.recording.times import seconds
from seatrial.models.vessel.basis import Array

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
LINEAR, ANGLES, YAW = DOFS[:3], DOFS[3:], ("yaw",)
UNITS = {  # that people record, by that of SI
    "m/s": ("m/s", "knot", "km/h", "ft/s", "cm/s", "mm/s"),
    "rad/s": ("rad/s", "deg/s", "rpm", "mrad/s", "deg/min"),
    "m": ("m", "mm", "cm", "ft", "km"), "rad": ("rad", "deg"),
    "s": ("s", "ms", "us", "ns", "min"),
}  # fmt: skip
# Readings that no correlation tells apart: kind of the problem, its axes, the options of the frames
# or of the heading that read the file so, and what is wrong.
TURNS: tuple[tuple[str, Sequence[str], dict[str, str], str], ...] = (
    ("earth", LINEAR, {"velocity": "earth"}, "the velocities are along the axes of the earth"),
    ("frame", LINEAR, {"position": "ENU"}, "the positions are east, north, up"),
    ("frame", FLIPPED, {"body": "FLU"}, "the velocities are forward, left, up, not forward, right, "
     "down, or the pose is of east, north, up"),
    ("heading", YAW, {"attitude": "ENU"}, "the attitude is of ENU"),
    ("frame", DOFS, {"attitude": "ENU", "body": "FLU"},
     "the attitude is of ENU, and the velocities are forward, left, up"),
    ("frame", DOFS, {"position": "ENU", "attitude": "ENU"}, "position and attitude are of ENU"),
    ("earth", LINEAR, {"velocity": "earth", "position": "ENU"},
     "the velocities are along the axes of the earth, and all is east, north, up"),
    ("heading", YAW, {"positive": "anticlockwise"}, "the heading counts anticlockwise"),
    ("heading", YAW, {"positive": "clockwise"}, "the heading counts clockwise"),
    ("frame", YAW, {"position": "ENU", "positive": "anticlockwise"},
     "the heading counts anticlockwise, and the positions are east, north, up"),
    ("heading", YAW, {"zero": "east", "positive": "anticlockwise"},
     "the heading counts from east, anticlockwise"),
)  # fmt: skip
Change = Mapping[str, Any]  # options of excitation, such as columns.velocity.surge, and values


@dataclass(frozen=True)
class RecordingDefect:
    """What is wrong with some axes of a recording, and the change of options that fixes it."""

    # scale | sign | swap | earth | frame | heading | clock | time | resampled | question | unknown
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

    result: Consistency
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
    poses, speeds = set(file.columns.posed), set(file.columns.moving)
    for own in (poses & (speeds | set(PLANAR)), poses & speeds, set(dofs)):
        known = tuple(dof for dof in DOFS if dof in own)
        with suppress(*FAULTS):
            if known:
                sources, recording = file.sources(), file.recording(known)
                case, blocks = _Case(file, sources, known, recording, None), _blocks(sources, file)
                if blocks is not None:
                    rate = file.resample_hz or 1.0 / recording.period_s
                    part = replace(file, resample_hz=rate, at_gap="split")
                    with suppress(*FAULTS):
                        return case._replace(file=part, blocks=blocks).examined()
                return case.examined()
    return None


class _State(NamedTuple):
    """How a recording agrees if it is read with some options."""

    file: RecordedFile
    recording: Recording
    result: Consistency

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

    def explained(self, axis: Agreement) -> bool:
        """Whether a small angle between bow and heading explains the scale of an axis aside."""
        surge = next((a for a in self.result.axes if a.dof == "surge"), None)
        if surge is None or surge.off or not (surge.certain or surge.steady):
            return False
        ahead, aside = (self.recording.nu[:, self.recording.dofs.index(dof)]
                        for dof in ("surge", axis.dof))  # fmt: skip
        error = abs(abs(axis.scale) - 1.0) * np.std(aside)
        return axis.dof in LINEAR[1:] and bool(error < SMALL_ANGLE * abs(np.mean(ahead)))

    @property
    def specs(self) -> dict[str, Column]:
        """The columns of motion by option; without those that a quaternion or GNSS replaces."""
        columns = self.file.columns
        replaced = (LINEAR if columns.geodetic else (), ANGLES if columns.orientation else ())
        options = {f"position.{dof}" for dofs in replaced for dof in dofs}
        kinds = ("position", "velocity", "ground", "wind")
        return {option: spec for option, spec in columns.specs.items()
                if option.partition(".")[0] in kinds and option not in options}  # fmt: skip


class _Case(NamedTuple):
    """A recording that is read again and again, all of it or blocks of its sources."""

    file: RecordedFile
    sources: Mapping[str, Source]
    known: tuple[str, ...]
    recording: Recording
    blocks: Mapping[str, Source] | None

    def examined(self) -> Examination:
        """What is wrong with the recording, with the changes that were tried."""
        recording = self.file.recording(self.known, self.blocks)
        state, problems = self._compared(self.file, recording), list[RecordingDefect]()
        plain = state.result
        if (slower := self._slower(state)) is not None:
            after = self._tried(state, slower)
            problems.append(slower if after else replace(slower, change={}))
            state = after or state
        for _ in range(MOST_CHANGES):
            told = list(self._told(state))
            turned = any(problem.kind in ("earth", "frame", "heading") for problem in problems)
            if (best := self._best(state, [d for d in told if d.change], turned)) is None:
                break
            problems.append(best[0])
            state = self._compared(*best[1][:2])  # where it agrees best
        questions = [defect.message for defect in told if defect.kind == "question"]
        told = [replace(defect, change={}) for defect in told if defect.kind != "question"]
        named = {dof for defect in told for dof in defect.axes}
        told += [
            RecordingDefect("unknown", (axis.dof,), "the velocity and the derivative have a "
                            f"correlation of {axis.correlation:.2f}", value=axis.correlation)
            for axis in state.result.untrusted if axis.dof not in named
        ]  # fmt: skip
        delay = sum(p.value or 0.0 for p in problems if p.kind == "clock")
        result = replace(plain, lag_s=state.result.lag_s + delay)
        good = {a.dof for a in state.result.axes if a.correlation > SURE and not a.off}
        sure = {f"position.{dof}" for dof in good}
        sure |= {"position.yaw"} if good & set(LINEAR) else set()
        doubtful = doubts(self.sources, state.file.columns).items()
        questions = [*(line for option, line in doubtful if option not in sure), *questions]
        found, missing = tuple(problems + told), tuple(self._not_compared())
        return Examination(result, found, self.recording, tuple(questions), missing)

    def _compared(
        self, file: RecordedFile, recording: Recording, band: float | None = None
    ) -> _State:
        return _State(file, recording, consistency(recording, file.columns.moving, band))

    def _tried(self, state: _State, defect: RecordingDefect) -> _State | None:
        """The recording read with a change, compared in the same band; None if it cannot be."""
        band = None if defect.kind == "resampled" else state.result.band
        with suppress(*FAULTS):
            file = changed(state.file, defect.change)
            return self._compared(file, file.recording(self.known, self.blocks), band)
        return None

    def _best(
        self, state: _State, told: Sequence[RecordingDefect], turned: bool
    ) -> tuple[RecordingDefect, _State] | None:
        """The first of the changes that are as good as the best one; None if none gains enough.

        A vessel that hardly moves ahead gains what it moves ahead, also by two guesses together.
        """
        fine = not state.result.axes or state.result.quality > 1.0 - AS_GOOD
        settled, tried = fine and not state.aside, []
        degrees = [] if settled else list(self._degrees(state))
        guesses = [*(() if settled or turned else self._turns(state, state.aside)), *degrees]
        if state.aside and degrees and (after := self._tried(state, degrees[0])):
            guesses += [
                replace(turn, message=f"{degrees[0].message}, and {turn.message}",
                        change={**degrees[0].change, **turn.change})
                for turn in self._turns(after, aside=True)
            ]  # fmt: skip
        for defect in (*told, *guesses):
            if (after := self._tried(state, defect)) is None:
                continue
            ahead = after.ahead if state.aside and after.ahead > AHEAD else 0.0
            gain = after.result.quality - state.result.quality + ahead
            worse = defect in guesses and after.ahead < ASIDE and state.ahead > AHEAD
            worse |= any(
                new.quality < old.quality - AS_GOOD and old.correlation > SURE
                for old, new in zip(state.result.axes, after.result.axes, strict=True)
            )
            if gain > (defect in guesses) * AS_GOOD and not worse:
                text = f"the vessel moves ahead in {100.0 * max(state.ahead, 0.0):.0f} % of its way"
                said = f"{text}: {defect.message}" if ahead else defect.message
                tried.append((gain, replace(defect, message=said), after))
        most = max((gain for gain, *_ in tried), default=0.0)
        return next(((d, after) for gain, d, after in tried if gain >= most - AS_GOOD), None)

    def _turns(self, state: _State, aside: bool) -> Iterator[RecordingDefect]:
        """Other axes and headings, of which no correlation of one axis tells."""
        columns, specs, result = state.file.columns, state.specs, state.result
        heading, x = specs.get("position.yaw"), specs.get("position.surge")
        titled = bool(x and {"n", "north", "northing"} & set(words_of(x.name)))
        titled |= aside and bool(columns.geodetic)
        compared = {axis.dof for axis in result.axes}
        for kind, axes, options, text in TURNS if set(PLANAR) <= set(self.known) else ():
            sense: dict[str, Any] = {k: v for k, v in options.items() if k in ("zero", "positive")}
            change = {f"columns.frames.{k}": v for k, v in options.items() if k not in sense}
            if sense and heading:
                change |= _change({"position.yaw": replace(heading, **sense)})
            # which only a velocity along the body tells, or the way
            turns = (sense or "attitude" in options) and not (state.along or aside)
            if ((sense and heading is None) or turns or (titled and "position" in options)
                    or changed(state.file, change).columns == columns):  # fmt: skip
                continue
            yield RecordingDefect(kind, tuple(d for d in axes if d in compared), text, change)
        for off in (90.0, 180.0, -90.0) if state.along and set(PLANAR) <= set(self.known) else ():
            degrees = (state.file.heading_deg - off + 179.0) % 360.0 - 179.0
            text = f"the heading is {-off:g} degrees off the positions"
            yield RecordingDefect("heading", YAW, text, {"heading_deg": degrees}, off)

    def _degrees(self, state: _State) -> Iterator[RecordingDefect]:
        """Degrees of angles, and of rates beside them, whose unit is not stated."""
        known = readings(self.sources, state.file.columns)
        free = {o: spec for o, spec in state.specs.items() if spec.unit is None
                and o in known and known[o].known_from == SI_ASSUMED}  # fmt: skip
        angles = [option for option in BEARINGS if option in free]
        yaw = [option for option in angles if option == "position.yaw"]
        rates = [option for dof in ANGLES if (option := f"velocity.{dof}") in free]
        for group in (angles, [o for o in angles if o not in yaw], yaw, [*angles, *rates]):
            new = {o: replace(free[o], unit="deg/s" if o in rates else "deg") for o in group}
            axes = tuple(dof for dof in ANGLES if f"position.{dof}" in group)
            also = " and their rates" if set(rates) & set(group) else ""
            text = f"the angles of the pose{also} are in degrees"
            if group:
                yield RecordingDefect("scale", axes, text, _change(new), 180.0 / np.pi)

    def _told(self, state: _State) -> Iterator[RecordingDefect]:
        """What correlations and scales tell, with changes that may mend it.

        Axes in the same unit are named together; what is of no unit is a question. One factor on
        all rates, of positions and of angles, is one on time.
        """
        result, columns, specs = state.result, state.file.columns, state.specs
        for group in result.swaps:
            new = {f"velocity.{to}": specs[o] for dof, to in (group, group[::-1])
                   if (o := f"velocity.{dof}") in specs}  # fmt: skip
            change = _change(new) if len(new) == 2 else {}
            yield RecordingDefect("swap", group, "the velocities are exchanged", change)
        axes = [axis for axis in result.axes if axis.certain]
        for axis in (axis for axis in axes if axis.correlation < 0.0):
            option, text = f"velocity.{axis.dof}", "the velocity has the wrong sign"
            new = {o: replace(spec, column=f"-{spec.column}".removeprefix("--"))
                   for o, spec in specs.items() if o == option}  # fmt: skip
            yield RecordingDefect("sign", (axis.dof,), text, _change(new), -1.0)
        lag, period = result.lag_s, state.recording.period_s
        apart = abs(lag) >= max(SAMPLES_APART * period, CERTAIN * result.lag_error_s)
        if apart and result.shared_lag_s != 0.0:
            delay = float(f"{lag + columns.delay_s.get('velocity', 0.0):.3g}")
            text = f"{abs(lag):.3g} s {'behind' if lag > 0.0 else 'ahead of'} the pose"
            change = {"columns.delay_s.velocity": delay}
            yield RecordingDefect("clock", (), f"the velocities are {text}", change, lag)
        text, time = "the derivative of the pose is {:.3g} times the velocity", columns.clock
        scale = float(np.median([abs(axis.scale) for axis in axes])) if axes else 1.0
        same = all(1.0 / SAME_SCALE < abs(a.scale) / scale < SAME_SCALE and a.off for a in axes)
        unit, value = _unit(time.unit or "s", "time", scale)
        if unit and same and len({axis.dof in ANGLES for axis in axes}) == 2:
            change = {"columns.time": replace(time, unit=unit).written}
            dofs, line = tuple(axis.dof for axis in axes), f"{text.format(scale)} on every axis"
            yield RecordingDefect("time", dofs, line, change, value)
            return
        known = readings(self.sources, columns)
        groups = defaultdict[tuple[str, float], dict[str, str]](dict)  # option by axis
        for axis in (axis for axis in axes if axis.off):
            size, own = abs(axis.scale), f"velocity.{axis.dof}"
            own = "ground.speed" if columns.ground and axis.dof in LINEAR[:2] else own
            if state.explained(axis):
                line = (f"{text.format(size)}, though surge agrees: a lever arm, or a heading that "
                        "is late or turned, does that")  # fmt: skip
                yield RecordingDefect("unknown", (axis.dof,), line, value=size)
                continue
            for option, sense in ((own, 1), (f"position.{axis.dof}", -1)):
                now = known[option].unit or targets_of(option)[0] if option in specs else ""
                unit, value = _unit(now, option, size**sense) if now else ("", 1.0)
                if unit:
                    groups[unit, value**sense][axis.dof] = option
                    break
            else:
                if own in specs and not 1.0 / UNNAMED < size < UNNAMED:
                    pose = "attitude" if axis.dof in ANGLES else "position"
                    line = f"{specs[own].name} is {1.0 / size:.2f} of d({pose})/dt: which unit?"
                    yield RecordingDefect("question", (), line)
        for (unit, value), options in groups.items():
            change = _change({o: replace(specs[o], unit=unit) for o in options.values()})
            yield RecordingDefect("scale", tuple(options), text.format(value), change, value)

    def _not_compared(self) -> Iterator[str]:
        """Which quantity is missing for a comparison, and where."""
        poses, speeds = set(self.file.columns.posed), set(self.file.columns.moving)
        linear = [dof for dof in self.known if dof in LINEAR and dof in speeds]
        there = "pose and velocity cannot be compared there"
        flat = (f"the path cannot be turned into body axes and compared in {' and '.join(linear)}"
                if linear and poses & set(ANGLES) else "")  # fmt: skip
        for what, lacking, why in (
            ("velocity", [dof for dof in self.known if dof not in speeds], there),
            ("pose", [dof for dof in DOFS if dof in speeds - poses], there),
            ("pose or force", [d for d in PLANAR if d not in self.known] if flat else [], flat),
        ):
            if lacking:
                yield f"no {what} in {' and '.join(lacking)} is recorded: {why}"

    def _slower(self, state: _State) -> RecordingDefect | None:
        """Whether all columns of motion of a source were interpolated from slower ones.

        There is no problem if the recording is read at the original rate.
        """
        motion = defaultdict[str, dict[tuple[str, bool], list[Array]]](dict)
        for option, reading in readings(self.sources, state.file.columns).items():
            kind, _, dof = option.partition(".")
            if option in state.specs and kind in ("position", "velocity"):
                alike = motion[reading.source.name].setdefault((kind, dof in ANGLES), [])
                alike.append(reading.values)
        for name, groups in motion.items():
            t = seconds(self.sources[name], clock_of(self.sources[name], self.file.columns))
            own = sampling(t).rate_hz
            pieces = pairwise(piece_edges(t, 1.0 / own) if own else [0, len(t)])
            a, b = max(pieces, key=lambda piece: piece[1] - piece[0])
            rows = slice(a, min(b, a + MOST_SAMPLES))  # without a gap
            rates = [original_rate(np.column_stack(x)[rows], own) for x in groups.values()]
            if None in rates:
                continue
            rate = max(filter(None, rates))  # columns that stand still have fewer samples
            nice = float(round(rate) if abs(rate - round(rate)) < rate / 20 else f"{rate:.2g}")
            if nice * self.recording.period_s < 1.0 / SAME_RATE:
                text = f"the columns are interpolated from {nice:g} Hz, the file has {own:.3g} Hz"
                return RecordingDefect("resampled", (), text, {"resample_hz": nice}, nice)
        return None


def _blocks(sources: Mapping[str, Source], file: RecordedFile) -> dict[str, Source] | None:
    """Even blocks of the time of long sources; None if they are short."""
    clocks = dict[str, Array]()
    for name, source in sources.items():
        with suppress(*FAULTS):
            clocks[name] = seconds(source, clock_of(source, file.columns))
    longest = max(map(len, clocks.values()), default=0)
    if longest <= MOST_SAMPLES:
        return None
    start = min(float(np.nanmin(t)) for t in clocks.values())
    length = max(float(np.nanmax(t)) for t in clocks.values()) - start
    result = dict(sources)
    for name, t in clocks.items():
        rows = (t - start) / length * BLOCKS % 1.0 < MOST_SAMPLES / longest  # not those of NaN
        cells = {title: cells[rows] for title, cells in result[name].columns.items()}
        result[name] = replace(result[name], columns=cells)
    return result


def doubts(sources: Mapping[str, Source], columns: ColumnMap) -> dict[str, str]:
    """Questions about columns without a stated unit whose values reach far, by option."""
    result, speed = dict[str, str](), columns.specs.get("ground.speed")
    for option, reading in readings(sources, columns).items():
        (kind, _, key), name = option.partition("."), reading.column.removeprefix("-")
        named = quantity(reading.name) if kind == "inputs" else None
        of = named.option if named else option
        values = np.empty(0)
        with suppress(RecordingError):
            values = reading.values[~np.isnan(reading.values)]
        driven = option.startswith("inputs.pwm") and columns.specs[option].full is None
        if not len(values) or not (driven or reading.known_from == SI_ASSUMED):
            continue
        least, most = float(np.min(values)), float(np.max(values))
        largest = max(abs(least), abs(most))
        jumps = option in BEARINGS and np.any(np.abs(np.abs(np.diff(values)) - 360.0) < 36.0)
        spans = f"{name} ranges from {least:.4g} to {most:.4g}"
        if kind == "inputs" and PULSE_US[0] <= least and most <= PULSE_US[1]:
            pulse = f"{{column: {name}, neutral: 1500, full: 1900}}"
            line = f"is it the width of a pulse in us? inputs: {{{key}: {pulse}}}"
            result[option] = f"{spans}: {line}"
        elif option in ("water.speed", "wind.speed") and speed and speed.unit not in (None, "m/s"):
            line = f"{kind}: {{{key}: {{column: {name}, unit: {speed.unit}}}}}"
            result[option] = f"{speed.name} is in {speed.unit}, and {name}? {line}"
        elif driven and largest * si_factor(option, reading.unit) > 1.0:
            whole = f"{{column: {name}, neutral: 0, full: {largest:.3g}}}"
            result[option] = f"{spans}: which value is full? inputs: {{{key}: {whole}}}"
        elif not driven and (largest > LARGE.get(of, np.inf) or jumps):
            unit = f"{{column: {name}, unit: {'rpm' if of == 'inputs.n' else 'deg'}}}"
            result[option] = f"{spans}: in which unit? {kind}: {{{key}: {unit}}}"
    return result


def _unit(now: str, option: str, ratio: float) -> tuple[str, float]:
    """The unit that gives `ratio` times the values in `now`, and its ratio; empty: none does."""
    si = next(iter(targets_of(option)), "s")
    ratios = {unit: factor(unit, si) / factor(now, si) for unit in UNITS[si]}
    unit = min(ratios, key=lambda unit: abs(np.log(ratio / ratios[unit])))
    near = abs(np.log(ratio / ratios[unit])) < np.log(NEAR_SCALE)
    return (unit, ratios[unit]) if near else ("", 1.0)


def _change(specs: Mapping[str, Column]) -> dict[str, Any]:
    """The change of a map that puts columns at options."""
    return {f"columns.{option}": spec.written for option, spec in specs.items()}
