"""Rates of pose and velocity, and their integration over a control period.

    eta_dot = J(eta) nu,    nu_dot = M^-1 (tau + J(eta)' f - F(0, nu_r, attitude, nu_q)) + w

with the force f given in NED, the velocity through the water nu_r = nu - nu_c, that through the
air nu_q = nu - nu_w, and the process noise w. A stream that is constant in NED turns in body axes
with the vessel, d nu_c / dt = -S(omega) nu_c: in a uniform current a vessel moves as in still
water, seen from the water (Fossen (2011), section 8.3.1). A table without Coriolis forces leaves
this out as it leaves them out. A current that varies is taken as constant over a control period:
the forces of accelerated water are neglected.

The kinematics J are chosen by the type of a named tuple of `seatrial.models.vessel.pose`, so that
each is compiled without the others.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload

from seatrial.models.compiled import LEAN, lean_kernel
from seatrial.models.vessel.basis import INDEX, N_VARIABLES, Array, features_kernel
from seatrial.models.vessel.kinematics import (
    angle_rate_kernel,
    fill_attitude_kernel,
    frame_of_angles_kernel,
    frame_of_quaternion_kernel,
    quaternion_rate_kernel,
)
from seatrial.models.vessel.pose import Axes, Euler, Planar, Quaternion, normalise
from seatrial.models.vessel.table import (
    PlantTable,
    fill_air_kernel,
    fill_variables_kernel,
    weighted_sum_kernel,
)
from seatrial.models.vessel.thruster import LagTable, step_lag_kernel
from seatrial.models.weather.weather import Weather

COS_PSI = INDEX["cos(psi)"]
SIN_PSI = INDEX["sin(psi)"]
RATES: dict[type, Callable[..., None]] = {}


class Scratch(NamedTuple):
    """Work space of the right-hand side."""

    z: Array
    phi: Array
    rest: Array
    frame: Array  # (3, 3) rotation from body to NED
    through: Array  # velocity through the water
    tau: Array  # acting force at a stage
    nu: Array  # velocity and pose at a stage, their rates, and the weighted sums of these
    nu_dot: Array
    nu_sum: Array
    eta: Array
    eta_dot: Array
    eta_sum: Array


def scratch(n_terms: int, n_dof: int, n_pose: int) -> Scratch:
    """Work space for a plant of some terms, velocities and pose coordinates."""
    z = np.zeros(2 * N_VARIABLES)
    z[0] = z[N_VARIABLES] = 1.0
    velocities = (np.zeros(n_dof) for _ in range(6))
    poses = (np.zeros(n_pose) for _ in range(3))
    rest = next(velocities)
    return Scratch(z, np.empty(n_terms), rest, np.zeros((3, 3)), *velocities, *poses)


def rates(
    kinematics: Any, plant: PlantTable, eta: Array, nu: Array, tau: Array, weather: Weather,
    k: int, work: Scratch, eta_dot: Array, nu_dot: Array,
) -> None:  # fmt: skip
    """Write eta_dot and nu_dot under the force tau and row k of the weather."""
    RATES[type(kinematics)](kinematics, plant, eta, nu, tau, weather, k, work, eta_dot, nu_dot)


@overload(rates, jit_options=LEAN)
def _rates(
    kinematics: Any, plant: Any, eta: Any, nu: Any, tau: Any, weather: Any, k: Any, work: Any,
    eta_dot: Any, nu_dot: Any,
) -> Any:  # fmt: skip
    step = RATES[kinematics.instance_class]

    def chosen(
        kinematics: Any, plant: Any, eta: Any, nu: Any, tau: Any, weather: Any, k: Any, work: Any,
        eta_dot: Any, nu_dot: Any,
    ) -> None:  # fmt: skip
        step(kinematics, plant, eta, nu, tau, weather, k, work, eta_dot, nu_dot)

    return chosen


@lean_kernel
def unmet_force(plant: PlantTable, tau: Array, work: Scratch) -> None:
    """rest = tau - F(0, nu_r, attitude, nu_q), of the variables that stand in the work space."""
    features_kernel(plant.codes, work.z, work.phi)
    weighted_sum_kernel(plant.theta, work.phi, work.rest)
    for i in range(tau.shape[0]):
        work.rest[i] = tau[i] - work.rest[i]


@lean_kernel
def accelerate(plant: PlantTable, rest: Array, process: Array, nu_dot: Array) -> None:
    """nu_dot = M^-1 rest + w."""
    n = rest.shape[0]
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += plant.inverse_inertia[i, j] * rest[j]
        nu_dot[i] = total + process[i]


@lean_kernel
def _axes_rates(
    axes: Axes, plant: PlantTable, eta: Array, nu: Array, tau: Array, weather: Weather, k: int,
    work: Scratch, eta_dot: Array, nu_dot: Array,
) -> None:  # fmt: skip
    """Each axis alone; a current along north and east meets surge and sway."""
    for i in range(nu.shape[0]):
        eta_dot[i] = work.through[i] = nu[i]
    if axes.north >= 0:
        work.through[axes.north] -= weather.current_ned[k, 0]
    if axes.east >= 0:
        work.through[axes.east] -= weather.current_ned[k, 1]
    fill_variables_kernel(work.z, plant.velocity_index, work.through)
    if plant.aerodynamic:
        ahead = nu[axes.north] - weather.wind_ned[k, 0] if axes.north >= 0 else 0.0
        aside = nu[axes.east] - weather.wind_ned[k, 1] if axes.east >= 0 else 0.0
        fill_air_kernel(work.z, ahead, aside)
    unmet_force(plant, tau, work)
    for i in range(nu.shape[0]):
        work.rest[i] += weather.force_ned[k, i]
    accelerate(plant, work.rest, weather.process[k], nu_dot)


RATES[Axes] = _axes_rates


@lean_kernel
def _planar_rates(
    planar: Planar, plant: PlantTable, eta: Array, nu: Array, tau: Array, weather: Weather, k: int,
    work: Scratch, eta_dot: Array, nu_dot: Array,
) -> None:  # fmt: skip
    """eta_dot = R(psi) nu; vectors in NED are seen from body axes by R(psi)'."""
    c, s = np.cos(eta[2]), np.sin(eta[2])
    work.z[COS_PSI], work.z[SIN_PSI] = c, s
    work.z[N_VARIABLES + COS_PSI], work.z[N_VARIABLES + SIN_PSI] = abs(c), abs(s)
    eta_dot[0] = c * nu[0] - s * nu[1]
    eta_dot[1] = s * nu[0] + c * nu[1]
    eta_dot[2] = nu[2]
    north, east = weather.current_ned[k, 0], weather.current_ned[k, 1]
    ahead, aside = c * north + s * east, c * east - s * north
    work.through[0], work.through[1], work.through[2] = nu[0] - ahead, nu[1] - aside, nu[2]
    fill_variables_kernel(work.z, plant.velocity_index, work.through)
    if plant.aerodynamic:
        north, east = weather.wind_ned[k, 0], weather.wind_ned[k, 1]
        fill_air_kernel(work.z, nu[0] - (c * north + s * east), nu[1] - (c * east - s * north))
    unmet_force(plant, tau, work)
    north, east = weather.force_ned[k, 0], weather.force_ned[k, 1]
    work.rest[0] += c * north + s * east
    work.rest[1] += c * east - s * north
    work.rest[2] += weather.force_ned[k, 2]
    accelerate(plant, work.rest, weather.process[k], nu_dot)
    if plant.turning:
        nu_dot[0] += nu[2] * aside
        nu_dot[1] -= nu[2] * ahead


RATES[Planar] = _planar_rates


@lean_kernel
def _spatial_rates(
    plant: PlantTable, eta: Array, nu: Array, tau: Array, weather: Weather, k: int, work: Scratch,
    eta_dot: Array, nu_dot: Array,
) -> None:  # fmt: skip
    """All rates but that of the attitude, which stands in work.frame and work.z."""
    R, stream = work.frame, work.through
    for i in range(3):
        eta_dot[i] = R[i, 0] * nu[0] + R[i, 1] * nu[1] + R[i, 2] * nu[2]
        stream[i] = R[0, i] * weather.current_ned[k, 0] + R[1, i] * weather.current_ned[k, 1]
    ahead, aside, below = stream[0], stream[1], stream[2]
    for i in range(3):
        work.through[i] = nu[i] - stream[i]
        work.through[3 + i] = nu[3 + i]
    fill_variables_kernel(work.z, plant.velocity_index, work.through)
    if plant.aerodynamic:
        north, east = weather.wind_ned[k, 0], weather.wind_ned[k, 1]
        through = nu[0] - R[0, 0] * north - R[1, 0] * east
        fill_air_kernel(work.z, through, nu[1] - R[0, 1] * north - R[1, 1] * east)
    unmet_force(plant, tau, work)
    force = weather.force_ned[k]
    for i in range(3):
        work.rest[i] += R[0, i] * force[0] + R[1, i] * force[1] + R[2, i] * force[2]
        work.rest[3 + i] += R[0, i] * force[3] + R[1, i] * force[4] + R[2, i] * force[5]
    accelerate(plant, work.rest, weather.process[k], nu_dot)
    if plant.turning:
        nu_dot[0] -= nu[4] * below - nu[5] * aside
        nu_dot[1] -= nu[5] * ahead - nu[3] * below
        nu_dot[2] -= nu[3] * aside - nu[4] * ahead


@lean_kernel
def _quaternion_rates(
    kinematics: Quaternion, plant: PlantTable, eta: Array, nu: Array, tau: Array,
    weather: Weather, k: int, work: Scratch, eta_dot: Array, nu_dot: Array,
) -> None:  # fmt: skip
    """Hoyer (2021), eqs. (2.2)-(2.3) and (2.20)."""
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
    """The same with the attitude in angles."""
    frame_of_angles_kernel(eta[3:], work.frame)
    fill_attitude_kernel(work.z, work.frame)
    angle_rate_kernel(eta[3:], nu[3], nu[4], nu[5], eta_dot[3:])
    _spatial_rates(plant, eta, nu, tau, weather, k, work, eta_dot, nu_dot)


RATES[Euler] = _euler_rates


@lean_kernel
def _step(
    kinematics: Any, plant: PlantTable, lag: LagTable, thrust: Array, command: Array, eta: Array,
    nu: Array, weather: Weather, k: int, h: float, euler: bool, work: Scratch,
) -> None:  # fmt: skip
    """One step of eta, nu and (exactly) of the thrust (n_dof, 2), in place.

    Classical Runge-Kutta with stages at 0, h/2, h/2 and h, or forward Euler with one at 0; `lag`
    is the thruster's step of h/2.
    """
    stages = 1 if euler else 4
    for i in range(eta.shape[0]):
        work.eta[i], work.eta_sum[i] = eta[i], 0.0
    for i in range(nu.shape[0]):
        work.nu[i], work.nu_sum[i] = nu[i], 0.0
    for stage in range(stages):
        if stage == 1 or stage == 3:
            step_lag_kernel(lag, thrust, command)
        for i in range(nu.shape[0]):
            work.tau[i] = thrust[i, 0]
        rates(
            kinematics, plant, work.eta, work.nu, work.tau, weather, k, work, work.eta_dot,
            work.nu_dot,
        )  # fmt: skip
        weight = h / 6.0 if stage == 0 or stage == 3 else h / 3.0
        if euler:
            weight = h
            step_lag_kernel(lag, thrust, command)
            step_lag_kernel(lag, thrust, command)
        reach = h if stage == 2 else 0.5 * h
        for i in range(eta.shape[0]):
            work.eta_sum[i] += weight * work.eta_dot[i]
            work.eta[i] = eta[i] + reach * work.eta_dot[i]
        for i in range(nu.shape[0]):
            work.nu_sum[i] += weight * work.nu_dot[i]
            work.nu[i] = nu[i] + reach * work.nu_dot[i]
    for i in range(eta.shape[0]):
        eta[i] += work.eta_sum[i]
    for i in range(nu.shape[0]):
        nu[i] += work.nu_sum[i]
    normalise(kinematics, eta)


@lean_kernel
def advance(
    kinematics: Any, plant: PlantTable, lag: LagTable, thrust: Array, command: Array, eta: Array,
    nu: Array, weather: Weather, k: int, h: float, substeps: int, work: Scratch,
    euler: bool = False,
) -> None:  # fmt: skip
    """Advance pose, velocity and thrust (n_dof, 2) over one control period; command held."""
    if lag.direct:
        step_lag_kernel(lag, thrust, command)
    for _ in range(substeps):
        _step(
            kinematics, plant, lag, thrust, command, eta, nu, weather, k, h, euler, work,
        )  # fmt: skip
