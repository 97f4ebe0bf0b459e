"""Drag ahead, linear at low speed and quadratic at high: a part of the hull without an input.

    X = -s d_1 u - (1 - s) d_2 |u| u,   s = 1 - tanh(|u| / u_c)

so that neither is counted where the other one holds. As in MSS (forceSurgeDamping.m, 2025), where
tanh has the sign of u, which drives a vessel that moves astern.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from seatrial.models.compiled import lean_kernel
from seatrial.models.ranges import NotNegative, Positive
from seatrial.models.vessel.basis import INDEX, Array
from seatrial.models.vessel.devices.device import DEVICES, Bounds, Device

U = INDEX["u"]
D_1, D_2, CROSSOVER = range(3)


class SurgeDragStructure(NamedTuple):
    """Parameters of a hull in the arrays of the kernels."""

    first: int


@dataclass(frozen=True)
class SurgeDrag(Device):
    """Drag of a hull on its own course; `crossover_m_s` is u_c."""

    PARAMETERS: ClassVar[Mapping[str, Bounds]] = {
        "d_1": Bounds("kg/s", 0.0, 1e7),
        "d_2": Bounds("kg/m", 0.0, 1e7),
        "crossover_m_s": Bounds("m/s", 0.01, 10.0),
    }

    d_1: NotNegative
    d_2: NotNegative
    crossover_m_s: Positive

    def inputs(self) -> tuple[str, ...]:
        """None."""
        return ()

    def structure(self, first: int, place: int, places: Mapping[str, int]) -> SurgeDragStructure:
        """Parameters in the arrays of the kernels."""
        return SurgeDragStructure(first)


@lean_kernel
def _step(
    structure: SurgeDragStructure, parameters: Array, z: Array, wake: Array, force: Array
) -> None:
    """Add the drag."""
    at, u = structure.first, z[U]
    share = 2.0 / (np.exp(2.0 * abs(u) / parameters[at + CROSSOVER]) + 1.0)
    drag = share * parameters[at + D_1] + (1.0 - share) * parameters[at + D_2] * abs(u)
    force[0] -= drag * u


DEVICES[SurgeDragStructure] = _step
