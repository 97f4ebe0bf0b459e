"""Columns as they were recorded, and how a file is to be read."""

import io
import warnings
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path
from textwrap import shorten
from typing import Annotated, NamedTuple, TypeAlias

import numpy as np
from annotated_types import Ge
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError, RecordingError, SeatrialError
from seatrial.models.ranges import check_ranges
from seatrial.models.vessel.basis import Array

MAX_NUMBER = 1e30  # larger numbers are not measurements, and their squares could overflow
LARGEST_BYTES = 2**28  # of a text file, and of the numbers of any recording
MOST_CELLS = LARGEST_BYTES // 8
MOST_ELEMENTS = 64  # of an array in a message or of a matrix; larger ones are images and the like
MARKS = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}  # of text in another encoding
TextArray: TypeAlias = NDArray[np.object_]  # of str, as written
# Cells that stand for no sample, as programs write them, in small letters.
MISSING = frozenset(
    ("", "nan", "+nan", "-nan", "n/a", "na", "n.a.", "#n/a", "#n/a n/a", "#na", "<na>", "nat", "null",
     "none", "nil", "-", "--", "---", "?", "missing", "1.#qnan", "-1.#ind", "1.#ind", "#value!",
     "#div/0!", "#num!", "#null!", "#ref!", "#name?")
)  # fmt: skip


class FileCell(NamedTuple):
    """A cell as it is written in its file, for messages; `text` is None where there is no text."""

    place: str  # such as "line 7"
    text: str | None


def _row(row: int, column: str) -> FileCell:
    return FileCell(f"row {row + 1}", None)


@dataclass(frozen=True, eq=False)
class Source:
    """Columns that share a clock: a table, a topic, a group.

    Columns of numbers hold NaN for a missing value; a column with any other cell holds its text as
    written, such as date-times. `units` are those of the file (`t [s]` is the column `t` in `s`).
    Lines of `left_out` that concern a whole file stand in its first source.
    """

    name: str  # stem of the file, or topic, relative to the folder
    path: Path
    columns: dict[str, Array | TextArray]  # (N,) each
    units: dict[str, str] = field(default_factory=dict)
    written: dict[str, str] = field(default_factory=dict)  # names in the header, where they differ
    repeated: Mapping[str, tuple[str, ...]] = field(default_factory=dict)  # title: its columns
    left_out: tuple[str, ...] = ()  # what of the file was left out, and why
    cell: Callable[[int, str], FileCell] = _row  # reads the file again

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    def find(self, name: str) -> str | None:
        """The column of a name, which may be written as in the header; None if there is none."""
        if name in self.columns:
            return name
        return next((plain for plain, full in self.written.items() if full == name), None)

    def numbers(self, name: str, *, gaps: bool = False) -> Array:
        """The column `name` as numbers, shape (N,); `gaps` allows NaN, for empty cells.

        Raises RecordingError, with file, column and line, if a cell is not a finite number.
        """
        column = self.find(name)
        if column is None or name in self.repeated:
            raise self._absent(name)
        values = self.columns[column]
        numeric = values.dtype != np.object_
        parsed = np.asarray(values, dtype=np.float64) if numeric else _parsed(values.tolist())
        wrong = ~(np.abs(parsed) < MAX_NUMBER)
        if gaps:
            wrong &= ~np.isnan(parsed) if numeric else ~np.array([is_empty(v) for v in values])
        if np.any(wrong):
            row = int(np.argmax(wrong))
            place, text = self.cell(row, column)
            text = str(values[row]) if text is None else text
            got = repr(shorten(text, 40, placeholder="...")) if text.strip() else "an empty cell"
            raise RecordingError(
                f"{self.path}, column {name}, {place}: got {got}, expected a finite number"
            )
        return parsed

    def _absent(self, name: str) -> RecordingError:
        if name in self.repeated:
            return RecordingError(
                f"{self.path}: {len(self.repeated[name])} columns are titled {name!r}, expected one "
                f"of {', '.join(self.repeated[name])}"
            )
        names = [self.written.get(column, column) for column in self.columns]
        listing = shorten(", ".join(names), 600, placeholder=" ...")
        return RecordingError(f"{self.path}: no column {name!r}, expected it among {listing}")


def is_empty(cell: str) -> bool:
    """Whether a cell stands for no sample."""
    return cell.strip().lower() in MISSING


def column_of_cells(cells: Sequence[str]) -> Array | TextArray:
    """Cells as numbers, NaN where one is missing; as they are if one is something else, (N,)."""
    values = _parsed(cells)
    plain = all(map(is_empty, (cells[row] for row in np.flatnonzero(np.isnan(values)))))
    return values if plain else np.array(cells, dtype=np.object_)


def _parsed(cells: Sequence[str]) -> Array:
    """Cells as numbers, shape (N,); NaN where a cell is none."""
    values = np.full(len(cells), np.nan)
    for row, cell in enumerate(cells):
        # float() accepts more than is written by instruments: 1_000, and digits of other scripts.
        if cell.isascii() and "_" not in cell and not is_empty(cell):
            try:
                values[row] = float(cell)
            except ValueError:
                continue
    return values


def column(sources: Mapping[str, Source], name: str) -> tuple[Source, str]:
    """The source and the name of a column: `column` where that is unique, or `source:column`.

    A source may be named by the end of its path. Raises RecordingError if there is no such column,
    or several.
    """
    if len(sources) == 1:
        (source,) = sources.values()
        if name in source.repeated or source.find(name) is not None:
            return source, source.find(name) or name
    holders = [(source, plain) for source in sources.values() if (plain := source.find(name))]
    if not holders and ":" in name:
        wanted, _, plain_name = name.rpartition(":")
        ending = f"/{wanted.lstrip('/')}"
        named = [s for s in sources.values() if f"/{s.name}".endswith(ending)]
        named = [sources[wanted]] if wanted in sources else named
        if not named:
            listing = shorten(", ".join(sources), 600, placeholder=" ...")
            raise RecordingError(
                f"{_place(sources)}: no source {wanted!r}, expected it among {listing}"
            )
        holders = [(source, plain) for source in named if (plain := source.find(plain_name))]
        if not holders:
            raise named[0]._absent(plain_name)
    if len(holders) > 1:
        listing = shorten(", ".join(source.name for source, _ in holders), 300, placeholder=" ...")
        raise RecordingError(
            f"{_place(sources)}: {len(holders)} sources have a column {name!r}: {listing}; "
            f"expected one of them before it, as {holders[0][0].name}:{holders[0][1]}"
        )
    if not holders:
        if len(sources) == 1:
            raise next(iter(sources.values()))._absent(name)
        known = [
            f"{source.name}:{plain}" for source in sources.values() for plain in source.columns
        ]
        listing = shorten(", ".join(known), 600, placeholder=" ...")
        raise RecordingError(f"{_place(sources)}: no column {name!r}, expected it among {listing}")
    return holders[0]


def _place(sources: Mapping[str, Source]) -> str:
    paths = [source.path for source in sources.values()]
    shared = [
        path
        for path in (paths[0], *paths[0].parents)
        if all(path == other or path in other.parents for other in paths)
    ]
    return str(shared[0]) if shared else ", ".join(map(str, paths))


def check_file(path: Path) -> None:
    """Raise RecordingError if a file has more bytes than are read."""
    if (size := path.stat().st_size) > LARGEST_BYTES:
        raise RecordingError(
            f"{path}: got {size / 1e6:.0f} MB, expected at most {LARGEST_BYTES / 1e6:.0f}; cut the "
            "recording"
        )


def check_size(path: Path, cells: int) -> None:
    """Raise RecordingError if a recording has more numbers than fit in memory."""
    if cells > MOST_CELLS:
        raise RecordingError(
            f"{path}: got {cells:.3g} numbers, expected at most {MOST_CELLS:.3g}; cut the recording"
        )


@contextmanager
def foreign(path: Path, expected: str) -> Iterator[None]:
    """Name the file where a reader that is not ours fails, and keep what it prints to ourselves.

    A damaged file can make a reader raise anything. Raises RecordingError.
    """
    quiet = io.StringIO()
    try:
        with warnings.catch_warnings(), redirect_stdout(quiet), redirect_stderr(quiet):
            warnings.simplefilter("ignore")
            yield
    except SeatrialError:
        raise
    except MemoryError as error:
        raise RecordingError(
            f"{path}: takes more memory than there is, expected {expected} of a recording; cut it"
        ) from error
    except Exception as error:
        reason = shorten(f"{type(error).__name__} {error}".strip(), 200, placeholder=" ...")
        raise RecordingError(f"{path}: cannot be read ({reason}), expected {expected}") from error


class Rows:
    """Columns that grow message by message; what a message does not have stays missing."""

    def __init__(self) -> None:
        self.count = 0
        self.cells: dict[str, array[float] | list[str]] = {}

    def add(self, values: Iterable[tuple[str, float | str]]) -> None:
        """Add a message: its numbers and texts by name."""
        for name, value in values:
            cells = self.cells.get(name)
            if cells is None:
                cells = self.cells[name] = [] if isinstance(value, str) else array("d")
            elif isinstance(value, str) and not isinstance(cells, list):
                cells = self.cells[name] = ["" if x != x else f"{x:.17g}" for x in cells]
            if isinstance(cells, list):
                cells.extend([""] * (self.count - len(cells)))
                cells.append(value if isinstance(value, str) else f"{value:.17g}")
            else:
                cells.extend([np.nan] * (self.count - len(cells)))
                cells.append(value)
        self.count += 1

    def columns(self) -> dict[str, Array | TextArray]:
        """All columns, shape (N,) each."""
        found: dict[str, Array | TextArray] = {}
        for name, cells in self.cells.items():
            lost = self.count - len(cells)
            if isinstance(cells, list):
                found[name] = np.array([*cells, *[""] * lost], dtype=np.object_)
            else:
                found[name] = np.concatenate([np.array(cells), np.full(lost, np.nan)])
        return found


@dataclass(frozen=True)
class TextOptions:
    """How a text file is written; null: found out from the file.

    `header_lines` counts the lines of names (0: none): the names stand in the first, units may
    stand in the second. `skip_lines` are passed over before. `names` replace those of the header.
    """

    separator: str | None = None  # one character; " ": any white space
    decimal: str | None = None  # "." or ","
    encoding: str | None = None
    comment: str | None = "#"  # beginning of lines that are passed over
    skip_lines: Annotated[int, Ge(0)] = 0
    header_lines: Annotated[int, Ge(0)] | None = None
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.separator is not None and (len(self.separator) != 1 or self.separator in '"\r\n'):
            raise ConfigurationError(f"separator: got {self.separator!r}, expected one character")
        if self.decimal not in (None, ".", ","):
            raise ConfigurationError(f"decimal: got {self.decimal!r}, expected '.', ',' or null")
        if self.decimal == "," and self.separator == ",":
            raise ConfigurationError(
                "decimal and separator are both ',', expected a different separator"
            )
        if self.encoding is not None:
            try:
                "".encode(self.encoding)
            except LookupError as error:
                raise ConfigurationError(
                    f"encoding: got {self.encoding!r}, expected one that is known, such as "
                    "utf-8, latin-1, utf-16"
                ) from error
        if len(set(self.names)) < len(self.names):
            raise ConfigurationError(f"names: got {', '.join(self.names)}, expected each once")


@dataclass(frozen=True)
class ReadOptions:
    """How files are read; `format` null: by the suffix of each file, else by its content.

    `messages` are files `.msg` with definitions of messages of ROS that a bag lacks.
    """

    format: str | None = None
    text: TextOptions = field(default_factory=TextOptions)
    messages: tuple[str, ...] = ()
