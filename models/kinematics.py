"""Frames, rotations and angle wrapping.

NED is the local north-east-down frame; body axes point forward, to starboard and down.
"""

import numpy as np

from models.basis import Array
from models.compiled import lean_kernel


def rotation(psi: float) -> Array:
    """Body to NED rotation about the down axis, shape (3, 3); psi [rad]. Jervan, eq. (2.2)."""
    c, s = np.cos(psi), np.sin(psi)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def wrap(angle: float) -> float:
    """The same angle in (-pi, pi]; [rad]."""
    return float(np.pi - (np.pi - angle) % (2.0 * np.pi))


def unroll(headings: Array) -> Array:
    """Headings without jumps of a full turn along the first axis; [rad]."""
    return np.asarray(np.unwrap(headings, axis=0), dtype=np.float64)


def in_body(ned: Array, psi: Array) -> Array:
    """Horizontal vectors (north, east), shape (N, 2), seen from body axes at headings (N,)."""
    c, s = np.cos(psi), np.sin(psi)
    return np.stack([c * ned[:, 0] + s * ned[:, 1], c * ned[:, 1] - s * ned[:, 0]], axis=1)


def through_water(nu_dot: Array, nu: Array, psi: Array, current_ned: Array) -> tuple[Array, Array]:
    """Acceleration and velocity through a stream that is constant in NED, planar, shape (N, 3).

    nu_r = nu - nu_c and nu_r_dot = nu_dot + S(omega) nu_c; current_ned [m/s], shape (N, 2).
    """
    stream = in_body(current_ned, psi)
    nu_r, nu_r_dot = nu.copy(), nu_dot.copy()
    nu_r[:, :2] -= stream
    nu_r_dot[:, 0] -= nu[:, 2] * stream[:, 1]
    nu_r_dot[:, 1] += nu[:, 2] * stream[:, 0]
    return nu_r_dot, nu_r


def body_velocity(eta_dot: Array, psi: float) -> Array:
    """nu = R(psi)' eta_dot for planar motion; eta_dot NED [m/s, m/s, rad/s], shape (3,)."""
    return np.asarray(rotation(psi).T @ eta_dot, dtype=np.float64)


def body_acceleration(eta_dot: Array, eta_ddot: Array, psi: float) -> Array:
    """nu_dot = R' eta_ddot - r S R' eta_dot, the time derivative of `body_velocity`; shape (3,)."""
    nu = body_velocity(eta_dot, psi)
    turning = np.array([-nu[1], nu[0], 0.0]) * nu[2]
    return np.asarray(rotation(psi).T @ eta_ddot - turning, dtype=np.float64)


def reference_in_body(
    planar: bool, filtered: Array, eta_d: Array, nu_d: Array, nu_dot_d: Array
) -> None:
    """Desired pose, body velocity and acceleration from the filter state (n_dof, 3).

    Planar: nu_d = R(psi_d)' eta_d_dot, and its derivative. Otherwise each axis stands alone.
    """
    for i in range(eta_d.shape[0]):
        eta_d[i], nu_d[i], nu_dot_d[i] = filtered[i, 0], filtered[i, 1], filtered[i, 2]
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
