"""Drag of the flow across a hull, by strips along it: a part of the hull without an input.

    Y = -1/2 rho H C_D  int |v + x r| (v + x r) dx
    N = -1/2 rho H C_D  int x |v + x r| (v + x r) dx

from x = -L/2 to L/2, with the height H of the section across the flow, a draught or a diameter, and
likewise Z and M of w - x q for a submerged vessel. Faltinsen (1990), section 6; Fossen (2021),
section 6.4.3. Each of `strips` equal strips has the flow in its middle.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, NamedTuple

from annotated_types import Ge

from seatrial.models.compiled import lean_kernel
from seatrial.models.ranges import Positive
from seatrial.models.vessel.basis import INDEX, Array
from seatrial.models.vessel.devices.device import DEVICES, Bounds, Device

V, W, Q, R = (INDEX[name] for name in ("v", "w", "q", "r"))
LENGTH, HEIGHT, DRAG, RHO = range(4)


class CrossFlowStructure(NamedTuple):
    """Parameters of a hull in the arrays of the kernels, and its strips."""

    first: int  # parameter
    strips: int
    ends: bool
    submerged: bool


@dataclass(frozen=True)
class CrossFlow(Device):
    """Strips of a hull that move sideways, and up and down if it is `submerged`.

    `rule`: `ends` sums the flow at both ends of every strip once, which are one more than there are
    strips, as MSS did until 2026; the drag is then that of a hull longer by one strip.
    """

    PARAMETERS: ClassVar[Mapping[str, Bounds]] = {
        "length_m": Bounds("m", 0.1, 500.0),
        "height_m": Bounds("m", 0.01, 30.0),
        "drag_coefficient": Bounds("", 0.0, 3.0),
        "rho_kg_m3": Bounds("kg/m^3", 900.0, 1100.0),
    }

    length_m: Positive
    height_m: Positive
    drag_coefficient: Positive
    rho_kg_m3: Positive = 1025.0
    strips: Annotated[int, Ge(2)] = 20
    rule: Literal["middles", "ends"] = "middles"
    submerged: bool = False

    def inputs(self) -> tuple[str, ...]:
        """None."""
        return ()

    def structure(self, first: int, place: int, places: Mapping[str, int]) -> CrossFlowStructure:
        """Parameters in the arrays of the kernels."""
        return CrossFlowStructure(first, self.strips, self.rule == "ends", self.submerged)


@lean_kernel
def _step(
    structure: CrossFlowStructure, parameters: Array, z: Array, wake: Array, force: Array
) -> None:
    """Add the drag of every strip."""
    at, ends = structure.first, structure.ends
    width = parameters[at + LENGTH] / structure.strips
    scale = 0.5 * parameters[at + RHO] * parameters[at + HEIGHT] * parameters[at + DRAG] * width
    for i in range(structure.strips + (1 if ends else 0)):
        x = (i + (0.0 if ends else 0.5) - 0.5 * structure.strips) * width
        across = z[V] + x * z[R]
        drag = scale * abs(across) * across
        force[1] -= drag
        force[5] -= x * drag
        if structure.submerged:
            across = z[W] - x * z[Q]
            drag = scale * abs(across) * across
            force[2] -= drag
            force[4] += x * drag


DEVICES[CrossFlowStructure] = _step
