"""From measured signals to signals that can be identified with."""

import numpy as np

from models.basis import Array


def central_difference(values: Array, period_s: float) -> Array:
    """d/dt along the first axis, [unit/s]; second order, also at the two ends.

    (x[k+1] - x[k-1]) / (2 h): no phase, gain sinc(2 f h). It commutes with every linear
    time-invariant filter, but for the ends.
    """
    if len(values) < 3:
        return np.asarray(np.gradient(values, period_s, axis=0))
    return np.asarray(np.gradient(values, period_s, axis=0, edge_order=2))


def without_sign_flips(quaternions: Array) -> Array:
    """The same rotations, shape (N, 4), with neighbours on the same side: q . q_next >= 0.

    q and -q are one rotation; a recorder that changes the sign at 180 degrees puts spikes into
    derivatives and wrong values between samples. Hoyer (2021), section 5.4.3.
    """
    products = np.sum(quaternions[1:] * quaternions[:-1], axis=1)
    signs = np.cumprod(np.concatenate([[1.0], np.where(products < 0.0, -1.0, 1.0)]))
    return np.asarray(quaternions * signs[:, None])


def euler_zyx(quaternions: Array) -> Array:
    """(phi, theta, psi) [rad], shape (N, 3), from unit quaternions (w, x, y, z), shape (N, 4).

    R = R_z(psi) R_y(theta) R_x(phi), Fossen (2011), section 2.2; psi in (-pi, pi].
    """
    w, x, y, z = quaternions.T
    phi = np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y))
    theta = np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0))
    psi = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return np.column_stack([phi, theta, psi])
