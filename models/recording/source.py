"""Recordings as they are: files of any known format, and folders of them, as sources."""

import codecs
import io
import os
import re
import warnings
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout, suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib import import_module
from importlib.util import find_spec
from itertools import count
from pathlib import Path
from textwrap import shorten
from typing import Annotated, Literal, NamedTuple, TypeAlias

import numpy as np
from annotated_types import Ge
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError, RecordingError, SeatrialError
from seatrial.models.ranges import check_ranges
from seatrial.models.recording import formats
from seatrial.models.vessel.basis import Array

LARGEST_BYTES = 2**28  # of a file that is read at once, and of the numbers of any recording
MOST_CELLS = LARGEST_BYTES // 8
MOST_ELEMENTS = 64  # of an array in a message or of a matrix; larger ones are images and the like
TextArray: TypeAlias = NDArray[np.object_]  # of str, as written
Values: TypeAlias = Array | TextArray
TITLE = re.compile(r"(.*?\S)[\s_]*[\[({](?!\d+[\])])(?:in )?([^\[\](){}]*?)(?: since .*)?[\])}]")
PARTS = ("yea", "mon", "day", "hou", "min", "sec")  # of a time in columns of their own
NO_UNITS = {"nodim": "", "bool": "", "enum": "", "timestamp": "s"}  # of gliders
# Cells that stand for no sample, as programs write them, in small letters.
MISSING = frozenset(
    ("", "nan", "+nan", "-nan", "n/a", "na", "n.a.", "#n/a", "#n/a n/a", "#na", "<na>", "nat",
     "null", "none", "nil", "-", "--", "---", "?", "missing", "1.#qnan", "-1.#ind", "1.#ind",
     "#value!", "#div/0!", "#num!", "#null!", "#ref!", "#name?")
)  # fmt: skip
# The place of a cell in its file, such as "line 7", and its text, None where there is no text.
Cell: TypeAlias = Callable[[int, str], tuple[str, str | None]]


class FileFormat(NamedTuple):
    """How a format is recognised, and the function of the folder `formats` that reads it."""

    suffixes: tuple[str, ...]
    reader: str  # file.function
    package: str | None = None  # needed to read it
    begins: bytes = rb"(?!)"  # how a file begins, a regular expression


NMEA = rb"(?:[^\n]{0,200}\n){0,20}?[^\n]{0,100}[$!](?:[A-Z]{2}[A-Z\d]{3}|P[A-Z]{3,}),[^\n]*[,*]"
FORMATS: dict[str, FileFormat] = {
    name: FileFormat(tuple(suffixes.split()), *row)
    for name, suffixes, *row in (
        ("csv", ".csv .tsv", "text.read"),
        ("dat", ".dat .txt .asc .dba .log .alog", "text.read"),
        ("excel", ".xlsx .xlsm", "tables.read_excel", "openpyxl", rb"PK\x03\x04"),
        ("netcdf", ".nc .nc4 .cdf", "tables.read_netcdf", "xarray", rb"CDF[\x01\x02\x05]|\x89HDF"),
        ("ardupilot", ".bin .tlog", "messages.read_ardupilot", "pymavlink",
         rb"\xa3\x95|FMT, ?\d|.{8}[\xfd\xfe].{5,}"),
        ("nmea", ".nmea .nma", "nmea.read", "pynmea2", NMEA),
        ("parquet", ".parquet .pq", "tables.read_parquet", None, rb"PAR1"),
        ("mat", ".mat", "tables.read_matlab", None, rb"MATLAB "),
        ("rosbag", ".bag .db3 .mcap", "messages.read_bag", "rosbags",
         rb"#ROSBAG|\x89MCAP|SQLite format 3\0"),
        ("ulog", ".ulg .ulog", "messages.read_ulog", "pyulog", rb"ULog\x01"),
    )
}  # fmt: skip
EXTRAS = {"rosbag": "ros"}  # that install a package; others are called as their format
SUFFIXES = {suffix: name for name, form in FORMATS.items() for suffix in form.suffixes}
BAG = "metadata.yaml"  # in a folder that is a bag of ROS 2
ANY = (".csv", ".txt", ".dat", ".log", ".asc", ".bin")  # suffixes of files of any content


def _row(row: int, column: str) -> tuple[str, None]:
    return f"row {row + 1}", None


@dataclass(frozen=True, eq=False)
class Source:
    """Columns that share a clock: a table, a topic, a group.

    Columns of numbers hold NaN for a missing value, others text as written, such as date-times.
    `units` are those of the file (`t [s]` is the column `t` in `s`). Lines of `left_out` that
    concern a whole file stand in its first source.
    """

    name: str  # stem of the file, or topic, relative to the folder
    path: Path
    columns: dict[str, Values]  # (N,) each
    units: dict[str, str] = field(default_factory=dict)
    titles: Mapping[str, str] = field(default_factory=dict)  # as written, where names differ
    left_out: tuple[str, ...] = ()  # what of the file was left out, and why
    cell: Cell = _row  # a cell of the file, by row and column
    times: dict[object, Array] = field(default_factory=dict, init=False, repr=False)  # as read

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
        """The column `name` as numbers, shape (N,); `gaps` allows NaN, for missing values.

        Raises RecordingError, with file, column and line, if a cell is not a finite number.
        """
        column = self.find(name)
        if column is None:
            raise self.absent(name)
        values = self.columns[column]
        text = values.dtype == np.object_
        wrong = np.ones(len(values), dtype=bool) if text else np.isnan(values.astype(np.float64))
        if np.any(wrong) and (text or not gaps):
            raise self.refused(int(np.argmax(wrong)), name)
        return np.asarray(values, dtype=np.float64)

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


Contents: TypeAlias = tuple[list[Source], Sequence[str]]  # of a file, and what was left out


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
    titles = [title.strip() or f"c{i + 1}" for i, title in enumerate(_grouped(titles, columns))]
    groups, lines = defaultdict[str, list[int]](list), list(left_out)
    for i, title in enumerate(titles):
        same = (j for j in groups[title] if columns[j].dtype == columns[i].dtype)
        exact = columns[i].dtype == np.object_
        if any(np.array_equal(columns[i], columns[j], equal_nan=not exact) for j in same):
            lines.append(f"column {title}: stands {titles.count(title)} times, with equal cells")
        else:
            groups[title].append(i)
    parts = {t: m.groups() if (m := TITLE.fullmatch(t)) else (t, "") for t in groups}
    alike = Counter(name for name, _ in parts.values())
    names = dict[int, str]()
    for title, (first, *others) in groups.items():
        free = (name for k in count(1) if (name := f"{title}.{k}") not in groups)
        names |= dict(zip((first, *others), free, strict=False)) if others else {
            first: parts[title][0] if alike[parts[title][0]] == 1 else title}  # fmt: skip
    numbers, known = {names[i]: i for i in sorted(names)}, dict[str, str]()
    for name, i in numbers.items():
        unit = (units[i].strip("[]() ") if units else "") or parts[titles[i]][1].strip()
        known |= {name: unit} if (unit := NO_UNITS.get(unit, unit)) else {}
        lines += [f"column {name}: {reasons[i]}"] if reasons and reasons[i] else []
    values = {name: columns[i] for name, i in numbers.items()}
    for name, moments, of in _dates(values):
        values[name], known[name] = moments, "s"
        lines.append(f"columns {', '.join(of)}: read as the time {name}")
    for name, angles in _angles(values).items():
        values[name], known[name] = angles, "deg"
        lines.append(f"column {name}: degrees and minutes, read as degrees")
    return Source(
        source, path, values, known,
        {name: titles[i] for name, i in numbers.items() if titles[i] != name},
        tuple(dict.fromkeys(lines)),
        _row if cell is None else lambda row, column: cell(row, numbers[column]),
    )  # fmt: skip


def _grouped(titles: Sequence[str], columns: Sequence[Values]) -> Sequence[str]:
    """The titles; where some repeat, those after a title without cells have it before them."""
    result, group = list(titles), ""
    for i, values in enumerate(columns) if len(set(titles)) < len(titles) else ():
        empty = np.all(values == "") if values.dtype == np.object_ else np.all(np.isnan(values))
        group = f"{titles[i]}." if empty and titles[i].strip() else group
        result[i] = titles[i] if empty else group + titles[i]
    return result


def _dates(columns: Mapping[str, Values]) -> Iterator[tuple[str, Array, list[str]]]:
    """Times [s since 1970] of which year, month ... second are columns of their own."""
    groups = defaultdict[str, dict[str, str]](dict)
    for name, values in columns.items():
        match = re.fullmatch(rf"(.*?)[ _.]?({'|'.join(PARTS)})[a-z]*", name, re.IGNORECASE)
        if match and values.dtype != np.object_:
            groups[match[1]][match[2].lower()] = name
    for stem, own in groups.items():
        if set(own) == set(PARTS):
            year, month, day, *clock = (np.asarray(columns[own[part]], float) for part in PARTS)
            whole = np.nan_to_num([year - 1970.0, month - 1.0, day - 1.0]).astype(np.int64)
            months = whole[0].astype("datetime64[Y]").astype("datetime64[M]") + whole[1]
            midnight = (months.astype("datetime64[D]") + whole[2]).astype("datetime64[s]")
            t = midnight.astype(np.float64) + np.array([3600.0, 60.0, 1.0]) @ clock
            yield stem or "date_time", t + 0.0 * (year + month + day), list(own.values())


def _angles(columns: Mapping[str, Values]) -> dict[str, Array]:
    """Latitude and longitude written as DDMM.mm, in degrees; their sides may stand beside them."""
    known = {kind: n for n, x in columns.items() if x.dtype != np.object_ and len(x)
             for kind in ("lat", "lon") if re.search(rf"(?i)\b{kind}", n)}  # fmt: skip
    result = dict[str, Array]()
    largest = np.nanmax(np.abs(columns[known["lat"]]), initial=0.0) if len(known) == 2 else 0.0
    minutes = [np.nanmax(np.abs(columns[name]) % 100.0, initial=0.0) for name in known.values()]
    if not 90.0 < largest <= 9000.0 or max(minutes) >= 60.0:
        return result
    for kind, sides in (("lat", {"N", "S"}), ("lon", {"E", "W"})):
        result[known[kind]] = degrees(columns[known[kind]])
        for cells in columns.values():
            if cells.dtype == np.object_ and (there := set(cells) - {""}) and there <= sides:
                result[known[kind]] *= np.where(np.isin(cells, ("S", "W")), -1.0, 1.0)
    return result


def degrees(values: Values) -> Array:
    """Degrees of numbers that are written as degrees and minutes, DDMM.mm, (N,)."""
    numbers = np.asarray(values, dtype=np.float64)
    whole = np.trunc(numbers / 100.0)
    return np.asarray(whole + (numbers - 100.0 * whole) / 60.0)


def column(sources: Mapping[str, Source], name: str) -> tuple[Source, str]:
    """The source and the name of a column: `column` where that is unique, or `source:column`.

    A source may be named by the end of its path. Raises RecordingError if there is no such column,
    or several.
    """
    searched, title = list(sources.values()), name
    place = os.path.commonpath([source.path for source in searched])
    if ":" in name and not any(source.find(name) for source in searched):
        wanted, _, title = name.rpartition(":")
        ending = f"/{wanted.lstrip('/')}"
        searched = [source for source in searched if f"/{source.name}".endswith(ending)]
        searched = [sources[wanted]] if wanted in sources else searched
        if not searched:
            known = _listing(sources)
            raise RecordingError(f"{place}: no source {wanted!r}, expected it among {known}")
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


@dataclass(frozen=True)
class TextOptions:
    """How a text file is written; null: found out from the file.

    `header_lines` counts the lines of names (0: none): the names stand in the first, units may
    stand in the second. `skip_lines` are passed over before. `names` replace those of the header.
    """

    separator: str | None = None  # one character; " ": any white space
    decimal: Literal[".", ","] | None = None
    encoding: str | None = None
    comment: str | None = "#"  # beginning of lines that are passed over
    skip_lines: Annotated[int, Ge(0)] = 0
    header_lines: Annotated[int, Ge(0)] | None = None
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_ranges(self)
        mark = self.separator
        if mark is not None and (len(mark) != 1 or mark in '"\r\n' or mark == self.decimal):
            raise ConfigurationError(
                f"separator: got {mark!r}, expected one character, another than the decimal"
            )
        try:
            codecs.lookup(self.encoding or "utf-8")
        except LookupError as error:
            raise ConfigurationError(f"encoding: {error}, expected one such as latin-1") from error


@dataclass(frozen=True)
class ReadOptions:
    """How files are read; `format` null: by the suffix of each file, else by its content.

    `messages` are files `.msg` with definitions of messages of ROS that a bag lacks.
    """

    format: str | None = None
    text: TextOptions = field(default_factory=TextOptions)
    messages: tuple[str, ...] = ()


def read_sources(path: Path, options: ReadOptions) -> dict[str, Source]:
    """Read a file, or all files of a folder, as sources by name; the last ones are kept.

    Raises RecordingError if a file cannot be read, ConfigurationError for a format that is not
    known or whose package is not installed.
    """
    stamps: list[tuple[int, ...]] = []
    with suppress(OSError, ValueError):  # which reading it says
        for file in (*map(Path, options.messages), path, *path.rglob("*")):
            state = file.stat()
            stamps.append((state.st_mtime_ns, state.st_size, state.st_ino))
    return dict(_sources(path, options, tuple(stamps)))


@lru_cache(maxsize=1)
def _sources(
    path: Path, options: ReadOptions, stamp: tuple[tuple[int, ...], ...]
) -> dict[str, Source]:
    """Those of a file in one state of it: what checks a recording reads it several times."""
    if options.format not in (None, *FORMATS):
        raise ConfigurationError(
            f"excitation.format: got {options.format!r}, expected one of {', '.join(FORMATS)}"
        )
    if not path.is_dir() and not path.is_file():
        problem = "is not a regular file" if path.exists() else "there is no such file"
        shown = str(path).replace("\0", "\\0")
        raise RecordingError(f"{shown}: {problem}, expected a recording")
    bag = (path / BAG).is_file() and options.format in (None, "rosbag")
    files = {path: ""} if bag or path.is_file() else _files(path, options)
    sources: dict[str, Source] = {}
    for file, name in files.items():
        try:
            known = _read(file, options)
        except OSError as error:
            raise RecordingError(
                f"{file}: cannot be read ({error.strerror or error}), expected a recording"
            ) from error
        for source in known:
            own = "" if name and source.name == file.stem else source.name
            full = "/".join(filter(None, (name, own)))
            sources[full] = replace(source, name=full)
    return sources


def _read(path: Path, options: ReadOptions) -> list[Source]:
    """The sources of one file: its format by the option, else by its suffix or its content."""
    suffix = path.suffix.lower()
    kind = options.format or ("rosbag" if path.is_dir() else SUFFIXES.get(suffix))
    if options.format is None and (kind is None or suffix in ANY) and path.is_file():
        with path.open("rb") as file:
            head = file.read(4096)
        told = (name for name, form in FORMATS.items() if re.match(form.begins, head, re.DOTALL))
        kind = next(told, kind)
        if kind is None and b"\0" in head and head[:2] not in (b"\xff\xfe", b"\xfe\xff"):
            raise RecordingError(
                f"{path}: is of no known format, expected {', '.join(FORMATS)} "
                f"({', '.join(SUFFIXES)})"
            )
    kind = kind or "dat"
    form, expected = FORMATS[kind], f"expected a recording in the format {kind}"
    if form.package is not None and find_spec(form.package) is None:
        extra = EXTRAS.get(kind, kind)
        raise ConfigurationError(
            f"{path}: {form.package} is not installed: pip install 'seatrial[{extra}]'"
        )
    # what is read at once must fit; a bag is read message by message
    if form.package != "rosbags" and (size := path.stat().st_size) > LARGEST_BYTES:
        raise RecordingError(
            f"{path}: got {size / 1e6:.0f} MB, expected at most {LARGEST_BYTES / 1e6:.0f}; cut the "
            "recording"
        )
    module, _, function = form.reader.partition(".")
    reader, quiet = import_module(f"{formats.__name__}.{module}"), io.StringIO()
    try:
        with warnings.catch_warnings(), redirect_stdout(quiet), redirect_stderr(quiet):
            warnings.simplefilter("ignore")
            sources, left_out = getattr(reader, function)(path, options)
    except Exception as error:  # a library may raise anything
        if isinstance(error, SeatrialError) or module == "text":
            raise
        reason = shorten(f"{type(error).__name__} {error}".strip(), 200, placeholder=" ...")
        raise RecordingError(f"{path}: cannot be read ({reason}), {expected}") from error
    if not sources:
        reasons = "".join(f"; {line}" for line in left_out)
        raise RecordingError(f"{path}: got no columns of numbers{reasons}, {expected}")
    return [replace(sources[0], left_out=(*left_out, *sources[0].left_out)), *sources[1:]]


def _files(folder: Path, options: ReadOptions) -> dict[Path, str]:
    """The recorded files below a folder, and their names relative to it, without suffix."""
    kinds = FORMATS if options.format is None else (options.format,)
    plain = {
        path: path.relative_to(folder).with_suffix("").as_posix()
        for path in sorted(folder.rglob("*"))
        if SUFFIXES.get(path.suffix.lower()) in kinds or path.suffix == f".{options.format}"
        if path.is_file()
    }
    if not plain:
        raise RecordingError(
            f"{folder}: is a folder without recordings, expected files with {', '.join(SUFFIXES)}"
        )
    counts = Counter(plain.values())
    return {
        path: name if counts[name] == 1 else path.relative_to(folder).as_posix()
        for path, name in plain.items()
    }
