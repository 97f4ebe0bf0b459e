"""Metrics of sampled signals, with units. Jervan (2020), section 3.5."""

import numpy as np

from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import wrap


def mean_square(error: Array) -> Array:
    """MSE along the first axis, in the square of the signal's unit. (3.16)"""
    return np.asarray(np.mean(np.square(error), axis=0))


def mean_absolute(error: Array) -> Array:
    """MAE along the first axis, in the signal's unit. (3.17)"""
    return np.asarray(np.mean(np.abs(error), axis=0))


def position_error(eta_d: Array, eta: Array) -> Array:
    """Position error e_pos [m], shape (N,), in the plane or along a single axis. (4.6)"""
    difference = (eta_d - eta)[:, :2]
    return np.asarray(np.sqrt(np.sum(np.square(difference), axis=1)))


def heading_error(eta_d: Array, eta: Array) -> Array:
    """e_psi [rad], shape (N,), wrapped to (-pi, pi]; poses (N, 3). (4.7)"""
    return wrap((eta_d - eta)[:, 2])


def position_power(tau: Array, nu: Array) -> Array:
    """|tau_x u + tau_y v| [W], shape (N,)."""
    return np.asarray(np.abs(np.sum(tau[:, :2] * nu[:, :2], axis=1)))


def heading_power(tau: Array, nu: Array) -> Array:
    """|tau_n r| [W], shape (N,)."""
    return np.asarray(np.abs(tau[:, 2] * nu[:, 2]))


def iaew(error: Array, power: Array, period_s: float) -> float:
    """Integral absolute error times work, at the end of the mission. (3.18)"""
    return float(np.sum(np.abs(error)) * period_s * np.sum(power) * period_s)


def relative_errors(value: Array, truth: Array) -> Array:
    """|value - truth| / |truth|; NaN where the truth is zero."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(truth == 0.0, np.nan, np.abs(value - truth) / np.abs(truth))


def below_true_model(mse: Array, plant_mse: Array, force_variance: Array) -> Array:
    """Whether a model fits better than the true plant, which indicates a fit to lag or feedback.

    True if the MSE is below 0.99 times that of the true plant for the same force signal, unless
    the latter is within 1e-6 of the variance of the force, that is, exact.
    """
    meaningful = plant_mse > 1e-6 * force_variance
    return np.asarray(meaningful & (mse < 0.99 * plant_mse))
