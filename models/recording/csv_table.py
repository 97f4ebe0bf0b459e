"""CSV files as columns of numbers, with errors that name file, line and column."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import shorten

import numpy as np

from seatrial.models.errors import RecordingError
from seatrial.models.vessel.basis import Array, Codes

UNIFORMITY = 0.01  # a step may differ from the sample time by this share of it
LARGEST = 1e30  # what is larger was not measured, and its square is not far from overflow


@dataclass(frozen=True, eq=False)
class Table:
    """Number columns of a CSV file with one header line; NaN where a cell is empty."""

    path: Path
    lines: Codes  # (N,) line of the file that each row ends on, for messages
    columns: dict[str, Array]  # (N,) each
    present: tuple[str, ...]  # names of all columns of the file


def read_table(
    path: Path, required: Sequence[str], optional: Sequence[str] = (), *, gaps: bool = False
) -> Table:
    """The `required` columns, and the `optional` ones that are there.

    `gaps` allows empty cells and NaN. RecordingError when the file cannot be read, a required
    column is missing, or a cell of one of these columns is not a finite number.
    """
    header, rows, lines = _rows(path)
    for name in required:
        if name not in header:
            raise RecordingError(f"{path}: no column {name!r}, expected it among {listed(header)}")
    columns = {}
    for name in dict.fromkeys((*required, *(each for each in optional if each in header))):
        if header.count(name) > 1:
            raise RecordingError(f"{path}: {header.count(name)} columns {name!r}, expected one")
        place = header.index(name)
        columns[name] = _numbers(
            [row[place] for row in rows], lines, f"{path}, column {name}", gaps
        )
    return Table(path, np.array(lines, dtype=np.int64), columns, tuple(header))


def check_time(table: Table, name: str, sample_time_s: float | None) -> None:
    """Raise RecordingError where time does not increase in uniform steps.

    A step may differ by 1 % from `sample_time_s` [s] (None: from the median step).
    """
    t = table.columns[name]
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


def check_increasing(table: Table, name: str) -> None:
    """Raise RecordingError where a time is missing or does not come after the one before."""
    t = table.columns[name]
    if len(t) < 2:
        raise RecordingError(f"{table.path}: got {len(t)} samples, expected at least 2")
    wrong = ~(np.diff(t) > 0.0)  # also where a time is missing
    if np.any(wrong):
        k = int(np.argmax(wrong))
        raise RecordingError(
            f"{table.path}, column {name}, line {table.lines[k + 1]}: got {t[k + 1]:.6f} s after "
            f"{t[k]:.6f} s, expected time to increase"
        )


def check_gaps(table: Table, time: str, longest_s: float) -> None:
    """Raise RecordingError where a column has no sample for more than `longest_s` [s].

    Columns may begin late and end early.
    """
    check_increasing(table, time)
    for name, values in table.columns.items():
        known = np.flatnonzero(~np.isnan(values))
        if len(known) < 2:
            raise RecordingError(
                f"{table.path}, column {name}: got {len(known)} samples, expected at least 2"
            )
        t = table.columns[time][known]
        gaps = np.diff(t)
        if np.max(gaps) > longest_s:
            k = int(np.argmax(gaps > longest_s))
            raise RecordingError(
                f"{table.path}, column {name}, line {table.lines[known[k]]}: got no sample for "
                f"{gaps[k]:.6g} s after {t[k]:.6g} s, expected at most {longest_s:g} s"
            )


def listed(names: Sequence[str]) -> str:
    """Names on one line, however many and whatever they hold."""
    return shorten(", ".join(names), 600, placeholder=" ...")


def _rows(path: Path) -> tuple[list[str], list[list[str]], list[int]]:
    """Header, rows of equally many cells, and the line of each row; blank lines are skipped."""
    reader = csv.reader(io.StringIO(_text(path), newline=""))
    rows: list[list[str]] = []
    lines: list[int] = []
    try:
        header = [name.strip() for name in next(row for row in reader if row)]
        for row in reader:
            if row and len(row) != len(header):
                raise RecordingError(
                    f"{path}, line {reader.line_num}: got {len(row)} cells, "
                    f"expected {len(header)} as in the header"
                )
            if row:
                rows.append(row)
                lines.append(reader.line_num)
    except csv.Error as error:
        raise RecordingError(
            f"{path}, line {reader.line_num}: {error}, expected comma-separated values"
        ) from error
    if not rows:
        raise RecordingError(f"{path}: got a header and no rows, expected samples below it")
    return header, rows, lines


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


def _numbers(cells: list[str], lines: list[int], where: str, gaps: bool) -> Array:
    values = np.empty(len(cells))
    for i, cell in enumerate(cells):
        try:
            values[i] = float(cell)
        except ValueError:
            if cell.strip():
                raise _not_a_number(cell, lines[i], where) from None
            values[i] = np.nan
    wrong = ~(np.abs(values) < LARGEST) & ~(gaps & np.isnan(values))
    if np.any(wrong):
        first = int(np.argmax(wrong))
        raise _not_a_number(cells[first], lines[first], where)
    return values


def _not_a_number(cell: str, line: int, where: str) -> RecordingError:
    got = repr(shorten(cell, 40, placeholder="...")) if cell.strip() else "an empty cell"
    return RecordingError(f"{where}, line {line}: got {got}, expected a finite number")
