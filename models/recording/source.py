"""Columns as they were recorded, and how a file is to be read."""

import codecs
import io
import os
import re
import warnings
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from textwrap import shorten
from typing import Annotated, Any, TypeAlias

import numpy as np
from annotated_types import Ge
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError, RecordingError, SeatrialError
from seatrial.models.ranges import check_ranges
from seatrial.models.vessel.basis import Array

MAX_NUMBER = 1e30  # larger numbers are not measurements, and their squares could overflow
LARGEST_BYTES = 2**28  # of a file that is read at once, and of the numbers of any recording
MOST_CELLS = LARGEST_BYTES // 8
MOST_ELEMENTS = 64  # of an array in a message or of a matrix; larger ones are images and the like
TextArray: TypeAlias = NDArray[np.object_]  # of str, as written
Values: TypeAlias = Array | TextArray
NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
# Cells that stand for no sample, as programs write them, in small letters.
MISSING = frozenset(
    ("", "nan", "+nan", "-nan", "n/a", "na", "n.a.", "#n/a", "#n/a n/a", "#na", "<na>", "nat",
     "null", "none", "nil", "-", "--", "---", "?", "missing", "1.#qnan", "-1.#ind", "1.#ind",
     "#value!", "#div/0!", "#num!", "#null!", "#ref!", "#name?")
)  # fmt: skip
TITLE = re.compile(r"(?P<name>.*?\S)[\s_]*[\[(](?!\d+[\])])(?P<unit>[^\[\]()]*)[\])]")
NO_UNITS = {"nodim": "", "bool": "", "enum": "", "timestamp": "s"}  # of gliders
# The place of a cell in its file, such as "line 7", and its text, None where there is no text.
Cell: TypeAlias = Callable[[int, str], tuple[str, str | None]]


def _row(row: int, column: str) -> tuple[str, None]:
    return f"row {row + 1}", None


@dataclass(frozen=True, eq=False)
class Source:
    """Columns that share a clock: a table, a topic, a group.

    Columns of numbers hold NaN for a missing value; a column with any other cell holds its text as
    written, such as date-times. `units` are those of the file (`t [s]` is the column `t` in `s`).
    Lines of `left_out` that concern a whole file stand in its first source.
    """

    name: str  # stem of the file, or topic, relative to the folder
    path: Path
    columns: dict[str, Values]  # (N,) each
    units: dict[str, str] = field(default_factory=dict)
    titles: Mapping[str, str] = field(default_factory=dict)  # as written, where names differ
    left_out: tuple[str, ...] = ()  # what of the file was left out, and why
    cell: Cell = _row  # a cell of the file, by row and column

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    def title(self, name: str) -> str:
        """The title of a column as it is written in the file."""
        return self.titles.get(name, name)

    def find(self, name: str) -> str | None:
        """The column of a name, which may be written as in the header; None if there is none."""
        titled = [plain for plain, title in self.titles.items() if title == name]
        return name if name in self.columns else titled[0] if len(titled) == 1 else None

    def numbers(self, name: str, *, gaps: bool = False) -> Array:
        """The column `name` as numbers, shape (N,); `gaps` allows NaN, for empty cells.

        Raises RecordingError, with file, column and line, if a cell is not a finite number.
        """
        column = self.find(name)
        if column is None:
            raise self.absent(name)
        values = self.columns[column]
        if values.dtype == np.object_:
            cells = [cell.strip() for cell in values]
            parsed = np.array([float(c) if NUMBER.fullmatch(c) else np.nan for c in cells])
            missing = np.array([c.lower() in MISSING for c in cells], dtype=bool)
        else:
            parsed = np.asarray(values, dtype=np.float64)
            missing = np.isnan(parsed)
        wrong = ~(np.abs(parsed) < MAX_NUMBER) & ~(missing & gaps)
        if np.any(wrong):
            raise self.refused(int(np.argmax(wrong)), name)
        return parsed

    def refused(self, row: int, name: str, expected: str = "a finite number") -> RecordingError:
        """What is raised of a cell of a column `name` that is not what is expected."""
        column = self.find(name) or next(iter(self.columns))
        place, text = self.cell(row, column)
        text = str(self.columns[column][row]) if text is None else text
        got = repr(shorten(text, 40, placeholder="...")) if text.strip() else "an empty cell"
        return RecordingError(
            f"{self.path}, column {name}, {place}: got {got}, expected {expected}"
        )

    def absent(self, name: str) -> RecordingError:
        """What is raised where there is no column `name`, or several have that title."""
        alike = [plain for plain, title in self.titles.items() if title == name]
        if alike:
            got = f"{len(alike)} columns are titled {name!r}, expected one of"
            return RecordingError(f"{self.path}: {got} {_listing(alike)}")
        known = _listing(map(self.title, self.columns))
        return RecordingError(f"{self.path}: no column {name!r}, expected it among {known}")


def _listing(names: Iterable[str]) -> str:
    return shorten(", ".join(names), 600, placeholder=" ...")


def table_source(
    source: str, path: Path, titles: Sequence[str], columns: Sequence[Values],
    units: Sequence[str] = (), reasons: Sequence[str] = (), left_out: Sequence[str] = (),
    cell: Callable[[int, int], tuple[str, str | None]] | None = None,
) -> Source:  # fmt: skip
    """A table as a source: names, units and repeated titles of its columns.

    `t [s]` is the column `t` in `s`, a column without title is c1, c2 ... Columns whose names
    differ by the unit only keep their titles. Of columns of one title with equal cells one is kept,
    others are `x.1`, `x.2` ...

    Args:
        source: its name.
        titles: as written, of the `columns`, (N,) each.
        units: of the columns, where the file has them apart from the titles.
        reasons: what was left out of the columns; `left_out`: of the table.
        cell: a cell of the file by row and number of the column.
    """
    titles = [title.strip() or f"c{i + 1}" for i, title in enumerate(titles)]
    groups: dict[str, list[int]] = {}
    twice = dict[str, None]()
    for i, title in enumerate(titles):
        group = groups.setdefault(title, [])
        if any(_equal(columns[i], columns[j]) for j in group):
            said = f"column {title}: stands {titles.count(title)} times, with equal cells"
            twice[said] = None
        else:
            group.append(i)
    matches = {title: TITLE.fullmatch(title) for title in groups}
    plain = {title: match["name"] if match else title for title, match in matches.items()}
    names: dict[int, str] = {}
    for title, (first, *others) in groups.items():
        if others:
            free = (name for k in count(1) if (name := f"{title}.{k}") not in groups)
            names |= dict(zip((first, *others), free, strict=False))
        else:
            alone = list(plain.values()).count(plain[title]) == 1
            names[first] = plain[title] if alone else title
    names = dict(sorted(names.items()))
    known: dict[str, str] = {}
    for i, name in names.items():
        match = matches[titles[i]]
        unit = (units[i].strip("[]() ") if units else "") or (match["unit"] if match else "")
        known |= {name: unit} if (unit := NO_UNITS.get(unit.strip(), unit.strip())) else {}
    numbers = {name: i for i, name in names.items()}
    lines = [f"column {name}: {reasons[i]}" for i, name in names.items() if reasons and reasons[i]]
    return Source(
        source, path, {name: columns[i] for i, name in names.items()}, known,
        {name: titles[i] for i, name in names.items() if titles[i] != name},
        (*left_out, *lines, *twice),
        _row if cell is None else lambda row, column: cell(row, numbers[column]),
    )  # fmt: skip


def _equal(one: Values, other: Values) -> bool:
    exact = one.dtype == np.object_
    return bool(one.dtype == other.dtype and np.array_equal(one, other, equal_nan=not exact))


def column(sources: Mapping[str, Source], name: str) -> tuple[Source, str]:
    """The source and the name of a column: `column` where that is unique, or `source:column`.

    A source may be named by the end of its path. Raises RecordingError if there is no such column,
    or several.
    """
    searched, title = list(sources.values()), name
    place = os.path.commonpath([source.path for source in searched])
    holders = [(source, plain) for source in searched if (plain := source.find(name))]
    if not holders and ":" in name:
        wanted, _, title = name.rpartition(":")
        ending = f"/{wanted.lstrip('/')}"
        searched = [source for source in searched if f"/{source.name}".endswith(ending)]
        searched = [sources[wanted]] if wanted in sources else searched
        if not searched:
            raise RecordingError(
                f"{place}: no source {wanted!r}, expected it among {_listing(sources)}"
            )
        holders = [(source, plain) for source in searched if (plain := source.find(title))]
    if len(holders) == 1:
        return holders[0]
    if holders:
        raise RecordingError(
            f"{place}: {len(holders)} sources have a column {name!r}: "
            f"{_listing(source.name for source, _ in holders)}; expected one of them before it, "
            f"as {holders[0][0].name}:{holders[0][1]}"
        )
    if len(searched) == 1 or ":" in name:
        raise searched[0].absent(title)
    known = _listing(f"{source.name}:{plain}" for source in searched for plain in source.columns)
    raise RecordingError(f"{place}: no column {name!r}, expected it among {known}")


def check_size(path: Path, cells: int) -> None:
    """Raise RecordingError if a recording has more numbers than fit in memory."""
    if cells > MOST_CELLS:
        raise RecordingError(
            f"{path}: got {cells:.3g} numbers, expected at most {MOST_CELLS:.3g}; cut the recording"
        )


@contextmanager
def foreign(path: Path, expected: str) -> Iterator[None]:
    """Name the file where a library fails, which may raise anything, and hide what it prints.

    Raises RecordingError.
    """
    quiet = io.StringIO()
    try:
        with warnings.catch_warnings(), redirect_stdout(quiet), redirect_stderr(quiet):
            warnings.simplefilter("ignore")
            yield
    except SeatrialError:
        raise
    except Exception as error:
        reason = shorten(f"{type(error).__name__} {error}".strip(), 200, placeholder=" ...")
        raise RecordingError(f"{path}: cannot be read ({reason}), expected {expected}") from error


Contents: TypeAlias = tuple[list[Source], Sequence[str]]  # of a file, and what was left out


class Rows:
    """Columns that grow message by message; what a message does not have stays missing.

    A column holds numbers or texts, by its first value.
    """

    def __init__(self) -> None:
        self.count = 0
        self.cells: dict[str, Any] = {}  # array of float, or list of str

    def add(self, values: Iterable[tuple[str, Any]]) -> None:
        """Add a message: its numbers and texts (str) by name."""
        for name, value in values:
            cells = self.cells.setdefault(name, [] if isinstance(value, str) else array("d"))
            cells.extend([_nothing(cells)] * (self.count - len(cells)))
            cells.append(value)
        self.count += 1

    def columns(self) -> dict[str, Values]:
        """All columns, shape (N,) each."""
        result = {}
        for name, cells in self.cells.items():
            cells.extend([_nothing(cells)] * (self.count - len(cells)))
            result[name] = np.array(cells, dtype=object if isinstance(cells, list) else float)
        return result


def _nothing(cells: object) -> str | float:
    return "" if isinstance(cells, list) else np.nan


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
        problem = ""
        if self.separator is not None and (len(self.separator) != 1 or self.separator in '"\r\n'):
            problem = f"separator: got {self.separator!r}, expected one character"
        elif self.decimal not in (None, ".", ","):
            problem = f"decimal: got {self.decimal!r}, expected '.', ',' or null"
        elif self.decimal == self.separator == ",":
            problem = "decimal and separator are both ',', expected a different separator"
        elif len(set(self.names)) < len(self.names):
            problem = f"names: got {', '.join(self.names)}, expected each once"
        try:
            codecs.lookup(self.encoding or "utf-8")
        except LookupError:
            problem = f"encoding: got {self.encoding!r}, expected one that is known, as latin-1"
        if problem:
            raise ConfigurationError(problem)


@dataclass(frozen=True)
class ReadOptions:
    """How files are read; `format` null: by the suffix of each file, else by its content.

    `messages` are files `.msg` with definitions of messages of ROS that a bag lacks.
    """

    format: str | None = None
    text: TextOptions = field(default_factory=TextOptions)
    messages: tuple[str, ...] = ()
