"""Linear-quadratic control with integral action, in incremental form.

    J = 1/2 sum (y_k - r)' Q (y_k - r) + Delta u_k' P Delta u_k
    u_k = u_{k-1} + G1 (x_k - x_{k-1}) + G2 (y_{k-1} - r_k)

Bargouth (2022), (3.38)-(3.46). A constant disturbance cancels in the increments, so it leaves no
steady-state error. At an amplitude limit the increment is clipped, which prevents integral windup.
"""

from dataclasses import dataclass
from typing import Annotated, ClassVar, NamedTuple

import numpy as np
from scipy.linalg import solve_discrete_are

from seatrial.models.compiled import lean_kernel
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
from seatrial.models.control.linear_design import (
    DesignModel,
    check_weights,
    closed_loop_radius,
    design_model,
)
from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import FORCE_UNIT, POSE_UNIT
from seatrial.models.simulation.registry import CONTROLLERS
from seatrial.models.simulation.statespace import StateSpace
from seatrial.models.simulation.voyage import NO_OUTLOOK, Outlook
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import wrap_kernel
from seatrial.models.vessel.tuning import FromVessel
from seatrial.models.weather.wind import WindForce


class LqiTable(NamedTuple):
    """Parameters of the compiled step."""

    observer: Observer
    outlook: Outlook
    gain: Array  # (r, n + m) [N, Nm] of (Delta x, y_{k-1} - r)
    limited: bool
    every: int  # number of loop instants between two commands
    change: Array  # (n,) work space: increments, error, force
    now: Array  # (n,)
    error: Array  # (m,)
    known: Array  # (r,)
    command: Array  # (r,)


@lean_kernel
def _step(
    lqi: LqiTable, past: Memory, eta: Array, nu: Array, eta_d: Array, nu_d: Array,
    nu_dot_d: Array, tau: Array, tau_fb: Array,
) -> None:  # fmt: skip
    """u_k = u_{k-1} + G1 Delta x + G2 (y_{k-1} - r_k), within the limits; held between samples."""
    if past.instant[0] % lqi.every == 0:
        _command(lqi, past, eta, nu, eta_d)
    for i in range(tau.shape[0]):
        tau[i] = tau_fb[i] = past.command[i]
    past.instant[0] += 1


@lean_kernel
def _command(lqi: LqiTable, past: Memory, eta: Array, nu: Array, eta_d: Array) -> None:
    """Compute the command of one sample and store it in the memory."""
    n, m, r = past.x.shape[0], eta.shape[0], past.command.shape[0]
    turning, tau = lqi.observer.turning, lqi.command
    estimate(lqi.observer, past, eta, nu)
    psi = heading(lqi.observer, past.x)
    to_axes(turning, psi, past.x, lqi.now)
    known_force(lqi.observer, psi, lqi.now[n - m :], lqi.outlook, past.instant[0], True, lqi.known)
    if past.instant[0] == 0:
        for i in range(r):
            tau[i] = -lqi.known[i]
    else:
        for i in range(n):
            lqi.now[i] = past.x[i] - past.x_last[i]
        to_axes(turning, psi, lqi.now, lqi.change)
        for i in range(m):
            lqi.now[i] = past.y_last[i] - eta_d[i]
        to_axes(turning, psi, lqi.now[:m], lqi.error)
        if turning:
            lqi.error[2] = wrap_kernel(lqi.error[2])
        to_axes(turning, psi - past.axes[0], past.command, tau)
        for i in range(r):
            for j in range(n):
                tau[i] += lqi.gain[i, j] * lqi.change[j]
            for j in range(m):
                tau[i] += lqi.gain[i, n + j] * lqi.error[j]
    remember(lqi.observer, past, psi, eta, lqi.known, lqi.outlook)
    accept(past, tau, lqi.observer.limits, lqi.limited)


CONTROLLERS[LqiTable] = _step


def lqi_gain(model: StateSpace, Q: Array, P: Array) -> Array:
    """Gain G (r, n + m) of Delta u = G (Delta x, y_{k-1} - r), from the Riccati equation.

    Q (m, m) weights the output error, P (r, r) the input increments. Raises ConfigurationError
    when the Riccati equation has no stabilising solution.
    """
    augmented = model.with_integral_action()
    try:
        S = solve_discrete_are(augmented.A, augmented.B, augmented.C.T @ Q @ augmented.C, P)
    except (np.linalg.LinAlgError, ValueError) as error:
        raise ConfigurationError(f"controller=lqi: the design is not stable: {error}") from error
    return -np.asarray(
        np.linalg.solve(P + augmented.B.T @ S @ augmented.B, augmented.B.T @ S @ augmented.A)
    )


@dataclass(frozen=True)
class Lqi(Controller):
    """LQ control with integral action on the pose.

    `error_weight` weights the pose error [1/m^2, 1/rad^2], `input_weight` the input increments per
    sample, as fractions of `limits` [N, Nm]. With `period_s` None a command is computed at every
    loop instant. `wind` is the wind force on the vessel if it is known and the wind is measured.
    `limited` keeps the commands within the limits.
    """

    error_weight: Annotated[tuple[float, ...], FromVessel("tuning.control.error_weight")]
    input_weight: Annotated[tuple[float, ...], FromVessel("tuning.control.increment_weight")]
    limits: Annotated[tuple[float, ...], FromVessel("force_limits")]
    limited: bool
    period_s: Annotated[float | None, FromVessel("tuning.control.period_s")]
    estimator: Estimator
    kalman: Kalman
    wind: Annotated[WindForce | None, FromVessel("tuning.windage")]

    takes_state_space: ClassVar[bool] = True

    def __post_init__(self) -> None:
        n = len(self.limits)
        check_weights("limits", self.limits, n, positive=True)
        check_weights("error_weight", self.error_weight, n, positive=True)
        check_weights("input_weight", self.input_weight, n, positive=True)

    def design(self, model: Model, period_s: float) -> DesignModel:
        """The design model at the controller's period."""
        own = samples(self.period_s, period_s) * period_s
        return design_model(model, self.limits, own, self.wind)

    def build(self, model: Model, period_s: float) -> tuple[LqiTable, Memory]:
        """Parameters and initial state of the compiled step, for a model and loop period [s]."""
        design = self.design(model, period_s)
        gain = lqi_gain(design.model, np.diag(self.error_weight), np.diag(self.input_weight))
        n, r = design.model.B.shape
        m = len(design.model.C)
        work = (np.zeros(size) for size in (n, n, m, r, r))
        table = LqiTable(
            observer_of(design, self.estimator, self.kalman), NO_OUTLOOK,
            np.ascontiguousarray(design.limits[:, None] * gain), self.limited,
            samples(self.period_s, period_s), *work,
        )  # fmt: skip
        return table, memory(n, m, r)

    def foresee(self, parameters: LqiTable, outlook: Outlook) -> LqiTable:
        """The parameters with the forecast of the weather and the mission."""
        return parameters._replace(outlook=outlook)

    def command_limits(self) -> tuple[float, ...] | None:
        """The limits [N, Nm] if the commands are limited, else None."""
        return self.limits if self.limited else None

    def command_rows(self, period_s: float) -> int:
        """Number of loop instants between two commands."""
        return samples(self.period_s, period_s)

    def diagnostics(self, model: Model, period_s: float) -> list[Diagnostic]:
        """The design's order, controllability and closed-loop spectral radius."""
        design = self.design(model, period_s)
        table, _ = self.build(model, period_s)
        augmented = design.model.with_integral_action()
        gain = table.gain / design.limits[:, None]
        radius = closed_loop_radius(augmented.A, augmented.B, gain)
        return [
            *design.diagnostics(),
            *estimator_diagnostics(table.observer),
            Diagnostic("spectral_radius", "all", radius),
            *si_weights(design, self.error_weight, self.input_weight),
        ]


def samples(own_s: float | None, period_s: float) -> int:
    """Number of loop instants in the controller's period `own_s` [s]; 1 if that is None.

    Raises ConfigurationError when it is not a multiple of the loop period `period_s` [s].
    """
    if own_s is None:
        return 1
    times = round(own_s / period_s)
    if times < 1 or abs(times * period_s - own_s) > 1e-9 * own_s:
        raise ConfigurationError(
            f"controller.period_s: got {own_s:g} s, expected a multiple of sample_time_s, "
            f"{period_s:g} s"
        )
    return times


def si_weights(
    design: DesignModel, error_weight: tuple[float, ...], input_weight: tuple[float, ...]
) -> list[Diagnostic]:
    """The weights in SI units; those of the input are divided by the squared limits."""
    diagnostics = []
    for i, dof in enumerate(design.dofs):
        diagnostics.append(
            Diagnostic("error_weight", dof, error_weight[i], f"1/{POSE_UNIT[dof]}^2")
        )
        scaled = float(input_weight[i] / design.limits[i] ** 2)
        diagnostics.append(Diagnostic("input_weight", dof, scaled, f"1/{FORCE_UNIT[dof]}^2"))
    return diagnostics
