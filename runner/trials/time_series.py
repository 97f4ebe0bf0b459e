"""Time series of a trial: the recording, the residual force and the deployments."""

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from seatrial.models.identification.problem import Identified, lack_of_fit
from seatrial.models.notation import (
    ACCELERATION_UNIT,
    FORCE_UNIT,
    PLANAR,
    POSE_UNIT,
    VELOCITY_UNIT,
    accelerations_of,
    poses_of,
    velocities_of,
)
from seatrial.models.recording.recording import Recording
from seatrial.models.simulation import metrics as measure
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from seatrial.models.weather.weather import Weather
from seatrial.runner.record.rows import Series
from seatrial.runner.record.vocabulary import IDENTIFIED_STD
from seatrial.runner.trials.closed_loop import ExcitationData, SimulatedMission
from seatrial.runner.trials.deployment_metrics import is_allocated
from seatrial.runner.trials.validation_metrics import Predictions

Mask = NDArray[np.bool_]
AXES = ("north", "east")
WIND_NOISE = ("noise_wind_ahead", "noise_wind_abeam")
_AFFIXES = re.compile(r"^(?:wave|noise|process)_|_(?:d|setpoint)$")


class SeriesColumns(dict[str, Array]):
    """The columns of a series of a vessel with some degrees of freedom."""

    def __init__(self, dofs: tuple[str, ...], t: Array) -> None:
        super().__init__(t=t)
        self.dofs, self.poses = dofs, poses_of(dofs)
        self.velocities, self.accelerations = velocities_of(dofs), accelerations_of(dofs)

    def add(
        self, values: Array | None, names: Sequence[str], before: str = "", after: str = ""
    ) -> None:
        """Add values (N, k) as columns of these names, if there are any."""
        if values is not None and len(values):
            columns = np.asarray(values).T
            self.update(zip((f"{before}{n}{after}" for n in names), columns, strict=True))

    def add_weather(self, weather: Weather) -> None:
        """Add the realised disturbances that are present and vary over time."""
        self.add(weather.wind_ned, AXES, "wind_")
        self.add(weather.current_ned, AXES, "current_")
        self.add(weather.wave_motion, self.poses, "wave_")
        self.add(weather.process, self.accelerations, "process_")

    def add_noise(self, weather: Weather) -> None:
        """Add the measurement noise and the force in NED, if they are not zero."""
        waves = weather.wave_motion if len(weather.wave_motion) else 0.0
        for values, names, before in (
            (weather.pose_noise - waves, self.poses, "noise_"),
            (weather.velocity_noise, self.velocities, "noise_"),
            (weather.acceleration_noise, self.accelerations, "noise_"),
            (weather.wind_noise, WIND_NOISE, ""),
            (weather.force_ned, self.dofs, "force_ned_"),
        ):
            self.add(values if np.any(values) else None, names, before)

    def add_recording(self, recording: Recording) -> None:
        """Add motion, command and acting force of a recording."""
        self.add(recording.eta, self.poses)
        self.add(recording.nu, self.velocities)
        self.add(recording.nu_dot, self.accelerations)
        if recording.inputs is None:
            self.add(recording.tau, self.dofs, "tau_")
        self.add(recording.inputs, recording.input_names)
        self.add(recording.commands, recording.input_names, after="_command")
        self.add(recording.tau_actual, self.dofs, "tau_actual_")

    def series(self, kind: str) -> Series:
        """Return the columns as a series, with the unit of each by its name."""
        axes = [f"{medium}_{axis}" for medium in ("wind", "current") for axis in AXES]
        units = dict.fromkeys([*axes, *WIND_NOISE, "air_ahead", "air_abeam"], "m/s")
        units |= {"t": "s", "train": "", "e_pos": "m", "e_psi": "rad"}
        for names, unit_of in (
            (self.poses, POSE_UNIT),
            (self.velocities, VELOCITY_UNIT),
            (self.accelerations, ACCELERATION_UNIT),
        ):
            units |= {name: unit_of[dof] for name, dof in zip(names, self.dofs, strict=True)}
        # That of `x` for `x_d`, `x_setpoint`, `wave_x`, `noise_x` and `process_x`, or of a force.
        named = {
            name: units.get(name)
            or units.get(_AFFIXES.sub("", name))
            or FORCE_UNIT.get(name.rpartition("_")[2], "")
            for name in self
        }
        return Series(kind, dict(self), named)


def recording_series(
    recording: Recording, training: Mask, sailed: SimulatedMission | None
) -> Series:
    """Return the recording as measured; for a simulation, with the realised weather."""
    columns = SeriesColumns(recording.dofs, recording.t)
    columns["train"] = training.astype(np.float64)
    columns.add_recording(recording)
    if sailed is not None:
        columns.add_weather(sailed.voyage.weather)
        columns.add_noise(sailed.voyage.weather)
        if is_allocated(sailed.voyage):  # the commanded forces before the allocation
            columns.add(sailed.voyage.log.tau, columns.dofs, "tau_asked_")
        columns.add(sailed.wind, columns.dofs, "wind_")
    return columns.series("recording")


def training_series(recording: Recording) -> Series:
    """Return what an identifier may use, for programs that read it from a file.

    `tau_filtered` is the command filtered by a known thruster lag, `air` the measured velocity of
    the air.
    """
    columns = SeriesColumns(recording.dofs, recording.t)
    columns.add_recording(recording)
    columns.add(recording.tau_filtered, columns.dofs, "tau_filtered_")
    columns.add(recording.wind, ("ahead", "abeam"), "air_")
    return columns.series("recording")


def residual_series(excited: ExcitationData, nominal: Vessel, identified: Identified) -> Series:
    """Return the commanded force, and its residual for every model, over the recording."""
    recording = excited.recording
    columns = SeriesColumns(recording.dofs, recording.t)
    columns["train"] = excited.training.astype(np.float64)
    columns.add(recording.tau, columns.dofs, "tau_")
    models = {"nominal": nominal, "identified": identified.model}
    if excited.truth is not None:
        models["plant"] = excited.truth
    for name, model in models.items():
        residual = lack_of_fit(recording, model, "commanded")
        columns.add(residual, columns.dofs, f"residual_{name}_")
    return columns.series("residual")


def prediction_series(
    held_out: Recording, predicted: Predictions, deviation: Array | None = None
) -> Series:
    """Return the held-out motion and its predictions; NaN where they diverge.

    `start` is 1 at the measured states from which the free runs begin. `surge` is the measured
    velocity, `surge_identified` that of the free run, `surge_identified_10s` that predicted from
    the state measured 10 s before; likewise `x` and `x_identified`. `surge_identified_std` is the
    standard deviation of the measured velocity about that of the free run (`model_error`).
    """
    columns = SeriesColumns(held_out.dofs, held_out.t)
    names = (*columns.poses, *columns.dofs)
    unit_of = [units[dof] for units in (POSE_UNIT, VELOCITY_UNIT) for dof in columns.dofs]
    columns["start"] = held_out.piece_starts.astype(np.float64)
    units = {"t": "s", "start": ""}
    parts = {"": np.hstack([held_out.eta, held_out.nu])}
    parts |= {f"_{model}": motion for model, motion in predicted.free_runs.items()}
    parts |= {f"_{model}_{s:g}s": values for (model, s), values in predicted.after.items()}
    if deviation is not None:
        parts[f"_{IDENTIFIED_STD}"] = deviation
    for suffix, values in parts.items():
        columns.add(values, names, after=suffix)
        units |= {f"{n}{suffix}": unit for n, unit in zip(names, unit_of, strict=True)}
    return Series("prediction", dict(columns), units)


def deployment_series(sailed: SimulatedMission, model: str) -> Series:
    """Return a deployment: pose, reference, set-point, velocity, force, error and weather."""
    voyage = sailed.voyage
    log, columns = voyage.log, SeriesColumns(voyage.dofs, voyage.t)
    columns.add(log.eta, columns.poses)
    columns.add(log.eta_d, columns.poses, after="_d")
    columns.add(log.nu, columns.velocities)
    columns.add(log.nu_d, columns.velocities, after="_d")
    if voyage.inputs:
        columns.add(log.tau_actual, voyage.inputs)
        columns.add(log.applied, voyage.inputs, after="_command")
    if voyage.by_force:
        columns.add(log.tau, columns.dofs, "tau_")
        columns.add(log.tau_fb, columns.dofs, "tau_fb_")
    if is_allocated(voyage):
        columns.add(log.applied, columns.dofs, "tau_applied_")
    columns["e_pos"] = measure.position_error(log.eta_d, log.eta)
    if columns.dofs == PLANAR:
        columns["e_psi"] = measure.heading_error(log.eta_d, log.eta)
    columns.add_weather(voyage.weather)
    columns.add(log.setpoint, columns.poses, after="_setpoint")
    columns.add(sailed.wind, columns.dofs, "wind_")
    return columns.series(f"deployment_{model}")
