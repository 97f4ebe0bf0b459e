"""From columns of any unit, sense, frame and clock to a table in SI units, NED and body axes.

Every column becomes a channel of its own times. Channels of one clock stay as they are; those of
several clocks are joined on one grid. Then positions, attitude and velocities are turned into our
frames, the sensor is moved to the origin of the vessel, and velocities that were not recorded
are differentiated from the pose.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.notation import DOFS, PLANAR
from seatrial.models.recording.column import (
    SI,
    Column,
    Frames,
    Geodetic,
    WindColumns,
    as_column,
    factor,
    froude_factor,
    input_factor,
    is_known,
    seconds,
)
from seatrial.models.recording.column_map import KINDS, ColumnMap, ColumnTable
from seatrial.models.recording.joining import Channel, TimeGrid, join_channels
from seatrial.models.recording.preprocessing import without_sign_flips
from seatrial.models.recording.sampling import is_later
from seatrial.models.recording.smoothing import lowpass, noise_floor
from seatrial.models.recording.source import Source, column
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import euler_zyx, pose_jacobian, unroll

if TYPE_CHECKING:
    import pymap3d
else:
    import lazy_loader

    pymap3d = lazy_loader.load("pymap3d")

HELD_SIGNALS = ("force", "commands")  # constant until the next sample
QUATERNION = ("w", "x", "y", "z")
LONGEST_GAP_S = 1.0  # [s] that joining fills if nothing else is asked
EPOCH_S = 1e8  # [s] later times are dates
LENGTH = 0.05  # largest error of the length of a quaternion
FLIPPED = ("sway", "heave", "pitch", "yaw")  # of forward, left, up axes
MIN_PIECE = 30  # samples of a piece that is filtered
Sources = Mapping[str, Source]


@dataclass(frozen=True)
class Canonical:
    """Columns by option, such as `velocity.surge`, in SI units, and the map that names them."""

    table: ColumnTable
    columns: ColumnMap


def canonical(
    sources: Sources, columns: ColumnMap, dofs: Sequence[str], grid: TimeGrid | None,
    heading_deg: float = 0.0,
) -> Canonical:  # fmt: skip
    """Read the columns of a map for some degrees of freedom.

    Args:
        sources: the files or topics of the recording.
        columns: the map.
        dofs: degrees of freedom of the vessel.
        grid: for channels of several clocks; None: the rate of the first one.
        heading_deg: heading of the frame of the positions in that of the orientation.

    Returns:
        Times and columns on one clock, and the plain map of their names.

    Raises:
        RecordingError: a column is missing, or channels cannot be joined.
        ConfigurationError: a unit is not known.
    """
    channels, holders = _channels(sources, columns, dofs)
    first = next(iter(holders.values()))
    one = len({id(source) for source in holders.values()}) == 1
    if one and grid is None and not columns.delay_s:
        _check_complete(first, channels)
        t = next(iter(channels.values())).t
        if not np.median(np.diff(t)) > 0.0:  # more than half are not later than the last one
            row = int(np.argmax(np.diff(t) <= 0.0)) + 1
            place = first.cell(row, next(iter(first.columns))).place
            raise RecordingError(f"{first.path}, columns.time, {place}: the time does not rise")
        known = {name: channel.values for name, channel in channels.items()}
    else:
        joined = join_channels(
            {name: _clean(channel) for name, channel in channels.items()},
            grid or TimeGrid(_rate(channels), LONGEST_GAP_S),
        )
        t, known = joined.t, joined.columns
    known = _in_our_frames(t, known, columns, np.radians(heading_deg))

    def named(kind: str, names: Iterable[str] = DOFS) -> dict[str, str | Column]:
        return {name: f"{kind}.{name}" for name in names if f"{kind}.{name}" in known}

    plain = ColumnMap(
        "time", named("position"), named("velocity"), named("acceleration"), named("force"),
        named("actual_force"), orientation=None, inputs=named("inputs", columns.inputs),
        commands=named("commands", columns.commands), loads=named("loads", columns.loads),
        wind=columns.wind and WindColumns("wind.speed", "wind.direction", columns.wind.kind),
    )  # fmt: skip
    return Canonical(ColumnTable(first, {"time": t, **known}), plain)


def _check_complete(source: Source, channels: Mapping[str, Channel]) -> None:
    """Raise RecordingError if a column has empty cells."""
    for name, channel in channels.items():
        empty = np.isnan(channel.values) | np.isnan(channel.t)
        if np.any(empty):
            row = int(np.argmax(empty))
            place = source.cell(row, next(iter(source.columns))).place
            raise RecordingError(
                f"{source.path}, columns.{name}, {place}: got an empty cell, expected a number in "
                "each; excitation.resample_hz=RATE joins columns with cells between their samples"
            )


def _rate(channels: Mapping[str, Channel]) -> float:
    """The sample rate [Hz] of the slowest state, rounded to a number of few digits."""
    steps = [float(np.median(np.diff(c.t))) for c in channels.values() if not c.held and len(c.t)]
    return float(f"{1.0 / max(steps):.2g}")


def _clean(channel: Channel) -> Channel:
    """The channel without empty cells, and without samples that are not later than the last."""
    valid = ~(np.isnan(channel.values) | np.isnan(channel.t))
    t, values = channel.t[valid], channel.values[valid]
    later = is_later(t)
    return Channel(t[later], values[later], channel.held)


def _channels(
    sources: Sources, columns: ColumnMap, dofs: Sequence[str]
) -> tuple[dict[str, Channel], dict[str, Source]]:
    """The channels in SI units, by option, and the sources that hold them."""
    time = as_column(columns.time)
    clocks: dict[str, Array] = {}
    channels, holders = {}, {}
    start, pace = first_time(sources, columns), froude_factor("s", columns.froude_scale)
    for option, spec in wanted(columns, dofs).items():
        source, name = column(sources, spec.name)
        if source.name not in clocks:
            clocks[source.name] = seconds(source, _time_of(time, source))
        kind = option.partition(".")[0]
        values = _in_si(source, name, option, spec)
        values = values * _froude(option, spec, source.units.get(name), columns.froude_scale)
        delay = columns.delay_s.get(source.name, columns.delay_s.get(kind, 0.0))
        channels[option] = Channel(
            pace * (clocks[source.name] - delay), values, kind in HELD_SIGNALS
        )
        holders[option] = source
    if not channels:
        raise ConfigurationError("excitation.columns: got none for the vessel, expected some")
    if start > EPOCH_S:  # times since 1970: only differences matter
        channels = {
            name: Channel(channel.t - pace * start, channel.values, channel.held)
            for name, channel in channels.items()
        }
    return _unit_quaternions(channels), holders


def first_time(sources: Sources, columns: ColumnMap) -> float:
    """The first time [s] of all sources that have one, so that it does not depend on the vessel."""
    firsts = []
    for source in sources.values():
        try:
            firsts.append(float(seconds(source, _time_of(as_column(columns.time), source))[0]))
        except (RecordingError, ConfigurationError):
            continue
    return min(firsts, default=0.0)


def _time_of(time: Column, source: Source) -> Column:
    """The time of a source: `source:column` is of that one, others have a column of that name."""
    if source.find(time.name) is None and ":" in time.name:
        plain = time.name.rpartition(":")[2]
        return replace(time, column=plain)
    return time


def wanted(columns: ColumnMap, dofs: Sequence[str]) -> dict[str, Column]:
    """The columns that a vessel needs, by option."""
    result: dict[str, Column] = {}
    turned = columns.frames != Frames() or any(columns.lever_arm_m) or columns.geodetic is not None
    for kind in KINDS:
        named: Mapping[str, str | Column] = getattr(columns, kind)
        for dof, name in named.items():
            by_pose = kind in ("position", "velocity") and (turned or dof in DOFS[3:])
            needed = dof in dofs or by_pose or (kind == "position" and not columns.velocity)
            replaced = kind == "position" and (
                (columns.orientation is not None and dof in DOFS[3:])
                or (columns.geodetic is not None and dof in DOFS[:3])
            )
            if needed and not replaced:
                result[f"{kind}.{dof}"] = as_column(name)
    if columns.orientation is not None:
        names = zip(QUATERNION, columns.quaternion, strict=True)
        result |= {f"quaternion.{part}": Column(name) for part, name in names}
    if columns.geodetic is not None:
        where = columns.geodetic
        result |= {
            "geodetic.latitude": Column(where.latitude),
            "geodetic.longitude": Column(where.longitude),
        }
        if where.altitude is not None:
            result["geodetic.altitude"] = Column(where.altitude)
    by_name = {"inputs": columns.inputs, "commands": columns.commands, "loads": columns.loads}
    for kind, inputs in by_name.items():
        result |= {f"{kind}.{name}": as_column(spec) for name, spec in inputs.items()}
    if columns.wind is not None and set(PLANAR) <= set(dofs):
        result["wind.speed"] = as_column(columns.wind.speed)
        result["wind.direction"] = as_column(columns.wind.direction)
    return result


def _in_si(source: Source, name: str, option: str, spec: Column) -> Array:
    """A column in SI units, with its sign, its sense and without jumps of angles."""
    kind, _, dof = option.partition(".")
    values = source.numbers(name, gaps=True)
    if spec.full is not None:
        values = (values - spec.neutral) / (spec.full - spec.neutral)
    values = values * spec.sign
    unit = spec.unit or source.units.get(name)
    if kind in ("inputs", "commands"):
        return values * (input_factor(unit) if unit and (spec.unit or _is_input(unit)) else 1.0)
    if kind not in SI and kind != "loads":
        return values
    target = "N" if kind == "loads" else SI[kind][dof]
    if unit and (spec.unit or is_known(unit, target)):
        values = values * factor(unit, target)
    if option == "wind.direction":
        values = _unrolled(values)
    if kind == "position" and dof in DOFS[3:]:
        values = _unrolled(values)
        if spec.positive == "anticlockwise":
            values = -values
        if spec.zero == "east":
            values = values + 0.5 * np.pi
    return values


def _froude(option: str, spec: Column, unit: str | None, scale: float) -> float:
    """The factor of a column in SI units by Froude's law; 1 for what is of the same size."""
    if scale == 1.0:
        return 1.0
    kind, _, dof = option.partition(".")
    if kind in ("inputs", "commands"):
        known = spec.unit or unit
        if known is None:
            raise ConfigurationError(
                f"columns.{option}: got no unit, expected one, on which froude_scale={scale:g} "
                "depends"
            )
        return froude_factor(known, scale)
    if kind == "geodetic":
        raise ConfigurationError("columns.geodetic: froude_scale needs a position in metres")
    if kind == "loads":
        return froude_factor("N", scale)
    return froude_factor(SI[kind][dof], scale) if kind in SI else 1.0


def _is_input(unit: str) -> bool:
    try:
        input_factor(unit)
    except ConfigurationError:
        return False
    return True


def _unrolled(angles: Array) -> Array:
    result, valid = angles.copy(), ~np.isnan(angles)
    result[valid] = unroll(angles[valid])
    return result


def _unit_quaternions(channels: dict[str, Channel]) -> dict[str, Channel]:
    """Channels with quaternions of length one, without sign flips."""
    names = [f"quaternion.{part}" for part in QUATERNION]
    if names[0] not in channels:
        return channels
    quaternions = np.column_stack([channels[name].values for name in names])
    lengths = np.linalg.norm(quaternions, axis=1)
    if np.any(np.abs(lengths - 1.0) > LENGTH):
        k = int(np.argmax(np.abs(lengths - 1.0) > LENGTH))
        raise RecordingError(
            f"columns.orientation, sample {k + 1}: got a quaternion of length {lengths[k]:.3g}, "
            "expected 1"
        )
    units = without_sign_flips(quaternions / lengths[:, None])
    new = {
        name: channels[name]._replace(values=values)
        for name, values in zip(names, units.T, strict=True)
    }
    return {**channels, **new}


def _in_our_frames(
    t: Array, known: Mapping[str, Array], columns: ColumnMap, heading: float
) -> dict[str, Array]:
    """Columns by option in NED and forward, right, down axes at the origin of the vessel."""
    composed = ("quaternion", "geodetic")
    result = {name: v for name, v in known.items() if name.partition(".")[0] not in composed}
    frames, n = columns.frames, len(t)
    attitude = _attitude(known, frames, n)
    for i, dof in enumerate(DOFS[3:]):
        if f"position.{dof}" in known or "quaternion.w" in known:
            result[f"position.{dof}"] = attitude[:, i].copy()
    attitude[:, 2] -= heading
    if columns.geodetic is not None:
        path = _path(known, columns.geodetic)
        result |= {f"position.{dof}": path[:, i] for i, dof in enumerate(DOFS[:3])}
    elif frames.position == "ENU":
        result |= _exchanged(known, "position")
    period = float(np.median(np.diff(t)))
    if frames.velocity == "earth":
        result |= _along_body(result, attitude, frames)
    elif frames.body == "FLU":
        result |= {f"velocity.{dof}": -result[f"velocity.{dof}"] for dof in FLIPPED
                   if f"velocity.{dof}" in result}  # fmt: skip
    result |= _differentiated(t, result, attitude, period)
    if any(columns.lever_arm_m):
        result |= _moved(result, attitude, np.array(columns.lever_arm_m))
    return result


def _attitude(known: Mapping[str, Array], frames: Frames, n: int) -> Array:
    """(phi, theta, psi) [rad] in NED, shape (N, 3)."""
    if "quaternion.w" in known:
        attitude = euler_zyx(np.column_stack([known[f"quaternion.{p}"] for p in QUATERNION]))
    else:
        zero = np.zeros(n)
        attitude = np.column_stack([known.get(f"position.{dof}", zero) for dof in DOFS[3:]])
    if frames.attitude == "ENU":
        attitude = attitude * [1.0, -1.0, -1.0] + [0.0, 0.0, 0.5 * np.pi]
    attitude[:, 2] = unroll(attitude[:, 2])
    return np.asarray(attitude)


def _path(known: Mapping[str, Array], where: Geodetic) -> Array:
    """North, east and down [m] of the origin, shape (N, 3), on WGS 84."""
    latitude, longitude = known["geodetic.latitude"], known["geodetic.longitude"]
    altitude = known.get("geodetic.altitude", np.zeros(len(latitude)))
    origin = where.origin or (latitude[0], longitude[0], altitude[0])
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


def _along_body(known: Mapping[str, Array], attitude: Array, frames: Frames) -> dict[str, Array]:
    """Body velocities of those along the axes of the earth; angular ones are of the body."""
    if frames.position == "ENU":
        known = {**known, **_exchanged(known, "velocity")}
    zero = np.zeros(len(attitude))
    earth = np.column_stack([known.get(f"velocity.{dof}", zero) for dof in DOFS[:3]])
    body = np.einsum("nji,nj->ni", pose_jacobian(attitude)[:, :3, :3], earth)
    return {
        f"velocity.{dof}": body[:, i]
        for i, dof in enumerate(DOFS[:3])
        if f"velocity.{dof}" in known
    }


def _differentiated(
    t: Array, known: Mapping[str, Array], attitude: Array, period: float
) -> dict[str, Array]:
    """Body velocities that were not recorded, from the pose through the attitude.

    The pose is low-passed forward and backward where its density first reaches four times its
    noise floor, so that the derivative holds motion and not the noise.
    """
    absent = [dof for dof in DOFS if f"position.{dof}" in known and f"velocity.{dof}" not in known]
    if not absent:
        return {}
    starts = np.diff(t, prepend=-np.inf) > 1.5 * period
    zero = np.zeros(len(t))
    pose = np.column_stack([known.get(f"position.{dof}", zero) for dof in DOFS])
    rate = np.zeros_like(pose)
    edges = [*np.flatnonzero(starts).tolist(), len(t)]
    cutoff = noise_floor(pose, starts, period).cutoff_hz
    for a, b in pairwise(edges):
        piece = pose[a:b]
        if cutoff is not None and cutoff < 0.45 / period and b - a > MIN_PIECE:
            piece = lowpass(piece, cutoff, period)
        rate[a:b] = np.gradient(piece, period, axis=0) if b - a > 1 else 0.0
    jacobian = pose_jacobian(attitude)
    nu = np.empty_like(rate)
    nu[:, :3] = np.einsum("nji,nj->ni", jacobian[:, :3, :3], rate[:, :3])
    nu[:, 3:] = np.linalg.solve(jacobian[:, 3:, 3:], rate[:, 3:, None])[:, :, 0]
    return {f"velocity.{dof}": nu[:, DOFS.index(dof)] for dof in absent}


def _moved(known: Mapping[str, Array], attitude: Array, arm: Array) -> dict[str, Array]:
    """Position and velocity of the origin, from those of a sensor at `arm` [m] in body axes.

    p_o = p_s - R r, v_o = v_s - omega x r.
    """
    zero = np.zeros(len(attitude))
    turn = pose_jacobian(attitude)[:, :3, :3]
    omega = np.column_stack([known.get(f"velocity.{dof}", zero) for dof in DOFS[3:]])
    offset, speed = turn @ arm, np.cross(omega, arm)
    result = {}
    for i, dof in enumerate(DOFS[:3]):
        for kind, part in (("position", offset), ("velocity", speed)):
            if f"{kind}.{dof}" in known:
                result[f"{kind}.{dof}"] = known[f"{kind}.{dof}"] - part[:, i]
    return result
