"""Several files as one recording: which are for training and which for testing."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from glob import glob, has_magic
from pathlib import Path
from typing import NamedTuple

from seatrial.models.errors import ConfigurationError
from seatrial.models.recording.column_map import ColumnMap
from seatrial.models.recording.source import TextOptions

MOST_FILES = 1000


@dataclass(frozen=True)
class FileForm:
    """Columns and format of some of several files."""

    columns: ColumnMap
    format: str | None = None
    text: TextOptions = field(default_factory=TextOptions)


class FileSet(NamedTuple):
    """Files for training, then files for testing; without the latter every file is split."""

    train: tuple[Path, ...]
    test: tuple[Path, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The names of all files, with as much of the folders as tells them apart."""
        files = (*self.train, *self.test)
        for depth in range(1, max(len(path.parts) for path in files) + 1):
            names = tuple("/".join(path.parts[-depth:]) for path in files)
            if len(set(names)) == len(names):
                break
        return names


def file_set(train: Sequence[str], test: Sequence[str]) -> FileSet:
    """The files that patterns such as `runs/*.csv` match, each pattern's in order of their names.

    Raises ConfigurationError if a pattern matches nothing, or a file is in both.
    """
    found: dict[str, dict[Path, None]] = {"train": {}, "test": {}}
    for option, pattern in (*(("train", p) for p in train), *(("test", p) for p in test)):
        problem = ""
        if not pattern or any(character in pattern for character in "\0\r\n"):
            problem = f"got {pattern!r}, expected a file or a pattern of files"
        wanted = str(Path(pattern).expanduser())
        # Path.glob takes no absolute patterns.
        every = glob(wanted, recursive=True) if has_magic(wanted) else [wanted]  # noqa: PTH207
        if problem or not every:
            problem = problem or f"got {pattern}, which matches no file, expected recordings"
            raise ConfigurationError(f"excitation.{option}: {problem}")
        found[option] |= dict.fromkeys(Path(match) for match in sorted(every))
    if both := set(found["train"]) & set(found["test"]):
        raise ConfigurationError(
            f"excitation.test: got {min(both)}, which excitation.train has too, "
            "expected each file once"
        )
    if (count := sum(map(len, found.values()))) > MOST_FILES:
        raise ConfigurationError(
            f"excitation.train and test: got {count} files, expected at most {MOST_FILES}"
        )
    return FileSet(tuple(found["train"]), tuple(found["test"]))
