"""Metrics of sampled signals, with units. Jervan (2020), section 3.5.

For the metrics of set-point steps a mission is divided into stands, intervals of constant
set-point. A step is where one stand immediately follows another. Positions are compared by axis;
the caller wraps headings.
"""

from itertools import pairwise

import numpy as np

from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import wrap

SETTLING_BAND = 0.05  # of the step: the band of the settling time
STEADY_S = 60.0  # length of the mean that is the steady-state error [s]
EARLY_S = 10.0  # interval before the step in which a controller with preview may act [s]
RISE = (0.1, 0.9)


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
    return float(cumulative_iaew(error, power, period_s)[-1])


def cumulative_iaew(error: Array, power: Array, period_s: float) -> Array:
    """Integral absolute error times work from the start to every sample, shape (N,). (3.18)"""
    return np.asarray(np.cumsum(np.abs(error)) * period_s * np.cumsum(power) * period_s)


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


def stands(setpoint: Array, least: int) -> list[slice]:
    """Intervals of at least `least` rows in which the set-point (N, n_dof) is constant."""
    moves = np.flatnonzero(np.any(np.diff(setpoint, axis=0) != 0.0, axis=1)) + 1
    edges = [0, *moves.tolist(), len(setpoint)]
    runs = [slice(a, b) for a, b in pairwise(edges)]
    return [run for run in runs if run.stop - run.start >= least]


def steady_state_error(error: Array, where: list[slice], period_s: float, ahead: int) -> Array:
    """Largest |mean error| of a stand, over the 60 s before the preview of the next step starts.

    `error` has shape (N, n_dof), the result (n_dof,); `ahead` is the number of rows of the
    preview, which ends a stand only if another one follows. NaN if no stand is long enough: the
    mean must be in its last two thirds.
    """
    rows = round(STEADY_S / period_s)
    means = []
    for stand in where:
        end = stand.stop - (ahead if stand.stop < len(error) else 0)
        if end - rows >= stand.start + (stand.stop - stand.start) // 3:
            means.append(np.abs(np.mean(error[end - rows : end], axis=0)))
    undefined = np.full(error.shape[1], np.nan)
    return np.max(means, axis=0) if means else undefined


def step_responses(
    setpoint: Array, pose: Array, where: list[slice], period_s: float, ahead: int
) -> dict[str, Array]:
    """Overshoot, rise time, settling time and early share of every axis, shape (n_dof,).

    Overshoot is the largest over all steps [%]; the others are means: rise from 10 to 90 % [s],
    settling within 5 % [s], that of the first and of the last step, and the share of the change
    made in the 10 s before the step [%]. NaN if an axis has no step, or does not settle.
    """
    n_dof = setpoint.shape[1]
    responses: dict[str, list[list[float]]] = {
        name: [[] for _ in range(n_dof)]
        for name in ("overshoot", "rise_time", "settling_time", "early_share")
    }
    for before, stand in pairwise(where):
        if before.stop != stand.start:
            continue
        end = stand.stop - (ahead if stand.stop < len(pose) else 0)
        for i in range(n_dof):
            first, last = setpoint[before.start, i], setpoint[stand.start, i]
            if first == last:
                continue
            share = (pose[stand.start : end, i] - first) / (last - first)
            start = max(stand.start - round(EARLY_S / period_s), before.start)
            early = (pose[stand.start, i] - pose[start, i]) / (last - first)
            responses["overshoot"][i].append(100.0 * max(0.0, float(np.max(share)) - 1.0))
            responses["rise_time"][i].append(_rise(share) * period_s)
            responses["settling_time"][i].append(_settling(share) * period_s)
            responses["early_share"][i].append(100.0 * float(early))
    settling = responses["settling_time"]
    responses["settling_time_first"] = [values[:1] for values in settling]
    responses["settling_time_last"] = [values[-1:] for values in settling]
    combine = {"overshoot": np.max}
    return {
        name: np.array([combine.get(name, np.mean)(v) if v else np.nan for v in values])
        for name, values in responses.items()
    }


def _rise(share: Array) -> float:
    """Rows from the first above 10 % to the first above 90 %; NaN if 90 % is not reached."""
    low, high = (np.flatnonzero(share >= level) for level in RISE)
    return float(high[0] - low[0]) if len(high) else float("nan")


def _settling(share: Array) -> float:
    """Rows until the share stays within 5 % of one; NaN if it is outside at the end."""
    outside = np.flatnonzero(np.abs(share - 1.0) > SETTLING_BAND)
    if not len(outside):
        return 0.0
    return float(outside[-1] + 1) if outside[-1] + 1 < len(share) else float("nan")


def integral_absolute_error(error: Array, period_s: float) -> Array:
    """IAE, shape (n_dof,), in the error's unit times seconds."""
    return np.asarray(np.sum(np.abs(error), axis=0) * period_s)


def integral_time_absolute_error(error: Array, setpoint: Array, period_s: float) -> Array:
    """ITAE with the time counted from the last move of the set-point; unit times s^2."""
    rows = np.arange(len(error))
    moved = np.any(np.diff(setpoint, axis=0, prepend=setpoint[:1]) != 0.0, axis=1)
    since = rows - np.maximum.accumulate(np.where(moved, rows, 0))
    return np.asarray(np.sum(np.abs(error) * since[:, None], axis=0) * period_s**2)


def root_mean_square(signal: Array) -> Array:
    """RMS along the first axis, in the signal's unit."""
    return np.asarray(np.sqrt(np.mean(np.square(signal), axis=0)))


def total_variation(signal: Array) -> Array:
    """Sum of |changes| along the first axis, in the signal's unit."""
    return np.asarray(np.sum(np.abs(np.diff(signal, axis=0)), axis=0))


def hits(command: Array, limits: Array) -> Array:
    """Number of samples at which a command (N, n_dof) is at its limit (n_dof,), (n_dof,)."""
    return np.asarray(np.sum(np.abs(command) >= limits * (1.0 - 1e-9), axis=0))


def energy(power: Array, period_s: float) -> float:
    """Work [J] of a power [W] that is never recovered."""
    return float(np.sum(np.abs(power)) * period_s)
