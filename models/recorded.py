"""Measured recordings: CSV files with a column map."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from models.basis import DOFS, Array
from models.csv_table import Table, read_table
from models.errors import ConfigurationError, RecordingError
from models.kinematics import unroll, wrap
from models.preprocessing import central_difference, euler_zyx, without_sign_flips
from models.recording import Recording

UNIFORMITY = 0.01  # a step may differ from the sample time by this share of it
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
        for kind in ("position", "velocity", "acceleration", "force", "actual_force"):
            for dof, name in getattr(self, kind).items():
                if dof not in DOFS:
                    raise ConfigurationError(
                        f"columns.{kind}: got {dof!r}, expected some of {', '.join(DOFS)}"
                    )
                if not _column(name):
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
        maps = (self.velocity, self.force, self._poses(dofs), self.acceleration, self.actual_force)
        names = [_column(one[dof]) for one in maps for dof in dofs if dof in one]
        turning = any(dof in DOFS[3:] for dof in dofs)
        return [self.time, *names, *((self.orientation or ()) if turning else ())]

    def values(self, table: Table, kind: str, dofs: Sequence[str]) -> Array:
        """Columns of one kind with their signs, shape (N, n_dof)."""
        names = getattr(self, kind)
        return np.column_stack([_signed(table, names[dof]) for dof in dofs])

    def attitude(self, table: Table, heading: float) -> Array:
        """(phi, theta, psi) [rad], shape (N, 3), psi from `heading`; zero if not recorded."""
        if self.orientation is not None and all(n in table.columns for n in self.orientation):
            quaternions = np.column_stack([table.columns[name] for name in self.orientation])
            angles = euler_zyx(without_sign_flips(_unit(quaternions, table, self.orientation)))
            return np.asarray(angles - [0.0, 0.0, heading])
        angles = np.zeros((len(table.lines), 3))
        for i, dof in enumerate(DOFS[3:]):
            name = self.position.get(dof)
            if self.orientation is None and name and _column(name) in table.columns:
                angles[:, i] = _signed(table, name) - (heading if dof == "yaw" else 0.0)
        return angles

    def _poses(self, dofs: Sequence[str]) -> Mapping[str, str]:
        """The position columns in use: angles come from the orientation where it is recorded."""
        own = DOFS if self.orientation is None else DOFS[:3]
        return {dof: name for dof, name in self.position.items() if dof in own and dof in dofs}


@dataclass(frozen=True)
class RecordedFile:
    """A measured CSV file as excitation: read, checked and cut, not simulated.

    The samples strictly between `start_s` and `end_s` are used (null: all), the first
    `train_fraction` of them for training. `sample_time_s` is checked against the file (null:
    taken from it). `heading_deg` is the heading of the frame of the positions in the frame of
    the orientation: 180 where the map turns both horizontal positions round.
    """

    path: str | None
    start_s: float | None
    end_s: float | None
    sample_time_s: float | None
    train_fraction: float
    heading_deg: float
    columns: ColumnMap

    def __post_init__(self) -> None:
        if not self.path:
            raise ConfigurationError("excitation.path: expected a CSV file, got none")
        if self.start_s is not None and self.end_s is not None and self.start_s >= self.end_s:
            raise ConfigurationError(
                f"start_s must lie before end_s = {self.end_s:g}, got {self.start_s:g}"
            )
        if self.sample_time_s is not None and not self.sample_time_s > 0.0:
            raise ConfigurationError(f"sample_time_s must be positive, got {self.sample_time_s:g}")
        if not 0.0 < self.train_fraction < 1.0:
            raise ConfigurationError(
                f"train_fraction must lie between 0 and 1, got {self.train_fraction:g}"
            )

    @property
    def file(self) -> Path:
        """The file, with `~` replaced by the home folder."""
        return Path(self.path or "").expanduser()

    def check(self, dofs: Sequence[str]) -> None:
        """Raise ConfigurationError when the map has no columns for a vessel; reads nothing."""
        self.columns.check(dofs)

    def read(self, dofs: Sequence[str]) -> Recording:
        """The recording of a vessel of these degrees of freedom.

        nu_dot is the central difference of nu where it is not recorded: the low-pass of an
        identifier is linear and commutes with it. Raises RecordingError, naming file, line and
        column.
        """
        self.check(dofs)
        table = read_table(self.file, self.columns.required(dofs), self.columns.orientation or ())
        t = table.columns[self.columns.time]
        period_s = check_time(table, self.columns.time, self.sample_time_s)
        nu = self.columns.values(table, "velocity", dofs)
        nu_dot = central_difference(nu, period_s)
        for i, dof in enumerate(dofs):
            if dof in self.columns.acceleration:
                nu_dot[:, i] = self.columns.values(table, "acceleration", (dof,))[:, 0]
        tau = self.columns.values(table, "force", dofs)
        acting = all(dof in self.columns.actual_force for dof in dofs)
        tau_actual = self.columns.values(table, "actual_force", dofs) if acting else None
        kept = self._window(t)
        attitude = self.columns.attitude(table, np.radians(self.heading_deg))[kept]
        attitude[:, 2] = _heading(attitude[:, 2])
        return Recording(
            tuple(dofs), t[kept], self._pose(table, kept, attitude, dofs), nu[kept], nu_dot[kept],
            tau[kept], attitude, tau_actual=None if tau_actual is None else tau_actual[kept],
        )  # fmt: skip

    def _pose(
        self, table: Table, kept: NDArray[np.bool_], attitude: Array, dofs: Sequence[str]
    ) -> Array:
        poses = []
        for dof in dofs:
            if dof in DOFS[3:]:
                poses.append(attitude[:, DOFS[3:].index(dof)])
            else:
                poses.append(self.columns.values(table, "position", (dof,))[kept, 0])
        return np.column_stack(poses)

    def _window(self, t: Array) -> NDArray[np.bool_]:
        """The samples strictly between `start_s` and `end_s`."""
        start = -np.inf if self.start_s is None else self.start_s
        end = np.inf if self.end_s is None else self.end_s
        kept = (start < t) & (t < end)
        if np.count_nonzero(kept) < 2:
            raise RecordingError(
                f"{self.file}: got {np.count_nonzero(kept)} samples with {start:g} < t < {end:g} s,"
                f" expected at least 2; the file holds {t[0]:g} to {t[-1]:g} s"
            )
        return kept


def check_time(table: Table, name: str, sample_time_s: float | None) -> float:
    """The sample time [s] of an increasing, uniform time column.

    Raises RecordingError at the first step that is not within 1 % of `sample_time_s` (null: of
    the median step).
    """
    t = table.columns[name]
    if len(t) < 2:
        raise RecordingError(f"{table.path}: got {len(t)} samples, expected at least 2")
    check_increasing(table, name)
    steps = np.diff(t)
    period = float(np.median(steps)) if sample_time_s is None else sample_time_s
    wrong = np.abs(steps - period) > UNIFORMITY * period
    if np.any(wrong):
        k = int(np.argmax(wrong))
        raise RecordingError(
            f"{table.path}, column {name}, line {table.lines[k + 1]}: got a step of "
            f"{steps[k]:.6g} s, expected a uniform sample time of {period:.6g} s"
        )
    return float((t[-1] - t[0]) / (len(t) - 1))


def check_increasing(table: Table, name: str) -> None:
    """Raise RecordingError at the first time that does not come after the one before."""
    t = table.columns[name]
    wrong = np.diff(t) <= 0.0
    if np.any(wrong):
        k = int(np.argmax(wrong))
        raise RecordingError(
            f"{table.path}, column {name}, line {table.lines[k + 1]}: got {t[k + 1]:.6f} s after "
            f"{t[k]:.6f} s, expected time to increase"
        )


def _heading(psi: Array) -> Array:
    """Headings [rad] without jumps, the first one in (-pi, pi]."""
    return unroll(np.concatenate([[wrap(psi[0])], psi[1:]]))


def _column(name: str) -> str:
    return name.removeprefix("-")


def _signed(table: Table, name: str) -> Array:
    values = table.columns[_column(name)]
    return -values if name.startswith("-") else values


def _unit(quaternions: Array, table: Table, names: Sequence[str]) -> Array:
    """Quaternions of length one; RecordingError where they are far from it."""
    lengths = np.linalg.norm(quaternions, axis=1)
    wrong = np.abs(lengths - 1.0) > NORM_TOLERANCE
    if np.any(wrong):
        k = int(np.argmax(wrong))
        raise RecordingError(
            f"{table.path}, columns {', '.join(names)}, line {table.lines[k]}: got a quaternion of "
            f"length {lengths[k]:.3g}, expected 1"
        )
    return np.asarray(quaternions / lengths[:, None])
