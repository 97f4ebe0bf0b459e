"""The closed loop: guidance, reference filter, controller, thrusters, vessel and weather.

At every control instant t_k the loop measures, logs the acceleration under the force that acts
just before the new command, asks the guidance law for a set-point and the controller for a
force, and then advances the vessel over one control period by RK4 while the command is held.

The loop knows no controller and no guidance law. Each registers its compiled step for its own
named tuple of parameters (`CONTROLLERS`, `GUIDANCE`), so the whole loop compiles with it, and
the same source runs in Python for a step that cannot be compiled.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload

from models.basis import N_VARIABLES, Array, features_kernel
from models.compiled import lean_kernel
from models.errors import ConfigurationError, Diverged
from models.kinematics import reference_in_body_kernel
from models.recording import Recording, attitude_of
from models.thruster import LagTable, SecondOrderLag, lag_table, step_lag_kernel
from models.vessel import (
    PLANAR,
    PlantTable,
    Vessel,
    fill_variables_kernel,
    weighted_sum_kernel,
)

COS_PSI = N_VARIABLES - 2
SIN_PSI = N_VARIABLES - 1

CONTROLLERS: dict[type, Callable[..., None]] = {}
GUIDANCE: dict[type, Callable[..., None]] = {}


class Weather(NamedTuple):
    """Realised disturbances, one row a control instant; SI units."""

    pose_noise: Array  # (N, n_dof), added to the measured pose
    velocity_noise: Array  # (N, n_dof)
    acceleration_noise: Array  # (N, n_dof), in the log only
    force_ned: Array  # (N, n_dof), NED [N, N, Nm]; along the axis where there is no heading


class FilterTable(NamedTuple):
    """Exact step of the reference filter: x <- a x + b r, x = (position, rate, acceleration)."""

    a: Array  # (3, 3)
    b: Array  # (3,)


class Log(NamedTuple):
    """What the loop writes, one row a control instant, shape (N, n_dof) each; SI units."""

    eta: Array  # true pose
    nu: Array  # true body velocity
    nu_dot: Array  # true acceleration under the force acting before the new command
    eta_measured: Array
    nu_measured: Array
    tau: Array  # command
    tau_actual: Array  # acting force, before the new command
    tau_fb: Array  # feedback share of the command
    eta_d: Array  # filtered reference
    nu_d: Array
    nu_dot_d: Array
    setpoint: Array


class Scratch(NamedTuple):
    """Work space of the right-hand side."""

    z: Array
    phi: Array
    rest: Array
    tau: Array  # acting force at a stage
    eta: Array  # pose and velocity at a stage, their rates, and the weighted sums of these
    nu: Array
    eta_dot: Array
    nu_dot: Array
    eta_sum: Array
    nu_sum: Array


def control_step(
    parameters: Any, state: Array, eta: Array, nu: Array, eta_d: Array, nu_d: Array,
    nu_dot_d: Array, tau: Array, tau_fb: Array,
) -> None:  # fmt: skip
    """One step of the controller registered for the type of `parameters`; writes tau, tau_fb."""
    CONTROLLERS[type(parameters)](parameters, state, eta, nu, eta_d, nu_d, nu_dot_d, tau, tau_fb)


@overload(control_step)
def _control_step(
    parameters: Any, state: Any, eta: Any, nu: Any, eta_d: Any, nu_d: Any, nu_dot_d: Any,
    tau: Any, tau_fb: Any,
) -> Any:  # fmt: skip
    step = CONTROLLERS[parameters.instance_class]

    def chosen(
        parameters: Any, state: Any, eta: Any, nu: Any, eta_d: Any, nu_d: Any, nu_dot_d: Any,
        tau: Any, tau_fb: Any,
    ) -> None:  # fmt: skip
        step(parameters, state, eta, nu, eta_d, nu_d, nu_dot_d, tau, tau_fb)

    return chosen


def guide_step(parameters: Any, state: Array, k: int, eta: Array, setpoint: Array) -> None:
    """One step of the guidance law registered for the type of `parameters`; writes setpoint."""
    GUIDANCE[type(parameters)](parameters, state, k, eta, setpoint)


@overload(guide_step)
def _guide_step(parameters: Any, state: Any, k: Any, eta: Any, setpoint: Any) -> Any:
    step = GUIDANCE[parameters.instance_class]

    def chosen(parameters: Any, state: Any, k: Any, eta: Any, setpoint: Any) -> None:
        step(parameters, state, k, eta, setpoint)

    return chosen


@lean_kernel
def _derivative(
    plant: PlantTable, planar: bool, eta: Array, nu: Array, tau: Array, force_ned: Array,
    scratch: Scratch, eta_dot: Array, nu_dot: Array,
) -> None:  # fmt: skip
    """eta_dot = R(psi) nu; nu_dot = M^-1 (tau + R(psi)' force_ned - F(0, nu, attitude))."""
    n = nu.shape[0]
    fill_variables_kernel(scratch.z, plant.velocity_index, nu)
    rest = scratch.rest
    if planar:
        c, s = np.cos(eta[2]), np.sin(eta[2])
        scratch.z[COS_PSI], scratch.z[SIN_PSI] = c, s
        eta_dot[0] = c * nu[0] - s * nu[1]
        eta_dot[1] = s * nu[0] + c * nu[1]
        eta_dot[2] = nu[2]
    else:
        for i in range(n):
            eta_dot[i] = nu[i]
    features_kernel(plant.codes, scratch.z, scratch.phi)
    weighted_sum_kernel(plant.theta, scratch.phi, rest)
    for i in range(n):
        rest[i] = tau[i] - rest[i]
    if planar:
        rest[0] += c * force_ned[0] + s * force_ned[1]
        rest[1] += c * force_ned[1] - s * force_ned[0]
        rest[2] += force_ned[2]
    else:
        for i in range(n):
            rest[i] += force_ned[i]
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += plant.inverse_inertia[i, j] * rest[j]
        nu_dot[i] = total


@lean_kernel
def _rk4_step(
    plant: PlantTable, planar: bool, lag: LagTable, thrust: Array, command: Array, eta: Array,
    nu: Array, force_ned: Array, h: float, scratch: Scratch,
) -> None:  # fmt: skip
    """One classical Runge-Kutta step of eta, nu and (exactly) of the thrust (n_dof, 2), in place.

    The stages stand at 0, h/2, h/2 and h; `lag` is the thruster's step of h/2.
    """
    n = nu.shape[0]
    for i in range(n):
        scratch.eta[i], scratch.nu[i] = eta[i], nu[i]
        scratch.eta_sum[i] = scratch.nu_sum[i] = 0.0
    for stage in range(4):
        if stage == 1 or stage == 3:
            step_lag_kernel(lag, thrust, command)
        for i in range(n):
            scratch.tau[i] = thrust[i, 0]
        _derivative(
            plant, planar, scratch.eta, scratch.nu, scratch.tau, force_ned, scratch,
            scratch.eta_dot, scratch.nu_dot,
        )  # fmt: skip
        weight = h / 6.0 if stage == 0 or stage == 3 else h / 3.0
        reach = h if stage == 2 else 0.5 * h
        for i in range(n):
            scratch.eta_sum[i] += weight * scratch.eta_dot[i]
            scratch.nu_sum[i] += weight * scratch.nu_dot[i]
            scratch.eta[i] = eta[i] + reach * scratch.eta_dot[i]
            scratch.nu[i] = nu[i] + reach * scratch.nu_dot[i]
    for i in range(n):
        eta[i] += scratch.eta_sum[i]
        nu[i] += scratch.nu_sum[i]


@lean_kernel
def _advance(
    plant: PlantTable, planar: bool, lag: LagTable, thrust: Array, command: Array, eta: Array,
    nu: Array, force_ned: Array, h: float, substeps: int, scratch: Scratch,
) -> None:  # fmt: skip
    """Advance pose, velocity and thrust (n_dof, 2) over one control period; command held."""
    if lag.direct:
        step_lag_kernel(lag, thrust, command)
    for _ in range(substeps):
        _rk4_step(plant, planar, lag, thrust, command, eta, nu, force_ned, h, scratch)


@lean_kernel
def _step_filter(table: FilterTable, state: Array, setpoint: Array) -> None:
    """Advance the reference filter of every axis; state (n_dof, 3)."""
    for i in range(state.shape[0]):
        x0, x1, x2 = state[i, 0], state[i, 1], state[i, 2]
        for j in range(3):
            a = table.a[j]
            state[i, j] = a[0] * x0 + a[1] * x1 + a[2] * x2 + table.b[j] * setpoint[i]


@lean_kernel
def _sail(
    plant: PlantTable, planar: bool, lag: LagTable, weather: Weather, guidance: Any,
    guidance_state: Array, table: FilterTable, reference: Array, controller: Any,
    controller_state: Array, thrust: Array, eta: Array, nu: Array, limits: Array, h: float,
    substeps: int, scratch: Scratch, log: Log,
) -> int:  # fmt: skip
    """Sail all rows of the log; the number of rows written, fewer when a limit was left."""
    n: int = log.eta.shape[0]
    n_dof = nu.shape[0]
    for k in range(n):
        for i in range(n_dof):
            if not abs(nu[i]) <= limits[i]:
                return k
        for i in range(n_dof):
            log.eta[k, i], log.nu[k, i], log.tau_actual[k, i] = eta[i], nu[i], thrust[i, 0]
            log.eta_measured[k, i] = eta[i] + weather.pose_noise[k, i]
            log.nu_measured[k, i] = nu[i] + weather.velocity_noise[k, i]
        force_ned = weather.force_ned[k]
        _derivative(
            plant,
            planar,
            eta,
            nu,
            log.tau_actual[k],
            force_ned,
            scratch,
            scratch.eta_dot,
            log.nu_dot[k],
        )
        guide_step(guidance, guidance_state, k, log.eta_measured[k], log.setpoint[k])
        reference_in_body_kernel(planar, reference, log.eta_d[k], log.nu_d[k], log.nu_dot_d[k])
        _step_filter(table, reference, log.setpoint[k])
        control_step(
            controller, controller_state, log.eta_measured[k], log.nu_measured[k], log.eta_d[k],
            log.nu_d[k], log.nu_dot_d[k], log.tau[k], log.tau_fb[k],
        )  # fmt: skip
        _advance(plant, planar, lag, thrust, log.tau[k], eta, nu, force_ned, h, substeps, scratch)
    return n


@dataclass(frozen=True)
class Plant:
    """The true vessel of a simulation with its thrusters and limits."""

    vessel: Vessel
    thruster: SecondOrderLag | None
    velocity_limits: tuple[float, ...]  # [m/s, rad/s]

    @property
    def planar(self) -> bool:
        """Whether the pose is (x, y, psi) in NED; otherwise each axis integrates its velocity."""
        return self.vessel.dofs == PLANAR


@dataclass(frozen=True)
class Voyage:
    """A sailed simulation: time [s], shape (N,), and its log."""

    t: Array
    log: Log
    dofs: tuple[str, ...]


def sail(
    plant: Plant,
    weather: Weather,
    guidance: tuple[NamedTuple, Array],
    reference_filter: FilterTable,
    controller: tuple[NamedTuple, Array],
    start: Array,
    period_s: float,
    step_s: float,
) -> Voyage:
    """Sail from rest at the pose `start` for as many control periods as the weather has rows.

    `guidance` and `controller` are (parameters, initial state) of registered steps; `period_s`
    is the control period and `step_s` the longest integration step [s]. Raises Diverged with the
    time when a velocity leaves its limit.
    """
    if not 0.0 < step_s <= period_s:
        raise ConfigurationError(
            f"integration step must be positive and at most {period_s} s, got {step_s}"
        )
    n, n_dof = weather.force_ned.shape
    substeps = int(np.ceil(period_s / step_s - 1e-9))
    log = Log(*(np.zeros((n, n_dof)) for _ in Log._fields))
    reference = np.zeros((n_dof, 3))
    reference[:, 0] = start
    table = plant.vessel.plant_table()
    z = np.zeros(2 * N_VARIABLES)
    z[0] = z[N_VARIABLES] = 1.0
    work = (np.empty(n_dof) for _ in range(8))
    scratch = Scratch(z, np.empty(len(table.codes)), *work)
    h = period_s / substeps
    rows: int = _sail(
        table, plant.planar, lag_table(plant.thruster, 0.5 * h), weather, *guidance,
        reference_filter, reference, *controller, np.zeros((n_dof, 2)),
        np.array(start, dtype=np.float64),
        np.zeros(n_dof), np.array(plant.velocity_limits, dtype=np.float64), h, substeps, scratch,
        log,
    )  # fmt: skip
    if rows < n:
        raise _diverged(plant, log, rows, period_s)
    return Voyage(period_s * np.arange(n, dtype=np.float64), log, plant.vessel.dofs)


def _diverged(plant: Plant, log: Log, rows: int, period_s: float) -> Diverged:
    """The error for a voyage that ended after `rows` instants."""
    share = np.abs(log.nu[rows - 1]) / plant.velocity_limits
    i = int(np.argmax(share))
    name, limit = plant.vessel.velocities[i], plant.velocity_limits[i]
    time = rows * period_s
    return Diverged(
        f"{plant.vessel.name}: |{name}| exceeds {limit:.3g} at t = {time:.1f} s", time, name
    )


def recording_of(voyage: Voyage, weather: Weather) -> Recording:
    """What the instruments saw of a voyage: the measured motion, the command, the acting force."""
    log = voyage.log
    return Recording(
        dofs=voyage.dofs,
        t=voyage.t,
        eta=log.eta_measured,
        nu=log.nu_measured,
        nu_dot=log.nu_dot + weather.acceleration_noise,
        tau=log.tau,
        attitude=attitude_of(voyage.dofs, log.eta_measured),
        tau_actual=log.tau_actual,
    )
