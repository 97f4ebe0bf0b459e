"""A model in C, compiled and called, and our own kernels on the same vessel."""

import ctypes
import shutil
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io

from seatrial.models.simulation.dynamics import advance, rates, scratch
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.parameters import VesselParameters
from seatrial.models.vessel.pose import Kinematics, kinematics_of, state_of
from seatrial.models.vessel.thruster import LagTable, input_lag, lag_table
from seatrial.models.weather.weather import Weather

FLAGS = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic")
NONE = np.zeros((0, 0))
WIND, CURRENT = np.array([4.0, -7.0]), np.array([0.1, 0.2])


def octave(program: str, folder: Path, given: Mapping[str, Any]) -> dict[str, Any]:
    """What a program of Octave saves in `answer.mat`, of what it is given in `given.mat`."""
    found = shutil.which("octave-cli")
    if found is None:
        pytest.skip("no Octave: apt-get install octave")
    scipy.io.savemat(folder / "given.mat", given)
    done = subprocess.run(
        [found, "--quiet", "--no-init-file", "--eval", program],
        cwd=folder, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    answer: dict[str, Any] = scipy.io.loadmat(folder / "answer.mat", simplify_cells=True)
    return answer


def compiled(*sources: Path) -> ctypes.CDLL:
    """The C files as a library, compiled without a warning."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler: apt-get install gcc")
    library = sources[0].with_suffix(".so")
    command = [compiler, *FLAGS, "-O1", "-fPIC", "-shared", "-o", library, *sources, "-lm"]
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
        n, inputs = len(self.dofs), self.vessel.inputs
        self.commands = len(inputs) or n
        self.start = np.array(self.vessel.input_start or (0.0,) * n)
        self.nu_start = np.zeros(n)
        if inputs and "surge" in self.dofs:
            self.nu_start[self.dofs.index("surge")] = self.vessel.approach_speed_m_s
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

    def lag(self, step_s: float) -> LagTable:
        """The lag and limits of the forces, or of the inputs, for a step."""
        if self.vessel.inputs:
            return input_lag([*self.vessel.inputs.values()], step_s)
        return lag_table(self.vessel.thruster, step_s, self.n)

    def sail(self, commands: Array, step_s: float, parts: int = 1) -> Array:
        """Pose and velocity after each step, of `parts` parts, from the start; commands (N, n).

        `acting` (N, 3, n) is then what acted at the start, in the middle and at the end of the
        (last part of the) steps.
        """
        lag, eta = self.lag(0.5 * step_s / parts), state_of(self.kinematics, np.zeros(self.n))
        nu, thrust = self.nu_start.copy(), np.zeros((self.commands, 2))
        thrust[:, 0] = self.start
        self.acting = np.empty((len(commands), 3, self.commands))
        track = np.empty((len(commands), self.n_pose + self.n))
        for k, command in enumerate(commands):
            advance(
                self.kinematics, self.plant, lag, thrust, command, eta, nu, self.weather, 0,
                step_s / parts, parts, self.work,
            )  # fmt: skip
            track[k] = [*eta, *nu]
            self.acting[k] = self.work.acting[:, : self.commands]
        return track

    def random_commands(self, steps: int, share: float = 0.3) -> Array:
        """Commands (steps, n), each held for 50 steps, within a share of the limits."""
        low, high = np.array(self.vessel.input_low), np.array(self.vessel.input_high)
        if not self.vessel.inputs:
            high = np.array([self.vessel.limits_by_dof[dof] for dof in self.dofs])
            low = -high
        drawn = np.random.default_rng(1).uniform(low, high, size=(steps // 50, self.commands))
        return np.repeat(self.start + share * (drawn - self.start), 50, axis=0)


class Theirs:
    """The exported functions for the same."""

    def __init__(self, library: ctypes.CDLL, name: str, ours: Ours) -> None:
        self.library, self.name, self.ours = library, name, ours
        lag = ours.vessel.thruster
        order = 0 if lag is None else 2 if np.isfinite(lag.damping) else 1
        order = 1 if ours.vessel.inputs else order
        self.size = ours.n_pose + ours.n + ours.commands * order

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
        """Pose and velocity after each step from the start; commands (N, n)."""
        n, state = self.ours.n, np.full(self.size, np.nan)
        self._call("start", state, np.zeros(n), self.ours.nu_start)
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
