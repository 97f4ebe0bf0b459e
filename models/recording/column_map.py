"""Which columns of a recording are what; errors name file, line and column."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.notation import DOFS
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.recording.column import (
    Column,
    Frames,
    Geodetic,
    WindColumns,
    as_column,
    check_dofs,
)
from seatrial.models.recording.preprocessing import without_sign_flips
from seatrial.models.recording.sources import ReadOptions, Source, column, read_sources
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import euler_zyx, unroll

KINDS = ("position", "velocity", "acceleration", "force", "actual_force")
NORM_TOLERANCE = 0.05  # of the length of a quaternion: a larger error means a wrong column


@dataclass(frozen=True, eq=False)
class ColumnTable:
    """Columns of numbers on one clock; NaN for an empty cell."""

    source: Source
    columns: dict[str, Array]  # (N,) each

    @property
    def path(self) -> Path:
        """The file, for messages."""
        return self.source.path

    def place(self, row: int) -> str:
        """Where a row stands in its file, for messages, such as "line 7"; reads the file again."""
        return self.source.cell(row, next(iter(self.source.columns))).place


def read_table(
    path: Path,
    required: Sequence[str],
    optional: Sequence[str] = (),
    options: ReadOptions | None = None,
    *,
    gaps: bool = False,
) -> ColumnTable:
    """Read the `required` columns of a file, and those `optional` columns that exist.

    `gaps` allows empty cells and NaN. Raises RecordingError if the file cannot be read, a required
    column is missing or of another clock than the first, or a cell of these columns is not a
    finite number.
    """
    sources = read_sources(path, options or ReadOptions())
    source = column(sources, required[0])[0]
    columns = {}
    for name in required:
        holder, plain = column(sources, name)
        if holder is not source:
            raise RecordingError(
                f"{path}: column {name!r} is of {holder.name}, {required[0]!r} of {source.name}: "
                "expected columns of one clock"
            )
        columns[name] = source.numbers(plain, gaps=gaps)
    for name in optional:
        if (known := source.find(name)) is not None and name not in columns:
            columns[name] = source.numbers(known, gaps=gaps)
    return ColumnTable(source, columns)


@dataclass(frozen=True)
class ColumnMap:
    """Names of a file's columns, by degree of freedom; a leading minus changes the sign.

    Positions [m] (and angles [rad] if there is no `orientation`), body velocities [m/s, rad/s],
    body accelerations [m/s^2, rad/s^2] if recorded, commanded forces [N, Nm], acting forces
    if recorded, time [s], orientation as the quaternion (w, x, y, z) of the body, also by part.
    A `Column` states another unit or sense. `inputs` and `commands` of the inputs of a vessel are
    by their names. `lever_arm_m` is where the sensor of position and velocity is in body axes,
    `delay_s` by how much a source, or the columns of a kind, are behind. `loads` are measured on
    devices [N], by names such as `propeller.thrust`. `froude_scale` is the length of what was
    recorded over that of the vessel, to which all columns are scaled by Froude's law.
    """

    time: str | Column
    position: dict[str, str | Column]
    velocity: dict[str, str | Column]
    acceleration: dict[str, str | Column]
    force: dict[str, str | Column]
    actual_force: dict[str, str | Column]
    orientation: tuple[str, str, str, str] | dict[str, str] | None
    inputs: dict[str, str | Column] = field(default_factory=dict)
    commands: dict[str, str | Column] = field(default_factory=dict)
    geodetic: Geodetic | None = None
    frames: Frames = field(default_factory=Frames)
    lever_arm_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    delay_s: dict[str, float] = field(default_factory=dict)
    loads: dict[str, str | Column] = field(default_factory=dict)
    froude_scale: Positive = 1.0
    wind: WindColumns | None = None

    def __post_init__(self) -> None:
        check_ranges(self)
        for kind in KINDS:
            check_dofs(kind, getattr(self, kind))
        if isinstance(self.orientation, dict) and set(self.orientation) != set("wxyz"):
            raise ConfigurationError(
                f"columns.orientation: got {', '.join(self.orientation)}, expected w, x, y, z"
            )

    @property
    def is_plain(self) -> bool:
        """Whether all columns are of one clock, in our units and frames."""
        named = [
            self.time, *(name for kind in KINDS for name in getattr(self, kind).values()),
        ]  # fmt: skip
        bare = not (
            self.inputs or self.commands or self.geodetic or self.delay_s or self.loads or self.wind
        )
        return (
            bare
            and self.frames == Frames()
            and not any(self.lever_arm_m)
            and self.froude_scale == 1.0
            and not isinstance(self.orientation, dict)
            and all(isinstance(name, str) and ":" not in name for name in named)
        )

    @property
    def quaternion(self) -> tuple[str, ...]:
        """Columns of the quaternion (w, x, y, z)."""
        names = self.orientation or ()
        return tuple(names[part] for part in "wxyz") if isinstance(names, dict) else tuple(names)

    def check(self, dofs: Sequence[str]) -> None:
        """Raise ConfigurationError if a degree of freedom has no column."""
        # A velocity may be differentiated from the pose, and a steered vessel has no force.
        needed = {"velocity": self.is_plain, "force": not self.inputs, "position": True}
        for kind in (kind for kind, wanted in needed.items() if wanted):
            known = set(getattr(self, kind))
            if kind == "position" and self.orientation is not None:
                known |= set(DOFS[3:])
            if kind == "position" and self.geodetic is not None:
                known |= set(DOFS[:3])
            for dof in dofs:
                if dof not in known:
                    raise ConfigurationError(
                        f"excitation.columns.{kind}: no column for {dof}, "
                        f"expected one for each of {', '.join(dofs)}"
                    )

    def required(self, dofs: Sequence[str]) -> list[str]:
        """Names of the columns required for a vessel with these degrees of freedom."""
        maps = (self.velocity, self.force, self._poses(), self.acceleration, self.actual_force)
        names = [_plain(columns[dof]) for columns in maps for dof in dofs if dof in columns]
        turning = any(dof in DOFS[3:] for dof in dofs)
        return [_plain(self.time), *names, *(self.quaternion if turning else ())]

    def angles(self) -> list[str]:
        """Names of the columns with angles of the pose, which may jump by a full turn."""
        return [_plain(name) for dof, name in self._poses().items() if dof in DOFS[3:]]

    def values(self, table: ColumnTable, kind: str, dofs: Iterable[str]) -> Array:
        """Columns of one kind with their signs, shape (N, n_dof)."""
        names = getattr(self, kind)
        return np.column_stack([_signed(table, names[dof]) for dof in dofs])

    def air(
        self, table: ColumnTable, heading: Array, nu: Array, dofs: Sequence[str]
    ) -> Array | None:
        """Velocity of the air over ground in body axes [m/s], shape (N, 2); None if not recorded.

        `heading` (N,) [rad] and the velocities `nu` (N, n_dof) are those of the body.
        """
        if self.wind is None:
            return None
        speed, direction = (_signed(table, name) for name in (self.wind.speed, self.wind.direction))
        apparent = self.wind.kind == "apparent"
        angle = direction if apparent else direction - heading
        air = -speed[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        if apparent:
            air += nu[:, [dofs.index(dof) for dof in ("surge", "sway")]]
        return np.asarray(air)

    def attitude(self, table: ColumnTable, heading: float) -> Array:
        """(phi, theta, psi) [rad], shape (N, 3), psi from `heading`; zero if not recorded."""
        if self.orientation is not None and _all_in(table, self.quaternion):
            quaternions = np.column_stack([table.columns[name] for name in self.quaternion])
            return np.asarray(euler_zyx(quaternions) - [0.0, 0.0, heading])
        angles = np.zeros((len(table.columns[_plain(self.time)]), 3))
        for dof, name in self._poses().items():
            if dof in DOFS[3:] and _all_in(table, (_plain(name),)):
                offset = heading if dof == "yaw" else 0.0
                angles[:, DOFS[3:].index(dof)] = _signed(table, name) - offset
        return angles

    def continuous(self, table: ColumnTable, angles: Iterable[str] = ()) -> ColumnTable:
        """The table with unwrapped angles and with unit quaternions without sign flips.

        `angles` names columns of further angles [rad] that do not belong to the pose. Raises
        RecordingError if the length of a quaternion is far from one.
        """
        columns = dict(table.columns)
        for name in (*self.angles(), *angles):
            if name in columns:  # not every vessel uses it
                valid = ~np.isnan(columns[name])
                columns[name] = columns[name].copy()
                columns[name][valid] = unroll(columns[name][valid])
        if self.orientation is not None and _all_in(table, self.quaternion):
            quaternions = np.column_stack([columns[name] for name in self.quaternion])
            valid = ~np.any(np.isnan(quaternions), axis=1)
            lengths = np.linalg.norm(quaternions, axis=1)
            _check_lengths(table, lengths, self.quaternion)
            quaternions[~valid] = np.nan
            unit = quaternions[valid] / lengths[valid, None]
            quaternions[valid] = without_sign_flips(unit)
            columns |= dict(zip(self.quaternion, quaternions.T, strict=True))
        return replace(table, columns=columns)

    def _poses(self) -> Mapping[str, str | Column]:
        """The position columns in use; angles come from the orientation if it is recorded."""
        dofs = DOFS if self.orientation is None else DOFS[:3]
        return {dof: name for dof, name in self.position.items() if dof in dofs}


def _check_lengths(table: ColumnTable, lengths: Array, names: Sequence[str]) -> None:
    wrong = np.abs(lengths - 1.0) > NORM_TOLERANCE  # False for NaN
    if np.any(wrong):
        k = int(np.argmax(wrong))
        raise RecordingError(
            f"{table.path}, columns {', '.join(names)}, {table.place(k)}: got a quaternion of "
            f"length {lengths[k]:.3g}, expected 1"
        )


def _all_in(table: ColumnTable, names: Iterable[str]) -> bool:
    return all(name in table.columns for name in names)


def _plain(name: str | Column) -> str:
    return name.removeprefix("-") if isinstance(name, str) else name.name


def _signed(table: ColumnTable, name: str | Column) -> Array:
    values = table.columns[_plain(name)]
    sign = as_column(name).sign
    return -values if sign < 0.0 else values
