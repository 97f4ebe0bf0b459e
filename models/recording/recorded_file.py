"""Measured recordings as excitation: files that are read by a map, checked, and cut.

Every column becomes a channel of its own times. Channels of one clock stay as they are unless a
rate is asked for; those of several clocks are joined on one grid. Then positions, attitude and
velocities are turned into our frames, the sensor is moved to the origin of the vessel, and
velocities that were not recorded are differentiated from the pose. What is left out is said.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from glob import glob, has_magic
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import scipy
from annotated_types import Ge
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.notation import DOFS, OrderedManoeuvre
from seatrial.models.ranges import NotNegative, Positive, check_ranges
from seatrial.models.recording import column_map as maps
from seatrial.models.recording import recording as recordings
from seatrial.models.recording import signals, times
from seatrial.models.recording.column_map import FAULTS, FLIPPED, MOTION, QUATERNION, ColumnMap
from seatrial.models.recording.recording import Recording, Split, half
from seatrial.models.recording.source import ReadOptions, Source, TextOptions, read_sources
from seatrial.models.recording.times import AtGap, Channel, Channels, clock_of, join_channels
from seatrial.models.vessel import kinematics
from seatrial.models.vessel.basis import Array

BRIDGED = 2.5  # sample times that joining fills at any rate
QUATERNION_ERROR = 0.05  # of the length of a quaternion: a larger one means a wrong column
COMPOSED = ("orientation", "geodetic", "ground", "water", "wind")  # of which motion is made
# Numbers that loggers write where there is none, if nothing else is near.
SENTINELS = (999.0, 9999.0, 99999.0, 999999.0, 32767.0, 32768.0, 65535.0, 1e20)
NO_FIX = {  # of AIS, and without satellites
    "geodetic.latitude": (0.0, 91.0), "geodetic.longitude": (0.0, 181.0),
    "position.yaw": (511.0,), "ground.speed": (102.3,),
}  # fmt: skip
LEAST_SAMPLES = 2  # of a window
Sources = Mapping[str, Source]
Signals = dict[str, Array]  # by option, such as velocity.surge; (N,) each
Joined = tuple[Array, Signals]  # at times (N,) [s]
Readings = dict[str, maps.ColumnReading]


@dataclass(frozen=True)
class Outliers:
    """Outliers: samples over `deviations` standard deviations from their `window` neighbours."""

    replace: bool = False
    window: Annotated[int, Ge(4)] = 10
    deviations: Positive = 3.0

    def __post_init__(self) -> None:
        check_ranges(self)


class ReadSignals(NamedTuple):
    """Signals on one clock, in SI units and our frames."""

    t: Array  # (N,) [s]
    values: Signals
    readings: tuple[maps.ColumnReading, ...]
    left_out: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class FileForm:
    """Columns and format of some of several files."""

    columns: ColumnMap
    format: str | None = None
    text: TextOptions = field(default_factory=TextOptions)


def matched(patterns: Sequence[str]) -> list[Path]:
    """The files that patterns such as `runs/*.csv` match, each pattern's in order of their names.

    Raises ConfigurationError if a pattern matches nothing.
    """
    every = dict[Path, None]()
    for pattern in patterns:
        wanted = str(Path(pattern).expanduser())
        # Path.glob takes no absolute patterns.
        files = glob(wanted, recursive=True) if has_magic(wanted) else [wanted]  # noqa: PTH207
        if not files:
            got = f"got {pattern}, which matches no file"
            raise ConfigurationError(f"excitation: {got}, expected recordings")
        every |= dict.fromkeys(map(Path, sorted(files)))
    return [*every]


@dataclass(frozen=True, kw_only=True)
class RecordedFile(FileForm):
    """A measured file as excitation, which is read, checked and cut instead of simulated.

    The samples strictly between `start_s` and `end_s` are used (null: all). The first
    `train_fraction` of them are for training, or the trips `training_trips` (counted from 1) if
    `trip_starts_s` is set. `train` and `test` name several files instead, which are read one by
    one; without `test`, `train_fraction` splits each of them. The first `initial_s` of a file are
    not tested on. The files of `test` may have columns of their own, `tested`.
    """

    resample_hz: Positive | None = None  # None: as recorded, else the rate of the slowest state
    max_gap_s: Positive = 1.0
    at_gap: AtGap = "refuse"
    heading_deg: float = 0.0  # of the frame of the positions in that of the attitude
    outliers: Outliers = field(default_factory=Outliers)
    path: str | None = None
    start_s: float | None = None
    end_s: float | None = None
    train_fraction: float = 0.5
    trip_starts_s: tuple[float, ...] = ()
    training_trips: tuple[int, ...] = ()
    train: tuple[str, ...] = ()
    test: tuple[str, ...] = ()
    initial_s: NotNegative = 0.0
    tested: FileForm | None = None  # of the files of `test`, if it is another one
    messages: tuple[str, ...] = ()  # files of message definitions, for bags without them
    trust: bool = False  # also what does not agree
    manoeuvre: OrderedManoeuvre = field(default_factory=OrderedManoeuvre)
    map: str | None = None  # file of the columns; its content is in the other options
    test_map: str | None = None  # that of the files of `test`; its content is in `tested`
    _read: dict[Any, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_ranges(self)
        start, end = self.start_s, self.end_s
        problems = {
            "excitation.path: expected null beside train": self.path and (self.train or self.test),
            "excitation.test requires excitation.train, got none": self.test and not self.train,
            "excitation.test_map requires excitation.test": self.tested and not self.test,
            "trip_starts_s is of one file, got excitation.train": self.train and self.trip_starts_s,
            "excitation.path: expected a recording, got none": not self.path and not self.train,
            f"start_s must lie before end_s = {end or 0.0:g}, got {start or 0.0:g}":
                start is not None and end is not None and start >= end,
            "training_trips requires trip_starts_s": self.training_trips and not self.trip_starts_s,
        }  # fmt: skip
        if problem := next((text for text, there in problems.items() if there), None):
            raise ConfigurationError(problem)
        half(2, self.train_fraction)
        if self.trip_starts_s:
            self.split(np.array(self.trip_starts_s))  # refuses wrong trips

    @cached_property
    def _own(self) -> dict[str, Path]:
        """The files of the recording by their options: `path`, or `train[0]` and so on."""
        if not self.train:
            return {"path": Path(self.path or "").expanduser()}
        train, test = matched(self.train), matched(self.test)
        if both := set(train) & set(test):
            got = f"got {min(both)}, which excitation.train has too"
            raise ConfigurationError(f"excitation.test: {got}, expected each file once")
        return {f"{option}[{i}]": path for option, files in (("train", train), ("test", test))
                for i, path in enumerate(files)}  # fmt: skip

    @cached_property
    def readers(self) -> dict[Path, "RecordedFile"]:
        """The files of the recording, each with what reads it: those of `test` as `tested`."""
        tested = replace(self, **vars(self.tested)) if self.tested else self
        return {path: tested if option.startswith("test") else self
                for option, path in self._own.items()}  # fmt: skip

    def files(self) -> dict[str, Path]:
        """The files that are read, by option."""
        messages = {f"messages[{i}]": path for i, path in enumerate(self.messages)}
        others = {"map": self.map, "test_map": self.test_map} | messages
        return self._own | {name: Path(path).expanduser() for name, path in others.items() if path}

    def sources(self, path: Path | None = None) -> dict[str, Source]:
        """The columns of a file as recorded, of the first one by default."""
        options = ReadOptions(self.format, self.text, self.messages)
        return read_sources(path or next(iter(self.readers)), options)

    def check(self, dofs: Sequence[str]) -> None:
        """Raise ConfigurationError if a column for the vessel is not mapped; does not read it."""
        self.columns.check(dofs)
        if self.tested is not None:
            self.tested.columns.check(dofs)

    def read(self, dofs: Sequence[str]) -> Recording:
        """The recording of a vessel with these degrees of freedom.

        Raises RecordingError, which names file, line and column.
        """
        self.check(dofs)
        return self.recording(dofs)

    def account(self, dofs: Sequence[str], sources: Sources | None = None) -> list[ReadSignals]:
        """How each file is read, once; `sources` are the columns of one file, if not its own."""
        read: list[ReadSignals] = self._read.setdefault(tuple(dofs), [])
        for path, reader in [*self.readers.items()][len(read) :]:
            read.append(reader.signals(path, sources or reader.sources(path), dofs))
        return read

    def recording(self, dofs: Sequence[str], sources: Sources | None = None) -> Recording:
        """The recording of all files, each read alone, end to end with gaps in time between them.

        Nothing is differentiated or filtered over a joint. `sources` is as in `account`; nothing
        needs to act on the vessel.
        """
        read = zip(self.readers.items(), self.account(dofs, sources), strict=True)
        parts = [reader._cut(path, own, dofs) for (path, reader), own in read]
        if not self.train:
            return parts[0]
        depths = range(1, 1 + max(len(path.parts) for path in self.readers))
        every = (tuple("/".join(p.parts[-depth:]) for p in self.readers) for depth in depths)
        names = next(names for names in every if len(set(names)) == len(names))  # tell them apart
        parts = [replace(part, file=np.full(len(part), number), file_names=names)
                 for number, part in enumerate(parts)]  # fmt: skip
        return recordings.end_to_end(parts)

    def signals(self, path: Path, sources: Sources, dofs: Sequence[str]) -> ReadSignals:
        """The signals that are mapped for a vessel with some degrees of freedom, on one clock.

        Raises RecordingError, which names the file `path`, if a column of `sources` is missing, a
        cell is no number, or channels cannot be joined; ConfigurationError if a unit is not known.
        """
        notes = [line for source in sources.values() for line in source.left_out]
        try:
            read = maps.readings(sources, self.columns, maps.wanted(self.columns, dofs))
            channels = self._channels(sources, read, notes)
            rule = self.outliers
            for option, channel in channels.items() if rule.replace else ():
                valid, values = ~np.isnan(channel.values), channel.values.copy()
                wrong = signals.outliers(values[valid], rule.window, rule.deviations)
                values[valid] = signals.interpolated(channel.t[valid], values[valid], wrong)
                channels[option] = channel._replace(values=values)
                told = f"column {read[option].name}: {np.sum(wrong)} outliers are replaced"
                notes += [told] if np.any(wrong) else []
            t, known = self._on_one_clock(channels, read, notes)
            known = _in_our_frames(t, known, self.columns, np.radians(self.heading_deg))
        except RecordingError as error:
            named = str(path) in str(error)
            raise error if named else RecordingError(f"{path}: {error}") from error
        return ReadSignals(t, known, tuple(read.values()), tuple(maps.together(notes)))

    def _channels(self, sources: Sources, read: Readings, notes: list[str]) -> Channels:
        """The columns in SI units on their clocks, by option."""
        if not read:
            raise ConfigurationError("excitation.columns: got none for the vessel, expected some")
        used = {reading.source.name: reading.source for reading in read.values()}.values()
        notes += filter(None, (times.disagreement(s, clock_of(s, self.columns)) for s in used))
        times_of, channels = clocks(sources, self.columns), Channels()
        for option, reading in read.items():
            spec, delays = self.columns.specs[option], self.columns.delay_s
            kind, name, values = option.partition(".")[0], reading.source.name, reading.values
            t = times_of[name] - delays.get(name, delays.get(kind, 0.0))
            missing = {sign * size: 0.5 * size for size in SENTINELS for sign in (1.0, -1.0)}
            missing |= dict.fromkeys(NO_FIX.get(option, ()), 0.5)
            for size, near in missing.items():  # where nothing else is near
                wrong = values == size
                if np.any(wrong) and not np.any(np.abs(values[~wrong] - size) < near):
                    cells = f"{np.count_nonzero(wrong)} cells are {size:g}"
                    notes.append(f"column {reading.name}: {cells}: missing values")
                    values = np.where(wrong, np.nan, values)
            if spec.full is not None:
                values = (values - spec.neutral) / (spec.full - spec.neutral)
            values = values * spec.sign * maps.si_factor(option, reading.unit)
            if maps.targets_of(option) == ("rad",):  # without jumps
                valid = ~np.isnan(values)
                values[valid] = kinematics.unroll(values[valid])
                values = -values if spec.positive == "anticlockwise" else values
                values = values + 0.5 * np.pi if spec.zero == "east" else values
            held = kind in ("force", "commands")  # until the next sample
            channels[option] = Channel(t, values, held, f"column {spec.name}")
        if (parts := {f"orientation.{part}" for part in QUATERNION}) <= channels.keys():
            quaternions = np.column_stack([channels[name].values for name in sorted(parts)])
            lengths = np.linalg.norm(quaternions, axis=1)
            if len(wrong := np.flatnonzero(np.abs(lengths - 1.0) > QUATERNION_ERROR)):
                got = f"got a quaternion of length {lengths[wrong[0]]:.3g}, expected 1"
                raise RecordingError(f"columns.orientation, sample {wrong[0] + 1}: {got}")
            quaternions /= lengths[:, None]  # all four are NaN where one is
            valid = ~np.isnan(lengths)
            quaternions[valid] = signals.without_sign_flips(quaternions[valid])
            for name, part in zip(sorted(parts), quaternions.T, strict=True):
                channels[name] = channels[name]._replace(values=part)
        return channels

    def _on_one_clock(self, channels: Channels, read: Readings, notes: list[str]) -> Joined:
        """The times (N,) of all channels, and their values then: joined unless they share a clock.

        Without `resample_hz` the rate is that of the slowest velocity, or position, rounded.
        Channels of one source stay as they are if they are complete and rise by equal steps, longer
        ones at gaps with `split`; `refuse` raises RecordingError for others, with line and column.
        """
        t, source = next(iter(channels.values())).t, next(iter(read.values())).source
        rate, longest, split = self.resample_hz, self.max_gap_s, self.at_gap == "split"
        known = {option: channel.values for option, channel in channels.items()}
        apart = len({reading.source.name for reading in read.values()}) > 1 or len(t) < 2
        if not (apart := apart or rate is not None or bool(self.columns.delay_s)):
            period = float(np.nanmedian(np.diff(t)))
            even = np.abs(np.diff(t) - period) < recordings.UNIFORMITY * period
            even |= split & (np.diff(t) > signals.GAP * period)
            faults = [(np.isnan(x), read[o].name, "a finite number") for o, x in known.items()]
            rising = f"time to increase by equal steps, here {period:.6g} s"
            clock = clock_of(source, self.columns).name
            faults.append((np.append(np.isnan(t[0]), ~even), clock, rising))
            for wrong, name, expected in faults:
                if np.any(wrong) and not split:
                    grid = "excitation.resample_hz=RATE puts the columns on a uniform grid"
                    raise source.refused(int(np.argmax(wrong)), name, f"{expected}; {grid}")
                apart |= bool(np.any(wrong))
        if apart:
            channels = {option: c.cleaned(notes) for option, c in channels.items()}
            if rate is None:
                pose = ("position", "geodetic", "orientation")
                every = ([c.t for o, c in channels.items() if o.startswith(kinds) and len(c.t) > 1]
                         for kinds in ("velocity", pose, ""))  # fmt: skip
                slowest = max((np.median(np.diff(x)) for x in next(filter(None, every), ())),
                              default=1.0)  # fmt: skip
                rate = float(f"{1.0 / slowest:.2g}")
                longest = max(longest, BRIDGED / rate)
            t, known = join_channels(channels, rate, longest, self.at_gap)
        whole = min(float(c.t[-1]) for c in channels.values())
        whole -= max(float(c.t[0]) for c in channels.values())
        period = float(np.median(np.diff(t)))
        lost, pieces = whole - len(t) * period, len(recordings.piece_edges(t, period)) - 1
        if pieces > 1 or lost >= 2.0 * period:
            told = f"{lost:.3g} of {whole:.4g} s are in gaps: left out"
            notes.append(f"{told}, {pieces} pieces remain")
        return t, known

    def _cut(self, path: Path, read: ReadSignals, dofs: Sequence[str]) -> Recording:
        """The recording of one file in its window, with what is missing derived from the rest.

        These are accelerations, positions that are not needed (the way made good), and angles (0).
        """
        t, known = read.t, read.values

        def stack(kind: str, names: Sequence[str]) -> Array:
            return np.column_stack([known[f"{kind}.{name}"] for name in names])

        if missing := [dof for dof in dofs if f"velocity.{dof}" not in known]:
            text = f"no column for {', '.join(missing)}, nor a position to differentiate"
            raise ConfigurationError(f"excitation.columns.velocity: {text}")
        start = -np.inf if self.start_s is None else self.start_s
        end = np.inf if self.end_s is None else self.end_s
        rows = (start < t) & (t < end)
        if (count := np.count_nonzero(rows)) < LEAST_SAMPLES:
            got = f"{path}: got {count} samples with {start:g} < t < {end:g} s, expected at least 2"
            raise RecordingError(f"{got}; the file holds {t[0]:g} to {t[-1]:g} s")
        period, nu = recordings.sample_time(t), stack("velocity", dofs)
        edges = recordings.piece_edges(t, period)
        nu_dot = recordings.piecewise(lambda x: signals.central_difference(x, period), edges, nu)
        level = dict.fromkeys((f"position.{dof}" for dof in DOFS[3:]), 0.0 * t)
        rates = {f"acceleration.{d}": x for d, x in zip(dofs, nu_dot.T, strict=True)}
        t, nu, known = t[rows], nu[rows], {o: x[rows] for o, x in (level | rates | known).items()}
        psi = known["position.yaw"]
        known["position.yaw"] = psi + (kinematics.wrap(psi[0]) - psi[0])
        way = scipy.integrate.cumulative_trapezoid(nu, t, axis=0, initial=0.0)
        known = {f"position.{dof}": x for dof, x in zip(dofs, way.T, strict=True)} | known
        inputs, loads = tuple(self.columns.inputs), tuple(self.columns.loads)
        commands = tuple(self.columns.commands)
        measured: dict[str, Any] = {"tau": np.zeros_like(nu)} | {
            field: stack(kind, names) for field, kind, names in (
                ("tau", "force", dofs), ("tau_actual", "actual_force", dofs),
                ("wind", "air", DOFS[:2]), ("inputs", "inputs", inputs),
                ("commands", "commands", commands), ("loads", "loads", loads))
            if names and all(f"{kind}.{name}" in known for name in names)
        }  # fmt: skip
        return Recording(
            tuple(dofs), t, stack("position", dofs), nu, stack("acceleration", dofs),
            attitude=stack("position", DOFS[3:]), input_names=inputs, load_names=loads,
            **measured,
        )  # fmt: skip

    def split(self, t: Array, file: NDArray[np.int64] | None = None) -> Split:
        """Training and test samples of the recording that `read` returns.

        Its times are t (N,) [s], `file` (N,) the number of the file of each sample, of several. A
        file is not tested on in its first `initial_s` [s]: a free run starts from what is measured
        then. A trip lasts until the next one; samples before the first are in neither set. Jervan
        (2020), section 5.3, trains on trips 1 and 3. Raises ConfigurationError if too little is
        left for one of them.
        """
        if self.trip_starts_s:
            trip = np.searchsorted(self.trip_starts_s, t, side="right")
            train = np.isin(trip, self.training_trips) & (trip > 0)
            test = ~train & (trip > 0)
            if np.any(np.diff(self.trip_starts_s) <= 0.0) or not (np.any(train) and np.any(test)):
                got = f"got {list(self.training_trips)} of trips at {list(self.trip_starts_s)}"
                expected = "expected some for training, some for testing, at increasing times"
                raise ConfigurationError(f"training_trips: {got} s, {expected}")
            return Split(train, test)
        if file is None:
            return half(len(t), self.train_fraction)
        train, test = np.zeros((2, len(t)), dtype=np.bool_)
        for number, (option, path) in enumerate(self._own.items()):
            rows = np.flatnonzero(file == number)
            tested = not self.test or option.startswith("test")
            own = half(len(rows), self.train_fraction)
            train[rows] = not tested if self.test else own.train
            late = t[rows] >= t[rows[0]] + self.initial_s
            test[rows] = late & (tested if self.test else own.test)
            if tested and (left := np.count_nonzero(test[rows])) < LEAST_SAMPLES:
                got = f"got {self.initial_s:g} s, which leaves {left} samples for testing of {path}"
                length = f"{np.ptp(t[rows]):g} s long; expected at least {LEAST_SAMPLES}"
                raise ConfigurationError(f"excitation.initial_s: {got}, {length}")
        return Split(train, test)


def clocks(sources: Sources, columns: ColumnMap) -> dict[str, Array]:
    """The times [s] of the rows of each source that has some, (N,), less the first date of any.

    They do not depend on the vessel; of dates only differences matter.
    """
    known, firsts = dict[str, Array](), [np.inf]
    for source in sources.values():
        with suppress(*FAULTS, ValueError):
            known[source.name] = times.seconds(source, clock_of(source, columns))
            firsts.append(float(np.nanmin(known[source.name])))
    start = min(firsts)
    return {name: t - start if times.EPOCH_S < start < np.inf else t for name, t in known.items()}


def _in_our_frames(t: Array, known: Signals, columns: ColumnMap, heading: float) -> Signals:
    """Signals by option in NED and forward, right, down axes at the origin of the vessel.

    `heading` [rad] is that of the frame of the positions in the frame of the attitude.
    """
    frames, absent = columns.frames, np.full(len(t), np.nan)
    pose, nu = (np.column_stack([known.get(f"{kind}.{dof}", absent) for dof in DOFS])
                for kind in MOTION)  # fmt: skip
    if "orientation.w" in known:
        parts = [known[f"orientation.{part}"] for part in QUATERNION]
        pose[:, 3:] = kinematics.euler_zyx(np.column_stack(parts))
    if frames.attitude == "ENU":
        pose[:, 3:] = pose[:, 3:] * [1.0, -1.0, -1.0] + [0.0, 0.0, 0.5 * np.pi]
    if columns.geodetic:  # from the first sample, on WGS 84
        import pymap3d  # slow to import

        way = [known.get(f"geodetic.{name}", 0.0 * t) for name in maps.SI["geodetic"]]
        if np.max(np.abs(way[0])) > 90.0 or np.max(np.abs(way[1])) > 360.0:
            got = f"got {way[0][0]:g}, {way[1][0]:g}, expected degrees"
            raise RecordingError(f"columns.geodetic: {got}")
        ned = np.column_stack(pymap3d.geodetic2ned(*way, *(x[0] for x in way)))
        pose[:, : len(columns.geodetic)] = ned[:, : len(columns.geodetic)]
    elif frames.position == "ENU":
        pose[:, :3] = pose[:, [1, 0, 2]] * [1.0, 1.0, -1.0]
    if frames.velocity == "earth" and frames.position == "ENU":
        nu[:, :3] = nu[:, [1, 0, 2]] * [1.0, 1.0, -1.0]
    posed, moving = ~np.isnan(pose[0]), ~np.isnan(nu[0])
    pose[:, ~posed], nu[:, ~moving] = 0.0, 0.0
    pose[:, 5] -= heading * posed[5]
    attitude = pose[:, 3:] = kinematics.unroll(pose[:, 3:])
    if frames.velocity == "earth":  # angular velocities are of the body
        if moving[0] != moving[1]:
            got = "got one of surge and sway along the axes of the earth, expected both"
            raise RecordingError(f"columns.velocity: {got}")
        nu[:, :3] = signals.in_body(attitude, nu[:, :3])
    elif frames.body == "FLU":
        nu[:, [DOFS.index(dof) for dof in FLIPPED]] *= -1.0
    if "ground.speed" in known:
        angle, speed = known["ground.course"] - attitude[:, 2], known["ground.speed"]
        nu[:, :2], moving[:2] = (speed * [np.cos(angle), np.sin(angle)]).T, True
    if np.any(lacking := posed & ~moving):
        nu[:, lacking] = _differentiated(t, pose)[:, lacking]
    if any(columns.lever_arm_m):  # p_o = p_s - R r, v_o = v_s - omega x r
        arm = np.array(columns.lever_arm_m)
        nu[:, :3] -= np.cross(nu[:, 3:], arm)
        pose[:, :3] -= kinematics.pose_jacobian(attitude)[:, :3, :3] @ arm
    result = {o: x for o, x in known.items() if o.partition(".")[0] not in (*MOTION, *COMPOSED)}
    for kind, values, there in zip(MOTION, (pose, nu), (posed, posed | moving), strict=True):
        result |= {f"{kind}.{DOFS[i]}": values[:, i] for i in np.flatnonzero(there)}
    if "wind.speed" in known:
        apparent = (columns.wind or {}).get("kind") == "apparent"
        angle = known["wind.direction"] - (0.0 if apparent else attitude[:, 2])
        air = -known["wind.speed"] * [np.cos(angle), np.sin(angle)] + apparent * nu[:, :2].T
        result |= {"air.surge": air[0], "air.sway": air[1]}
    if "water.speed" in known and {"velocity.surge", "velocity.sway"} <= result.keys():
        # The log shows the speed along the bow: what is left of that over ground is the current.
        along = np.column_stack([nu[:, 0] - known["water.speed"], nu[:, 1]])
        result["current.north"], result["current.east"] = kinematics.in_ned(along, attitude[:, 2]).T
    return result


def _differentiated(t: Array, pose: Array) -> Array:
    """Body velocities (N, 6) from the pose (N, 6) in NED, piece by piece.

    The position and each angle are low-passed forward and backward where their density first
    reaches four times its noise floor, so that the derivative holds motion and not the noise.
    Angular velocities are those of the rotation, not of its Euler angles.
    """
    period = float(np.median(np.diff(t)))
    starts = recordings.piece_starts(t, period)
    groups = {columns: signals.noise_floor(pose[:, columns], starts, period).cutoff_hz
              for columns in ((0, 1, 2), (3,), (4,), (5,))}  # fmt: skip

    def rates(pose: Array) -> Array:
        if len(pose) < 2:
            return np.zeros_like(pose)
        rate = np.gradient(pose, period, axis=0)
        rate[:, 3:] = kinematics.body_rates(pose[:, 3:], period)
        for columns, cutoff in groups.items():
            if cutoff is not None and cutoff < 0.45 / period and len(pose) > recordings.MIN_PIECE:
                rate[:, columns] = signals.lowpass(rate[:, columns], cutoff, period)
        return rate

    nu = recordings.piecewise(rates, recordings.piece_edges(t, period), pose)
    nu[:, :3] = signals.in_body(pose[:, 3:], nu[:, :3])
    return nu
