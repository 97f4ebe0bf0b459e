"""PID control with model feedforward. Jervan (2020), eqs. (2.9)-(2.14).

Thrusters that lag as omega_n^2 / (s^2 + 2 zeta omega_n s + omega_n^2) delay a slow command by
T = 2 zeta / omega_n. The thruster lead compensates this delay: it adds T d(tau_FF)/dt to the
feedforward, computed by a backward difference.
"""

from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple

import numpy as np

from seatrial.models.compiled import lean_kernel
from seatrial.models.control.controller import Controller, Model, table_of
from seatrial.models.control.linear_design import design_model
from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import DOFS, PLANAR
from seatrial.models.simulation.dynamics import COS_PSI, SIN_PSI
from seatrial.models.simulation.registry import CONTROLLERS
from seatrial.models.simulation.statespace import spectral_radius
from seatrial.models.simulation.voyage import Log, Outlook
from seatrial.models.vessel.basis import N_VARIABLES, Array, features_kernel
from seatrial.models.vessel.kinematics import (
    SPATIAL,
    fill_angles_kernel,
    spatial_error_kernel,
    wrap_kernel,
)
from seatrial.models.vessel.table import (
    ForceTable,
    Vessel,
    fill_air_kernel,
    fill_variables_kernel,
    weighted_sum_kernel,
)
from seatrial.models.vessel.thruster import SecondOrderLag
from seatrial.models.vessel.tuning import FromVessel


class PidTable(NamedTuple):
    """Parameters of the compiled step."""

    kp: Array  # (n_dof,)
    ki: Array
    kd: Array
    feedback: bool
    feedforward: bool
    model: ForceTable
    planar: bool
    period_s: float
    lead: float  # T divided by the period; 0: no thruster lead
    z: Array  # work space: variables and their magnitudes, basis functions, body error
    phi: Array
    e: Array


def body_error(planar: bool, eta_d: Array, eta: Array, e: Array) -> None:
    """e = R(psi)' (eta_d - eta), the heading error wrapped to (-pi, pi]. Jervan (2020), eq. (2.11).

    In six degrees of freedom the attitude error is the quaternion error.
    """
    for i in range(e.shape[0]):
        e[i] = eta_d[i] - eta[i]
    if planar:
        c, s = np.cos(eta[2]), np.sin(eta[2])
        north, east = e[0], e[1]
        e[0] = c * north + s * east
        e[1] = c * east - s * north
        e[2] = wrap_kernel(e[2])
    elif e.shape[0] == SPATIAL:
        spatial_error_kernel(eta_d, eta, e)


body_error_kernel = lean_kernel(body_error)


@lean_kernel
def feedforward(pid: PidTable, eta_d: Array, nu_d: Array, nu_dot_d: Array, tau: Array) -> None:
    """tau = F(nu_dot_d, nu_d), the force that the reference motion needs [N, Nm]."""
    fill_variables_kernel(pid.z, pid.model.acceleration_index, nu_dot_d)
    fill_variables_kernel(pid.z, pid.model.velocity_index, nu_d)
    if pid.planar:
        pid.z[COS_PSI], pid.z[SIN_PSI] = np.cos(eta_d[2]), np.sin(eta_d[2])
        pid.z[N_VARIABLES + COS_PSI] = abs(pid.z[COS_PSI])
        pid.z[N_VARIABLES + SIN_PSI] = abs(pid.z[SIN_PSI])
    elif nu_d.shape[0] == SPATIAL:
        fill_angles_kernel(pid.z, eta_d[3:])
    if pid.model.aerodynamic and nu_d.shape[0] > 1:  # wind unknown: assume still air
        fill_air_kernel(pid.z, nu_d[0], nu_d[1])
    features_kernel(pid.model.codes, pid.z, pid.phi)
    weighted_sum_kernel(pid.model.theta, pid.phi, tau)


@lean_kernel
def _step(
    pid: PidTable, state: Array, eta: Array, nu: Array, eta_d: Array, nu_d: Array,
    nu_dot_d: Array, tau: Array, tau_fb: Array,
) -> None:  # fmt: skip
    """tau = F(nu_dot_d, nu_d) + Kp e + Ki int e + Kd (nu_d - nu); then the integral is updated.

    state = (integral of e, last feedforward, 1 after the first feedforward).
    """
    n = tau.shape[0]
    for i in range(n):
        tau[i] = tau_fb[i] = 0.0
    if pid.feedforward:
        feedforward(pid, eta_d, nu_d, nu_dot_d, tau)
        if pid.lead > 0.0:
            for i in range(n):
                now = tau[i]
                tau[i] += pid.lead * (now - state[n + i]) * state[2 * n]
                state[n + i] = now
            state[2 * n] = 1.0
    if pid.feedback:
        e = pid.e
        body_error_kernel(pid.planar, eta_d, eta, e)
        for i in range(n):
            tau_fb[i] = pid.kp[i] * e[i] + pid.ki[i] * state[i] + pid.kd[i] * (nu_d[i] - nu[i])
            state[i] += pid.period_s * e[i]
            tau[i] += tau_fb[i]


CONTROLLERS[PidTable] = _step


@dataclass(frozen=True)
class PidFeedforward(Controller):
    """PID on the body-frame error with the model's force as feedforward.

    Gains in SI, one per degree of freedom: kp [N/m, Nm/rad], ki [N/(m s), ...], kd [N s/m, ...].
    `thruster_lead` compensates the lag of `thruster` if there is one. Without `deployed_feedback`
    an evaluation uses the feedforward alone.
    """

    kp: Annotated[tuple[float, ...], FromVessel("tuning.pid.kp")]
    ki: Annotated[tuple[float, ...], FromVessel("tuning.pid.ki")]
    kd: Annotated[tuple[float, ...], FromVessel("tuning.pid.kd")]
    feedback: bool = True
    feedforward: bool = True
    deployed_feedback: bool = True
    thruster_lead: bool = False
    thruster: Annotated[SecondOrderLag | None, FromVessel("thruster")] = None

    def __post_init__(self) -> None:
        for name in ("kp", "ki", "kd"):
            gains = getattr(self, name)
            if len(gains) != len(self.kp) or min(gains, default=0.0) < 0.0:
                raise ConfigurationError(
                    f"{name} must be {len(self.kp)} numbers, none negative, got {list(gains)}"
                )
        if not (self.feedback or self.feedforward):
            raise ConfigurationError(
                "feedback and feedforward are both off, expected at least one of them"
            )
        if not (self.deployed_feedback or self.feedforward):
            raise ConfigurationError(
                "deployed_feedback and feedforward are both off, expected at least one of them"
            )

    def deployed(self) -> "PidFeedforward":
        """The controller of an evaluation: this one, or its feedforward alone."""
        return self if self.deployed_feedback else replace(self, feedback=False)

    def build(self, model: Model, period_s: float) -> tuple[PidTable, Array]:
        """Parameters and initial state of the compiled step, for a table and loop period [s]."""
        model = table_of(model)
        if len(self.kp) != len(model.dofs):
            raise ConfigurationError(
                f"controller.kp: got {len(self.kp)} gains, expected {len(model.dofs)} "
                f"for {', '.join(model.dofs)}"
            )
        table = model.force_table()
        z = np.zeros(2 * N_VARIABLES)
        z[0] = z[N_VARIABLES] = 1.0
        kp, ki, kd = (np.array(g, dtype=np.float64) for g in (self.kp, self.ki, self.kd))
        lag = self.thruster if self.thruster_lead else None
        lead_s = 0.0 if lag is None else lag.delay_s  # 2 zeta / omega_n, at low frequency
        parameters = PidTable(
            kp, ki, kd, self.feedback, self.feedforward, table, model.dofs == PLANAR, period_s,
            lead_s / period_s, z, np.empty(len(table.codes)), np.empty(len(model.dofs)),
        )  # fmt: skip
        return parameters, np.zeros(2 * len(model.dofs) + 1)

    def diagnostics(self, model: Model, period_s: float) -> list[Diagnostic]:
        """Spectral radius of the closed loop on the linearised model, for planar motion.

        x = (eta, nu, int e), tau = Kp e + Ki int e - Kd nu, e = -eta. Without feedback, or without
        a position gain on every axis, the loop has no equilibrium and nothing is returned.
        """
        model = table_of(model)
        if not self.feedback or min(self.kp) <= 0.0 or set(model.dofs) & set(DOFS[3:5]):
            return []
        try:
            linear = design_model(model, (1.0,) * len(model.dofs), period_s).model
        except ConfigurationError:  # a model that is not linear in its accelerations
            return []
        integrating = np.array(self.ki) > 0.0
        rows, n = np.eye(len(integrating))[integrating], linear.order
        A = np.block(
            [[linear.A, np.zeros((n, len(rows)))], [-period_s * rows @ linear.C, np.eye(len(rows))]]
        )
        B = np.vstack([linear.B, np.zeros((len(rows), len(integrating)))])
        gain = np.hstack([-np.diag(self.kp), -np.diag(self.kd), (rows * self.ki).T])
        return [Diagnostic("spectral_radius", "all", spectral_radius(A + B @ gain))]

    def adapt(
        self, parameters: PidTable, state: Array, model: Vessel, period_s: float,
        outlook: Outlook, log: Log, k: int,
    ) -> PidTable:  # fmt: skip
        """Parameters for a new model during a simulation, before instant k, without a bump.

        On every axis with integral action the integral takes over the change of the feedforward.
        """
        new, _ = self.build(model, period_s)
        n = len(self.kp)
        before, after = np.zeros(n), np.zeros(n)
        for table, tau in ((parameters, before), (new, after)):
            feedforward(table, log.eta_d[k - 1], log.nu_d[k - 1], log.nu_dot_d[k - 1], tau)
        if self.feedforward:
            integrating = np.array(self.ki) > 0.0
            state[:n][integrating] += ((before - after) / np.maximum(self.ki, 1e-300))[integrating]
            state[n : 2 * n] += after - before
        return new
