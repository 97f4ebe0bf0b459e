"""All that can be said of a recording before anything is identified from it."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.notation import DOFS, PLANAR
from seatrial.models.recording.column_map import KINDS, Column, ColumnMap, as_column
from seatrial.models.recording.consistency import Consistency, consistency
from seatrial.models.recording.diagnosis import RecordingDefect, problems
from seatrial.models.recording.recording import Recording
from seatrial.models.recording.sampling import of_angles, original_rate, resampled, sampling
from seatrial.models.recording.source import Source, column
from seatrial.models.recording.times import seconds
from seatrial.models.vessel.basis import Array

Read = Callable[[ColumnMap, Sequence[str]], Recording]
MOTION = ("position", "velocity")


@dataclass(frozen=True)
class Examination:
    """The comparison of pose and velocity, and all problems; the recording that was compared."""

    result: Consistency
    problems: tuple[RecordingDefect, ...]
    recording: Recording


def examine(
    read: Read, columns: ColumnMap, sources: Mapping[str, Source], dofs: Sequence[str]
) -> Examination | None:
    """Examine a recording with all degrees of freedom that it holds, else with `dofs`.

    Args:
        read: reads the recording by a map.
        columns: the map.
        sources: the columns as recorded.
        dofs: degrees of freedom of the vessel.

    Returns:
        None if the path cannot be turned into body axes, for lack of the heading.
    """
    angles = of_angles(_angles(columns, sources))
    corrected = replace(columns, position=_in_degrees(columns, angles)) if angles else columns
    for known in (_measured(columns), tuple(dofs)):
        try:
            recording = read(corrected, known)
        except (ConfigurationError, RecordingError):
            continue
        if np.any(recording.attitude) and not set(PLANAR) <= set(known):
            continue
        result = consistency(recording, [dof for dof in known if dof in columns.acceleration])
        names = {
            f"{kind}.{dof}": as_column(name).column
            for kind in KINDS
            for dof, name in getattr(columns, kind).items()
        }
        slower = _resampled(columns, sources)
        if slower and slower[0].value:  # delays are of the samples that were recorded
            result = replace(result, period_s=1.0 / slower[0].value)
        found = (*angles, *slower, *problems(result, names))
        return Examination(result, found, recording)
    return None


def _measured(columns: ColumnMap) -> tuple[str, ...]:
    """Degrees of freedom with a pose, a velocity and a force, or inputs, of their own."""
    poses = set(columns.position) | (set(DOFS[3:]) if columns.orientation else set())
    poses |= set(DOFS[:3]) if columns.geodetic else set()
    forces = set(DOFS) if columns.inputs else set(columns.force)
    return tuple(dof for dof in DOFS if dof in poses & set(columns.velocity) & forces)


def _angles(
    columns: ColumnMap, sources: Mapping[str, Source]
) -> list[tuple[str, str, Array]]:  # fmt: skip
    """Axis, name and values of the angles of the pose that are mapped without a unit."""
    if columns.orientation is not None:
        return []
    known = []
    for dof, spec in columns.position.items():
        plain = as_column(spec)
        if dof in DOFS[3:] and plain.unit is None:
            values = _numbers(sources, plain)
            if values is not None:
                known.append((dof, plain.column, values))
    return known


def _in_degrees(columns: ColumnMap, angles: Sequence[RecordingDefect]) -> dict[str, str | Column]:
    wrong = {dof for problem in angles for dof in problem.axes}
    return {
        dof: replace(as_column(spec), unit="deg") if dof in wrong else spec
        for dof, spec in columns.position.items()
    }


def _resampled(columns: ColumnMap, sources: Mapping[str, Source]) -> list[RecordingDefect]:
    """The problem of a source whose columns of motion were interpolated from a slower one."""
    groups: dict[str, list[Array]] = {}
    for kind in MOTION:
        named: Mapping[str, str | Column] = getattr(columns, kind)
        for dof, spec in named.items():
            values = _numbers(sources, as_column(spec))
            if values is not None:
                part = f"{_place(sources, as_column(spec))}:{kind}{dof in DOFS[3:]}"
                groups.setdefault(part, []).append(values)
    rates: dict[str, tuple[float, list[float | None]]] = {}
    for part, members in groups.items():
        name = part.rpartition(":")[0]
        try:
            rate = sampling(seconds(sources[name], as_column(columns.time))).rate_hz
        except (ConfigurationError, RecordingError):
            continue
        own = original_rate(np.column_stack(members), rate)
        rates.setdefault(name, (rate, []))[1].append(own)
    return [problem for rate, known in rates.values() for problem in resampled(known, rate)]


def _place(sources: Mapping[str, Source], spec: Column) -> str:
    try:
        return column(sources, spec.name)[0].name
    except RecordingError:
        return ""


def _numbers(sources: Mapping[str, Source], spec: Column) -> Array | None:
    """A column as recorded; None if the file has none."""
    try:
        source, name = column(sources, spec.name)
        return source.numbers(name, gaps=True)
    except RecordingError:
        return None
