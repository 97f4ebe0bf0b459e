"""From columns of any unit, sense, frame and clock to signals in SI units, NED and body axes.

Every column becomes a channel of its own times. Channels of one clock stay as they are unless a
rate is asked for; those of several clocks are joined on one grid. Then positions, attitude and
velocities are turned into our frames, the sensor is moved to the origin of the vessel, and
velocities that were not recorded are differentiated from the pose. What is left out is said.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np
from annotated_types import Ge

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.notation import DOFS, PLANAR
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.recording import units
from seatrial.models.recording.column_map import KINDS, QUATERNION, Column, ColumnMap, Frames
from seatrial.models.recording.joining import AtGap, Channel, TimeGrid, join_channels
from seatrial.models.recording.preprocessing import interpolated, outliers, without_sign_flips
from seatrial.models.recording.recording import GAP, MIN_PIECE, Mask, piece_edges
from seatrial.models.recording.smoothing import lowpass, noise_floor
from seatrial.models.recording.source import Source, column
from seatrial.models.recording.times import EPOCH_S, disagreement, find_time, is_later, seconds
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import body_rates, euler_zyx, pose_jacobian, unroll

if TYPE_CHECKING:
    import pymap3d
else:
    import lazy_loader

    pymap3d = lazy_loader.load("pymap3d")

HELD_SIGNALS = ("force", "commands")  # constant until the next sample
BRIDGED = 2.5  # sample times that joining fills at any rate
SI_ASSUMED = "no unit is stated: SI"
QUATERNION_ERROR = 0.05  # of the length of a quaternion: a larger one means a wrong column
FLIPPED = ("sway", "heave", "pitch", "yaw")  # of forward, left, up axes
UNIFORMITY = 0.01  # largest deviation of a step from the sample time, relative to it
# Numbers that loggers write where there is none, if nothing else is near.
SENTINELS = (999.0, 9999.0, 99999.0, 999999.0, 32767.0, 32768.0, 65535.0, 1e20)
Sources = Mapping[str, Source]


@dataclass(frozen=True)
class Outliers:
    """Outliers: samples over `deviations` standard deviations from their `window` neighbours."""

    replace: bool = False
    window: Annotated[int, Ge(4)] = 10
    deviations: Positive = 3.0

    def __post_init__(self) -> None:
        check_ranges(self)

    def of(self, values: Array) -> Mask:
        """Mask (N,) of the outliers among the samples that are there."""
        valid = ~np.isnan(values)
        mask = np.zeros(len(values), dtype=np.bool_)
        mask[valid] = outliers(values[valid], self.window, self.deviations)
        return mask


@dataclass(frozen=True)
class ColumnReading:
    """With which unit and sign a column was read, and where they are known from."""

    option: str
    column: str
    unit: str
    known_from: str


@dataclass(frozen=True, eq=False)
class Signals:
    """Signals by option, such as `velocity.surge`, on one clock, in SI units and our frames."""

    t: Array  # (N,) [s]
    values: dict[str, Array]  # (N,) each
    outliers: dict[str, int]  # by recorded column
    readings: tuple[ColumnReading, ...]
    left_out: tuple[str, ...]


class _Part(NamedTuple):
    """A column of a source as a channel, and how it was read."""

    channel: Channel
    source: Source
    name: str
    clock: str
    reading: ColumnReading


@dataclass(frozen=True)
class Reading:
    """How the columns of a recording are read: the map, the grid, and what is cleaned."""

    columns: ColumnMap
    grid: TimeGrid | None = None  # None: as recorded, else the rate of the slowest state
    sample_time_s: float | None = None  # None: the median step
    outliers: Outliers = field(default_factory=Outliers)
    heading_deg: float = 0.0  # of the frame of the positions in that of the attitude
    more: Mapping[str, Column] = field(default_factory=dict)  # further columns by option
    at_gap: AtGap = "refuse"  # without a grid, and the longest gap that joining then fills
    max_gap_s: float = 1.0

    def read(self, path: Path, sources: Sources, dofs: Sequence[str]) -> Signals:
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
        try:
            return self._signals(sources, dofs)
        except RecordingError as error:
            named = str(path) in str(error)
            raise error if named else RecordingError(f"{path}: {error}") from error

    def _signals(self, sources: Sources, dofs: Sequence[str]) -> Signals:
        notes = [line for source in sources.values() for line in source.left_out]
        parts = self._parts(sources, dofs, notes)
        channels = {option: part.channel for option, part in parts.items()}
        channels = _unit_quaternions(channels, parts)
        counts = {}
        for option, channel in channels.items():
            wrong = self.outliers.of(channel.values)
            counts[parts[option].reading.column.removeprefix("-")] = int(np.sum(wrong))
            if self.outliers.replace and np.any(wrong):
                valid = ~np.isnan(channel.values)
                values = channel.values.copy()
                values[valid] = interpolated(channel.t[valid], values[valid], wrong[valid])
                channels[option] = channel._replace(values=values)
        alone = len({id(part.source) for part in parts.values()}) == 1
        alone = alone and self.grid is None and not self.columns.delay_s
        t = self._one_clock(channels, parts) if alone else None
        known = {option: channel.values for option, channel in channels.items()}
        cleaned = {o: _clean(c, notes) for o, c in channels.items()} if t is None else channels
        rate = _rate(cleaned)
        grid = self.grid or TimeGrid(rate, max(self.max_gap_s, BRIDGED / rate), self.at_gap)
        if t is None:
            t, known = join_channels(cleaned, grid)
        notes += _dropped(t, cleaned, grid)
        known = _in_our_frames(t, known, self.columns, np.radians(self.heading_deg))
        readings = tuple(part.reading for part in parts.values())
        return Signals(t, known, counts, readings, tuple(dict.fromkeys(notes)))

    def _parts(self, sources: Sources, dofs: Sequence[str], notes: list[str]) -> dict[str, _Part]:
        """The columns in SI units, by option."""
        specs, needed = wanted(self.columns, dofs)
        specs = {**specs, **self.more}
        if not specs:
            raise ConfigurationError("excitation.columns: got none for the vessel, expected some")
        scale, clocks = self.columns.froude_scale, dict[str, tuple[str, Array]]()
        pace = units.froude_factor("s", scale)
        start = first_time(sources, self.columns)
        parts = {}
        for option, spec in specs.items():
            try:
                source, name = column(sources, spec.name)
            except RecordingError:
                if option in needed or option in self.more:
                    raise
                continue
            if source.name not in clocks:
                clock = clock_of(source, self.columns)
                clocks[source.name] = clock.name, seconds(source, clock)
                notes += [line] if (line := disagreement(source, clock)) else []
            values = _without_sentinels(source.numbers(name, gaps=True), name, notes)
            reading = reading_of(source, name, option, spec, specs)
            kind = option.partition(".")[0]
            delay = self.columns.delay_s.get(source.name, self.columns.delay_s.get(kind, 0.0))
            values = _in_si(values, option, spec, reading.unit)
            values = values * _froude(option, reading.unit, scale)
            clock_name, times = clocks[source.name]
            t = pace * (times - start - delay)
            channel = Channel(t, values, kind in HELD_SIGNALS, f"column {spec.name}")
            parts[option] = _Part(channel, source, name, clock_name, reading)
        return parts

    def _one_clock(
        self, channels: Mapping[str, Channel], parts: Mapping[str, _Part]
    ) -> Array | None:
        """The times of channels that share one, which must be complete and rise by equal steps.

        At gaps that are left out, steps may be longer. None: they can only be joined.
        """
        first, error = next(iter(parts.values())), None
        source, t = first.source, first.channel.t
        empty = {option: np.isnan(channel.values) for option, channel in channels.items()}
        option = next((option for option, mask in empty.items() if np.any(mask)), None)
        steps = np.diff(t)
        period = self.sample_time_s or float(np.median(steps)) if len(t) > 1 else 1.0
        rising = steps > 0.0
        even = np.abs(steps - period) <= UNIFORMITY * abs(period)
        even |= (self.at_gap == "split") & (steps > GAP * period)
        if option is not None:
            expected = "a finite number; excitation.resample_hz=RATE joins columns with gaps"
            error = source.refused(int(np.argmax(empty[option])), parts[option].name, expected)
        elif len(t) < 2:
            error = RecordingError(f"{source.path}: got {len(t)} samples, expected at least 2")
        elif np.any(np.isnan(t)):
            error = source.refused(int(np.argmax(np.isnan(t))), first.clock)
        elif not np.all(rising & even):
            k = int(np.argmin(rising)) if not np.all(rising) else int(np.argmin(even))
            got = (
                f"a step of {steps[k]:.6g} s, expected a uniform sample time of {period:.6g} s"
                if np.all(rising)
                else f"{t[k + 1]:.6f} s after {t[k]:.6f} s, expected time to increase"
            )
            place, _ = source.cell(k + 1, next(iter(source.columns)))
            error = RecordingError(
                f"{source.path}, column {first.clock}, {place}: got {got}; "
                "excitation.resample_hz=RATE puts the columns on a uniform grid"
            )
        if error is not None and self.at_gap != "split":
            raise error
        return t if error is None else None


def wanted(columns: ColumnMap, dofs: Sequence[str]) -> tuple[dict[str, Column], set[str]]:
    """The columns that a vessel with some degrees of freedom uses, by option, and which it needs.

    The attitude is used where it is recorded, also by a vessel that does not turn.
    """
    turned = columns.frames != Frames() or any(columns.lever_arm_m) or columns.geodetic is not None
    turned = turned or columns.ground is not None or any(dof not in columns.moving for dof in dofs)
    turns = turned or any(dof in DOFS[3:] for dof in dofs)
    used: dict[str, Column] = {}
    needed: set[str] = set()
    for option, spec in columns.columns().items():
        kind, _, dof = option.partition(".")
        if kind in KINDS:
            replaced = kind == "position" and (
                (columns.orientation is not None and dof in DOFS[3:])
                or (columns.geodetic is not None and dof in DOFS[:3])
            )
            swung = kind == "velocity" and dof in DOFS[3:] and any(columns.lever_arm_m)
            linear = dof in DOFS[:3] and kind in ("position", "velocity") and turned
            required = dof in dofs or swung or linear
            wished = required or (kind == "position" and dof in DOFS[3:])
            if replaced or not wished:
                continue
        else:  # air, water and course have a meaning in the plane alone
            if kind in ("wind", "air", "ground", "water") and not set(PLANAR) <= set(dofs):
                continue
            required = kind != "quaternion" or turns
        used[option] = spec
        needed |= {option} if required else set()
    return used, needed


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
        try:
            firsts.append(float(np.nanmin(seconds(source, clock_of(source, columns)))))
        except (RecordingError, ConfigurationError, ValueError):
            continue
    start = min(firsts, default=0.0)
    return start if start > EPOCH_S else 0.0


def reading_of(
    source: Source, name: str, option: str, spec: Column, specs: Mapping[str, Column]
) -> ColumnReading:
    """The unit of a column of a source, and where it is known from: the first that tells it."""
    targets, kind = units.targets_of(option), option.partition(".")[0]
    unit, origin = (targets[0] if len(targets) == 1 else ""), SI_ASSUMED
    if spec.unit is not None or spec.full is not None or not targets:
        unit, origin = spec.unit or "", "the map"
    elif known := stated_unit(source, name, targets):
        unit, origin = known
    elif kind in ("position", "velocity", "force", "actual_force", "acceleration"):
        for other, beside in specs.items():  # of the same quantity, told by the same source
            plain = source.find(beside.name.rpartition(":")[2])
            same = other.partition(".")[0] == kind and units.targets_of(other) == targets
            told = stated_unit(source, plain, targets) if plain and plain != name and same else None
            if told:
                unit, origin = told[0], f"{beside.name} beside it"
                break
    return ColumnReading(option, spec.column, unit, origin)


def stated_unit(source: Source, name: str, targets: Sequence[str]) -> tuple[str, str] | None:
    """The unit of a column by the metadata of the file or by its title, and which it is."""
    stated = source.units.get(name)
    if stated and units.target_of(stated, targets) is not None:
        return stated, "the file"
    titled = units.unit_in_title(source.title(name), targets)
    return (titled, "the title") if titled else None


def _in_si(values: Array, option: str, spec: Column, unit: str) -> Array:
    """A column in SI units, with its sign, its sense and without jumps of angles."""
    kind, _, dof = option.partition(".")
    if spec.full is not None:
        values = (values - spec.neutral) / (spec.full - spec.neutral)
    values = values * spec.sign
    targets = units.targets_of(option)
    if unit and kind in ("inputs", "commands"):
        values = values * units.input_factor(unit)
    elif unit and targets:
        values = values * units.factor(unit, targets[0])
    angle = kind == "position" and dof in DOFS[3:]
    if angle or option in ("wind.direction", "ground.course") or kind == "thruster_angle":
        values, valid = values.copy(), ~np.isnan(values)
        values[valid] = unroll(values[valid])
    if angle:
        values = -values if spec.positive == "anticlockwise" else values
        values = values + 0.5 * np.pi if spec.zero == "east" else values
    return values


def _froude(option: str, unit: str, scale: float) -> float:
    """The factor of a column in SI units by Froude's law; 1 for what is of the same size."""
    kind = option.partition(".")[0]
    if scale == 1.0 or not (targets := units.targets_of(option)):
        return 1.0
    if kind == "geodetic":
        raise ConfigurationError("columns.geodetic: froude_scale needs a position in metres")
    if kind in ("inputs", "commands") and not unit:
        raise ConfigurationError(
            f"columns.{option}: got no unit, expected one, on which froude_scale={scale:g} depends"
        )
    return units.froude_factor(targets[0] if len(targets) == 1 else unit, scale)


def _without_sentinels(values: Array, name: str, notes: list[str]) -> Array:
    """The column without numbers that stand for none, such as -999, where nothing else is near."""
    for sentinel in (sign * size for size in SENTINELS for sign in (1.0, -1.0)):
        wrong = values == sentinel
        if np.any(wrong) and not np.any(np.abs(values[~wrong] - sentinel) < 0.5 * abs(sentinel)):
            count = int(np.sum(wrong))
            notes.append(f"column {name}: {count} cells are {sentinel:g}: missing values")
            values = np.where(wrong, np.nan, values)
    return values


def _clean(channel: Channel, notes: list[str]) -> Channel:
    """The channel without missing values, and without samples that are not later than the last."""
    valid = ~(np.isnan(channel.values) | np.isnan(channel.t))
    if timeless := int(np.sum(np.isnan(channel.t))):
        notes.append(f"{timeless} rows have no time: left out")
    t, values = channel.t[valid], channel.values[valid]
    later = is_later(t)
    if not np.all(later):
        back, same = int(np.sum(np.diff(t) < 0.0)), int(np.sum(np.diff(t) == 0.0))
        notes.append(
            f"{channel.name}: {int(np.sum(~later))} samples are not later than the one before "
            f"({same} times repeat, {back} go back): left out"
        )
    return channel._replace(t=t[later], values=values[later])


def _rate(channels: Mapping[str, Channel]) -> float:
    """The sample rate [Hz] of the slowest velocity, or position, rounded to few digits."""
    for kinds in ("velocity", ("position", "geodetic", "quaternion"), ""):
        own = [c.t for option, c in channels.items() if option.startswith(kinds) and len(c.t) > 1]
        if own:
            break
    step = max((float(np.median(np.diff(t))) for t in own), default=1.0)
    return float(f"{1.0 / step:.2g}") if step > 0.0 else 1.0


def _dropped(t: Array, channels: Mapping[str, Channel], grid: TimeGrid) -> list[str]:
    """What of the time that the channels cover is not in the recording."""
    ends = min(float(c.t[-1]) for c in channels.values())
    whole, period = (
        ends - max(float(c.t[0]) for c in channels.values()),
        float(np.median(np.diff(t))),
    )
    lost, pieces = whole - len(t) * period, len(piece_edges(t, period)) - 1
    if pieces < 2 and lost < 2.0 * period:
        return []
    return [
        f"{lost:.3g} of {whole:.4g} s are in gaps of more than {grid.max_gap_s:g} s: left out, "
        f"{pieces} pieces remain"
    ]


def _unit_quaternions(
    channels: dict[str, Channel], parts: Mapping[str, _Part]
) -> dict[str, Channel]:
    """Channels with quaternions of length one, without sign flips."""
    names = [f"quaternion.{part}" for part in QUATERNION]
    if not set(names) <= set(channels):
        return channels
    quaternions = np.column_stack([channels[name].values for name in names])
    valid = ~np.any(np.isnan(quaternions), axis=1)
    lengths = np.linalg.norm(quaternions, axis=1)
    wrong = np.abs(lengths - 1.0) > QUATERNION_ERROR  # False for NaN
    if np.any(wrong):
        k = int(np.argmax(wrong))
        columns = ", ".join(parts[name].reading.column for name in names)
        raise RecordingError(
            f"columns {columns}, sample {k + 1}: got a quaternion of length {lengths[k]:.3g}, "
            "expected 1"
        )
    quaternions[~valid] = np.nan
    quaternions[valid] = without_sign_flips(quaternions[valid] / lengths[valid, None])
    new = zip(names, quaternions.T, strict=True)
    return {**channels, **{name: channels[name]._replace(values=v) for name, v in new}}


def _in_our_frames(
    t: Array, known: Mapping[str, Array], columns: ColumnMap, heading: float
) -> dict[str, Array]:
    """Signals by option in NED and forward, right, down axes at the origin of the vessel."""
    composed = ("quaternion", "geodetic", "ground", "water")
    result = {name: v for name, v in known.items() if name.partition(".")[0] not in composed}
    frames, period = columns.frames, float(np.median(np.diff(t)))
    attitude = _attitude(known, frames, len(t), heading)
    for i, dof in enumerate(DOFS[3:]):
        if f"position.{dof}" in known or "quaternion.w" in known:
            result[f"position.{dof}"] = attitude[:, i]
    if columns.geodetic is not None:
        path = _path(known, columns)
        count = 3 if columns.geodetic.altitude is not None else 2
        result |= {f"position.{dof}": path[:, i] for i, dof in enumerate(DOFS[:count])}
    elif frames.position == "ENU":
        result |= _exchanged(known, "position")
    if frames.velocity == "earth" or any(columns.lever_arm_m):
        turn = pose_jacobian(attitude)[:, :3, :3]
    if frames.velocity == "earth":  # angular velocities are of the body
        earth = {**result, **_exchanged(result, "velocity")} if frames.position == "ENU" else result
        result |= _stacked("velocity", earth, np.einsum("nji,nj->ni", turn, _linear(earth, len(t))))
    elif frames.body == "FLU":
        result |= {f"velocity.{dof}": -result[f"velocity.{dof}"] for dof in FLIPPED
                   if f"velocity.{dof}" in result}  # fmt: skip
    if "ground.speed" in known:
        angle = known["ground.course"] - attitude[:, 2]
        result["velocity.surge"] = known["ground.speed"] * np.cos(angle)
        result["velocity.sway"] = known["ground.speed"] * np.sin(angle)
    result |= _differentiated(t, result, attitude, period)
    if any(columns.lever_arm_m):  # p_o = p_s - R r, v_o = v_s - omega x r
        arm = np.array(columns.lever_arm_m)
        omega = [result.get(f"velocity.{dof}", np.zeros(len(t))) for dof in DOFS[3:]]
        speed = _linear(result, len(t)) - np.cross(np.column_stack(omega), arm)
        place = _linear(result, len(t), "position") - turn @ arm
        result |= _stacked("velocity", result, speed) | _stacked("position", result, place)
    if "water.speed" in known and {"velocity.surge", "velocity.sway"} <= set(result):
        # The log shows the speed along the bow: what is left of that over ground is the current.
        along, aside = result["velocity.surge"] - known["water.speed"], result["velocity.sway"]
        c, s = np.cos(attitude[:, 2]), np.sin(attitude[:, 2])
        result["current.north"] = c * along - s * aside
        result["current.east"] = s * along + c * aside
    return result


def _linear(known: Mapping[str, Array], n: int, kind: str = "velocity") -> Array:
    """Surge, sway and heave (N, 3) of a kind; zero where one is not there."""
    return np.column_stack([known.get(f"{kind}.{dof}", np.zeros(n)) for dof in DOFS[:3]])


def _stacked(kind: str, known: Mapping[str, Array], values: Array) -> dict[str, Array]:
    """The columns of surge, sway and heave (N, 3) that are known, by option."""
    options = {f"{kind}.{dof}": values[:, i] for i, dof in enumerate(DOFS[:3])}
    return {option: column for option, column in options.items() if option in known}


def _attitude(known: Mapping[str, Array], frames: Frames, n: int, heading: float) -> Array:
    """(phi, theta, psi) [rad] in NED, shape (N, 3), unrolled; psi counts from `heading`."""
    if "quaternion.w" in known:
        attitude = euler_zyx(np.column_stack([known[f"quaternion.{p}"] for p in QUATERNION]))
    else:
        zero = np.zeros(n)
        attitude = np.column_stack([known.get(f"position.{dof}", zero) for dof in DOFS[3:]])
    if frames.attitude == "ENU":
        attitude = attitude * [1.0, -1.0, -1.0] + [0.0, 0.0, 0.5 * np.pi]
    if "quaternion.w" in known or "position.yaw" in known:
        attitude = unroll(attitude - [0.0, 0.0, heading])
    return np.asarray(attitude)


def _path(known: Mapping[str, Array], columns: ColumnMap) -> Array:
    """North, east and down [m] of the origin, shape (N, 3), on WGS 84."""
    assert columns.geodetic is not None
    latitude, longitude = known["geodetic.latitude"], known["geodetic.longitude"]
    altitude = known.get("geodetic.altitude", np.zeros(len(latitude)))
    origin = columns.geodetic.origin or (latitude[0], longitude[0], altitude[0])
    if np.max(np.abs(latitude)) > 90.0 or np.max(np.abs(longitude)) > 360.0:
        raise RecordingError(
            f"columns.geodetic: got {latitude[0]:g}, {longitude[0]:g}, expected degrees"
        )
    return np.column_stack(pymap3d.geodetic2ned(latitude, longitude, altitude, *origin))


def _exchanged(known: Mapping[str, Array], kind: str) -> dict[str, Array]:
    """North, east, down of what was mapped as surge, sway, heave but is east, north, up."""
    order = {"surge": ("sway", 1.0), "sway": ("surge", 1.0), "heave": ("heave", -1.0)}
    return {
        f"{kind}.{dof}": sign * known[f"{kind}.{other}"]
        for dof, (other, sign) in order.items()
        if f"{kind}.{other}" in known
    }


def _differentiated(
    t: Array, known: Mapping[str, Array], attitude: Array, period: float
) -> dict[str, Array]:
    """Body velocities that were not recorded, from the pose, piece by piece.

    The pose is low-passed forward and backward where its density first reaches four times its
    noise floor, so that the derivative holds motion and not the noise. Angular velocities are those
    of the rotation, not of its Euler angles.
    """
    absent = [dof for dof in DOFS if f"position.{dof}" in known and f"velocity.{dof}" not in known]
    if not absent:
        return {}
    edges, zero = piece_edges(t, period), np.zeros(len(t))
    starts = np.zeros(len(t), dtype=np.bool_)
    starts[edges[:-1]] = True
    pose = np.column_stack([known.get(f"position.{dof}", zero) for dof in DOFS])
    cutoff = noise_floor(pose, starts, period).cutoff_hz
    nu = np.zeros_like(pose)
    for a, b in pairwise(edges):
        if b - a < 2:
            continue
        rate = np.gradient(pose[a:b], period, axis=0)
        rate[:, 3:] = body_rates(attitude[a:b], period)
        if cutoff is not None and cutoff < 0.45 / period and b - a > MIN_PIECE:
            rate = lowpass(rate, cutoff, period)
        turn = pose_jacobian(attitude[a:b])[:, :3, :3]
        nu[a:b, :3] = np.einsum("nji,nj->ni", turn, rate[:, :3])
        nu[a:b, 3:] = rate[:, 3:]
    return {f"velocity.{dof}": nu[:, DOFS.index(dof)] for dof in absent}
