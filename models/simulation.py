"""The closed loop: guidance, reference filter, controller, thrusters, vessel and weather.

At every control instant t_k the loop measures, logs the acceleration under the force that acts
just before the new command, asks the guidance law for a set-point and the controller for a
force, and then advances the vessel over one control period by RK4 while the command is held.

The loop knows no controller, no guidance law and no reference model: `models.registry` gives it
the step of each by the type of its parameters.
A command that is not a number never reaches the vessel: the last one is held, and logged as held.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from time import perf_counter
from typing import Any, Literal, NamedTuple

import numpy as np

from models.allocating import ALLOCATIONS, Direct, allocate_step
from models.allocation import Allocation
from models.basis import Array
from models.compiled import lean_kernel
from models.dynamics import Scratch, advance, rates, scratch
from models.errors import ConfigurationError, Diverged
from models.kinematics import in_body, reference_in_body_kernel
from models.pose import kinematics_of, pose_of, state_of
from models.recording import Recording, attitude_of
from models.registry import CONTROLLERS, control_step, guide_step, reference_step
from models.thruster import LagTable, SecondOrderLag, lag_table
from models.vessel import PLANAR, PlantTable, Vessel
from models.weather import Weather

BLOCK = 2000  # control instants of the compiled loop that are timed together


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
    held: Array  # 1 where the command was not a number, and the last one was held
    applied: Array  # what the thrusters' allocation makes of the command


class Outlook(NamedTuple):
    """What a controller may know of the mission and the weather, now and ahead; SI units.

    Rows are control instants; what is not known has no rows.
    """

    reference: Array  # (N, n_dof) pose that will be asked for
    wind_ned: Array  # (N, 2) velocity of the air
    wind_noise: Array  # (N, 2) error of the anemometer, body axes; ahead, nobody has measured
    added: Array  # (N, n_dof) force that is added to the controller's commands


NO_OUTLOOK = Outlook(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 0)))


@lean_kernel
def _observe(
    k: int, plant: PlantTable, kinematics: Any, weather: Weather, guidance: Any,
    guidance_state: Array, planar: bool, table: Any, reference: Array, thrust: Array, eta: Array,
    nu: Array, limits: Array, work: Scratch, log: Log,
) -> bool:  # fmt: skip
    """Measure, log and ask for the reference at instant k; False when a limit was left."""
    n_dof = nu.shape[0]
    for i in range(n_dof):
        if not abs(nu[i]) <= limits[i]:
            return False
    for i in range(n_dof):
        log.eta[k, i] = log.eta[max(k - 1, 0), i]
        log.nu[k, i], log.tau_actual[k, i] = nu[i], thrust[i, 0]
    pose_of(kinematics, eta, work.frame, log.eta[k])
    for i in range(n_dof):
        log.eta_measured[k, i] = log.eta[k, i] + weather.pose_noise[k, i]
        log.nu_measured[k, i] = nu[i] + weather.velocity_noise[k, i]
    rates(
        kinematics, plant, eta, nu, log.tau_actual[k], weather, k, work, work.eta_dot,
        log.nu_dot[k],
    )  # fmt: skip
    guide_step(guidance, guidance_state, k, log.eta_measured[k], log.setpoint[k])
    reference_in_body_kernel(planar, reference, log.eta_d[k], log.nu_d[k], log.nu_dot_d[k])
    reference_step(table, reference, log.setpoint[k])
    return True


@lean_kernel
def _hold(k: int, tau: Array, tau_fb: Array, held: Array) -> None:
    """The last command again where that of row k is not a number."""
    for i in range(tau.shape[1]):
        if not np.isfinite(tau[k, i]):
            for j in range(tau.shape[1]):
                tau[k, j] = tau[k - 1, j] if k > 0 else 0.0
                tau_fb[k, j] = tau_fb[k - 1, j] if k > 0 else 0.0
                held[k, j] = 1.0
            return


@lean_kernel
def _sail(
    first: int, last: int, plant: PlantTable, kinematics: Any, lag: LagTable, allocation: Any,
    weather: Weather, guidance: Any, guidance_state: Array, planar: bool, table: Any,
    reference: Array, controller: Any, controller_state: Any, added: Array, thrust: Array,
    eta: Array, nu: Array, limits: Array, h: float, substeps: int, euler: bool, work: Scratch,
    log: Log,
) -> int:  # fmt: skip
    """Sail the instants from `first` to before `last`; where it ended, earlier at a limit."""
    for k in range(first, last):
        if not _observe(
            k, plant, kinematics, weather, guidance, guidance_state, planar, table, reference,
            thrust, eta, nu, limits, work, log,
        ):  # fmt: skip
            return k
        control_step(
            controller, controller_state, log.eta_measured[k], log.nu_measured[k], log.eta_d[k],
            log.nu_d[k], log.nu_dot_d[k], log.tau[k], log.tau_fb[k],
        )  # fmt: skip
        for i in range(added.shape[1]):
            log.tau[k, i] += added[k, i]
        _hold(k, log.tau, log.tau_fb, log.held)
        allocate_step(allocation, log.tau[k], log.applied[k])
        advance(
            kinematics, plant, lag, thrust, log.applied[k], eta, nu, weather, k, h, substeps,
            work, euler,
        )  # fmt: skip
    return last


@dataclass(frozen=True)
class Plant:
    """The true vessel of a simulation with its thrusters and limits."""

    vessel: Vessel
    thruster: SecondOrderLag | None
    velocity_limits: tuple[float, ...]  # [m/s, rad/s]
    change: tuple[float, Vessel] | None = None  # from a time [s] on it is another vessel
    attitude: Literal["quaternion", "euler"] = "quaternion"  # of six degrees of freedom
    integrator: Literal["rk4", "euler"] = "rk4"
    allocation: Allocation | None = None  # of the command to thrusters

    @property
    def planar(self) -> bool:
        """Whether the pose is (x, y, psi) in NED; otherwise each axis integrates its velocity."""
        return self.vessel.dofs == PLANAR

    def at(self, time_s: float) -> Vessel:
        """The vessel from a time [s] on."""
        if self.change is None or time_s < self.change[0] - 1e-9:
            return self.vessel
        return self.change[1]


@dataclass(frozen=True)
class Voyage:
    """A sailed simulation: time [s], shape (N,), its log, and the weather it met.

    `step_times` [s] are wall-clock times of one turn of the loop: of every instant where the
    controller ran in Python, else means over blocks of the compiled loop.
    """

    t: Array
    log: Log
    dofs: tuple[str, ...]
    weather: Weather
    step_times: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True)
class Watch:
    """Somebody who looks at the log while sailing and may change the controller's parameters.

    `look(k, log, parameters, state)` is called before the instants k that are multiples of
    `every`, from the first multiple on, and returns parameters of the same type.
    """

    every: int
    look: Callable[[int, Log, Any, Any], Any]


def sail(
    plant: Plant,
    weather: Weather,
    guidance: tuple[NamedTuple, Array],
    reference_filter: NamedTuple,
    controller: tuple[NamedTuple, Any],
    start: Array,
    period_s: float,
    step_s: float,
    start_nu: Array | None = None,
    watch: Watch | None = None,
    added: Array | None = None,
) -> Voyage:
    """Sail from the pose `start` for as many control periods as the weather has rows.

    The voyage begins at rest, unless a velocity `start_nu` over ground is given. A force `added`
    to the controller's command [N, Nm], shape (N, n_dof), excites the vessel.

    `guidance` and `controller` are (parameters, initial state) of registered steps and
    `reference_filter` the table of a registered reference model; `period_s` is the control period
    and `step_s` the longest integration step [s]. Raises Diverged with the time when a velocity
    leaves its limit.
    """
    if not 0.0 < step_s <= period_s:
        raise ConfigurationError(
            f"integration step must be positive and at most {period_s} s, got {step_s}"
        )
    n, n_dof = weather.force_ned.shape
    substeps = int(np.ceil(period_s / step_s - 1e-9))
    h = period_s / substeps
    log = Log(*(np.zeros((n, n_dof)) for _ in Log._fields))
    reference = np.zeros((n_dof, 3))
    reference[:, 0] = start
    parameters, state = controller
    kinematics = kinematics_of(plant.vessel.dofs, plant.attitude)
    pose = state_of(kinematics, np.asarray(start, dtype=np.float64))
    log.eta[:1] = start  # angles are unrolled from here
    sharing = Direct() if plant.allocation is None else plant.allocation.table(plant.vessel.dofs)
    before = (
        kinematics, lag_table(plant.thruster, 0.5 * h), sharing, weather.sailed(),
        *guidance, plant.planar, reference_filter, reference,
    )  # fmt: skip
    craft = (
        np.zeros((0, 0)) if added is None else np.ascontiguousarray(added, dtype=np.float64),
        np.zeros((n_dof, 2)), pose,
        np.zeros(n_dof) if start_nu is None else np.array(start_nu, dtype=np.float64),
        np.array(plant.velocity_limits, dtype=np.float64), h, substeps,
        plant.integrator == "euler",
    )  # fmt: skip
    steps = CONTROLLERS[type(parameters)], ALLOCATIONS[type(sharing)]
    loop, edges = _loop(steps, plant, watch, n, period_s)
    times: list[float] = []
    for first, last in pairwise(edges):
        table = plant.at(first * period_s).plant_table()
        if watch is not None and first > 0 and first % watch.every == 0:
            parameters = watch.look(first, log, parameters, state)
        work = scratch(len(table.codes), n_dof, len(pose))
        begun = perf_counter()
        rows: int = loop(first, last, table, *before, parameters, state, *craft, work, log)
        if rows < last:
            raise _diverged(plant, log, rows, period_s)
        times.append((perf_counter() - begun) / max(last - first, 1))
    t = period_s * np.arange(n, dtype=np.float64)
    return Voyage(t, log, plant.vessel.dofs, weather, np.array(times[1:]))


def _loop(
    steps: Sequence[Callable[..., None]],
    plant: Plant,
    watch: Watch | None,
    n: int,
    period_s: float,
) -> tuple[Callable[..., int], list[int]]:
    """The compiled loop, or the same in Python for a step that is; and where it is interrupted.

    It begins with an empty stretch, so that compiling or loading it is not timed.
    """
    compiled: Any = _sail
    block = BLOCK
    if not all(hasattr(step, "py_func") for step in steps):  # none has with numba disabled
        compiled, block = getattr(compiled, "py_func", compiled), 1
    edges = {*range(0, n, block), n}
    if watch is not None:
        edges |= set(range(watch.every, n, watch.every))
    if plant.change is not None:
        edges |= {min(n, int(np.ceil(plant.change[0] / period_s - 1e-9)))}
    return compiled, [0, *sorted(edges)]


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
    """What the instruments saw of a voyage: the measured motion, the command, the acting force.

    The command is the one after the allocation, which the vessel knows.
    """
    log = voyage.log
    return Recording(
        dofs=voyage.dofs,
        t=voyage.t,
        eta=log.eta_measured,
        nu=log.nu_measured,
        nu_dot=log.nu_dot + weather.acceleration_noise,
        tau=log.applied,
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


@lean_kernel
def _foresee(
    planar: bool, table: Any, state: Array, setpoints: Array, eta_d: Array, nu_d: Array,
    nu_dot_d: Array,
) -> None:  # fmt: skip
    for k in range(setpoints.shape[0]):
        reference_in_body_kernel(planar, state, eta_d[k], nu_d, nu_dot_d)
        reference_step(table, state, setpoints[k])


def outlook(
    plant: Plant, weather: Weather, guidance: NamedTuple, reference_filter: NamedTuple,
    start: Array, added: Array | None = None,
) -> Outlook:  # fmt: skip
    """What can be known ahead: the reference of set-points on a timetable, and the weather's wind.

    A guidance law knows its set-points in advance when its parameters have `setpoints`, shape
    (N, n_dof).
    """
    setpoints = getattr(guidance, "setpoints", np.zeros((0, 0)))
    eta_d = np.zeros_like(setpoints)
    state = np.zeros((len(start), 3))
    state[:, 0] = start
    work = np.zeros((2, len(start)))
    _foresee(plant.planar, reference_filter, state, setpoints, eta_d, *work)
    force = np.zeros((0, 0)) if added is None else np.ascontiguousarray(added, dtype=np.float64)
    return Outlook(eta_d, weather.wind_ned, weather.wind_noise, force)
