"""Time series of a trial: the recording, the residual force and the deployments."""

import re
from collections.abc import Iterable, Sequence

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
WIND_NOISE = ("noise_wind_ahead", "noise_wind_abeam")
_AFFIXES = re.compile(r"^(?:wave|noise|process)_|_(?:d|setpoint)$")


def _columns(names: Iterable[str], values: Array) -> dict[str, Array]:
    return dict(zip(names, np.asarray(values).T, strict=True))


def _units(dofs: tuple[str, ...], columns: Iterable[str]) -> dict[str, str]:
    """Return the unit of each series column, by its name."""
    axes = [f"{medium}_{axis}" for medium in ("wind", "current") for axis in ("north", "east")]
    units = dict.fromkeys([*axes, *WIND_NOISE], "m/s")
    units |= {"t": "s", "train": "", "e_pos": "m", "e_psi": "rad"}
    for names, unit_of in (
        (poses_of(dofs), POSE_UNIT),
        (velocities_of(dofs), VELOCITY_UNIT),
        (accelerations_of(dofs), ACCELERATION_UNIT),
    ):
        units |= {name: unit_of[dof] for name, dof in zip(names, dofs, strict=True)}
    # That of `x` for `x_d`, `x_setpoint`, `wave_x`, `noise_x` and `process_x`, or that of a force.
    return {
        name: units.get(name)
        or units.get(_AFFIXES.sub("", name))
        or FORCE_UNIT.get(name.rpartition("_")[2], "")
        for name in columns
    }


def _weather(weather: Weather, dofs: tuple[str, ...]) -> dict[str, Array]:
    """Return the realised disturbances that are present and vary over time."""
    axes = ("north", "east")
    parts = (
        ([f"wind_{axis}" for axis in axes], weather.wind_ned),
        ([f"current_{axis}" for axis in axes], weather.current_ned),
        ([f"wave_{name}" for name in poses_of(dofs)], weather.wave_motion),
        ([f"process_{name}" for name in accelerations_of(dofs)], weather.process),
    )
    return {k: v for names, part in parts if len(part) for k, v in _columns(names, part).items()}


def _noise(weather: Weather, dofs: tuple[str, ...]) -> dict[str, Array]:
    """Return the measurement noise and the force in NED, if they are not zero."""
    waves = weather.wave_motion if len(weather.wave_motion) else 0.0
    parts = (
        ([f"noise_{name}" for name in poses_of(dofs)], weather.pose_noise - waves),
        ([f"noise_{name}" for name in velocities_of(dofs)], weather.velocity_noise),
        ([f"noise_{name}" for name in accelerations_of(dofs)], weather.acceleration_noise),
        (WIND_NOISE, weather.wind_noise),
        ([f"force_ned_{dof}" for dof in dofs], weather.force_ned),
    )
    return {k: v for names, part in parts if np.any(part) for k, v in _columns(names, part).items()}


def recording_series(
    recording: Recording, training: Mask, sailed: SimulatedMission | None
) -> Series:
    """Return the recording as measured; for a simulation, with the realised weather."""
    dofs = recording.dofs
    columns = {"t": recording.t, "train": training.astype(np.float64), **_measured(recording)}
    if sailed is not None:
        columns |= _weather(sailed.voyage.weather, dofs)
        columns |= _noise(sailed.voyage.weather, dofs)
        if is_allocated(sailed.voyage):  # the commanded forces before the allocation
            columns |= _columns([f"tau_asked_{dof}" for dof in dofs], sailed.voyage.log.tau)
        if sailed.wind is not None:
            columns |= _columns([f"wind_{dof}" for dof in dofs], sailed.wind)
    return Series("recording", columns, _units(dofs, columns))


def _measured(recording: Recording) -> dict[str, Array]:
    """Return motion, command and acting force of a recording."""
    dofs = recording.dofs
    columns = _columns(poses_of(dofs), recording.eta)
    columns |= _columns(velocities_of(dofs), recording.nu)
    columns |= _columns(accelerations_of(dofs), recording.nu_dot)
    if recording.inputs is None:
        columns |= _columns([f"tau_{dof}" for dof in dofs], recording.tau)
    else:
        columns |= _columns(recording.input_names, recording.inputs)
    if recording.commands is not None:
        columns |= _columns(_command_names(recording.input_names), recording.commands)
    if recording.tau_actual is not None:
        columns |= _columns([f"tau_actual_{dof}" for dof in dofs], recording.tau_actual)
    return columns


def training_series(recording: Recording) -> Series:
    """Return what an identifier may use, for programs that read it from a file.

    `tau_filtered` is the command filtered by a known thruster lag, `air` the measured velocity of
    the air.
    """
    dofs = recording.dofs
    columns = {"t": recording.t, **_measured(recording)}
    if recording.tau_filtered is not None:
        columns |= _columns([f"tau_filtered_{dof}" for dof in dofs], recording.tau_filtered)
    units = _units(dofs, columns)
    if recording.wind is not None:
        wind = _columns(("air_ahead", "air_abeam"), recording.wind)
        columns, units = columns | wind, units | dict.fromkeys(wind, "m/s")
    return Series("recording", columns, units)


def _command_names(inputs: Sequence[str]) -> list[str]:
    """Return the columns of the commands of inputs."""
    return [f"{name}_command" for name in inputs]


def residual_series(excited: ExcitationData, nominal: Vessel, identified: Identified) -> Series:
    """Return the commanded force, and its residual for every model, over the recording."""
    recording = excited.recording
    dofs = recording.dofs
    columns = {"t": recording.t, "train": excited.training.astype(np.float64)}
    columns |= _columns([f"tau_{dof}" for dof in dofs], recording.tau)
    models = {"nominal": nominal, "identified": identified.model}
    if excited.truth is not None:
        models["plant"] = excited.truth
    for name, model in models.items():
        residual = lack_of_fit(recording, model, "commanded")
        columns |= _columns([f"residual_{name}_{dof}" for dof in dofs], residual)
    return Series("residual", columns, _units(dofs, columns))


def prediction_series(
    held_out: Recording, predicted: Predictions, deviation: Array | None = None
) -> Series:
    """Return the held-out motion and its predictions; NaN where they diverge.

    `start` is 1 at the measured states from which the free runs begin. `surge` is the measured
    velocity, `surge_identified` that of the free run, `surge_identified_10s` that predicted from
    the state measured 10 s before; likewise `x` and `x_identified`. `surge_identified_std` is the
    standard deviation of the measured velocity about that of the free run (`model_error`).
    """
    dofs = held_out.dofs
    names, unit = (*poses_of(dofs), *dofs), _units(dofs, (*poses_of(dofs), *velocities_of(dofs)))
    unit_of = dict(zip(names, unit.values(), strict=True))
    columns = {"t": held_out.t, "start": held_out.piece_starts.astype(np.float64)}
    columns |= _columns(names, np.hstack([held_out.eta, held_out.nu]))
    units = {"t": "s", "start": "", **unit_of}
    parts = [(names, model, motion) for model, motion in predicted.free_runs.items()]
    parts += [
        (names, f"{model}_{seconds:g}s", values)
        for (model, seconds), values in predicted.after.items()
    ]
    if deviation is not None:
        parts.append((names, IDENTIFIED_STD, deviation))
    for of, suffix, values in parts:
        columns |= _columns([f"{name}_{suffix}" for name in of], values)
        units |= {f"{name}_{suffix}": unit_of[name] for name in of}
    return Series("prediction", columns, units)


def deployment_series(sailed: SimulatedMission, model: str) -> Series:
    """Return a deployment: pose, reference, set-point, velocity, force, error and weather."""
    voyage = sailed.voyage
    log, dofs = voyage.log, voyage.dofs
    columns = {"t": voyage.t}
    columns |= _columns(poses_of(dofs), log.eta)
    columns |= _columns([f"{name}_d" for name in poses_of(dofs)], log.eta_d)
    columns |= _columns(velocities_of(dofs), log.nu)
    columns |= _columns([f"{name}_d" for name in velocities_of(dofs)], log.nu_d)
    if voyage.inputs:
        columns |= _columns(voyage.inputs, log.tau_actual)
        columns |= _columns(_command_names(voyage.inputs), log.applied)
    if voyage.by_force:
        columns |= _columns([f"tau_{dof}" for dof in dofs], log.tau)
        columns |= _columns([f"tau_fb_{dof}" for dof in dofs], log.tau_fb)
    if is_allocated(voyage):
        columns |= _columns([f"tau_applied_{dof}" for dof in dofs], log.applied)
    columns["e_pos"] = measure.position_error(log.eta_d, log.eta)
    if dofs == PLANAR:
        columns["e_psi"] = measure.heading_error(log.eta_d, log.eta)
    columns |= _weather(voyage.weather, dofs)
    columns |= _columns([f"{name}_setpoint" for name in poses_of(dofs)], log.setpoint)
    if sailed.wind is not None:
        columns |= _columns([f"wind_{dof}" for dof in dofs], sailed.wind)
    return Series(f"deployment_{model}", columns, _units(dofs, columns))
