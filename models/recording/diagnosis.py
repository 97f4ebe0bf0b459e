"""Problems of a recording by name, each with the option that cures it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from seatrial.models.notation import DOFS, VELOCITY_UNIT
from seatrial.models.recording.agreement import CERTAIN, Agreement
from seatrial.models.recording.consistency import LEAST_TRUSTED, Consistency
from seatrial.models.recording.motion import DEGREE, Reading

SAME_SCALE = (
    1.39  # scales within this factor of one are nearer to it than to the next unit, the knot
)
NEAR_SCALE = 1.25  # a scale is that of a unit within this factor
UNNAMED = 2.0  # a scale within this factor that is of no unit is that of a filter or sensor
SAMPLES_APART = 2.0  # a smaller delay is that of a filter or of sampling
CHANGED_SIGN_IN_FLU = ("sway", "heave", "pitch", "yaw")
# What multiplies a recorded value to give the derivative that it is compared with.
VELOCITY_UNITS = {"knot": 1852.0 / 3600.0, "km/h": 1.0 / 3.6, "ft/s": 0.3048, "cm/s": 0.01,
                  "mm/s": 0.001}  # fmt: skip
RATE_UNITS = {"deg/s": DEGREE, "rpm": np.pi / 30.0, "mrad/s": 0.001}
LENGTH_UNITS = {"mm": 1000.0, "cm": 100.0, "ft": 1.0 / 0.3048, "km": 0.001}
ANGLE_UNITS = {"deg": 1.0 / DEGREE}
ACCELERATION_UNITS = {"g_0": 9.80665, "cm/s^2": 0.01, "mm/s^2": 0.001}
TURNING_UNITS = {"deg/s^2": DEGREE}
TIME_UNITS = {"ms": 0.001, "us": 1e-6, "ns": 1e-9, "min": 60.0}
OPTION = "excitation.columns"
Names = Mapping[str, str]  # the recorded column of an option such as velocity.surge


@dataclass(frozen=True)
class RecordingDefect:
    """What is wrong with some axes of a recording, and the option that cures it."""

    kind: str  # scale | sign | swap | earth | frame | heading | clock | time | sampling | unknown
    axes: tuple[str, ...]
    message: str
    cure: str
    value: float | None = None  # the factor, the lag [s], the angle [deg] or the rate [Hz]

    def __str__(self) -> str:
        axes = f"{', '.join(self.axes)}: " if self.axes else ""
        return f"{axes}{self.message}; {self.cure}"


def problems(result: Consistency, names: Names | None = None) -> tuple[RecordingDefect, ...]:
    """All problems of a recording; `names` are the columns that the cures shall show."""
    names, reading = names or {}, result.reading
    axes = [axis for axis in result.best if axis.excited and result.significant(axis)]
    timed = _time(axes)
    found = _frames(reading, axes)
    swaps = _swaps(axes, names)
    signs = _signs(axes, names)
    scales = [timed] if timed else _scales(axes, names)
    clock = _clock(result)
    accelerations = [
        problem
        for axis in result.accelerations
        if axis.excited and (problem := _acceleration(axis, names))
    ]
    found += [*swaps, *signs, *scales, *clock, *accelerations]
    if reading.degrees:
        found.append(_degrees(result, names))
    return (*found, *_unexplained(result, found))


def _frames(reading: Reading, axes: Sequence[Agreement]) -> list[RecordingDefect]:
    """Readings of the pose and of the velocity's axes that differ from ours."""
    linear = tuple(axis.dof for axis in axes if axis.dof in DOFS[:3])
    found = []
    if reading.velocity == "earth":
        found.append(
            RecordingDefect(
                "earth", linear, "the velocities are along the axes of the earth, not of the body",
                f"{OPTION}.frames.velocity=earth",
            )
        )  # fmt: skip
    if reading.position == "ENU":
        found.append(
            RecordingDefect(
                "frame", linear, "the positions are east, north, up, not north, east, down",
                f"{OPTION}.frames.position=ENU",
            )
        )  # fmt: skip
    if reading.heading == "opposite":
        found.append(
            RecordingDefect(
                "heading", ("yaw",), "the heading counts anticlockwise",
                f"{OPTION}.position.yaw: {{positive: anticlockwise}}",
            )
        )  # fmt: skip
    if reading.heading == "east":
        found.append(
            RecordingDefect(
                "heading", ("yaw",), "the attitude is of ENU: the heading counts from east, "
                "anticlockwise", f"{OPTION}.frames.attitude=ENU, or "
                f"{OPTION}.position.yaw: {{zero: east, positive: anticlockwise}}",
            )
        )  # fmt: skip
    if reading.heading_offset:
        degrees = round(np.degrees(reading.heading_offset))
        degrees = degrees - 360 if degrees > 180 else degrees
        found.append(
            RecordingDefect(
                "heading", ("yaw",), f"the heading is {-degrees:g} degrees off the positions",
                f"subtract {degrees:g} from excitation.heading_deg", float(degrees),
            )
        )  # fmt: skip
    return found


def _swaps(axes: Sequence[Agreement], names: Names) -> list[RecordingDefect]:
    """Velocities that belong to other axes than those they are mapped to."""
    found, seen = [], set()
    for axis in axes:
        if axis.other == axis.dof or axis.dof in seen:
            continue
        group, dof = [axis.dof], axis.other
        taken = {a.dof: a.other for a in axes}
        while dof in taken and dof not in group:
            group.append(dof)
            dof = taken[dof]
        if axis.other not in group:
            group.append(axis.other)
        seen |= set(group)
        cures = ", ".join(
            f"{OPTION}.velocity.{a.other}={_column(names, f'velocity.{a.dof}')}"
            for a in axes
            if a.dof in group
        )
        ordered = tuple(dof for dof in DOFS if dof in group)
        found.append(RecordingDefect("swap", ordered, "the velocities are exchanged", cures))
    return found


def _signs(axes: Sequence[Agreement], names: Names) -> list[RecordingDefect]:
    """Velocities of the wrong sign; those of FLU are named together."""
    wrong = [axis.dof for axis in axes if axis.correlation < 0.0]
    expected = [axis.dof for axis in axes if axis.dof in CHANGED_SIGN_IN_FLU]
    if len(wrong) > 1 and wrong == expected and len(axes) > len(wrong):
        return [
            RecordingDefect(
                "frame", tuple(wrong), "the velocities are forward, left, up, not forward, right, "
                "down", f"{OPTION}.frames.body=FLU (or the pose is: {OPTION}.frames.position=ENU "
                f"with {OPTION}.frames.attitude=ENU)",
            )
        ]  # fmt: skip
    return [
        RecordingDefect(
            "sign", (dof,), "the velocity has the wrong sign",
            f"{OPTION}.velocity.{dof}={_reversed(_column(names, f'velocity.{dof}'))}", -1.0,
        )
        for dof in wrong
    ]  # fmt: skip


def _time(axes: Sequence[Agreement]) -> RecordingDefect | None:
    """One factor on all rates, of positions and of angles, is one on time."""
    linear = [axis for axis in axes if axis.dof in DOFS[:3]]
    angular = [axis for axis in axes if axis.dof in DOFS[3:]]
    scale = float(np.median([abs(axis.scale) for axis in axes])) if axes else 1.0
    if not (linear and angular) or not all(_off(axis) for axis in axes):
        return None
    if not all(1.0 / SAME_SCALE < abs(axis.scale) / scale < SAME_SCALE for axis in axes):
        return None
    unit = _nearest(1.0 / scale, {name: 1.0 / factor for name, factor in TIME_UNITS.items()})
    cure = (
        f"{OPTION}.time: {{unit: {unit}}}" if unit else
        f"the samples are {scale:.3g} times as far apart: {OPTION}.time: {{unit: {scale:.3g} s}}"
    )  # fmt: skip
    return RecordingDefect(
        "time", tuple(axis.dof for axis in axes),
        f"the derivative of the pose is {scale:.3g} times the velocity on every axis", cure, scale,
    )  # fmt: skip


def _scales(axes: Sequence[Agreement], names: Names) -> list[RecordingDefect]:
    """Velocities or poses in another unit; axes of one kind in the same unit are named together."""
    found: list[RecordingDefect] = []
    for dofs, rates, poses in (
        (DOFS[:3], VELOCITY_UNITS, LENGTH_UNITS),
        (DOFS[3:], RATE_UNITS, ANGLE_UNITS),
    ):
        groups: dict[tuple[str, str | None, float], list[str]] = {}
        for axis in axes:
            if axis.dof in dofs and _off(axis):
                size = abs(axis.scale)
                velocity, pose = _nearest(size, rates), _nearest(size, poses)
                if not (velocity or pose) and 1.0 / UNNAMED < size < UNNAMED:
                    continue
                kind = "position" if pose and not velocity else "velocity"
                key = (kind, velocity or pose, 0.0 if velocity or pose else size)
                groups.setdefault(key, []).append(axis.dof)
        for (kind, unit, factor), members in groups.items():
            known = {**rates, **poses}
            value = known[unit] if unit else factor
            told = unit or f"{factor:.3g} {VELOCITY_UNIT[members[0]]}"
            cures = _units(kind, members, told, names)
            message = f"the derivative of the pose is {value:.3g} times the velocity"
            found.append(RecordingDefect("scale", tuple(members), message, cures, value))
    return found


def _degrees(result: Consistency, names: Names) -> RecordingDefect:
    """Angles that are in degrees."""
    dofs = tuple(axis.dof for axis in result.velocities if axis.dof in result.reading.degrees)
    cures = _units("position", dofs, "deg", names)
    return RecordingDefect(
        "scale", dofs, "the angles of the pose are in degrees", cures, 1.0 / DEGREE
    )


def _units(kind: str, dofs: Sequence[str], unit: str, names: Names) -> str:
    return ", ".join(
        f"{OPTION}.{kind}.{dof}: {{column: {_column(names, f'{kind}.{dof}')}, unit: {unit}}}"
        for dof in dofs
    )


def _clock(result: Consistency) -> list[RecordingDefect]:
    """A clock of the velocities that is apart from that of the pose."""
    lag = result.lag_s
    # A filter delays some axes, a clock that is apart all of them.
    least = max(SAMPLES_APART * result.period_s, CERTAIN * result.lag_error_s)
    if abs(lag) < least or result.shared_lag_s == 0.0:
        return []
    behind = "behind" if lag > 0.0 else "ahead of"
    message = f"the velocities are {abs(lag):.3g} s {behind} the pose"
    return [RecordingDefect("clock", (), message, f"{OPTION}.delay_s.velocity={lag:.3g}", lag)]


def _acceleration(axis: Agreement, names: Names) -> RecordingDefect | None:
    """A recorded acceleration of the wrong sign or unit."""
    name = f"acceleration.{axis.dof}"
    column = _column(names, name)
    if axis.correlation < -LEAST_TRUSTED:
        return RecordingDefect(
            "sign", (axis.dof,), "the acceleration has the wrong sign",
            f"{OPTION}.{name}={_reversed(column)}", -1.0,
        )  # fmt: skip
    units = ACCELERATION_UNITS if axis.dof in DOFS[:3] else TURNING_UNITS
    unit = _nearest(abs(axis.scale), units)
    if axis.correlation > LEAST_TRUSTED and unit and _off(axis):
        message = f"the derivative of the velocity is {axis.scale:.3g} times the acceleration"
        cure = f"{OPTION}.{name}: {{column: {column}, unit: {unit}}}"
        return RecordingDefect("scale", (axis.dof,), message, cure, units[unit])
    return None


def _unexplained(result: Consistency, found: Sequence[RecordingDefect]) -> list[RecordingDefect]:
    """Excited axes that agree with nothing, and are not named by another problem."""
    named = {dof for problem in found for dof in problem.axes}
    kinds = {problem.kind for problem in found}
    if kinds & {"earth", "frame", "heading", "clock"}:
        return []
    best = {axis.dof: axis for axis in result.best}
    return [
        RecordingDefect(
            "unknown", (axis.dof,),
            f"velocity and derivative of the pose have a correlation of {axis.correlation:.2f}",
            f"another column for {OPTION}.velocity.{axis.dof} or {OPTION}.position.{axis.dof}",
            axis.correlation,
        )
        for axis in result.velocities
        if axis.excited and axis.dof not in named
        and max(axis.correlation, best[axis.dof].correlation) < LEAST_TRUSTED
    ]  # fmt: skip


def _off(axis: Agreement) -> bool:
    """Whether neither regression gives a scale near one."""
    low, high = axis.bounds
    return high < 1.0 / SAME_SCALE or low > SAME_SCALE


def _nearest(size: float, units: Mapping[str, float]) -> str | None:
    """The unit whose factor is nearest to a scale; None if none is near."""
    distance: Callable[[str], float] = lambda unit: abs(np.log(size / units[unit]))  # noqa: E731
    unit = min(units, key=distance)
    return unit if distance(unit) < np.log(NEAR_SCALE) else None


def _column(names: Names, option: str) -> str:
    return names.get(option, "NAME")


def _reversed(column: str) -> str:
    return column.removeprefix("-") if column.startswith("-") else f"-{column}"
