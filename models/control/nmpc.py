"""Nonlinear model predictive control of the pose, on the equation of motion of the model itself.

At every command the problem of `nonlinear_program` is solved from the estimated state and unknown
force, with the reference and the wind that are known in advance. The gain is that of `estimator`,
the prediction that of the model itself. The last plan, moved on by a step, is the first guess.
Where the mission has obstacles, each pose of this guess gives the lines to the nearest ones
(`free_space`), beyond which the hull stays; a slack keeps the problem feasible. If no solution is
found, the command is that of the last plan.
"""

from dataclasses import dataclass, field
from typing import Annotated, Literal, NamedTuple

import numpy as np
from annotated_types import Ge, Le

from seatrial.models.compiled import kernel
from seatrial.models.control.controller import Controller, Model, table_of
from seatrial.models.control.estimator import (
    Estimator,
    Kalman,
    Memory,
    Observer,
    correct,
    estimate,
    estimator_diagnostics,
    heading,
    memory,
    observer_of,
    to_axes,
)
from seatrial.models.control.free_space import separating_lines
from seatrial.models.control.linear_design import DesignModel, check_weights, design_model
from seatrial.models.control.mpc import Preview
from seatrial.models.control.nonlinear_program import Program, ProgramStructure
from seatrial.models.diagnostics import Diagnostic
from seatrial.models.ranges import NotNegative, Positive, check_ranges
from seatrial.models.simulation.casadi_rates import coefficients, solver_of
from seatrial.models.simulation.registry import CONTROLLERS
from seatrial.models.simulation.voyage import NO_OUTLOOK, Outlook
from seatrial.models.vessel.basis import Array, Codes
from seatrial.models.vessel.scales import GRAVITY
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag
from seatrial.models.vessel.tuning import FromVessel
from seatrial.models.weather.wind import WindForce

NOWHERE = 1e6  # [m] that a line without an obstacle is away


class NmpcTable(NamedTuple):
    """Parameters of the step."""

    options: "Nmpc"
    model: Vessel
    observer: Observer
    outlook: Outlook
    program: Program
    shared: Array  # parameters of all stages
    bounds: dict[str, Array]  # of unknowns and constraints
    corners: Array  # of the obstacles, (M, 2), and where each begins
    first: Codes
    every: int  # number of loop instants between two commands


@dataclass
class NmpcMemory:
    """State of the step; forces are shares of the limits."""

    estimated: Memory
    acting: Array  # (r,) by the lag
    command: Array  # (r,)
    plan: Array | None = None  # unknowns of the last problem
    slack: dict[str, float] = field(default_factory=dict)  # largest so far: distance [m], speed


@kernel
def _observe(observer: Observer, past: Memory, eta: Array, nu: Array, velocity: Array) -> None:
    """Correct the predicted state by a measurement, and write the velocity in body axes."""
    if past.instant[0] == 0 or observer.measured:
        estimate(observer, past, eta, nu)
    else:
        correct(observer, past, eta)
    to_axes(observer.turning, heading(observer, past.x), past.x[eta.shape[0] :], velocity)


def _step(
    mpc: NmpcTable, past: NmpcMemory, eta: Array, nu: Array, eta_d: Array, nu_d: Array,
    nu_dot_d: Array, tau: Array, tau_fb: Array,
) -> None:  # fmt: skip
    """The first command of the best plan; without a solution that of the last plan."""
    estimated = past.estimated
    if estimated.instant[0] % mpc.every == 0:
        velocity = np.zeros(len(tau))
        _observe(mpc.observer, estimated, eta, nu, velocity)
        lags = [past.acting] if mpc.program.structure.lagging else []
        state = np.concatenate([estimated.x[: len(tau)], velocity, *lags, past.command])
        stages = _solve(mpc, past, state, eta_d)
        _predict(mpc, past, state, stages[0])
    tau[:] = tau_fb[:] = mpc.observer.limits * past.command
    estimated.instant[0] += 1


CONTROLLERS[NmpcTable] = _step


def _predict(mpc: NmpcTable, past: NmpcMemory, state: Array, stage: Array) -> None:
    """Move the estimate to the next command on the model itself, whose error the bias then is."""
    estimated, program, n = past.estimated, mpc.program, mpc.program.n
    psi, turning, added = heading(mpc.observer, estimated.x), mpc.observer.turning, np.zeros(n)
    if estimated.instant[0] < len(mpc.outlook.added):
        to_axes(turning, -psi, mpc.outlook.added[estimated.instant[0]], added)
    stage = stage.copy()
    stage[n : 2 * n] += added
    unknowns = np.concatenate([past.command, np.zeros(len(program.slacks))])
    ahead = np.asarray(program.step(state, unknowns, stage, mpc.shared)).ravel()
    estimated.x[:n], past.acting = ahead[:n], ahead[-2 * n : -n]
    to_axes(turning, -heading(mpc.observer, estimated.x), ahead[n : 2 * n], estimated.x[n:])
    estimated.bias[:] *= mpc.observer.bias_decay


def _solve(mpc: NmpcTable, past: NmpcMemory, state: Array, eta_d: Array) -> Array:
    """Solve the problem from a state; writes plan, command and slack, returns the stages."""
    program, n = mpc.program, mpc.program.n
    width, nx = program.width, program.states
    if past.plan is None or len(past.plan) != program.length:
        rest = np.concatenate([state, past.command, np.zeros(len(program.slacks))])
        rest[n : 2 * n] = 0.0
        plan = np.tile(rest, program.structure.steps + 1)[: program.length]
    else:
        plan = np.concatenate([past.plan[width:], past.plan[-width:]])  # a step later
    plan[:nx] = state
    stages = _stages(mpc, past.estimated, plan, eta_d)
    p = np.concatenate([state, mpc.shared, stages.ravel()])
    solution = program.solver(x0=plan, p=p, **mpc.bounds)
    if program.solver.stats()["success"]:
        plan = np.asarray(solution["x"]).ravel()
    else:
        past.estimated.failures[0] += 1
    past.plan, past.command = plan, np.clip(plan[nx : nx + n], -1.0, 1.0)
    most = np.max(program.stages(plan)[:, nx + n :], axis=0)
    for name, slack in zip(program.slacks, most.tolist(), strict=True):
        past.slack[name] = max(past.slack.get(name, 0.0), slack)
    return stages


def _stages(mpc: NmpcTable, past: Memory, plan: Array, eta_d: Array) -> Array:
    """Parameters of all stages: target, disturbance, wind and lines; shape (steps + 1, width)."""
    program, n, k = mpc.program, mpc.program.n, past.instant[0]
    steps, outlook, turning = program.structure.steps, mpc.outlook, mpc.observer.turning
    stages = np.zeros((steps + 1, sum(program.stage)))
    rows = k + mpc.every * np.arange(steps + 1)
    known = mpc.options.preview != "none" and len(outlook.reference)
    stages[:, :n] = (
        outlook.reference[np.minimum(rows, len(outlook.reference) - 1)] if known else eta_d
    )
    if turning:
        turns = np.round((stages[0, 2] - past.x[2]) / (2.0 * np.pi))
        stages[:, 2] -= 2.0 * np.pi * turns
    decay = mpc.observer.bias_decay ** np.arange(steps + 1)
    stages[:, n : 2 * n] = decay[:, None] * past.bias
    if len(outlook.wind_ned):
        stages[:, 2 * n : 2 * n + 2] = _wind(mpc, past, rows)
    if program.structure.lines:
        assert outlook.hull is not None
        poses = np.ascontiguousarray(program.stages(plan)[:, :3])
        lines = np.zeros((steps, program.structure.lines, 3))
        separating_lines(outlook.hull, poses, mpc.corners, mpc.first, lines)
        lines[:, :, 2] = np.maximum(lines[:, :, 2], -NOWHERE) + mpc.options.margin_m
        stages[:steps, 2 * n + 2 :] = lines.reshape(steps, -1)
    return stages


def _wind(mpc: NmpcTable, past: Memory, rows: Array) -> Array:
    """Velocity of the air at every stage, north and east [m/s]: measured, or known in advance."""
    outlook, k = mpc.outlook, past.instant[0]
    last = len(outlook.wind_ned) - 1
    now = outlook.wind_ned[min(k, last)].copy()
    if k < len(outlook.wind_noise):
        psi = heading(mpc.observer, past.x)
        c, s = np.cos(psi), np.sin(psi)
        now += np.array([[c, -s], [s, c]]) @ outlook.wind_noise[k]
    wind = np.tile(now, (len(rows), 1))
    if mpc.options.preview == "setpoint_and_wind":
        wind[1:] = outlook.wind_ned[np.minimum(rows[1:], last)]
    return wind


@dataclass(frozen=True, kw_only=True)
class Nmpc(Controller):
    """Nonlinear model predictive control of the pose by forces on the axes.

    `horizon` steps of `step` sqrt(L / g), after each of which there is a command. `error_weight`
    weighs the error of the pose [1/m^2, 1/rad^2], and `effort` times `input_weight` increments of
    the force in `period_s` as shares of `limits` [N, Nm]. The hull stays `margin` L away from the
    `lines` nearest obstacles, and velocities below `speed_limits` [m/s, rad/s]; a violation by a
    length, or by the limit itself, costs `slack_weight` times an error of a length.
    """

    horizon: Annotated[int, Ge(2), Le(1000)]
    step: Positive
    preview: Preview
    error_weight: Annotated[tuple[float, ...], FromVessel("tuning.control.error_weight")]
    input_weight: Annotated[tuple[float, ...], FromVessel("tuning.control.increment_weight")]
    effort: Positive
    period_s: Annotated[Positive, FromVessel("tuning.control.period_s")]
    limits: Annotated[tuple[float, ...], FromVessel("force_limits")]
    rate_limits: tuple[float, ...] | None
    speed_limits: tuple[float, ...] | None
    margin: NotNegative
    lines: Annotated[int, Ge(1), Le(20)]
    slack_weight: Positive
    solver: Literal["fatrop", "ipopt"]
    estimator: Estimator
    kalman: Kalman
    wind: Annotated[WindForce | None, FromVessel("tuning.windage")]
    thruster: Annotated[SecondOrderLag | None, FromVessel("thruster")] = None
    length_m: Annotated[Positive, FromVessel("scales.length_m")]

    def __post_init__(self) -> None:
        check_ranges(self)
        n = len(self.limits)
        check_weights("error_weight", self.error_weight, n, positive=False)
        for name in ("limits", "input_weight", "rate_limits", "speed_limits"):
            values = getattr(self, name)
            if values is not None:
                check_weights(name, values, n, positive=True)
        solver_of(self.solver)

    @property
    def margin_m(self) -> float:
        """Distance of the hull from obstacles [m]."""
        return self.margin * self.length_m

    def command_rows(self, period_s: float) -> int:
        """Number of loop instants between two commands."""
        step_s = self.step * float(np.sqrt(self.length_m / GRAVITY))
        return max(1, round(step_s / period_s))

    def preview_rows(self, period_s: float) -> int:
        """Number of loop instants by which a step of the reference is known in advance."""
        return 0 if self.preview == "none" else self.horizon * self.command_rows(period_s)

    def command_limits(self) -> tuple[float, ...]:
        """The limits of the force [N, Nm], and of the thrusters."""
        most = None if self.thruster is None else self.thruster.amplitude_limit
        return tuple(np.minimum(self.limits, most or np.inf).tolist())

    def failures(self, state: NmpcMemory) -> int:
        """Number of problems that were not solved."""
        return int(state.estimated.failures[0])

    def findings(self, state: NmpcMemory) -> list[Diagnostic]:
        """The largest violations: of the distance from obstacles, and of a speed limit [share]."""
        units = {"distance": "m", "speed": ""}
        return [Diagnostic(f"slack_{name}", "all", most, units[name])
                for name, most in state.slack.items()]  # fmt: skip

    def design(self, model: Model, period_s: float) -> DesignModel:
        """The linear model of the estimator, at the period of the commands."""
        own = self.command_rows(period_s) * period_s
        return design_model(table_of(model), self.command_limits(), own, self.wind)

    def build(self, model: Model, period_s: float) -> tuple[NmpcTable, NmpcMemory]:
        """Parameters and initial state of the step, which runs in Python."""
        design = self.design(model, period_s)
        observer = observer_of(design, self.estimator, self.kalman)
        n, every = len(design.dofs), self.command_rows(period_s)
        program, shared, bounds = self._problem(table_of(model), NO_OUTLOOK, every * period_s)
        corners, first = np.zeros((0, 2)), np.zeros(1, dtype=np.int64)
        table = NmpcTable(
            self, table_of(model), observer, NO_OUTLOOK, program, shared, bounds, corners, first,
            every,
        )  # fmt: skip
        return table, NmpcMemory(memory(2 * n, n, n), np.zeros(n), np.zeros(n))

    def foresee(self, parameters: NmpcTable, outlook: Outlook) -> NmpcTable:
        """The parameters with reference, wind and obstacles; its program is compiled."""
        step_s = float(parameters.shared[0])
        program, shared, bounds = self._problem(parameters.model, outlook, step_s)
        obstacles = [np.asarray(each, dtype=np.float64) for each in outlook.obstacles or ()]
        assert program.solver is not None
        return parameters._replace(
            outlook=outlook, program=program, shared=shared, bounds=bounds,
            corners=np.vstack([np.zeros((0, 2)), *obstacles]),
            first=np.cumsum([0, *map(len, obstacles)]),
        )  # fmt: skip

    def _problem(
        self, model: Vessel, outlook: Outlook, step_s: float
    ) -> tuple[Program, Array, dict[str, Array]]:
        """The program for a model and an outlook, its shared parameters and its bounds."""
        n, length = len(model.dofs), self.length_m
        if len(outlook.wind_ned) and self.wind and not model.force_table().aerodynamic:
            model = model + self.wind.table(model.dofs)
        plant, lag = model.plant_table(), self.thruster
        rates = self._rates(step_s)
        hull = outlook.hull if outlook.obstacles and outlook.hull is not None else np.zeros((0, 2))
        structure = ProgramStructure(
            model.dofs, lag is not None, self.horizon, self.lines if len(hull) else 0, len(hull),
            self.speed_limits is not None, bool(np.any(np.isfinite(rates))),
            solver_of(self.solver),
        )  # fmt: skip
        program = Program(structure, plant)
        decay = 0.0 if lag is None else float(np.exp(-0.5 * step_s / lag.delay_s))
        error = np.array(self.error_weight) / max(self.error_weight)  # tolerances are absolute
        change = self.effort * np.array(self.input_weight) / max(self.error_weight)
        change *= (self.period_s / step_s) ** 2
        of_length = self.slack_weight * length
        weights = [of_length] * bool(len(hull)) + [of_length * length] * structure.limited_speed
        speeds = np.ones(n) if self.speed_limits is None else np.array(self.speed_limits)
        shared = np.concatenate([
            [step_s, decay], self.command_limits(), error, change, weights, speeds,
            hull.ravel(), coefficients(plant),
        ])  # fmt: skip
        return program, shared, program.bounds(np.minimum(rates, 2.0))

    def _rates(self, step_s: float) -> Array:
        """Largest change of the command in a step, as shares of the limits."""
        own = np.inf if self.rate_limits is None else np.array(self.rate_limits)
        lag = None if self.thruster is None else self.thruster.rate_limit
        most = np.minimum(own, np.inf if lag is None else np.array(lag))
        return np.asarray(np.broadcast_to(most, len(self.limits)) * step_s / self.command_limits())

    def diagnostics(self, model: Model, period_s: float) -> list[Diagnostic]:
        """Order, controllability and spectral radius of the estimator, and the step."""
        design = self.design(model, period_s)
        observer = observer_of(design, self.estimator, self.kalman)
        step = Diagnostic("horizon_step", "all", design.period_s, "s")
        return [*design.diagnostics(), *estimator_diagnostics(observer), step]
