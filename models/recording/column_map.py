"""Which columns of a file are what: names by degree of freedom, with signs."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.notation import DOFS
from seatrial.models.recording.csv_table import Table
from seatrial.models.recording.preprocessing import without_sign_flips
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import euler_zyx, unroll

KINDS = ("position", "velocity", "acceleration", "force", "actual_force")
NORM_TOLERANCE = 0.05  # of a quaternion's length: more is not rounding but a wrong column


@dataclass(frozen=True)
class ColumnMap:
    """Names of a file's columns, by degree of freedom; a leading minus changes the sign.

    Positions [m] (angles [rad] where there is no `orientation`), body velocities [m/s, rad/s],
    body accelerations [m/s^2, rad/s^2] where recorded, commanded forces [N, Nm], acting forces
    where recorded, time [s], orientation as the quaternion (w, x, y, z) of the body.
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
        """Raise ConfigurationError when a degree of freedom has no column."""
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
        """Names of the columns that a vessel of these degrees of freedom needs."""
        maps = (self.velocity, self.force, self._poses(), self.acceleration, self.actual_force)
        names = [_plain(one[dof]) for one in maps for dof in dofs if dof in one]
        turning = any(dof in DOFS[3:] for dof in dofs)
        return [self.time, *names, *((self.orientation or ()) if turning else ())]

    def angles(self) -> list[str]:
        """Names of the columns that hold angles of the pose, which may jump by a full turn."""
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
        """The table with quaternions of length one and without sign flips, angles unrolled.

        `angles` names columns of other angles [rad] than those of the pose. Raises
        RecordingError where a quaternion is far from length one.
        """
        columns = dict(table.columns)
        for name in (*self.angles(), *angles):
            if name in columns:  # a vessel may not need it
                known = ~np.isnan(columns[name])
                columns[name] = columns[name].copy()
                columns[name][known] = unroll(columns[name][known])
        if self.orientation is not None and _all_in(table, self.orientation):
            quaternions = np.column_stack([columns[name] for name in self.orientation])
            known = ~np.any(np.isnan(quaternions), axis=1)
            lengths = np.linalg.norm(quaternions, axis=1)
            _check_lengths(table, lengths, self.orientation)
            quaternions[~known] = np.nan
            unit = quaternions[known] / lengths[known, None]
            quaternions[known] = without_sign_flips(unit)
            columns |= dict(zip(self.orientation, quaternions.T, strict=True))
        return replace(table, columns=columns)

    def _poses(self) -> Mapping[str, str]:
        """The position columns in use: angles come from the orientation where it is recorded."""
        own = DOFS if self.orientation is None else DOFS[:3]
        return {dof: name for dof, name in self.position.items() if dof in own}


def _check_lengths(table: Table, lengths: Array, names: Sequence[str]) -> None:
    wrong = np.abs(lengths - 1.0) > NORM_TOLERANCE  # False where it is not known
    if np.any(wrong):
        k = int(np.argmax(wrong))
        raise RecordingError(
            f"{table.path}, columns {', '.join(names)}, line {table.line(k)}: got a quaternion of "
            f"length {lengths[k]:.3g}, expected 1"
        )


def _all_in(table: Table, names: Iterable[str]) -> bool:
    return all(name in table.columns for name in names)


def _plain(name: str) -> str:
    return name.removeprefix("-")


def _signed(table: Table, name: str) -> Array:
    values = table.columns[_plain(name)]
    return -values if name.startswith("-") else values
