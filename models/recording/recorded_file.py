"""Measured recordings as excitation: files that are read by a map, checked, and cut."""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.notation import DOFS, PLANAR
from seatrial.models.ranges import NotNegative, Positive, check_ranges
from seatrial.models.recording import recording as recordings
from seatrial.models.recording.column_map import Column, ColumnMap, as_column
from seatrial.models.recording.diagnosis import Examination, examine
from seatrial.models.recording.file_set import FileForm, file_set
from seatrial.models.recording.joining import AtGap, TimeGrid
from seatrial.models.recording.preprocessing import (
    Description,
    Differentiation,
    describe,
    without_bias,
)  # fmt: skip
from seatrial.models.recording.reader import Outliers, Reading, Signals, clock_of, first_time
from seatrial.models.recording.recording import Mask, Recording, Split, half
from seatrial.models.recording.sources import ReadOptions, Source, TextOptions, column, read_sources
from seatrial.models.recording.stored import is_stored, read_recording
from seatrial.models.recording.times import EPOCH_S, seconds
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import unroll, wrap
from seatrial.models.vessel.thruster import AzimuthThrusters

LEAST_SAMPLES = 2  # of a window


class MeasuredRecording(ABC):
    """A measured recording as excitation, which is read instead of simulated."""

    def check(self, dofs: Sequence[str]) -> None:  # noqa: B027 - every vessel is accepted
        """Raise ConfigurationError if the recording does not suit a vessel; does not read it."""

    def files(self) -> dict[str, Path]:
        """Paths of the files that are read, by option."""
        return {}

    @abstractmethod
    def read(self, dofs: Sequence[str]) -> Recording:
        """Read the recording of a vessel with these degrees of freedom; raises RecordingError."""

    def split(self, t: Array) -> Split:
        """Training and test samples of the recording that `read` returns; times t [s], (N,)."""
        return half(len(t))

    def split_of(self, recording: Recording) -> Split:
        """Training and test samples of the recording that `read` returns."""
        return self.split(recording.t)

    def describe(self) -> tuple[Description, ...]:
        """Descriptive statistics of the recorded columns."""
        return ()

    def examine(self, dofs: Sequence[str]) -> Examination | None:
        """Whether pose and velocity belong together; None if they cannot be compared."""
        return None

    @property
    def trusted(self) -> bool:
        """Whether the recording is taken also if pose and velocity do not belong together."""
        return False

    def outlier_counts(self, dofs: Sequence[str]) -> dict[str, int]:
        """Number of outliers in each column."""
        return {}

    def account(self, dofs: Sequence[str]) -> Sequence[Signals]:
        """How each file was read: units with their origin, and what was left out."""
        return ()


@dataclass(frozen=True)
class RecordedFile(MeasuredRecording):
    """A measured file as excitation, which is read, checked and cut instead of simulated.

    The samples strictly between `start_s` and `end_s` are used (null: all). The first
    `train_fraction` of them are for training, or the trips `training_trips` (counted from 1) if
    `trip_starts_s` is set. Either the file is sampled uniformly, with `sample_time_s` (null: the
    median step), or every column has its own samples with empty cells between them, and all
    columns are resampled on one grid with `resample_hz`. `heading_deg` is the heading of the frame
    of the positions in the frame of the orientation: 180 if both horizontal positions are
    reversed. `train` and `test` name several files instead, which are read one by one; without
    `test`, `train_fraction` splits each of them. The first `initial_s` of a file are not tested on.
    The files of `test` may have columns of their own, `tested`.
    """

    path: str | None
    start_s: float | None
    end_s: float | None
    sample_time_s: Positive | None
    resample_hz: Positive | None
    max_gap_s: Positive
    at_gap: AtGap
    train_fraction: float
    trip_starts_s: tuple[float, ...]
    training_trips: tuple[int, ...]
    heading_deg: float
    columns: ColumnMap
    outliers: Outliers
    zero_acceleration_bias: bool
    differentiation: Differentiation
    thrusters: AzimuthThrusters
    statistics: tuple[str, ...]
    train: tuple[str, ...] = ()
    test: tuple[str, ...] = ()
    initial_s: NotNegative = 0.0
    tested: FileForm | None = None  # of the files of `test`, if it is another one
    format: str | None = None
    text: TextOptions = field(default_factory=TextOptions)
    messages: tuple[str, ...] = ()  # files of message definitions, for bags without them
    trust: bool = False
    map: str | None = None  # file of the columns; its content is in the other options
    test_map: str | None = None  # that of the files of `test`; its content is in `tested`
    _read: dict[tuple[str, ...], Signals] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )
    _sources: dict[str, Source] = field(default_factory=dict, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        check_ranges(self)
        if self.path and (self.train or self.test):
            raise ConfigurationError(
                "excitation.path and excitation.train name files, expected one of them to be null"
            )
        if self.test and not self.train:
            raise ConfigurationError("excitation.test requires excitation.train, got none")
        if self.tested is not None and not self.test:
            raise ConfigurationError("excitation.test_map is of files of excitation.test, got none")
        if self.train and self.trip_starts_s:
            raise ConfigurationError("trip_starts_s is of one file, got excitation.train")
        if not self.path and not self.train:
            raise ConfigurationError("excitation.path: expected a recording, got none")
        if any(character in (self.path or "") for character in "\0\r\n"):
            raise ConfigurationError(f"path: got {self.path!r}, expected one line of text")
        if self.start_s is not None and self.end_s is not None and self.start_s >= self.end_s:
            raise ConfigurationError(
                f"start_s must lie before end_s = {self.end_s:g}, got {self.start_s:g}"
            )
        if self.sample_time_s is not None and self.resample_hz is not None:
            raise ConfigurationError(
                f"sample_time_s = {self.sample_time_s:g} requires a uniform file and resample_hz = "
                f"{self.resample_hz:g} resamples it, expected one of them to be null"
            )
        half(2, self.train_fraction)
        recordings.trips(np.zeros(1), self.trip_starts_s)
        if len(self.training_trips) and not len(self.trip_starts_s):
            raise ConfigurationError("training_trips requires trip_starts_s, got none")
        if self.trip_starts_s:
            recordings.by_trips(np.arange(1, 1 + len(self.trip_starts_s)), self.training_trips)
        if self.thrusters.rpm and self.columns.actual_force:
            raise ConfigurationError(
                "thrusters.rpm and columns.actual_force both define the acting force, expected one"
            )

    @property
    def file(self) -> Path:
        """Path of the file, with `~` replaced by the home folder."""
        return Path(self.path or "").expanduser()

    def files(self) -> dict[str, Path]:
        """The recorded files, by option."""
        own = {"path": self.file}
        if self.train:
            known = file_set(self.train, self.test)
            parts = {"train": known.train, "test": known.test}
            own = {f"{k}[{i}]": path for k, files in parts.items() for i, path in enumerate(files)}
        others = {"map": self.map, "test_map": self.test_map}
        others |= {f"messages[{i}]": path for i, path in enumerate(self.messages)}
        return own | {name: Path(path).expanduser() for name, path in others.items() if path}

    def check(self, dofs: Sequence[str]) -> None:
        """Raise ConfigurationError if a column for the vessel is not mapped; does not read it."""
        self.columns.check(dofs)
        if self.tested is not None:
            self.tested.columns.check(dofs)

    def read(self, dofs: Sequence[str]) -> Recording:
        """Read the recording of a vessel with these degrees of freedom.

        Raises RecordingError, which names file, line and column. The low-pass filter of an
        identifier is applied later: it is linear, so it commutes with the differentiation.
        """
        self.check(dofs)
        return self._recording(dofs)

    def _recording(self, dofs: Sequence[str]) -> Recording:
        if self.train:
            files = file_set(self.train, self.test)
            return files.read(lambda file: self._alone(file)._recording(dofs))
        if self._is_stored:
            recording = read_recording(self.file, dofs)
            return recording.part(self._window(recording.t))
        signals, n = self._signals(dofs), len(dofs)
        t, values = signals.t, signals.values
        rows = self._window(t)

        def of(kind: str) -> Array | None:
            columns = [values.get(f"{kind}.{dof}") for dof in dofs]
            known = [c for c in columns if c is not None]
            return np.column_stack(known) if len(known) == n else None

        def named(kind: str, names: Mapping[str, str | Column]) -> Array | None:
            known = [values[f"{kind}.{name}"][rows] for name in names]
            return np.column_stack(known) if known else None

        nu = of("velocity")
        if nu is None:
            missing = [dof for dof in dofs if f"velocity.{dof}" not in values]
            raise ConfigurationError(
                f"excitation.columns.velocity: no column for {', '.join(missing)}, nor a position "
                "to differentiate"
            )
        tau = of("force") if self.columns.force else None
        acting, zero = self._acting(values, dofs), np.zeros(len(t))
        attitude = np.column_stack([values.get(f"position.{dof}", zero) for dof in DOFS[3:]])[rows]
        attitude[:, 2] = unroll(np.concatenate([[wrap(attitude[0, 2])], attitude[1:, 2]]))
        return Recording(
            tuple(dofs), t[rows], self._pose(signals, rows, attitude, dofs), nu[rows],
            self._acceleration(signals, nu, dofs)[rows],
            np.zeros_like(nu[rows]) if tau is None else tau[rows], attitude,
            tau_actual=None if acting is None else acting[rows],
            inputs=named("inputs", self.columns.inputs),
            commands=named("commands", self.columns.commands),
            input_names=tuple(self.columns.inputs),
            wind=self._air(values, rows, attitude, nu, dofs),
            loads=named("loads", self.columns.loads), load_names=tuple(self.columns.loads),
        )  # fmt: skip

    def _signals(self, dofs: Sequence[str]) -> Signals:
        """The used columns in SI units and our frames; read once."""
        key = tuple(dofs)
        if key not in self._read:
            grid = None
            if self.resample_hz:
                grid = TimeGrid(self.resample_hz, self.max_gap_s, self.at_gap)
            more: dict[str, Column] = {}
            if self._has_thruster_force(dofs):
                for kind in ("rpm", "angle"):
                    names = enumerate(getattr(self.thrusters, kind))
                    more |= {f"thruster_{kind}.{i}": Column(name) for i, name in names}
            reading = Reading(
                self.columns, grid, self.sample_time_s, self.outliers, self.heading_deg, more
            )
            self._read[key] = reading.read(self.file, self.sources(), dofs)
        return self._read[key]

    def sources(self) -> dict[str, Source]:
        """The columns as recorded, by source."""
        if self._sources:
            return self._sources
        return read_sources(self.file, ReadOptions(self.format, self.text, self.messages))

    @property
    def _is_stored(self) -> bool:
        """Whether the file is in our own form, which needs no map; options that clean are void."""
        return is_stored(self.file)

    def _alone(self, file: Path) -> "RecordedFile":
        """The reader of one of several files."""
        alone = replace(self, path=str(file), train=(), test=(), tested=None, test_map=None)
        if self.tested is None or file not in file_set(self.train, self.test).test:
            return alone
        form = self.tested
        return replace(alone, columns=form.columns, format=form.format, text=form.text)

    def _each(self) -> "list[RecordedFile]":
        """The readers of the files that are not in our own form, one by one."""
        every = [self]
        if self.train:
            every = [self._alone(file) for file in file_set(self.train, self.test).files]
        return [reader for reader in every if not reader._is_stored]

    def account(self, dofs: Sequence[str]) -> Sequence[Signals]:
        """How each file was read: units with their origin, and what was left out."""
        return [reader._signals(dofs) for reader in self._each()]

    def outlier_counts(self, dofs: Sequence[str]) -> dict[str, int]:
        """Number of outliers in each used column, over the entire files."""
        totals: Counter[str] = Counter()
        for signals in self.account(dofs):
            totals.update(signals.outliers)
        return dict(totals)

    def examine(self, dofs: Sequence[str]) -> Examination | None:
        """Compare pose and velocity, with all degrees of freedom that the file holds."""

        each = self._each()
        whole = each[0].sources() if each else {}

        def read(
            columns: ColumnMap,
            dofs: Sequence[str],
            sources: dict[str, Source] | None = None,
            **options: Any,
        ) -> Recording:
            reader = replace(self, columns=columns, **options)
            if not self.train:  # the file is parsed once
                reader._sources.update(sources or whole)
            return reader._recording(dofs)

        return examine(read, self.columns, whole, dofs, self.heading_deg)

    @property
    def trusted(self) -> bool:
        """Whether `trust` overrides what does not agree."""
        return self.trust

    def split(self, t: Array) -> Split:
        """Training and test samples of the recording that `read` returns; times t [s], (N,).

        Raises ConfigurationError if the window contains no trip for training or none for testing.
        """
        if not self.trip_starts_s:
            return half(len(t), self.train_fraction)
        return recordings.by_trips(recordings.trips(t, self.trip_starts_s), self.training_trips)

    def split_of(self, recording: Recording) -> Split:
        """Training and test samples; several files are split by file."""
        if not self.train:
            return self.split(recording.t)
        files = file_set(self.train, self.test)
        return files.split(recording, self.train_fraction, self.initial_s)

    def describe(self) -> tuple[Description, ...]:
        """Descriptive statistics of the recorded columns `statistics` in the window."""
        if not self.statistics:
            return ()
        rows = []
        for reader in self._each():
            sources = reader.sources()
            start = first_time(sources, reader.columns)
            source = column(sources, as_column(reader.columns.time).name)[0]
            t = seconds(source, clock_of(source, reader.columns))
            window = reader._window(t - start if start > EPOCH_S else t)
            known = [name for name in self.statistics if source.find(name) is not None]
            described = describe({name: source.numbers(name, gaps=True)[window] for name in known})
            stem = f"{reader.file.stem}:" if self.train else ""
            rows += [replace(row, name=f"{stem}{row.name}") for row in described]
        return tuple(rows)

    def _acceleration(self, signals: Signals, nu: Array, dofs: Sequence[str]) -> Array:
        """nu_dot (N, n_dof), recorded (without bias if configured) or differentiated by pieces."""
        t, nu_dot = signals.t, np.empty_like(nu)
        period_s = recordings.sample_time(t)
        for a, b in pairwise(recordings.piece_edges(t, period_s)):
            nu_dot[a:b] = self.differentiation.derivative(nu[a:b], period_s)
            for i, dof in enumerate(dofs):
                recorded = signals.values.get(f"acceleration.{dof}")
                if recorded is not None:
                    part = recorded[a:b]
                    if self.zero_acceleration_bias:
                        part = without_bias(part, nu[a:b, i], period_s)
                    nu_dot[a:b, i] = part
        return nu_dot

    def _acting(self, values: Mapping[str, Array], dofs: Sequence[str]) -> Array | None:
        """The acting force (N, n_dof); None if a degree of freedom has none."""
        if self._has_thruster_force(dofs):
            count = range(len(self.thrusters.rpm))
            rpm, angle = (
                np.column_stack([values[f"thruster_{kind}.{i}"] for i in count])
                for kind in ("rpm", "angle")
            )
            try:
                force = self.thrusters.force(rpm, angle)
            except RecordingError as error:
                raise RecordingError(f"{self.file}: {error}") from error
            return force[:, [PLANAR.index(dof) for dof in dofs]]
        known = [values.get(f"actual_force.{dof}") for dof in dofs]
        columns = [c for c in known if c is not None]
        return np.column_stack(columns) if len(columns) == len(dofs) else None

    def _has_thruster_force(self, dofs: Sequence[str]) -> bool:
        """Whether motor speeds determine the acting force in all these degrees of freedom."""
        return bool(self.thrusters.rpm) and set(dofs) <= set(PLANAR)

    def _pose(self, signals: Signals, rows: Mask, attitude: Array, dofs: Sequence[str]) -> Array:
        """The pose (n, n_dof); a position in surge that is not recorded is the way made good."""
        poses, t = [], signals.t[rows]
        for dof in dofs:
            position = signals.values.get(f"position.{dof}")
            if dof in DOFS[3:]:
                poses.append(attitude[:, DOFS[3:].index(dof)])
            elif position is not None:
                poses.append(position[rows])
            else:
                speed = signals.values[f"velocity.{dof}"][rows]
                poses.append(scipy.integrate.cumulative_trapezoid(speed, t, initial=0.0))
        return np.column_stack(poses)

    def _air(
        self, values: Mapping[str, Array], rows: Mask, attitude: Array, nu: Array,
        dofs: Sequence[str],
    ) -> Array | None:  # fmt: skip
        """Velocity of the air over ground in body axes [m/s], (n, 2); None if not recorded."""
        if self.columns.wind is None or "wind.speed" not in values:
            return None
        speed, angle = (values[f"wind.{name}"][rows] for name in ("speed", "direction"))
        apparent = self.columns.wind.kind == "apparent"
        angle = angle if apparent else angle - attitude[:, 2]
        air = -speed[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        if apparent:
            air += nu[rows][:, [dofs.index(dof) for dof in ("surge", "sway")]]
        return np.asarray(air)

    def _window(self, t: Array) -> Mask:
        """Mask (N,) of the samples strictly between `start_s` and `end_s`."""
        start = -np.inf if self.start_s is None else self.start_s
        end = np.inf if self.end_s is None else self.end_s
        window = (start < t) & (t < end)
        if np.count_nonzero(window) < LEAST_SAMPLES:
            raise RecordingError(
                f"{self.file}: got {np.count_nonzero(window)} samples with {start:g} < t < {end:g} "
                f"s, expected at least 2; the file holds {t[0]:g} to {t[-1]:g} s"
            )
        return window
