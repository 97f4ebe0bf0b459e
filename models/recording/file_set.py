"""Several files as one recording: which are for training and which for testing."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from glob import glob, has_magic
from pathlib import Path

import numpy as np

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.recording.column_map import ColumnMap
from seatrial.models.recording.joining import end_to_end
from seatrial.models.recording.recording import Recording, Split, half
from seatrial.models.recording.sources import TextOptions

MOST_FILES = 1000


@dataclass(frozen=True)
class FileForm:
    """Columns and format of some of several files."""

    columns: ColumnMap
    format: str | None = None
    text: TextOptions = field(default_factory=TextOptions)


@dataclass(frozen=True)
class FileSet:
    """Files for training, then files for testing; without the latter every file is split."""

    train: tuple[Path, ...]
    test: tuple[Path, ...]

    @property
    def files(self) -> tuple[Path, ...]:
        """All files, in the order of the recording."""
        return (*self.train, *self.test)

    def read(self, read: Callable[[Path], Recording]) -> Recording:
        """Read each file alone, and put them end to end with gaps in time between them.

        Every sample keeps the number of its file, so nothing is differentiated or filtered over a
        joint. Raises RecordingError, with the file, if one differs in what it holds.
        """
        parts: list[Recording] = []
        for number, path in enumerate(self.files):
            part = read(path)
            parts.append(replace(part, file=np.full(len(part), number)))
            try:
                end_to_end([replace(part, file=None) for part in (parts[0], parts[-1])])
            except RecordingError as error:
                raise RecordingError(
                    f"{path}: {error}; excitation.resample_hz gives all files one sample time"
                ) from error
        for depth in range(1, max(len(path.parts) for path in self.files) + 1):
            names = tuple("/".join(path.parts[-depth:]) for path in self.files)
            if len(set(names)) == len(names):  # as much of the folders as tells the files apart
                break
        return replace(end_to_end(parts), file_names=names)

    def split(self, recording: Recording, train_fraction: float, initial_s: float) -> Split:
        """Training and test samples of the recording that `read` returns.

        A file for testing is not tested on in its first `initial_s` [s]: a free run starts from
        the state that is measured then.
        """
        assert recording.file is not None
        train = np.zeros(len(recording), dtype=np.bool_)
        test = train.copy()
        for number, path in enumerate(self.files):
            rows = np.flatnonzero(recording.file == number)
            t = recording.t[rows]
            if self.test and number < len(self.train):
                train[rows] = True
                continue
            parts = None if self.test else half(len(rows), train_fraction)
            train[rows] = False if parts is None else parts.train
            test[rows] = (t >= t[0] + initial_s) & (True if parts is None else parts.test)
            if (left := np.count_nonzero(test[rows])) < 2:
                raise ConfigurationError(
                    f"excitation.initial_s: got {initial_s:g} s, which leaves {left} samples "
                    f"for testing of {path}, {t[-1] - t[0]:g} s long; expected at least 2"
                )
        return Split(train, test)


def file_set(train: Sequence[str], test: Sequence[str]) -> FileSet:
    """The files that patterns such as `runs/*.csv` match, each pattern's in order of their names.

    Raises ConfigurationError if a pattern matches nothing, or a file is in both.
    """
    found: dict[str, dict[Path, None]] = {"train": {}, "test": {}}
    for option, patterns in (("train", train), ("test", test)):
        for pattern in patterns:
            if not pattern or any(character in pattern for character in "\0\r\n"):
                raise ConfigurationError(
                    f"excitation.{option}: got {pattern!r}, expected a file or a pattern of files"
                )
            wanted = str(Path(pattern).expanduser())
            # Path.glob takes no absolute patterns.
            every = glob(wanted, recursive=True) if has_magic(wanted) else [wanted]  # noqa: PTH207
            if not every:
                raise ConfigurationError(
                    f"excitation.{option}: got {pattern}, which matches no file, expected "
                    "recordings"
                )
            found[option] |= dict.fromkeys(Path(match) for match in sorted(every))
    if both := set(found["train"]) & set(found["test"]):
        raise ConfigurationError(
            f"excitation.test: got {min(both)}, which excitation.train has too, "
            "expected each file once"
        )
    known = FileSet(tuple(found["train"]), tuple(found["test"]))
    if len(known.files) > MOST_FILES:
        raise ConfigurationError(
            f"excitation.train and test: got {len(known.files)} files, expected at most {MOST_FILES}"
        )
    return known
