"""The closed loop: guidance, reference filter, controller, thrusters, vessel and weather.

At every control instant t_k the loop measures, logs the acceleration under the force that acts
just before the new command, evaluates the guidance law and the controller, and advances the vessel
over one control period by RK4 with a constant command.

The loop does not depend on any controller, guidance law or reference model: `registry` provides
the step of each by the type of its parameters. A command that is not finite is not applied: the
previous command is held, and the log marks it as held.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from time import thread_time
from typing import NamedTuple

import numpy as np

from seatrial.models.compiled import in_python, is_compiled, lean_kernel
from seatrial.models.errors import ConfigurationError, Diverged
from seatrial.models.simulation.dynamics import Scratch, advance, rates, scratch
from seatrial.models.simulation.registry import (
    CONTROLLERS,
    Parameters,
    State,
    bound_controller,
    bound_guidance,
    control_step,
    guide_step,
    reference_step,
)
from seatrial.models.simulation.voyage import ALLOTTED, COMMANDED, Log, Voyage
from seatrial.models.vessel.allocation import ALLOCATIONS, DeviceAllocation, Direct, allocate_step
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.parameters import Plant
from seatrial.models.vessel.plant_table import PlantTable, bound_plant
from seatrial.models.vessel.pose import Kinematics, kinematics_of, pose_of, state_of
from seatrial.models.vessel.thruster import LagTable, input_lag, lag_table
from seatrial.models.weather.weather import Weather

BLOCK_INSTANTS = 2000  # control instants of the compiled loop that are timed as one block
# added force, thrust, pose, velocity and its limits, step [s], steps in a period, by Euler
Craft = tuple[Array, Array, Array, Array, Array, float, int, bool]


@lean_kernel
def _observe(
    k: int, plant: PlantTable, kinematics: Kinematics, weather: Weather, guidance: Parameters,
    guidance_state: Array, planar: bool, table: Parameters, reference: Array, thrust: Array,
    eta: Array, nu: Array, limits: Array, work: Scratch, log: Log,
) -> bool:  # fmt: skip
    """Measure, log and evaluate the reference at instant k; False if a limit is exceeded."""
    n_dof = nu.shape[0]
    for i in range(n_dof):
        if not abs(nu[i]) <= limits[i]:
            return False
    for i in range(n_dof):
        log.eta[k, i] = log.eta[max(k - 1, 0), i]
        log.nu[k, i] = nu[i]
    for i in range(thrust.shape[0]):
        log.tau_actual[k, i] = thrust[i, 0]
    pose_of(kinematics, eta, work.frame, log.eta[k])
    for i in range(n_dof):
        log.eta_measured[k, i] = log.eta[k, i] + weather.pose_noise[k, i]
        log.nu_measured[k, i] = nu[i] + weather.velocity_noise[k, i]
    rates(
        kinematics, plant, eta, nu, log.tau_actual[k], weather, k, work, work.eta_dot,
        work.nu_dot,
    )  # fmt: skip
    for i in range(n_dof):
        log.nu_dot[k, i] = work.nu_dot[i]
    guide_step(guidance, guidance_state, k, log.eta_measured[k], log.setpoint[k])
    reference_step(
        table, reference, log.setpoint[k], planar, log.eta_d[k], log.nu_d[k], log.nu_dot_d[k]
    )
    return True


@lean_kernel
def _hold(k: int, tau: Array, tau_fb: Array, held: Array) -> None:
    """Repeat the previous command if the command of row k is not finite."""
    for i in range(tau.shape[1]):
        if not np.isfinite(tau[k, i]):
            for j in range(tau.shape[1]):
                tau[k, j] = tau[k - 1, j] if k > 0 else 0.0
                tau_fb[k, j] = tau_fb[k - 1, j] if k > 0 else 0.0
                held[k, j] = 1.0
            return


@lean_kernel
def _sail(
    first: int, last: int, plant: PlantTable, kinematics: Kinematics, lag: LagTable,
    allocation: NamedTuple, weather: Weather, guidance: Parameters, guidance_state: Array,
    table: Parameters, planar: bool, reference: Array, controller: Parameters,
    controller_state: State, added: Array, thrust: Array, eta: Array, nu: Array, limits: Array,
    h: float, substeps: int, euler: bool, work: Scratch, log: Log,
) -> int:  # fmt: skip
    """Simulate the instants `first` to `last` - 1; returns the first not simulated."""
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
            work, euler, True,
        )  # fmt: skip
    return last


@dataclass(frozen=True)
class Watch:
    """A function that reads the log during a simulation and may change the controller parameters.

    `look(k, log, parameters, state)` is called before every instant k > 0 that is a multiple of
    `every`, and returns parameters of the same type.
    """

    every: int
    look: Callable[[int, Log, Parameters, State], Parameters]


def sail(
    plant: Plant,
    weather: Weather,
    guidance: tuple[NamedTuple, Array],
    reference_filter: NamedTuple,
    controller: tuple[Parameters, State],
    start: Array,
    period_s: float,
    step_s: float,
    start_nu: Array | None = None,
    watch: Watch | None = None,
    added: Array | None = None,
) -> Voyage:
    """Simulate the closed loop for as many control periods as the weather has rows.

    Args:
        plant: the vessel with thrusters and limits.
        weather: realised disturbances, N rows.
        guidance: parameters and initial state of a registered guidance step.
        reference_filter: table of a registered reference model.
        controller: parameters and initial state of a registered controller step.
        start: initial pose [m, rad], shape (n_dof,).
        period_s: control period [s].
        step_s: longest integration step [s].
        start_nu: initial velocity over ground [m/s, rad/s], shape (n_dof,); None means rest.
        watch: function that may change the controller parameters during the simulation.
        added: force added to the command of the controller [N, Nm], shape (N, n_dof).

    Returns:
        The voyage with its log.

    Raises:
        ConfigurationError: a wrong integration step, or what is added is no command.
        Diverged: a velocity exceeded its limit, with the time.
    """
    substeps = _substeps(period_s, step_s)
    n, n_dof = weather.force_ned.shape
    h = period_s / substeps
    positioning = plant.allocation if isinstance(plant.allocation, DeviceAllocation) else None
    log = _empty_log(n, n_dof, len(plant.inputs) or n_dof, positioning is not None)
    if added is not None and added.shape != log.tau.shape:  # compiled code checks no bounds
        raise ConfigurationError(f"added: got shape {added.shape}, expected {log.tau.shape}")
    reference = np.zeros((n_dof, 3))
    reference[:, 0] = start
    kinematics = kinematics_of(plant.vessel.dofs, plant.vessel.attitude)
    pose = state_of(kinematics, np.asarray(start, dtype=np.float64))
    log.eta[:1] = start  # angles are unwrapped from here
    sharing = Direct() if plant.allocation is None else plant.allocation.table(plant.vessel.dofs)
    craft = (*_vessel_state(plant, pose, start_nu, added), h, substeps, plant.integrator == "euler")
    steps = CONTROLLERS[type(controller[0])], ALLOCATIONS[type(sharing)]
    loop, edges = _loop(steps, plant, watch, n, period_s)
    before = (
        kinematics, _lag(plant, 0.5 * h), sharing, weather,
        *bound_guidance(*guidance, reference_filter), plant.planar, reference,
    )  # fmt: skip
    times = _run_blocks(loop, edges, plant, watch, controller, before, craft, log, period_s)
    return Voyage(
        period_s * np.arange(n, dtype=np.float64), log, plant.vessel.dofs, weather,
        plant.immediate, np.array(times[1:]), plant.vessel.inputs, positioning,
    )  # fmt: skip


def _empty_log(n: int, n_dof: int, n_commands: int, positioned: bool) -> Log:
    """A log of n instants; what is commanded has `n_commands` columns, or is a force."""
    inputs = ALLOTTED if positioned else COMMANDED
    return Log(*(np.zeros((n, n_commands if k in inputs else n_dof)) for k in Log._fields))


def _lag(plant: Plant, step_s: float) -> LagTable:
    """The lag of the inputs, or of the thrusters, for a step [s]."""
    if plant.inputs:
        return input_lag(plant.inputs, step_s)
    return lag_table(plant.thruster, step_s, len(plant.vessel.dofs))


def _vessel_state(
    plant: Plant, pose: Array, start_nu: Array | None, added: Array | None
) -> tuple[Array, Array, Array, Array, Array]:
    """Added force, initial thrust, pose and velocity, and the limits of the velocity."""
    n_dof = len(plant.vessel.dofs)
    acting = np.zeros((len(plant.inputs) or n_dof, 2))
    acting[:, 0] = [each.start for each in plant.inputs] or 0.0
    return (
        np.zeros((0, 0)) if added is None else np.ascontiguousarray(added, dtype=np.float64),
        acting,
        pose,
        np.zeros(n_dof) if start_nu is None else np.array(start_nu, dtype=np.float64),
        np.array(plant.velocity_limits, dtype=np.float64),
    )


def _run_blocks(
    loop: Callable[..., int], edges: Sequence[int], plant: Plant, watch: Watch | None,
    controller: tuple[Parameters, State], before: tuple[object, ...], craft: Craft,
    log: Log, period_s: float,
) -> list[float]:  # fmt: skip
    """Run the loop between the edges; returns the mean CPU time of a step in each block [s]."""
    parameters, state = controller
    times: list[float] = []
    for first, last in pairwise(edges):
        table = bound_plant(plant.at(first * period_s).plant_table())
        if watch is not None and first > 0 and first % watch.every == 0:
            parameters = watch.look(first, log, parameters, state)
        work = scratch(len(table.codes), log.nu.shape[1], len(craft[2]))
        control = parameters, state
        if loop is _sail:
            control = bound_controller(*control)
        started_s = thread_time()
        rows = loop(first, last, table, *before, *control, *craft, work, log)
        if rows < last:
            raise _diverged(plant, log, rows, period_s)
        times.append((thread_time() - started_s) / max(last - first, 1))
    return times


def _substeps(period_s: float, step_s: float) -> int:
    """Integration steps in a control period, each at most `step_s` [s] long."""
    if not 0.0 < step_s <= period_s:
        raise ConfigurationError(
            f"integration step must be positive and at most {period_s} s, got {step_s}"
        )
    return int(np.ceil(period_s / step_s - 1e-9))


def _loop(
    steps: Sequence[Callable[..., None]], plant: Plant, watch: Watch | None, n: int, period_s: float
) -> tuple[Callable[..., int], list[int]]:
    """The loop, in Python if one of its steps is, and the instants at which it is interrupted.

    The first block is empty, so that compiling or loading the loop is not timed.
    """
    compiled: Callable[..., int] = _sail
    block = BLOCK_INSTANTS
    if not all(is_compiled(step) for step in steps):
        compiled, block = in_python(compiled), 1
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
