"""Vessels and identified models as objects: simulated, written for other programs, sailed again."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import FORCE_UNIT, VELOCITY_UNIT, poses_of, velocities_of
from seatrial.runner import compare, export
from seatrial.runner.compare.grid import Scalar, grid_of
from seatrial.runner.interface.displayed_table import Table

if TYPE_CHECKING:  # what is slow to import
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from seatrial.models.excitation import commands, setpoints
    from seatrial.models.identification import free_run, validation
    from seatrial.models.recording.recording import Recording
    from seatrial.models.simulation import loop, registry
    from seatrial.models.vessel import parameters as vessels
    from seatrial.models.vessel.basis import Array
    from seatrial.models.vessel.table import Vessel as Coefficients
    from seatrial.models.weather import weather
    from seatrial.runner.export.stored_model import StoredModel

    Forces = Sequence[Sequence[float]] | Array | Mapping[str, Any]  # a frame is like a mapping
else:
    import lazy_loader

    pd = lazy_loader.load("pandas")
    free_run, validation, commands, setpoints, loop, registry, vessels, weather = (
        lazy_loader.load(f"seatrial.models.{name}", suppress_warning=True)
        for name in (
            *("identification.free_run", "identification.validation", "excitation.commands"),
            *("excitation.setpoints", "simulation.loop", "simulation.registry"),
            *("vessel.parameters", "weather.weather"),
        )
    )


class Model:
    """A model of a vessel: a table of coefficients, with the thrusters and limits of the vessel.

    `table` is the coefficient table, `parameters` the vessel that it belongs to, `choice` its name
    after `vessel=`, if it has one, `stored` the run that it comes from, and `address` the logbook
    of this run.
    """

    def __init__(
        self,
        table: "Coefficients",
        parameters: "vessels.VesselParameters",
        choice: str | None = None,
        stored: "StoredModel | None" = None,
        address: str | None = None,
    ) -> None:
        self.table = table
        self.parameters = parameters
        self.choice = choice
        self.stored = stored
        self.address = address

    @property
    def name(self) -> str:
        """Name of the vessel."""
        return self.parameters.name

    @property
    def dofs(self) -> tuple[str, ...]:
        """Degrees of freedom."""
        return self.table.dofs

    @property
    def coefficients(self) -> "pd.DataFrame":
        """The coefficients in SI units, force per term: terms are rows, columns are axes."""
        terms = [term.name for term in self.table.terms]
        return pd.DataFrame(self.table.theta.copy(), index=terms, columns=list(self.dofs))

    @property
    def inertia(self) -> "pd.DataFrame":
        """The inertia matrix with added mass [kg, kg m, kg m^2]."""
        axes = list(self.dofs)
        return pd.DataFrame(self.table.inertia.copy(), index=axes, columns=axes)

    def simulate(
        self,
        force: "Forces",
        period_s: float = 0.1,
        *,
        step_s: float = 0.025,
        pose: Sequence[float] | None = None,
        velocity: Sequence[float] | None = None,
    ) -> "pd.DataFrame":
        """Simulate the motion in calm water under commanded forces, through the thrusters.

        Args:
            force: commanded forces [N, Nm], held over each period: an array (N, n_dof), a frame or
                a mapping with a column for each degree of freedom (`surge` or `tau_surge`). A
                column that is missing is zero.
            period_s: time between two rows [s].
            step_s: longest integration step [s].
            pose: at the start [m, rad], shape (n_dof,); zero by default.
            velocity: at the start [m/s, rad/s], shape (n_dof,); zero by default.

        Returns:
            Pose, body velocity and command by time t [s], before the command of the row acts.

        Raises:
            Diverged: A velocity exceeds the limit of the vessel.
        """
        n_dof = len(self.dofs)
        forces = _commands(force, self.dofs)
        still = np.zeros_like(forces)
        start, start_nu = (
            np.zeros(n_dof) if values is None else np.array(values, dtype=np.float64)
            for values in (pose, velocity)
        )
        for name, values in (("pose", start), ("velocity", start_nu)):
            if values.shape != (n_dof,):
                raise ConfigurationError(
                    f"{name}: got shape {values.shape}, expected a number for each of {self.dofs}"
                )
        voyage = loop.sail(
            self.parameters.plant(self.table), weather.Weather(still, still, still, still),
            (registry.Timetable(still), np.zeros(1)), setpoints.UNFILTERED,
            commands.command([commands.Piece()], np.zeros(n_dof), 0, 0), start, period_s,
            min(step_s, period_s), start_nu, added=forces,
        )  # fmt: skip
        motion = motion_frame(voyage.t, self.dofs, voyage.log.eta, voyage.log.nu)
        for dof, column in zip(self.dofs, forces.T, strict=True):
            motion[f"tau_{dof}"] = column
        return motion

    def predict(self, recording: "Recording", restart_s: float = 30.0) -> "pd.DataFrame":
        """Predict a recorded motion from the recorded force.

        Args:
            recording: the recording; every piece without a gap begins at its measured state.
            restart_s: time [s] after which a prediction begins anew at the measured state.

        Returns:
            Predicted pose and body velocity by time t [s].

        Raises:
            IdentificationError: The model cannot be simulated: its inertia is not positive
                definite, or a term needs what is not predicted.
        """
        lag = self.parameters.thruster
        known = recording.with_thruster(lag)
        validation.prediction(self.table, known, lag)  # raises for a model that cannot be simulated
        every = max(round(restart_s / known.period_s), 2)
        course = validation.bounded_course(known, lag, None, every, self.table.attitude)
        motion = free_run.free_run(self.table, course, "rk4")
        n = len(self.dofs)
        return motion_frame(known.t, self.dofs, motion[:, :n], motion[:, n:])

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Draw the force that a steady motion along each axis alone requires, up to the limits.

        Args:
            ax: axes of yours to draw into, for a model with one degree of freedom.

        Returns:
            The figure, with a panel for each degree of freedom.
        """
        speeds = self.parameters.plant(self.table).velocity_limits
        most = self.parameters.force_limits or (np.inf,) * len(speeds)
        style = compare.plots.style
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
        self,
        to: str,
        output: str | Path | None = None,
        *,
        at: str | None = None,
        force: bool = False,
    ) -> list[Path]:
        """Write the model of a run for another program, as `seatrial-results model` does.

        Args:
            to: yaml, json, statespace, python-control, mss, pvs, gazebo, vrx, c or fmu.
            output: path of the (first) file; by default the name of the vessel and the run.
            at: operating point of a linear model, such as `"u=0.5"`.
            force: whether to replace files that exist.

        Returns:
            The files.
        """
        if self.stored is None:
            raise ConfigurationError(f"save: got {self.name}, expected the model of a stored run")
        path = None if output is None else Path(output)
        return export.model_formats.write(self.stored, to, path, at, force)

    def __repr__(self) -> str:
        return str(self._shown())

    def _repr_html_(self) -> str:
        return self._shown().text("html")

    @property
    def _source(self) -> str:
        return self.name if self.stored is None else self.stored.source

    def _shown(self) -> Table:
        rows: list[list[Scalar]] = [
            [term.name, *map(float, row)]
            for term, row in zip(self.table.terms, self.table.theta, strict=True)
            if np.any(row)
        ]
        return Table(grid_of(f"{self._source}, SI units", ("term", *self.dofs), rows))


def _commands(force: "Forces", dofs: tuple[str, ...]) -> "Array":
    """Return commanded forces as an array (N, n_dof)."""
    if not isinstance(force, Sequence | np.ndarray):
        known = {name.removeprefix("tau_"): force[name] for name in map(str, force)}
        if not known or set(known) - set(dofs):
            raise ConfigurationError(
                f"force: got columns {', '.join(known)}, expected some of {', '.join(dofs)}"
            )
        n = len(next(iter(known.values())))
        columns = [np.asarray(known.get(dof, np.zeros(n)), dtype=np.float64) for dof in dofs]
        return np.ascontiguousarray(np.column_stack(columns))
    array = np.array(force, dtype=np.float64, order="C")
    if array.ndim != 2 or array.shape[1] != len(dofs) or not len(array):
        raise ConfigurationError(f"force: got shape {array.shape}, expected (N, {len(dofs)})")
    return array


def motion_frame(t: "Array", dofs: tuple[str, ...], eta: "Array", nu: "Array") -> "pd.DataFrame":
    """Return pose and body velocity, shape (N, n_dof) each, by time t [s]."""
    names = [*poses_of(dofs), *velocities_of(dofs)]
    return pd.DataFrame(np.hstack([eta, nu]), columns=names, index=pd.Index(t, name="t"))
