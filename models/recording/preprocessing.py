"""Preprocessing of measured signals; outliers by Jervan (2020), section 5.2.

All functions are pure; time and signals run along the first axis.
"""

import numpy as np

from seatrial.models.recording.recording import Mask
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import pose_jacobian


def outliers(values: Array, window: int = 10, deviations: float = 3.0) -> Mask:
    """Samples further than `deviations` standard deviations from a moving mean; values (N,).

    Mean and standard deviation (n - 1) are those of the `window` nearest samples, half of them
    before and half after, *without* the sample itself: if it were included, no sample of ten could
    deviate by more than (10 - 1) / sqrt(10) = 2.85 standard deviations, and no outlier would be
    detected. In pure white noise 1.9 % of the samples count as outliers; in smooth signals, steps
    and ramps none do.
    """
    n = len(values)
    if n <= window:
        return np.zeros(n, dtype=bool)
    start = np.clip(np.arange(n) - window // 2, 0, n - window - 1)
    mean = (sum(values[start + k] for k in range(window + 1)) - values) / window
    distance = np.abs(values - mean)
    squares = sum((values[start + k] - mean) ** 2 for k in range(window + 1)) - distance**2
    deviation = np.sqrt(np.maximum(squares, 0.0) / (window - 1))
    rounding = 1e-9 * float(np.max(np.abs(values)))  # a constant signal has no outliers
    return np.asarray(distance > np.maximum(deviations * deviation, rounding))


def interpolated(t: Array, values: Array, wrong: Mask) -> Array:
    """Values (N,) with the `wrong` samples replaced by linear interpolation in time t (N,) [s]."""
    if np.all(wrong):
        return values
    return np.where(wrong, np.interp(t, t[~wrong], values[~wrong]), values)


def central_difference(values: Array, period_s: float) -> Array:
    """d/dt along the first axis, [unit/s]; second order, also at the two ends; of one sample zero.

    (x[k+1] - x[k-1]) / (2 h): zero phase, gain sinc(2 f h). Except at the ends, it commutes with
    every linear time-invariant filter.
    """
    if len(values) < 3:
        return np.gradient(values, period_s, axis=0) if len(values) > 1 else np.zeros_like(values)
    return np.asarray(np.gradient(values, period_s, axis=0, edge_order=2))


def in_body(attitude: Array, values: Array) -> Array:
    """Vectors (N, 3) along the axes of the earth in those of the body, attitude (N, 3) [rad]."""
    return np.asarray(np.einsum("nji,nj->ni", pose_jacobian(attitude)[:, :3, :3], values))


def without_sign_flips(quaternions: Array) -> Array:
    """The same rotations, shape (N, 4), with signs such that q . q_next >= 0.

    q and -q are the same rotation; a change of sign at 180 degrees causes spikes in derivatives
    and wrong interpolated values. Hoyer (2021), section 5.4.3.
    """
    products = np.sum(quaternions[1:] * quaternions[:-1], axis=1)
    signs = np.cumprod(np.concatenate([[1.0], np.where(products < 0.0, -1.0, 1.0)]))
    return np.asarray(quaternions * signs[:, None])
