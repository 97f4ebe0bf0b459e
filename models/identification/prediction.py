"""Free-run prediction of a recording by a candidate model. Hoyer (2021), section 6.1.

From the measured pose and velocity at the first sample the equations of motion

    eta_dot = J(eta) nu,    nu_dot = M^-1 (tau - F(0, nu, attitude, nu_q))

are integrated with the recorded force, by Euler, eq. (6.2), or by RK4 at the sample time. J is
the rotation by the heading for surge, sway and yaw, that of the Euler angles (zyx) for six degrees
of freedom, and 1 for other vessels: each velocity along its own axis. Both rates are limited at
every stage, as in section 6.4, so that no candidate overflows; how often, is counted.

`predict` is the readable equation for one candidate; `population` does the same for many.
"""

from typing import NamedTuple

import numpy as np

from seatrial.models.compiled import kernel, lean_kernel
from seatrial.models.errors import RecordingError
from seatrial.models.identification.structure import (
    IN_PLANE,
    IN_SPACE,
    Flags,
    Integrator,
    Structure,
    layout,
    size_of_z,
)
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag

GAP = 1.5  # sample times: a longer step in time begins a new prediction


class Course(NamedTuple):
    """A recording as the kernels see it, N samples; SI units."""

    force: Array  # (N, 3, n_dof) acting at the start, middle and end of each sample
    wind: Array  # (N, 2) velocity of the air in body axes, held over each sample
    measured: Array  # (N, 2 n_dof) pose and velocity
    start: Array  # (N, 2 n_dof) where a prediction begins, the state it begins with
    restart: Flags  # (N,) samples at which a prediction begins
    step_s: float
    limit: float  # of eta_dot [m/s, rad/s] and nu_dot [m/s^2, rad/s^2]


@lean_kernel
def limited(rate: float, limit: float) -> float:
    """The rate within +- limit; the limit where it is not a number."""
    below = rate if rate < limit else limit
    return below if below > -limit else -limit


@lean_kernel
def _blow(table: Structure, wind: Array, state: Array, z: Array) -> None:
    """Write the velocity through the air, its norm and magnitudes into z."""
    n, ahead, aside = state.shape[0] // 2, -wind[0], -wind[1]
    if table.air[0] >= 0:
        ahead += state[n + table.air[0]]
    if table.air[1] >= 0:
        aside += state[n + table.air[1]]
    row = 1 + 4 * n
    z[row], z[row + 1], z[row + 2] = ahead, aside, np.sqrt(ahead * ahead + aside * aside)
    z[row + 3], z[row + 4] = abs(ahead), abs(aside)


@lean_kernel
def _turn_in_space(state: Array, z: Array, rate: Array) -> None:
    """eta_dot = J(eta) nu with Euler angles (zyx). Fossen (2011), eqs. (2.18) and (2.28)."""
    cx, sx, cy, sy, cz, sz = z[19], z[20], z[21], z[22], z[23], z[24]
    u, v, w, p, q, r = state[6], state[7], state[8], state[9], state[10], state[11]
    ahead = cy * u + sy * (sx * v + cx * w)
    aside = cx * v - sx * w
    rate[0] = cz * ahead - sz * aside
    rate[1] = sz * ahead + cz * aside
    rate[2] = cy * (sx * v + cx * w) - sy * u
    rate[5] = (sx * q + cx * r) / cy
    rate[4] = cx * q - sx * r
    rate[3] = p + sy * rate[5]


@lean_kernel
def _rates(
    table: Structure, coefficients: Array, inverse: Array, force: Array, wind: Array, state: Array,
    limit: float, z: Array, rest: Array, rate: Array,
) -> float:  # fmt: skip
    """Write the limited rate of state = [eta, nu], shape (2 n,); the number of limited entries."""
    n = rest.shape[0]
    for i in range(n):
        z[1 + i] = state[n + i]
        rest[i] = force[i]
    for i in table.magnitudes:
        z[1 + n + i] = abs(state[n + i])
    for i in table.angles:
        z[1 + 2 * n + 2 * i], z[2 + 2 * n + 2 * i] = np.cos(state[i]), np.sin(state[i])
    if table.air.shape[0] > 0:
        _blow(table, wind, state, z)
    for k in range(table.factors.shape[0]):
        phi = z[table.factors[k, 0]] * z[table.factors[k, 1]] * z[table.factors[k, 2]]
        for e in range(table.first[k], table.first[k + 1]):
            rest[table.axis[e]] -= coefficients[e] * phi
    for i in range(n):
        rate[i] = state[n + i]
        rate[n + i] = 0.0
        for j in range(n):
            if table.coupled[i, j]:
                rate[n + i] += inverse[i, j] * rest[j]
    if table.kinematics == IN_PLANE:
        c, s = z[5 + 2 * n], z[6 + 2 * n]
        rate[0] = c * state[3] - s * state[4]
        rate[1] = s * state[3] + c * state[4]
    elif table.kinematics == IN_SPACE:
        _turn_in_space(state, z, rate)
    count = 0.0
    for i in range(2 * n):
        wanted = rate[i]
        rate[i] = limited(wanted, limit)
        count += 1.0 if rate[i] != wanted else 0.0
    return count


@lean_kernel
def _step(
    table: Structure, coefficients: Array, inverse: Array, force: Array, wind: Array, state: Array,
    h: float, limit: float, z: Array, rest: Array, rate: Array, trial: Array, total: Array,
) -> float:  # fmt: skip
    """Advance the state by one sample; the number of limited rates.

    Euler, or RK4 whose stages stand at 0, h/2, h/2 and h.
    """
    count = 0.0
    for stage in range(4 if table.rk4 else 1):
        at = trial if stage > 0 else state
        acting = force[(stage + 1) // 2]
        count += _rates(table, coefficients, inverse, acting, wind, at, limit, z, rest, rate)
        weight = h / 6.0 if stage == 0 or stage == 3 else h / 3.0
        weight = weight if table.rk4 else h
        reach = h if stage == 2 else 0.5 * h
        for i in range(state.shape[0]):
            before = total[i] if stage > 0 else state[i]
            total[i] = before + weight * rate[i]
            trial[i] = state[i] + reach * rate[i]
    for i in range(state.shape[0]):
        state[i] = total[i]
    return count


@lean_kernel
def _run(
    table: Structure, coefficients: Array, inverse: Array, course: Course, states: Array,
    z: Array, rest: Array, state: Array, rate: Array, trial: Array, total: Array,
) -> float:  # fmt: skip
    """Predict all samples; the number of limited rates."""
    count = 0.0
    for k in range(states.shape[0]):
        if course.restart[k]:
            for i in range(state.shape[0]):
                state[i] = course.start[k, i]
        else:
            count += _step(
                table, coefficients, inverse, course.force[k - 1], course.wind[k - 1], state,
                course.step_s, course.limit, z, rest, rate, trial, total,
            )  # fmt: skip
        for i in range(state.shape[0]):
            states[k, i] = state[i]
    return count


size_of_z_kernel = lean_kernel(size_of_z)


@kernel
def predict(
    table: Structure, coefficients: Array, inverse: Array, course: Course, states: Array
) -> float:
    """Predict one candidate: states (N, 2 n_dof) is written; the number of limited rates."""
    n = inverse.shape[0]
    z = np.zeros(size_of_z_kernel(n))
    z[0] = 1.0
    scratch = np.empty((4, 2 * n))
    return _run(
        table, coefficients, inverse, course, states, z, np.empty(n), scratch[0], scratch[1],
        scratch[2], scratch[3],
    )  # fmt: skip


def held_force(recording: Recording, thruster: SecondOrderLag | None, kind: str | None) -> Array:
    """Force [N, Nm] at the start, middle and end of each sample, shape (N, 3, n_dof).

    By default the command, passed through the lag where that is known; else the recorded acting
    force; else the command as it is. A thruster without lag acts as commanded, so a recorded
    force that is last sample's command says nothing new. After the last sample nothing acts.
    """
    actual = recording.tau_actual
    if thruster is None and actual is not None and np.array_equal(actual[1:], recording.tau[:-1]):
        kind = kind or "commanded"
    start = recording.force(kind)
    if start is recording.tau:
        return np.repeat(start[:, None, :], 3, axis=1)
    end = np.vstack([start[1:], start[-1:]])
    middle = 0.5 * (start + end)
    if thruster is not None and start is recording.tau_filtered:
        middle = _middle_of_lag(thruster, sample_time(recording), start, end, recording.tau)
    return np.stack([start, middle, end], axis=1)


def _middle_of_lag(
    thruster: SecondOrderLag, step_s: float, start: Array, end: Array, command: Array
) -> Array:
    """Force in the middle of each sample: the rate that leads to its end, half a step on."""
    whole, half = thruster.table(step_s), thruster.table(0.5 * step_s)
    by_rate = whole.a[0, 1] or 1.0  # a first-order lag has no rate: what is left of `end` is zero
    rate = (end - whole.a[0, 0] * start - whole.b[0] * command) / by_rate
    return np.asarray(half.a[0, 0] * start + half.a[0, 1] * rate + half.b[0] * command)


def sample_time(recording: Recording) -> float:
    """Sample time [s], also where parts of the recording are missing."""
    return float(np.median(np.diff(recording.t)))


def course_of(
    recording: Recording,
    thruster: SecondOrderLag | None,
    force: str | None,
    horizon: int | None,
    limit: float,
) -> Course:
    """The recording for the kernels, predictions beginning anew every `horizon` samples.

    They also begin anew where samples are missing. Raises RecordingError where the recorded
    velocity is itself beyond the limit.
    """
    fastest = float(np.max(np.abs(recording.nu)))
    if not fastest < limit:
        raise RecordingError(
            f"recorded velocity: got {fastest:.3g}, expected below "
            f"identifier.derivative_limit = {limit:g}"
        )
    step = sample_time(recording)
    restart = np.concatenate([[True], np.diff(recording.t) > GAP * step])
    if horizon is not None:
        index = np.arange(len(recording))
        restart |= (index - np.maximum.accumulate(np.where(restart, index, 0))) % horizon == 0
    measured = np.ascontiguousarray(np.hstack([recording.eta, recording.nu]))
    acting = np.ascontiguousarray(held_force(recording, thruster, force))
    still = np.zeros((len(recording), 2))
    wind = still if recording.wind is None else np.ascontiguousarray(recording.wind)
    return Course(acting, wind, measured, measured, restart, step, limit)


def free_run(model: Vessel, course: Course, integrator: Integrator) -> Array:
    """Pose and velocity that a model predicts, shape (N, 2 n_dof)."""
    plan = layout(model.terms, model.dofs, model.theta != 0.0, integrator)
    entries = plan.entries(model.theta[None])[:, 0].copy()
    inverse = plan.inverse_inertia(model.theta[None])[0][..., 0].copy()
    states = np.empty_like(course.measured)
    predict(plan.structure, entries, inverse, course, states)
    return states
