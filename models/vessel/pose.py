"""The pose as a state of the integration, for each kind of kinematics.

`Axes`, `Planar`, `Rolling`, `Quaternion` and `Euler` name the kinematics J of
eta_dot = J(eta) nu. A kernel is compiled for one of these types, without the code of the others.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba.extending import overload

from seatrial.models.compiled import LEAN, lean_kernel, tuple_of
from seatrial.models.notation import DOFS, PLANAR, ROLLING
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import (
    angles_of_frame_kernel,
    frame_of_quaternion_kernel,
    half_turns_kernel,
    quaternion_of,
    rotation_between,
    turn_between,
)

OF_AXES = ("surge", "sway", "roll", "pitch", "yaw")


class Axes(NamedTuple):
    """Every velocity is integrated along its own axis; other angles stay level and north.

    Each field is an index into the degrees of freedom, -1 if the vessel does not have that one.
    """

    north: int
    east: int
    roll: int
    pitch: int
    yaw: int


class Planar(NamedTuple):
    """Surge, sway and yaw; the pose is (x, y, psi) in NED."""

    heading: int = 2


class Rolling(NamedTuple):
    """Surge, sway, roll and yaw; the state is (x, y) in NED, phi and psi."""

    roll: int = 2
    yaw: int = 3


class Quaternion(NamedTuple):
    """Six degrees of freedom; the state is (x, y, z) in NED and a unit quaternion."""

    first: int = 3


class Euler(NamedTuple):
    """Six degrees of freedom; the state is (x, y, z, phi, theta, psi), singular at 90 degrees."""

    first: int = 3


Kinematics = Axes | Planar | Rolling | Quaternion | Euler


def kinematics_of(dofs: tuple[str, ...], attitude: str = "quaternion") -> Kinematics:
    """The kinematics of a vessel; `attitude` (quaternion, euler) is for six degrees of freedom."""
    if dofs == PLANAR:
        return Planar()
    if dofs == ROLLING:
        return Rolling()
    if dofs == DOFS:
        return Quaternion() if attitude == "quaternion" else Euler()
    indices = (dofs.index(dof) if dof in dofs else -1 for dof in OF_AXES)
    return Axes(*indices)


def state_of(kinematics: Kinematics, pose: Array) -> Array:
    """The integrated state (..., n_pose) of poses over the degrees of freedom, (..., n_dof)."""
    if isinstance(kinematics, Quaternion):
        quaternion = np.moveaxis(quaternion_of(np.moveaxis(pose[..., 3:], -1, 0)), 0, -1)
        return np.concatenate([pose[..., :3], quaternion], axis=-1)
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
    Axes: _copy_pose, Planar: _copy_pose, Rolling: _copy_pose, Euler: _copy_pose,
    Quaternion: _quaternion_pose,
}  # fmt: skip


def pose_of(kinematics: Kinematics, eta: Array, frame: Array, pose: Array) -> None:
    """Write the pose (n_dof,) [m, rad] of a state (n_pose,).

    Angles are unwrapped to the turn nearest to the previous content of `pose`.
    """
    POSES[type(kinematics)](kinematics, eta, frame, pose)


@overload(pose_of, jit_options=LEAN)
def _pose_of(kinematics: Kinematics, eta: Array, frame: Array, pose: Array) -> Callable[..., None]:
    step = POSES[tuple_of(kinematics)]

    def kernel(kinematics: Kinematics, eta: Array, frame: Array, pose: Array) -> None:
        step(kinematics, eta, frame, pose)

    return kernel


@lean_kernel
def _no_change(kinematics: Kinematics, eta: Array) -> None:
    pass


@lean_kernel
def _to_unit(kinematics: Quaternion, eta: Array) -> None:
    size = np.sqrt(eta[3] * eta[3] + eta[4] * eta[4] + eta[5] * eta[5] + eta[6] * eta[6])
    for i in range(3, 7):
        eta[i] /= size


NORMS: dict[type, Callable[..., None]] = {
    Axes: _no_change, Planar: _no_change, Rolling: _no_change, Euler: _no_change,
    Quaternion: _to_unit,
}  # fmt: skip


def normalise(kinematics: Kinematics, eta: Array) -> None:
    """Scale the quaternion of a state, if it has one, to unit length."""
    NORMS[type(kinematics)](kinematics, eta)


@overload(normalise, jit_options=LEAN)
def _normalise(kinematics: Kinematics, eta: Array) -> Callable[..., None]:
    step = NORMS[tuple_of(kinematics)]

    def kernel(kinematics: Kinematics, eta: Array) -> None:
        step(kinematics, eta)

    return kernel


@lean_kernel
def _along_axes(axes: Axes, first: Array, second: Array, e: Array) -> None:
    for i in range(e.shape[0]):
        e[i] = second[i] - first[i]
    for i in (axes.roll, axes.pitch, axes.yaw):
        if i >= 0:
            e[i] = turn_between(first[i], second[i])


@lean_kernel
def _in_plane(planar: Planar, first: Array, second: Array, e: Array) -> None:
    e[0], e[1] = second[0] - first[0], second[1] - first[1]
    e[2] = turn_between(first[2], second[2])


@lean_kernel
def _with_roll(rolling: Rolling, first: Array, second: Array, e: Array) -> None:
    e[0], e[1] = second[0] - first[0], second[1] - first[1]
    e[2], e[3] = turn_between(first[2], second[2]), turn_between(first[3], second[3])


@lean_kernel
def _of_quaternions(kinematics: Quaternion, first: Array, second: Array, e: Array) -> None:
    for i in range(3):
        e[i] = second[i] - first[i]
    rotation_between(
        (first[3], first[4], first[5], first[6]),
        (second[3], second[4], second[5], second[6]),
        e[3:],
    )


@lean_kernel
def _of_angles(kinematics: Euler, first: Array, second: Array, e: Array) -> None:
    for i in range(3):
        e[i] = second[i] - first[i]
    rotation_between(
        half_turns_kernel(first[3], first[4], first[5]),
        half_turns_kernel(second[3], second[4], second[5]),
        e[3:],
    )


DEVIATIONS: dict[type, Callable[..., None]] = {
    Axes: _along_axes, Planar: _in_plane, Rolling: _with_roll, Euler: _of_angles,
    Quaternion: _of_quaternions,
}  # fmt: skip


def deviation(kinematics: Kinematics, first: Array, second: Array, e: Array) -> None:
    """Write the deviation e (n_dof,) [m, rad] of the second state of the pose from the first.

    It is the difference in NED for positions, the rotation vector of R_1' R_2 for an attitude in
    three angles, and the difference within half a turn for a single angle.
    """
    DEVIATIONS[type(kinematics)](kinematics, first, second, e)


@overload(deviation, jit_options=LEAN)
def _deviation(
    kinematics: Kinematics, first: Array, second: Array, e: Array
) -> Callable[..., None]:
    step = DEVIATIONS[tuple_of(kinematics)]

    def kernel(kinematics: Kinematics, first: Array, second: Array, e: Array) -> None:
        step(kinematics, first, second, e)

    return kernel


def displaced(kinematics: Kinematics, states: Array, offsets: Array) -> Array:
    """States (n, n_pose) displaced by offsets (n, n_dof); quaternions by rotation vectors [rad]."""
    if not isinstance(kinematics, Quaternion):
        return np.asarray(states + offsets)
    n, x, y, z = states[:, 3:].T
    angle = np.linalg.norm(offsets[:, 3:], axis=1)
    a, b, c = (0.5 * np.sinc(angle / (2.0 * np.pi))[:, None] * offsets[:, 3:]).T
    m = np.cos(0.5 * angle)
    rotated = [
        n * m - x * a - y * b - z * c,
        n * a + x * m + y * c - z * b,
        n * b - x * c + y * m + z * a,
        n * c + x * b - y * a + z * m,
    ]
    return np.column_stack([states[:, :3] + offsets[:, :3], *rotated])
