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

from models.basis import Array
from models.compiled import lean_kernel
from models.dynamics import Scratch, Weather, advance, kinematics_of, rates, scratch
from models.errors import ConfigurationError, Diverged
from models.kinematics import in_body, reference_in_body_kernel
from models.recording import Recording, attitude_of
from models.thruster import LagTable, SecondOrderLag, lag_table
from models.vessel import PLANAR, PlantTable, Vessel

CONTROLLERS: dict[type, Callable[..., None]] = {}
GUIDANCE: dict[type, Callable[..., None]] = {}


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
def _step_filter(table: FilterTable, state: Array, setpoint: Array) -> None:
    """Advance the reference filter of every axis; state (n_dof, 3)."""
    for i in range(state.shape[0]):
        x0, x1, x2 = state[i, 0], state[i, 1], state[i, 2]
        for j in range(3):
            a = table.a[j]
            state[i, j] = a[0] * x0 + a[1] * x1 + a[2] * x2 + table.b[j] * setpoint[i]


@lean_kernel
def _sail(
    plant: PlantTable, kinematics: Any, lag: LagTable, weather: Weather, guidance: Any,
    guidance_state: Array, planar: bool, table: FilterTable, reference: Array, controller: Any,
    controller_state: Array, thrust: Array, eta: Array, nu: Array, limits: Array, h: float,
    substeps: int, work: Scratch, log: Log,
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
        rates(
            kinematics, plant, eta, nu, log.tau_actual[k], weather, k, work, work.eta_dot,
            log.nu_dot[k],
        )  # fmt: skip
        guide_step(guidance, guidance_state, k, log.eta_measured[k], log.setpoint[k])
        reference_in_body_kernel(planar, reference, log.eta_d[k], log.nu_d[k], log.nu_dot_d[k])
        _step_filter(table, reference, log.setpoint[k])
        control_step(
            controller, controller_state, log.eta_measured[k], log.nu_measured[k], log.eta_d[k],
            log.nu_d[k], log.nu_dot_d[k], log.tau[k], log.tau_fb[k],
        )  # fmt: skip
        advance(
            kinematics, plant, lag, thrust, log.tau[k], eta, nu, weather, k, h, substeps, work,
        )  # fmt: skip
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
    """A sailed simulation: time [s], shape (N,), its log, and the weather it met."""

    t: Array
    log: Log
    dofs: tuple[str, ...]
    weather: Weather


def sail(
    plant: Plant,
    weather: Weather,
    guidance: tuple[NamedTuple, Array],
    reference_filter: FilterTable,
    controller: tuple[NamedTuple, Array],
    start: Array,
    period_s: float,
    step_s: float,
    start_nu: Array | None = None,
) -> Voyage:
    """Sail from the pose `start` for as many control periods as the weather has rows.

    The voyage begins at rest, unless a velocity `start_nu` over ground is given.

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
    h = period_s / substeps
    rows: int = _sail(
        table, kinematics_of(plant.vessel.dofs), lag_table(plant.thruster, 0.5 * h),
        weather.sailed(), *guidance, plant.planar, reference_filter, reference, *controller,
        np.zeros((n_dof, 2)), np.array(start, dtype=np.float64),
        np.zeros(n_dof) if start_nu is None else np.array(start_nu, dtype=np.float64),
        np.array(plant.velocity_limits, dtype=np.float64), h, substeps,
        scratch(len(table.codes), n_dof, n_dof), log,
    )  # fmt: skip
    if rows < n:
        raise _diverged(plant, log, rows, period_s)
    return Voyage(period_s * np.arange(n, dtype=np.float64), log, plant.vessel.dofs, weather)


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
        wind=measured_wind(voyage, weather),
    )


def measured_wind(voyage: Voyage, weather: Weather) -> Array | None:
    """What an anemometer aboard sees: the air's velocity in body axes [m/s], shape (N, 2).

    None where there is no wind.
    """
    if not len(weather.wind_ned):
        return None
    psi = attitude_of(voyage.dofs, voyage.log.eta)[:, 2]
    noise = weather.wind_noise if len(weather.wind_noise) else 0.0
    return in_body(weather.wind_ned, psi) + noise
