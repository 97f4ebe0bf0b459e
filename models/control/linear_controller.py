"""Controllers of the pose that are designed on a linear model: their options, and the linear law.

    u_0 = G theta,  theta = (x_0, r_1 ... r_N, d_0 ... d_{N-1}, u_{-1})

The law of `horizon` without limits, and with N = 1 the linear-quadratic regulator of `lqi`. In the
formulation `increments` x_0 is (Delta x_0, y_{-1}), d are increments, and u_0 = u_{-1} + G theta.
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
from seatrial.models.control.linear_design import DesignModel, check_weights, design_model
from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import FORCE_UNIT, POSE_UNIT
from seatrial.models.simulation.registry import CONTROLLERS, Parameters
from seatrial.models.simulation.statespace import spectral_radius
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
    gain: Array  # as of Law
    steps: int
    increments: bool
    setpoints: bool
    winds: bool
    regulator: bool
    limited: bool  # the last command is kept within the limits
    every: int  # number of loop instants between two commands
    theta: Array  # (width,) parameters of the problem
    now: Array  # (n,) work space
    change: Array  # (n,)
    error: Array  # (m,)
    known: Array  # (r,)
    last: Array  # (r,)
    tau: Array  # (r,)


def write_parameters(law: LinearTable, past: Memory, eta: Array, nu: Array, eta_d: Array) -> None:
    """Update the memory to this instant and write theta = (x_0, r, d, u_{-1}) in body axes.

    If the axes turn, positions are relative to the estimated pose, or to the last measured pose in
    the formulation `increments`.
    """
    n, m = past.x.shape[0], eta.shape[0]
    r, k = past.command.shape[0], past.instant[0]
    table, theta, limits = law.observer, law.theta, law.observer.limits
    estimate(table, past, eta, nu)
    psi = heading(table, past.x)
    _state(law, past, eta, psi)
    at = n + law.increments * m
    shift = 0.0
    for i in range(law.steps):
        row = k + (i + 1) * law.every
        for j in range(m):
            ahead = law.setpoints and law.outlook.reference.shape[0] > 0
            target = (
                law.outlook.reference[min(row, law.outlook.reference.shape[0] - 1), j]
                if ahead
                else eta_d[j]
            )
            if table.turning and j == 2 and i == 0:
                shift = 2.0 * np.pi * np.round((target - psi) / (2.0 * np.pi))
            law.now[j] = target - law.error[j] - (shift if j == 2 and table.turning else 0.0)
        to_axes(table.turning, psi, law.now[:m], theta[at + i * m : at + (i + 1) * m])
    at += law.steps * m
    _disturbance(law, past, psi, at)
    at += law.steps * r
    to_axes(table.turning, psi - past.axes[0], past.command, law.last)
    for i in range(r):
        law.last[i] /= limits[i]
        if k == 0:  # the first command compensates the known disturbance
            law.last[i] = -law.known[i] / limits[i]
        if law.limited and not law.regulator:  # the rotation to the new axes can exceed the limits
            law.last[i] = min(max(law.last[i], -1.0), 1.0)
        theta[at + i] = law.last[i]
    remember(table, past, psi, eta, law.known, law.outlook)


@lean_kernel
def _state(law: LinearTable, past: Memory, eta: Array, psi: float) -> None:
    """Write x_0 to theta, and to `error` the pose that the reference is relative to."""
    n, m = past.x.shape[0], eta.shape[0]
    turning, theta = law.observer.turning, law.theta
    for i in range(m):
        law.error[i] = 0.0
    for i in range(n):
        law.now[i] = past.x[i]
        if law.increments:
            law.now[i] = past.x[i] - past.x_last[i] if past.instant[0] > 0 else 0.0
        elif turning and i < m:
            law.now[i], law.error[i] = 0.0, past.x[i]
    to_axes(turning, psi, law.now, theta[:n])
    if law.increments:
        for i in range(m):
            law.error[i] = past.y_last[i] if past.instant[0] > 0 else eta[i]
            theta[n + i] = 0.0


@lean_kernel
def _disturbance(law: LinearTable, past: Memory, psi: float, at: int) -> None:
    """Write d_0 ... d_{N-1} to theta: known disturbance plus bias, or its increments."""
    n, r, k = past.x.shape[0], past.command.shape[0], past.instant[0]
    table, theta, limits = law.observer, law.theta, law.observer.limits
    to_axes(table.turning, psi, past.x, law.change)
    velocity = law.change[n - r :]
    known_force(table, psi, velocity, law.outlook, k, True, law.known)
    to_axes(table.turning, psi, past.bias, law.tau)
    for j in range(r):
        law.last[j] = law.known[j]
    for i in range(law.steps):
        if i > 0 and law.winds:
            known_force(table, psi, velocity, law.outlook, k + i * law.every, False, law.last)
        for j in range(r):
            theta[at + i * r + j] = (law.last[j] + law.tau[j]) / limits[j]
            law.tau[j] *= table.bias_decay
    if law.increments:
        for i in range(law.steps - 1, 0, -1):
            for j in range(r):
                theta[at + i * r + j] -= theta[at + (i - 1) * r + j]
        to_axes(table.turning, psi - past.axes[0], past.known, law.last)
        for j in range(r):
            before = law.last[j] if k > 0 else law.known[j]
            theta[at + j] = (law.known[j] - before) / limits[j]


_write = lean_kernel(write_parameters)


@lean_kernel
def _linear_step(
    law: LinearTable, past: Memory, eta: Array, nu: Array, eta_d: Array, nu_d: Array,
    nu_dot_d: Array, tau: Array, tau_fb: Array,
) -> None:  # fmt: skip
    """u_0 = G theta, or u_{-1} + G theta; a regulator first compensates the known disturbance."""
    if past.instant[0] % law.every == 0:
        _write(law, past, eta, nu, eta_d)
        for i in range(law.tau.shape[0]):
            total = 0.0
            if not (law.regulator and past.instant[0] == 0):
                for j in range(law.theta.shape[0]):
                    total += law.gain[i, j] * law.theta[j]
            law.tau[i] = (total + law.increments * law.last[i]) * law.observer.limits[i]
        accept(past, law.tau, law.observer.limits, law.limited)
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
        """The parameters with the forecast of the weather and the mission, without obstacles."""
        return parameters._replace(outlook=outlook._replace(obstacles=None, hull=None))

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
        return LinearTable(observer, NO_OUTLOOK, *law, self.limited, every, *work), memory(n, m, r)

    def diagnostics(self, model: Model, period_s: float) -> list[Diagnostic]:
        """Order, controllability and spectral radii of the design, and its weights in SI units.

        The closed loop is that without limits.
        """
        design = self.design(model, period_s)
        observer, law = observer_of(design, self.estimator, self.kalman), self.law(design)
        own = design.model.with_integral_action() if law.increments else design.model
        radius = spectral_radius(own.A + own.B @ law.gain[:, : own.order])
        diagnostics = [
            *design.diagnostics(),
            *estimator_diagnostics(observer),
            Diagnostic("spectral_radius", "all", radius),
        ]
        for i, dof in enumerate(design.dofs):
            scaled = float(self.input_weight[i] / design.limits[i] ** 2)
            diagnostics += [
                Diagnostic("error_weight", dof, self.error_weight[i], f"1/{POSE_UNIT[dof]}^2"),
                Diagnostic("input_weight", dof, scaled, f"1/{FORCE_UNIT[dof]}^2"),
            ]
        return diagnostics
