"""Frames, rotations, Jacobians, cross products and angle wrapping.

NED is the local north-east-down frame; body axes point forward, to starboard and down. In six
degrees of freedom the attitude is (phi, theta, psi), applied in the order zyx, or the unit
quaternion (eta, eps_1, eps_2, eps_3) of the rotation from body to NED; Fossen (2011), chapter 2.
"""

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from seatrial.models.compiled import lean_kernel
from seatrial.models.elementary import where
from seatrial.models.vessel.basis import ATTITUDE, INDEX, N_VARIABLES, Array

FIRST_ANGLE = INDEX[ATTITUDE[0]]
SMALL = 1e-12
TURN = 2.0 * np.pi
SPATIAL = 6  # degrees of freedom with an attitude
Angle = TypeVar("Angle", float, Array)


def wrap(angle: Angle) -> Angle:
    """Wrap an angle [rad], a number or an array, to (-pi, pi]."""
    return np.pi - (np.pi - angle) % (2.0 * np.pi)


wrap_kernel = lean_kernel(wrap)


def unroll(headings: Array) -> Array:
    """Unwrap headings [rad] along the first axis."""
    return np.asarray(np.unwrap(headings, axis=0), dtype=np.float64)


def cross_matrix(a: Sequence[float] | Array) -> Array:
    """S(a) with S(a) b = a x b, shape (3, 3)."""
    x, y, z = a
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def in_ned(body: Array, psi: float | Array) -> Array:
    """Rotate horizontal vectors (..., 2) from body axes at headings `psi` [rad] to NED."""
    c, s = np.cos(psi), np.sin(psi)
    ahead, aside = body[..., 0], body[..., 1]
    return np.stack([c * ahead - s * aside, s * ahead + c * aside], axis=-1)


def in_body(ned: Array, psi: float | Array) -> Array:
    """Rotate horizontal vectors (..., 2) from NED to body axes at headings `psi` [rad]."""
    return in_ned(ned, -psi)


def half_turns(phi: float, theta: float, psi: float) -> tuple[float, float, float, float]:
    """Unit quaternion (eta, eps_1, eps_2, eps_3) of the attitude (phi, theta, psi) [rad]."""
    cx, sx = np.cos(0.5 * phi), np.sin(0.5 * phi)
    cy, sy = np.cos(0.5 * theta), np.sin(0.5 * theta)
    cz, sz = np.cos(0.5 * psi), np.sin(0.5 * psi)
    return (
        cx * cy * cz + sx * sy * sz,
        sx * cy * cz - cx * sy * sz,
        cx * sy * cz + sx * cy * sz,
        cx * cy * sz - sx * sy * cz,
    )


half_turns_kernel = lean_kernel(half_turns)


def quaternion_of(angles: Array) -> Array:
    """Unit quaternion of (phi, theta, psi) [rad], shape (3, ...) to (4, ...)."""
    return np.array(half_turns(*angles))


def frame_of_quaternion(q: Array, frame: Array) -> None:
    """Write the rotation from body to NED of a quaternion (4,) to frame (3, 3). Hoyer, eq. (2.3).

    N quaternions (4, N) are written to frame (3, 3, N).
    """
    n, x, y, z = q[0], q[1], q[2], q[3]
    frame[0, 0], frame[1, 1] = 1.0 - 2.0 * (y * y + z * z), 1.0 - 2.0 * (x * x + z * z)
    frame[2, 2] = 1.0 - 2.0 * (x * x + y * y)
    frame[0, 1], frame[1, 0] = 2.0 * (x * y - z * n), 2.0 * (x * y + z * n)
    frame[0, 2], frame[2, 0] = 2.0 * (x * z + y * n), 2.0 * (x * z - y * n)
    frame[1, 2], frame[2, 1] = 2.0 * (y * z - x * n), 2.0 * (y * z + x * n)


def frame_of_angles(angles: Array, frame: Array) -> None:
    """Write the rotation from body to NED of (phi, theta, psi) [rad] to frame (3, 3).

    N attitudes (3, N) are written to frame (3, 3, N).
    """
    cx, sx = np.cos(angles[0]), np.sin(angles[0])
    cy, sy = np.cos(angles[1]), np.sin(angles[1])
    cz, sz = np.cos(angles[2]), np.sin(angles[2])
    frame[0, 0], frame[1, 0], frame[2, 0] = cz * cy, sz * cy, -sy
    frame[0, 1], frame[0, 2] = cz * sy * sx - sz * cx, sz * sx + cz * cx * sy
    frame[1, 1], frame[1, 2] = cz * cx + sx * sy * sz, sy * sz * cx - cz * sx
    frame[2, 1], frame[2, 2] = cy * sx, cy * cx


def angles_of_frame(frame: Array, angles: Array) -> None:
    """Write (phi, theta, psi) [rad] of a rotation (3, 3), unwrapped to the turn nearest `angles`.

    At a pitch of +-90 degrees only a combination of phi and psi is determined; phi is not changed.
    """
    level = np.sqrt(frame[2, 1] * frame[2, 1] + frame[2, 2] * frame[2, 2])
    roll = angles[0]
    if level > SMALL:
        roll = np.arctan2(frame[2, 1], frame[2, 2])
        yaw = np.arctan2(frame[1, 0], frame[0, 0])
    else:
        c, s = np.cos(roll), np.sin(roll)
        yaw = np.arctan2(s * frame[0, 2] - c * frame[0, 1], c * frame[1, 1] - s * frame[1, 2])
    angles[0] += wrap_kernel(roll - angles[0])
    angles[2] += wrap_kernel(yaw - angles[2])
    angles[1] = np.arctan2(-frame[2, 0], level)


def fill_attitude(z: Array, frame: Array) -> None:
    """Write cosines and sines of the attitude, and their magnitudes, into z = [x, |x|].

    They follow from the rotation (3, 3) without its angles, so products such as
    cos(theta) sin(phi) are correct at every attitude.
    """
    level = np.sqrt(frame[2, 1] * frame[2, 1] + frame[2, 2] * frame[2, 2])
    vertical = level <= SMALL
    inverse = 1.0 / where(vertical, SMALL, level)
    at = FIRST_ANGLE
    z[at] = where(vertical, 1.0, frame[2, 2] * inverse)
    z[at + 1] = where(vertical, 0.0, frame[2, 1] * inverse)
    z[at + 2], z[at + 3] = level, -frame[2, 0]
    z[at + 4] = where(vertical, frame[1, 1], frame[0, 0] * inverse)
    z[at + 5] = where(vertical, -frame[0, 1], frame[1, 0] * inverse)
    for i in range(at, at + 6):
        z[N_VARIABLES + i] = abs(z[i])


def quaternion_rate(q: Array, p: float, q_rate: float, r: float, rate: Array) -> None:
    """q_dot = T_q(q) omega, written to rate (4,). Hoyer (2021), eqs. (2.2)-(2.3)."""
    n, x, y, z = q[0], q[1], q[2], q[3]
    rate[0] = -0.5 * (x * p + y * q_rate + z * r)
    rate[1] = 0.5 * (n * p - z * q_rate + y * r)
    rate[2] = 0.5 * (z * p + n * q_rate - x * r)
    rate[3] = 0.5 * (x * q_rate - y * p + n * r)


def angle_rate(angles: Array, p: float, q: float, r: float, rate: Array) -> None:
    """Write (phi, theta, psi)_dot = T(phi, theta) omega, (3,); singular at theta = 90 degrees."""
    c, s = np.cos(angles[0]), np.sin(angles[0])
    yaw_rate = (s * q + c * r) / np.cos(angles[1])
    rate[0] = p + np.sin(angles[1]) * yaw_rate
    rate[1] = c * q - s * r
    rate[2] = yaw_rate


def pose_jacobian(angles: Array) -> Array:
    """J of eta_dot = J(eta) nu, shape (N, 6, 6), from (phi, theta, psi) [rad], shape (N, 3).

    J = diag(R, T), Fossen (2011), eqs. (2.18) and (2.28); T is singular at theta = +-90 deg.
    """
    jacobian = np.zeros((6, 6, len(angles)))
    frame_of_angles(angles.T, jacobian[:3, :3])
    (c, cy, _), (s, sy, _) = np.cos(angles).T, np.sin(angles).T
    cy = np.where(np.abs(cy) < 1e-6, 1e-6, cy)
    t, k = sy / cy, 1.0 / cy
    jacobian[3, 3] = 1.0
    jacobian[3, 4], jacobian[3, 5] = s * t, c * t
    jacobian[4, 4], jacobian[4, 5] = c, -s
    jacobian[5, 4], jacobian[5, 5] = s * k, c * k
    return np.moveaxis(jacobian, -1, 0)


def euler_zyx(quaternions: Array) -> Array:
    """(phi, theta, psi) [rad], shape (N, 3), from quaternions (w, x, y, z) of any length, (N, 4).

    R = R_z(psi) R_y(theta) R_x(phi), Fossen (2011), section 2.2; psi in (-pi, pi].
    """
    frame = np.empty((3, 3, len(quaternions)))
    frame_of_quaternion((quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T, frame)
    phi = np.arctan2(frame[2, 1], frame[2, 2])
    theta = np.arcsin(np.clip(-frame[2, 0], -1.0, 1.0))
    return np.column_stack([phi, theta, np.arctan2(frame[1, 0], frame[0, 0])])


def turned(attitude: Array) -> Array:
    """Rotation about the body axes since the first sample [rad], shape (N, 3).

    The rotation vectors from each attitude (phi, theta, psi) [rad], shape (N, 3), to the next one
    are summed. Its derivative is (p, q, r) to second order, at every pitch and however the angles
    jump; of a planar motion it is the heading, unrolled, less the first one.

    Source: the logarithm of conj(q_k) q_k+1, Sola (2017), Quaternion kinematics, section 2.4.
    """
    q = quaternion_of(attitude.T).T
    (a, u), (b, v) = ((part[:, :1], part[:, 1:]) for part in (q[:-1], q[1:]))
    turn = a * v - b * u - np.cross(u, v)
    cosine = a * b + np.sum(u * v, axis=1, keepdims=True)
    size = np.linalg.norm(turn, axis=1, keepdims=True)
    angle = 2.0 * np.arctan2(size, np.abs(cosine)) * np.where(cosine < 0.0, -1.0, 1.0)  # q is -q
    turn *= np.divide(angle, size, out=np.zeros_like(size), where=size > 0.0)
    return np.concatenate([np.zeros((1, 3)), np.cumsum(turn, axis=0)])


def body_rates(attitude: Array, period_s: float, starts: NDArray[np.bool_] | None = None) -> Array:
    """(p, q, r) [rad/s], shape (N, 3), by central differences of the rotation of an attitude.

    Args:
        attitude: (phi, theta, psi) [rad], shape (N, 3), which may jump.
        period_s: sample time [s].
        starts: true (N,) at the first sample of each piece; no difference is taken across it.
    """
    cuts = () if starts is None else np.flatnonzero(starts[1:]) + 1
    return np.concatenate(
        [
            np.gradient(turned(piece), period_s, axis=0, edge_order=2 if len(piece) > 2 else 1)
            if len(piece) > 1
            else np.zeros((len(piece), 3))
            for piece in np.split(attitude, cuts)
        ]
    )


frame_of_quaternion_kernel = lean_kernel(frame_of_quaternion)
frame_of_angles_kernel = lean_kernel(frame_of_angles)
angles_of_frame_kernel = lean_kernel(angles_of_frame)
fill_attitude_kernel = lean_kernel(fill_attitude)
quaternion_rate_kernel = lean_kernel(quaternion_rate)
angle_rate_kernel = lean_kernel(angle_rate)


@lean_kernel
def _to_body(
    cx: float, sx: float, cy: float, sy: float, cz: float, sz: float, ned: Array, body: Array
) -> None:
    """Write R' times a vector in NED (3,), from the cosines and sines of phi, theta and psi."""
    x, y, z = ned[0], ned[1], ned[2]
    body[0] = cz * cy * x + sz * cy * y - sy * z
    body[1] = (cz * sy * sx - sz * cx) * x + (cz * cx + sx * sy * sz) * y + cy * sx * z
    body[2] = (sz * sx + cz * cx * sy) * x + (sy * sz * cx - cz * sx) * y + cy * cx * z


def spatial_reference(filtered: Array, nu_d: Array, nu_dot_d: Array) -> None:
    """Write body velocity and acceleration (6,) of a reference in six degrees of freedom.

    `filtered` (6, 3) holds (x, y, z, phi, theta, psi) with first and second derivative.
    v = R' p_dot, v_dot = R' p_ddot - omega x v; omega = T^-1 Theta_dot, and its derivative.
    """
    cx, sx = np.cos(filtered[3, 0]), np.sin(filtered[3, 0])
    cy, sy = np.cos(filtered[4, 0]), np.sin(filtered[4, 0])
    cz, sz = np.cos(filtered[5, 0]), np.sin(filtered[5, 0])
    roll, pitch, yaw = filtered[3, 1], filtered[4, 1], filtered[5, 1]
    p, q, r = roll - sy * yaw, cx * pitch + sx * cy * yaw, cx * cy * yaw - sx * pitch
    nu_d[3], nu_d[4], nu_d[5] = p, q, r
    nu_dot_d[3] = filtered[3, 2] - sy * filtered[5, 2] - cy * pitch * yaw
    nu_dot_d[4] = cx * filtered[4, 2] + sx * cy * filtered[5, 2] + roll * r - sx * sy * pitch * yaw
    nu_dot_d[5] = cx * cy * filtered[5, 2] - sx * filtered[4, 2] - roll * q - cx * sy * pitch * yaw
    _to_body(cx, sx, cy, sy, cz, sz, filtered[:3, 1], nu_d)
    _to_body(cx, sx, cy, sy, cz, sz, filtered[:3, 2], nu_dot_d)
    u, v, w = nu_d[0], nu_d[1], nu_d[2]
    nu_dot_d[0] -= q * w - r * v
    nu_dot_d[1] -= r * u - p * w
    nu_dot_d[2] -= p * v - q * u


spatial_reference_kernel = lean_kernel(spatial_reference)


def spatial_error(eta_d: Array, eta: Array, e: Array) -> None:
    """Write the position error in body axes and twice the vector part of the quaternion error.

    e = [R' (p_d - p), 2 sgn(eta_e) eps_e], shape (6,), with q_e = conj(q) q_d. For a small
    attitude error the second part is the rotation vector [rad].
    """
    cx, sx, cy, sy = np.cos(eta[3]), np.sin(eta[3]), np.cos(eta[4]), np.sin(eta[4])
    for i in range(3):
        e[i] = eta_d[i] - eta[i]
    _to_body(cx, sx, cy, sy, np.cos(eta[5]), np.sin(eta[5]), e, e)
    n, x, y, z = half_turns_kernel(eta[3], eta[4], eta[5])
    n_d, x_d, y_d, z_d = half_turns_kernel(eta_d[3], eta_d[4], eta_d[5])
    sign = 2.0 if n * n_d + x * x_d + y * y_d + z * z_d >= 0.0 else -2.0
    e[3] = sign * (n * x_d - x * n_d - y * z_d + z * y_d)
    e[4] = sign * (n * y_d - y * n_d - z * x_d + x * z_d)
    e[5] = sign * (n * z_d - z * n_d - x * y_d + y * x_d)


spatial_error_kernel = lean_kernel(spatial_error)


@lean_kernel
def turn_between(first: float, second: float) -> float:
    """Difference `second` - `first` of two angles [rad], in [-pi, pi)."""
    angle = second - first
    return angle - TURN * np.floor((angle + np.pi) / TURN)  # type: ignore[no-any-return]


def fill_angles(z: Array, angles: Array) -> None:
    """Write cosines and sines of (phi, theta, psi), and their magnitudes, into z = [x, |x|]."""
    for i in range(3):
        at = FIRST_ANGLE + 2 * i
        z[at], z[at + 1] = np.cos(angles[i]), np.sin(angles[i])
        z[N_VARIABLES + at], z[N_VARIABLES + at + 1] = abs(z[at]), abs(z[at + 1])


@lean_kernel
def rotation_between(
    first: tuple[float, float, float, float],
    second: tuple[float, float, float, float],
    vector: Array,
) -> None:
    """Write the rotation vector (3,) of R_1' R_2 [rad] for two unit quaternions.

    Its direction is the axis, in body axes, of the rotation from the first attitude to the second;
    its length is the angle, at most pi.
    """
    n, x, y, z = first
    n_2, x_2, y_2, z_2 = second
    cosine = n * n_2 + x * x_2 + y * y_2 + z * z_2  # of half the angle
    vector[0] = n * x_2 - x * n_2 - y * z_2 + z * y_2
    vector[1] = n * y_2 - y * n_2 - z * x_2 + x * z_2
    vector[2] = n * z_2 - z * n_2 - x * y_2 + y * x_2
    sine = np.sqrt(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2])
    angle = 2.0 * np.arctan2(sine, abs(cosine))
    scale = where(sine > 0.0, angle / where(sine > 0.0, sine, 1.0), 2.0)
    scale = where(cosine < 0.0, -scale, scale)
    for i in range(3):
        vector[i] *= scale


fill_angles_kernel = lean_kernel(fill_angles)


def reference_in_body(
    planar: bool, filtered: Array, eta_d: Array, nu_d: Array, nu_dot_d: Array
) -> None:
    """Write desired pose, body velocity and acceleration (n_dof,) from the filter state (n_dof, 3).

    For a planar vessel nu_d = R(psi_d)' eta_d_dot, and its derivative; six degrees of freedom are
    treated likewise. For any other vessel the axes are independent.
    """
    for i in range(eta_d.shape[0]):
        eta_d[i], nu_d[i], nu_dot_d[i] = filtered[i, 0], filtered[i, 1], filtered[i, 2]
    if eta_d.shape[0] == SPATIAL:
        spatial_reference_kernel(filtered, nu_d, nu_dot_d)
    if not planar:
        return
    c, s = np.cos(filtered[2, 0]), np.sin(filtered[2, 0])
    r = filtered[2, 1]
    nu_d[0] = c * filtered[0, 1] + s * filtered[1, 1]
    nu_d[1] = c * filtered[1, 1] - s * filtered[0, 1]
    nu_d[2] = r
    nu_dot_d[0] = c * filtered[0, 2] + s * filtered[1, 2] + r * nu_d[1]
    nu_dot_d[1] = c * filtered[1, 2] - s * filtered[0, 2] - r * nu_d[0]
    nu_dot_d[2] = filtered[2, 2]


reference_in_body_kernel = lean_kernel(reference_in_body)
