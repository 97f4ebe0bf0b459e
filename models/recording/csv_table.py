"""CSV files as columns of numbers, with errors that name file, line and column."""

import csv
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from textwrap import shorten
from typing import Any

import numpy as np

from seatrial.models.errors import RecordingError
from seatrial.models.vessel.basis import Array

UNIFORMITY = 0.01  # a step may differ from the sample time by this share of it
LARGEST = 1e30  # what is larger was not measured, and its square is not far from overflow
NUMBER = r"^(?P<number>[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)$"
MISSING = r"^([+-]?[nN][aA][nN])?$"


@dataclass(frozen=True, eq=False)
class Table:
    """Number columns of a CSV file with one header line; NaN where a cell is empty."""

    path: Path
    columns: dict[str, Array]  # (N,) each
    present: tuple[str, ...]  # names of all columns of the file

    def line(self, row: int) -> int:
        """Line of the file that a row ends on, for messages: the file is read again."""
        return next(islice(_cells(self.path, _text(self.path)), row + 1, None))[0]


def read_table(
    path: Path, required: Sequence[str], optional: Sequence[str] = (), *, gaps: bool = False
) -> Table:
    """The `required` columns, and the `optional` ones that are there.

    `gaps` allows empty cells and NaN. RecordingError when the file cannot be read, a required
    column is missing, or a cell of one of these columns is not a finite number.
    """
    text = _text(path)
    head = list(islice(_cells(path, text), 2))
    if len(head) < 2:
        raise RecordingError(f"{path}: got a header and no rows, expected samples below it")
    line, header = head[0][0], [name.strip() for name in head[0][1]]
    for name in required:
        if name not in header:
            raise RecordingError(f"{path}: no column {name!r}, expected it among {listed(header)}")
    names = list(dict.fromkeys((*required, *(each for each in optional if each in header))))
    for name in names:
        if header.count(name) > 1:
            raise RecordingError(f"{path}: {header.count(name)} columns {name!r}, expected one")
    texts = _texts(path, text, line, len(header), [header.index(name) for name in names])
    table = Table(path, {}, tuple(header))
    for name, cells in zip(names, texts, strict=True):
        table.columns[name] = _numbers(table, name, cells, gaps)
    return table


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
            f"{table.path}, column {name}, line {table.line(k + 1)}: got a step of "
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
            f"{table.path}, column {name}, line {table.line(k + 1)}: got {t[k + 1]:.6f} s after "
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
                f"{table.path}, column {name}, line {table.line(int(known[k]))}: got no sample for "
                f"{gaps[k]:.6g} s after {t[k]:.6g} s, expected at most {longest_s:g} s"
            )


def listed(names: Sequence[str]) -> str:
    """Names on one line, however many and whatever they hold."""
    return shorten(", ".join(names), 600, placeholder=" ...")


def _texts(path: Path, text: str, header_line: int, width: int, places: Sequence[int]) -> Any:
    """The columns at some places below the header, as text without spaces about it."""
    import pyarrow as pa  # slow to import
    from pyarrow import compute as pc
    from pyarrow import csv as arrow_csv

    data, names = text.encode(), [str(place) for place in range(width)]
    chosen = {names[place]: pa.string() for place in places}
    try:
        table = arrow_csv.read_csv(
            pa.py_buffer(data),
            arrow_csv.ReadOptions(
                use_threads=False, block_size=len(data), skip_rows=header_line, column_names=names
            ),
            arrow_csv.ParseOptions(newlines_in_values=True),
            arrow_csv.ConvertOptions(
                include_columns=list(chosen), column_types=chosen, strings_can_be_null=False
            ),
        )
    except pa.ArrowInvalid as error:
        raise _not_a_row(path, text, width, str(error)) from error
    return [pc.utf8_trim_whitespace(column) for column in table.columns]


def _not_a_row(path: Path, text: str, width: int, reason: str) -> RecordingError:
    """The first row of another length than the header's, or what else stopped the reader."""
    for line, row in _cells(path, text):
        if len(row) != width:
            return RecordingError(
                f"{path}, line {line}: got {len(row)} cells, expected {width} as in the header"
            )
    return RecordingError(f"{path}: {shorten(reason, 600)}, expected comma-separated values")


def _numbers(table: Table, name: str, cells: Any, gaps: bool) -> Array:
    """Numbers as floats are written; NaN for a missing one, where `gaps` allows it."""
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
    """The line that each row ends on, and its cells; blank lines are skipped."""
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
        reason = getattr(error, "strerror", None) or str(error)
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
