"""Recordings, vessels and identified models as objects: read, fitted, simulated, sailed again."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, NoReturn, Self, TypeAlias, cast

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from seatrial.models import notation
from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.excitation import commands, setpoints
from seatrial.models.identification import free_run, problem, validation
from seatrial.models.recording import recording as recordings
from seatrial.models.recording import signals, source
from seatrial.models.recording.recorded_file import RecordedFile
from seatrial.models.simulation import loop, registry
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
from seatrial.runner.trials.closed_loop import SeriesColumns, Streams

Forces: TypeAlias = Sequence[Sequence[float]] | Array | Mapping[str, Any] | pd.DataFrame
Recordings: TypeAlias = recordings.Recording | pd.DataFrame | Array | Sequence[Any]
KINDS = (recordings.Recording, pd.DataFrame, np.ndarray)
COLUMNS = {  # of a stored series, by degree of freedom
    "position": notation.POSES, "velocity": notation.VELOCITIES,
    "acceleration": notation.ACCELERATIONS, "force": [f"tau_{dof}" for dof in notation.DOFS],
    "actual_force": [f"tau_actual_{dof}" for dof in notation.DOFS],
}  # fmt: skip


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
        given = {"vessel": vessel, "excitation": "recording", **own}
        config = in_process.composed(overrides_of(given)).config
        dofs = build_as(VesselParameters, config["vessel"], "vessel").dofs
        return cls.of(build_as(RecordedFile, config["excitation"], "excitation").read(dofs))

    @classmethod
    def from_frame(cls, frame: pd.DataFrame, **options_: Any) -> Self:
        """Make a recording of a frame with the columns of a stored series.

        Time t [s] is the index or a column, or there is a DatetimeIndex; for surge, sway and yaw
        there are the pose `x, y, psi` [m, rad], the body velocity `u, v, r` [m/s, rad/s], the
        commanded force `tau_surge, tau_sway, tau_yaw` [N, Nm], the acceleration `u_dot, v_dot,
        r_dot`, else the velocity is differentiated, and `tau_actual_surge, ...`, the acting force,
        if measured. The options are those of a measured file, such as `resample_hz=10.0`.

        Raises RecordingError if a column is missing, a number not finite, or the steps not equal.
        """
        if not isinstance(frame, pd.DataFrame | Mapping):
            raise RecordingError(f"frame: got {type(frame).__name__}, expected columns by name")
        frame = pd.DataFrame(frame)
        if isinstance(frame.index, pd.DatetimeIndex) and "t" not in frame:
            frame = frame.set_axis((frame.index - frame.index.min()).total_seconds().rename("t"))
        table = frame.reset_index() if frame.index.name == "t" else frame
        letters = zip(notation.DOFS, notation.VELOCITIES, strict=True)
        axes = tuple(dof for dof, name in letters if name in table)
        if len(table) < 2 or not axes:
            got = f"{len(table)} rows of {', '.join(map(str, table))}"
            raise RecordingError(f"frame: got {got}, expected at least 2, with u, v, w, p, q or r")
        mapped: Any = {
            kind: {dof: name for dof, name in zip(notation.DOFS, names, strict=True)
                   if dof in axes and (kind in ("velocity", "force") or name in table)}
            for kind, names in COLUMNS.items()
        }  # fmt: skip
        steps = pd.to_numeric(table.get("t", pd.Series(dtype=float)), errors="coerce").diff()[1:]
        period = steps.median()
        even = (steps - period).abs() < recordings.UNIFORMITY * period
        gaps = (steps > signals.GAP * period) & (period > 0.0)
        at_gap = "split" if gaps.any() and (gaps | even).all() else "refuse"
        node = {"columns": {"time": {"column": "t", "unit": "s"}, **mapped}, "path": "frame"}
        reader = build_as(RecordedFile, {**node, "at_gap": at_gap, **options_}, "")
        columns = {str(name): table[name].to_numpy() for name in table}
        return cls.of(reader.recording(axes, {"": source.Source("", Path("frame"), columns)}))

    @classmethod
    def of(cls, recording: recordings.Recording) -> Self:
        """Return a recording of the models as one of this interface."""
        return cls(**{field.name: getattr(recording, field.name) for field in fields(recording)})

    def to_frame(self) -> pd.DataFrame:
        """Return the columns that `from_frame` reads, by time t [s]."""
        columns = SeriesColumns(self.dofs, self.t)
        columns.add_recording(self)
        return pd.DataFrame(columns.columns).set_index("t")

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
        expected = "expected a list of recordings: recording.blocks(10) cuts one"
        raise ConfigurationError(f"X: got one recording, {expected}")

    def _shown(self) -> TextTable:
        title = f"recording of {', '.join(self.dofs)}: {len(self)} samples of {self.period_s:g} s"
        title += f", t = {self.t[0]:g} to {self.t[-1]:g} s"
        return table_of(title, "column", self.to_frame().agg(["min", "mean", "max", "std"]).T)


class Model(Displayed):
    """A model of a vessel: a table of coefficients, with the thrusters and limits of the vessel.

    `table` has the coefficients, `parameters` is the vessel, `part` what a trial takes for it,
    `stored` the model in the logbook at `address`, `identified` what an identifier returned.
    """

    identified: problem.Identified | None = None

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
        return pd.DataFrame(self.table.theta.copy(), terms, list(self.dofs))

    @property
    def inertia(self) -> pd.DataFrame:
        """The inertia matrix with added mass [kg, kg m, kg m^2]."""
        return pd.DataFrame(self.table.inertia.copy(), list(self.dofs), list(self.dofs))

    def simulate(
        self, force: Forces, period_s: float = 0.1, *, step_s: float = 0.025,
        pose: Sequence[float] | None = None, velocity: Sequence[float] | None = None,
    ) -> pd.DataFrame:  # fmt: skip
        """Simulate pose and body velocity by time t [s] in calm water, before each command acts.

        Raises Diverged if a velocity exceeds the limit of the vessel.

        Args:
            force: commanded forces [N, Nm], held over each period and given through the thrusters:
                an array (N, n_dof), or columns by degree of freedom (`surge` or `tau_surge`), of
                which a missing one is zero. Of a steered vessel its inputs, in their units.
            period_s: time between two rows [s].
            step_s: longest integration step [s].
            pose: at the start [m, rad], shape (n_dof,); zero by default.
            velocity: at the start [m/s, rad/s], shape (n_dof,); zero by default.
        """
        n_dof, inputs = len(self.dofs), self.parameters.input_names
        names = list(inputs or self.dofs)
        if isinstance(force, Mapping | pd.DataFrame):
            frame = pd.DataFrame(force).rename(columns=lambda name: str(name).removeprefix("tau_"))
            if frame.empty or set(frame) - set(names):
                raise ConfigurationError(f"force: got {list(frame)}, expected some of {names}")
            force = frame.reindex(columns=names, fill_value=0.0).to_numpy()
        if not min(period_s, step_s) > 0.0:
            raise ConfigurationError(f"period_s, step_s: got {period_s}, {step_s}, expected > 0")
        command = array_of(force, "force")
        if command.ndim != 2 or command.shape[1] != len(names) or not len(command):
            raise ConfigurationError(
                f"force: got shape {command.shape}, expected (N, {len(names)})"
            )
        still, start = np.zeros((len(command), n_dof)), {}
        for name, values in {"pose": pose, "velocity": velocity}.items():
            start[name] = array_of([0.0] * n_dof if values is None else values, name)
            if (shape := start[name].shape) != (n_dof,):
                raise ConfigurationError(f"{name}: got shape {shape}, expected ({n_dof},)")
        voyage = loop.sail(
            self.parameters.plant(self.table), Weather(still, still, still, still),
            (registry.Timetable(still), np.zeros(1)), setpoints.UNFILTERED,
            commands.command([commands.Piece()], np.zeros(len(names)), 0, 0), start["pose"],
            period_s, min(step_s, period_s), start["velocity"], added=command,
        )  # fmt: skip
        motion = motion_frame(voyage.t, self.dofs, voyage.log.eta, voyage.log.nu)
        motion[[name if inputs else f"tau_{name}" for name in names]] = command
        return motion

    def predict(self, recording: recordings.Recording, restart_s: float = 30.0) -> pd.DataFrame:
        """Predict a recorded motion from the recorded force: pose and body velocity by time t [s].

        The prediction begins anew at the measured state after each gap and every `restart_s` [s].
        Raises IdentificationError for a model that cannot be simulated.
        """
        lag = self.parameters.thruster
        known = recording.with_thruster(lag)
        every = max(round(restart_s / known.period_s), 2)
        course = validation.prediction(self.table, known, lag, horizon=every).course
        motion = free_run.free_run(self.table, course, "rk4")
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
                units = notation.VELOCITY_UNIT[dof], notation.FORCE_UNIT[dof]
                panel.set(xlabel=f"{dof} [{units[0]}]", ylabel=f"force [{units[1]}]")
            return style.titled(chart, panels, self._source)

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
            raise ConfigurationError("save: got a model that is not stored, expected that of a run")
        return model_formats.write(self.stored, to, Path(output) if output else None, at, force)

    def _shown(self) -> TextTable:
        used = self.coefficients[np.any(self.table.theta, axis=1)]
        return table_of(f"{self._source}, SI units", "term", used)


class Vessel(Model):
    """A vessel with its nominal model, by name, from a file, or from numbers.

    `choice` is what the command line takes after `vessel=`, a name, the path of a file or `run:17`;
    the options of a vessel replace its own: `name`, `dofs`, `inertia`, `derivatives`, ...
    """

    def __init__(self, choice: str | Path | None = None, **numbers: object) -> None:
        node: Any = {}
        if choice is not None:
            node = in_process.composed(overrides_of({"vessel": choice})).config["vessel"]
        parameters = build_as(VesselParameters, {**node, **numbers}, "vessel")
        super().__init__(parameters.nominal(), parameters, parameters if numbers else choice)

    def fit(
        self, recordings: Recordings, identifier: str | problem.Identifier = "auto",
        seed: int = 0, **options: object,
    ) -> Model:  # fmt: skip
        """Identify the vessel from recordings; the arguments are those of `Estimator`."""
        return fitted(recordings, self, identifier, seed, options)


def fitted(
    data: Recordings, vessel: str | Path | Model, identifier: str | problem.Identifier, seed: int,
    options: Mapping[str, Any],
) -> Model:  # fmt: skip
    """Identify a vessel; raises SeatrialError for a wrong option, or data that do not suffice."""
    named, given = isinstance(identifier, str), dict[str, object](vessel=vessel)
    if named:
        given["identifier"] = identifier
        given |= {f"identifier.{name}": value for name, value in options.items()}
    node = in_process.composed(overrides_of(given)).config
    role, part = cast(Any, problem.Identifier), cast(Any, identifier)  # an abstract class
    if not named and not isinstance(part, role):
        raise ConfigurationError(f"identifier: got {part!r}, expected a name or an Identifier")
    method = build_as(role, node["identifier"], "identifier") if named else replace(part, **options)
    if getattr(method, "selection", None) == "test":
        raise ConfigurationError("identifier.selection: got test, expected training data")
    parameters = build_as(VesselParameters, node["vessel"], "vessel")
    nominal, lag, training = parameters.nominal(), parameters.thruster, joined(data, parameters)
    method.check(nominal, lag, True)
    problem.check_needs(method.needs(), parameters.name, lag, training)
    # Nothing is held out: what tests a model is not for its identification.
    task = problem.Problem(training, training, nominal, lag)
    result = method.identify(task, Streams(seed).generator("identifier"))
    model = Model(result.model, parameters)
    model.identified = problem.with_interval(method, result)
    return model


def joined(data: Recordings, vessel: VesselParameters) -> recordings.Recording:
    """Return data as one recording, each command filtered from rest unless it was before a cut.

    An array has time, poses, velocities and forces as its columns.
    """
    one = isinstance(data, KINDS) or not isinstance(data, Iterable)
    listed: list[Any] = [data] if one else list(data)  # type: ignore[arg-type]
    if not listed or not all(isinstance(each, KINDS) for each in listed):
        kinds = {type(each).__name__ for each in listed} or {"nothing"}
        raise ConfigurationError(
            f"X: got {', '.join(kinds)}, expected recordings, frames or arrays"
        )
    forces = [f"tau_{dof}" for dof in vessel.dofs]
    names = ["t", *notation.poses_of(vessel.dofs), *notation.velocities_of(vessel.dofs), *forces]
    for shape in {x.shape[1:] for x in listed if isinstance(x, np.ndarray)} - {(len(names),)}:
        raise ConfigurationError(f"X: got samples of shape {shape}, expected {', '.join(names)}")
    parts = [
        x if isinstance(x, recordings.Recording) else
        Recording.from_frame(pd.DataFrame(x, columns=names if isinstance(x, np.ndarray) else None))
        for x in listed
    ]  # fmt: skip
    for dofs in {x.dofs for x in parts} - {vessel.dofs}:
        raise ConfigurationError(f"X: got {', '.join(dofs)}, expected {', '.join(vessel.dofs)}")
    known = [x if x.tau_filtered is not None else x.with_thruster(vessel.thruster) for x in parts]
    return recordings.end_to_end(known)


def array_of(values: object, key: str) -> Array:
    """Return values as an array of finite numbers; errors name the argument."""
    try:
        return np.array(np.asarray_chkfinite(values, np.float64), order="C")
    except (TypeError, ValueError) as error:
        raise ConfigurationError(f"{key}: got {values!r:.80}, expected finite numbers") from error


def motion_frame(t: Array, dofs: tuple[str, ...], eta: Array, nu: Array) -> pd.DataFrame:
    """Return pose and body velocity, shape (N, n_dof) each, by time t [s]."""
    names = [*notation.poses_of(dofs), *notation.velocities_of(dofs)]
    return pd.DataFrame(np.hstack([eta, nu]), columns=names, index=pd.Index(t, name="t"))


def table_of(title: str, index: str, numbers: pd.DataFrame) -> TextTable:
    """Return a frame of numbers as a table, each row with its name."""
    rows: list[list[Scalar]] = [[str(name), *row] for name, row in numbers.iterrows()]
    return grid_of(title, (index, *map(str, numbers)), rows)
