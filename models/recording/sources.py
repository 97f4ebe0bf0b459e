"""Reads recordings as they are: files of any known format, and folders of them, as sources."""

from collections import Counter
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.recording import formats
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
    "csv": FileFormat((".csv", ".tsv"), "text_file"),
    "dat": FileFormat((".dat", ".txt", ".asc"), "text_file"),
    "parquet": FileFormat((".parquet", ".pq"), "parquet_file"),
    "mat": FileFormat((".mat",), "mat_file"),
    "rosbag": FileFormat((".bag", ".db3", ".mcap"), "ros_bag", "rosbags", "ros"),
    "ulog": FileFormat((".ulg", ".ulog"), "ulog_file", "pyulog", "ulog"),
}
BAG = "metadata.yaml"  # in a folder that is a bag of ROS 2


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
    kind = options.format or ("rosbag" if path.is_dir() else _format_of(path)) or "csv"
    package, extra = FORMATS[kind].package, FORMATS[kind].extra
    if package is not None and find_spec(package) is None:
        raise ConfigurationError(
            f"{path}: {package} is not installed: pip install 'seatrial[{extra}]'"
        )
    try:
        return FORMATS[kind].read(path, ReadOptions(kind, options.text))
    except OSError as error:
        raise _unreadable(path, error) from error


def _format_of(path: Path) -> str | None:
    suffix = path.suffix.lower()
    return next((name for name, form in FORMATS.items() if suffix in form.suffixes), None)


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
