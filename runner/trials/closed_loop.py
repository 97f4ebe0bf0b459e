"""Closed-loop simulation of a mission, and its time series with units.

A mission is simulated with plant, weather, controller and adaptation; a recording, simulated or
measured, and a deployment are stored as columns of equal length.
"""

import logging
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from seatrial.models import notation
from seatrial.models.compiled import is_compiled
from seatrial.models.control.controller import Controller, Model
from seatrial.models.control.linear_design import largest_disturbance
from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError, Diverged, PartError
from seatrial.models.excitation.commands import Steering
from seatrial.models.excitation.missions import Mission
from seatrial.models.identification.adaptive import Adapter, Update
from seatrial.models.recording.recording import Recording, attitude_of
from seatrial.models.returned import checked_array, name_of
from seatrial.models.simulation import metrics as measure
from seatrial.models.simulation.dynamics import advance
from seatrial.models.simulation.loop import sail
from seatrial.models.simulation.registry import CONTROLLERS, GUIDANCE, Parameters, State, Timetable
from seatrial.models.simulation.voyage import Outlook, Voyage, measured_wind, outlook
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.parameters import Plant
from seatrial.models.vessel.table import Vessel
from seatrial.models.weather.weather import Weather
from seatrial.runner.configuration.config import Trial
from seatrial.runner.configuration.plugins import is_own
from seatrial.runner.record.rows import Results, Series
from seatrial.runner.record.vocabulary import STREAMS, Stream

log = logging.getLogger(__name__)
IN_PYTHON = "controller %s: its step is Python, so the loop is not compiled and takes longer"
_said: set[str] = set()  # controllers of which this has been said


@dataclass(frozen=True, eq=False)
class ControlDesign:
    """Properties of a controller's design on a model, known before the simulation."""

    dofs: tuple[str, ...]
    needed: Array  # (n_dof,) largest force needed to hold the vessel still [N, Nm]
    limits: tuple[float, ...] | None = None  # [N, Nm]
    ahead: int = 0  # preview horizon, in loop instants
    every: int = 1  # period of the commands, in loop instants
    diagnostics: Sequence[Diagnostic] = ()


@dataclass(frozen=True, eq=False)
class SimulatedMission:
    """A simulated voyage, and the controller design it was simulated with."""

    voyage: Voyage
    period_s: float
    design: ControlDesign
    failures: int = 0  # number of commands that could not be computed; the last one was held
    findings: Sequence[Diagnostic] = ()  # of the controller
    adapter: Adapter | None = None  # the online identification, if any
    wind: Array | None = None  # (N, n_dof) force of the wind [N, Nm]


@dataclass(frozen=True, eq=False)
class ExcitationData:
    """The recording of an excitation, its split, and the true model if it is known."""

    recording: Recording
    training: NDArray[np.bool_]  # mask of the training samples, shape (N,)
    testing: NDArray[np.bool_]
    truth: Vessel | None  # coefficients of the plant, with those of the disturbance
    sailed: SimulatedMission | None = None  # what was recorded; None for a measured file


class TrialDiverged(Diverged):
    """A simulation diverged; `results` are those that are valid all the same."""

    def __init__(self, error: Diverged, results: Results) -> None:
        super().__init__(str(error), error.time_s, error.quantity)
        self.results = results


class Streams:
    """The independent random streams of one trial, spawned from its seed.

    Generators of one stream give equal numbers. A trial whose result draws from no stream does not
    depend on its seed.
    """

    def __init__(self, seed: int) -> None:
        seeds = np.random.SeedSequence(seed).spawn(len(STREAMS))
        self._seeds = dict(zip(STREAMS, seeds, strict=True))
        self._generators: list[tuple[Stream, np.random.Generator]] = []

    def generator(self, stream: Stream) -> np.random.Generator:
        """Return a new generator of a stream."""
        generator = np.random.default_rng(self._seeds[stream])
        self._generators.append((stream, generator))
        return generator

    def drawn(self) -> tuple[Stream, ...]:
        """Return the streams from which a number was drawn so far."""
        used = {
            stream
            for stream, generator in self._generators
            if generator.bit_generator.state
            != np.random.default_rng(self._seeds[stream]).bit_generator.state
        }
        return tuple(stream for stream in STREAMS if stream in used)


@dataclass(frozen=True, eq=False)
class MissionSetup:
    """A mission ready to be simulated: the plant, the weather and the built controller."""

    trial: Trial
    seeds: Streams
    model: Model
    mission: Mission
    plant: Plant
    weather: Weather
    guidance: tuple[Parameters, State]
    reference: Parameters
    controller: Controller
    control: tuple[Parameters, State]
    start: Array
    added: Array | None  # force that the excitation adds to the command [N, Nm]
    ahead: Outlook
    design: ControlDesign

    def sail(self, update: Update | None = None) -> SimulatedMission:
        """Simulate the mission, with online identification by `update`; raises Diverged."""
        trial, controller, state = self.trial, self.controller, self.control[1]
        dofs, period = trial.vessel.dofs, trial.sample_time_s
        name, step = name_of(controller), CONTROLLERS[type(self.control[0])]
        in_python = is_compiled(advance) and not is_compiled(step) and not is_own(name)
        if in_python and name not in _said:
            _said.add(name)
            log.info(IN_PYTHON, name)
        adapter = None
        if update is not None and isinstance(self.model, Vessel):
            adapter = Adapter(
                update, trial.identifier, trial.vessel.thruster, self.weather, dofs, period,
                self.model, self.seeds.generator("identifier"),
                lambda parameters, state, model, log, k: controller.adapt(
                    parameters, state, model, period, self.ahead, log, k
                ),
            )  # fmt: skip
        voyage = sail(
            self.plant, self.weather, self.guidance, self.reference, self.control, self.start,
            period, trial.integration_step_s, start_nu=self.mission.start_velocity(dofs),
            watch=None if adapter is None else adapter.watch, added=self.added,
        )  # fmt: skip
        wind, table, nu = wind_in_body(voyage), trial.disturbance.aerodynamics(dofs), voyage.log.nu
        if wind is not None:  # its force
            attitude = attitude_of(dofs, voyage.log.eta)
            wind = -table.inverse(np.zeros_like(nu), nu, attitude, wind) if table.terms else None
        failures, findings = controller.failures(state), controller.findings(state)
        return SimulatedMission(voyage, period, self.design, failures, findings, adapter, wind)


@dataclass(frozen=True, eq=False)
class _Given(Controller):
    """The commands that a mission gives in place of a controller."""

    control: Steering

    def build(self, model: Model, period_s: float) -> tuple[Parameters, State]:
        """The step of the mission."""
        return self.control


def drawn(trial: Trial, seeds: Streams) -> Trial:
    """Return a trial with what its missions draw; raises ConfigurationError where that is none."""
    missions: dict[str, Any] = {}
    groups: tuple[Stream, ...] = ("excitation", "evaluation")
    for group in groups:
        if isinstance(mission := getattr(trial, group), Mission):
            with named(trial, group):
                missions[group] = mission.drawn(seeds.generator(group))
    return replace(trial, **missions)


@contextmanager
def named(trial: Trial, group: str) -> Iterator[None]:
    """Put the option chosen from the group before an error message of what is done."""
    try:
        yield
    except ConfigurationError as error:
        name = f"{group}={trial.names[group]}"
        if str(error).startswith(name):
            raise
        raise ConfigurationError(f"{name}: {error}") from error


def prepare(
    trial: Trial, seeds: Streams, model: Model, mission: Mission,
    deployed: bool = False, true: Vessel | None = None,
) -> MissionSetup:  # fmt: skip
    """Prepare a mission that starts at rest, with the controller built on `model`.

    In a deployment (`deployed`) the plant changes as the trial's `plant.change` says. `true` is the
    model of the plant; None means the nominal one, scaled.
    """
    vessel, period = trial.vessel, trial.sample_time_s
    count = round(mission.duration_s / period)
    if deployed and trial.samples is not None:
        count = min(count, trial.samples)
    t = period * np.arange(count, dtype=np.float64)
    start = np.zeros(len(vessel.dofs)) if mission.start is None else np.array(mission.start)
    noise, disturbance = seeds.generator("noise"), seeds.generator("disturbance")
    weather = trial.disturbance.realise(len(t), vessel.dofs, noise, disturbance, period)
    steering, plant = mission.steering(vessel.dofs, period), plant_of(trial, deployed, true)
    controller = trial.controller if steering is None else _Given(steering)
    assert controller is not None
    steers = controller if steering is None else mission
    if plant.inputs and not steers.commands_inputs:  # but forces
        plant = replace(plant, allocation=vessel.positioning)
    guidance, reference = mission.guidance(t, start), mission.reference_filter.table(period)
    _check_step(mission, "guidance", guidance, GUIDANCE)
    if isinstance(guidance[0], Timetable):
        shape = len(t), len(vessel.dofs)
        checked_array(mission, "guidance", guidance[0].setpoints, shape)
    added = mission.force(t, vessel.dofs, seeds.generator("excitation"))
    if added is not None:
        added = checked_array(mission, "force", added, (len(t), len(vessel.dofs)))
    ahead = mission.foreseen(outlook(plant, weather, guidance[0], reference, start, added))
    heading = ahead.reference[:, 2] if vessel.planar and len(ahead.reference) else np.zeros(0)
    controller = controller.deployed() if deployed else controller
    model = commanded(model, controller)
    built = controller.build(model, period)
    _check_step(controller, "build", built, CONTROLLERS)
    parameters, state = built
    design = ControlDesign(
        vessel.dofs, largest_disturbance(plant.vessel, weather, heading),
        controller.command_limits(), controller.preview_rows(period),
        controller.command_rows(period), controller.diagnostics(model, period),
    )  # fmt: skip
    return MissionSetup(
        trial, seeds, model, mission, plant, weather, guidance, reference, controller,
        (controller.foresee(parameters, ahead), state), start, added, ahead, design,
    )  # fmt: skip


def commanded(model: Model, controller: Controller) -> Model:
    """Return the model for a controller: of a vessel with inputs the hull, if it gives forces."""
    if not isinstance(model, Vessel) or not model.inputs or controller.commands_inputs:
        return model
    hull = {name: device for name, device in model.devices.items() if not device.inputs()}
    return replace(model, inputs=(), devices=hull)


def _check_step(
    part: Controller | Mission, method: str, built: object, registered: Container[type]
) -> None:
    """Check that a part returned the parameters of a registered step; raises PartError."""
    parameters = built[0] if isinstance(built, tuple) and len(built) == 2 else built
    if (kind := type(parameters)) not in registered:
        where = f"{name_of(part)}.{method}"
        raise PartError(f"{where}: got a {kind.__name__}, for which no step is registered")


def plant_of(trial: Trial, deployed: bool, true: Vessel | None = None) -> Plant:
    """Build the true vessel with its wind forces and, in a deployment, its change.

    Wind forces are not added to a model `true` that has terms of its own for them.
    """
    vessel, change = trial.vessel, trial.plant.change
    wind = trial.disturbance.aerodynamics(vessel.dofs)
    model, scale = (vessel.nominal(), trial.plant.scale) if true is None else (true, 1.0)
    if true is not None and true.force_table().aerodynamic:
        wind = 0.0 * wind
    plant = vessel.plant(scale * model + wind)
    if not deployed or change is None:
        return plant
    return replace(plant, change=(change.at_s, change.scale * model + wind))


def wind_in_body(voyage: Voyage) -> Array | None:
    """Compute the wind velocity in the body frame [m/s], shape (N, 2); None without wind."""
    return measured_wind(voyage, voyage.weather._replace(wind_noise=np.zeros((0, 2))))


def warn(text: str, reasons: Iterable[object]) -> list[Diagnostic]:
    """Log a warning for each reason, and return the reasons as diagnostics."""
    labels = [*map(str, reasons)]
    for label in labels:
        log.warning(text.format(label))
    return [Diagnostic("warning", "all", None, label=label) for label in labels]


AXES = {"north": "m/s", "east": "m/s"}
AIR = {"ahead": "m/s", "abeam": "m/s"}


class SeriesColumns:
    """The columns of a series of a vessel with some degrees of freedom.

    `pose`, `velocity`, `acceleration`, `speed` and `force` have the unit of each name.
    """

    def __init__(self, dofs: tuple[str, ...], t: Array) -> None:
        self.columns, self.units = {"t": t}, {"t": "s"}
        self.pose = _named(notation.poses_of(dofs), notation.POSE_UNIT, dofs)
        self.velocity = _named(notation.velocities_of(dofs), notation.VELOCITY_UNIT, dofs)
        self.acceleration = _named(
            notation.accelerations_of(dofs), notation.ACCELERATION_UNIT, dofs
        )
        self.speed = _named(dofs, notation.VELOCITY_UNIT, dofs)
        self.force = _named(dofs, notation.FORCE_UNIT, dofs)

    def add(self, values: NDArray[Any] | None, units: Mapping[str, str], form: str = "{}") -> None:
        """Add values (N, k) or (N,), if there are any, as columns named by `form`."""
        if values is not None and len(values):
            for (name, unit), column in zip(units.items(), np.atleast_2d(values.T), strict=True):
                self.columns[form.format(name)] = np.asarray(column, dtype=np.float64)
                self.units[form.format(name)] = unit

    def add_weather(self, weather: Weather) -> None:
        """Add the realised disturbances that are present and vary over time."""
        self.add(weather.wind_ned, AXES, "wind_{}")
        self.add(weather.current_ned, AXES, "current_{}")
        self.add(weather.wave_motion, self.pose, "wave_{}")
        self.add(weather.process, self.acceleration, "process_{}")

    def add_recording(self, recording: Recording) -> None:
        """Add motion, command and acting force of a recording."""
        inputs = dict.fromkeys(recording.input_names, "")
        self.add(recording.eta, self.pose)
        self.add(recording.nu, self.velocity)
        self.add(recording.nu_dot, self.acceleration)
        self.add(recording.tau if recording.inputs is None else None, self.force, "tau_{}")
        self.add(recording.inputs, inputs)
        self.add(recording.commands, inputs, "{}_command")
        self.add(recording.tau_actual, self.force, "tau_actual_{}")

    def series(self, kind: str) -> Series:
        """Return the columns as a series."""
        return Series(kind, self.columns, self.units)


def _named(names: Iterable[str], units: Mapping[str, str], dofs: Iterable[str]) -> dict[str, str]:
    return {name: units[dof] for name, dof in zip(names, dofs, strict=True)}


def recording_series(excited: ExcitationData) -> Series:
    """Return the recording as measured; for a simulation, with the realised weather."""
    recording, sailed = excited.recording, excited.sailed
    columns = SeriesColumns(recording.dofs, recording.t)
    columns.add(excited.training, {"train": ""})
    columns.add_recording(recording)
    if sailed is None:
        return columns.series("recording")
    weather = sailed.voyage.weather
    columns.add_weather(weather)
    waves = weather.wave_motion if len(weather.wave_motion) else 0.0
    for values, units, form in (
        (weather.pose_noise - waves, columns.pose, "noise_{}"),
        (weather.velocity_noise, columns.velocity, "noise_{}"),
        (weather.acceleration_noise, columns.acceleration, "noise_{}"),
        (weather.wind_noise, AIR, "noise_wind_{}"),
        (weather.force_ned, columns.force, "force_ned_{}"),
    ):
        columns.add(values if np.any(values) else None, units, form)
    if is_allocated(sailed.voyage):  # the commanded forces before the allocation
        columns.add(sailed.voyage.log.tau, columns.force, "tau_asked_{}")
    columns.add(sailed.wind, columns.force, "wind_{}")
    return columns.series("recording")


def training_series(recording: Recording) -> Series:
    """Return what an identifier may use, for programs that read it from a file.

    `tau_filtered` is the command filtered by a known thruster lag, `air` the measured velocity of
    the air.
    """
    columns = SeriesColumns(recording.dofs, recording.t)
    columns.add_recording(recording)
    columns.add(recording.tau_filtered, columns.force, "tau_filtered_{}")
    columns.add(recording.wind, AIR, "air_{}")
    return columns.series("recording")


def is_allocated(voyage: Voyage) -> bool:
    """Return whether commands were changed, if by rounding, to what the thrusters can give."""
    return not voyage.positioned and not np.array_equal(voyage.log.applied, voyage.log.tau)


def deployment_series(sailed: SimulatedMission, model: str) -> Series:
    """Return a deployment: pose, reference, set-point, velocity, force, error and weather."""
    voyage = sailed.voyage
    log, columns = voyage.log, SeriesColumns(voyage.dofs, voyage.t)
    columns.add(log.eta, columns.pose)
    columns.add(log.eta_d, columns.pose, "{}_d")
    columns.add(log.nu, columns.velocity)
    columns.add(log.nu_d, columns.velocity, "{}_d")
    if voyage.inputs:
        inputs = dict.fromkeys(voyage.inputs, "")
        columns.add(log.tau_actual, inputs)
        columns.add(log.applied, inputs, "{}_command")
    if voyage.by_force:
        columns.add(log.tau, columns.force, "tau_{}")
        columns.add(log.tau_fb, columns.force, "tau_fb_{}")
    if is_allocated(voyage):
        columns.add(log.applied, columns.force, "tau_applied_{}")
    columns.add(measure.position_error(log.eta_d, log.eta), {"e_pos": "m"})
    if voyage.dofs == notation.PLANAR:
        columns.add(measure.heading_error(log.eta_d, log.eta), {"e_psi": "rad"})
    columns.add_weather(voyage.weather)
    columns.add(log.setpoint, columns.pose, "{}_setpoint")
    columns.add(sailed.wind, columns.force, "wind_{}")
    return columns.series(f"deployment_{model}")
