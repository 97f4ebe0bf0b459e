"""Manoeuvres of a helmsman: Williamson turn, and reverse spiral (Bech).

The helmsman steers by first-order Nomoto, T r_dot + r = K delta, with poles at `bandwidth` U / L.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

import numpy as np

from seatrial.models.compiled import lean_kernel
from seatrial.models.excitation.helm import SteeredMission
from seatrial.models.excitation.missions import Steering
from seatrial.models.ranges import Positive
from seatrial.models.simulation.registry import CONTROLLERS
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import wrap_kernel
from seatrial.models.vessel.tuning import FromVessel

DAMPING_RATIO = 1.0


class WilliamsonTable(NamedTuple):
    """Angles of a Williamson turn [rad], and the gains of the helmsman."""

    base: Array
    helm: int
    yaw: int
    angle: float  # of the helm that turns the vessel to starboard
    away: float  # change of heading at which the helm is put to the other side
    check: float  # before the reciprocal course, where the helmsman takes over
    kp: float
    kd: float
    first: int


@lean_kernel
def _williamson(
    turn: WilliamsonTable, state: Array, eta: Array, nu: Array, eta_d: Array, nu_d: Array,
    nu_dot_d: Array, tau: Array, tau_fb: Array,
) -> None:  # fmt: skip
    """state = (instant, side of the first helm, heading of the approach, phase)."""
    for i in range(tau.shape[0]):
        tau[i] = tau_fb[i] = turn.base[i]
    heading, side = eta[turn.yaw], state[1]
    if state[0] <= turn.first:
        state[2] = heading
    change = side * (heading - state[2])
    if state[3] == 0.0 and change >= turn.away:
        state[3] = 1.0
    if state[3] == 1.0 and change <= turn.check - np.pi:
        state[3] = 2.0
    if state[0] >= turn.first:
        if state[3] == 0.0:
            order = side * turn.angle
        elif state[3] == 1.0:
            order = -side * turn.angle
        else:
            error = wrap_kernel(state[2] - side * np.pi - heading)
            order = turn.kp * error - turn.kd * nu[turn.yaw]
            limit = abs(turn.angle)
            order = min(max(order, -limit), limit)
        tau[turn.helm] = tau_fb[turn.helm] = order
    state[0] += 1.0


CONTROLLERS[WilliamsonTable] = _williamson


@dataclass(frozen=True, kw_only=True)
class HelmsmanMission(SteeredMission):
    """A manoeuvre in which the helm is steered by heading or yaw rate."""

    bandwidth: Positive = 1.0  # of the helmsman [U / L]
    length_m: Annotated[Positive, FromVessel("scales.length_m")]
    nomoto_gain: Annotated[tuple[float, ...], FromVessel("nomoto_gain")]  # [1/s] by input
    nomoto_time_s: Annotated[tuple[float, ...], FromVessel("nomoto_time_s")]

    @property
    def unit_s(self) -> float:
        """Time to sail one ship length [s]."""
        return self.length_m / self.speed_m_s


@dataclass(frozen=True, kw_only=True)
class Williamson(HelmsmanMission):
    """Back onto the own track: helm to one side, to the other, and the reciprocal course."""

    manoeuvre: Literal["williamson"] = "williamson"
    helm_deg: float
    away_deg: Positive
    check_deg: Positive  # before the reciprocal course, where the helm is steered
    duration_lengths: Positive

    @property
    def duration_s(self) -> float:
        """Length [s]."""
        return self.approach_s + self.duration_lengths * self.unit_s

    def steering(self, dofs: Sequence[str], period_s: float) -> Steering:
        """The commands of the manoeuvre."""
        gain, time = self.nomoto_gain[self.index], self.nomoto_time_s[self.index]
        omega = self.bandwidth / self.unit_s
        kp, kd = time * omega**2 / gain, (2.0 * DAMPING_RATIO * omega * time - 1.0) / gain
        table = WilliamsonTable(
            self.base, self.index, dofs.index("yaw"),
            self.sign * float(np.radians(abs(self.helm_deg))), float(np.radians(self.away_deg)),
            float(np.radians(self.check_deg)), kp, kd, round(self.approach_s / period_s),
        )  # fmt: skip
        return table, np.array([0.0, self.sign * np.sign(self.helm_deg), 0.0, 0.0])


class RateTable(NamedTuple):
    """Yaw rates [rad/s] in turn, and the gains of the rate controller."""

    base: Array
    helm: int
    yaw: int
    rates: Array
    held: int  # instants of a rate
    first: int
    kp: float
    ki: float  # over an instant
    low: float
    high: float


@lean_kernel
def _steer_rate(
    table: RateTable, state: Array, eta: Array, nu: Array, eta_d: Array, nu_d: Array,
    nu_dot_d: Array, tau: Array, tau_fb: Array,
) -> None:  # fmt: skip
    """state = (instant, integral [rad] of helm)."""
    for i in range(tau.shape[0]):
        tau[i] = tau_fb[i] = table.base[i]
    k = (int(state[0]) - table.first) // table.held
    if k >= 0:
        error = table.rates[min(k, len(table.rates) - 1)] - nu[table.yaw]
        order = table.kp * error + state[1]
        limited = min(max(order, table.low), table.high)
        if order == limited:  # otherwise the integral would wind up
            state[1] += table.ki * error
        tau[table.helm] = tau_fb[table.helm] = limited
    state[0] += 1.0


CONTROLLERS[RateTable] = _steer_rate


@dataclass(frozen=True, kw_only=True)
class ReverseSpiral(HelmsmanMission):
    """Yaw rates held in turn by the helm, each for `hold_lengths` L / U; in units of U / L."""

    manoeuvre: Literal["reverse_spiral"] = "reverse_spiral"
    largest_rate: Positive
    count: int
    hold_lengths: Positive
    input_low: Annotated[tuple[float, ...], FromVessel("input_low")]
    input_high: Annotated[tuple[float, ...], FromVessel("input_high")]

    @property
    def duration_s(self) -> float:
        """Length [s]."""
        return self.approach_s + self.count * self.hold_lengths * self.unit_s

    def steering(self, dofs: Sequence[str], period_s: float) -> Steering:
        """PI control of the rate, with both poles at the bandwidth."""
        gain, time = self.nomoto_gain[self.index], self.nomoto_time_s[self.index]
        omega = self.bandwidth / self.unit_s
        rates = np.linspace(1.0, -1.0, self.count) * self.largest_rate / self.unit_s
        table = RateTable(
            self.base, self.index, dofs.index("yaw"), rates,
            max(1, round(self.hold_lengths * self.unit_s / period_s)),
            round(self.approach_s / period_s), (2.0 * DAMPING_RATIO * omega * time - 1.0) / gain,
            period_s * time * omega**2 / gain, self.input_low[self.index],
            self.input_high[self.index],
        )  # fmt: skip
        return table, np.zeros(2)
