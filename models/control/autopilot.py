"""Autopilot of a steered vessel: heading by the helm, speed by the shaft.

Heading: PID with the reference's yaw rate and acceleration fed forward, on first-order Nomoto
T r_dot + r = K delta of the nominal model at the commanded speed. With omega and zeta

    k_p = T omega^2 / K,  k_d = (2 zeta omega T - 1) / K,  k_i = omega k_p / 10
    delta = (T r_d' + r_d) / K + k_p e + k_d (r_d - r) + integral,   e = wrap(psi_d - psi)

Speed: PI on du/dt = a u + b n, its poles at a fraction of omega. The helm is an input, such as a
rudder, or the difference of two; the shaft is an input or the sum of two. Commands keep the limits
and rate limits of the inputs; the integrals follow the commands that are given (back-calculation),
so that they do not wind up. Fossen (2021), sections 15.3.4 and 16.2.
"""

from dataclasses import dataclass
from typing import Annotated, ClassVar, NamedTuple

import numpy as np

from seatrial.models.compiled import lean_kernel
from seatrial.models.control.controller import Controller, Model, table_of
from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.simulation.registry import CONTROLLERS
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import wrap_kernel
from seatrial.models.vessel.steering import SteeringModel, steering_model
from seatrial.models.vessel.tuning import FromVessel

INTEGRAL = 10.0  # omega over the rate of the integral
SPEED = 0.3  # poles of the speed over those of the heading


class AutopilotTable(NamedTuple):
    """Parameters of the step; SI units, radians."""

    base: Array  # (n_inputs,)
    low: Array
    high: Array
    change: Array  # (n_inputs,) in an instant
    helm: Array  # (n_inputs,) change of the inputs by a unit of helm
    shaft: Array  # zeros: none
    yaw: int
    surge: int
    kp: float
    ki: float
    kd: float
    gain: float  # K
    time_s: float  # T
    feedforward: bool
    speed: float
    speed_kp: float
    speed_ki: float
    track: float  # of the integrals after a limit [1/s]
    period_s: float


@lean_kernel
def _limited(table: AutopilotTable, i: int, order: float, before: float) -> float:
    """A command within the limits of an input and of its rate."""
    order = min(max(order, before - table.change[i]), before + table.change[i])
    return float(min(max(order, table.low[i]), table.high[i]))


@lean_kernel
def _step(
    table: AutopilotTable, state: Array, eta: Array, nu: Array, eta_d: Array, nu_d: Array,
    nu_dot_d: Array, tau: Array, tau_fb: Array,
) -> None:  # fmt: skip
    """state = (integral of the helm, of the shaft, last commands)."""
    error, slow = wrap_kernel(eta_d[table.yaw] - eta[table.yaw]), table.speed - nu[table.surge]
    rate = nu_d[table.yaw]
    helm = feedback = table.kp * error + table.kd * (rate - nu[table.yaw]) + state[0]
    if table.feedforward:
        helm += (table.time_s * nu_dot_d[table.yaw] + rate) / table.gain
    shaft = table.speed_kp * slow + state[1]
    for i in range(tau.shape[0]):
        order = table.base[i] + table.helm[i] * helm + table.shaft[i] * shaft
        tau[i] = state[2 + i] = _limited(table, i, order, state[2 + i])
    given = _along(table, table.shaft, tau)
    for i in range(tau.shape[0]):
        tau_fb[i] = table.base[i] + table.helm[i] * feedback + table.shaft[i] * given
    state[0] += table.period_s * table.ki * error
    state[0] += table.period_s * table.track * (_along(table, table.helm, tau) - helm)
    state[1] += table.period_s * (table.speed_ki * slow + table.track * (given - shaft))


@lean_kernel
def _along(table: AutopilotTable, direction: Array, tau: Array) -> float:
    """Helm or shaft that commands contain; zero without the direction."""
    size = contained = 0.0
    for i in range(tau.shape[0]):
        size += direction[i] ** 2
        contained += direction[i] * (tau[i] - table.base[i])
    return float(contained / max(size, 1.0))


CONTROLLERS[AutopilotTable] = _step


@dataclass(frozen=True, kw_only=True)
class SteeringController(Controller):
    """A controller of the heading by the input `helm`, on the model linearised ahead.

    Two inputs steer by their difference, as two propellers side by side.
    """

    commands_inputs: ClassVar[bool] = True

    helm: Annotated[str | tuple[str, str], FromVessel("steered_by")] = "delta"
    speed_m_s: Annotated[Positive, FromVessel("approach_speed_m_s")]
    length_m: Annotated[Positive, FromVessel("scales.length_m")]
    input_names: Annotated[tuple[str, ...], FromVessel("input_names")]
    input_start: Annotated[tuple[float, ...], FromVessel("input_start")]
    input_low: Annotated[tuple[float, ...], FromVessel("input_low")]
    input_high: Annotated[tuple[float, ...], FromVessel("input_high")]

    def __post_init__(self) -> None:
        check_ranges(self)

    @property
    def helm_direction(self) -> Array:
        """Change of the inputs by a unit of helm, shape (n_inputs,)."""
        return self.direction("helm", self.helm, -1.0)

    def direction(self, option: str, inputs: str | tuple[str, str], second: float) -> Array:
        """1 for an input, or for the first of two and `second` for the other, (n_inputs,).

        Raises ConfigurationError for one that the vessel does not have.
        """
        names = (inputs,) if isinstance(inputs, str) else inputs
        if not {*names} <= {*self.input_names}:
            raise ConfigurationError(
                f"controller.{option}: got {', '.join(names)}, expected an input of the vessel, "
                f"got {', '.join(self.input_names) or 'no inputs'}"
            )
        change = np.zeros(len(self.input_names))
        for name, sign in zip(names, (1.0, second), strict=False):
            change[self.input_names.index(name)] = sign
        return change

    @property
    def base(self) -> Array:
        """Inputs at the start, shape (n_inputs,)."""
        return np.array(self.input_start, dtype=np.float64)

    def steered(self, model: Model) -> SteeringModel:
        """The nominal model linearised at the commanded speed."""
        table = table_of(model)
        if "yaw" not in table.dofs:
            raise ConfigurationError(
                f"controller: got a vessel in {', '.join(table.dofs)}, expected one in yaw"
            )
        return steering_model(table, self.speed_m_s, self.base)


@dataclass(frozen=True, kw_only=True)
class Autopilot(SteeringController):
    """Heading by the input `helm`, and speed by the input `shaft` where the vessel has it.

    Two inputs drive by their sum. `bandwidth` is omega in units of U / L at the commanded speed.
    """

    shaft: Annotated[str | tuple[str, str] | None, FromVessel("driven_by")] = None
    bandwidth: Positive = 0.8
    damping: Positive = 1.0
    integral: bool = True
    feedforward: bool = True
    input_rates: Annotated[tuple[float | None, ...], FromVessel("input_rates")]

    @property
    def omega(self) -> float:
        """Natural frequency of the heading loop [rad/s]."""
        return self.bandwidth * self.speed_m_s / self.length_m

    def gains(self, linear: SteeringModel) -> tuple[float, float, float]:
        """Gains k_p, k_i, k_d of the heading by pole placement."""
        gain, time = linear.along(self.helm_direction).nomoto(0)
        omega = self.omega
        kp = time * omega**2 / gain
        kd = (2.0 * self.damping * omega * time - 1.0) / gain
        return kp, kp * omega / INTEGRAL if self.integral else 0.0, kd

    def build(self, model: Model, period_s: float) -> tuple[AutopilotTable, Array]:
        """Parameters and initial state of the compiled step."""
        linear = self.steered(model)
        helm, (kp, ki, kd) = self.helm_direction, self.gains(linear)
        gain, time = linear.along(helm).nomoto(0)
        surge = linear.dofs.index("surge") if "surge" in linear.dofs else 0  # not used without it
        shaft = self._shaft_direction(linear)
        speed_kp, speed_ki = self._speed_gains(linear, shaft)
        rates = [np.inf if rate is None else rate for rate in self.input_rates]
        base = self.base
        table = AutopilotTable(
            base, np.array(self.input_low), np.array(self.input_high), period_s * np.array(rates),
            helm, shaft, linear.dofs.index("yaw"), surge, kp, ki, kd, gain,
            time, self.feedforward, self.speed_m_s, speed_kp, speed_ki,
            self.omega if self.integral else 0.0, period_s,
        )  # fmt: skip
        return table, np.concatenate([np.zeros(2), base])

    def _shaft_direction(self, linear: SteeringModel) -> Array:
        """Change of the inputs by a unit of shaft; zeros without one that drives the vessel."""
        none = np.zeros(len(self.input_names))
        if self.shaft is None or "surge" not in linear.dofs:
            return none
        shaft = self.direction("shaft", self.shaft, 1.0)
        return shaft if linear.along(shaft).surge(0)[1] > 0.0 else none

    def _speed_gains(self, linear: SteeringModel, shaft: Array) -> tuple[float, float]:
        """Gains of the speed by pole placement; zeros without a shaft."""
        if not np.any(shaft):
            return 0.0, 0.0
        a, b = linear.along(shaft).surge(0)
        omega = SPEED * self.omega
        return max(0.0, (2.0 * self.damping * omega + a) / b), omega**2 / b

    def diagnostics(self, model: Model, period_s: float) -> list[Diagnostic]:
        """Spectral radius of heading loop and linearised model, with the integral."""
        linear = self.steered(model)
        kp, ki, kd = self.gains(linear)
        rows = [linear.dofs.index(dof) for dof in ("sway", "yaw") if dof in linear.dofs]
        n = len(rows)
        A = np.zeros((n + 2, n + 2))  # (velocities, heading, integral)
        A[:n, :n] = linear.A[np.ix_(rows, rows)]
        A[n, n - 1] = 1.0
        A[n + 1, n] = -ki
        b = linear.along(self.helm_direction).B[rows, 0]
        A[:n, n - 1] -= kd * b
        A[:n, n] -= kp * b
        A[:n, n + 1] += b
        poles = np.linalg.eigvals(A if self.integral else A[:-1, :-1])
        return [Diagnostic("spectral_radius", "all", float(np.exp(period_s * np.max(poles.real))))]
