"""The pose as it is integrated, by the kinematics of the vessel.

`Axes`, `Planar`, `Quaternion` and `Euler` name the kinematics J of eta_dot = J(eta) nu; a kernel
is compiled for the type of the one that it is given, without the others.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba.extending import overload

from seatrial.models.compiled import LEAN, lean_kernel, tuple_of
from seatrial.models.notation import DOFS
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import (
    angles_of_frame_kernel,
    frame_of_quaternion_kernel,
    quaternion_of,
)
from seatrial.models.vessel.table import PLANAR


class Axes(NamedTuple):
    """Every velocity is integrated along its own axis, the vessel level and heading north."""

    north: int  # the degree of freedom along north and the one along east; -1 is none
    east: int


class Planar(NamedTuple):
    """Surge, sway and yaw; the pose is (x, y, psi) in NED."""

    heading: int = 2


class Quaternion(NamedTuple):
    """Six degrees of freedom; the state is (x, y, z) in NED and a unit quaternion."""

    first: int = 3


class Euler(NamedTuple):
    """Six degrees of freedom; the state is (x, y, z, phi, theta, psi), singular at 90 degrees."""

    first: int = 3


Kinematics = Axes | Planar | Quaternion | Euler


def kinematics_of(dofs: tuple[str, ...], attitude: str | None = None) -> Kinematics:
    """The kinematics of a vessel; `attitude` (quaternion, euler) is of six degrees of freedom."""
    if dofs == PLANAR:
        return Planar()
    if dofs == DOFS and attitude is not None:
        return Quaternion() if attitude == "quaternion" else Euler()
    return Axes(*(dofs.index(dof) if dof in dofs else -1 for dof in ("surge", "sway")))


def state_of(kinematics: Kinematics, pose: Array) -> Array:
    """The state that is integrated, of a pose over the degrees of freedom."""
    if isinstance(kinematics, Quaternion):
        return np.concatenate([pose[:3], quaternion_of(pose[3:])])
    return np.array(pose, dtype=np.float64)


@lean_kernel
def _copy_pose(kinematics: Kinematics, eta: Array, frame: Array, pose: Array) -> None:
    for i in range(pose.shape[0]):
        pose[i] = eta[i]


@lean_kernel
def _quaternion_pose(kinematics: Quaternion, eta: Array, frame: Array, pose: Array) -> None:
    for i in range(3):
        pose[i] = eta[i]
    frame_of_quaternion_kernel(eta[3:], frame)
    angles_of_frame_kernel(frame, pose[3:])


POSES: dict[type, Callable[..., None]] = {
    Axes: _copy_pose, Planar: _copy_pose, Euler: _copy_pose, Quaternion: _quaternion_pose,
}  # fmt: skip


def pose_of(kinematics: Kinematics, eta: Array, frame: Array, pose: Array) -> None:
    """Write the pose over the degrees of freedom of a state.

    Angles become the turns that are nearest to those that stand in `pose` before.
    """
    POSES[type(kinematics)](kinematics, eta, frame, pose)


@overload(pose_of, jit_options=LEAN)
def _pose_of(kinematics: Kinematics, eta: Array, frame: Array, pose: Array) -> Callable[..., None]:
    step = POSES[tuple_of(kinematics)]

    def chosen(kinematics: Kinematics, eta: Array, frame: Array, pose: Array) -> None:
        step(kinematics, eta, frame, pose)

    return chosen


@lean_kernel
def _leave(kinematics: Kinematics, eta: Array) -> None:
    pass


@lean_kernel
def _to_unit(kinematics: Quaternion, eta: Array) -> None:
    size = np.sqrt(eta[3] * eta[3] + eta[4] * eta[4] + eta[5] * eta[5] + eta[6] * eta[6])
    for i in range(3, 7):
        eta[i] /= size


NORMS: dict[type, Callable[..., None]] = {
    Axes: _leave, Planar: _leave, Euler: _leave, Quaternion: _to_unit,
}  # fmt: skip


def normalise(kinematics: Kinematics, eta: Array) -> None:
    """Give the quaternion of a state, where it has one, its length of one."""
    NORMS[type(kinematics)](kinematics, eta)


@overload(normalise, jit_options=LEAN)
def _normalise(kinematics: Kinematics, eta: Array) -> Callable[..., None]:
    step = NORMS[tuple_of(kinematics)]

    def chosen(kinematics: Kinematics, eta: Array) -> None:
        step(kinematics, eta)

    return chosen
