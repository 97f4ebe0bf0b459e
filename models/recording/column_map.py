"""Which columns of a recording are what; errors name file, line and column."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.notation import DOFS
from seatrial.models.recording.preprocessing import without_sign_flips
from seatrial.models.recording.sources import ReadOptions, Source, column, read_sources
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import euler_zyx, unroll

KINDS = ("position", "velocity", "acceleration", "force", "actual_force")
NORM_TOLERANCE = 0.05  # of the length of a quaternion: a larger error means a wrong column


@dataclass(frozen=True, eq=False)
class Table:
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
) -> Table:
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
    return Table(source, columns)


@dataclass(frozen=True)
class ColumnMap:
    """Names of a file's columns, by degree of freedom; a leading minus changes the sign.

    Positions [m] (and angles [rad] if there is no `orientation`), body velocities [m/s, rad/s],
    body accelerations [m/s^2, rad/s^2] if recorded, commanded forces [N, Nm], acting forces
    if recorded, time [s], orientation as the quaternion (w, x, y, z) of the body.
    """

    time: str
    position: dict[str, str]
    velocity: dict[str, str]
    acceleration: dict[str, str]
    force: dict[str, str]
    actual_force: dict[str, str]
    orientation: tuple[str, str, str, str] | None

    def __post_init__(self) -> None:
        for kind in KINDS:
            for dof, name in getattr(self, kind).items():
                if dof not in DOFS:
                    raise ConfigurationError(
                        f"columns.{kind}: got {dof!r}, expected some of {', '.join(DOFS)}"
                    )
                if not _plain(name):
                    raise ConfigurationError(
                        f"columns.{kind}.{dof}: got {name!r}, expected the name of a column"
                    )

    def check(self, dofs: Sequence[str]) -> None:
        """Raise ConfigurationError if a degree of freedom has no column."""
        for kind in ("velocity", "force", "position"):
            known = set(getattr(self, kind))
            if kind == "position" and self.orientation is not None:
                known |= set(DOFS[3:])
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
        return [self.time, *names, *((self.orientation or ()) if turning else ())]

    def angles(self) -> list[str]:
        """Names of the columns with angles of the pose, which may jump by a full turn."""
        return [_plain(name) for dof, name in self._poses().items() if dof in DOFS[3:]]

    def values(self, table: Table, kind: str, dofs: Iterable[str]) -> Array:
        """Columns of one kind with their signs, shape (N, n_dof)."""
        names = getattr(self, kind)
        return np.column_stack([_signed(table, names[dof]) for dof in dofs])

    def attitude(self, table: Table, heading: float) -> Array:
        """(phi, theta, psi) [rad], shape (N, 3), psi from `heading`; zero if not recorded."""
        if self.orientation is not None and _all_in(table, self.orientation):
            quaternions = np.column_stack([table.columns[name] for name in self.orientation])
            return np.asarray(euler_zyx(quaternions) - [0.0, 0.0, heading])
        angles = np.zeros((len(table.columns[self.time]), 3))
        for dof, name in self._poses().items():
            if dof in DOFS[3:] and _all_in(table, (_plain(name),)):
                offset = heading if dof == "yaw" else 0.0
                angles[:, DOFS[3:].index(dof)] = _signed(table, name) - offset
        return angles

    def continuous(self, table: Table, angles: Iterable[str] = ()) -> Table:
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
        if self.orientation is not None and _all_in(table, self.orientation):
            quaternions = np.column_stack([columns[name] for name in self.orientation])
            valid = ~np.any(np.isnan(quaternions), axis=1)
            lengths = np.linalg.norm(quaternions, axis=1)
            _check_lengths(table, lengths, self.orientation)
            quaternions[~valid] = np.nan
            unit = quaternions[valid] / lengths[valid, None]
            quaternions[valid] = without_sign_flips(unit)
            columns |= dict(zip(self.orientation, quaternions.T, strict=True))
        return replace(table, columns=columns)

    def _poses(self) -> Mapping[str, str]:
        """The position columns in use; angles come from the orientation if it is recorded."""
        dofs = DOFS if self.orientation is None else DOFS[:3]
        return {dof: name for dof, name in self.position.items() if dof in dofs}


def _check_lengths(table: Table, lengths: Array, names: Sequence[str]) -> None:
    wrong = np.abs(lengths - 1.0) > NORM_TOLERANCE  # False for NaN
    if np.any(wrong):
        k = int(np.argmax(wrong))
        raise RecordingError(
            f"{table.path}, columns {', '.join(names)}, {table.place(k)}: got a quaternion of "
            f"length {lengths[k]:.3g}, expected 1"
        )


def _all_in(table: Table, names: Iterable[str]) -> bool:
    return all(name in table.columns for name in names)


def _plain(name: str) -> str:
    return name.removeprefix("-")


def _signed(table: Table, name: str) -> Array:
    values = table.columns[_plain(name)]
    return -values if name.startswith("-") else values
