"""A rudder behind a propeller as in Son and Nomoto (1982), with its roll moment.

    F_N = -1/2 rho A_R f_alpha U_R^2 sin(alpha_R),   alpha_R = delta + atan(v_R / u_R)
    u_R = u_P epsilon sqrt(1 + 8 kappa K_T / (pi J^2))
    v_R = U (gamma v' + c_r r' + c_rrr r'^3 + c_rrv r'^2 v')
    X_R = c_RX F_N sin(delta),  Y_R = (1 + a_H) F_N cos(delta),
    K_R = -z_R (1 + a_H) F_N cos(delta),  N_R = (x_R + a_H x_H) F_N cos(delta)

with U_R^2 = u_R^2 + v_R^2 and u_P, K_T, J of the propeller. Fossen (1994), appendix E.1.3.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from seatrial.models.compiled import lean_kernel
from seatrial.models.elementary import angle_of
from seatrial.models.ranges import Positive
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.devices.device import DEVICES, Bounds, Device, input_index
from seatrial.models.vessel.devices.propeller import OVER_SPEED, SPEED, R, V
from seatrial.models.vessel.devices.rudder import place_of

(
    A_R, F_ALPHA, EPSILON, KAPPA, GAMMA, C_R, C_RRR, C_RRV, C_RX, A_H, X_H, X_R, Z_R, RHO, LENGTH,
) = range(15)  # fmt: skip


class SonNomotoStructure(NamedTuple):
    """Input and parameters of a rudder in the arrays of the kernels."""

    delta: int
    first: int  # parameter
    propeller: int  # place in `wake` of the propeller ahead of it


@dataclass(frozen=True)
class SonNomotoRudder(Device):
    """A rudder that an input `delta` [rad] turns, behind the device `propeller`.

    Positions are in ship lengths, forward of midship; `z_R` is the height of the centre of roll
    above the rudder. `delta` > 0 turns the ship to starboard.
    """

    PARAMETERS: ClassVar[Mapping[str, Bounds]] = {
        "area_m2": Bounds("m^2", 1e-4, 300.0),
        "f_alpha": Bounds("", 0.5, 6.0),
        "epsilon": Bounds("", 0.4, 2.0),
        "kappa": Bounds("", 0.0, 1.0),
        "gamma": Bounds("", 0.0, 1.5),
        "c_r": Bounds("", -1.0, 1.0),
        "c_rrr": Bounds("", -5.0, 5.0),
        "c_rrv": Bounds("", -5.0, 5.0),
        "c_RX": Bounds("", 0.0, 1.5),
        "a_H": Bounds("", -0.5, 1.0),
        "x_H": Bounds("", -1.0, 0.5),
        "x_R": Bounds("", -0.6, 0.0),
        "z_R": Bounds("", -0.2, 0.2),
        "rho_kg_m3": Bounds("kg/m^3", 900.0, 1100.0),
        "length_m": Bounds("m", 0.1, 500.0),
    }

    area_m2: Positive
    f_alpha: Positive
    length_m: Positive
    epsilon: Positive
    kappa: float
    gamma: float
    c_r: float
    c_rrr: float
    c_rrv: float
    c_RX: float
    a_H: float
    x_H: float
    x_R: float = -0.5
    z_R: float = 0.0
    rho_kg_m3: Positive = 1025.0
    propeller: str = "propeller"
    delta: str = "delta"

    def inputs(self) -> tuple[str, ...]:
        """The rudder angle."""
        return (self.delta,)

    def structure(self, first: int, place: int, places: Mapping[str, int]) -> SonNomotoStructure:
        """Input and parameters in the arrays of the kernels."""
        return SonNomotoStructure(input_index(self.delta), first, place_of(self.propeller, places))


@lean_kernel
def _step(
    structure: SonNomotoStructure, parameters: Array, z: Array, wake: Array, force: Array
) -> None:
    """Add the forces of the rudder and those it induces on the hull."""
    at, delta = structure.first, z[structure.delta]
    length = parameters[at + LENGTH]
    v, r = z[V] * z[OVER_SPEED], z[R] * length * z[OVER_SPEED]
    v_r = z[SPEED] * (
        parameters[at + GAMMA] * v
        + (parameters[at + C_R] + (parameters[at + C_RRR] * r + parameters[at + C_RRV] * v) * r) * r
    )
    inflow, jet = wake[structure.propeller], wake[structure.propeller + 1]
    washed = inflow * inflow + parameters[at + KAPPA] * (jet * jet - inflow * inflow)
    u_r = parameters[at + EPSILON] * np.sqrt(washed)
    pressure = 0.5 * parameters[at + RHO] * parameters[at + A_R] * (u_r * u_r + v_r * v_r)
    normal = -pressure * parameters[at + F_ALPHA] * np.sin(delta + angle_of(v_r, u_r))
    a_h, across = parameters[at + A_H], normal * np.cos(delta)
    force[0] += parameters[at + C_RX] * normal * np.sin(delta)
    force[1] += (1.0 + a_h) * across
    force[3] -= (1.0 + a_h) * parameters[at + Z_R] * length * across
    force[5] += (parameters[at + X_R] + a_h * parameters[at + X_H]) * length * across


DEVICES[SonNomotoStructure] = _step
