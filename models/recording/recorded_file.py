"""Measured recordings: a CSV file that is read, checked, optionally cleaned, and cut.

Interface of the readers of measured recordings; `recorded_file` implements it for CSV files.
"""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.notation import DOFS, PLANAR
from seatrial.models.ranges import NotNegative, Positive, check_ranges
from seatrial.models.recording.column import Column, as_column
from seatrial.models.recording.column_map import ColumnMap, ColumnTable, read_table
from seatrial.models.recording.diagnosis import Examination, examine
from seatrial.models.recording.file_set import FileForm, file_set
from seatrial.models.recording.joining import AtGap, Channel, TimeGrid, join_channels
from seatrial.models.recording.mapping import canonical
from seatrial.models.recording.preprocessing import (
    AzimuthThrusters,
    Description,
    Differentiation,
    describe,
    interpolated,
    outliers,
    without_bias,
)
from seatrial.models.recording.recording import (
    Mask,
    Recording,
    Split,
    by_trips,
    half,
    piece_edges,
    sample_time,
    trips,
)
from seatrial.models.recording.sources import ReadOptions, TextOptions, read_sources
from seatrial.models.recording.stored import is_stored, read_recording
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import unroll, wrap


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


UNIFORMITY = 0.01  # largest deviation of a step from the sample time, relative to it


@dataclass(frozen=True)
class Outliers:
    """Outliers: samples over `deviations` standard deviations from their `window` neighbours."""

    replace: bool
    window: Annotated[int, Ge(4)]
    deviations: Positive

    def __post_init__(self) -> None:
        check_ranges(self)


@dataclass(frozen=True)
class RecordedFile(MeasuredRecording):
    """A measured CSV file as excitation, which is read, checked and cut instead of simulated.

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
    trust: bool = False
    map: str | None = None  # file of the columns; its content is in the other options
    test_map: str | None = None  # that of the files of `test`; its content is in `tested`

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
        trips(np.zeros(1), self.trip_starts_s)
        if len(self.training_trips) and not len(self.trip_starts_s):
            raise ConfigurationError("training_trips requires trip_starts_s, got none")
        if self.trip_starts_s:
            by_trips(np.arange(1, 1 + len(self.trip_starts_s)), self.training_trips)
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
        maps = {"map": self.map, "test_map": self.test_map}
        return own | {name: Path(path).expanduser() for name, path in maps.items() if path}

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
        if self.train:
            return file_set(self.train, self.test).read(lambda file: self._alone(file).read(dofs))
        if self._is_stored:
            recording = read_recording(self.file, dofs)
            return recording.part(self._window(recording.t))
        reader, table = self._mapped(dofs)
        return reader._recording(reader._cleaned(table), dofs)

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

    def _recording(self, table: ColumnTable, dofs: Sequence[str]) -> Recording:
        t = table.columns[self._time]
        nu = self.columns.values(table, "velocity", dofs)
        steered = bool(self.columns.inputs) and not self.columns.force
        tau = np.zeros_like(nu) if steered else self.columns.values(table, "force", dofs)
        nu_dot, acting = self._acceleration(table, nu, dofs), self._acting(table, dofs)
        rows = self._window(t)
        attitude = self.columns.attitude(table, np.radians(self.heading_deg))[rows]
        attitude[:, 2] = unroll(np.concatenate([[wrap(attitude[0, 2])], attitude[1:, 2]]))
        return Recording(
            tuple(dofs), t[rows], self._pose(table, rows, attitude, dofs), nu[rows], nu_dot[rows],
            tau[rows], attitude, tau_actual=None if acting is None else acting[rows],
            inputs=self._inputs(table, rows, self.columns.inputs),
            commands=self._inputs(table, rows, self.columns.commands),
            input_names=tuple(self.columns.inputs),
            wind=self._air(table, rows, attitude, nu, dofs),
            loads=self._inputs(table, rows, self.columns.loads),
            load_names=tuple(self.columns.loads),
        )  # fmt: skip

    def _air(
        self, table: ColumnTable, rows: Mask, attitude: Array, nu: Array, dofs: Sequence[str]
    ) -> Array | None:
        """Velocity of the air (N, 2); None where it is not recorded, or has no meaning."""
        if not set(PLANAR) <= set(dofs):
            return None
        part = replace(table, columns={name: x[rows] for name, x in table.columns.items()})
        return self.columns.air(part, attitude[:, 2], nu[rows], dofs)

    @staticmethod
    def _inputs(table: ColumnTable, rows: Mask, names: Mapping[str, str | Column]) -> Array | None:
        """Inputs, commands or loads (N, n) by the names of a vessel; None if not recorded."""
        columns = [table.columns[as_column(name).name][rows] for name in names.values()]
        return np.column_stack(columns) if columns else None

    def examine(self, dofs: Sequence[str]) -> Examination | None:
        """Compare pose and velocity, with all degrees of freedom that the file holds."""

        def read(columns: ColumnMap, dofs: Sequence[str], **options: Any) -> Recording:
            return replace(self, columns=columns, **options).read(dofs)

        files = file_set(self.train, self.test).files if self.train else (self.file,)
        sources = read_sources(files[0], self._options)
        return examine(read, self.columns, sources, dofs, self.heading_deg)

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
        return by_trips(trips(t, self.trip_starts_s), self.training_trips)

    def split_of(self, recording: Recording) -> Split:
        """Training and test samples; several files are split by file."""
        if not self.train:
            return self.split(recording.t)
        files = file_set(self.train, self.test)
        return files.split(recording, self.train_fraction, self.initial_s)

    def outlier_counts(self, dofs: Sequence[str]) -> dict[str, int]:
        """Number of outliers in each used column, over the entire file."""
        if self.train:
            totals: Counter[str] = Counter()
            for file in file_set(self.train, self.test).files:
                totals.update(self._alone(file).outlier_counts(dofs))
            return dict(totals)
        if self._is_stored:
            return {}
        reader, table = self._mapped(dofs)
        return {name: int(np.sum(wrong)) for name, wrong in reader._outliers(table).items()}

    def describe(self) -> tuple[Description, ...]:
        """Descriptive statistics of the recorded columns `statistics` in the window."""
        if self.train:
            return tuple(
                replace(row, name=f"{file.stem}:{row.name}")
                for file in file_set(self.train, self.test).files
                for row in self._alone(file).describe()
            )
        if not self.columns.is_plain or self._is_stored:
            return ()
        table = read_table(self.file, (self._time,), self.statistics, self._options, gaps=True)
        window = self._window(table.columns[self._time])
        names = [name for name in self.statistics if name in table.columns]
        return describe({name: table.columns[name][window] for name in names})

    @property
    def _options(self) -> ReadOptions:
        return ReadOptions(self.format, self.text)

    @property
    def _time(self) -> str:
        """The column of time."""
        return as_column(self.columns.time).name

    def _mapped(self, dofs: Sequence[str]) -> "tuple[RecordedFile, ColumnTable]":
        """The used columns in SI units and our frames, and the reader whose map names them."""
        if self.columns.is_plain:
            return self, self._measured(dofs)
        self.check(dofs)
        sources = read_sources(self.file, self._options)
        grid = self.resample_hz and TimeGrid(self.resample_hz, self.max_gap_s, self.at_gap)
        try:
            known = canonical(sources, self.columns, dofs, grid or None, self.heading_deg)
        except RecordingError as error:
            named = str(error).startswith(str(self.file))
            raise error if named else RecordingError(f"{self.file}: {error}") from error
        if grid is None or self.at_gap == "refuse":
            check_time(known.table, "time", self.sample_time_s)
        return replace(self, columns=known.columns, resample_hz=None), known.table

    def _cleaned(self, table: ColumnTable) -> ColumnTable:
        if self.outliers.replace:
            columns, t = dict(table.columns), table.columns[self._time]
            for name, wrong in self._outliers(table).items():
                valid = ~np.isnan(columns[name])
                columns[name] = columns[name].copy()
                columns[name][valid] = interpolated(t[valid], columns[name][valid], wrong[valid])
            table = replace(table, columns=columns)
        return table if self.resample_hz is None else self._resampled(table, self.resample_hz)

    def _measured(self, dofs: Sequence[str]) -> ColumnTable:
        """The used columns as recorded, checked, with continuous angles and quaternions."""
        self.check(dofs)
        required = self.columns.required(dofs)
        if self._has_thruster_force(dofs):
            required += [*self.thrusters.rpm, *self.thrusters.angle]
        optional = (*self.columns.quaternion, *self.columns.angles())
        gaps = self.resample_hz is not None
        table = read_table(self.file, required, optional, self._options, gaps=gaps)
        if gaps and self.at_gap == "split":
            check_increasing(table, self._time)
        elif gaps:
            check_gaps(table, self._time, self.max_gap_s)
        else:
            check_time(table, self._time, self.sample_time_s)
        return self.columns.continuous(table, self.thrusters.angle)

    def _outliers(self, table: ColumnTable) -> dict[str, Mask]:
        """Masks (N,) of the outliers in every column except time, among its own samples."""
        masks = {}
        for name, values in table.columns.items():
            if name != self._time:
                valid = ~np.isnan(values)
                masks[name] = np.zeros(len(values), dtype=bool)
                masks[name][valid] = outliers(
                    values[valid], self.outliers.window, self.outliers.deviations
                )
        return masks

    def _resampled(self, table: ColumnTable, rate_hz: float) -> ColumnTable:
        t, channels = table.columns[self._time], {}
        for name, values in table.columns.items():
            valid = ~np.isnan(values)
            if name != self._time:
                channels[name] = Channel(t[valid], values[valid])
        try:
            grid = TimeGrid(rate_hz, self.max_gap_s, self.at_gap)
            joined = join_channels(channels, grid)
        except RecordingError as error:
            raise RecordingError(f"{table.path}: {error}") from error
        return replace(table, columns={self._time: joined.t, **joined.columns})

    def _acceleration(self, table: ColumnTable, nu: Array, dofs: Sequence[str]) -> Array:
        """nu_dot (N, n_dof), recorded (without bias if configured) or differentiated by pieces."""
        t, nu_dot = table.columns[self._time], np.empty_like(nu)
        period_s = sample_time(t)
        for a, b in pairwise(piece_edges(t, period_s)):
            nu_dot[a:b] = self.differentiation.derivative(nu[a:b], period_s)
            for i, dof in enumerate(dofs):
                if dof in self.columns.acceleration:
                    recorded = self.columns.values(table, "acceleration", (dof,))[a:b, 0]
                    if self.zero_acceleration_bias:
                        recorded = without_bias(recorded, nu[a:b, i], period_s)
                    nu_dot[a:b, i] = recorded
        return nu_dot

    def _acting(self, table: ColumnTable, dofs: Sequence[str]) -> Array | None:
        """The acting force (N, n_dof); None if a degree of freedom has none."""
        if self._has_thruster_force(dofs):
            rpm, angle = (
                np.column_stack([table.columns[name] for name in names])
                for names in (self.thrusters.rpm, self.thrusters.angle)
            )
            try:
                force = self.thrusters.force(rpm, angle)
            except RecordingError as error:
                raise RecordingError(f"{table.path}: {error}") from error
            return force[:, [PLANAR.index(dof) for dof in dofs]]
        if all(dof in self.columns.actual_force for dof in dofs):
            return self.columns.values(table, "actual_force", dofs)
        return None

    def _has_thruster_force(self, dofs: Sequence[str]) -> bool:
        """Whether motor speeds determine the acting force in all these degrees of freedom."""
        return bool(self.thrusters.rpm) and set(dofs) <= set(PLANAR)

    def _pose(
        self, table: ColumnTable, window: Mask, attitude: Array, dofs: Sequence[str]
    ) -> Array:
        poses = []
        for dof in dofs:
            if dof in DOFS[3:]:
                poses.append(attitude[:, DOFS[3:].index(dof)])
            else:
                poses.append(self.columns.values(table, "position", (dof,))[window, 0])
        return np.column_stack(poses)

    def _window(self, t: Array) -> Mask:
        """Mask (N,) of the samples strictly between `start_s` and `end_s`."""
        start = -np.inf if self.start_s is None else self.start_s
        end = np.inf if self.end_s is None else self.end_s
        window = (start < t) & (t < end)
        if np.count_nonzero(window) < 2:
            raise RecordingError(
                f"{self.file}: got {np.count_nonzero(window)} samples with {start:g} < t < {end:g} "
                f"s, expected at least 2; the file holds {t[0]:g} to {t[-1]:g} s"
            )
        return window


def check_time(table: ColumnTable, name: str, sample_time_s: float | None) -> None:
    """Raise RecordingError if time does not increase in uniform steps.

    A step may differ by 1 % from `sample_time_s` [s] (None: from the median step).
    """
    t = table.columns[name]
    check_increasing(table, name)
    steps = np.diff(t)
    period = float(np.median(steps)) if sample_time_s is None else sample_time_s
    wrong = np.abs(steps - period) > UNIFORMITY * period
    if np.any(wrong):
        k = int(np.argmax(wrong))
        raise RecordingError(
            f"{table.path}, column {name}, {table.place(k + 1)}: got a step of "
            f"{steps[k]:.6g} s, expected a uniform sample time of {period:.6g} s"
        )


def check_increasing(table: ColumnTable, name: str) -> None:
    """Raise RecordingError if a time is missing or not later than the previous time."""
    t = table.columns[name]
    if len(t) < 2:
        raise RecordingError(f"{table.path}: got {len(t)} samples, expected at least 2")
    wrong = ~(np.diff(t) > 0.0)  # True for NaN
    if np.any(wrong):
        k = int(np.argmax(wrong))
        raise RecordingError(
            f"{table.path}, column {name}, {table.place(k + 1)}: got {t[k + 1]:.6f} s after "
            f"{t[k]:.6f} s, expected time to increase"
        )


def check_gaps(table: ColumnTable, time: str, longest_s: float) -> None:
    """Raise RecordingError if a column has no sample for more than `longest_s` [s].

    Columns may start late and end early.
    """
    check_increasing(table, time)
    for name, values in table.columns.items():
        rows = np.flatnonzero(~np.isnan(values))
        if len(rows) < 2:
            raise RecordingError(
                f"{table.path}, column {name}: got {len(rows)} samples, expected at least 2"
            )
        t = table.columns[time][rows]
        gaps = np.diff(t)
        if np.max(gaps) > longest_s:
            k = int(np.argmax(gaps > longest_s))
            raise RecordingError(
                f"{table.path}, column {name}, {table.place(int(rows[k]))}: got no sample for "
                f"{gaps[k]:.6g} s after {t[k]:.6g} s, expected at most {longest_s:g} s"
            )
