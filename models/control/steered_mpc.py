"""Model predictive control of the heading on the linearised steered model.

x = (v, r, psi, delta) moves by the nominal model linearised ahead at the commanded speed,
discretised at the controller's period, with the lag of the helm if it has one. The unknowns are
increments of the commanded helm over the horizon,

    min sum Q ((psi - psi_d)^2 + (T_d r)^2) + P (Delta delta / limit)^2

within the limit of the helm and of its rate. With T_d = 0 a step of the course overshoots, as it
does for any quadratic cost of the heading alone. Increments give integral action: a constant
moment or current leaves no error. Bargouth (2022), section 3.6.4, with the helm in place of the
forces.
"""

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Ge, Le

from seatrial.models.control.autopilot import SteeringController
from seatrial.models.control.controller import Model
from seatrial.models.control.horizon import Horizon, Solver, increments, unconstrained_gain
from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError
from seatrial.models.ranges import NotNegative, Positive
from seatrial.models.simulation.registry import CONTROLLERS
from seatrial.models.simulation.statespace import StateSpace, spectral_radius
from seatrial.models.vessel.basis import Array, Codes
from seatrial.models.vessel.kinematics import wrap
from seatrial.models.vessel.steering import SteeringModel
from seatrial.models.vessel.tuning import FromVessel


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


def _step(
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


CONTROLLERS[SteeredMpcTable] = _step


@dataclass(frozen=True, kw_only=True)
class SteeredMpc(SteeringController):
    """Model predictive control of the heading by the input `helm`.

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
            decay, self.horizon, every, Solver(increments(problem)),
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
        gain = unconstrained_gain(problem, increments(problem))[:, problem.parameters[0]]
        radius = spectral_radius(problem.A + problem.B @ gain)
        return [Diagnostic("spectral_radius", "all", radius)]


def _moving(linear: SteeringModel) -> Codes:
    """Rows of sway and yaw, or of yaw alone."""
    return np.array([linear.dofs.index(dof) for dof in ("sway", "yaw") if dof in linear.dofs])
