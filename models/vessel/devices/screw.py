"""A propeller of a submerged vehicle, with its torque, by straight lines over the advance ratio.

    X = (1 - t) rho D^4 (K_T0 |n| n + K_T1 |n| V_a / D),   V_a = (1 - w) U
    K = s rho D^5 (K_Q0 |n| n + K_Q1 |n| V_a / D)

ahead; astern the terms in V_a are left out. The hull takes the share s of the torque. Fossen
(2021), section 8.4.2, as in PythonVehicleSimulator (remus100.py).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from seatrial.models.compiled import lean_kernel
from seatrial.models.elementary import where
from seatrial.models.ranges import Positive
from seatrial.models.vessel.basis import INDEX, Array
from seatrial.models.vessel.devices.device import DEVICES, Bounds, Device, input_index

SPEED = INDEX["U"]
DIAMETER, KT_0, KT_1, KQ_0, KQ_1, WAKE_FRACTION, DEDUCTION, SHARE, RHO = range(9)


class ScrewStructure(NamedTuple):
    """Input and parameters of a propeller in the arrays of the kernels."""

    n: int
    first: int  # parameter


@dataclass(frozen=True)
class Screw(Device):
    """A propeller on the axis that an input `n` [1/s] drives."""

    PARAMETERS: ClassVar[Mapping[str, Bounds]] = {
        "diameter_m": Bounds("m", 0.01, 15.0),
        "kt_0": Bounds("", 0.05, 1.0),
        "kt_1": Bounds("", -1.0, 0.0),
        "kq_0": Bounds("", 0.0, 0.2),
        "kq_1": Bounds("", -0.2, 0.0),
        "wake_fraction": Bounds("", 0.0, 0.7),
        "t_P": Bounds("", 0.0, 0.5),
        "torque_share": Bounds("", 0.0, 1.0),
        "rho_kg_m3": Bounds("kg/m^3", 900.0, 1100.0),
    }

    diameter_m: Positive
    kt_0: float
    kt_1: float
    kq_0: float
    kq_1: float
    wake_fraction: float = 0.0
    t_P: float = 0.0
    torque_share: float = 1.0
    rho_kg_m3: Positive = 1025.0
    n: str = "n"

    def inputs(self) -> tuple[str, ...]:
        """The shaft speed."""
        return (self.n,)

    def structure(self, first: int, place: int, places: Mapping[str, int]) -> ScrewStructure:
        """Input and parameters in the arrays of the kernels."""
        return ScrewStructure(input_index(self.n), first)


@lean_kernel
def _step(
    structure: ScrewStructure, parameters: Array, z: Array, wake: Array, force: Array
) -> None:
    """Add thrust and torque."""
    at, n = structure.first, z[structure.n]
    diameter = parameters[at + DIAMETER]
    advance = where(n > 0.0, (1.0 - parameters[at + WAKE_FRACTION]) * z[SPEED] / diameter, 0.0)
    d_2 = diameter * diameter
    scale = parameters[at + RHO] * d_2 * d_2 * abs(n)
    thrust = parameters[at + KT_0] * n + parameters[at + KT_1] * advance
    torque = parameters[at + KQ_0] * n + parameters[at + KQ_1] * advance
    force[0] += (1.0 - parameters[at + DEDUCTION]) * scale * thrust
    force[3] += parameters[at + SHARE] * scale * diameter * torque


DEVICES[ScrewStructure] = _step
