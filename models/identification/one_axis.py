"""Prediction of many candidates that move along one axis, against a polynomial of their speed.

    x_dot = u,    m u_dot = tau - (c_0 + c_1 u + c_2 u^2 + c_3 u^3 + |u| (c_4 + c_5 u + c_6 u^2))

The surge models of Hoyer (2021), sections 2.3.4 and 2.3.5, and every table over 1, u and |u|: the
equations of `prediction` for LANES candidates side by side. A step is one loop over the lanes,
whose rows stand in one flat array at distances known when it is compiled, so that it vectorises;
so are the metric and the kind of drag, of which the commonest have few coefficients.

Most candidates never reach the limit of the rates. A `free` run leaves the limits out and notes
the largest rate instead, which is less arithmetic; a candidate whose largest rate was beyond the
limit is to be run again with them. All others move the same either way.
"""

import numpy as np

from seatrial.models.compiled import lean_kernel
from seatrial.models.identification.lanes import LANES, MAE, MEAN_ERROR, MSE, SMAPE
from seatrial.models.identification.prediction import Course, limited
from seatrial.models.vessel.basis import Array, Codes

COEFFICIENTS = 7
PROPORTIONAL, AFFINE, MODULUS, ANY = range(4)  # c_1; c_0, c_1; c_1, c_5; or any coefficients
# first lane of each row of the work array
X, U, DRAG = 0, LANES, 2 * LANES
INVERSE = DRAG + COEFFICIENTS * LANES
LIMITED = INVERSE + LANES  # number of limited rates, or of a free run the largest rate
ERRORS = LIMITED + LANES
SIZE = ERRORS + 2 * LANES


@lean_kernel
def kind_of(coefficients: Codes) -> int:
    """The simplest kind of drag that has all of some coefficients."""
    constant, modulus, others = False, False, False
    for c in coefficients:
        constant, modulus = constant or c == 0, modulus or c == 5
        others = others or (c != 0 and c != 1 and c != 5)
    if others or (constant and modulus):
        return ANY
    return MODULUS if modulus else AFFINE if constant else PROPORTIONAL


@lean_kernel
def _wanted(work: Array, m: int, tau: float, u: float, kind: int) -> float:
    """u_dot of lane m, before it is limited."""
    drag: float = u * work[DRAG + LANES + m]
    if kind == AFFINE:
        drag += work[DRAG + m]
    elif kind == MODULUS:
        drag = u * (work[DRAG + LANES + m] + abs(u) * work[DRAG + 5 * LANES + m])
    elif kind == ANY:
        even = work[DRAG + 2 * LANES + m] + u * work[DRAG + 3 * LANES + m]
        odd = work[DRAG + 5 * LANES + m] + u * work[DRAG + 6 * LANES + m]
        drag += work[DRAG + m] + u * u * even + abs(u) * (work[DRAG + 4 * LANES + m] + u * odd)
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
def _euler(work: Array, force: Array, h: float, limit: float, kind: int) -> None:
    """Advance by forward Euler; force (3, 1) at the start, middle and end of the step."""
    tau = force[0, 0]
    for m in range(LANES):
        u = work[U + m]
        wanted = _wanted(work, m, tau, u, kind)
        speed, rate = limited(u, limit), limited(wanted, limit)
        work[LIMITED + m] += _changed(speed, u) + _changed(rate, wanted)
        work[X + m] += h * speed
        work[U + m] = u + h * rate


@lean_kernel
def _free_euler(
    work: Array, force: Array, measured: Array, h: float, kind: int, metric: int
) -> None:
    """The same without limits; errors are added in the same loop, which is as long as a step."""
    tau, x_measured, u_measured = force[0, 0], measured[0], measured[1]
    for m in range(LANES):
        u = work[U + m]
        rate = _wanted(work, m, tau, u, kind)
        work[LIMITED + m] = _larger(work[LIMITED + m], u, rate)
        ahead, after = work[X + m] + h * u, u + h * rate
        work[X + m], work[U + m] = ahead, after
        work[ERRORS + m] += _error(x_measured, ahead, metric)
        work[ERRORS + LANES + m] += _error(u_measured, after, metric)


@lean_kernel
def _rk4(work: Array, force: Array, h: float, limit: float, kind: int) -> None:
    """Advance by RK4, whose stages stand at 0, h/2, h/2 and h."""
    first, middle, last = force[0, 0], force[1, 0], force[2, 0]
    for m in range(LANES):
        u1 = work[U + m]
        w1 = _wanted(work, m, first, u1, kind)
        v1, r1 = limited(u1, limit), limited(w1, limit)
        u2 = u1 + 0.5 * h * r1
        w2 = _wanted(work, m, middle, u2, kind)
        v2, r2 = limited(u2, limit), limited(w2, limit)
        u3 = u1 + 0.5 * h * r2
        w3 = _wanted(work, m, middle, u3, kind)
        v3, r3 = limited(u3, limit), limited(w3, limit)
        u4 = u1 + h * r3
        w4 = _wanted(work, m, last, u4, kind)
        v4, r4 = limited(u4, limit), limited(w4, limit)
        count = _changed(v1, u1) + _changed(v2, u2) + _changed(v3, u3) + _changed(v4, u4)
        count += _changed(r1, w1) + _changed(r2, w2) + _changed(r3, w3) + _changed(r4, w4)
        work[LIMITED + m] += count
        work[X + m] += h / 6.0 * (v1 + v4) + h / 3.0 * (v2 + v3)
        work[U + m] = u1 + h / 6.0 * (r1 + r4) + h / 3.0 * (r2 + r3)


@lean_kernel
def _free_rk4(work: Array, force: Array, h: float, kind: int) -> None:
    """The same without limits."""
    first, middle, last = force[0, 0], force[1, 0], force[2, 0]
    for m in range(LANES):
        u1 = work[U + m]
        r1 = _wanted(work, m, first, u1, kind)
        u2 = u1 + 0.5 * h * r1
        r2 = _wanted(work, m, middle, u2, kind)
        u3 = u1 + 0.5 * h * r2
        r3 = _wanted(work, m, middle, u3, kind)
        u4 = u1 + h * r3
        r4 = _wanted(work, m, last, u4, kind)
        largest = _larger(_larger(work[LIMITED + m], u1, r1), u2, r2)
        work[LIMITED + m] = _larger(_larger(largest, u3, r3), u4, r4)
        work[X + m] += h / 6.0 * (u1 + u4) + h / 3.0 * (u2 + u3)
        work[U + m] = u1 + h / 6.0 * (r1 + r4) + h / 3.0 * (r2 + r3)


@lean_kernel
def _error(y: float, predicted: float, metric: int) -> float:
    """What a sample adds to the error y - y_hat. Hoyer (2021), eqs. (3.5)-(3.7)."""
    if metric == MAE:
        return abs(y - predicted)
    if metric == MSE:
        return (y - predicted) ** 2
    if metric == MEAN_ERROR:
        return y - predicted
    return _share(y, predicted)


@lean_kernel
def _add_errors(work: Array, measured: Array, metric: int) -> None:
    """Add this sample's errors."""
    x, u = measured[0], measured[1]
    for m in range(LANES):
        work[ERRORS + m] += _error(x, work[X + m], metric)
        work[ERRORS + LANES + m] += _error(u, work[U + m], metric)


@lean_kernel
def _share(y: float, predicted: float) -> float:
    """|y - y_hat| in percent of their mean size."""
    scale = 0.5 * (abs(y) + abs(predicted))
    share = abs(y - predicted) / scale
    return 100.0 * share if scale > 0.0 else 0.0


@lean_kernel
def _advance(
    work: Array, k: int, course: Course, metric: int, rk4: bool, free: bool, kind: int
) -> None:
    """One step to sample k, and its errors."""
    force, measured, h = course.force[k - 1], course.measured[k], course.step_s
    if free and not rk4:
        _free_euler(work, force, measured, h, kind, metric)
        return
    if free:
        _free_rk4(work, force, h, kind)
    elif rk4:
        _rk4(work, force, h, course.limit, kind)
    else:
        _euler(work, force, h, course.limit, kind)
    _add_errors(work, measured, metric)


@lean_kernel
def _run(work: Array, course: Course, metric: int, rk4: bool, free: bool, kind: int) -> None:
    """Predict all samples with a metric that is known when it is compiled."""
    for k in range(course.measured.shape[0]):
        if course.restart[k]:
            for m in range(LANES):
                work[X + m] = course.start[k, 0]
                work[U + m] = course.start[k, 1]
            _add_errors(work, course.measured[k], metric)
        elif kind == PROPORTIONAL:
            _advance(work, k, course, metric, rk4, free, PROPORTIONAL)
        elif kind == AFFINE:
            _advance(work, k, course, metric, rk4, free, AFFINE)
        elif kind == MODULUS:
            _advance(work, k, course, metric, rk4, free, MODULUS)
        else:
            _advance(work, k, course, metric, rk4, free, ANY)


@lean_kernel
def run_one_axis(
    work: Array, course: Course, metric: int, rk4: bool, free: bool, kind: int
) -> None:
    """Predict all samples of one block: work (SIZE,) holds drag and inverse, errors are summed."""
    if metric == MAE:
        _run(work, course, MAE, rk4, free, kind)
    elif metric == MSE:
        _run(work, course, MSE, rk4, free, kind)
    elif metric == MEAN_ERROR:
        _run(work, course, MEAN_ERROR, rk4, free, kind)
    else:
        _run(work, course, SMAPE, rk4, free, kind)


@lean_kernel
def stayed_within(work: Array, m: int, limit: float) -> bool:
    """Whether no rate of lane m was beyond the limit, or no number, in a free run."""
    finite = np.isfinite(work[ERRORS + m]) and np.isfinite(work[ERRORS + LANES + m])
    within: bool = finite and work[LIMITED + m] <= limit
    return within
