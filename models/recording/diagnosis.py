"""All that can be said of a recording before anything is identified from it.

Every problem has the change of the map that mends it, if one does: a change is proposed only if the
recording, read again with it, agrees. What is no unit of the field is asked, not scaled.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple, Protocol

import numpy as np

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.notation import DOFS, PLANAR
from seatrial.models.recording.column_map import KINDS, Column, ColumnMap, as_column
from seatrial.models.recording.consistency import (
    CERTAIN,
    LEAST_TRUSTED,
    SURE,
    Agreement,
    Consistency,
    consistency,
    in_degrees,
)
from seatrial.models.recording.reader import SI_ASSUMED, clock_of, unit_of
from seatrial.models.recording.recording import Recording
from seatrial.models.recording.sampling import original_rate, sampling
from seatrial.models.recording.source import Source, column
from seatrial.models.recording.times import seconds
from seatrial.models.recording.units import SI, factor
from seatrial.models.vessel.basis import Array

SAME_SCALE = 1.39  # scales within this factor of one are nearer to it than to the knot
NEAR_SCALE = 1.25  # a scale is that of a unit within this factor
UNNAMED = 2.0  # a scale within this factor that is of no unit is that of a filter or sensor
SAMPLES_APART = 2.0  # a smaller delay is that of a filter or of sampling
WORSE = 0.05  # correlation that an axis may lose by a change that mends another
SAME_RATE = 1.05  # of the rate of the original samples
MOST_SAMPLES, BLOCKS = 200_000, 20  # of a longer recording, as many even blocks are compared
LARGE = {"roll": np.pi, "pitch": np.pi, "yaw": 6.0 * np.pi}  # [rad] rarely reached
CHANGED_SIGN_IN_FLU = ("sway", "heave", "pitch", "yaw")
UNITS = {  # that people record, by that of SI
    "m/s": ("m/s", "knot", "km/h", "ft/s", "cm/s", "mm/s"),
    "rad/s": ("rad/s", "deg/s", "rpm", "mrad/s", "deg/min"),
    "m": ("m", "mm", "cm", "ft", "km"), "rad": ("rad", "deg"),
    "m/s^2": ("m/s^2", "g_0", "cm/s^2", "mm/s^2"), "rad/s^2": ("rad/s^2", "deg/s^2"),
    "s": ("s", "ms", "us", "ns", "min"),
}  # fmt: skip
Change = Mapping[str, Any]  # options of excitation, such as columns.velocity.surge, and values
FAULTS = (ConfigurationError, RecordingError)


class Read(Protocol):
    """Reads the recording with a map and other options, in some degrees of freedom."""

    def __call__(self, columns: ColumnMap, dofs: Sequence[str], **options: Any) -> Recording: ...  # noqa: D102


@dataclass(frozen=True)
class RecordingDefect:
    """What is wrong with some axes of a recording, and the change of options that mends it."""

    # scale | sign | swap | earth | frame | heading | clock | time | resampled | unknown
    kind: str
    axes: tuple[str, ...]
    message: str
    change: Change = field(default_factory=dict)  # empty: none that was tried mends it
    value: float | None = None  # the factor, the lag [s], the angle [deg] or the rate [Hz]

    @property
    def fix(self) -> str:
        """The change as it is written in a configuration."""
        return ", ".join(
            f"excitation.{path}: {{{', '.join(f'{key}: {item}' for key, item in value.items())}}}"
            if isinstance(value, Mapping)
            else f"excitation.{path}={value:g}" if isinstance(value, float)
            else f"excitation.{path}={value}"
            for path, value in self.change.items()
        )  # fmt: skip

    cure = fix

    def __str__(self) -> str:
        axes = f"{', '.join(self.axes)}: " if self.axes else ""
        return f"{axes}{self.message}; {self.fix or 'no change of the map that was tried mends it'}"

    @property
    def signs(self) -> set[tuple[str, str]]:
        """The kind of the problem with each of its axes."""
        return {(self.kind, dof) for dof in self.axes or ("",)}


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


def changed(columns: ColumnMap, change: Change) -> ColumnMap:
    """The map with a change; other options of `excitation` are left out."""
    for path, value in change.items():
        kind, _, name = path.removeprefix("columns.").partition(".")
        new: Any = Column(**value) if isinstance(value, Mapping) else value
        if kind == "frames":
            new = replace(columns.frames, **{name: value})
        elif name:
            new = {**getattr(columns, kind), name: new}
        if path.startswith("columns."):
            columns = replace(columns, **{kind: new})
    return columns


def examine(
    read: Read, columns: ColumnMap, sources: Mapping[str, Source], dofs: Sequence[str],
    heading_deg: float = 0.0,
) -> Examination | None:  # fmt: skip
    """Examine a recording with all degrees of freedom that it holds, else with `dofs`.

    Args:
        read: reads the recording by a map and other options, such as `resample_hz`.
        columns: the map.
        sources: the columns as recorded.
        dofs: degrees of freedom of the vessel.
        heading_deg: that of the options.

    Returns:
        None if the recording cannot be read.
    """
    poses, speeds = set(columns.posed), set(columns.moving)
    for own in (poses & (speeds | set(PLANAR)), poses & speeds, set(dofs)):
        known = tuple(dof for dof in DOFS if dof in own)
        if not known:
            continue
        try:
            recording = read(columns, known)
        except FAULTS:
            continue
        return _Case(read, columns, sources, known, heading_deg).examined(recording, poses)
    return None


class _Draft(NamedTuple):
    """A problem, and changes that may mend it."""

    defect: RecordingDefect
    changes: tuple[Change, ...]


class _Comparison(NamedTuple):
    columns: ColumnMap
    recording: Recording
    result: Consistency
    drafts: tuple[_Draft, ...]
    questions: tuple[str, ...]

    @property
    def signs(self) -> set[tuple[str, str]]:
        return {sign for draft in self.drafts for sign in draft.defect.signs}

    @property
    def good(self) -> set[str]:
        """Axes of which the scale is right."""
        axes = self.result.velocities
        return {a.dof for a in axes if a.excited and a.correlation > SURE and not _off(a)}


@dataclass(frozen=True)
class _Case:
    """A recording that is read again and again."""

    read: Read
    columns: ColumnMap
    sources: Mapping[str, Source]
    known: tuple[str, ...]
    heading_deg: float

    def compared(self, change: Change) -> _Comparison:
        """Read the recording with a change, and compare."""
        columns = changed(self.columns, change)
        options = {k: value for k, value in change.items() if not k.startswith("columns.")}
        return self._of(columns, self.read(columns, self.known, **options))

    def _of(self, columns: ColumnMap, recording: Recording) -> _Comparison:
        part = recording
        if len(part) > MOST_SAMPLES:
            row = np.arange(len(part)) % -(-len(part) // BLOCKS)
            part = part.part(row < MOST_SAMPLES // BLOCKS)
        measured = [dof for dof in self.known if dof in columns.acceleration]
        result = consistency(part, measured, columns.moving)
        slower = self._slower(1.0 / recording.period_s)
        for draft in slower:  # delays are of the samples that were recorded
            result = replace(result, period_s=1.0 / (draft.defect.value or np.inf))
        found = _Diagnosis(result, columns, self.sources, self.heading_deg)
        return _Comparison(columns, recording, result, (*slower, *found.drafts), found.questions)

    def examined(self, recording: Recording, poses: set[str]) -> Examination:
        """What is wrong with the recording, with the changes that were tried."""
        plain = self._of(self.columns, recording)
        turned, wide = self._in_degrees(plain)
        start = self.compared(turned) if turned else plain
        result = replace(start.result, velocities=plain.result.velocities,
                         accelerations=plain.result.accelerations)  # fmt: skip
        found = [] if not turned else [
            RecordingDefect(
                "scale", tuple(path.rpartition(".")[2] for path in turned),
                "the angles of the pose are in degrees", turned, 180.0 / np.pi,
            )
        ]  # fmt: skip
        mended = self._mended(start, turned)
        found += [replace(d.defect, change=c) for d, c in zip(start.drafts, mended, strict=True)]
        questions = (*wide, *start.questions)
        return Examination(
            result, tuple(found), plain.recording, questions, self._not_compared(poses)
        )

    def _mended(self, before: _Comparison, turned: Change) -> list[Change]:
        """Of each problem the change that mends it, empty if none does: all together, then alone.

        A problem is mended if it is gone, no other has come, and no axis agrees less.
        """
        level = {a.dof: a.correlation for a in before.result.velocities if a.excited}

        def mends(change: Change, signs: set[tuple[str, str]]) -> bool:
            try:
                after = self.compared({**turned, **change})
            except FAULTS:
                return False
            less = [a for a in after.result.velocities
                    if a.correlation < level.get(a.dof, -1.0) - WORSE]  # fmt: skip
            return after.signs <= before.signs - signs and not less

        firsts = [draft.changes[0] if draft.changes else {} for draft in before.drafts]
        together = {path: value for change in firsts for path, value in change.items()}
        able = [draft.defect.signs for draft in before.drafts if draft.changes]
        if able and mends(together, set().union(*able)):
            return firsts
        return [
            next((c for c in d.changes if (len(able) > 1 or c != together)
                  and mends(c, d.defect.signs)), {})
            for d in before.drafts
        ]  # fmt: skip

    def _in_degrees(self, plain: _Comparison) -> tuple[Change, tuple[str, ...]]:
        """The change of angles that are in degrees by the motion, and questions about others."""
        specs = {} if self.columns.orientation else {
            dof: as_column(spec) for dof, spec in self.columns.position.items() if dof in DOFS[3:]
        }  # fmt: skip
        wide = {}
        for dof, spec in specs.items():
            values = _numbers(self.sources, spec)
            told = plain.good & ({dof, *DOFS[:3]} if dof == "yaw" else {dof})
            if values is None or told or self._stated(f"position.{dof}", spec):
                continue
            if np.nanmax(np.abs(values), initial=0.0) > LARGE[dof]:
                wide[dof] = (f"{spec.name} ranges from {np.nanmin(values):.4g} to "
                             f"{np.nanmax(values):.4g}, read in rad: which unit?")  # fmt: skip
        cutoff = plain.result.cutoff_hz
        large = {*wide, *in_degrees(plain.recording, self.columns.moving, cutoff)}
        tilt = {"roll", "pitch"} if large & {"roll", "pitch"} else set()  # of one instrument
        for dofs in (large | tilt, tilt, large - tilt) if large else ():
            change = {f"columns.position.{dof}": _written(replace(specs[dof], unit="deg"))
                      for dof in DOFS if dof in dofs and dof in specs}  # fmt: skip
            try:
                if change and plain.good < self.compared(change).good:
                    return change, tuple(text for dof, text in wide.items() if dof not in dofs)
            except FAULTS:
                continue
        return {}, tuple(wide.values())

    def _stated(self, option: str, spec: Column) -> bool:
        """Whether the unit of a column is stated somewhere."""
        return unit_of(self.sources, self.columns, option, spec).known_from != SI_ASSUMED

    def _not_compared(self, poses: set[str]) -> tuple[str, ...]:
        """Which quantity is missing for a comparison, and where."""
        speeds, there = set(self.columns.moving), "pose and velocity cannot be compared there"
        lines = []
        if lacking := [dof for dof in self.known if dof not in speeds]:
            lines.append(f"no velocity in {' and '.join(lacking)} is recorded: {there}")
        if unposed := [dof for dof in DOFS if dof in speeds - poses]:
            lines.append(f"no pose in {' and '.join(unposed)} is recorded: {there}")
        linear = [dof for dof in self.known if dof in DOFS[:3] and dof in speeds]
        if linear and poses & set(DOFS[3:]) and (gone := set(PLANAR) - set(self.known)):
            names = " and ".join(dof for dof in PLANAR if dof in gone)
            lines.append(f"no pose or force in {names} is recorded: the path cannot be turned into "
                         f"body axes and compared in {' and '.join(linear)}")  # fmt: skip
        return tuple(lines)

    def _slower(self, rate_hz: float) -> tuple[_Draft, ...]:
        """The problem of a source whose columns of motion were all interpolated from slower ones.

        There is none if the recording is read at the original rate.
        """
        groups: dict[str, dict[str, list[Array]]] = {}
        for kind in ("position", "velocity"):
            for dof, spec in getattr(self.columns, kind).items():
                values = _numbers(self.sources, as_column(spec))
                if values is not None:
                    name = column(self.sources, as_column(spec).name)[0].name
                    parts = groups.setdefault(name, {})
                    parts.setdefault(f"{kind}{dof in DOFS[3:]}", []).append(values)
        drafts = []
        for name, parts in groups.items():
            try:
                source = self.sources[name]
                own = sampling(seconds(source, clock_of(source, self.columns))).rate_hz
            except FAULTS:
                continue
            rates = [original_rate(np.column_stack(values)[:MOST_SAMPLES], own)
                     for values in parts.values()]  # fmt: skip
            known = [rate for rate in rates if rate is not None]
            if len(known) < len(rates):
                continue
            rate = max(known)  # columns that stand still for a while have fewer samples
            nice = float(round(rate) if abs(rate - round(rate)) < rate / 20 else f"{rate:.2g}")
            if rate_hz > SAME_RATE * nice:
                text = f"the columns are interpolated from {nice:g} Hz, the file has {own:.3g} Hz"
                defect = RecordingDefect("resampled", (), text, value=nice)
                drafts.append(_Draft(defect, ({"resample_hz": nice},)))
        return tuple(drafts)


class _Diagnosis:
    """Problems by name, with changes of the map that may mend them, and questions."""

    def __init__(
        self, result: Consistency, columns: ColumnMap, sources: Mapping[str, Source],
        heading_deg: float,
    ) -> None:  # fmt: skip
        self.sources, self.columns = sources, columns
        self.specs = {
            f"{kind}.{dof}": as_column(spec)
            for kind in KINDS
            for dof, spec in getattr(columns, kind).items()
            if columns.orientation is None or kind != "position" or dof in DOFS[:3]
        }
        # Where the columns belong, and how they are written when all that was found is put right.
        self.places = {f"velocity.{a.dof}": f"velocity.{a.other}" for a in result.best}
        self.axes = [axis for axis in result.best if axis.excited and result.significant(axis)]
        self.found: list[tuple[RecordingDefect, tuple[str, ...], tuple[Change, ...]]] = []
        self.questions: tuple[str, ...] = ()
        self._frames(result, heading_deg)
        self._order_and_signs()
        if not self._time():
            self._scales()
        self._clock(result)
        self._accelerations(result)
        self._unexplained(result)

    @property
    def drafts(self) -> tuple[_Draft, ...]:
        """The problems with the changes that may mend them."""
        drafts = []
        for defect, options, changes in self.found:
            own = {f"columns.{self.places.get(option, option)}": _written(self.specs[option])
                   for option in options if option in self.specs}  # fmt: skip
            drafts.append(_Draft(defect, changes or ((own,) if own else ())))
        return tuple(drafts)

    def _add(
        self, kind: str, axes: Sequence[str], message: str, *changes: Change,
        options: Sequence[str] = (), value: float | None = None, **new: Any,
    ) -> None:  # fmt: skip
        """Add a problem; `new` are of the columns `options`."""
        for option in options:
            if option in self.specs:
                self.specs[option] = replace(self.specs[option], **new)
        defect = RecordingDefect(kind, tuple(axes), message, value=value)
        self.found.append((defect, tuple(options), changes))

    def _frames(self, result: Consistency, heading_deg: float) -> None:
        """Readings of the pose and of the velocity's axes that differ from ours."""
        reading, linear = result.reading, [a.dof for a in self.axes if a.dof in DOFS[:3]]
        yaw = self.specs.get("position.yaw")
        if reading.velocity == "earth":
            text = "the velocities are along the axes of the earth, not of the body"
            self._add("earth", linear, text, {"columns.frames.velocity": "earth"})
        if reading.position == "ENU":
            text = "the positions are east, north, up, not north, east, down"
            self._add("frame", linear, text, {"columns.frames.position": "ENU"})
        if reading.heading == "opposite":
            opposite = yaw and yaw.positive == "anticlockwise"
            sense = "clockwise" if opposite else "anticlockwise"
            self._add("heading", ("yaw",), f"the heading counts {sense}",
                      options=("position.yaw",), positive=sense)  # fmt: skip
        if reading.heading == "east":
            east = yaw and _written(replace(yaw, zero="east", positive="anticlockwise"))
            self._add(
                "heading", ("yaw",), "the attitude is of ENU: the heading counts from east, "
                "anticlockwise", {"columns.frames.attitude": "ENU"},
                *([{"columns.position.yaw": east}] if east else []),
            )  # fmt: skip
        if reading.heading_offset:
            off = (round(np.degrees(reading.heading_offset)) + 179) % 360 - 179
            new = (heading_deg - off + 179.0) % 360.0 - 179.0
            self._add("heading", ("yaw",), f"the heading is {-off:g} degrees off the positions",
                      {"heading_deg": new}, value=float(off))  # fmt: skip

    def _order_and_signs(self) -> None:
        """Velocities that belong to other axes, or have the wrong sign; those of FLU together."""
        others, seen = {axis.dof: axis.other for axis in self.axes}, set[str]()
        for dof, other in others.items():
            group = [dof]
            while other not in group:
                group.append(other)
                other = others.get(other, dof)
            if len(group) > 1 and not seen & set(group):
                axes = [d for d in DOFS if d in group]
                self._add("swap", axes, "the velocities are exchanged",
                          options=[f"velocity.{d}" for d in axes])  # fmt: skip
            seen |= set(group)
        wrong = [axis.dof for axis in self.axes if axis.correlation < 0.0]
        expected = [axis.dof for axis in self.axes if axis.dof in CHANGED_SIGN_IN_FLU]
        if len(wrong) > 1 and wrong == expected and len(self.axes) > len(wrong):
            self._add(
                "frame", wrong, "the velocities are forward, left, up, not forward, right, down, "
                "or the pose is of east, north, up", {"columns.frames.body": "FLU"},
                {"columns.frames.position": "ENU", "columns.frames.attitude": "ENU"},
            )  # fmt: skip
            return
        for dof in wrong:
            self._reverse(f"velocity.{dof}")

    def _reverse(self, option: str) -> None:
        kind, _, dof = option.partition(".")
        spec = self.specs[option]
        name = spec.name if spec.sign < 0.0 else f"-{spec.name}"
        self._add("sign", (dof,), f"the {kind} has the wrong sign", options=(option,), value=-1.0,
                  column=name)  # fmt: skip

    def _time(self) -> bool:
        """One factor on all rates, of positions and of angles, is one on time."""
        dofs = [axis.dof for axis in self.axes]
        scale = float(np.median([abs(axis.scale) for axis in self.axes])) if dofs else 1.0
        both = set(dofs) & set(DOFS[:3]) and set(dofs) & set(DOFS[3:])
        same = all(1.0 / SAME_SCALE < abs(a.scale) / scale < SAME_SCALE for a in self.axes)
        if not both or not same or not all(map(_off, self.axes)):
            return False
        time = as_column(self.columns.time)
        text = f"the derivative of the pose is {scale:.3g} times the velocity on every axis"
        if unit := self._unit(time, "s", scale)[0]:
            change = {"columns.time": _written(replace(time, unit=unit))}
            self._add("time", dofs, text, change, value=scale)
        else:
            self.questions += (f"{text}: which unit is {time.name} in?",)
        return True

    def _scales(self) -> None:
        """Velocities or poses in another unit; axes in the same unit are named together."""
        groups: dict[tuple[str, str, float], list[str]] = {}
        for axis in filter(_off, self.axes):
            size = abs(axis.scale)
            for kind, ratio in (("velocity", size), ("position", 1.0 / size)):
                spec = self.specs.get(f"{kind}.{axis.dof}")
                unit, value = self._unit(spec, SI[kind][axis.dof], ratio) if spec else ("", 1.0)
                if unit:
                    key = (kind, unit, value if kind == "velocity" else 1.0 / value)
                    groups.setdefault(key, []).append(axis.dof)
                    break
            else:
                if not 1.0 / UNNAMED < size < UNNAMED:
                    name = self.specs[f"velocity.{axis.dof}"].name
                    pose = "position" if axis.dof in DOFS[:3] else "attitude"
                    self.questions += (f"{name} is {1.0 / size:.2f} of d({pose})/dt: which unit?",)
        for (kind, unit, value), dofs in groups.items():
            self._add("scale", dofs, f"the derivative of the pose is {value:.3g} times the "
                      "velocity", options=[f"{kind}.{dof}" for dof in dofs], value=value,
                      unit=unit)  # fmt: skip

    def _unit(self, spec: Column, si: str, ratio: float) -> tuple[str, float]:
        """The unit that gives `ratio` times the values, and its ratio; empty if there is none."""
        now = factor(self._now(spec, si), si)
        ratios = {unit: factor(unit, si) / now for unit in UNITS[si]}
        unit = min(ratios, key=lambda unit: abs(np.log(ratio / ratios[unit])))
        near = abs(np.log(ratio / ratios[unit])) < np.log(NEAR_SCALE)
        return (unit, ratios[unit]) if near else ("", 1.0)

    def _now(self, spec: Column, si: str) -> str:
        """The unit that a column is read with."""
        named = {option: s for option, s in self.columns.columns().items() if s.name == spec.name}
        option = next((option for option in named if SI.get(option.partition(".")[0])), "time")
        if option == "time":
            return spec.unit or si
        return unit_of(self.sources, self.columns, option, spec).unit or si

    def _clock(self, result: Consistency) -> None:
        """A clock of the velocities that is apart from that of the pose."""
        lag = result.lag_s
        # A filter delays some axes, a clock that is apart all of them.
        least = max(SAMPLES_APART * result.period_s, CERTAIN * result.lag_error_s)
        if abs(lag) >= least and result.shared_lag_s != 0.0:
            text = f"the velocities are {abs(lag):.3g} s {'behind' if lag > 0.0 else 'ahead of'}"
            delay = lag + self.columns.delay_s.get("velocity", 0.0)
            change = {"columns.delay_s.velocity": float(f"{delay:.3g}")}
            self._add("clock", (), f"{text} the pose", change, value=lag)

    def _accelerations(self, result: Consistency) -> None:
        """Recorded accelerations of the wrong sign or unit."""
        for axis in (axis for axis in result.accelerations if axis.excited):
            option, si = f"acceleration.{axis.dof}", SI["acceleration"][axis.dof]
            if axis.correlation < -LEAST_TRUSTED:
                self._reverse(option)
            elif axis.correlation > LEAST_TRUSTED and _off(axis):
                unit, value = self._unit(self.specs[option], si, axis.scale)
                text = f"the derivative of the velocity is {axis.scale:.3g} times the acceleration"
                if unit:
                    self._add("scale", (axis.dof,), text, options=(option,), value=value, unit=unit)

    def _unexplained(self, result: Consistency) -> None:
        """Excited axes that agree with nothing, and are not named by another problem."""
        named = {dof for defect, _, _ in self.found for dof in defect.axes}
        if {defect.kind for defect, _, _ in self.found} & {"earth", "frame", "heading", "clock"}:
            return
        best = {axis.dof: axis.correlation for axis in result.best}
        for axis in result.velocities:
            if axis.excited and axis.dof not in named and (
                max(axis.correlation, best[axis.dof]) < LEAST_TRUSTED
            ):  # fmt: skip
                self._add("unknown", (axis.dof,), "velocity and derivative of the pose have a "
                          f"correlation of {axis.correlation:.2f}", value=axis.correlation)


def _off(axis: Agreement) -> bool:
    """Whether neither regression gives a scale near one."""
    low, high = axis.bounds
    return high < 1.0 / SAME_SCALE or low > SAME_SCALE


def _written(spec: Column) -> object:
    """A column as it is written in a map."""
    new = {f.name: getattr(spec, f.name) for f in fields(spec)}
    new = {f.name: new[f.name] for f in fields(spec) if new[f.name] != f.default}
    return new if len(new) > 1 else spec.column


def _numbers(sources: Mapping[str, Source], spec: Column) -> Array | None:
    """A column as recorded; None if the file has none."""
    try:
        source, name = column(sources, spec.name)
        return source.numbers(name, gaps=True)
    except RecordingError:
        return None
