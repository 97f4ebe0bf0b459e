"""Measured recordings as excitation: files that are read by a map, checked, and cut."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from glob import glob, has_magic
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.notation import DOFS, OrderedManoeuvre
from seatrial.models.ranges import NotNegative, check_ranges
from seatrial.models.recording import recording as recordings
from seatrial.models.recording.column_map import ColumnMap
from seatrial.models.recording.reader import Reading, ReadSignals, Sources
from seatrial.models.recording.recording import Recording, Split, half
from seatrial.models.recording.signals import central_difference
from seatrial.models.recording.source import ReadOptions, Source, TextOptions, read_sources
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import wrap

LEAST_SAMPLES = 2  # of a window


@dataclass(frozen=True)
class FileForm:
    """Columns and format of some of several files."""

    columns: ColumnMap
    format: str | None = None
    text: TextOptions = field(default_factory=TextOptions)


def matched(patterns: Sequence[str]) -> list[Path]:
    """The files that patterns such as `runs/*.csv` match, each pattern's in order of their names.

    Raises ConfigurationError if a pattern matches nothing.
    """
    every = dict[Path, None]()
    for pattern in patterns:
        wanted = str(Path(pattern).expanduser())
        # Path.glob takes no absolute patterns.
        files = glob(wanted, recursive=True) if has_magic(wanted) else [wanted]  # noqa: PTH207
        if not files:
            raise ConfigurationError(
                f"excitation: got {pattern}, which matches no file, expected recordings"
            )
        every |= dict.fromkeys(map(Path, sorted(files)))
    return [*every]


@dataclass(frozen=True, kw_only=True)
class RecordedFile(Reading):
    """A measured file as excitation, which is read, checked and cut instead of simulated.

    The samples strictly between `start_s` and `end_s` are used (null: all). The first
    `train_fraction` of them are for training, or the trips `training_trips` (counted from 1) if
    `trip_starts_s` is set. `train` and `test` name several files instead, which are read one by
    one; without `test`, `train_fraction` splits each of them. The first `initial_s` of a file are
    not tested on. The files of `test` may have columns of their own, `tested`.
    """

    path: str | None
    start_s: float | None
    end_s: float | None
    train_fraction: float
    trip_starts_s: tuple[float, ...]
    training_trips: tuple[int, ...]
    train: tuple[str, ...] = ()
    test: tuple[str, ...] = ()
    initial_s: NotNegative = 0.0
    tested: FileForm | None = None  # of the files of `test`, if it is another one
    format: str | None = None
    text: TextOptions = field(default_factory=TextOptions)
    messages: tuple[str, ...] = ()  # files of message definitions, for bags without them
    trust: bool = False  # also what does not agree
    manoeuvre: OrderedManoeuvre = field(default_factory=OrderedManoeuvre)
    map: str | None = None  # file of the columns; its content is in the other options
    test_map: str | None = None  # that of the files of `test`; its content is in `tested`
    _read: dict[Any, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_ranges(self)
        start, end = self.start_s, self.end_s
        problems = {
            "excitation.path: expected null beside train": self.path and (self.train or self.test),
            "excitation.test requires excitation.train, got none": self.test and not self.train,
            "excitation.test_map requires excitation.test": self.tested and not self.test,
            "trip_starts_s is of one file, got excitation.train": self.train and self.trip_starts_s,
            "excitation.path: expected a recording, got none": not self.path and not self.train,
            f"start_s must lie before end_s = {end or 0.0:g}, got {start or 0.0:g}":
                start is not None and end is not None and start >= end,
            "training_trips requires trip_starts_s": self.training_trips and not self.trip_starts_s,
        }  # fmt: skip
        if problem := next((text for text, there in problems.items() if there), None):
            raise ConfigurationError(problem)
        half(2, self.train_fraction)
        if starts := self.trip_starts_s:
            recordings.by_trips(np.array(starts), starts, self.training_trips)

    @cached_property
    def _sets(self) -> dict[str, list[Path]]:
        """The files of `train` and of `test`, or the one of `path`."""
        if not self.train:
            return {"path": [Path(self.path or "").expanduser()]}
        train, test = matched(self.train), matched(self.test)
        if both := set(train) & set(test):
            got = f"got {min(both)}, which excitation.train has too"
            raise ConfigurationError(f"excitation.test: {got}, expected each file once")
        return {"train": train, "test": test}

    @cached_property
    def readers(self) -> dict[Path, "RecordedFile"]:
        """The files of the recording, each with what reads it: those of `test` as `tested`."""
        tested = replace(self, **vars(self.tested)) if self.tested else self
        return {path: tested if option == "test" else self
                for option, files in self._sets.items() for path in files}  # fmt: skip

    def files(self) -> dict[str, Path]:
        """The files that are read, by option."""
        own = {option if option == "path" else f"{option}[{i}]": path
               for option, files in self._sets.items() for i, path in enumerate(files)}  # fmt: skip
        messages = {f"messages[{i}]": path for i, path in enumerate(self.messages)}
        others = {"map": self.map, "test_map": self.test_map} | messages
        return own | {name: Path(path).expanduser() for name, path in others.items() if path}

    def sources(self, path: Path | None = None) -> dict[str, Source]:
        """The columns of a file as recorded, of the first one by default."""
        options = ReadOptions(self.format, self.text, self.messages)
        return read_sources(path or next(iter(self.readers)), options)

    def check(self, dofs: Sequence[str]) -> None:
        """Raise ConfigurationError if a column for the vessel is not mapped; does not read it."""
        self.columns.check(dofs)
        if self.tested is not None:
            self.tested.columns.check(dofs)

    def read(self, dofs: Sequence[str]) -> Recording:
        """The recording of a vessel with these degrees of freedom.

        Raises RecordingError, which names file, line and column.
        """
        self.check(dofs)
        return self.recording(dofs)

    def account(self, dofs: Sequence[str], sources: Sources | None = None) -> list[ReadSignals]:
        """How each file is read, once; `sources` are the columns of one file, if not its own."""
        read: list[ReadSignals] = self._read.setdefault(tuple(dofs), [])
        for path, reader in [*self.readers.items()][len(read) :]:
            read.append(reader.signals(path, sources or reader.sources(path), dofs))
        return read

    def recording(self, dofs: Sequence[str], sources: Sources | None = None) -> Recording:
        """The recording of all files, each read alone, end to end with gaps in time between them.

        Nothing is differentiated or filtered over a joint. `sources` is as in `account`; nothing
        needs to act on the vessel.
        """
        read = zip(self.readers.items(), self.account(dofs, sources), strict=True)
        parts = [reader._cut(path, signals, dofs) for (path, reader), signals in read]
        if not self.train:
            return parts[0]
        depths = range(1, 1 + max(len(path.parts) for path in self.readers))
        every = (tuple("/".join(p.parts[-depth:]) for p in self.readers) for depth in depths)
        names = next(names for names in every if len(set(names)) == len(names))  # tell them apart
        parts = [replace(part, file=np.full(len(part), number), file_names=names)
                 for number, part in enumerate(parts)]  # fmt: skip
        return recordings.end_to_end(parts)

    def _cut(self, path: Path, signals: ReadSignals, dofs: Sequence[str]) -> Recording:
        """The recording of one file in its window, with what is missing derived from the rest.

        These are accelerations, positions that are not needed (the way made good), and angles (0).
        """
        t, known = signals.t, signals.values

        def stack(kind: str, names: Sequence[str]) -> Array:
            return np.column_stack([known[f"{kind}.{name}"] for name in names])

        if missing := [dof for dof in dofs if f"velocity.{dof}" not in known]:
            text = f"no column for {', '.join(missing)}, nor a position to differentiate"
            raise ConfigurationError(f"excitation.columns.velocity: {text}")
        start = -np.inf if self.start_s is None else self.start_s
        end = np.inf if self.end_s is None else self.end_s
        rows = (start < t) & (t < end)
        if (count := np.count_nonzero(rows)) < LEAST_SAMPLES:
            got = f"{path}: got {count} samples with {start:g} < t < {end:g} s, expected at least 2"
            raise RecordingError(f"{got}; the file holds {t[0]:g} to {t[-1]:g} s")
        period, nu = recordings.sample_time(t), stack("velocity", dofs)
        difference = partial(central_difference, period_s=period)
        nu_dot = recordings.piecewise(difference, recordings.piece_edges(t, period), nu)
        level = dict.fromkeys((f"position.{dof}" for dof in DOFS[3:]), 0.0 * t)
        rates = {f"acceleration.{d}": x for d, x in zip(dofs, nu_dot.T, strict=True)}
        t, nu, known = t[rows], nu[rows], {o: x[rows] for o, x in (level | rates | known).items()}
        psi = known["position.yaw"]
        known["position.yaw"] = psi + (wrap(psi[0]) - psi[0])
        way = scipy.integrate.cumulative_trapezoid(nu, t, axis=0, initial=0.0)
        known = {f"position.{dof}": x for dof, x in zip(dofs, way.T, strict=True)} | known
        inputs, loads = tuple(self.columns.inputs), tuple(self.columns.loads)
        commands = tuple(self.columns.commands)
        measured: dict[str, Any] = {"tau": np.zeros_like(nu)} | {
            field: stack(kind, names) for field, kind, names in (
                ("tau", "force", dofs), ("tau_actual", "actual_force", dofs),
                ("wind", "air", DOFS[:2]), ("inputs", "inputs", inputs),
                ("commands", "commands", commands), ("loads", "loads", loads))
            if names and all(f"{kind}.{name}" in known for name in names)
        }  # fmt: skip
        return Recording(
            tuple(dofs), t, stack("position", dofs), nu, stack("acceleration", dofs),
            attitude=stack("position", DOFS[3:]), input_names=inputs, load_names=loads,
            **measured,
        )  # fmt: skip

    def split(self, t: Array, file: NDArray[np.int64] | None = None) -> Split:
        """Training and test samples of the recording that `read` returns.

        Its times are t (N,) [s], `file` (N,) the number of the file of each sample, of several. A
        file is not tested on in its first `initial_s` [s]: a free run starts from what is measured
        then. Raises ConfigurationError if too little is left for one of them.
        """
        if self.trip_starts_s:
            return recordings.by_trips(t, self.trip_starts_s, self.training_trips)
        if file is None:
            return half(len(t), self.train_fraction)
        train, test = np.zeros((2, len(t)), dtype=np.bool_)
        for number, path in enumerate(self.readers):
            rows = np.flatnonzero(file == number)
            tested = not self.test or path in self._sets["test"]
            own = half(len(rows), self.train_fraction)
            train[rows] = not tested if self.test else own.train
            late = t[rows] >= t[rows[0]] + self.initial_s
            test[rows] = late & (tested if self.test else own.test)
            if tested and (left := np.count_nonzero(test[rows])) < LEAST_SAMPLES:
                got = f"got {self.initial_s:g} s, which leaves {left} samples for testing of {path}"
                length = f"{np.ptp(t[rows]):g} s long; expected at least {LEAST_SAMPLES}"
                raise ConfigurationError(f"excitation.initial_s: {got}, {length}")
        return Split(train, test)
