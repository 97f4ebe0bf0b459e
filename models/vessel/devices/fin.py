"""A fin of a submerged vehicle in the free flow: a rudder, or a stern plane.

    rudder:  Y = -1/2 rho A C_L (u^2 + v^2) delta,   N = x Y
    plane:   Z = -1/2 rho A C_L (u^2 + w^2) delta,   M = -x Z

and the resistance X = -1/2 rho A C_L U^2 delta^2 with the same speed squared. Fossen (2021),
section 8.4.2, without stall.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal, NamedTuple

from seatrial.models.compiled import lean_kernel
from seatrial.models.ranges import Positive
from seatrial.models.vessel.basis import INDEX, Array
from seatrial.models.vessel.devices.device import DEVICES, Bounds, Device, input_index

U, V, W = (INDEX[name] for name in ("u", "v", "w"))
AREA, LIFT, X_F, RHO = range(4)


class FinStructure(NamedTuple):
    """Input and parameters of a fin in the arrays of the kernels."""

    delta: int
    across: int  # the velocity beside u in its plane
    rudder: bool
    first: int  # parameter


@dataclass(frozen=True)
class Fin(Device):
    """A fin that an input `delta` [rad] turns, `x_m` forward of the origin; `lift` is dC_L/ddelta.

    Behind the origin, delta > 0 of a `rudder` turns to starboard, and of a `plane` bow down.
    """

    PARAMETERS: ClassVar[Mapping[str, Bounds]] = {
        "area_m2": Bounds("m^2", 1e-4, 100.0),
        "lift": Bounds("", 0.1, 6.3),
        "x_m": Bounds("m", -100.0, 100.0),
        "rho_kg_m3": Bounds("kg/m^3", 900.0, 1100.0),
    }

    delta: str
    kind: Literal["rudder", "plane"]
    area_m2: Positive
    lift: Positive
    x_m: float
    rho_kg_m3: Positive = 1025.0

    def inputs(self) -> tuple[str, ...]:
        """The angle of the fin."""
        return (self.delta,)

    def structure(self, first: int, place: int, places: Mapping[str, int]) -> FinStructure:
        """Input and parameters in the arrays of the kernels."""
        rudder = self.kind == "rudder"
        return FinStructure(input_index(self.delta), V if rudder else W, rudder, first)


@lean_kernel
def _step(structure: FinStructure, parameters: Array, z: Array, wake: Array, force: Array) -> None:
    """Add lift and resistance."""
    at, delta, across = structure.first, z[structure.delta], z[structure.across]
    area, lift = parameters[at + AREA], parameters[at + LIFT]
    scale = 0.5 * parameters[at + RHO] * area * lift * (z[U] * z[U] + across * across)
    side, arm = -scale * delta, parameters[at + X_F]
    force[0] += side * delta
    if structure.rudder:
        force[1] += side
        force[5] += arm * side
    else:
        force[2] += side
        force[4] -= arm * side


DEVICES[FinStructure] = _step
