"""Rates of pose and velocity, and their integration over a control period.

    eta_dot = J(eta) nu,    nu_dot = M^-1 (tau + J(eta)' f - F(0, nu_r, attitude, nu_q)) + w

where tau is what acts: the force on the axes or, for a vessel with inputs, the forces of its
devices under these inputs, tau(nu_r, inputs); f is the force in NED, nu_r = nu - nu_c the velocity
through the water, nu_q = nu - nu_w that through the air, and w the process noise. A current that is
constant in NED rotates in body axes when the vessel turns, d nu_c / dt = -S(omega) nu_c: in a
uniform current a vessel moves relative to the water as in still water (Fossen (2011), section
8.3.1). This term is omitted for a table without Coriolis forces. A varying current is taken as
constant over a control period; the forces due to accelerated water are neglected.

The kinematics J are selected by the type of a named tuple of `pose`, so that each is compiled
without the others. The closed loop, the free run of one model and the free runs of many candidates
all use `step`: its arrays hold numbers, or packs of numbers (`seatrial.models.packs`) for many
candidates in parallel. Therefore no branch here may depend on the state; `where` is used instead.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba.extending import overload

from seatrial.models.compiled import LEAN, lean_kernel, tuple_of
from seatrial.models.elementary import angle_of, where
from seatrial.models.vessel.basis import INDEX, N_VARIABLES, REST_M_S, Array, features_kernel
from seatrial.models.vessel.devices.device import FORCES, MAX_DEVICES, WAKE, exert
from seatrial.models.vessel.kinematics import (
    angle_rate_kernel,
    fill_attitude_kernel,
    frame_of_angles_kernel,
    frame_of_quaternion_kernel,
    quaternion_rate_kernel,
)
from seatrial.models.vessel.plant_table import PlantTable
from seatrial.models.vessel.pose import (
    Axes,
    Euler,
    Kinematics,
    Planar,
    Quaternion,
    Rolling,
    normalise,
)
from seatrial.models.vessel.table import fill_air_kernel
from seatrial.models.vessel.thruster import LagTable, step_direct_kernel, step_lag_kernel
from seatrial.models.weather.weather import Weather

COS_PHI, COS_THETA, COS_PSI = INDEX["cos(phi)"], INDEX["cos(theta)"], INDEX["cos(psi)"]
SIN_PSI = INDEX["sin(psi)"]
PHI, THETA = INDEX["phi"], INDEX["theta"]
U, V, W, SPEED = INDEX["u"], INDEX["v"], INDEX["w"], INDEX["U"]
OVER_SPEED, OVER_SQUARE, BETA = INDEX["1/U"], INDEX["1/U^2"], INDEX["beta"]
WORK_SHAPE = (2, 3, 12)  # of a work space; at most 12 inputs
RATES: dict[type, Callable[..., None]] = {}


class Scratch(NamedTuple):
    """Work space of a step, of numbers or of packs."""

    z: Array
    phi: Array
    frame: Array  # (3, 12), of which (3, 3) is the rotation from body to NED
    acting: Array  # (3, 12): forces (n_dof) or inputs at the start, in the middle and at the end
    stream: Array  # (3,) velocity of the water in body axes
    limited: Array  # (1,) number of rates that had to be limited
    rest: Array
    through: Array  # velocity through the water
    nu: Array  # velocity and pose at a stage, their rates, and the weighted sums of these
    nu_dot: Array
    nu_sum: Array
    eta: Array
    eta_dot: Array
    eta_sum: Array
    made: Array  # (6,) forces of the devices
    wake: Array  # what each device leaves for those behind it


def scratch(
    n_terms: int, n_dof: int, n_pose: int, zeros: Callable[..., Array] = np.zeros
) -> Scratch:
    """Work space for numbers of terms, velocities and pose coordinates, in two arrays of `zeros`.

    For packs these have one more axis, see `seatrial.models.packs`.
    """
    sizes = (
        2 * N_VARIABLES, n_terms, 3, 1, *[n_dof] * 5, *[n_pose] * 3, FORCES, WAKE * MAX_DEVICES,
    )  # fmt: skip
    ends = np.cumsum(sizes)
    vectors, matrices = zeros((ends[-1],)), zeros(WORK_SHAPE)
    z, phi, *rest = (vectors[end - size : end] for size, end in zip(sizes, ends, strict=True))
    for i in (0, COS_PHI, COS_THETA, COS_PSI):  # level, and heading north
        z[i] = z[N_VARIABLES + i] = 1.0
    return Scratch(z, phi, matrices[0], matrices[1], *rest)


def rates(
    kinematics: Kinematics, plant: PlantTable, eta: Array, nu: Array, tau: Array, weather: Weather,
    k: int, work: Scratch, eta_dot: Array, nu_dot: Array,
) -> None:  # fmt: skip
    """Write eta_dot and nu_dot under the force tau and row k of the weather."""
    RATES[type(kinematics)](kinematics, plant, eta, nu, tau, weather, k, work, eta_dot, nu_dot)


@overload(rates, jit_options=LEAN)
def _rates(
    kinematics: Kinematics, plant: PlantTable, eta: Array, nu: Array, tau: Array, weather: Weather,
    k: int, work: Scratch, eta_dot: Array, nu_dot: Array,
) -> Callable[..., None]:  # fmt: skip
    step = RATES[tuple_of(kinematics)]

    def kernel(
        kinematics: Kinematics, plant: PlantTable, eta: Array, nu: Array, tau: Array,
        weather: Weather, k: int, work: Scratch, eta_dot: Array, nu_dot: Array,
    ) -> None:  # fmt: skip
        step(kinematics, plant, eta, nu, tau, weather, k, work, eta_dot, nu_dot)

    return kernel


@lean_kernel
def _net_force(plant: PlantTable, acting: Array, work: Scratch) -> None:
    """Write rest = tau - F(0, nu_r, attitude, nu_q) for the variables in the work space."""
    steered = plant.inputs.shape[0] > 0
    if steered:
        for j in range(plant.inputs.shape[0]):
            work.z[plant.inputs[j]] = acting[j]
            work.z[N_VARIABLES + plant.inputs[j]] = abs(acting[j])
        for i in range(FORCES):
            work.made[i] = 0.0
        exert(plant.devices, plant.parameters, work.z, work.wake, work.made)
    features_kernel(plant.codes, work.z, work.phi)
    for i in range(work.rest.shape[0]):
        total = 0.0
        for entry in range(plant.first[i], plant.first[i + 1]):
            total += plant.entries[entry] * work.phi[plant.term[entry]]
        work.rest[i] = (work.made[plant.axes[i]] if steered else acting[i]) - total


@lean_kernel
def _accelerate(plant: PlantTable, weather: Weather, k: int, rest: Array, nu_dot: Array) -> None:
    """Write nu_dot = M^-1 rest + w."""
    n = rest.shape[0]
    for i in range(n):
        total = 0.0
        for j in range(n):
            if plant.coupled[i, j]:
                total += plant.inverse_inertia[i, j] * rest[j]
        nu_dot[i] = total
    if weather.process.shape[0] > 0:
        for i in range(n):
            nu_dot[i] += weather.process[k, i]


@lean_kernel
def _fill_velocities(plant: PlantTable, nu: Array, z: Array) -> None:
    """Write velocities, and the magnitudes that are used, into z = [x, |x|]."""
    for i in range(nu.shape[0]):
        z[plant.velocity_index[i]] = nu[i]
    for place in plant.magnitudes:
        z[N_VARIABLES + plant.velocity_index[place]] = abs(nu[place])
    if plant.speed:
        speed = np.sqrt(z[U] * z[U] + z[V] * z[V] + z[W] * z[W])
        moving = speed > REST_M_S
        over = where(moving, 1.0 / where(moving, speed, 1.0), 0.0)
        z[SPEED], z[OVER_SPEED], z[OVER_SQUARE] = speed, over, over * over
    if plant.sideslip:
        angle = angle_of(z[V], z[U])
        z[BETA], z[N_VARIABLES + BETA] = angle, abs(angle)


@lean_kernel
def _fill_angle(z: Array, at: int, angle: float) -> None:
    """Write cosine and sine of an angle, and their magnitudes, into z = [x, |x|] from `at` on."""
    c, s = np.cos(angle), np.sin(angle)
    z[at], z[at + 1] = c, s
    z[N_VARIABLES + at], z[N_VARIABLES + at + 1] = abs(c), abs(s)


@lean_kernel
def _fill_inclination(z: Array, at: int, angle: float) -> None:
    """Write an angle of roll or pitch and its magnitude into z = [x, |x|]."""
    z[at], z[N_VARIABLES + at] = angle, abs(angle)


@lean_kernel
def _axes_rates(
    axes: Axes, plant: PlantTable, eta: Array, nu: Array, tau: Array, weather: Weather, k: int,
    work: Scratch, eta_dot: Array, nu_dot: Array,
) -> None:  # fmt: skip
    """Rates of independent axes; surge and sway are along north and east."""
    for i in range(nu.shape[0]):
        eta_dot[i] = nu[i]
    if axes.roll >= 0:
        _fill_angle(work.z, COS_PHI, eta[axes.roll])
        _fill_inclination(work.z, PHI, eta[axes.roll])
    if axes.pitch >= 0:
        _fill_angle(work.z, COS_THETA, eta[axes.pitch])
        _fill_inclination(work.z, THETA, eta[axes.pitch])
    if axes.yaw >= 0:
        _fill_angle(work.z, COS_PSI, eta[axes.yaw])
    through = nu
    if weather.current_ned.shape[0] > 0:
        through = work.through
        for i in range(nu.shape[0]):
            through[i] = nu[i]
        if axes.north >= 0:
            through[axes.north] -= weather.current_ned[k, 0]
        if axes.east >= 0:
            through[axes.east] -= weather.current_ned[k, 1]
    _fill_velocities(plant, through, work.z)
    if plant.aerodynamic:
        ahead = nu[axes.north] if axes.north >= 0 else 0.0
        aside = nu[axes.east] if axes.east >= 0 else 0.0
        if weather.wind_ned.shape[0] > 0:
            ahead -= weather.wind_ned[k, 0] if axes.north >= 0 else 0.0
            aside -= weather.wind_ned[k, 1] if axes.east >= 0 else 0.0
        if weather.wind_body.shape[0] > 0:
            ahead, aside = ahead - weather.wind_body[k, 0], aside - weather.wind_body[k, 1]
        fill_air_kernel(work.z, ahead, aside)
    _net_force(plant, tau, work)
    if weather.force_ned.shape[0] > 0:
        for i in range(nu.shape[0]):
            work.rest[i] += weather.force_ned[k, i]
    _accelerate(plant, weather, k, work.rest, nu_dot)


RATES[Axes] = _axes_rates


@lean_kernel
def _horizontal_rates(
    upright: float, plant: PlantTable, nu: Array, tau: Array, weather: Weather, k: int,
    work: Scratch, eta_dot: Array, nu_dot: Array,
) -> None:  # fmt: skip
    """Rates of a vessel without pitch at the heading in `work.z`; `upright` is cos(phi)."""
    c, s, yaw = work.z[COS_PSI], work.z[SIN_PSI], nu.shape[0] - 1
    eta_dot[0] = c * nu[0] - s * nu[1] * upright
    eta_dot[1] = s * nu[0] + c * nu[1] * upright
    eta_dot[2] = nu[2]
    eta_dot[yaw] = nu[yaw] * upright
    through = nu
    if weather.current_ned.shape[0] > 0:
        through, stream = work.through, work.stream
        north, east = weather.current_ned[k, 0], weather.current_ned[k, 1]
        stream[0], stream[1] = c * north + s * east, (c * east - s * north) * upright
        through[0], through[1] = nu[0] - stream[0], nu[1] - stream[1]
        through[2], through[yaw] = nu[2], nu[yaw]
    _fill_velocities(plant, through, work.z)
    if plant.aerodynamic:
        ahead, aside = nu[0], nu[1]
        if weather.wind_ned.shape[0] > 0:
            north, east = weather.wind_ned[k, 0], weather.wind_ned[k, 1]
            ahead -= c * north + s * east
            aside -= (c * east - s * north) * upright
        if weather.wind_body.shape[0] > 0:
            ahead, aside = ahead - weather.wind_body[k, 0], aside - weather.wind_body[k, 1]
        fill_air_kernel(work.z, ahead, aside)
    _net_force(plant, tau, work)
    if weather.force_ned.shape[0] > 0:
        north, east = weather.force_ned[k, 0], weather.force_ned[k, 1]
        work.rest[0] += c * north + s * east
        work.rest[1] += (c * east - s * north) * upright
        for i in range(2, nu.shape[0]):
            work.rest[i] += weather.force_ned[k, i]
    _accelerate(plant, weather, k, work.rest, nu_dot)
    if plant.turning and weather.current_ned.shape[0] > 0:
        nu_dot[0] += nu[yaw] * work.stream[1]
        nu_dot[1] -= nu[yaw] * work.stream[0]


@lean_kernel
def _planar_rates(
    planar: Planar, plant: PlantTable, eta: Array, nu: Array, tau: Array, weather: Weather, k: int,
    work: Scratch, eta_dot: Array, nu_dot: Array,
) -> None:  # fmt: skip
    """Rates of a planar vessel, eta_dot = R(psi) nu; R(psi)' maps vectors from NED to body axes."""
    _fill_angle(work.z, COS_PSI, eta[2])
    _horizontal_rates(1.0, plant, nu, tau, weather, k, work, eta_dot, nu_dot)


RATES[Planar] = _planar_rates


@lean_kernel
def _rolling_rates(
    rolling: Rolling, plant: PlantTable, eta: Array, nu: Array, tau: Array, weather: Weather,
    k: int, work: Scratch, eta_dot: Array, nu_dot: Array,
) -> None:  # fmt: skip
    """Rates in surge, sway, roll and yaw, without pitch. Fossen (2011), eq. (7.47)."""
    _fill_angle(work.z, COS_PHI, eta[2])
    _fill_inclination(work.z, PHI, eta[2])
    _fill_angle(work.z, COS_PSI, eta[3])
    _horizontal_rates(work.z[COS_PHI], plant, nu, tau, weather, k, work, eta_dot, nu_dot)


RATES[Rolling] = _rolling_rates


@lean_kernel
def _spatial_rates(
    plant: PlantTable, eta: Array, nu: Array, tau: Array, weather: Weather, k: int, work: Scratch,
    eta_dot: Array, nu_dot: Array,
) -> None:  # fmt: skip
    """All rates except that of the attitude, which is in work.frame and work.z."""
    R, stream = work.frame, work.stream
    for i in range(3):
        eta_dot[i] = R[i, 0] * nu[0] + R[i, 1] * nu[1] + R[i, 2] * nu[2]
    through = nu
    if weather.current_ned.shape[0] > 0:
        through = work.through
        for i in range(3):
            stream[i] = R[0, i] * weather.current_ned[k, 0] + R[1, i] * weather.current_ned[k, 1]
            through[i], through[3 + i] = nu[i] - stream[i], nu[3 + i]
    _fill_velocities(plant, through, work.z)
    if plant.aerodynamic:
        ahead, aside = nu[0], nu[1]
        if weather.wind_ned.shape[0] > 0:
            north, east = weather.wind_ned[k, 0], weather.wind_ned[k, 1]
            ahead = ahead - R[0, 0] * north - R[1, 0] * east
            aside = aside - R[0, 1] * north - R[1, 1] * east
        if weather.wind_body.shape[0] > 0:
            ahead, aside = ahead - weather.wind_body[k, 0], aside - weather.wind_body[k, 1]
        fill_air_kernel(work.z, ahead, aside)
    _net_force(plant, tau, work)
    if weather.force_ned.shape[0] > 0:
        force = weather.force_ned[k]
        for i in range(3):
            work.rest[i] += R[0, i] * force[0] + R[1, i] * force[1] + R[2, i] * force[2]
            work.rest[3 + i] += R[0, i] * force[3] + R[1, i] * force[4] + R[2, i] * force[5]
    _accelerate(plant, weather, k, work.rest, nu_dot)
    if plant.turning and weather.current_ned.shape[0] > 0:
        nu_dot[0] -= nu[4] * stream[2] - nu[5] * stream[1]
        nu_dot[1] -= nu[5] * stream[0] - nu[3] * stream[2]
        nu_dot[2] -= nu[3] * stream[1] - nu[4] * stream[0]


@lean_kernel
def _quaternion_rates(
    kinematics: Quaternion, plant: PlantTable, eta: Array, nu: Array, tau: Array,
    weather: Weather, k: int, work: Scratch, eta_dot: Array, nu_dot: Array,
) -> None:  # fmt: skip
    """Rates in six degrees of freedom. Hoyer (2021), eqs. (2.2)-(2.3) and (2.20)."""
    frame_of_quaternion_kernel(eta[3:], work.frame)
    fill_attitude_kernel(work.z, work.frame)
    quaternion_rate_kernel(eta[3:], nu[3], nu[4], nu[5], eta_dot[3:])
    _spatial_rates(plant, eta, nu, tau, weather, k, work, eta_dot, nu_dot)


RATES[Quaternion] = _quaternion_rates


@lean_kernel
def _euler_rates(
    kinematics: Euler, plant: PlantTable, eta: Array, nu: Array, tau: Array, weather: Weather,
    k: int, work: Scratch, eta_dot: Array, nu_dot: Array,
) -> None:  # fmt: skip
    """Rates in six degrees of freedom with the attitude in Euler angles."""
    frame_of_angles_kernel(eta[3:], work.frame)
    fill_attitude_kernel(work.z, work.frame)
    _fill_inclination(work.z, PHI, eta[3])
    _fill_inclination(work.z, THETA, eta[4])
    angle_rate_kernel(eta[3:], nu[3], nu[4], nu[5], eta_dot[3:])
    _spatial_rates(plant, eta, nu, tau, weather, k, work, eta_dot, nu_dot)


RATES[Euler] = _euler_rates


@lean_kernel
def _limited(rate: float, limit: float) -> float:
    """The rate limited to +-limit; a NaN becomes the limit."""
    below = where(rate < limit, rate, limit)
    return where(below > -limit, below, -limit)  # type: ignore[no-any-return]


@lean_kernel
def _weigh(
    stage: int, h: float, euler: bool, limit: float, x: Array, x_dot: Array, change: Array,
    ahead: Array,
) -> float:  # fmt: skip
    """Add the rate of a stage to the change over the step, and compute the state of the next stage.

    After the last stage `x` is updated. Returns the number of rates that were limited.
    """
    weight = h / 6.0 if stage == 0 or stage == 3 else h / 3.0
    reach = h if stage == 2 else 0.5 * h
    count = 0.0
    for i in range(x.shape[0]):
        rate = x_dot[i]
        if limit < np.inf:
            bounded = _limited(rate, limit)
            count += where(bounded != rate, 1.0, 0.0)
            rate = bounded
        if euler:
            x[i] += h * rate
        elif stage == 3:
            x[i] += change[i] + weight * rate
        else:
            change[i] = weight * rate + (change[i] if stage > 0 else 0.0)
            ahead[i] = x[i] + reach * rate
    return count


@lean_kernel
def step(
    kinematics: Kinematics, plant: PlantTable, force: Array, eta: Array, nu: Array,
    weather: Weather, k: int, h: float, euler: bool, limit: float, acceleration: float,
    work: Scratch, known: bool = False,
) -> None:  # fmt: skip
    """One step of pose and velocity, in place, under row k of the weather.

    Classical Runge-Kutta with stages at 0, h/2, h/2 and h, or forward Euler with one at 0; the
    force (3, n_dof) acts at the start, in the middle and at the end; for a steered vessel these are
    the inputs, (3, n_inputs). The rates of the pose are limited to +-limit [m/s, rad/s], those of
    the velocity to +-acceleration [m/s^2, rad/s^2] unless the first is infinite; `work.limited`
    counts the limited rates.
    If the rates at the start are `known`, `work` holds them.
    """
    for stage in range(1 if euler else 4):
        at_eta, at_nu = (work.eta, work.nu) if stage > 0 else (eta, nu)
        if stage > 0 or not known:
            rates(
                kinematics, plant, at_eta, at_nu, force[(stage + 1) // 2], weather, k, work,
                work.eta_dot, work.nu_dot,
            )  # fmt: skip
        count = _weigh(stage, h, euler, limit, eta, work.eta_dot, work.eta_sum, work.eta)
        count += _weigh(stage, h, euler, acceleration, nu, work.nu_dot, work.nu_sum, work.nu)
        if limit < np.inf:
            work.limited[0] += count
    normalise(kinematics, eta)


@lean_kernel
def advance(
    kinematics: Kinematics, plant: PlantTable, lag: LagTable, thrust: Array, command: Array,
    eta: Array, nu: Array, weather: Weather, k: int, h: float, substeps: int, work: Scratch,
    euler: bool = False, known: bool = False,
) -> None:  # fmt: skip
    """Advance pose, velocity and thrust (n, 2) over one control period; thrust is exact.

    The command (n,) is constant; `lag` is the discretised lag of the n thrusters, or inputs, for a
    step of h/2 [s]. If the rates under the thrust before the command are `known`, `work` holds
    them; they are computed again where the command changes the thrust immediately.
    """
    for i in range(thrust.shape[0]):
        work.acting[0, i] = thrust[i, 0]
    step_direct_kernel(lag, thrust, command)
    for i in range(thrust.shape[0]):
        known = known and thrust[i, 0] == work.acting[0, i]
    for part in range(substeps):
        for instant in range(3):
            if instant > 0:
                step_lag_kernel(lag, thrust, command)
            for i in range(thrust.shape[0]):
                work.acting[instant, i] = thrust[i, 0]
        step(
            kinematics, plant, work.acting, eta, nu, weather, k, h, euler, np.inf, np.inf, work,
            known and part == 0,
        )  # fmt: skip
