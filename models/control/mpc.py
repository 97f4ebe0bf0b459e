"""Model predictive control of the pose, in four formulations of one problem, and of the heading.

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

from seatrial.models.compiled import kernel
from seatrial.models.control import horizon
from seatrial.models.control.autopilot import SteeringController
from seatrial.models.control.controller import Model
from seatrial.models.control.estimator import Memory
from seatrial.models.control.horizon import Horizon, Quadratic, Solver
from seatrial.models.control.linear_controller import (
    Law,
    LinearController,
    LinearTable,
    write_parameters,
)
from seatrial.models.control.linear_design import DesignModel, check_weights
from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError
from seatrial.models.ranges import NotNegative, Positive, check_ranges
from seatrial.models.simulation.registry import CONTROLLERS, Parameters
from seatrial.models.simulation.statespace import StateSpace, spectral_radius
from seatrial.models.simulation.voyage import Outlook
from seatrial.models.vessel.basis import Array, Codes
from seatrial.models.vessel.kinematics import wrap
from seatrial.models.vessel.steering import SteeringModel
from seatrial.models.vessel.tuning import FromVessel

Preview = Literal["none", "setpoint", "setpoint_and_wind"]


class QpTable(NamedTuple):
    """Parameters of the step with limits, in Python: the table and the solver."""

    table: LinearTable
    solver: Solver


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
            if table.law.increments:
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


@dataclass(frozen=True, kw_only=True)
class Mpc(LinearController):
    """Model predictive control; the module describes `preview`, LinearController other options.

    `formulation`, Bargouth (2022), section 3.6: `standard`, z = (u, x, e, y); `reduced`, z =
    (u, x); `condensed`, z = u, the simple MPC of Di Ruscio; `integral`, z = Delta u, with integral
    action. `input_weight` weights the command as a fraction of `limits` [N, Nm], for `integral` its
    increments per sample, which `rate_limits` [N/s, Nm/s] bound (None: no bound). `horizon` is the
    number of predicted samples.
    """

    formulation: Formulation
    horizon: Annotated[int, Ge(1), Le(1000), FromVessel("tuning.control.horizon")]
    preview: Preview
    input_weight: Annotated[tuple[float, ...], FromVessel(_weight_of)]
    rate_limits: tuple[float, ...] | None = None

    every_error: ClassVar[bool] = False

    def __post_init__(self) -> None:
        check_ranges(self)
        super().__post_init__()
        if self.rate_limits is not None:
            if not self.incremental:
                raise ConfigurationError(
                    f"rate_limits: got {list(self.rate_limits)} with formulation="
                    f"{self.formulation}, expected null, or formulation=integral"
                )
            check_weights("rate_limits", self.rate_limits, len(self.limits), positive=True)

    @property
    def incremental(self) -> bool:
        """Whether the unknowns are increments of the command."""
        return self.formulation == "integral"

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

    def law(self, design: DesignModel) -> Law:
        """The first of the best unknowns without limits."""
        problem = self.problem(design)
        gain, preview = horizon.unconstrained_gain(problem, self.write(problem)), self.preview
        known = preview != "none", preview == "setpoint_and_wind"
        return Law(gain, self.horizon, self.incremental, *known)

    def build(self, model: Model, period_s: float) -> tuple[LinearTable | QpTable, Memory]:
        """Parameters and initial state of the step, for a model and loop period [s]."""
        table, state = super().build(model, period_s)
        if not self.limited:
            return table, state
        problem = self.problem(self.design(model, period_s))
        return QpTable(table, Solver(self.write(problem))), state

    def foresee(self, parameters: Parameters, outlook: Outlook) -> Parameters:
        """The parameters with the forecast of the weather and the mission."""
        if isinstance(parameters, QpTable):
            return parameters._replace(table=super().foresee(parameters.table, outlook))
        return super().foresee(parameters, outlook)

    def failures(self, state: Memory) -> int:
        """Number of samples at which the problem had no solution."""
        return int(state.failures[0])

    def preview_rows(self, period_s: float) -> int:
        """Number of loop instants by which a step of the reference is known in advance."""
        known = self.preview != "none"
        return self.horizon * self.command_rows(period_s) if known else 0


class SteeredMpcTable(NamedTuple):
    """Parameters of the step; SI units, radians."""

    base: Array  # (n_inputs,)
    helm: Array  # (n_inputs,) change of the inputs by a unit of helm
    yaw: int
    moving: Codes  # indices of sway and yaw rate
    limit: float
    decay: float  # of the lag of the helm over a period; 0: none
    steps: int
    every: int
    solver: Solver


class SteeredMemory(NamedTuple):
    """State of the step."""

    last: Array  # (n,) state at the last command
    share: Array  # (1,) commanded helm over its limit
    helm: Array  # (1,) helm over its limit, by its lag
    instant: Codes  # (1,)
    failures: Codes  # (1,)


def _steered_step(
    mpc: SteeredMpcTable, past: SteeredMemory, eta: Array, nu: Array, eta_d: Array, nu_d: Array,
    nu_dot_d: Array, tau: Array, tau_fb: Array,
) -> None:  # fmt: skip
    """The first of the best increments; if the problem has no solution, the last helm."""
    if past.instant[0] % mpc.every == 0:
        n = len(mpc.moving)
        now = np.concatenate([nu[mpc.moving], [eta[mpc.yaw]], past.helm])[: len(past.last)]
        if past.instant[0] == 0:
            past.last[:] = now
        error = wrap(np.array([eta_d[mpc.yaw] - past.last[n]]))
        wanted = np.tile([error[0], 0.0], mpc.steps)  # of the heading and of its rate
        theta = np.concatenate([now - past.last, [0.0], wanted, np.zeros(mpc.steps), past.share])
        z = mpc.solver.solve(theta)
        if z is None:
            past.failures[0] += 1
        else:
            past.share[:] = np.clip(past.share + z[:1], -1.0, 1.0)
        past.last[:] = now
        past.helm[:] = past.share + mpc.decay * (past.helm - past.share)
    tau[:] = mpc.base + mpc.helm * (mpc.limit * past.share[0])
    tau_fb[:] = tau
    past.instant[0] += 1


CONTROLLERS[SteeredMpcTable] = _steered_step


@dataclass(frozen=True, kw_only=True)
class SteeredMpc(SteeringController):
    """Model predictive control of the heading by the input `helm`, on the linearised steered model.

    x = (v, r, psi, delta) moves by the nominal model linearised ahead at the commanded speed,
    discretised at the controller's period, with the lag of the helm if it has one. The unknowns
    are increments of the commanded helm over the horizon,

        min sum Q ((psi - psi_d)^2 + (T_d r)^2) + P (Delta delta / limit)^2

    within the limit of the helm and of its rate. With T_d = 0 a step of the course overshoots, as
    it does for any quadratic cost of the heading alone. Increments give integral action: a
    constant moment or current leaves no error. Bargouth (2022), section 3.6.4, with the helm in
    place of the forces.

    `horizon` samples of `interval` L / U at the commanded speed are predicted. An error of the
    heading of `error_deg` costs as much as an increment of `change` of the helm's limit,
    and as a yaw rate that changes the heading as much in `damping` L / U.
    """

    horizon: Annotated[int, Ge(1), Le(1000)] = 40
    interval: Positive = 0.1
    error_deg: Positive = 5.0
    change: Positive = 0.2
    damping: NotNegative = 1.0
    input_rates: Annotated[tuple[float | None, ...], FromVessel("input_rates")]
    input_lags: Annotated[tuple[float | None, ...], FromVessel("input_lags")]

    def command_rows(self, period_s: float) -> int:
        """Number of loop instants between two commands."""
        return max(1, round(self.interval * self.length_m / self.speed_m_s / period_s))

    @property
    def limit(self) -> float:
        """Largest helm to both sides from the start of its inputs [rad]."""
        moved = self.helm_direction != 0.0
        base, low, high = self.base[moved], self.input_low, self.input_high
        reach = float(np.min([base - np.array(low)[moved], np.array(high)[moved] - base]))
        if not reach > 0.0:
            raise ConfigurationError(
                f"controller.helm: got a start of {base} between its limits {low} and {high}, "
                f"expected room to both sides"
            )
        return reach

    @property
    def lag_s(self) -> float | None:
        """Time constant of the helm [s]; None: it follows at once."""
        return self.input_lags[int(np.flatnonzero(self.helm_direction)[0])]

    def problem(self, model: Model, period_s: float) -> Horizon:
        """The optimal control problem at a loop period [s]."""
        linear = self.steered(model).along(self.helm_direction)
        rows = _moving(linear)
        n, own, lag = len(rows), self.command_rows(period_s) * period_s, self.lag_s
        states = n + 1 if lag is None else n + 2
        A, B = np.zeros((states, states)), np.zeros((states, 1))
        by_helm = self.limit * linear.B[rows, 0]
        A[:n, :n], A[n, n - 1] = linear.A[np.ix_(rows, rows)], 1.0
        if lag is None:
            B[:n, 0] = by_helm
        else:
            A[:n, n + 1], A[n + 1, n + 1], B[n + 1, 0] = by_helm, -1.0 / lag, 1.0 / lag
        heading, D = np.eye(states)[n : n + 1], np.zeros((1, 1))
        continuous = StateSpace(A, B, heading, D, None, inputs=("helm",), outputs=("psi",))
        design = continuous.discretised(own).with_integral_action()
        rate_of = np.eye(states + 1)[n : n + 1] / own  # increment of the heading over a period
        damping_s = self.damping * self.length_m / self.speed_m_s
        Q = np.diag([1.0, damping_s**2]) / np.radians(self.error_deg) ** 2
        P = np.array([[1.0 / self.change**2]])
        limits = [self.input_rates[i] for i in np.flatnonzero(self.helm_direction)]
        rate = min((one for one in limits if one is not None), default=None)
        largest = None if rate is None else np.array([rate * own / self.limit])
        C = np.vstack([design.C, rate_of])
        return Horizon(design.A, design.B, C, Q, P, self.horizon, largest)

    def build(self, model: Model, period_s: float) -> tuple[SteeredMpcTable, SteeredMemory]:
        """Parameters and initial state of the step, which runs in Python."""
        problem, linear = self.problem(model, period_s), self.steered(model)
        every, lag = self.command_rows(period_s), self.lag_s
        decay = 0.0 if lag is None else float(np.exp(-every * period_s / lag))
        table = SteeredMpcTable(
            self.base, self.helm_direction, linear.dofs.index("yaw"), _moving(linear), self.limit,
            decay, self.horizon, every, Solver(horizon.increments(problem)),
        )  # fmt: skip
        counts = np.zeros((2, 1), dtype=np.int64)
        last = np.zeros(len(problem.A) - 1)  # without the integral action
        return table, SteeredMemory(last, np.zeros(1), np.zeros(1), *counts)

    def failures(self, state: SteeredMemory) -> int:
        """Number of commands for which the problem had no solution."""
        return int(state.failures[0])

    def diagnostics(self, model: Model, period_s: float) -> list[Diagnostic]:
        """Spectral radius of the loop without limits."""
        problem = self.problem(model, period_s)
        gain = horizon.unconstrained_gain(problem, horizon.increments(problem))
        radius = spectral_radius(problem.A + problem.B @ gain[:, problem.parameters[0]])
        return [Diagnostic("spectral_radius", "all", radius)]


def _moving(linear: SteeringModel) -> Codes:
    """Rows of sway and yaw, or of yaw alone."""
    return np.array([linear.dofs.index(dof) for dof in ("sway", "yaw") if dof in linear.dofs])
