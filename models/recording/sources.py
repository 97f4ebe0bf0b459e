"""Reads recordings as they are: files of any known format, and folders of them, as sources."""

import re
from collections import Counter
from contextlib import nullcontext
from dataclasses import replace
from functools import lru_cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.recording import formats
from seatrial.models.recording.source import LARGEST_BYTES, foreign
from seatrial.models.recording.source import ReadOptions as ReadOptions
from seatrial.models.recording.source import Source as Source
from seatrial.models.recording.source import TextArray as TextArray
from seatrial.models.recording.source import TextOptions as TextOptions
from seatrial.models.recording.source import column as column

MOST_FILES = 1000  # of a folder


class FileFormat(NamedTuple):
    """How a format is recognised, and the function of the folder `formats` that reads it."""

    suffixes: tuple[str, ...]
    reader: str  # file.function
    expected: str = ""  # for errors of a library that reads it
    package: str | None = None  # needed to read it
    extra: str = ""  # that installs the package
    begins: bytes = rb"(?!)"  # how a file begins, a regular expression


NMEA = rb"(?:[^\n]{0,200}\n){0,20}?[^\n]{0,100}[$!](?:[A-Z]{2}[A-Z\d]{3}|P[A-Z]{3,}),[^\n]*[,*]"
FORMATS: dict[str, FileFormat] = {
    name: FileFormat(tuple(suffixes.split()), *row)
    for name, suffixes, *row in (
        ("csv", ".csv .tsv", "text.read"),
        ("dat", ".dat .txt .asc .dba .log", "text.read"),
        ("excel", ".xlsx .xlsm", "tables.read_excel", "a workbook of Excel (.xlsx)", "openpyxl",
         "excel", rb"PK\x03\x04"),
        ("netcdf", ".nc .nc4 .cdf", "tables.read_netcdf", "a netCDF file", "xarray", "netcdf",
         rb"CDF[\x01\x02\x05]|\x89HDF"),
        ("ardupilot", ".bin .tlog", "messages.read_ardupilot", "a log of ArduPilot", "pymavlink",
         "ardupilot", rb"\xa3\x95|.{8}[\xfd\xfe].{5,}"),
        ("nmea", ".nmea .nma", "nmea.read", "sentences of NMEA 0183 with a time", "pynmea2",
         "nmea", NMEA),
        ("parquet", ".parquet .pq", "tables.read_parquet", "a Parquet file", None, "", rb"PAR1"),
        ("mat", ".mat", "tables.read_matlab", "a MATLAB file", None, "", rb"MATLAB "),
        ("rosbag", ".bag .db3 .mcap", "messages.read_bag", "a bag of ROS or an MCAP file",
         "rosbags", "ros", rb"#ROSBAG|\x89MCAP|SQLite format 3\0"),
        ("ulog", ".ulg .ulog", "messages.read_ulog", "a ULog file", "pyulog", "ulog",
         rb"ULog\x01"),
    )
}  # fmt: skip
SUFFIXES = {suffix: name for name, form in FORMATS.items() for suffix in form.suffixes}
BAG = "metadata.yaml"  # in a folder that is a bag of ROS 2
ANY = (".csv", ".txt", ".dat", ".log", ".asc", ".bin")  # suffixes of files of any content


def read_sources(path: Path, options: ReadOptions) -> dict[str, Source]:
    """Read a file, or all files of a folder, as sources by name; the last ones are kept.

    Raises RecordingError if a file cannot be read, ConfigurationError for a format that is not
    known or whose package is not installed.
    """
    try:
        files = [*map(Path, options.messages), path, *(path.rglob("*") if path.is_dir() else ())]
        stats = [file.stat() for file in files if file.exists()]
    except (OSError, ValueError):
        stats = []
    known = _sources(path, options, tuple((s.st_mtime_ns, s.st_size, s.st_ino) for s in stats))
    return dict(known)


@lru_cache(maxsize=1)
def _sources(
    path: Path, options: ReadOptions, stamp: tuple[tuple[int, ...], ...]
) -> dict[str, Source]:
    """Those of a file in one state of it: what checks a recording reads it several times."""
    if options.format not in (None, *FORMATS):
        raise ConfigurationError(
            f"excitation.format: got {options.format!r}, expected one of {', '.join(FORMATS)}"
        )
    file = path
    try:
        if not path.is_dir() and not path.is_file():
            problem = "is not a regular file" if path.exists() else "there is no such file"
            shown = str(path).replace("\0", "\\0")
            raise RecordingError(f"{shown}: {problem}, expected a recording")
        if path.is_file() or ((path / BAG).is_file() and options.format in (None, "rosbag")):
            return {source.name: source for source in _read(path, options)}
        sources: dict[str, Source] = {}
        for file, name in _files(path, options).items():
            for source in _read(file, options):
                full = name if source.name == file.stem else f"{name}/{source.name}"
                sources[full] = replace(source, name=full)
        return sources
    except OSError as error:
        raise RecordingError(
            f"{file}: cannot be read ({error.strerror or error}), expected a recording"
        ) from error


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
    form = FORMATS[kind or "dat"]
    if form.package is not None and find_spec(form.package) is None:
        raise ConfigurationError(
            f"{path}: {form.package} is not installed: pip install 'seatrial[{form.extra}]'"
        )
    # what is read at once must fit; a bag is read message by message
    if form.package != "rosbags" and (size := path.stat().st_size) > LARGEST_BYTES:
        raise RecordingError(
            f"{path}: got {size / 1e6:.0f} MB, expected at most {LARGEST_BYTES / 1e6:.0f}; cut the "
            "recording"
        )
    module, _, function = form.reader.partition(".")
    reader = getattr(import_module(f"{formats.__name__}.{module}"), function)
    with foreign(path, form.expected) if form.expected else nullcontext():
        sources, left_out = reader(path, options)
    if not sources:
        reasons = "".join(f"; {line}" for line in left_out)
        raise RecordingError(
            f"{path}: got no columns of numbers{reasons}, expected {form.expected}"
        )
    return [replace(sources[0], left_out=(*left_out, *sources[0].left_out)), *sources[1:]]


def _files(folder: Path, options: ReadOptions) -> dict[Path, str]:
    """The recorded files below a folder, and their names relative to it, without suffix."""
    kinds = FORMATS if options.format is None else (options.format,)
    found = [
        path
        for path in sorted(folder.rglob("*"))
        if SUFFIXES.get(path.suffix.lower()) in kinds or path.suffix == f".{options.format}"
        if path.is_file()
    ]
    if not found:
        raise RecordingError(
            f"{folder}: is a folder without recordings, expected files with {', '.join(SUFFIXES)}"
        )
    if len(found) > MOST_FILES:
        raise RecordingError(f"{folder}: got {len(found)} files, expected at most {MOST_FILES}")
    plain = {path: path.relative_to(folder).with_suffix("").as_posix() for path in found}
    counts = Counter(plain.values())
    return {
        path: name if counts[name] == 1 else path.relative_to(folder).as_posix()
        for path, name in plain.items()
    }
