"""A model in C, compiled and called, and our own kernels on the same vessel."""

import ctypes
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from seatrial.models.simulation.dynamics import advance, rates, scratch
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.parameters import VesselParameters
from seatrial.models.vessel.pose import Kinematics, kinematics_of, state_of
from seatrial.models.vessel.thruster import lag_table
from seatrial.models.weather.weather import Weather

FLAGS = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic")
NONE = np.zeros((0, 0))


def compiled(source: Path) -> ctypes.CDLL:
    """The C file as a library, compiled without a warning."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler: apt-get install gcc")
    library = source.with_suffix(".so")
    command = [compiler, *FLAGS, "-O2", "-fPIC", "-shared", "-o", library, source, "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return ctypes.CDLL(str(library))


@dataclass
class Ours:
    """Our kernels for a vessel in a constant wind and current."""

    vessel: VesselParameters
    wind: Array
    current: Array

    def __post_init__(self) -> None:
        table = self.vessel.nominal()
        self.dofs, self.plant = table.dofs, table.plant_table()
        self.kinematics: Kinematics = kinematics_of(table.dofs, table.attitude)
        n = len(self.dofs)
        self.n, self.n_pose = n, len(state_of(self.kinematics, np.zeros(n)))
        self.weather = Weather(
            NONE, NONE, NONE, NONE, current_ned=self.current[None], wind_ned=self.wind[None]
        )
        self.work = scratch(len(self.plant.codes), n, self.n_pose)

    def rates(self, eta: Array, nu: Array, tau: Array) -> Array:
        """Rates of pose and velocity."""
        eta_dot, nu_dot = np.zeros(self.n_pose), np.zeros(self.n)
        rates(
            self.kinematics, self.plant, eta, nu, tau, self.weather, 0, self.work, eta_dot, nu_dot
        )
        return np.concatenate([eta_dot, nu_dot])

    def sail(self, commands: Array, step_s: float, parts: int = 1) -> Array:
        """Pose and velocity after each step, of `parts` parts, from rest; commands (N, n_dof)."""
        lag = lag_table(self.vessel.thruster, 0.5 * step_s / parts, len(self.dofs))
        eta = state_of(self.kinematics, np.zeros(self.n))
        nu, thrust = np.zeros(self.n), np.zeros((self.n, 2))
        track = np.empty((len(commands), self.n_pose + self.n))
        for k, command in enumerate(commands):
            advance(
                self.kinematics, self.plant, lag, thrust, command, eta, nu, self.weather, 0,
                step_s / parts, parts, self.work,
            )  # fmt: skip
            track[k] = [*eta, *nu]
        return track


class Theirs:
    """The exported functions for the same."""

    def __init__(self, source: Path, ours: Ours) -> None:
        self.library, self.name, self.ours = compiled(source), source.stem, ours
        lag = ours.vessel.thruster
        order = 0 if lag is None else 2 if np.isfinite(lag.damping) else 1
        self.size = ours.n_pose + ours.n * (1 + order)

    def _call(self, function: str, *arguments: Array | float) -> None:
        converted = [
            ctypes.c_double(item) if isinstance(item, float)
            else item.ctypes.data_as(ctypes.POINTER(ctypes.c_double))
            for item in arguments
        ]  # fmt: skip
        getattr(self.library, f"{self.name}_{function}")(*converted)

    def rates(self, state: Array, command: Array) -> Array:
        """Rate of the state."""
        rate = np.zeros(self.size)
        self._call("derivative", state, command, self.ours.wind, self.ours.current, rate)
        return rate

    def sail(self, commands: Array, step_s: float) -> Array:
        """Pose and velocity after each step from rest; commands (N, n_dof)."""
        n, state = self.ours.n, np.full(self.size, np.nan)
        self._call("start", state, np.zeros(n), np.zeros(n))
        track = np.empty((len(commands), self.ours.n_pose + n))
        for k, command in enumerate(commands):
            self._call("step", state, command, self.ours.wind, self.ours.current, step_s)
            track[k] = state[: track.shape[1]]
        return track

    def pose(self, state: Array) -> Array:
        """Pose of a state over the degrees of freedom."""
        pose = np.full(self.ours.n, np.nan)
        self._call("pose", state, pose)
        return pose


def relative(theirs: Array, ours: Array) -> float:
    """Largest difference of a column relative to its largest magnitude."""
    scale = np.max(np.abs(ours), axis=0)
    scale[scale == 0.0] = 1.0
    return float(np.max(np.abs(theirs - ours) / scale))
