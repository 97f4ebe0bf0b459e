"""Controllers of the pose that are designed on a linear model: their options, and the linear law.

    u_0 = G theta,  theta = (x_0, r_1 ... r_N, d_0 ... d_{N-1}, u_{-1})

The law of `horizon` without limits, and with N = 1 the linear-quadratic regulator with integral
action. In the formulation `increments` x_0 is (Delta x_0, y_{-1}), d are increments, and
u_0 = u_{-1} + G theta. The regulator is in this form, Bargouth (2022), (3.38)-(3.46):

    J = 1/2 sum (y_k - r)' Q (y_k - r) + Delta u_k' P Delta u_k
    u_k = u_{k-1} + G1 (x_k - x_{k-1}) + G2 (y_{k-1} - r_k)

A constant disturbance cancels in the increments, so it leaves no steady-state error. At an
amplitude limit the increment is clipped, which prevents integral windup.
"""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Annotated, ClassVar, NamedTuple

import numpy as np

from seatrial.models.compiled import lean_kernel
from seatrial.models.control.controller import Controller, Model
from seatrial.models.control.estimator import (
    Estimator,
    Kalman,
    Memory,
    Observer,
    estimate,
    estimator_diagnostics,
    heading,
    known_force,
    memory,
    observer_of,
    product,
    remember,
    to_axes,
)
from seatrial.models.control.linear_design import DesignModel, check_weights, design_model, riccati
from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError
from seatrial.models.simulation.registry import CONTROLLERS, Parameters
from seatrial.models.simulation.statespace import StateSpace, spectral_radius
from seatrial.models.simulation.voyage import NO_OUTLOOK, Outlook
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.tuning import FromVessel
from seatrial.models.weather.wind import WindForce


class Law(NamedTuple):
    """The unconstrained command, and which parameters it is of."""

    gain: Array  # (r, width): as a fraction of the limits, per parameter
    steps: int = 1  # of the horizon
    increments: bool = True
    setpoints: bool = False  # the future reference is known
    winds: bool = False  # the future wind is known
    regulator: bool = False  # the gain is of an infinite horizon


class LinearTable(NamedTuple):
    """Parameters of the compiled step, and of the problem whose parameters theta it writes."""

    observer: Observer
    outlook: Outlook
    law: Law
    limited: bool  # the last command is kept within the limits
    every: int  # number of loop instants between two commands
    theta: Array  # (width,) parameters of the problem
    now: Array  # (n,) work space
    change: Array  # (n,)
    error: Array  # (m,)
    known: Array  # (r,)
    last: Array  # (r,)
    tau: Array  # (r,)


def write_parameters(table: LinearTable, past: Memory, eta: Array, nu: Array, eta_d: Array) -> None:
    """Update the memory to this instant and write theta = (x_0, r, d, u_{-1}) in body axes.

    If the axes turn, positions are relative to the estimated pose, or to the last measured pose in
    the formulation `increments`.
    """
    n, m = past.x.shape[0], eta.shape[0]
    r, k = past.command.shape[0], past.instant[0]
    observer, law, theta, ahead = table.observer, table.law, table.theta, table.outlook.reference
    turning, rows = observer.turning, ahead.shape[0]
    estimate(observer, past, eta, nu)
    psi = heading(observer, past.x)
    _state(table, past, eta, psi)
    at = n + law.increments * m
    shift = 0.0
    for i in range(law.steps):
        row = min(k + (i + 1) * table.every, rows - 1)
        for j in range(m):
            target = eta_d[j] if rows == 0 else ahead[row, j]
            if turning and j == 2 and i == 0:
                shift = 2.0 * np.pi * np.round((target - psi) / (2.0 * np.pi))
            table.now[j] = target - table.error[j] - (shift if j == 2 and turning else 0.0)
        to_axes(turning, psi, table.now[:m], theta[at : at + m])
        at += m
    _disturbance(table, past, psi, at)
    to_axes(turning, psi - past.axes[0], past.command, table.last)
    for i in range(r):
        table.last[i] /= observer.limits[i]
        if k == 0:  # the first command compensates the known disturbance
            table.last[i] = -table.known[i] / observer.limits[i]
        if table.limited and not law.regulator:  # rotation to the new axes can exceed the limits
            table.last[i] = min(max(table.last[i], -1.0), 1.0)
        theta[at + law.steps * r + i] = table.last[i]
    remember(observer, past, psi, eta, table.known, table.outlook)


@lean_kernel
def _state(table: LinearTable, past: Memory, eta: Array, psi: float) -> None:
    """Write x_0 to theta, and to `error` the pose that the reference is relative to."""
    n, m = past.x.shape[0], eta.shape[0]
    turning, increments = table.observer.turning, table.law.increments
    for i in range(m):
        table.error[i] = past.x[i] if turning else 0.0
        if increments:
            table.error[i] = past.y_last[i] if past.instant[0] > 0 else eta[i]
            table.theta[n + i] = 0.0
    for i in range(n):
        table.now[i] = past.x[i]
        if increments:
            table.now[i] = past.x[i] - past.x_last[i] if past.instant[0] > 0 else 0.0
        elif turning and i < m:
            table.now[i] = 0.0
    to_axes(turning, psi, table.now, table.theta[:n])


@lean_kernel
def _disturbance(table: LinearTable, past: Memory, psi: float, at: int) -> None:
    """Write d_0 ... d_{N-1} to theta: known disturbance plus bias, or its increments."""
    n, r, k = past.x.shape[0], past.command.shape[0], past.instant[0]
    observer, law, theta, limits = table.observer, table.law, table.theta, table.observer.limits
    to_axes(observer.turning, psi, past.x, table.change)
    velocity = table.change[n - r :]
    known_force(observer, psi, velocity, table.outlook, k, True, table.known)
    to_axes(observer.turning, psi, past.bias, table.tau)
    for j in range(r):
        table.last[j] = table.known[j]
    for i in range(law.steps):
        if i > 0 and law.winds:
            ahead = k + i * table.every
            known_force(observer, psi, velocity, table.outlook, ahead, False, table.last)
        for j in range(r):
            theta[at + i * r + j] = (table.last[j] + table.tau[j]) / limits[j]
            table.tau[j] *= observer.bias_decay
    if law.increments:
        for i in range(law.steps * r - 1, r - 1, -1):
            theta[at + i] -= theta[at + i - r]
        to_axes(observer.turning, psi - past.axes[0], past.known, table.last)
        for j in range(r):
            before = table.last[j] if k > 0 else table.known[j]
            theta[at + j] = (table.known[j] - before) / limits[j]


_write = lean_kernel(write_parameters)


@lean_kernel
def _linear_step(
    table: LinearTable, past: Memory, eta: Array, nu: Array, eta_d: Array, nu_d: Array,
    nu_dot_d: Array, tau: Array, tau_fb: Array,
) -> None:  # fmt: skip
    """u_0 = G theta, or u_{-1} + G theta; if it is not finite, the last command.

    A regulator first compensates the known disturbance.
    """
    if past.instant[0] % table.every == 0:
        _write(table, past, eta, nu, eta_d)
        law, limits, finite = table.law, table.observer.limits, True
        product(law.gain, table.theta, table.tau)
        for i in range(tau.shape[0]):
            share = 0.0 if law.regulator and past.instant[0] == 0 else table.tau[i]
            table.tau[i] = (share + law.increments * table.last[i]) * limits[i]
            finite = finite and np.isfinite(table.tau[i])
        past.failures[0] += not finite
        for i in range(tau.shape[0] if finite else 0):
            within = min(max(table.tau[i], -limits[i]), limits[i])
            past.command[i] = within if table.limited else table.tau[i]
    for i in range(tau.shape[0]):
        tau[i] = tau_fb[i] = past.command[i]
    past.instant[0] += 1


CONTROLLERS[LinearTable] = _linear_step


@dataclass(frozen=True)
class LinearController(Controller):
    """A controller of the pose that is designed on a linear model.

    `error_weight` weights the pose error [1/m^2, 1/rad^2], `input_weight` the forces, or their
    increments per sample, as fractions of `limits` [N, Nm]. With `period_s` None a command is
    computed at every loop instant. `wind` is the wind force on the vessel if it is known and the
    wind is measured. `limited` keeps the commands within the limits.
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
    every_error: ClassVar[bool] = True  # must have a weight

    def __post_init__(self) -> None:
        n = len(self.limits)
        check_weights("limits", self.limits, n, positive=True)
        check_weights("error_weight", self.error_weight, n, positive=self.every_error)
        check_weights("input_weight", self.input_weight, n, positive=True)

    def design(self, model: Model, period_s: float) -> DesignModel:
        """The design model at the controller's period."""
        own = self.command_rows(period_s) * period_s
        return design_model(model, self.limits, own, self.wind)

    def foresee(self, parameters: Parameters, outlook: Outlook) -> Parameters:
        """The parameters with the forecast of the weather and, if it uses that, of the mission."""
        ahead = outlook.reference if parameters.law.setpoints else outlook.reference[:0]
        seen = outlook._replace(reference=ahead, obstacles=None, hull=None)
        return parameters._replace(outlook=seen)

    def command_limits(self) -> tuple[float, ...] | None:
        """The limits [N, Nm] if the commands are limited, else None."""
        return self.limits if self.limited else None

    def command_rows(self, period_s: float) -> int:
        """Number of loop instants between two commands.

        Raises ConfigurationError if the controller's period is not a multiple of that of the loop.
        """
        own = period_s if self.period_s is None else self.period_s
        times = round(own / period_s)
        if times < 1 or abs(times * period_s - own) > 1e-9 * own:
            raise ConfigurationError(
                f"controller.period_s: got {own:g} s, expected a multiple of sample_time_s, "
                f"{period_s:g} s"
            )
        return times

    @abstractmethod
    def law(self, design: DesignModel) -> Law:
        """The law without limits."""

    def build(self, model: Model, period_s: float) -> tuple[Parameters, Memory]:
        """Parameters and initial state of the compiled step, for a model and loop period [s]."""
        design, every = self.design(model, period_s), self.command_rows(period_s)
        law, (n, r), m = self.law(design), design.model.B.shape, len(design.model.C)
        observer = observer_of(design, self.estimator, self.kalman)
        work = (np.zeros(size) for size in (law.gain.shape[1], n, n, m, r, r, r))
        return LinearTable(observer, NO_OUTLOOK, law, self.limited, every, *work), memory(n, m, r)

    def diagnostics(self, model: Model, period_s: float) -> list[Diagnostic]:
        """Order, controllability and spectral radii of the design without limits."""
        design = self.design(model, period_s)
        observer, law = observer_of(design, self.estimator, self.kalman), self.law(design)
        own = design.model.with_integral_action() if law.increments else design.model
        radius = spectral_radius(own.A + own.B @ law.gain[:, : own.order])
        stability = Diagnostic("spectral_radius", "all", radius)
        return [*design.diagnostics(), *estimator_diagnostics(observer), stability]


@dataclass(frozen=True)
class Lqi(LinearController):
    """LQ control with integral action on the pose; `input_weight` weights the increments."""

    def law(self, design: DesignModel) -> Law:
        """theta = (Delta x, y_{-1}, r_1, d_0, u_{-1}); r_1 is relative to y_{-1}."""
        weights = np.diag(self.error_weight), np.diag(self.input_weight)
        gain, (n, r) = lqi_gain(design.model, *weights), design.model.B.shape
        of_theta = np.hstack([gain, -gain[:, n:], np.zeros((r, 2 * r))])
        return Law(np.ascontiguousarray(of_theta), regulator=True)


def lqi_gain(model: StateSpace, Q: Array, P: Array) -> Array:
    """Gain G (r, n + m) of Delta u = G (Delta x, y_{k-1} - r), from the Riccati equation.

    Q (m, m) weights the output error, P (r, r) the input increments. Raises ConfigurationError
    when the Riccati equation has no stabilising solution.
    """
    own = model.with_integral_action()
    A, B, reason = own.A, own.B, "controller=lqi: the design is not stable"
    S = riccati(A, B, own.C.T @ Q @ own.C, P, reason)
    return -np.asarray(np.linalg.solve(P + B.T @ S @ B, B.T @ S @ A))
