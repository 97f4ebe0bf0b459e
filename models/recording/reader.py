"""From columns of any unit, sense, frame and clock to signals in SI units, NED and body axes.

Every column becomes a channel of its own times. Channels of one clock stay as they are unless a
rate is asked for; those of several clocks are joined on one grid. Then positions, attitude and
velocities are turned into our frames, the sensor is moved to the origin of the vessel, and
velocities that were not recorded are differentiated from the pose. What is left out is said.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

import numpy as np
from annotated_types import Ge

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.notation import DOFS, PLANAR
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.recording import column_map as units
from seatrial.models.recording import recording as recordings
from seatrial.models.recording import signals
from seatrial.models.recording.column_map import KINDS, QUATERNION, Column, ColumnMap, Frames
from seatrial.models.recording.signals import GAP, lowpass, noise_floor
from seatrial.models.recording.source import Source, column
from seatrial.models.recording.times import EPOCH_S, disagreement, find_time, is_later, seconds
from seatrial.models.vessel import kinematics
from seatrial.models.vessel.basis import Array

if TYPE_CHECKING:
    import pymap3d
else:
    import lazy_loader

    pymap3d = lazy_loader.load("pymap3d")

FAULTS = (ConfigurationError, RecordingError)
HELD_SIGNALS = ("force", "commands")  # constant until the next sample
IN_THE_PLANE = ("wind", "air", "ground", "water")  # kinds without a meaning in other axes
BRIDGED = 2.5  # sample times that joining fills at any rate
SI_ASSUMED = "no unit is stated: SI"
QUATERNION_ERROR = 0.05  # of the length of a quaternion: a larger one means a wrong column
MOTION, COMPOSED = ("position", "velocity"), ("orientation", "geodetic", "ground", "water", "wind")
FLIPPED = ("sway", "heave", "pitch", "yaw")  # of forward, left, up axes
# Numbers that loggers write where there is none, if nothing else is near.
SENTINELS = (999.0, 9999.0, 99999.0, 999999.0, 32767.0, 32768.0, 65535.0, 1e20)
NO_FIX = {  # of AIS, and without satellites
    "geodetic.latitude": (0.0, 91.0), "geodetic.longitude": (0.0, 181.0),
    "position.yaw": (511.0,), "ground.speed": (102.3,),
}  # fmt: skip
MOST_SAMPLES = 100  # on the grid, for each sample of the channel with the most
MIN_STRETCH = 3  # samples of a stretch: a derivative of second order needs as many
TIME_ROUNDING = 1e-6  # of a sample time
AtGap = Literal["refuse", "split"]
Sources = Mapping[str, Source]
Signals = dict[str, Array]  # by option, such as velocity.surge; (N,) each
Joined = tuple[Array, Signals]  # at times (N,) [s]


@dataclass(frozen=True)
class Outliers:
    """Outliers: samples over `deviations` standard deviations from their `window` neighbours."""

    replace: bool = False
    window: Annotated[int, Ge(4)] = 10
    deviations: Positive = 3.0

    def __post_init__(self) -> None:
        check_ranges(self)


class ColumnReading(NamedTuple):
    """With which unit and sign a column was read, where they are known from, and its source."""

    option: str
    column: str  # as the map has it
    unit: str
    known_from: str
    source: Source
    name: str  # in the source

    @property
    def values(self) -> Array:
        """The numbers of the column as recorded, shape (N,); NaN where missing."""
        return self.source.numbers(self.name, gaps=True)


class ReadSignals(NamedTuple):
    """Signals on one clock, in SI units and our frames."""

    t: Array  # (N,) [s]
    values: Signals
    readings: tuple[ColumnReading, ...]
    left_out: tuple[str, ...]


class Channel(NamedTuple):
    """A signal on its own clock: a state is interpolated, a command held until the next."""

    t: Array  # (N,) [s], increasing
    values: Array  # (N,)
    held: bool = False
    name: str = ""  # for messages

    def gaps(self, t: Array, longest_s: float) -> Array:
        """The time [s] without a sample at times t (n,), where longer than `longest_s`; else 0."""
        before = np.searchsorted(self.t, t, side="right") - 1  # the same as after on a sample
        after = np.minimum(np.searchsorted(self.t, t), len(self.t) - 1)
        length = (t if self.held else self.t[after]) - self.t[before]
        return np.asarray(np.where(length > longest_s * (1.0 + TIME_ROUNDING), length, 0.0))

    def at(self, t: Array, rate_hz: float) -> Array:
        """The values at times t (n,)."""
        if not self.held:
            return np.interp(t, self.t, self.values)
        now = np.searchsorted(self.t, t + TIME_ROUNDING / rate_hz, side="right") - 1
        return np.asarray(self.values[now])

    def cleaned(self, notes: list[str]) -> "Channel":
        """Without missing values, and samples that are not later than all before; `notes` tell."""
        timeless = np.isnan(self.t)
        if np.any(timeless):
            notes.append(f"{np.sum(timeless)} rows have no time: left out")
        valid = ~(np.isnan(self.values) | timeless)
        t, values = self.t[valid], self.values[valid]
        if not np.all(later := is_later(t)):
            back, same = np.sum(np.diff(t) < 0.0), np.sum(np.diff(t) == 0.0)
            text = f"not later than the one before ({same} times repeat, {back} go back): left out"
            notes.append(f"{self.name}: {np.sum(~later)} samples are {text}")
        return self._replace(t=t[later], values=values[later])


Channels = dict[str, Channel]  # by option
Readings = dict[str, ColumnReading]


@dataclass(frozen=True, kw_only=True)
class Reading:
    """How the columns of a recording are read: the map, the clock, and what is cleaned."""

    columns: ColumnMap
    resample_hz: Positive | None = None  # None: as recorded, else the rate of the slowest state
    max_gap_s: Positive = 1.0
    at_gap: AtGap = "refuse"
    heading_deg: float = 0.0  # of the frame of the positions in that of the attitude
    outliers: Outliers = field(default_factory=Outliers)

    def signals(self, path: Path, sources: Sources, dofs: Sequence[str]) -> ReadSignals:
        """The signals that are mapped for a vessel with some degrees of freedom, on one clock.

        Raises RecordingError, which names the file `path`, if a column of `sources` is missing, a
        cell is no number, or channels cannot be joined; ConfigurationError if a unit is not known.
        """
        notes = [line for source in sources.values() for line in source.left_out]
        try:
            read = readings(sources, self.columns, wanted(self.columns, dofs))
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
        groups = defaultdict[str, list[str]](list)  # the columns of each note
        for note in dict.fromkeys(notes):
            name, _, text = note.partition(": ") if note.startswith("column ") else ("", "", note)
            groups[text] += [name.removeprefix("column ")] if name else []
        left_out = []
        for text, names in groups.items():
            columns = shorten(", ".join(names), 300, placeholder=" ...")
            left_out.append(f"column{'s' * (len(names) > 1)} {columns}: {text}" if names else text)
        return ReadSignals(t, known, tuple(read.values()), tuple(left_out))

    def _channels(self, sources: Sources, read: Readings, notes: list[str]) -> Channels:
        """The columns in SI units on their clocks, by option."""
        if not read:
            raise ConfigurationError("excitation.columns: got none for the vessel, expected some")
        for source in {reading.source.name: reading.source for reading in read.values()}.values():
            line = disagreement(source, clock_of(source, self.columns))
            notes += [line] if line else []
        times, firsts, channels = dict[str, Array](), [np.inf], Channels()
        for source in sources.values():  # of all, so that the start does not depend on the vessel
            with suppress(*FAULTS, ValueError):
                times[source.name] = seconds(source, clock_of(source, self.columns))
                firsts.append(float(np.nanmin(times[source.name])))
        start = min(firsts) if EPOCH_S < min(firsts) < np.inf else 0.0  # the first of any date
        for option, reading in read.items():
            spec, delays = self.columns.specs[option], self.columns.delay_s
            kind, name, values = option.partition(".")[0], reading.source.name, reading.values
            t = times[name] - start - delays.get(name, delays.get(kind, 0.0))
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
            values = values * spec.sign * units.si_factor(option, reading.unit)
            if units.targets_of(option) == ("rad",):  # without jumps
                valid = ~np.isnan(values)
                values[valid] = kinematics.unroll(values[valid])
                values = -values if spec.positive == "anticlockwise" else values
                values = values + 0.5 * np.pi if spec.zero == "east" else values
            channels[option] = Channel(t, values, kind in HELD_SIGNALS, f"column {spec.name}")
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
        """
        t, rate, longest = None, self.resample_hz, self.max_gap_s
        known = {option: channel.values for option, channel in channels.items()}
        alone = len({reading.source.name for reading in read.values()}) == 1
        if alone and rate is None and not self.columns.delay_s:
            t = self._shared_clock(channels, read)
        if t is None:
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

    def _shared_clock(self, channels: Channels, read: Readings) -> Array | None:
        """The times (N,) [s] of channels of one source, complete and rising by equal steps.

        `split` allows longer steps at gaps, and gives None for others, as channels can be joined;
        `refuse` raises RecordingError, with line and column.
        """
        t, source = next(iter(channels.values())).t, next(iter(read.values())).source
        if len(t) < 2:
            return None
        steps, split = np.diff(t), self.at_gap == "split"
        period = float(np.nanmedian(steps))
        even = np.abs(steps - period) < recordings.UNIFORMITY * period
        uneven = np.append(np.isnan(t[0]), ~(even | (split & (steps > GAP * period))))
        gaps = ((np.isnan(c.values), read[o].name, "a finite number") for o, c in channels.items())
        rising = f"time to increase by equal steps, here {period:.6g} s"
        for wrong, name, expected in (*gaps, (uneven, clock_of(source, self.columns).name, rising)):
            if np.any(wrong) and split:
                return None
            if np.any(wrong):
                grid = "excitation.resample_hz=RATE puts the columns on a uniform grid"
                raise source.refused(int(np.argmax(wrong)), name, f"{expected}; {grid}")
        return t


def join_channels(
    channels: Channels, rate_hz: float, max_gap_s: float, at_gap: AtGap = "refuse"
) -> Joined:
    """Interpolate states linearly, and hold commands, on one uniform grid of times (n,) [s].

    The grid starts where the last channel starts and ends where the first one ends. A time longer
    than `max_gap_s` [s] without a sample of one of the channels is a gap: `refuse` raises
    RecordingError, `split` leaves it out of the grid. The channels have no missing values, and
    angles are unrolled. There is no anti-aliasing filter.
    """
    if short := next((c for c in channels.values() if len(c.t) < 2), None):
        raise RecordingError(f"{short.name}: got {len(short.t)} samples, expected at least 2")
    start, last = max((float(c.t[0]), c.name) for c in channels.values())
    end, first = min((float(c.t[-1]) + max_gap_s * c.held, c.name) for c in channels.values())
    stop = min(end, max(float(c.t[-1]) for c in channels.values()))
    count = int(np.floor((stop - start) * rate_hz * (1.0 + 1e-12) + 1e-9)) + 1
    if count > MOST_SAMPLES * (most := max(len(channel.t) for channel in channels.values())):
        got = f"got {count:.3g} samples from the {most} recorded, at resample_hz={rate_hz:g}"
        raise RecordingError(f"{got}; expected at most {MOST_SAMPLES} times as many")
    rows = np.arange(count)  # of the grid, without those in gaps of the channels before
    for channel in channels.values():
        t = start + rows / rate_hz
        gaps = channel.gaps(t, max_gap_s)
        if at_gap == "refuse" and np.any(gaps):
            k = int(np.argmax(gaps > 0.0))
            before = channel.t[channel.t <= t[k]][-1]
            got = f"got no sample for {gaps[k]:.6g} s after {before:.6g} s"
            expected = f"expected at most {max_gap_s:g} s; excitation.at_gap=split leaves gaps out"
            raise RecordingError(f"{channel.name}: {got}, {expected}")
        rows = rows[gaps == 0.0]
    stretches = np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1)
    rows = np.concatenate([part if len(part) >= MIN_STRETCH else part[:0] for part in stretches])
    if not len(rows):
        got = (
            f"{last} begins at {start:g} s, {first} ends at {stop:g} s, gaps exceed {max_gap_s:g} s"
        )
        text = f"got no {MIN_STRETCH} samples at {rate_hz:g} Hz that all columns cover"
        raise RecordingError(f"{text}: {got}")
    t = start + rows / rate_hz
    return t, {key: channel.at(t, rate_hz) for key, channel in channels.items()}


def wanted(columns: ColumnMap, dofs: Sequence[str]) -> dict[str, bool]:
    """The options whose columns a vessel with some degrees of freedom uses, and if it needs them.

    The attitude is used where it is recorded, also by a vessel that does not turn.
    """
    arm, angles, used = any(columns.lever_arm_m), DOFS[3:], dict[str, bool]()
    turned = columns.frames != Frames() or arm or bool(columns.geodetic or columns.ground)
    turned = turned or not set(dofs) <= set(columns.moving)
    for option in columns.specs:
        kind, _, dof = option.partition(".")
        angle, posed = dof in angles, kind == "position"
        if kind in KINDS:
            needed = dof in dofs or (turned and not angle and kind in MOTION)
            needed |= arm and angle and kind == "velocity"
            replaced = posed and (columns.orientation if angle else columns.geodetic)
            if (needed or (angle and posed)) and not replaced:
                used[option] = needed
        elif kind not in IN_THE_PLANE or set(PLANAR) <= set(dofs):
            used[option] = kind != "orientation" or turned or bool(set(angles) & set(dofs))
    return used


def clock_of(source: Source, columns: ColumnMap) -> Column:
    """The time of a source: that of the map, which may be named `source:column`, or its own."""
    time = columns.clock
    for name in (time.name, time.name.rpartition(":")[2]):
        if source.find(name) is not None:
            return replace(time, column=name)
    known = find_time(source)
    return known or replace(time, column=column({source.name: source}, time.name)[1])  # raises


def readings(
    sources: Sources, columns: ColumnMap, used: Mapping[str, bool] | None = None
) -> Readings:
    """How each mapped column is read, by option; the first that tells its unit counts.

    `used` are the options that are read, and whether each is needed; None: those that are there.
    Raises RecordingError if a needed column does not exist.
    """
    result = {}
    used = dict.fromkeys(columns.specs, False) if used is None else used
    for option, needed in used.items():
        spec, targets = columns.specs[option], units.targets_of(option)
        kind = option.partition(".")[0]
        try:
            source, name = column(sources, spec.name)
        except RecordingError:
            if needed:
                raise
            continue
        unit, origin = spec.unit or "", "the map"
        if spec.unit is None and spec.full is None and targets:
            unit, origin = (targets[0] if len(targets) == 1 else ""), SI_ASSUMED
            beside = [  # columns of the same quantity, in the same source
                other.name for o, other in columns.specs.items()
                if kind in KINDS and o.startswith(f"{kind}.") and units.targets_of(o) == targets
            ]  # fmt: skip
            for title in (None, *beside):
                plain = source.find(title.rpartition(":")[2]) if title else name
                if plain and (stated := stated_unit(source, plain, targets)):
                    unit, origin = stated[0], f"{title} beside it" if title else stated[1]
                    break
        result[option] = ColumnReading(option, spec.column, unit, origin, source, name)
    return result


def stated_unit(source: Source, name: str, targets: Sequence[str]) -> tuple[str, str] | None:
    """The unit of a column by the metadata of the file or by its title, and which it is."""
    stated = source.units.get(name)
    if stated and units.target_of(stated, targets) is not None:
        return stated, "the file"
    titled = units.unit_in_title(source.titles.get(name, name), targets)
    return (titled, "the title") if titled else None


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
        way = [known.get(f"geodetic.{name}", 0.0 * t) for name in units.SI["geodetic"]]
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
    groups = {columns: noise_floor(pose[:, columns], starts, period).cutoff_hz
              for columns in ((0, 1, 2), (3,), (4,), (5,))}  # fmt: skip

    def rates(pose: Array) -> Array:
        if len(pose) < 2:
            return np.zeros_like(pose)
        rate = np.gradient(pose, period, axis=0)
        rate[:, 3:] = kinematics.body_rates(pose[:, 3:], period)
        for columns, cutoff in groups.items():
            if cutoff is not None and cutoff < 0.45 / period and len(pose) > recordings.MIN_PIECE:
                rate[:, columns] = lowpass(rate[:, columns], cutoff, period)
        return rate

    nu = recordings.piecewise(rates, recordings.piece_edges(t, period), pose)
    nu[:, :3] = signals.in_body(pose[:, 3:], nu[:, :3])
    return nu
