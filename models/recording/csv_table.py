"""Reads CSV files as columns of numbers and maps the columns; errors name file, line and column."""

import csv
import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING

import numpy as np

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.notation import DOFS
from seatrial.models.recording.preprocessing import without_sign_flips
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import euler_zyx, unroll

if TYPE_CHECKING:
    import pyarrow as pa

LARGEST_BLOCK = 2**31 - 1  # bytes that pyarrow parses at once
LARGEST = 1e30  # larger numbers are not measurements, and their squares could overflow
NUMBER = r"^(?P<number>[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)$"
MISSING = r"^([+-]?[nN][aA][nN])?$"
KINDS = ("position", "velocity", "acceleration", "force", "actual_force")
NORM_TOLERANCE = 0.05  # of the length of a quaternion: a larger error means a wrong column


@dataclass(frozen=True, eq=False)
class Table:
    """Numeric columns of a CSV file with one header line; NaN for an empty cell."""

    path: Path
    columns: dict[str, Array]  # (N,) each

    def line(self, row: int) -> int:
        """Number of the line on which a row ends, for messages; reads the file again."""
        return next(islice(_cells(self.path, _text(self.path)), row + 1, None))[0]


def read_table(
    path: Path, required: Sequence[str], optional: Sequence[str] = (), *, gaps: bool = False
) -> Table:
    """Read the `required` columns, and those `optional` columns that exist.

    `gaps` allows empty cells and NaN. Raises RecordingError if the file cannot be read, a required
    column is missing, or a cell of these columns is not a finite number.
    """
    text = _text(path)
    head = list(islice(_cells(path, text), 2))
    if len(head) < 2:
        raise RecordingError(f"{path}: got a header and no rows, expected samples below it")
    line, header = head[0][0], [name.strip() for name in head[0][1]]
    for name in required:
        if name not in header:
            listing = shorten(", ".join(header), 600, placeholder=" ...")
            raise RecordingError(f"{path}: no column {name!r}, expected it among {listing}")
    names = list(dict.fromkeys((*required, *(name for name in optional if name in header))))
    for name in names:
        if header.count(name) > 1:
            raise RecordingError(f"{path}: {header.count(name)} columns {name!r}, expected one")
    texts = _texts(path, text, line, len(header), [header.index(name) for name in names])
    table = Table(path, {})
    for name, cells in zip(names, texts, strict=True):
        table.columns[name] = _numbers(table, name, cells, gaps)
    return table


def _texts(
    path: Path, text: str, header_line: int, width: int, indices: Sequence[int]
) -> "list[pa.ChunkedArray]":
    """The columns at the given indices, below the header, as text without surrounding spaces."""
    import pyarrow as pa  # slow to import
    from pyarrow import compute as pc
    from pyarrow import csv as arrow_csv

    data, names = text.encode(), [str(index) for index in range(width)]
    types = {names[index]: pa.string() for index in indices}
    try:
        table = arrow_csv.read_csv(
            pa.py_buffer(data),
            arrow_csv.ReadOptions(
                use_threads=False,
                block_size=min(len(data), LARGEST_BLOCK),
                skip_rows=header_line,
                column_names=names,
            ),
            arrow_csv.ParseOptions(newlines_in_values=True),
            arrow_csv.ConvertOptions(
                include_columns=list(types), column_types=types, strings_can_be_null=False
            ),
        )
    except pa.ArrowInvalid as error:
        raise _not_a_row(path, text, width, str(error)) from error
    return [pc.utf8_trim_whitespace(column) for column in table.columns]


def _not_a_row(path: Path, text: str, width: int, reason: str) -> RecordingError:
    """Error for the first row whose length differs from the header, else the reader's reason."""
    for line, row in _cells(path, text):
        if len(row) != width:
            return RecordingError(
                f"{path}, line {line}: got {len(row)} cells, expected {width} as in the header"
            )
    return RecordingError(f"{path}: {shorten(reason, 600)}, expected comma-separated values")


def _numbers(table: Table, name: str, cells: "pa.ChunkedArray", gaps: bool) -> Array:
    """Cells as numbers, shape (N,); NaN for a missing number if `gaps` allows it."""
    from pyarrow import compute as pc

    written = pc.struct_field(pc.extract_regex(cells, NUMBER), "number")  # null: not a number
    values = np.array(pc.utf8_ltrim(written, "+").cast("float64").to_numpy())
    wrong = ~(np.abs(values) < LARGEST)
    if gaps:
        wrong &= ~pc.match_substring_regex(cells, MISSING).to_numpy()
    if np.any(wrong):
        row = int(np.argmax(wrong))
        cell = cells[row].as_py()
        got = repr(shorten(cell, 40, placeholder="...")) if cell else "an empty cell"
        raise RecordingError(
            f"{table.path}, column {name}, line {table.line(row)}: got {got}, "
            f"expected a finite number"
        )
    return values


def _cells(path: Path, text: str) -> Iterator[tuple[int, list[str]]]:
    """The line number on which each row ends, and its cells; blank lines are skipped."""
    reader = csv.reader(io.StringIO(text, newline=""))
    try:
        for row in reader:
            if row:
                yield reader.line_num, row
    except csv.Error as error:
        raise RecordingError(
            f"{path}, line {reader.line_num}: {error}, expected comma-separated values"
        ) from error


def _text(path: Path) -> str:
    try:
        if path.is_dir():
            raise RecordingError(f"{path}: is a folder, expected a CSV file")
        if path.exists() and not path.is_file():
            raise RecordingError(f"{path}: is not a regular file, expected a CSV file")
        data = path.read_bytes()
    except FileNotFoundError as error:
        raise RecordingError(f"{path}: there is no such file, expected a CSV file") from error
    except (OSError, ValueError) as error:  # ValueError: a path with a null character
        reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
        shown = str(path).replace("\0", "\\0")
        raise RecordingError(f"{shown}: cannot be read ({reason}), expected a CSV file") from error
    if b"\0" in data:
        line = data.count(b"\n", 0, data.index(b"\0")) + 1
        raise RecordingError(f"{path}, line {line}: got binary data, expected a CSV file")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise RecordingError(
            f"{path}, line {line}: got binary data or text that is not UTF-8, expected a CSV file"
        ) from error
    if not text.strip():
        raise RecordingError(f"{path}: is empty, expected a header and samples")
    return text


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
