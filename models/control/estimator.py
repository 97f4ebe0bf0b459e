"""State estimation for the controllers: a Kalman filter, or the measured motion.

    correct   x_k = x-_k + M (y_k - C x-_k)
    predict   x-_{k+1} = A x_k + B (u_k + d_k + b_k + a_k),    b-_{k+1} = exp(-h / T) b_k

M is the gain of the filter; that of the predictor is K = A M. Bargouth (2022), (2.27)-(2.28),
prints the second form and computes with the gain of the first. The disturbance d is known (wind).
The bias b is estimated (`estimate_bias`) in NED as a random walk, or as a process of first order
with time constant T; in yaw alone it is then the moment of a slow current, (2.9). The force a is
what an excitation adds to the command: the filter knows it, but the controller does not counteract
it.

The state is stored in NED and transformed to the present body axes, in which the model holds.
Earlier measurements and commands are transformed as well, so that a force that is constant in NED
stays constant. NaN measurements are ignored.
"""

from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

import numpy as np
import scipy

from seatrial.models.compiled import lean_kernel
from seatrial.models.control.linear_design import DesignModel, check_weights, riccati
from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError
from seatrial.models.ranges import NotNegative, Positive, check_ranges
from seatrial.models.simulation.dynamics import COS_PSI, SIN_PSI
from seatrial.models.simulation.statespace import spectral_radius
from seatrial.models.simulation.voyage import Outlook
from seatrial.models.vessel.basis import INDEX, N_VARIABLES, Array, Codes, features_kernel
from seatrial.models.vessel.kinematics import wrap_kernel
from seatrial.models.vessel.table import ForceTable, fill_air_kernel, weighted_sum_kernel
from seatrial.models.vessel.tuning import FromVessel

CONSTANT = INDEX["1"]


class Observer(NamedTuple):
    """The design model and its filter, for the kernels; inputs in SI."""

    A: Array  # (n, n)
    B: Array  # (n, r)
    C: Array  # (m, n)
    M: Array  # (n, m)
    bias_gain: Array  # (r, m) [N/m, ...]
    start: Array  # (n, m)
    limits: Array  # (r,) [N, Nm]
    bias_decay: float  # of the bias over one sample; 1: a random walk
    turning: bool
    measured: bool
    smooth: bool  # integral action on the estimated pose, which is unbiased if b is estimated
    still: ForceTable
    north: int  # index of the surge velocity, -1: none
    east: int  # index of the sway velocity, -1: none
    z: Array  # work space: variables and basis functions of the force at rest
    phi: Array
    error: Array  # (m,)
    local: Array  # (n,)
    moved: Array  # (n,)
    force: Array  # (r,)


class Memory(NamedTuple):
    """State of a controller between two samples; forces in SI."""

    instant: Codes  # (1,) number of loop instants so far
    failures: Codes  # (1,) samples at which the last command was held
    x: Array  # (n,) estimated state, NED
    x_last: Array  # (n,) estimated state of the last sample, NED
    y_last: Array  # (m,) pose of the last sample, for the integral action, NED
    bias: Array  # (r,) estimated disturbance, NED
    axes: Array  # (1,) heading of the body axes in which `known` and `command` are given [rad]
    known: Array  # (r,) known disturbance of the last sample
    command: Array  # (r,) force commanded at the last sample
    added: Array  # (r,) force that an excitation added to the command


def memory(n: int, m: int, r: int) -> Memory:
    """The initial memory, all zeros, for n states, m outputs and r inputs."""
    counts = np.zeros((2, 1), dtype=np.int64)
    return Memory(counts[0], counts[1], *(np.zeros(size) for size in (n, n, m, r, 1, r, r, r)))


@lean_kernel
def to_axes(turning: bool, psi: float, vector: Array, out: Array) -> None:
    """Transform a vector to axes turned by psi [rad]: rotate (x, y) of every triple by R(psi)'."""
    for i in range(vector.shape[0]):
        out[i] = vector[i]
    if turning:
        c, s = np.cos(psi), np.sin(psi)
        for i in range(0, vector.shape[0] - 1, 3):
            a, b = vector[i], vector[i + 1]
            out[i], out[i + 1] = c * a + s * b, c * b - s * a


@lean_kernel
def add_product(matrix: Array, vector: Array, out: Array) -> None:
    """Add a matrix times a vector to `out`."""
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            out[i] += matrix[i, j] * vector[j]


@lean_kernel
def product(matrix: Array, vector: Array, out: Array) -> None:
    """Write a matrix times a vector to `out`."""
    for i in range(matrix.shape[0]):
        out[i] = 0.0
    add_product(matrix, vector, out)


@lean_kernel
def heading(observer: Observer, x: Array) -> float:
    """Heading of the axes in which the model holds [rad]."""
    return x[2] if observer.turning else 0.0


@lean_kernel
def known_force(
    observer: Observer, psi: float, velocity: Array, outlook: Outlook, k: int, noise: bool,
    out: Array,
) -> None:  # fmt: skip
    """Write the known disturbance at rest, d = -F(0, 0, psi, nu_q), in body axes [N, Nm]."""
    z = observer.z
    z[COS_PSI], z[SIN_PSI] = np.cos(psi), np.sin(psi)
    z[N_VARIABLES + COS_PSI], z[N_VARIABLES + SIN_PSI] = abs(z[COS_PSI]), abs(z[SIN_PSI])
    if outlook.wind_ned.shape[0] > 0 and observer.still.aerodynamic:
        row = min(k, outlook.wind_ned.shape[0] - 1)
        north, east = outlook.wind_ned[row, 0], outlook.wind_ned[row, 1]
        ahead = z[COS_PSI] * north + z[SIN_PSI] * east
        aside = z[COS_PSI] * east - z[SIN_PSI] * north
        if noise and row < outlook.wind_noise.shape[0]:
            ahead += outlook.wind_noise[row, 0]
            aside += outlook.wind_noise[row, 1]
        u = velocity[observer.north] - ahead if observer.north >= 0 else 0.0
        v = velocity[observer.east] - aside if observer.east >= 0 else 0.0
        fill_air_kernel(z, u, v)
    features_kernel(observer.still.codes, z, observer.phi)
    weighted_sum_kernel(observer.still.theta, observer.phi, out)
    for i in range(out.shape[0]):
        out[i] = -out[i]


@lean_kernel
def estimate(observer: Observer, past: Memory, eta: Array, nu: Array) -> None:
    """Update the state to this instant: predict and correct it, or take the measured one.

    x <- A x + B (u + d + b + a) is in the body axes of the last sample, relative to its pose. Then
    b <- exp(-h / T) b.
    """
    x, local, moved, force = past.x, observer.local, observer.moved, observer.force
    m, turning = eta.shape[0], observer.turning
    for i in range(x.shape[0]):
        past.x_last[i] = x[i]
    if observer.measured:
        for i in range(m):
            x[i], observer.error[i] = eta[i], nu[i]
        to_axes(turning, -heading(observer, x), observer.error, x[m:])
    elif past.instant[0] == 0:
        product(observer.start, eta, x)
    else:
        psi = heading(observer, x)
        to_axes(turning, psi, past.bias, force)
        for i in range(force.shape[0]):
            force[i] += past.command[i] + past.known[i] + past.added[i]
            past.bias[i] *= observer.bias_decay
        to_axes(turning, psi, x, local)
        if turning:
            local[0] = local[1] = local[2] = 0.0
        product(observer.A, local, moved)
        add_product(observer.B, force, moved)
        to_axes(turning, -psi, moved, local)
        for i in range(x.shape[0]):
            x[i] = local[i] + (x[i] if turning and i < 3 else 0.0)
        correct(observer, past, eta)


@lean_kernel
def correct(observer: Observer, past: Memory, eta: Array) -> None:
    """x <- x + M (y - C x), with the innovation in the predicted body axes."""
    x, error, change, r = past.x, observer.error, observer.moved, past.bias.shape[0]
    for i in range(error.shape[0]):
        change[i] = eta[i]
        for j in range(x.shape[0]):
            change[i] -= observer.C[i, j] * x[j]
        if not np.isfinite(change[i]):
            return
    psi = heading(observer, x)
    to_axes(observer.turning, psi, change[: error.shape[0]], error)
    if observer.turning:
        error[2] = wrap_kernel(error[2])
    product(observer.M, error, observer.local)
    to_axes(observer.turning, -psi, observer.local, change)
    for i in range(x.shape[0]):
        x[i] += change[i]
    product(observer.bias_gain, error, observer.force)
    to_axes(observer.turning, -psi, observer.force, observer.local[:r])
    for i in range(r):
        past.bias[i] += observer.local[i]


@lean_kernel
def remember(
    observer: Observer, past: Memory, psi: float, eta: Array, known: Array, outlook: Outlook
) -> None:
    """Store the pose, the known disturbance and the added force for the next sample."""
    if observer.smooth:
        product(observer.C, past.x, past.y_last)
    for i in range(eta.shape[0]):
        if np.isfinite(eta[i]) and not observer.smooth:
            past.y_last[i] = eta[i]
    k = past.instant[0]
    for i in range(known.shape[0]):
        if np.isfinite(known[i]):  # else an anemometer has failed: as at the last sample
            past.known[i] = known[i]
        past.added[i] = outlook.added[k, i] if k < outlook.added.shape[0] else 0.0
    past.axes[0] = psi


@dataclass(frozen=True)
class Kalman:
    """Noise of the Kalman filter as standard deviations, one per degree of freedom.

    `process`: acceleration, constant over a sample [m/s^2, rad/s^2]. `measurement`: pose [m, rad].
    `bias_walk`: change of the unknown disturbance in one second [N, Nm], used if `estimate_bias`
    is true; an axis with zero has no such disturbance. It grows without bound, or is a process of
    first order with `bias_time_constant_s` T, whose standard deviation is then the walk times
    sqrt(T / 2). For an identified state-space model its identified gain is used instead.
    """

    process: Annotated[tuple[float, ...], FromVessel("tuning.control.process")]
    measurement: Annotated[tuple[float, ...], FromVessel("tuning.control.measurement")]
    bias_walk: Annotated[tuple[NotNegative, ...], FromVessel("tuning.control.bias_walk")]
    estimate_bias: bool
    bias_time_constant_s: Positive | None = None  # None: a random walk

    def __post_init__(self) -> None:
        check_ranges(self)
        for name in ("process", "measurement"):
            check_weights(name, getattr(self, name), len(self.process), positive=True)
        if len(self.bias_walk) != len(self.process) or max(self.bias_walk, default=0.0) <= 0.0:
            raise ConfigurationError(
                f"bias_walk must be {len(self.process)} numbers, one of them positive, "
                f"got {list(self.bias_walk)}"
            )

    def bias_decay(self, period_s: float) -> float:
        """Factor exp(-h / T) of the bias over one sample [s]; 1 for a random walk."""
        return float(np.exp(-period_s / (self.bias_time_constant_s or np.inf)))

    def gains(self, design: DesignModel) -> tuple[Array, Array]:
        """Filter gain M (n, m) and bias gain (r, m), the latter as a fraction of the limits."""
        model, n, r = design.model, design.model.order, len(design.limits)
        A, C, h = model.A, model.C, design.period_s
        bias = np.zeros((r, len(C)))
        if not design.physical:
            if self.estimate_bias or model.K is None:
                got = "estimate_bias" if self.estimate_bias else "a model without innovations gain"
                raise ConfigurationError(
                    f"controller.kalman: got {got}, expected the gain of an identified state-space "
                    "model"
                )
            M = np.linalg.lstsq(A, model.K, rcond=None)[0]  # of K = A M
            return np.asarray(M, dtype=np.float64), bias
        if len(self.process) != r:
            raise ConfigurationError(
                f"controller.kalman.process: got {len(self.process)} numbers, expected {r}"
            )
        shock = np.vstack([0.5 * h**2 * np.eye(r), h * np.eye(r)])
        Q, R = shock @ np.diag(np.square(self.process)) @ shock.T, np.square(self.measurement)
        drifts = np.flatnonzero(self.bias_walk) if self.estimate_bias else np.zeros(0, dtype=int)
        b, T = len(drifts), self.bias_time_constant_s
        time = h if T is None else -0.5 * T * np.expm1(-2.0 * h / T)
        added = np.square(np.array(self.bias_walk) / design.limits)[drifts] * time  # in a sample
        A = np.block([[A, model.B[:, drifts]], [np.zeros((b, n)), self.bias_decay(h) * np.eye(b)]])
        C = np.hstack([C, np.zeros((len(C), b))])
        M = filter_gain(A, C, scipy.linalg.block_diag(Q, np.diag(added)), np.diag(R))
        bias[drifts] = M[n:]
        return M[:n], bias


def filter_gain(A: Array, C: Array, Q: Array, R: Array) -> Array:
    """Steady-state filter gain M = P C' (C P C' + R)^-1 with P = A P A' - A M C P A' + Q.

    A is (n, n), C (m, n), Q (n, n), R (m, m); M has shape (n, m). The gain of the predictor is
    A M. Raises ConfigurationError when the Riccati equation has no solution.
    """
    P = riccati(A.T, C.T, Q, R, "controller.kalman: the filter has no steady-state gain")
    return np.asarray(np.linalg.solve(C @ P @ C.T + R, C @ P).T, dtype=np.float64)


Estimator = Literal["kalman", "measured"]


def observer_of(design: DesignModel, kind: Estimator, kalman: Kalman) -> Observer:
    """Table of a design model and its estimator, for the kernels.

    Raises ConfigurationError for an estimator that does not fit the model.
    """
    model, (n, r), m = design.model, design.model.B.shape, len(design.model.C)
    measured, velocities = kind == "measured", ("surge", "sway")
    if measured and (kalman.estimate_bias or not design.physical):
        raise ConfigurationError(
            "controller.estimator: got measured, expected kalman for kalman.estimate_bias and for "
            "an identified state-space model, whose state cannot be measured"
        )
    M, bias = (np.zeros((n, m)), np.zeros((r, m))) if measured else kalman.gains(design)
    still, z = design.still.force_table(), np.zeros(2 * N_VARIABLES)
    z[CONSTANT] = z[N_VARIABLES + CONSTANT] = 1.0
    own = model.A, model.B / design.limits, model.C, M, design.limits[:, None] * bias
    A, B, C, M, bias, start = map(np.ascontiguousarray, (*own, design.start()))
    north, east = (design.dofs.index(dof) if dof in design.dofs else -1 for dof in velocities)
    return Observer(
        A, B, C, M, bias, start, design.limits, kalman.bias_decay(design.period_s), design.turning,
        measured, kalman.estimate_bias, still, north, east, z, np.zeros(len(still.codes)),
        np.zeros(m), np.zeros(n), np.zeros(n), np.zeros(r),
    )  # fmt: skip


def estimator_diagnostics(table: Observer) -> list[Diagnostic]:
    """Spectral radius of the estimation error, A - A M C, without the bias."""
    if table.measured:
        return []
    error = table.A - table.A @ table.M @ table.C
    return [Diagnostic("estimator_radius", "all", spectral_radius(error))]
