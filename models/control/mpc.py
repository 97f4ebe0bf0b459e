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

from seatrial.models.compiled import kernel
from seatrial.models.control import horizon
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
from seatrial.models.errors import ConfigurationError
from seatrial.models.ranges import check_ranges
from seatrial.models.simulation.registry import CONTROLLERS, Parameters
from seatrial.models.simulation.voyage import Outlook
from seatrial.models.vessel.basis import Array
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
                    f"rate_limits: got {list(self.rate_limits)} with "
                    f"formulation={self.formulation}, expected null: only formulation=integral "
                    "supports rate limits"
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
