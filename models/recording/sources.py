"""Reads recordings as they are: files of any known format, and folders of them, as sources."""

import re
from collections import Counter
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.recording import formats
from seatrial.models.recording.source import MARKS as MARKS
from seatrial.models.recording.source import ReadOptions as ReadOptions
from seatrial.models.recording.source import Source as Source
from seatrial.models.recording.source import TextArray as TextArray
from seatrial.models.recording.source import TextOptions as TextOptions
from seatrial.models.recording.source import column as column

MOST_FILES = 1000  # of a folder


class FileFormat(NamedTuple):
    """How a format is recognised, and the file of the folder `formats` that reads it."""

    suffixes: tuple[str, ...]
    file: str
    package: str | None = None  # needed to read it
    extra: str = ""  # that installs the package

    def read(self, path: Path, options: ReadOptions) -> list[Source]:
        """The sources of a file; the reader is loaded now: it may need a package."""
        reader = import_module(f"{formats.__name__}.{self.file}")
        sources: list[Source] = reader.read(path, options)
        return sources


FORMATS: dict[str, FileFormat] = {
    "csv": FileFormat((".csv", ".tsv"), "text"),
    "dat": FileFormat((".dat", ".txt", ".asc", ".dba", ".log"), "text"),
    "excel": FileFormat((".xlsx", ".xlsm"), "excel_file", "openpyxl", "excel"),
    "netcdf": FileFormat((".nc", ".nc4", ".cdf"), "netcdf_file", "xarray", "netcdf"),
    "ardupilot": FileFormat((".bin", ".tlog"), "ardupilot", "pymavlink", "ardupilot"),
    "nmea": FileFormat((".nmea", ".nma"), "nmea", "pynmea2", "nmea"),
    "parquet": FileFormat((".parquet", ".pq"), "parquet_file"),
    "mat": FileFormat((".mat",), "mat_file"),
    "rosbag": FileFormat((".bag", ".db3", ".mcap"), "ros_bag", "rosbags", "ros"),
    "ulog": FileFormat((".ulg", ".ulog"), "ulog_file", "pyulog", "ulog"),
}
BAG = "metadata.yaml"  # in a folder that is a bag of ROS 2
# Files whose suffix tells nothing: text, and those of programs that use any suffix.
CONTENTS: tuple[tuple[str, re.Pattern[bytes]], ...] = (
    ("ardupilot", re.compile(rb"\xa3\x95|FMT, ?128,|.{8}[\xfd\xfe].{5,}", re.DOTALL)),
    ("rosbag", re.compile(rb"#ROSBAG|\x89MCAP|SQLite format 3\0")),
    ("ulog", re.compile(rb"ULog\x01")),
    ("parquet", re.compile(rb"PAR1")),
    ("mat", re.compile(rb"MATLAB ")),
    ("netcdf", re.compile(rb"CDF[\x01\x02\x05]|\x89HDF")),
    ("excel", re.compile(rb"PK\x03\x04")),
    ("nmea", re.compile(rb"(?:[^\n]{0,200}\n){0,20}?[^\n]{0,100}[$!](?:[A-Z]{2}[A-Z\d]{3}|P[A-Z]{3,}),[^\n]*[,*]")),
)
ANY = (".csv", ".txt", ".dat", ".log", ".asc", ".bin")  # suffixes that say little


def read_sources(path: Path, options: ReadOptions) -> dict[str, Source]:
    """Read a file, or all files of a folder, as sources by name.

    Raises RecordingError if a file cannot be read, ConfigurationError for a format that is not
    known or whose package is not installed.
    """
    if options.format is not None and options.format not in FORMATS:
        raise ConfigurationError(
            f"excitation.format: got {options.format!r}, expected one of {', '.join(FORMATS)}"
        )
    _check(path)
    if not path.is_dir() or ((path / BAG).is_file() and options.format in (None, "rosbag")):
        return {source.name: source for source in _read(path, options)}
    sources: dict[str, Source] = {}
    for file, name in _files(path, options).items():
        for source in _read(file, options):
            own = source.name == file.stem
            full = name if own else f"{name}/{source.name}"
            sources[full] = replace(source, name=full)
    return sources


def _read(path: Path, options: ReadOptions) -> list[Source]:
    """The sources of one file, by the option or by its suffix."""
    kind = options.format or ("rosbag" if path.is_dir() else _format_of(path))
    if options.format is None and path.is_file() and (kind is None or path.suffix.lower() in ANY):
        kind = _kind_of_content(path) or kind or "dat"
    package, extra = FORMATS[kind].package, FORMATS[kind].extra
    if package is not None and find_spec(package) is None:
        raise ConfigurationError(
            f"{path}: {package} is not installed: pip install 'seatrial[{extra}]'"
        )
    try:
        return FORMATS[kind].read(path, replace(options, format=kind))
    except OSError as error:
        raise _unreadable(path, error) from error


def _format_of(path: Path) -> str | None:
    suffix = path.suffix.lower()
    return next((name for name, form in FORMATS.items() if suffix in form.suffixes), None)


def _kind_of_content(path: Path) -> str | None:
    """The format that the first bytes of a file tell; None for text."""
    try:
        with path.open("rb") as file:
            head = file.read(4096)
    except OSError as error:
        raise _unreadable(path, error) from error
    kind = next((name for name, pattern in CONTENTS if pattern.match(head)), None)
    if kind is None and b"\0" in head and head[:2] not in MARKS and _format_of(path) is None:
        raise RecordingError(
            f"{path}: is of no known format, expected {', '.join(FORMATS)} "
            f"({', '.join(suffix for form in FORMATS.values() for suffix in form.suffixes)})"
        )
    return kind


def _files(folder: Path, options: ReadOptions) -> dict[Path, str]:
    """The recorded files below a folder, and their names relative to it, without suffix."""
    found = [
        path
        for path in sorted(folder.rglob("*"))
        if path.is_file() and (_format_of(path) or options.format == path.suffix.lstrip("."))
    ]
    if options.format is not None:
        found = [path for path in found if _format_of(path) in (None, options.format)]
    if not found:
        suffixes = ", ".join(suffix for form in FORMATS.values() for suffix in form.suffixes)
        raise RecordingError(
            f"{folder}: is a folder without recordings, expected files with {suffixes}"
        )
    if len(found) > MOST_FILES:
        raise RecordingError(f"{folder}: got {len(found)} files, expected at most {MOST_FILES}")
    plain = {path: path.relative_to(folder).with_suffix("").as_posix() for path in found}
    counts = Counter(plain.values())
    return {
        path: name if counts[name] == 1 else path.relative_to(folder).as_posix()
        for path, name in plain.items()
    }


def _check(path: Path) -> None:
    """Raise RecordingError unless a path is a file or a folder that can be read."""
    try:
        if not path.exists():
            raise RecordingError(f"{path}: there is no such file, expected a recording")
        if not path.is_dir() and not path.is_file():
            raise RecordingError(f"{path}: is not a regular file, expected a recording")
    except (OSError, ValueError) as error:  # ValueError: a path with a null character
        raise _unreadable(path, error) from error


def _unreadable(path: Path, error: Exception) -> RecordingError:
    reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
    shown = str(path).replace("\0", "\\0")
    return RecordingError(f"{shown}: cannot be read ({reason}), expected a recording")
