"""Time series of a trial: columns of equal length with their units."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from seatrial.models import notation
from seatrial.models.recording.recording import Recording
from seatrial.models.simulation import metrics as measure
from seatrial.models.simulation.voyage import Voyage
from seatrial.models.vessel.basis import Array
from seatrial.models.weather.weather import Weather
from seatrial.runner.record.rows import Series
from seatrial.runner.trials.closed_loop import ExcitationData, SimulatedMission

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
