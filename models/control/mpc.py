"""Model predictive control: four formulations of one problem, with preview of reference and wind.

Without limits the command is linear in the known quantities, and the step is compiled. With limits
a quadratic program is solved at every sample, in Python. If it has no solution, the last command
is held and the failure is counted.

`preview`: `none` uses the present set-point and wind over the whole horizon, `setpoint` uses the
future reference, `setpoint_and_wind` also the future wind, as Bargouth (2022), section 3.6.1,
assumes. A reference that is not known in advance (line of sight) is held constant.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, NamedTuple

import numpy as np
from annotated_types import Ge, Le

from seatrial.models.compiled import kernel, lean_kernel
from seatrial.models.control import horizon
from seatrial.models.control.controller import Controller, Model
from seatrial.models.control.estimator import (
    Estimator,
    Kalman,
    Memory,
    Observer,
    accept,
    estimate,
    estimator_diagnostics,
    heading,
    known_force,
    memory,
    observer_of,
    remember,
    to_axes,
)
from seatrial.models.control.horizon import Horizon, Quadratic, Solver
from seatrial.models.control.linear_design import (
    DesignModel,
    check_weights,
    closed_loop_radius,
    design_model,
)
from seatrial.models.control.lqi import samples, si_weights
from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError
from seatrial.models.ranges import check_ranges
from seatrial.models.simulation.registry import CONTROLLERS
from seatrial.models.simulation.voyage import NO_OUTLOOK, Outlook
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.tuning import FromVessel
from seatrial.models.weather.wind import WindForce

Preview = Literal["none", "setpoint", "setpoint_and_wind"]


class MpcTable(NamedTuple):
    """Parameters of the compiled step."""

    observer: Observer
    outlook: Outlook
    gain: Array  # (r, width): unconstrained command, as a fraction of the limits, per parameter
    steps: int  # of the horizon
    increments: bool
    limited: bool
    setpoints: bool  # the future reference is known
    winds: bool  # the future wind is known
    every: int  # number of loop instants between two commands
    theta: Array  # (width,) parameters of the problem
    now: Array  # (n,) work space
    change: Array  # (n,)
    error: Array  # (m,)
    known: Array  # (r,)
    last: Array  # (r,)
    tau: Array  # (r,)


class QpTable(NamedTuple):
    """Parameters of the step with limits, in Python: the table and the solver."""

    table: MpcTable
    solver: Solver


def write_parameters(mpc: MpcTable, past: Memory, eta: Array, nu: Array, eta_d: Array) -> None:
    """Update the memory to this instant and write theta = (x_0, r, d, u_{-1}) in body axes.

    If the axes turn, positions are relative to the estimated pose, or to the last measured pose in
    the formulation `increments`.
    """
    n, m = past.x.shape[0], eta.shape[0]
    r, k = past.command.shape[0], past.instant[0]
    table, theta, limits = mpc.observer, mpc.theta, mpc.observer.limits
    estimate(table, past, eta, nu)
    psi = heading(table, past.x)
    _state(mpc, past, eta, psi)
    at = n + mpc.increments * m
    shift = 0.0
    for i in range(mpc.steps):
        row = k + (i + 1) * mpc.every
        for j in range(m):
            ahead = mpc.setpoints and mpc.outlook.reference.shape[0] > 0
            target = (
                mpc.outlook.reference[min(row, mpc.outlook.reference.shape[0] - 1), j]
                if ahead
                else eta_d[j]
            )
            if table.turning and j == 2 and i == 0:
                shift = 2.0 * np.pi * np.round((target - psi) / (2.0 * np.pi))
            mpc.now[j] = target - mpc.error[j] - (shift if j == 2 and table.turning else 0.0)
        to_axes(table.turning, psi, mpc.now[:m], theta[at + i * m : at + (i + 1) * m])
    at += mpc.steps * m
    _disturbance(mpc, past, psi, at)
    at += mpc.steps * r
    to_axes(table.turning, psi - past.axes[0], past.command, mpc.last)
    for i in range(r):
        mpc.last[i] /= limits[i]
        if k == 0:  # the first command compensates the known disturbance
            mpc.last[i] = -mpc.known[i] / limits[i]
        if mpc.limited:  # the rotation to the new axes can exceed the limits
            mpc.last[i] = min(max(mpc.last[i], -1.0), 1.0)
        theta[at + i] = mpc.last[i]
    remember(table, past, psi, eta, mpc.known, mpc.outlook)


@lean_kernel
def _state(mpc: MpcTable, past: Memory, eta: Array, psi: float) -> None:
    """Write x_0 to theta, and to `error` the pose that the reference is relative to."""
    n, m = past.x.shape[0], eta.shape[0]
    turning, theta = mpc.observer.turning, mpc.theta
    for i in range(m):
        mpc.error[i] = 0.0
    for i in range(n):
        mpc.now[i] = past.x[i]
        if mpc.increments:
            mpc.now[i] = past.x[i] - past.x_last[i] if past.instant[0] > 0 else 0.0
        elif turning and i < m:
            mpc.now[i], mpc.error[i] = 0.0, past.x[i]
    to_axes(turning, psi, mpc.now, theta[:n])
    if mpc.increments:
        for i in range(m):
            mpc.error[i] = past.y_last[i] if past.instant[0] > 0 else eta[i]
            theta[n + i] = 0.0


@lean_kernel
def _disturbance(mpc: MpcTable, past: Memory, psi: float, at: int) -> None:
    """Write d_0 ... d_{N-1} to theta: known disturbance plus bias, or its increments."""
    n, r, k = past.x.shape[0], past.command.shape[0], past.instant[0]
    table, theta, limits = mpc.observer, mpc.theta, mpc.observer.limits
    to_axes(table.turning, psi, past.x, mpc.change)
    velocity = mpc.change[n - r :]
    known_force(table, psi, velocity, mpc.outlook, k, True, mpc.known)
    to_axes(table.turning, psi, past.bias, mpc.tau)
    for j in range(r):
        mpc.last[j] = mpc.known[j]
    for i in range(mpc.steps):
        if i > 0 and mpc.winds:
            known_force(table, psi, velocity, mpc.outlook, k + i * mpc.every, False, mpc.last)
        for j in range(r):
            theta[at + i * r + j] = (mpc.last[j] + mpc.tau[j]) / limits[j]
            mpc.tau[j] *= table.bias_decay
    if mpc.increments:
        for i in range(mpc.steps - 1, 0, -1):
            for j in range(r):
                theta[at + i * r + j] -= theta[at + (i - 1) * r + j]
        to_axes(table.turning, psi - past.axes[0], past.known, mpc.last)
        for j in range(r):
            before = mpc.last[j] if k > 0 else mpc.known[j]
            theta[at + j] = (mpc.known[j] - before) / limits[j]


_write = lean_kernel(write_parameters)


@lean_kernel
def _linear_step(
    mpc: MpcTable, past: Memory, eta: Array, nu: Array, eta_d: Array, nu_d: Array,
    nu_dot_d: Array, tau: Array, tau_fb: Array,
) -> None:  # fmt: skip
    """The command without limits: u_0 = G theta, or u_{-1} + G theta."""
    if past.instant[0] % mpc.every == 0:
        _write(mpc, past, eta, nu, eta_d)
        for i in range(mpc.tau.shape[0]):
            total = 0.0
            for j in range(mpc.theta.shape[0]):
                total += mpc.gain[i, j] * mpc.theta[j]
            mpc.tau[i] = (total + mpc.increments * mpc.last[i]) * mpc.observer.limits[i]
        accept(past, mpc.tau, mpc.observer.limits, False)
    for i in range(tau.shape[0]):
        tau[i] = tau_fb[i] = past.command[i]
    past.instant[0] += 1


CONTROLLERS[MpcTable] = _linear_step
_prepare = kernel(write_parameters)


def _quadratic_step(
    mpc: QpTable, past: Memory, eta: Array, nu: Array, eta_d: Array, nu_d: Array,
    nu_dot_d: Array, tau: Array, tau_fb: Array,
) -> None:  # fmt: skip
    """The command within the limits; if the problem has no solution, the last command."""
    table = mpc.table
    if past.instant[0] % table.every == 0:
        _prepare(table, past, eta, nu, eta_d)
        z = mpc.solver.solve(table.theta)
        if z is None:
            past.failures[0] += 1
        else:
            share = z[: len(tau)]
            if table.increments:
                share = share + table.last
            np.multiply(np.clip(share, -1.0, 1.0), table.observer.limits, out=past.command)
    tau[:] = tau_fb[:] = past.command
    past.instant[0] += 1


CONTROLLERS[QpTable] = _quadratic_step


Formulation = Literal["standard", "reduced", "condensed", "integral"]
FORMULATIONS: dict[Formulation, Callable[[Horizon], Quadratic]] = {
    "standard": horizon.standard,
    "reduced": horizon.reduced,
    "condensed": horizon.condensed,
    "integral": horizon.increments,
}


def _weight_of(options: Mapping[str, object]) -> str:
    """The weight of the vessel on the unknowns of a formulation: forces, or their increments."""
    name = "increment_weight" if options.get("formulation") == "integral" else "input_weight"
    return f"tuning.control.{name}"


@dataclass(frozen=True)
class Mpc(Controller):
    """Model predictive control; the module describes `preview`, Lqi the other options.

    `formulation`, Bargouth (2022), section 3.6: `standard`, z = (u, x, e, y); `reduced`, z =
    (u, x); `condensed`, z = u, the simple MPC of Di Ruscio; `integral`, z = Delta u, with integral
    action. `input_weight` weights the command as a fraction of `limits` [N, Nm], for `integral` its
    increments per sample, which `rate_limits` [N/s, Nm/s] bound (None: no bound). `horizon` is the
    number of predicted samples. With `period_s` None a command is computed at every loop instant.
    """

    formulation: Formulation
    horizon: Annotated[int, Ge(1), Le(1000), FromVessel("tuning.control.horizon")]
    preview: Preview
    error_weight: Annotated[tuple[float, ...], FromVessel("tuning.control.error_weight")]
    input_weight: Annotated[tuple[float, ...], FromVessel(_weight_of)]
    limits: Annotated[tuple[float, ...], FromVessel("force_limits")]
    limited: bool
    period_s: Annotated[float | None, FromVessel("tuning.control.period_s")]
    estimator: Estimator
    kalman: Kalman
    wind: Annotated[WindForce | None, FromVessel("tuning.windage")]
    rate_limits: tuple[float, ...] | None = None

    takes_state_space: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_ranges(self)
        n = len(self.limits)
        check_weights("limits", self.limits, n, positive=True)
        check_weights("error_weight", self.error_weight, n, positive=False)
        check_weights("input_weight", self.input_weight, n, positive=True)
        if self.rate_limits is not None:
            if not self.incremental:
                raise ConfigurationError(
                    f"rate_limits: got {list(self.rate_limits)} with "
                    f"formulation={self.formulation}, expected null: only formulation=integral "
                    "supports rate limits"
                )
            check_weights("rate_limits", self.rate_limits, n, positive=True)

    @property
    def incremental(self) -> bool:
        """Whether the unknowns are increments of the command."""
        return self.formulation == "integral"

    def design(self, model: Model, period_s: float) -> DesignModel:
        """The prediction model at the controller's period."""
        own = samples(self.period_s, period_s) * period_s
        return design_model(model, self.limits, own, self.wind)

    def problem(self, design: DesignModel) -> Horizon:
        """The optimal control problem on a design model."""
        model = design.model.with_integral_action() if self.incremental else design.model
        weights = np.diag(self.error_weight), np.diag(self.input_weight)
        rate = None
        if self.rate_limits is not None:
            rate = np.array(self.rate_limits) * design.period_s / design.limits
        return Horizon(model.A, model.B, model.C, *weights, self.horizon, rate)

    def write(self, problem: Horizon) -> Quadratic:
        """The problem as a quadratic program, in the chosen formulation."""
        return FORMULATIONS[self.formulation](problem)

    def build(self, model: Model, period_s: float) -> tuple[MpcTable | QpTable, Memory]:
        """Parameters and initial state of the step, for a model and loop period [s]."""
        design = self.design(model, period_s)
        problem = self.problem(design)
        quadratic = self.write(problem)
        n, r = design.model.B.shape
        m = len(design.model.C)
        work = (np.zeros(size) for size in (problem.width, n, n, m, r, r, r))
        table = MpcTable(
            observer_of(design, self.estimator, self.kalman), NO_OUTLOOK,
            horizon.unconstrained_gain(problem, quadratic), self.horizon, self.incremental,
            self.limited, self.preview != "none", self.preview == "setpoint_and_wind",
            samples(self.period_s, period_s), *work,
        )  # fmt: skip
        parameters = QpTable(table, Solver(quadratic)) if self.limited else table
        return parameters, memory(n, m, r)

    def foresee(self, parameters: MpcTable | QpTable, outlook: Outlook) -> MpcTable | QpTable:
        """The parameters with the forecast of the weather and the mission."""
        if isinstance(parameters, QpTable):
            return parameters._replace(table=parameters.table._replace(outlook=outlook))
        return parameters._replace(outlook=outlook)

    def command_limits(self) -> tuple[float, ...] | None:
        """The limits [N, Nm] if the commands are limited, else None."""
        return self.limits if self.limited else None

    def failures(self, state: Memory) -> int:
        """Number of samples at which the problem had no solution."""
        return int(state.failures[0])

    def command_rows(self, period_s: float) -> int:
        """Number of loop instants between two commands."""
        return samples(self.period_s, period_s)

    def preview_rows(self, period_s: float) -> int:
        """Number of loop instants by which a step of the reference is known in advance."""
        known = self.preview != "none"
        return self.horizon * self.command_rows(period_s) if known else 0

    def diagnostics(self, model: Model, period_s: float) -> list[Diagnostic]:
        """The design's order, controllability and unconstrained closed-loop spectral radius."""
        design = self.design(model, period_s)
        problem = self.problem(design)
        gain = horizon.unconstrained_gain(problem, self.write(problem))
        radius = closed_loop_radius(problem.A, problem.B, gain[:, problem.parameters[0]])
        table = observer_of(design, self.estimator, self.kalman)
        return [
            *design.diagnostics(),
            *estimator_diagnostics(table),
            Diagnostic("spectral_radius", "all", radius),
            *si_weights(design, self.error_weight, self.input_weight),
        ]
