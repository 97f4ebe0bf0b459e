"""Prediction of many candidates that move along one axis, against a polynomial of their speed.

    x_dot = u,    m u_dot = tau - (c_0 + c_1 u + c_2 u^2 + c_3 u^3 + |u| (c_4 + c_5 u + c_6 u^2))

The surge models of Hoyer (2021), sections 2.3.4 and 2.3.5, and every table over 1, u and |u|: the
equations of `prediction` for LANES candidates side by side. A step is one loop over the lanes,
whose rows stand in one flat array at distances known when it is compiled, so that it vectorises.

Most candidates never reach the limit of the rates. A `free` run leaves the limits out and notes
the largest rate instead, which costs two thirds of the arithmetic; a candidate whose largest rate
was beyond the limit is to be run again with them. All others move the same either way.
"""

import numpy as np

from models.basis import Array
from models.compiled import lean_kernel
from models.identification.lanes import LANES, MAE, MEAN_ERROR, MSE
from models.identification.prediction import Course, limited

COEFFICIENTS = 7
# first lane of each row of the work array
X, U, DRAG = 0, LANES, 2 * LANES
INVERSE = DRAG + COEFFICIENTS * LANES
LIMITED = INVERSE + LANES  # number of limited rates, or of a free run the largest rate
ERRORS = LIMITED + LANES
SIZE = ERRORS + 2 * LANES


@lean_kernel
def _wanted(work: Array, m: int, tau: float, u: float, linear: bool) -> float:
    """u_dot of lane m, before it is limited."""
    drag: float = work[DRAG + m] + u * work[DRAG + LANES + m]
    if not linear:
        even = work[DRAG + 2 * LANES + m] + u * work[DRAG + 3 * LANES + m]
        odd = work[DRAG + 5 * LANES + m] + u * work[DRAG + 6 * LANES + m]
        drag += u * u * even + abs(u) * (work[DRAG + 4 * LANES + m] + u * odd)
    over_m: float = work[INVERSE + m]
    return over_m * (tau - drag)


@lean_kernel
def _changed(rate: float, wanted: float) -> float:
    return 1.0 if rate != wanted else 0.0


@lean_kernel
def _larger(largest: float, u: float, rate: float) -> float:
    """The largest rate, of u and u_dot as well. What is no number is not seen."""
    size = abs(u) if abs(u) > abs(rate) else abs(rate)
    return size if size > largest else largest


@lean_kernel
def _euler(work: Array, force: Array, h: float, limit: float, linear: bool) -> None:
    """Advance by forward Euler; force (3, 1) at the start, middle and end of the step."""
    tau = force[0, 0]
    for m in range(LANES):
        u = work[U + m]
        wanted = _wanted(work, m, tau, u, linear)
        speed, rate = limited(u, limit), limited(wanted, limit)
        work[LIMITED + m] += _changed(speed, u) + _changed(rate, wanted)
        work[X + m] += h * speed
        work[U + m] = u + h * rate


@lean_kernel
def _free_euler(work: Array, force: Array, h: float, linear: bool) -> None:
    """The same without limits."""
    tau = force[0, 0]
    for m in range(LANES):
        u = work[U + m]
        rate = _wanted(work, m, tau, u, linear)
        work[LIMITED + m] = _larger(work[LIMITED + m], u, rate)
        work[X + m] += h * u
        work[U + m] = u + h * rate


@lean_kernel
def _rk4(work: Array, force: Array, h: float, limit: float, linear: bool) -> None:
    """Advance by RK4, whose stages stand at 0, h/2, h/2 and h."""
    first, middle, last = force[0, 0], force[1, 0], force[2, 0]
    for m in range(LANES):
        u1 = work[U + m]
        w1 = _wanted(work, m, first, u1, linear)
        v1, r1 = limited(u1, limit), limited(w1, limit)
        u2 = u1 + 0.5 * h * r1
        w2 = _wanted(work, m, middle, u2, linear)
        v2, r2 = limited(u2, limit), limited(w2, limit)
        u3 = u1 + 0.5 * h * r2
        w3 = _wanted(work, m, middle, u3, linear)
        v3, r3 = limited(u3, limit), limited(w3, limit)
        u4 = u1 + h * r3
        w4 = _wanted(work, m, last, u4, linear)
        v4, r4 = limited(u4, limit), limited(w4, limit)
        count = _changed(v1, u1) + _changed(v2, u2) + _changed(v3, u3) + _changed(v4, u4)
        count += _changed(r1, w1) + _changed(r2, w2) + _changed(r3, w3) + _changed(r4, w4)
        work[LIMITED + m] += count
        work[X + m] += h / 6.0 * (v1 + v4) + h / 3.0 * (v2 + v3)
        work[U + m] = u1 + h / 6.0 * (r1 + r4) + h / 3.0 * (r2 + r3)


@lean_kernel
def _free_rk4(work: Array, force: Array, h: float, linear: bool) -> None:
    """The same without limits."""
    first, middle, last = force[0, 0], force[1, 0], force[2, 0]
    for m in range(LANES):
        u1 = work[U + m]
        r1 = _wanted(work, m, first, u1, linear)
        u2 = u1 + 0.5 * h * r1
        r2 = _wanted(work, m, middle, u2, linear)
        u3 = u1 + 0.5 * h * r2
        r3 = _wanted(work, m, middle, u3, linear)
        u4 = u1 + h * r3
        r4 = _wanted(work, m, last, u4, linear)
        largest = _larger(_larger(work[LIMITED + m], u1, r1), u2, r2)
        work[LIMITED + m] = _larger(_larger(largest, u3, r3), u4, r4)
        work[X + m] += h / 6.0 * (u1 + u4) + h / 3.0 * (u2 + u3)
        work[U + m] = u1 + h / 6.0 * (r1 + r4) + h / 3.0 * (r2 + r3)


@lean_kernel
def _add_errors(work: Array, x: float, u: float, metric: int) -> None:
    """Add this sample's errors y - y_hat. Hoyer (2021), eqs. (3.5)-(3.7)."""
    if metric == MAE:
        for m in range(LANES):
            work[ERRORS + m] += abs(x - work[X + m])
            work[ERRORS + LANES + m] += abs(u - work[U + m])
    elif metric == MSE:
        for m in range(LANES):
            work[ERRORS + m] += (x - work[X + m]) ** 2
            work[ERRORS + LANES + m] += (u - work[U + m]) ** 2
    elif metric == MEAN_ERROR:
        for m in range(LANES):
            work[ERRORS + m] += x - work[X + m]
            work[ERRORS + LANES + m] += u - work[U + m]
    else:
        for m in range(LANES):
            work[ERRORS + m] += _share(x, work[X + m])
            work[ERRORS + LANES + m] += _share(u, work[U + m])


@lean_kernel
def _share(y: float, predicted: float) -> float:
    """|y - y_hat| in percent of their mean size."""
    scale = 0.5 * (abs(y) + abs(predicted))
    share = abs(y - predicted) / scale
    return 100.0 * share if scale > 0.0 else 0.0


@lean_kernel
def _advance(work: Array, force: Array, course: Course, rk4: bool, linear: bool) -> None:
    """One step with limits, compiled for either kind of drag."""
    h, limit = course.step_s, course.limit
    if rk4 and linear:
        _rk4(work, force, h, limit, True)
    elif rk4:
        _rk4(work, force, h, limit, False)
    elif linear:
        _euler(work, force, h, limit, True)
    else:
        _euler(work, force, h, limit, False)


@lean_kernel
def _advance_freely(work: Array, force: Array, course: Course, rk4: bool, linear: bool) -> None:
    """The same without limits."""
    if rk4 and linear:
        _free_rk4(work, force, course.step_s, True)
    elif rk4:
        _free_rk4(work, force, course.step_s, False)
    elif linear:
        _free_euler(work, force, course.step_s, True)
    else:
        _free_euler(work, force, course.step_s, False)


@lean_kernel
def run_one_axis(
    work: Array, course: Course, metric: int, rk4: bool, linear: bool, free: bool
) -> None:
    """Predict all samples of one block: work (SIZE,) holds drag and inverse, errors are summed."""
    for k in range(course.measured.shape[0]):
        if course.restart[k]:
            for m in range(LANES):
                work[X + m] = course.start[k, 0]
                work[U + m] = course.start[k, 1]
        elif free:
            _advance_freely(work, course.force[k - 1], course, rk4, linear)
        else:
            _advance(work, course.force[k - 1], course, rk4, linear)
        _add_errors(work, course.measured[k, 0], course.measured[k, 1], metric)


@lean_kernel
def stayed_within(work: Array, m: int, limit: float) -> bool:
    """Whether no rate of lane m was beyond the limit, or no number, in a free run."""
    finite = np.isfinite(work[ERRORS + m]) and np.isfinite(work[ERRORS + LANES + m])
    within: bool = finite and work[LIMITED + m] <= limit
    return within
