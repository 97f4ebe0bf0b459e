"""From columns of any unit, sense, frame and clock to signals in SI units, NED and body axes.

Every column becomes a channel of its own times. Channels of one clock stay as they are unless a
rate is asked for; those of several clocks are joined on one grid. Then positions, attitude and
velocities are turned into our frames, the sensor is moved to the origin of the vessel, and
velocities that were not recorded are differentiated from the pose. What is left out is said.
"""

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np
from annotated_types import Ge

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.notation import DOFS, PLANAR
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.recording import units
from seatrial.models.recording.column_map import KINDS, QUATERNION, Column, ColumnMap, Frames
from seatrial.models.recording.joining import AtGap, Channel, join_channels, left_in_gaps
from seatrial.models.recording.preprocessing import (
    in_body,
    interpolated,
    outliers,
    without_sign_flips,
)  # fmt: skip
from seatrial.models.recording.recording import MIN_PIECE, UNIFORMITY, piece_edges, piecewise
from seatrial.models.recording.recording import piece_starts as starts_of
from seatrial.models.recording.sampling import GAP
from seatrial.models.recording.smoothing import lowpass, noise_floor
from seatrial.models.recording.source import Source, column
from seatrial.models.recording.times import EPOCH_S, disagreement, find_time, seconds
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import body_rates, euler_zyx, pose_jacobian, unroll

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
EXCHANGED = {"surge": "sway", "sway": "surge"}  # of east, north, up
MOTION, COMPOSED = ("position", "velocity"), ("orientation", "geodetic", "ground", "water", "wind")
FLIPPED = ("sway", "heave", "pitch", "yaw")  # of forward, left, up axes
# Numbers that loggers write where there is none, if nothing else is near.
SENTINELS = (999.0, 9999.0, 99999.0, 999999.0, 32767.0, 32768.0, 65535.0, 1e20)
NO_FIX = {  # of AIS, and without satellites
    "geodetic.latitude": (0.0, 91.0), "geodetic.longitude": (0.0, 181.0),
    "position.yaw": (511.0,), "ground.speed": (102.3,),
}  # fmt: skip
Sources = Mapping[str, Source]


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


@dataclass(frozen=True, eq=False)
class ReadSignals:
    """Signals by option, such as `velocity.surge`, on one clock, in SI units and our frames."""

    t: Array  # (N,) [s]
    values: dict[str, Array]  # (N,) each
    readings: tuple[ColumnReading, ...]
    left_out: tuple[str, ...]


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
        """The signals that a vessel with some degrees of freedom needs.

        Args:
            path: the recording, for messages.
            sources: its columns as recorded, by source.
            dofs: degrees of freedom of the vessel.

        Returns:
            All signals that are mapped for these degrees of freedom, on one clock.

        Raises:
            RecordingError: a column is missing, a cell is no number, or channels cannot be joined.
            ConfigurationError: a unit is not known.
        """
        notes = [line for source in sources.values() for line in source.left_out]
        try:
            read = readings(sources, self.columns, wanted(self.columns, dofs))
            channels = self._channels(sources, read, notes)
            replaced, rule = list[str](), self.outliers
            for option, channel in channels.items() if rule.replace else ():
                valid, values = ~np.isnan(channel.values), channel.values.copy()
                wrong = outliers(values[valid], rule.window, rule.deviations)
                values[valid] = interpolated(channel.t[valid], values[valid], wrong)
                channels[option] = channel._replace(values=values)
                replaced += [f"{read[option].name} {np.sum(wrong)}"] if np.any(wrong) else []
            notes += [f"outliers are replaced: {', '.join(replaced)}"] if replaced else []
            t, known = self._on_one_clock(channels, read, notes)
            known = _in_our_frames(t, known, self.columns, np.radians(self.heading_deg))
        except RecordingError as error:
            named = str(path) in str(error)
            raise error if named else RecordingError(f"{path}: {error}") from error
        return ReadSignals(t, known, tuple(read.values()), tuple(_together(notes)))

    def _on_one_clock(
        self, channels: Mapping[str, Channel], read: Mapping[str, ColumnReading], notes: list[str]
    ) -> tuple[Array, dict[str, Array]]:
        """The times (N,) of all channels, and their values then: joined unless they share a clock.

        Without `resample_hz` the rate is that of the slowest velocity, or position, rounded.
        """
        alone = len({reading.source.name for reading in read.values()}) == 1
        t, rate, longest = None, self.resample_hz, self.max_gap_s
        if alone and rate is None and not self.columns.delay_s:
            t = _shared_clock(channels, read, self.columns, self.at_gap)
        if t is None:
            channels = {option: c.cleaned(notes) for option, c in channels.items()}
        known = {option: channel.values for option, channel in channels.items()}
        if rate is None:
            pose = ("position", "geodetic", "orientation")
            every = ([c.t for o, c in channels.items() if o.startswith(kinds) and len(c.t) > 1]
                     for kinds in ("velocity", pose, ""))  # fmt: skip
            steps = (float(np.median(np.diff(t))) for t in next(filter(None, every), ()))
            step = max(steps, default=1.0)
            rate = float(f"{1.0 / step:.2g}") if step > 0.0 else 1.0
            longest = max(longest, BRIDGED / rate)
        if t is None:
            t, known = join_channels(channels, rate, longest, self.at_gap)
        notes += left_in_gaps(t, channels, longest)
        return t, known

    def _channels(
        self, sources: Sources, read: Mapping[str, ColumnReading], notes: list[str]
    ) -> dict[str, Channel]:
        """The columns in SI units on their clocks, by option."""
        if not read:
            raise ConfigurationError("excitation.columns: got none for the vessel, expected some")
        clocks, channels = dict[str, Array](), dict[str, Channel]()
        start = first_time(sources, self.columns)
        for option, reading in read.items():
            spec, source = self.columns.specs[option], reading.source
            if source.name not in clocks:
                clock = clock_of(source, self.columns)
                clocks[source.name] = seconds(source, clock)
                notes += [line] if (line := disagreement(source, clock)) else []
            kind, delays = option.partition(".")[0], self.columns.delay_s
            t = clocks[source.name] - start - delays.get(source.name, delays.get(kind, 0.0))
            values = reading.values
            missing = [(sign * size, 0.5 * size) for size in SENTINELS for sign in (1.0, -1.0)]
            missing += [(size, 0.5) for size in NO_FIX.get(option, ())]
            for size, near in missing:  # where nothing else is near
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
                values[valid] = unroll(values[valid])
                values = -values if spec.positive == "anticlockwise" else values
                values = values + 0.5 * np.pi if spec.zero == "east" else values
            held, title = kind in HELD_SIGNALS, f"column {spec.name}"
            channels[option] = Channel(t, values, held, title)
        return _unit_quaternions(channels)


def _together(notes: Sequence[str]) -> Iterator[str]:
    """The notes, those that differ by the column only in one line."""
    groups = defaultdict[str, list[str]](list)
    for note in dict.fromkeys(notes):
        match = re.fullmatch(r"column (.+?): (.*)", note)
        groups[match[2] if match else note].append(match[1] if match else "")
    for text, names in groups.items():
        columns = shorten(", ".join(names), 300, placeholder=" ...")
        yield f"column{'s' * (len(names) > 1)} {columns}: {text}" if columns else text


def wanted(columns: ColumnMap, dofs: Sequence[str]) -> dict[str, bool]:
    """The options whose columns a vessel with some degrees of freedom uses, and if it needs them.

    The attitude is used where it is recorded, also by a vessel that does not turn.
    """
    arm = any(columns.lever_arm_m)
    turned = columns.frames != Frames() or arm or bool(columns.geodetic or columns.ground)
    turned = turned or any(dof not in columns.moving for dof in dofs)
    used = dict[str, bool]()
    for option in columns.specs:
        kind, _, dof = option.partition(".")
        angle = dof in DOFS[3:]
        if kind in KINDS:
            needed = dof in dofs or (turned and not angle and kind in MOTION)
            needed |= arm and angle and kind == "velocity"
            replaced = kind == "position" and (columns.orientation if angle else columns.geodetic)
            wished = not replaced and (needed or (angle and kind == "position"))
        else:
            needed = kind != "orientation" or turned or any(dof in DOFS[3:] for dof in dofs)
            wished = kind not in IN_THE_PLANE or set(PLANAR) <= set(dofs)
        used |= {option: needed} if wished else {}
    return used


def clock_of(source: Source, columns: ColumnMap) -> Column:
    """The time of a source: that of the map, which may be named `source:column`, or its own."""
    time = columns.clock
    for name in (time.name, time.name.rpartition(":")[2]):
        if source.find(name) is not None:
            return replace(time, column=name)
    known = find_time(source)
    if known is None:
        raise source.absent(time.name)
    return known


def first_time(sources: Sources, columns: ColumnMap) -> float:
    """What is subtracted from all times [s]: the first date of any source, or 0.

    It does not depend on the vessel; of dates only differences matter.
    """
    firsts = []
    for source in sources.values():
        with suppress(*FAULTS, ValueError):
            firsts.append(float(np.nanmin(seconds(source, clock_of(source, columns)))))
    start = min(firsts, default=0.0)
    return start if start > EPOCH_S else 0.0


def readings(
    sources: Sources, columns: ColumnMap, used: Mapping[str, bool] | None = None
) -> dict[str, ColumnReading]:
    """How each mapped column is read, by option; the first that tells its unit counts.

    Args:
        sources: the recording.
        columns: its map.
        used: the options that are read, and whether each is needed; None: those that are there.

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
        unit, origin = (targets[0] if len(targets) == 1 else ""), SI_ASSUMED
        if spec.unit is not None or spec.full is not None or not targets:
            unit, origin = spec.unit or "", "the map"
        else:
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
    titled = units.unit_in_title(source.title(name), targets)
    return (titled, "the title") if titled else None


def _shared_clock(
    channels: Mapping[str, Channel], read: Mapping[str, ColumnReading], columns: ColumnMap,
    at_gap: AtGap,
) -> Array | None:  # fmt: skip
    """The times (N,) [s] of channels of one source, which must be complete and rise by equal steps.

    `split` allows longer steps at gaps; the result is then None if the channels can only be joined.
    Raises RecordingError, with line and column, for `refuse`.
    """
    t, source = next(iter(channels.values())).t, next(iter(read.values())).source
    if len(t) < 2:
        raise RecordingError(f"{source.path}: got {len(t)} samples, expected at least 2")
    steps, clock = np.diff(t), clock_of(source, columns).name
    period = float(np.median(steps))
    even = np.abs(steps - period) <= UNIFORMITY * abs(period)
    even |= (at_gap == "split") & (steps > GAP * period)
    grid = "; excitation.resample_hz=RATE puts the columns on a uniform grid"
    # rows that are wrong, the column that is, and what it should hold
    wrong = [(np.isnan(c.values), read[o].name, f"a finite number{grid}")
             for o, c in channels.items()]  # fmt: skip
    wrong.append((np.isnan(t), clock, "a finite number"))
    wrong.append((np.append(False, steps <= 0.0), clock, f"time to increase{grid}"))
    wrong.append((np.append(False, ~even), clock, f"steps of {period:.6g} s{grid}"))
    row = next((row for row in wrong if np.any(row[0])), None)
    if row is not None and at_gap != "split":
        raise source.refused(int(np.argmax(row[0])), *row[1:])
    return t if row is None else None


def _unit_quaternions(channels: dict[str, Channel]) -> dict[str, Channel]:
    """Channels with quaternions of length one, without sign flips."""
    names = [f"orientation.{part}" for part in QUATERNION]
    if not set(names) <= set(channels):
        return channels
    quaternions = np.column_stack([channels[name].values for name in names])
    lengths = np.linalg.norm(quaternions, axis=1)
    if np.any(wrong := np.abs(lengths - 1.0) > QUATERNION_ERROR):  # False for NaN
        k = int(np.argmax(wrong))
        columns = ", ".join(channels[name].name.removeprefix("column ") for name in names)
        raise RecordingError(
            f"columns {columns}, sample {k + 1}: got a quaternion of length {lengths[k]:.3g}, "
            "expected 1"
        )
    quaternions /= lengths[:, None]  # all four are NaN where one is
    valid = ~np.isnan(lengths)
    quaternions[valid] = without_sign_flips(quaternions[valid])
    new = zip(names, quaternions.T, strict=True)
    return channels | {name: channels[name]._replace(values=values) for name, values in new}


def _in_our_frames(
    t: Array, known: Mapping[str, Array], columns: ColumnMap, heading: float
) -> dict[str, Array]:
    """Signals by option in NED and forward, right, down axes at the origin of the vessel."""
    frames, zero = columns.frames, 0.0 * t
    posed, moving = ({dof for dof in DOFS if f"{kind}.{dof}" in known} for kind in MOTION)
    pose, nu = (np.column_stack([known.get(f"{kind}.{dof}", zero) for dof in DOFS])
                for kind in MOTION)  # fmt: skip
    attitude = _attitude(known, frames, len(t), heading)
    posed |= set(DOFS[3:]) if "orientation.w" in known else set()
    if columns.geodetic:  # from the first sample, on WGS 84
        way = [known.get(f"geodetic.{name}", zero) for name in units.SI["geodetic"]]
        if np.max(np.abs(way[0])) > 90.0 or np.max(np.abs(way[1])) > 360.0:
            got = f"got {way[0][0]:g}, {way[1][0]:g}, expected degrees"
            raise RecordingError(f"columns.geodetic: {got}")
        pose[:, :3] = np.column_stack(pymap3d.geodetic2ned(*way, *(x[0] for x in way)))
        posed |= set(DOFS[: len(columns.geodetic)])
    elif frames.position == "ENU":
        pose[:, :3], posed = _from_enu(pose[:, :3]), {EXCHANGED.get(dof, dof) for dof in posed}
    pose[:, 3:] = attitude
    pose[:, [i for i, dof in enumerate(DOFS) if dof not in posed]] = 0.0
    if frames.velocity == "earth":  # angular velocities are of the body
        if len(moving & {"surge", "sway"}) == 1:
            raise RecordingError(
                "columns.velocity: got one of surge and sway along the axes of the earth, expected "
                "both, which are turned into the axes of the body"
            )
        if frames.position == "ENU":
            nu[:, :3], moving = _from_enu(nu[:, :3]), {EXCHANGED.get(dof, dof) for dof in moving}
        nu[:, :3] = in_body(attitude, nu[:, :3])
    elif frames.body == "FLU":
        nu[:, [DOFS.index(dof) for dof in FLIPPED]] *= -1.0
    if "ground.speed" in known:
        angle, speed = known["ground.course"] - attitude[:, 2], known["ground.speed"]
        nu[:, :2], moving = (speed * [np.cos(angle), np.sin(angle)]).T, moving | {"surge", "sway"}
    if absent := [DOFS.index(dof) for dof in posed - moving]:
        nu[:, absent] = _differentiated(t, pose, attitude)[:, absent]
        moving |= posed
    if any(columns.lever_arm_m):  # p_o = p_s - R r, v_o = v_s - omega x r
        arm = np.array(columns.lever_arm_m)
        nu[:, :3] -= np.cross(nu[:, 3:], arm)
        pose[:, :3] -= pose_jacobian(attitude)[:, :3, :3] @ arm
    result = {o: x for o, x in known.items() if o.partition(".")[0] not in (*MOTION, *COMPOSED)}
    for kind, values, there in zip(MOTION, (pose, nu), (posed, moving), strict=True):
        result |= {f"{kind}.{d}": x for d, x in zip(DOFS, values.T, strict=True) if d in there}
    if "wind.speed" in known:
        apparent = (columns.wind or {}).get("kind") == "apparent"
        angle = known["wind.direction"] - (0.0 if apparent else attitude[:, 2])
        air = -known["wind.speed"] * [np.cos(angle), np.sin(angle)] + apparent * nu[:, :2].T
        result |= {"air.surge": air[0], "air.sway": air[1]}
    if "water.speed" in known and {"surge", "sway"} <= moving:
        # The log shows the speed along the bow: what is left of that over ground is the current.
        along, aside = nu[:, 0] - known["water.speed"], nu[:, 1]
        c, s = np.cos(attitude[:, 2]), np.sin(attitude[:, 2])
        result["current.north"] = c * along - s * aside
        result["current.east"] = s * along + c * aside
    return result


def _from_enu(values: Array) -> Array:
    """North, east, down of vectors (N, 3) that are east, north, up."""
    return np.asarray(values[:, [1, 0, 2]] * [1.0, 1.0, -1.0])


def _attitude(known: Mapping[str, Array], frames: Frames, n: int, heading: float) -> Array:
    """(phi, theta, psi) [rad] in NED, shape (N, 3), unrolled; psi counts from `heading`."""
    if "orientation.w" in known:
        attitude = euler_zyx(np.column_stack([known[f"orientation.{p}"] for p in QUATERNION]))
    else:
        zero = np.zeros(n)
        attitude = np.column_stack([known.get(f"position.{dof}", zero) for dof in DOFS[3:]])
    if frames.attitude == "ENU":
        attitude = attitude * [1.0, -1.0, -1.0] + [0.0, 0.0, 0.5 * np.pi]
    if "orientation.w" in known or "position.yaw" in known:
        attitude = unroll(attitude - [0.0, 0.0, heading])
    return np.asarray(attitude)


def _differentiated(t: Array, pose: Array, attitude: Array) -> Array:
    """Body velocities (N, 6) from the pose (N, 6) in NED, piece by piece.

    The position and each angle are low-passed forward and backward where their density first
    reaches four times its noise floor, so that the derivative holds motion and not the noise.
    Angular velocities are those of the rotation, not of its Euler angles.
    """
    period = float(np.median(np.diff(t)))
    edges, starts = piece_edges(t, period), starts_of(t, period)
    groups = {columns: noise_floor(pose[:, columns], starts, period).cutoff_hz
              for columns in ((0, 1, 2), (3,), (4,), (5,))}  # fmt: skip

    def rates(pose: Array, attitude: Array) -> Array:
        if len(pose) < 2:
            return np.zeros_like(pose)
        rate = np.gradient(pose, period, axis=0)
        rate[:, 3:] = body_rates(attitude, period)
        for columns, cutoff in groups.items():
            if cutoff is not None and cutoff < 0.45 / period and len(pose) > MIN_PIECE:
                rate[:, columns] = lowpass(rate[:, columns], cutoff, period)
        return rate

    nu = piecewise(rates, edges, pose, attitude)
    nu[:, :3] = in_body(attitude, nu[:, :3])
    return nu
