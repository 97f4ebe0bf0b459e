"""Prediction errors of many candidates in one compiled call.

The same equations as `prediction.predict`, for blocks of LANES candidates side by side: every
innermost loop runs over the lanes of contiguous rows and so vectorises, and a block's rows stay
in the first-level cache. Errors are summed as the prediction goes; no trajectory is stored. What
moves along one axis against a polynomial of its speed takes a whole step in one such loop, see
`one_axis`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.models.compiled import kernel, lean_kernel
from seatrial.models.identification.lanes import LANES, MAE, MEAN_ERROR, MSE
from seatrial.models.identification.one_axis import (
    DRAG,
    ERRORS,
    INVERSE,
    LIMITED,
    SIZE,
    kind_of,
    run_one_axis,
    stayed_within,
)
from seatrial.models.identification.prediction import Course, size_of_z_kernel
from seatrial.models.identification.sine import cosine_and_sine
from seatrial.models.identification.structure import IN_PLANE, IN_SPACE, Structure
from seatrial.models.vessel.basis import Array

Indices = NDArray[np.int64]


class Block(NamedTuple):
    """Work space of one block of candidates, rows of LANES."""

    entries: Array  # (n_entries, LANES)
    inverse: Array  # (n_dof, n_dof, LANES)
    z: Array  # (6 + 4 n_dof, LANES), see `structure`
    phi: Array  # (LANES,)
    rest: Array  # (n_dof, LANES)
    state: Array  # (2 n_dof, LANES) pose and velocity
    trial: Array
    rate: Array
    total: Array
    limited: Array  # (LANES,) number of limited rates
    errors: Array  # (2 n_dof, LANES) sums


@lean_kernel
def _blow(table: Structure, block: Block, wind: Array, state: Array) -> None:
    """Write the velocity through the air, its norm and magnitudes into the work array."""
    n = block.rest.shape[0]
    row = 1 + 4 * n
    for axis in range(2):
        i = table.air[axis]
        for m in range(LANES):
            block.z[row + axis, m] = (state[n + i, m] if i >= 0 else 0.0) - wind[axis]
            block.z[row + 3 + axis, m] = abs(block.z[row + axis, m])
    for m in range(LANES):
        square = block.z[row, m] * block.z[row, m] + block.z[row + 1, m] * block.z[row + 1, m]
        block.z[row + 2, m] = np.sqrt(square)


@lean_kernel
def _set_work_array(table: Structure, block: Block, wind: Array, state: Array) -> None:
    """Write nu, |nu|, cosine and sine of a state into the work array."""
    n = block.rest.shape[0]
    for i in range(n):
        for m in range(LANES):
            block.z[1 + i, m] = state[n + i, m]
    for i in table.magnitudes:
        for m in range(LANES):
            block.z[1 + n + i, m] = abs(state[n + i, m])
    for i in table.angles:
        for m in range(LANES):
            cosine, sine = cosine_and_sine(state[i, m])
            block.z[1 + 2 * n + 2 * i, m], block.z[2 + 2 * n + 2 * i, m] = cosine, sine
    if table.air.shape[0] > 0:
        _blow(table, block, wind, state)


@lean_kernel
def _net_force(table: Structure, block: Block, force: Array) -> None:
    """rest = tau - F(0, nu, attitude)."""
    for i in range(block.rest.shape[0]):
        tau = force[i]
        for m in range(LANES):
            block.rest[i, m] = tau
    for k in range(table.factors.shape[0]):
        a, b, c = table.factors[k, 0], table.factors[k, 1], table.factors[k, 2]
        begin, end = table.first[k], table.first[k + 1]
        if b == 0 and end == begin + 1:  # a linear term of one axis, the commonest
            i = table.axis[begin]
            for m in range(LANES):
                block.rest[i, m] -= block.entries[begin, m] * block.z[c, m]
            continue
        for m in range(LANES):
            block.phi[m] = block.z[a, m] * block.z[b, m] * block.z[c, m]
        for e in range(begin, end):
            i = table.axis[e]
            for m in range(LANES):
                block.rest[i, m] -= block.entries[e, m] * block.phi[m]


@lean_kernel
def _limit(block: Block, row: int, limit: float) -> None:
    """Limit one row of the rates, count where; what is not a number becomes the limit."""
    for m in range(LANES):
        wanted = block.rate[row, m]
        below = wanted if wanted < limit else limit
        rate = below if below > -limit else -limit
        block.rate[row, m] = rate
        block.limited[m] += 1.0 if rate != wanted else 0.0


@lean_kernel
def _turn_in_space(block: Block, state: Array) -> None:
    """eta_dot = J(eta) nu with Euler angles (zyx)."""
    z, rate = block.z, block.rate
    for m in range(LANES):
        cx, sx, cy, sy = z[19, m], z[20, m], z[21, m], z[22, m]
        below = sx * state[7, m] + cx * state[8, m]
        ahead = cy * state[6, m] + sy * below
        aside = cx * state[7, m] - sx * state[8, m]
        rate[0, m] = z[23, m] * ahead - z[24, m] * aside
        rate[1, m] = z[24, m] * ahead + z[23, m] * aside
        rate[2, m] = cy * below - sy * state[6, m]
        rate[5, m] = (sx * state[10, m] + cx * state[11, m]) / cy
        rate[4, m] = cx * state[10, m] - sx * state[11, m]
        rate[3, m] = state[9, m] + sy * rate[5, m]


@lean_kernel
def _rates(
    table: Structure, block: Block, force: Array, wind: Array, state: Array, limit: float
) -> None:
    """Write the limited rates of a state."""
    n = block.rest.shape[0]
    _set_work_array(table, block, wind, state)
    _net_force(table, block, force)
    for i in range(n):
        for m in range(LANES):
            block.rate[i, m] = state[n + i, m]
            block.rate[n + i, m] = block.inverse[i, i, m] * block.rest[i, m]
        for j in range(n):
            if j != i and table.coupled[i, j]:
                for m in range(LANES):
                    block.rate[n + i, m] += block.inverse[i, j, m] * block.rest[j, m]
    if table.kinematics == IN_SPACE:
        _turn_in_space(block, state)
    elif table.kinematics == IN_PLANE:
        for m in range(LANES):
            c, s = block.z[11, m], block.z[12, m]
            block.rate[0, m] = c * state[3, m] - s * state[4, m]
            block.rate[1, m] = s * state[3, m] + c * state[4, m]
    for row in range(2 * n):
        _limit(block, row, limit)


@lean_kernel
def _step(
    table: Structure, block: Block, force: Array, wind: Array, h: float, limit: float
) -> None:
    """Advance all lanes by one sample: Euler, or RK4 whose stages stand at 0, h/2, h/2 and h."""
    rows = block.state.shape[0]
    for stage in range(4 if table.rk4 else 1):
        at = block.trial if stage > 0 else block.state
        _rates(table, block, force[(stage + 1) // 2], wind, at, limit)
        if not table.rk4:
            for i in range(rows):
                for m in range(LANES):
                    block.state[i, m] += h * block.rate[i, m]
            return
        weight = h / 6.0 if stage == 0 or stage == 3 else h / 3.0
        reach = h if stage == 2 else 0.5 * h
        for i in range(rows):
            for m in range(LANES):
                before = block.total[i, m] if stage > 0 else block.state[i, m]
                block.total[i, m] = before + weight * block.rate[i, m]
                block.trial[i, m] = block.state[i, m] + reach * block.rate[i, m]
    for i in range(rows):
        for m in range(LANES):
            block.state[i, m] = block.total[i, m]


@lean_kernel
def _add_errors(block: Block, measured: Array, metric: int) -> None:
    """Add this sample's errors y - y_hat. Hoyer (2021), eqs. (3.5)-(3.7)."""
    for i in range(block.state.shape[0]):
        y = measured[i]
        if metric == MAE:
            for m in range(LANES):
                block.errors[i, m] += abs(y - block.state[i, m])
        elif metric == MSE:
            for m in range(LANES):
                block.errors[i, m] += (y - block.state[i, m]) ** 2
        elif metric == MEAN_ERROR:
            for m in range(LANES):
                block.errors[i, m] += y - block.state[i, m]
        else:
            for m in range(LANES):
                scale = 0.5 * (abs(y) + abs(block.state[i, m]))
                share = abs(y - block.state[i, m]) / scale
                block.errors[i, m] += 100.0 * share if scale > 0.0 else 0.0


@lean_kernel
def _run(table: Structure, block: Block, course: Course, metric: int) -> None:
    """Predict all samples of one block."""
    for k in range(course.measured.shape[0]):
        if course.restart[k]:
            for i in range(block.state.shape[0]):
                start = course.start[k, i]
                for m in range(LANES):
                    block.state[i, m] = start
        else:
            _step(
                table, block, course.force[k - 1], course.wind[k - 1], course.step_s, course.limit
            )
        _add_errors(block, course.measured[k], metric)


@kernel
def _on_one_axis(
    table: Structure, entries: Array, inverse: Array, course: Course, metric: int, which: Indices,
    free: bool, errors: Array, limited: Array,
) -> Indices:  # fmt: skip
    """Errors of some candidates with one axis and a polynomial drag; those still to be limited."""
    samples, kind = course.measured.shape[0], kind_of(table.drag)
    work, left, rest = np.empty(SIZE), 0, np.empty_like(which)
    for begin in range(0, len(which), LANES):
        lanes = which[begin : begin + LANES]
        work[:] = 0.0
        for m in range(len(lanes)):
            work[INVERSE + m] = inverse[0, 0, lanes[m]]
            for e in range(table.drag.shape[0]):
                work[DRAG + LANES * table.drag[e] + m] += entries[e, lanes[m]]
        run_one_axis(work, course, metric, table.rk4, free, kind)
        for m in range(len(lanes)):
            if free and not stayed_within(work, m, course.limit):
                rest[left] = lanes[m]
                left += 1
            limited[lanes[m]] = 0.0 if free else work[LIMITED + m]
            errors[lanes[m], 0] = abs(work[ERRORS + m]) / samples
            errors[lanes[m], 1] = abs(work[ERRORS + LANES + m]) / samples
    return rest[:left]


@kernel
def prediction_errors(
    table: Structure, entries: Array, inverse: Array, course: Course, metric: int, errors: Array,
    limited: Array,
) -> None:  # fmt: skip
    """Errors of n candidates: errors (n, 2 n_dof) and limited (n,), the number of limited rates.

    entries (n_entries, n) and inverse (n_dof, n_dof, n) are the candidates' tables. The mean
    error is the magnitude of the mean.
    """
    if table.drag.shape[0] > 0:
        which = np.arange(inverse.shape[2])
        for free in (True, False):  # once more, limited, those whose rates leave the limits
            which = _on_one_axis(
                table, entries, inverse, course, metric, which, free, errors, limited
            )
        return
    n_dof, n = inverse.shape[1], inverse.shape[2]
    scratch = np.empty((5, 2 * n_dof, LANES))
    block = Block(
        np.zeros((entries.shape[0], LANES)), np.zeros((n_dof, n_dof, LANES)),
        np.ones((size_of_z_kernel(n_dof), LANES)), np.empty(LANES), np.empty((n_dof, LANES)),
        scratch[0], scratch[1], scratch[2], scratch[3], np.empty(LANES), scratch[4],
    )  # fmt: skip
    for begin in range(0, n, LANES):
        size = min(LANES, n - begin)
        block.entries[:, :size] = entries[:, begin : begin + size]
        block.inverse[:, :, :size] = inverse[:, :, begin : begin + size]
        block.errors[:] = 0.0
        block.limited[:] = 0.0
        _run(table, block, course, metric)
        for m in range(size):
            limited[begin + m] = block.limited[m]
            for i in range(2 * n_dof):
                errors[begin + m, i] = abs(block.errors[i, m]) / course.measured.shape[0]
