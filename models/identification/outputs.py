"""Outputs of a prediction that a fit compares with the recording, each with a weight.

    e = weight (y_hat - y) / s

where s is the standard deviation of the measured output y in its file, so that every file and
every output counts alike whatever its size. Outputs are poses and velocities, and loads that were
measured on devices, such as `propeller.thrust`. A measured load that is NaN is left out.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import POSE_UNIT, VELOCITY_UNIT, poses_of, velocities_of
from seatrial.models.recording.recording import Recording, attitude_of
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.devices.device import Device
from seatrial.models.vessel.table import Vessel

ALL = "all"


@dataclass(frozen=True, eq=False)
class Outputs:
    """The compared states, and then the compared loads of a recording."""

    names: tuple[str, ...]
    dofs: tuple[str, ...]  # `all` for a load
    units: tuple[str, ...]
    columns: tuple[int, ...]  # of the states
    loads: tuple[int, ...]  # of the loads of the recording
    recording: Recording
    scale: Array  # (N, n) standard deviation in the file over the weight; 1 where there is no data

    @property
    def spread(self) -> Array:
        """Size (n,) of each output."""
        return np.asarray(np.median(self.scale, axis=0))

    def errors(self, deviation: Array, nu: Array, devices: Mapping[str, Device]) -> Array:
        """Predicted - measured (N, n), from that of the states and the predicted velocities.

        deviation (N, 2 n_dof), nu (N, n_dof); the devices give the loads.
        """
        errors = deviation[:, self.columns]
        if not self.loads:
            return errors
        predicted = _loads(self.recording, nu, devices, [*self.names[len(self.columns) :]])
        assert self.recording.loads is not None
        difference = predicted - self.recording.loads[:, self.loads]
        known = np.isfinite(self.recording.loads[:, self.loads])
        return np.hstack([errors, np.where(known, difference, 0.0)])


def outputs_of(weights: Mapping[str, float], recording: Recording, nominal: Vessel) -> Outputs:
    """The outputs with a weight; raises ConfigurationError for one that is not known.

    A load that the recording does not have is left out.
    """
    check_outputs(weights, nominal)
    states = (*poses_of(nominal.dofs), *velocities_of(nominal.dofs))
    units = [unit[dof] for unit in (POSE_UNIT, VELOCITY_UNIT) for dof in nominal.dofs]
    columns = [i for i, name in enumerate(states) if name in weights]
    loads = [i for i, name in enumerate(recording.load_names) if name in weights]
    names = [*(states[i] for i in columns), *(recording.load_names[i] for i in loads)]
    measured = np.hstack([recording.eta, recording.nu])[:, columns]
    if recording.loads is not None:
        measured = np.hstack([measured, recording.loads[:, loads]])
    scale = _spread_by_file(measured, recording) / [weights[name] for name in names]
    dofs = [*((nominal.dofs * 2)[i] for i in columns), *(ALL for _ in loads)]
    own_units = [*(units[i] for i in columns), *("N" for _ in loads)]
    return Outputs(
        tuple(names), tuple(dofs), tuple(own_units), tuple(columns), tuple(loads), recording, scale
    )


def check_outputs(weights: Mapping[str, float], nominal: Vessel) -> None:
    """Raise ConfigurationError for an output that is not known, and for a weight of zero."""
    states = (*poses_of(nominal.dofs), *velocities_of(nominal.dofs))
    loads = [f"{name}.{load}" for name, each in nominal.devices.items() for load in each.LOADS]
    for name, weight in weights.items():
        if name not in states and name not in loads:
            expected = ", ".join((*states, *loads))
            raise ConfigurationError(f"identifier.outputs: got {name}, expected some of {expected}")
        if not weight > 0.0:
            raise ConfigurationError(f"identifier.outputs.{name} must be positive, got {weight:g}")
    if not set(weights) & set(states):
        raise ConfigurationError(
            f"identifier.outputs: got no state, expected some of {', '.join(states)}"
        )


def _spread_by_file(measured: Array, recording: Recording) -> Array:
    """Standard deviation of columns (N, n) in the file of each sample; 1 for what is constant."""
    file = np.zeros(len(recording), dtype=np.int64) if recording.file is None else recording.file
    scale = np.ones_like(measured)
    for number in np.unique(file):
        rows: NDArray[np.bool_] = file == number
        deviation = np.std(measured[rows], axis=0)
        scale[rows] = np.where(deviation > 0.0, deviation, 1.0)  # 1 for NaN
    return scale


def _loads(
    recording: Recording, nu: Array, devices: Mapping[str, Device], names: Sequence[str]
) -> Array:
    """Loads (N, n) of devices at velocities nu (N, n_dof) and the recorded inputs."""
    assert recording.inputs is not None
    inputs = dict(zip(recording.input_names, recording.inputs.T, strict=True))
    attitude = attitude_of(recording.dofs, recording.eta)
    x = basis.variables(np.zeros_like(nu), nu, attitude, recording.dofs, recording.wind, inputs)
    columns = []
    for name in names:
        device, _, load = name.partition(".")
        each = devices[device]
        columns.append(each.loads(x)[:, each.LOADS.index(load)])
    return np.column_stack(columns)
