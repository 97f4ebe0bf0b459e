"""Lift and drag of a slender body, and the damping that it has at low speed alone.

    drag = 1/2 rho U^2 S (C_D0 + C_L^2 / (pi e A)),   lift = 1/2 rho U^2 S C_L
    C_L = pi A / (1 + sqrt(1 + (A / 2)^2)) alpha,   alpha = atan2(w, u),   A = b^2 / S
    X = -drag cos(alpha) + lift sin(alpha) - d_u exp(-c U) u
    Z = -drag sin(alpha) - lift cos(alpha),   Y = -d_v exp(-c U) v

in the vertical plane, as a wing of the span b and the area S. Beard and McLain (2012), section 4.2;
Fossen (2021), section 8.4.2.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from seatrial.models.compiled import lean_kernel
from seatrial.models.elementary import angle_of
from seatrial.models.ranges import NotNegative, Positive
from seatrial.models.vessel.basis import INDEX, Array
from seatrial.models.vessel.devices.device import DEVICES, Bounds, Device

U, V, W, SPEED = (INDEX[name] for name in ("u", "v", "w", "U"))
AREA, SPAN, DRAG_0, OSWALD, D_U, D_V, FADING, RHO = range(8)


class SlenderBodyStructure(NamedTuple):
    """Parameters of a body in the arrays of the kernels."""

    first: int


@dataclass(frozen=True)
class SlenderBody(Device):
    """A part of the hull without an input."""

    PARAMETERS: ClassVar[Mapping[str, Bounds]] = {
        "area_m2": Bounds("m^2", 1e-3, 1000.0),
        "span_m": Bounds("m", 0.01, 50.0),
        "drag_0": Bounds("", 0.001, 1.0),
        "oswald": Bounds("", 0.3, 1.0),
        "d_u": Bounds("kg/s", 0.0, 1e6),
        "d_v": Bounds("kg/s", 0.0, 1e6),
        "fading": Bounds("s/m", 0.0, 100.0),
        "rho_kg_m3": Bounds("kg/m^3", 900.0, 1100.0),
    }

    area_m2: Positive
    span_m: Positive
    drag_0: Positive
    oswald: Positive = 0.7
    d_u: NotNegative = 0.0
    d_v: NotNegative = 0.0
    fading: NotNegative = 0.0
    rho_kg_m3: Positive = 1025.0

    def inputs(self) -> tuple[str, ...]:
        """None."""
        return ()

    def structure(self, first: int, place: int, places: Mapping[str, int]) -> SlenderBodyStructure:
        """Parameters in the arrays of the kernels."""
        return SlenderBodyStructure(first)


@lean_kernel
def _step(
    structure: SlenderBodyStructure, parameters: Array, z: Array, wake: Array, force: Array
) -> None:
    """Add lift, drag and damping."""
    at, speed, alpha = structure.first, z[SPEED], angle_of(z[W], z[U])
    area, span = parameters[at + AREA], parameters[at + SPAN]
    aspect = span * span / area
    lift = np.pi * aspect / (1.0 + np.sqrt(1.0 + 0.25 * aspect * aspect)) * alpha
    drag = parameters[at + DRAG_0] + lift * lift / (np.pi * parameters[at + OSWALD] * aspect)
    pressure = 0.5 * parameters[at + RHO] * speed * speed * area
    c, s = np.cos(alpha), np.sin(alpha)
    fading = np.exp(-parameters[at + FADING] * speed)
    force[0] += pressure * (lift * s - drag * c) - parameters[at + D_U] * fading * z[U]
    force[1] -= parameters[at + D_V] * fading * z[V]
    force[2] -= pressure * (drag * s + lift * c)


DEVICES[SlenderBodyStructure] = _step
