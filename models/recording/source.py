"""Recordings as they are: files of any known format, and folders of them, as sources."""

import io
import os
import re
import warnings
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from textwrap import shorten
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError, RecordingError, SeatrialError
from seatrial.models.ranges import NotNegativeInt, check_ranges
from seatrial.models.vessel.basis import Array

LARGEST_MB = 268  # of a file that is read at once, and of the numbers of any recording
MOST_ELEMENTS = 64  # of an array in a message or of a matrix; larger ones are images and the like
TextArray: TypeAlias = NDArray[np.object_]  # of str, as written
Values: TypeAlias = Array | TextArray
# Cells that stand for no sample, as programs write them, in small letters.
MISSING = frozenset(
    ("", "nan", "+nan", "-nan", "n/a", "na", "n.a.", "#n/a", "#n/a n/a", "#na", "<na>", "nat",
     "null", "none", "nil", "-", "--", "---", "?", "missing", "1.#qnan", "-1.#ind", "1.#ind",
     "#value!", "#div/0!", "#num!", "#null!", "#ref!", "#name?")
)  # fmt: skip


class FileFormat(NamedTuple):
    """How a format is recognised, and the function of the folder `formats` that reads it."""

    suffixes: str
    reader: str  # file.function
    package: str | None = None  # needed to read it
    begins: bytes = rb"(?!)"  # how a file begins, a regular expression


NMEA = rb"(?:[^\n]{0,200}\n){0,20}?[^\n]{0,100}[$!](?:[A-Z]{2}[A-Z\d]{3}|P[A-Z]{3,}),[^\n]*[,*]"
MAVLINK = rb"\xa3\x95|FMT, ?\d|.{8}[\xfd\xfe].{5,}"
HDF = rb"(?:.{512})?\x89HDF"  # also MATLAB 7.3
BAG = rb"#ROSBAG|\x89MCAP|SQLite format 3\0"
FORMATS = {
    "csv": FileFormat(".csv .tsv", "text.read"),
    "dat": FileFormat(".dat .txt .asc .dba .log", "text.read"),
    "excel": FileFormat(".xlsx .xlsm", "tables.read_excel", "openpyxl", rb"PK\x03\x04"),
    "hdf5": FileFormat(".h5 .hdf5", "tables.read_hdf5", "h5py", HDF),
    "netcdf": FileFormat(".nc .nc4 .cdf", "tables.read_netcdf", "xarray", rb"CDF[\x01\x02\x05]"),
    "ardupilot": FileFormat(".bin .tlog", "tables.read_ardupilot", "pymavlink", MAVLINK),
    "nmea": FileFormat(".nmea .nma", "tables.read_nmea", "pynmea2", NMEA),
    "parquet": FileFormat(".parquet .pq", "tables.read_parquet", None, rb"PAR1"),
    "mat": FileFormat(".mat", "tables.read_matlab", None, rb"MATLAB [^7]"),
    "rosbag": FileFormat(".bag .db3 .mcap", "tables.read_bag", "rosbags", BAG),
    "ulog": FileFormat(".ulg .ulog", "tables.read_ulog", "pyulog", rb"ULog\x01"),
}
EXTRAS = {"rosbag": "ros", "hdf5": "mat"}  # others are called as their format
SUFFIXES = {suffix: name for name, form in FORMATS.items() for suffix in form.suffixes.split()}
ANY = {".csv", ".txt", ".dat", ".log", ".asc", ".bin", ".mat"}  # suffixes of files of any content


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
    titles: dict[str, str] = field(default_factory=dict)  # as written, where names differ
    left_out: tuple[str, ...] = ()  # what of the file was left out, and why
    # The place of a cell in its file, such as "line 7", and its text, by row and column.
    cell: Callable[[int, str], tuple[str, str]] | None = None
    times: dict[object, Array] = field(default_factory=dict, init=False, repr=False)  # as read

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))

    def find(self, name: str) -> str | None:
        """The column of a name, which may be written as in the header; None if there is none."""
        titled = [plain for plain, title in self.titles.items() if title == name]
        return name if name in self.columns else titled[0] if len(titled) == 1 else None

    def numbers(self, name: str, *, gaps: bool = False) -> Array:
        """The column `name` as numbers, shape (N,); `gaps` allows NaN, for missing values.

        Raises RecordingError, with file, column and line, if a cell is not a finite number.
        """
        values = self.columns[column({self.name: self}, name)[1]]
        text = values.dtype == np.object_
        wrong = np.ones(len(values), dtype=bool) if text else np.isnan(values)
        if np.any(wrong) and (text or not gaps):
            raise self.refused(int(np.argmax(wrong)), name)
        return np.asarray(values, dtype=np.float64)

    def refused(self, row: int, name: str, expected: str = "a finite number") -> RecordingError:
        """What is raised of a cell of a column `name` that is not what is expected."""
        column = self.find(name) or next(iter(self.columns))
        place, text = f"row {row + 1}", str(self.columns[column][row])
        place, text = self.cell(row, column) if self.cell else (place, text)
        got = repr(shorten(text, 40, placeholder="...")) if text.strip() else "an empty cell"
        place = f"{self.path}, column {name}, {place}"
        return RecordingError(f"{place}: got {got}, expected {expected}")


Contents: TypeAlias = tuple[list[Source], Sequence[str]]  # of a file, and what was left out


def column(sources: Mapping[str, Source], name: str) -> tuple[Source, str]:
    """The source and the name of a column: `column` where that is unique, or `source:column`.

    A source may be named by the end of its path. Raises RecordingError if there is no such column,
    or several.
    """
    every, (wanted, _, last) = list(sources.values()), name.rpartition(":")
    ending = f"/{wanted.lstrip('/')}"
    alike = [source for source in every if f"/{source.name}".endswith(ending)]
    alike = [sources[wanted]] if wanted in sources else alike
    holders = [(source, plain) for source in every if (plain := source.find(name))]
    holders = holders or [(source, plain) for source in alike if (plain := source.find(last))]
    if len(holders) == 1:
        return holders[0]
    got = f"{len(holders)} sources have a column" if holders else "no column"
    known = holders or [(source, plain) for source in alike or every for plain in source.columns]
    names = [plain if len(every) == 1 else f"{source.name}:{plain}" for source, plain in known]
    place, among = os.path.commonpath([s.path for s in every]), ", ".join(names)
    among = shorten(among, 600, placeholder=" ...")
    raise RecordingError(f"{place}: {got} {name!r}, expected it among {among}")


def check_size(path: Path, size: int) -> None:
    """Raise RecordingError if a recording has more bytes than are read at once."""
    if size > 1e6 * LARGEST_MB:
        got = f"{path}: got {size / 1e6:.0f} MB"
        raise RecordingError(f"{got}, expected at most {LARGEST_MB}; cut the recording")


@dataclass(frozen=True)
class TextOptions:
    """How a text file is written; null: found out from the file.

    `header_lines` counts the lines of names (0: none): the names stand in the first, units may
    stand in the second. `skip_lines` are passed over before. `names` replace those of the header.
    """

    separator: Literal["\t", ";", "|", ",", " "] | None = None  # " ": any white space
    decimal: Literal[".", ","] | None = None
    encoding: str | None = None
    comment: str | None = "#"  # beginning of lines that are passed over
    skip_lines: NotNegativeInt = 0
    header_lines: NotNegativeInt | None = None
    names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_ranges(self)


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
    files = (*map(Path, options.messages), path, *path.rglob("*"))
    states = (file.stat() for file in files if file.exists())
    return dict(_sources(path, options, tuple((s.st_mtime_ns, s.st_size) for s in states)))


@lru_cache(maxsize=1)
def _sources(path: Path, options: ReadOptions, stamp: tuple[object, ...]) -> dict[str, Source]:
    """Those of a file in one state of it: what checks a recording reads it several times."""
    if options.format not in (None, *FORMATS):
        got = f"excitation.format: got {options.format!r}"
        raise ConfigurationError(f"{got}, expected one of {', '.join(FORMATS)}")
    kinds, files = FORMATS if options.format is None else (options.format,), [path]
    if not path.is_file() and not ("rosbag" in kinds and (path / "metadata.yaml").is_file()):
        files = [file for file in sorted(path.rglob("*"))
                 if SUFFIXES.get(file.suffix.lower()) in kinds and file.is_file()]  # fmt: skip
    if not files:
        problem = "holds no recording" if path.exists() else "there is no such file"
        shown = str(path).replace("\0", "\\0")
        raise RecordingError(f"{shown}: {problem}, expected a recording: {', '.join(SUFFIXES)}")
    names = {f: f.relative_to(path).with_suffix("").as_posix() for f in files if f != path}
    counts, sources = Counter(names.values()), dict[str, Source]()
    for file in files:
        name = names.get(file, "")
        name = name if counts[name] < 2 else file.relative_to(path).as_posix()
        try:
            known = _read(file, options)
        except SeatrialError:
            raise
        except Exception as error:  # a library may raise anything
            got = shorten(f"{type(error).__name__} {error}".strip(), 200, placeholder=" ...")
            raise RecordingError(f"{file}: cannot be read ({got}), expected a recording") from error
        for source in known:
            own = "" if name and source.name == file.stem else source.name
            full = "/".join(filter(None, (name, own)))
            full = f"{full}/{len(sources)}" if full in sources else full
            sources[full] = replace(source, name=full)
    return sources


def _read(path: Path, options: ReadOptions) -> list[Source]:
    """The sources of one file: its format by the option, else by its suffix or its content."""
    suffix = path.suffix.lower()
    kind = options.format or ("rosbag" if path.is_dir() else SUFFIXES.get(suffix, "dat"))
    if options.format is None and path.is_file() and suffix not in SUFFIXES.keys() - ANY:
        with path.open("rb") as file:
            head = file.read(4096)
        told = (name for name, form in FORMATS.items() if re.match(form.begins, head, re.DOTALL))
        kind = next(told, kind)
    form = FORMATS[kind]
    if form.package is not None and find_spec(form.package) is None:
        way = f"pip install 'seatrial[{EXTRAS.get(kind, kind)}]'"
        raise ConfigurationError(f"{path}: {form.package} is not installed: {way}")
    if form.package != "rosbags":  # a bag is read message by message
        check_size(path, path.stat().st_size)
    module, _, function = form.reader.partition(".")
    reader, quiet = import_module(f"{__package__}.formats.{module}"), io.StringIO()
    with warnings.catch_warnings(), redirect_stdout(quiet), redirect_stderr(quiet):
        warnings.simplefilter("ignore")
        sources, left_out = getattr(reader, function)(path, options)
    if not sources:
        reasons = "".join(f"; {line}" for line in left_out)
        raise RecordingError(f"{path}: got no columns of numbers{reasons}, expected some of {kind}")
    return [replace(sources[0], left_out=(*left_out, *sources[0].left_out)), *sources[1:]]
