"""Recordings, vessels and identified models as objects: read, fitted, simulated, sailed again."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, NoReturn, Self, TypeAlias

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.excitation import commands, setpoints
from seatrial.models.identification import problem as problems
from seatrial.models.identification.free_run import free_run
from seatrial.models.identification.validation import prediction
from seatrial.models.notation import (
    DOFS,
    FORCE_UNIT,
    VELOCITY_UNIT,
    accelerations_of,
    poses_of,
    velocities_of,
)
from seatrial.models.recording import recording as recordings
from seatrial.models.recording.column_map import Column, ColumnMap
from seatrial.models.recording.recorded_file import RecordedFile
from seatrial.models.recording.signals import GAP
from seatrial.models.recording.source import Source
from seatrial.models.simulation.loop import sail
from seatrial.models.simulation.registry import Timetable
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.parameters import VesselParameters
from seatrial.models.vessel.table import Vessel as Coefficients
from seatrial.models.weather.weather import Weather
from seatrial.runner.compare.grid import Scalar, TextTable, grid_of
from seatrial.runner.compare.plots import style
from seatrial.runner.configuration.config import build_as
from seatrial.runner.export import model_formats
from seatrial.runner.export.stored_model import StoredModel
from seatrial.runner.interface.shell import Displayed, overrides_of
from seatrial.runner.sweeps import in_process
from seatrial.runner.trials.closed_loop import Streams

Forces: TypeAlias = Sequence[Sequence[float]] | Array | Mapping[str, Any] | pd.DataFrame
Recordings: TypeAlias = recordings.Recording | pd.DataFrame | Sequence[Any]
KINDS = (recordings.Recording, pd.DataFrame)


@dataclass(frozen=True, eq=False, repr=False)
class Recording(Displayed, recordings.Recording):
    """A recording of a vessel: motion and commanded force, uniformly sampled, SI units, radians."""

    @classmethod
    def from_csv(cls, path: str | Path, vessel: Any = "milliampere", **options_: object) -> Self:
        """Read the degrees of freedom of a vessel from a measured file, as `excitation=recording`.

        The options are those of `conf/excitation/recording.yaml`, such as `start_s=10.0` or
        `columns={"time": "t", "velocity": {"surge": "u"}}`; the columns, their signs and
        `heading_deg=180` are by default those of the Beluga recordings. Raises RecordingError,
        which names line and column, or ConfigurationError for a wrong option or column.
        """
        own = {f"excitation.{name}": value for name, value in (options_ | {"path": path}).items()}
        words = overrides_of({"vessel": vessel, "excitation": "recording", **own})
        config = in_process.composed(words).config
        dofs = build_as(VesselParameters, config["vessel"], "vessel").dofs
        return cls.of(build_as(RecordedFile, config["excitation"], "excitation").read(dofs))

    @classmethod
    def from_frame(
        cls, frame: pd.DataFrame, dofs: Sequence[str] | None = None, **options_: Any
    ) -> Self:
        """Make a recording of a frame with the columns of a stored series.

        Args:
            frame: time t [s] as the index or a column, or a DatetimeIndex; for surge, sway and yaw
                the pose `x, y, psi` [m, rad], the body velocity `u, v, r` [m/s, rad/s] and the
                commanded force `tau_surge, tau_sway, tau_yaw` [N, Nm]. If the acceleration `u_dot,
                v_dot, r_dot` is missing, the velocity is differentiated. `tau_actual_surge, ...` is
                the acting force, if measured.
            dofs: degrees of freedom; by default those whose velocity is there.
            **options_: options of a measured file, such as `resample_hz=10.0` for unequal steps.

        Raises:
            RecordingError: A column is missing, a number not finite, or the steps are not equal.
        """
        if isinstance(frame.index, pd.DatetimeIndex) and "t" not in frame:
            frame = frame.set_axis((frame.index - frame.index.min()).total_seconds().rename("t"))
        table = frame.reset_index() if frame.index.name == "t" else frame
        axes = tuple(dofs or (dof for dof in DOFS if velocities_of((dof,))[0] in table))
        if len(table) < 2 or not axes:
            got = f"{len(table)} rows of {', '.join(map(str, table))}"
            raise RecordingError(f"frame: got {got}, expected at least 2, with u, v, w, p, q or r")
        names = {
            "position": poses_of(axes), "velocity": velocities_of(axes),
            "acceleration": accelerations_of(axes), "force": [f"tau_{dof}" for dof in axes],
            "actual_force": [f"tau_actual_{dof}" for dof in axes],
        }  # fmt: skip
        mapped: dict[str, Any] = {
            kind: dict(zip(axes, own, strict=True)) for kind, own in names.items()
            if kind not in ("acceleration", "actual_force") or set(own) <= set(table)
        }  # fmt: skip
        steps = pd.to_numeric(table.get("t", pd.Series(dtype=float)), errors="coerce").diff()[1:]
        period = steps.median()
        even = (steps - period).abs() < recordings.UNIFORMITY * period
        gaps = (steps > GAP * period) & (period > 0.0)
        at_gap = "split" if gaps.any() and (gaps | even).all() else "refuse"
        options: Any = {"path": "frame", "at_gap": at_gap, **options_}
        reader = RecordedFile(columns=ColumnMap(Column("t", "s"), **mapped), **options)
        columns = {str(name): table[name].to_numpy() for name in table}
        return cls.of(reader.recording(axes, {"": Source("", Path("frame"), columns)}))

    @classmethod
    def of(cls, recording: recordings.Recording) -> Self:
        """Return a recording of the models as one of this interface."""
        return cls(**{field.name: getattr(recording, field.name) for field in fields(recording)})

    def to_frame(self) -> pd.DataFrame:
        """Return the columns that `from_frame` reads, by time t [s]."""
        frame = motion_frame(self.t, self.dofs, self.eta, self.nu)
        frame[list(accelerations_of(self.dofs))] = self.nu_dot
        for name, values in {"tau": self.tau, "tau_actual": self.tau_actual}.items():
            if values is not None:
                frame[[f"{name}_{dof}" for dof in self.dofs]] = values
        return frame

    def split(self, fraction: float = 0.5) -> tuple[Self, Self]:
        """Return the first `fraction` of the samples, to train on, and the rest, to test on."""
        parts = recordings.half(len(self), fraction)
        return self.part(parts.train), self.part(parts.test)

    def blocks(self, count: int, gap_s: float = 0.0) -> list[Self]:
        """Cut the recording into `count` equal blocks of time, for a cross-validation.

        At the end of every block but the last `gap_s` [s] are left out, so that a model is not
        tested on samples next to those it was fitted to.
        """
        *earlier, last = recordings.blocks(len(self), count)
        gap = round(gap_s / self.period_s)
        cuts = [*(slice(cut.start, max(cut.stop - gap, cut.start)) for cut in earlier), last]
        return [self.part(cut) for cut in cuts]

    def __array__(self, *arguments: object, **keywords: object) -> NoReturn:
        """Refuse to be an array: a cross-validation must not mix samples that are neighbours."""
        raise ConfigurationError(
            "X: got one recording, expected a list of recordings: recording.blocks(10) cuts one"
        )

    def _shown(self) -> TextTable:
        title = f"recording of {', '.join(self.dofs)}: {len(self)} samples of {self.period_s:g} s"
        title += f", t = {self.t[0]:g} to {self.t[-1]:g} s"
        return table_of(title, "column", self.to_frame().agg(["min", "mean", "max", "std"]).T)


class Model(Displayed):
    """A model of a vessel: a table of coefficients, with the thrusters and limits of the vessel.

    `table` is the coefficient table, `parameters` the vessel that it belongs to, `part` what a
    trial takes for it, `stored` the model of a run that it is, in the logbook at `address`, and
    `identified` what an identifier returned.
    """

    identified: problems.Identified | None = None

    def __init__(
        self, table: Coefficients, parameters: VesselParameters, part: object = None,
        stored: StoredModel | None = None, address: str | None = None,
    ) -> None:  # fmt: skip
        self.table, self.parameters, self.part = table, parameters, part
        self.stored, self.address = stored, address
        self.dofs = table.dofs
        self._source = parameters.name if stored is None else stored.source

    @property
    def coefficients(self) -> pd.DataFrame:
        """The coefficients in SI units, force per term: terms are rows, columns are axes."""
        terms = [term.name for term in self.table.terms]
        return pd.DataFrame(self.table.theta.copy(), index=terms, columns=list(self.dofs))

    @property
    def inertia(self) -> pd.DataFrame:
        """The inertia matrix with added mass [kg, kg m, kg m^2]."""
        axes = list(self.dofs)
        return pd.DataFrame(self.table.inertia.copy(), index=axes, columns=axes)

    def simulate(
        self, force: Forces, period_s: float = 0.1, *, step_s: float = 0.025,
        pose: Sequence[float] | None = None, velocity: Sequence[float] | None = None,
    ) -> pd.DataFrame:  # fmt: skip
        """Simulate the motion in calm water under commanded forces, through the thrusters.

        A steered vessel is commanded by its inputs instead. Raises Diverged if a velocity exceeds
        the limit of the vessel.

        Args:
            force: commanded forces [N, Nm], held over each period: an array (N, n_dof), or columns
                by degree of freedom (`surge` or `tau_surge`), of which a missing one is zero; or
                inputs by their names, in the units of the vessel.
            period_s: time between two rows [s].
            step_s: longest integration step [s].
            pose: at the start [m, rad], shape (n_dof,); zero by default.
            velocity: at the start [m/s, rad/s], shape (n_dof,); zero by default.

        Returns:
            Pose, body velocity and command by time t [s], before the command of the row acts.
        """
        n_dof, inputs = len(self.dofs), self.parameters.input_names
        command = _commands(force, inputs or self.dofs)
        still, start = np.zeros((len(command), n_dof)), {}
        for name, values in {"pose": pose, "velocity": velocity}.items():
            start[name] = np.array([0.0] * n_dof if values is None else values, dtype=np.float64)
            if (shape := start[name].shape) != (n_dof,):
                raise ConfigurationError(f"{name}: got shape {shape}, expected ({n_dof},)")
        voyage = sail(
            self.parameters.plant(self.table), Weather(still, still, still, still),
            (Timetable(still), np.zeros(1)), setpoints.UNFILTERED,
            commands.open_loop(command.shape[1]), start["pose"], period_s, min(step_s, period_s),
            start["velocity"], added=command,
        )  # fmt: skip
        motion = motion_frame(voyage.t, self.dofs, voyage.log.eta, voyage.log.nu)
        motion[list(inputs) or [f"tau_{dof}" for dof in self.dofs]] = command
        return motion

    def predict(self, recording: recordings.Recording, restart_s: float = 30.0) -> pd.DataFrame:
        """Predict a recorded motion from the recorded force: pose and body velocity by time t [s].

        The prediction begins anew at the measured state after each gap and every `restart_s` [s].
        Raises IdentificationError for a model that cannot be simulated.
        """
        lag = self.parameters.thruster
        known = recording.with_thruster(lag)
        every = max(round(restart_s / known.period_s), 2)
        course = prediction(self.table, known, lag, horizon=every).course
        motion = free_run(self.table, course, "rk4")
        return motion_frame(known.t, self.dofs, *np.hsplit(motion, 2))

    def plot(self, ax: Axes | None = None) -> Figure:
        """Draw the force that a steady motion along each axis alone requires, up to the limits.

        There is a panel for each degree of freedom; one may be drawn into axes of yours.
        """
        speeds = self.parameters.plant(self.table).velocity_limits
        most = self.parameters.force_limits or (np.inf,) * len(speeds)
        with style.drawn(ax):
            chart, panels = style.panels(1, len(speeds), 3.2, 2.6)
            for i, (dof, panel) in enumerate(zip(self.dofs, panels, strict=True)):
                nu = np.zeros((401, len(speeds)))
                nu[:, i] = np.linspace(-speeds[i], speeds[i], len(nu))
                force = self.table.inverse(np.zeros_like(nu), nu)[:, i]
                held = np.abs(force) <= most[i]
                panel.plot(nu[held, i], force[held])
                panel.set_xlabel(f"{dof} [{VELOCITY_UNIT[dof]}]")
                panel.set_ylabel(f"force [{FORCE_UNIT[dof]}]")
            style.headed(chart, panels, self._source)
        return chart

    def save(
        self, to: str, output: str | Path | None = None, *, at: str | None = None,
        force: bool = False,
    ) -> list[Path]:  # fmt: skip
        """Write the model of a run for another program, as `seatrial-results model` does.

        `to` is yaml, json, statespace, python-control, mss, pvs, gazebo, vrx, c or fmu, `output`
        the (first) file, `at` the operating point of a linear model, such as `"u=0.5"`; `force`
        replaces files. Returns their paths.
        """
        if self.stored is None:
            raise ConfigurationError("save: got a model of no run, expected that of a stored run")
        path = None if output is None else Path(output)
        return model_formats.write(self.stored, to, path, at, force)

    def _shown(self) -> TextTable:
        used = self.coefficients[np.any(self.table.theta, axis=1)]
        return table_of(f"{self._source}, SI units", "term", used)


class Vessel(Model):
    """A vessel with its nominal model, by name, from a file, or from numbers.

    `choice` is what the command line takes after `vessel=`, a name, the path of a file or `run:17`;
    without one the options of a vessel are given: `name`, `dofs`, `inertia`, `derivatives`, ...
    """

    def __init__(self, choice: str | Path | None = None, **numbers: object) -> None:
        if choice is not None and numbers:
            raise ConfigurationError(f"Vessel: got {choice} and numbers, expected one of them")
        node: object = numbers
        if choice is not None:
            node = in_process.composed(overrides_of({"vessel": choice})).config["vessel"]
        parameters = build_as(VesselParameters, node, "vessel")
        super().__init__(parameters.nominal(), parameters, choice or parameters)

    def fit(
        self, recordings: Recordings, identifier: str | problems.Identifier = "auto",
        seed: int = 0, **options: object,
    ) -> Model:  # fmt: skip
        """Identify the vessel from recordings; the arguments are those of `Estimator`."""
        return fitted(recordings, self, identifier, seed, options)


def fitted(
    data: Recordings, vessel: str | Path | Model, identifier: str | problems.Identifier, seed: int,
    options: Mapping[str, Any],
) -> Model:  # fmt: skip
    """Identify a vessel from a recording, or from several with gaps between them.

    Raises SeatrialError for a wrong option, and for data that do not determine the model.
    """
    method: Any = identifier
    given: dict[str, object] = {"vessel": vessel}
    if isinstance(identifier, str):
        given |= {"identifier": identifier}
        given |= {f"identifier.{name}": value for name, value in options.items()}
    else:
        method = replace(method, **options)
    node = in_process.composed(overrides_of(given)).config
    if isinstance(identifier, str):
        role: Any = problems.Identifier  # abstract
        method = build_as(role, node["identifier"], "identifier")
    if getattr(method, "selection", None) == "test":
        raise ConfigurationError("identifier.selection: got test, expected training data")
    parameters = build_as(VesselParameters, node["vessel"], "vessel")
    nominal, lag, training = parameters.nominal(), parameters.thruster, joined(data, parameters)
    method.check(nominal, lag, True)
    problems.check_needs(method.needs(), parameters.name, lag, training)
    # Nothing is held out: what tests a model is not for its identification.
    problem = problems.Problem(training, training, nominal, lag)
    result = method.identify(problem, Streams(seed).generator("identifier"))
    model = Model(result.model, parameters)
    model.identified = problems.with_interval(method, result)
    return model


def joined(data: Recordings, vessel: VesselParameters) -> recordings.Recording:
    """Return data as one recording, each command filtered from rest unless it was before a cut."""
    listed = [data] if isinstance(data, KINDS) else list(data)
    if not listed or not all(isinstance(each, KINDS) for each in listed):
        kinds = {type(each).__name__ for each in listed} or {"nothing"}
        raise ConfigurationError(f"X: got {', '.join(kinds)}, expected recordings or frames")
    parts = [Recording.from_frame(x) if isinstance(x, pd.DataFrame) else x for x in listed]
    known = [x if x.tau_filtered is not None else x.with_thruster(vessel.thruster) for x in parts]
    return recordings.end_to_end(known)


def motion_frame(t: Array, dofs: tuple[str, ...], eta: Array, nu: Array) -> pd.DataFrame:
    """Return pose and body velocity, shape (N, n_dof) each, by time t [s]."""
    names = [*poses_of(dofs), *velocities_of(dofs)]
    return pd.DataFrame(np.hstack([eta, nu]), columns=names, index=pd.Index(t, name="t"))


def table_of(title: str, index: str, numbers: pd.DataFrame) -> TextTable:
    """Return a frame of numbers as a table, each row with its name."""
    rows: list[list[Scalar]] = [[str(name), *row] for name, row in numbers.iterrows()]
    return grid_of(title, (index, *map(str, numbers)), rows)


def _commands(given: Forces, names: tuple[str, ...]) -> Array:
    """Return commands as an array (N, n), of forces or inputs by their names."""
    if isinstance(given, Mapping | pd.DataFrame):
        frame = pd.DataFrame(given).rename(columns=lambda name: str(name).removeprefix("tau_"))
        if frame.empty or set(frame) - set(names):
            got, expected = ", ".join(frame), ", ".join(names)
            raise ConfigurationError(f"force: got columns {got}, expected some of {expected}")
        given = frame.reindex(columns=list(names), fill_value=0.0).to_numpy()
    array = np.array(given, dtype=np.float64, order="C")
    if array.ndim != 2 or array.shape[1] != len(names) or not len(array):
        raise ConfigurationError(f"force: got shape {array.shape}, expected (N, {len(names)})")
    return array
