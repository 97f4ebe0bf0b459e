"""Measured recordings as excitation: files that are read by a map, checked, and cut."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.notation import DOFS, PLANAR
from seatrial.models.ranges import NotNegative, Positive, check_ranges
from seatrial.models.recording import recording as recordings
from seatrial.models.recording.column_map import Column, ColumnMap
from seatrial.models.recording.diagnosis import Examination, examine
from seatrial.models.recording.file_set import FileForm, file_set
from seatrial.models.recording.joining import AtGap, TimeGrid, end_to_end
from seatrial.models.recording.preprocessing import Differentiation, without_bias
from seatrial.models.recording.reader import Outliers, Reading, Signals, clock_of, first_time
from seatrial.models.recording.recording import Mask, Recording, Split, half
from seatrial.models.recording.sources import ReadOptions, Source, TextOptions, column, read_sources
from seatrial.models.recording.times import seconds
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import unroll, wrap
from seatrial.models.vessel.thruster import AzimuthThrusters

if TYPE_CHECKING:  # slow to import
    import pandas as pd
else:
    import lazy_loader

    pd = lazy_loader.load("pandas")

LEAST_SAMPLES = 2  # of a window
STATISTICS = {"count": "count", "mean": "mean", "std": "std", "50%": "median", "min": "minimum",
              "max": "maximum"}  # fmt: skip


@dataclass(frozen=True)
class RecordedFile:
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
    trust: bool = False  # also what does not agree
    map: str | None = None  # file of the columns; its content is in the other options
    test_map: str | None = None  # that of the files of `test`; its content is in `tested`
    _read: dict[tuple[object, ...], Signals] = field(
        default_factory=dict, init=False, repr=False, compare=False
    )

    def __post_init__(self) -> None:
        check_ranges(self)
        start, end = self.start_s, self.end_s
        problems = {
            "excitation.path and excitation.train name files, expected one of them to be null":
                self.path and (self.train or self.test),
            "excitation.test requires excitation.train, got none": self.test and not self.train,
            "excitation.test_map is of files of excitation.test, got none":
                self.tested is not None and not self.test,
            "trip_starts_s is of one file, got excitation.train": self.train and self.trip_starts_s,
            "excitation.path: expected a recording, got none": not self.path and not self.train,
            f"path: got {self.path!r}, expected one line of text":
                any(character in (self.path or "") for character in "\0\r\n"),
            f"start_s must lie before end_s = {end or 0.0:g}, got {start or 0.0:g}":
                start is not None and end is not None and start >= end,
            f"sample_time_s = {self.sample_time_s} requires a uniform file and resample_hz = "
            f"{self.resample_hz} resamples it, expected one of them to be null":
                self.sample_time_s is not None and self.resample_hz is not None,
            "training_trips requires trip_starts_s, got none":
                self.training_trips and not self.trip_starts_s,
            "thrusters.rpm and columns.actual_force both define the acting force, expected one":
                self.thrusters.rpm and self.columns.actual_force,
        }  # fmt: skip
        if problem := next((text for text, there in problems.items() if there), None):
            raise ConfigurationError(problem)
        half(2, self.train_fraction)
        recordings.trips(np.zeros(1), self.trip_starts_s)
        if self.trip_starts_s:
            recordings.by_trips(np.arange(1, 1 + len(self.trip_starts_s)), self.training_trips)

    @property
    def file(self) -> Path:
        """Path of the file, with `~` replaced by the home folder."""
        return Path(self.path or "").expanduser()

    def files(self) -> dict[str, Path]:
        """The files that are read, by option."""
        own = {"path": self.file}
        if self.train:
            known = file_set(self.train, self.test)._asdict()
            own = {f"{k}[{i}]": path for k, files in known.items() for i, path in enumerate(files)}
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

    def _recording(
        self, dofs: Sequence[str], sources: Mapping[str, Source] | None = None
    ) -> Recording:
        """The recording of all files, each read alone, end to end with gaps in time between them.

        Every sample keeps the number of its file, so nothing is differentiated or filtered over a
        joint. `sources` are the columns of the file, if others than those in it.
        """
        parts: list[Recording] = []
        for number, (path, form) in enumerate(self._forms().items()):
            part = self._of_file(path, form, dofs, sources)
            if not self.train:
                return part
            parts.append(replace(part, file=np.full(len(part), number)))
            try:
                end_to_end([replace(part, file=None) for part in (parts[0], parts[-1])])
            except RecordingError as error:
                raise RecordingError(
                    f"{path}: {error}; excitation.resample_hz gives all files one sample time"
                ) from error
        return replace(end_to_end(parts), file_names=file_set(self.train, self.test).names)

    def _forms(self) -> dict[Path, FileForm]:
        """The files of the recording, each with its columns and format."""
        own = FileForm(self.columns, self.format, self.text)
        if not self.train:
            return {self.file: own}
        known = file_set(self.train, self.test)
        return dict.fromkeys(known.train, own) | dict.fromkeys(known.test, self.tested or own)

    def _sources(self, path: Path, form: FileForm) -> dict[str, Source]:
        return read_sources(path, ReadOptions(form.format, form.text, self.messages))

    def _of_file(
        self, path: Path, form: FileForm, dofs: Sequence[str], sources: Mapping[str, Source] | None
    ) -> Recording:
        """The recording of one file."""
        signals, n, columns = self._signals(path, form, dofs, sources), len(dofs), form.columns
        t, values = signals.t, signals.values
        rows = self._window(path, t)

        def of(kind: str) -> Array | None:
            known = [values[o] for dof in dofs if (o := f"{kind}.{dof}") in values]
            return np.column_stack(known) if len(known) == n else None

        def named(kind: str) -> Array | None:
            known = [values[f"{kind}.{name}"][rows] for name in getattr(columns, kind)]
            return np.column_stack(known) if known else None

        nu = of("velocity")
        if nu is None:
            missing = [dof for dof in dofs if f"velocity.{dof}" not in values]
            raise ConfigurationError(
                f"excitation.columns.velocity: no column for {', '.join(missing)}, nor a position "
                "to differentiate"
            )
        tau, acting, zero = of("force"), of("actual_force"), np.zeros(len(t))
        if self._has_thruster_force(dofs):
            acting = self._thruster_force(path, values, dofs)
        attitude = np.column_stack([values.get(f"position.{dof}", zero) for dof in DOFS[3:]])[rows]
        attitude[:, 2] = unroll(np.concatenate([[wrap(attitude[0, 2])], attitude[1:, 2]]))
        pose = []
        for dof in dofs:
            if dof in DOFS[3:]:
                pose.append(attitude[:, DOFS[3:].index(dof)])
            elif (position := values.get(f"position.{dof}")) is not None:
                pose.append(position[rows])
            else:  # the way made good
                speed = values[f"velocity.{dof}"][rows]
                pose.append(scipy.integrate.cumulative_trapezoid(speed, t[rows], initial=0.0))
        return Recording(
            tuple(dofs), t[rows], np.column_stack(pose), nu[rows],
            self._acceleration(signals, nu, dofs)[rows],
            np.zeros_like(nu[rows]) if tau is None else tau[rows], attitude,
            tau_actual=None if acting is None else acting[rows],
            inputs=named("inputs"), commands=named("commands"), input_names=tuple(columns.inputs),
            wind=_air(columns, {o: v[rows] for o, v in values.items()}, attitude, nu[rows], dofs),
            loads=named("loads"), load_names=tuple(columns.loads),
        )  # fmt: skip

    def _signals(
        self, path: Path, form: FileForm, dofs: Sequence[str],
        sources: Mapping[str, Source] | None = None,
    ) -> Signals:  # fmt: skip
        """The used columns of a file in SI units and our frames; read once."""
        key = (path, *dofs)
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
                form.columns, grid, self.sample_time_s, self.outliers, self.heading_deg, more,
                self.at_gap, self.max_gap_s,
            )  # fmt: skip
            known = self._sources(path, form) if sources is None else sources
            self._read[key] = reading.read(path, known, dofs)
        return self._read[key]

    def account(self, dofs: Sequence[str]) -> Sequence[Signals]:
        """How each file was read: units with their origin, and what was left out."""
        return [self._signals(path, form, dofs) for path, form in self._forms().items()]

    def outlier_counts(self, dofs: Sequence[str]) -> dict[str, int]:
        """Number of outliers in each used column, over the entire files."""
        totals: Counter[str] = Counter()
        for signals in self.account(dofs):
            totals.update(signals.outliers)
        return dict(totals)

    def examine(self, dofs: Sequence[str]) -> Examination | None:
        """Compare pose and velocity, with all degrees of freedom that the file holds.

        None if they cannot be compared.
        """

        def read(
            columns: ColumnMap, dofs: Sequence[str], sources: Mapping[str, Source] | None = None,
            **options: Any,
        ) -> Recording:  # fmt: skip
            reader = replace(self, columns=columns, **options)
            return reader._recording(dofs, None if self.train else sources)

        path, form = next(iter(self._forms().items()))
        return examine(read, self.columns, self._sources(path, form), dofs, self.heading_deg)

    def split(self, t: Array, file: NDArray[np.int64] | None = None) -> Split:
        """Training and test samples of the recording that `read` returns.

        A file for testing is not tested on in its first `initial_s` [s]: a free run starts from
        the state that is measured then.

        Args:
            t: its times [s], (N,).
            file: the number of the file of each sample, (N,), of several files.

        Raises ConfigurationError if no trip, or too little of a file, is left for one of them.
        """
        if self.trip_starts_s:
            return recordings.by_trips(recordings.trips(t, self.trip_starts_s), self.training_trips)
        if file is None:
            return half(len(t), self.train_fraction)
        files = file_set(self.train, self.test)
        train, test = np.zeros((2, len(t)), dtype=np.bool_)
        for number, path in enumerate(self._forms()):
            rows = np.flatnonzero(file == number)
            if self.test and number < len(files.train):
                train[rows] = True
                continue
            parts = None if self.test else half(len(rows), self.train_fraction)
            train[rows] = False if parts is None else parts.train
            late = t[rows] >= t[rows[0]] + self.initial_s
            test[rows] = late & (True if parts is None else parts.test)
            if (left := np.count_nonzero(test[rows])) < LEAST_SAMPLES:
                raise ConfigurationError(
                    f"excitation.initial_s: got {self.initial_s:g} s, which leaves {left} samples "
                    f"for testing of {path}, {np.ptp(t[rows]):g} s long; expected at least 2"
                )
        return Split(train, test)

    def describe(self) -> dict[str, dict[str, float]]:
        """Descriptive statistics of the recorded columns `statistics` in the window; std by n - 1.

        Missing values are ignored.
        """
        result: dict[str, dict[str, float]] = {}
        for path, form in self._forms().items() if self.statistics else ():
            sources = self._sources(path, form)
            source = column(sources, form.columns.clock.name)[0]
            t = seconds(source, clock_of(source, form.columns))
            window = self._window(path, t - first_time(sources, form.columns))
            for name in filter(source.find, self.statistics):
                values = pd.Series(source.numbers(name, gaps=True)[window]).describe([0.5])
                stem = f"{path.stem}:" if self.train else ""
                result[f"{stem}{name}"] = {
                    new: float(values[old]) for old, new in STATISTICS.items()
                }
        return result

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

    def _thruster_force(
        self, path: Path, values: Mapping[str, Array], dofs: Sequence[str]
    ) -> Array:
        """The acting force (N, n_dof) of the speeds and angles of the thrusters."""
        rpm, angle = (
            np.column_stack([values[f"thruster_{k}.{i}"] for i in range(len(self.thrusters.rpm))])
            for k in ("rpm", "angle")
        )
        try:
            force = self.thrusters.force(rpm, angle)
        except RecordingError as error:
            raise RecordingError(f"{path}: {error}") from error
        return force[:, [PLANAR.index(dof) for dof in dofs]]

    def _has_thruster_force(self, dofs: Sequence[str]) -> bool:
        """Whether motor speeds determine the acting force in all these degrees of freedom."""
        return bool(self.thrusters.rpm) and set(dofs) <= set(PLANAR)

    def _window(self, path: Path, t: Array) -> Mask:
        """Mask (N,) of the samples strictly between `start_s` and `end_s`."""
        start = -np.inf if self.start_s is None else self.start_s
        end = np.inf if self.end_s is None else self.end_s
        window = (start < t) & (t < end)
        if np.count_nonzero(window) < LEAST_SAMPLES:
            raise RecordingError(
                f"{path}: got {np.count_nonzero(window)} samples with {start:g} < t < {end:g} s, "
                f"expected at least 2; the file holds {t[0]:g} to {t[-1]:g} s"
            )
        return window


def _air(
    columns: ColumnMap, values: Mapping[str, Array], attitude: Array, nu: Array, dofs: Sequence[str]
) -> Array | None:
    """Velocity of the air over ground in body axes [m/s], (n, 2); None if not recorded."""
    if "air.surge" in values:
        return np.column_stack([values["air.surge"], values["air.sway"]])
    if columns.wind is None or "wind.speed" not in values:
        return None
    speed, angle = values["wind.speed"], values["wind.direction"]
    apparent = columns.wind.kind == "apparent"
    angle = angle if apparent else angle - attitude[:, 2]
    air = -speed[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    if apparent:
        air += nu[:, [dofs.index(dof) for dof in ("surge", "sway")]]
    return np.asarray(air)
