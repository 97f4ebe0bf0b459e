"""A rudder in the slipstream of a propeller, with the reaction of the hull.

    F_N = 1/2 rho A_R U_R^2 f_alpha sin(alpha_R),   U_R^2 = u_R^2 + v_R^2
    alpha_R = delta - atan2(v_R, u_R)
    v_R = U gamma_R beta_R,   beta_R = beta - l_R' r'
    u_R = epsilon sqrt(eta (u_P + kappa (u_inf - u_P))^2 + (1 - eta) u_P^2)
    X_R = -(1 - t_R) F_N sin(delta),   Y_R = -(1 + a_H) F_N cos(delta),
    N_R = -(x_R + a_H x_H) F_N cos(delta)

with u_P the velocity that reaches the propeller and u_inf = u_P sqrt(1 + 8 K_T / (pi J^2)) that
far behind it. Yasukawa and Yoshimura (2015), eqs. (18) to (30). `delta` > 0 turns the ship to
starboard. Without a propeller, u_R = epsilon u, or epsilon U in a flow that is taken to be along
the hull, as in Fossen (2021), section 9.5.1.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal, NamedTuple

import numpy as np

from seatrial.models.compiled import lean_kernel
from seatrial.models.elementary import angle_of, where
from seatrial.models.errors import ConfigurationError
from seatrial.models.ranges import Positive
from seatrial.models.vessel.basis import INDEX, Array
from seatrial.models.vessel.devices.device import DEVICES, Bounds, Device, input_index
from seatrial.models.vessel.devices.propeller import SPEED, drift

(
    A_R, F_ALPHA, ETA, EPSILON, KAPPA, GAMMA_PLUS, GAMMA_MINUS, L_R, T_R, A_H, X_H, X_R,
    NEUTRAL, RHO, LENGTH,
) = range(15)  # fmt: skip


class RudderStructure(NamedTuple):
    """Input and parameters of a rudder in the arrays of the kernels."""

    delta: int
    first: int  # parameter
    propeller: int  # place in `wake` of the propeller ahead of it; -1: none
    flow: int  # the variable that is its inflow without a propeller


@dataclass(frozen=True)
class Rudder(Device):
    """A rudder that an input `delta` [rad] turns, in the flow of the device `propeller` (or null).

    `eta` is the share of its height in the slipstream, D_P / H_R. Positions are in ship lengths,
    forward of midship, `neutral_rad` the angle at which it gives no side force in straight flow.
    """

    PARAMETERS: ClassVar[Mapping[str, Bounds]] = {
        "area_m2": Bounds("m^2", 1e-4, 300.0),
        "f_alpha": Bounds("", 0.5, 6.0),
        "eta": Bounds("", 0.0, 1.0),
        "epsilon": Bounds("", 0.4, 2.0),
        "kappa": Bounds("", 0.0, 1.0),
        "gamma_R_plus": Bounds("", 0.0, 1.5),
        "gamma_R_minus": Bounds("", 0.0, 1.5),
        "l_R": Bounds("", -2.0, 0.0),
        "t_R": Bounds("", 0.0, 1.0),
        "a_H": Bounds("", -0.5, 1.0),
        "x_H": Bounds("", -1.0, 0.5),
        "x_R": Bounds("", -0.6, 0.0),
        "neutral_rad": Bounds("rad", -0.2, 0.2),
        "rho_kg_m3": Bounds("kg/m^3", 900.0, 1100.0),
        "length_m": Bounds("m", 0.1, 500.0),
    }

    area_m2: Positive
    f_alpha: Positive
    length_m: Positive
    eta: float = 1.0
    epsilon: Positive = 1.0
    kappa: float = 0.5
    gamma_R_plus: float = 0.5
    gamma_R_minus: float = 0.5
    l_R: float = -0.71
    t_R: float = 0.0
    a_H: float = 0.0
    x_H: float = -0.45
    x_R: float = -0.5
    neutral_rad: float = 0.0
    rho_kg_m3: Positive = 1025.0
    propeller: str | None = "propeller"
    flow: Literal["u", "U"] = "u"  # without a propeller
    delta: str = "delta"

    def inputs(self) -> tuple[str, ...]:
        """The rudder angle."""
        return (self.delta,)

    def structure(self, first: int, place: int, places: Mapping[str, int]) -> RudderStructure:
        """Input and parameters in the arrays of the kernels."""
        ahead = -1 if self.propeller is None else place_of(self.propeller, places)
        return RudderStructure(input_index(self.delta), first, ahead, INDEX[self.flow])


def place_of(name: str, places: Mapping[str, int]) -> int:
    """Place in `wake` of the device ahead; raises ConfigurationError if it does not come before."""
    if name not in places:
        raise ConfigurationError(
            f"devices: a rudder is behind {name!r}, expected a device that is given before it: "
            f"{', '.join(places) or 'there is none'}"
        )
    return places[name]


@lean_kernel
def _step(
    structure: RudderStructure, parameters: Array, z: Array, wake: Array, force: Array
) -> None:
    """Add the forces of the rudder and those it induces on the hull."""
    at, delta = structure.first, z[structure.delta]
    length = parameters[at + LENGTH]
    beta = drift(z, parameters[at + L_R], length)
    straightening = where(beta >= 0.0, parameters[at + GAMMA_PLUS], parameters[at + GAMMA_MINUS])
    v_r = z[SPEED] * straightening * beta
    inflow = jet = z[structure.flow]
    if structure.propeller >= 0:
        inflow, jet = wake[structure.propeller], wake[structure.propeller + 1]
    washed = inflow + parameters[at + KAPPA] * (jet - inflow)
    share = parameters[at + ETA]
    u_r = parameters[at + EPSILON] * np.sqrt(
        share * washed * washed + (1.0 - share) * inflow * inflow
    )
    attack = delta - parameters[at + NEUTRAL] - angle_of(v_r, u_r)
    pressure = 0.5 * parameters[at + RHO] * parameters[at + A_R] * (u_r * u_r + v_r * v_r)
    normal = pressure * parameters[at + F_ALPHA] * np.sin(attack)
    across = normal * np.cos(delta)
    a_h = parameters[at + A_H]
    force[0] -= (1.0 - parameters[at + T_R]) * normal * np.sin(delta)
    force[1] -= (1.0 + a_h) * across
    force[5] -= (parameters[at + X_R] + a_h * parameters[at + X_H]) * length * across


DEVICES[RudderStructure] = _step
