"""Model predictive control of the heading on the linearised steered model.

x = (v, r, psi) moves by the believed model linearised ahead at the commanded speed, discretised at
the controller's period. The unknowns are increments of the helm over the horizon,

    min sum Q (psi - psi_d)^2 + P (Delta delta / limit)^2

within the limit of the helm and of its rate. Increments give integral action: a constant moment or
current leaves no error. Bargouth (2022), section 3.6.4, with the helm in place of the forces.
"""

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np

from seatrial.models.control.autopilot import SteeringController
from seatrial.models.control.controller import Model
from seatrial.models.control.horizon import Horizon, Solver, increments, unconstrained_gain
from seatrial.models.control.linear_design import closed_loop_radius
from seatrial.models.errors import ConfigurationError
from seatrial.models.findings import Finding
from seatrial.models.ranges import Positive, PositiveInt
from seatrial.models.simulation.registry import CONTROLLERS
from seatrial.models.simulation.statespace import StateSpace
from seatrial.models.vessel.basis import Array, Codes
from seatrial.models.vessel.kinematics import wrap
from seatrial.models.vessel.tuning import FromVessel


class SteeredMpcTable(NamedTuple):
    """Parameters of the step; SI units, radians."""

    base: Array  # (n_inputs,)
    helm: int
    yaw: int
    moving: Codes  # indices of sway and yaw rate
    limit: float
    steps: int
    every: int
    solver: Solver


class SteeredMemory(NamedTuple):
    """State of the step."""

    last: Array  # (n,) state at the last command
    share: Array  # (1,) helm over its limit
    instant: Codes  # (1,)
    failures: Codes  # (1,)


def _step(
    mpc: SteeredMpcTable, past: SteeredMemory, eta: Array, nu: Array, eta_d: Array, nu_d: Array,
    nu_dot_d: Array, tau: Array, tau_fb: Array,
) -> None:  # fmt: skip
    """The first of the best increments; if the problem has no solution, the last helm."""
    if past.instant[0] % mpc.every == 0:
        now = np.append(nu[mpc.moving], eta[mpc.yaw])
        if past.instant[0] == 0:
            past.last[:] = now
        error = wrap(np.array([eta_d[mpc.yaw] - past.last[-1]]))
        theta = np.concatenate(
            [now - past.last, [0.0], np.tile(error, mpc.steps), np.zeros(mpc.steps), past.share]
        )
        z = mpc.solver.solve(theta)
        if z is None:
            past.failures[0] += 1
        else:
            past.share[:] = np.clip(past.share + z[:1], -1.0, 1.0)
        past.last[:] = now
    tau[:] = mpc.base
    tau[mpc.helm] = mpc.limit * past.share[0]
    tau_fb[:] = tau
    past.instant[0] += 1


CONTROLLERS[SteeredMpcTable] = _step


@dataclass(frozen=True, kw_only=True)
class SteeredMpc(SteeringController):
    """Model predictive control of the heading by the input `helm`.

    `horizon` samples of `interval` L / U at the commanded speed are predicted. An error of the
    heading of `error_deg` costs as much as an increment of `change` of the helm's limit.
    """

    horizon: PositiveInt = 40
    interval: Positive = 0.1
    error_deg: Positive = 5.0
    change: Positive = 0.2
    input_rates: Annotated[tuple[float | None, ...], FromVessel("input_rates")]

    def command_rows(self, period_s: float) -> int:
        """Number of loop instants between two commands."""
        return max(1, round(self.interval * self.length_m / self.speed_m_s / period_s))

    def preview_rows(self, period_s: float) -> int:
        """The set-point is held over the horizon."""
        return 0

    @property
    def limit(self) -> float:
        """Largest helm to both sides [rad]."""
        low, high = self.input_low[self.index], self.input_high[self.index]
        if not low < 0.0 < high:
            raise ConfigurationError(
                f"controller.helm: got limits from {low:.4g} to {high:.4g}, expected both sides"
            )
        return min(-low, high)

    def problem(self, model: Model, period_s: float) -> Horizon:
        """The optimal control problem at a loop period [s]."""
        linear = self.steered(model)
        rows = [linear.dofs.index(dof) for dof in ("sway", "yaw") if dof in linear.dofs]
        n, own = len(rows), self.command_rows(period_s) * period_s
        A, B = np.zeros((n + 1, n + 1)), np.zeros((n + 1, 1))
        A[:n, :n], B[:n, 0] = linear.A[np.ix_(rows, rows)], self.limit * linear.B[rows, self.index]
        A[n, n - 1] = 1.0
        heading = np.eye(n + 1)[-1:]
        D = np.zeros((1, 1))
        continuous = StateSpace(A, B, heading, D, None, inputs=(self.helm,), outputs=("psi",))
        design = continuous.discretised(own).with_integral_action()
        Q = np.array([[1.0 / np.radians(self.error_deg) ** 2]])
        P = np.array([[1.0 / self.change**2]])
        rate = self.input_rates[self.index]
        largest = None if rate is None else np.array([rate * own / self.limit])
        return Horizon(design.A, design.B, design.C, Q, P, self.horizon, largest)

    def build(self, model: Model, period_s: float) -> tuple[SteeredMpcTable, SteeredMemory]:
        """Parameters and initial state of the step, which runs in Python."""
        problem, linear = self.problem(model, period_s), self.steered(model)
        rows = [linear.dofs.index(dof) for dof in ("sway", "yaw") if dof in linear.dofs]
        table = SteeredMpcTable(
            self.base, self.index, linear.dofs.index("yaw"), np.array(rows), self.limit,
            self.horizon, self.command_rows(period_s), Solver(increments(problem)),
        )  # fmt: skip
        counts = np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.int64)
        share = self.base[self.index : self.index + 1] / self.limit
        return table, SteeredMemory(np.zeros(len(rows) + 1), share, *counts)

    def failures(self, state: SteeredMemory) -> int:
        """Number of commands for which the problem had no solution."""
        return int(state.failures[0])

    def remarks(self, model: Model, period_s: float) -> list[Finding]:
        """Spectral radius of the loop without limits."""
        problem = self.problem(model, period_s)
        gain = unconstrained_gain(problem, increments(problem))[:, problem.parameters[0]]
        radius = closed_loop_radius(problem.A, problem.B, gain)
        return [Finding("spectral_radius", "all", radius)]
