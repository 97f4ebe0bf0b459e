"""A propeller by its thrust at bollard pull: fixed, in a tunnel, or on an azimuth.

    T = k ((1 - q) s + q s^2) - a s V_a,   s = (|x| - d) / (1 - d), and 0 in the dead band |x| < d
    X = T cos(alpha),   Y = T sin(alpha),   N = x_T Y - y_T X

with the input x, a shaft speed [1/s] or a PWM signal from -1 to 1, and k that of its sign. The
default, q = 1 and d = 0, is T = k |n| n. V_a is the velocity of the water along its axis; the term
in it is the loss by inflow of Blanke (1981), T = k |n| n - a |n| V_a, Fossen (2021), section 9.1.
The flow across its axis, V_c, leaves the part exp(-c V_c^2) of the thrust, as of a tunnel thruster
in a vessel that moves ahead; this is an empirical form. Two fixed ones beside each other steer by
the difference of their thrusts.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, ClassVar, NamedTuple

import numpy as np
from annotated_types import Ge

from seatrial.models.compiled import lean_kernel
from seatrial.models.elementary import where
from seatrial.models.ranges import NotNegative, Positive
from seatrial.models.vessel.basis import INDEX, Array
from seatrial.models.vessel.devices.device import DEVICES, Bounds, DataRange, Device, input_index

U, V, R = (INDEX[name] for name in ("u", "v", "r"))
AHEAD, ASTERN, DEAD, CURVE, ADVANCE, CROSSING, ANGLE, X_T, Y_T = range(9)


class ThrusterStructure(NamedTuple):
    """Inputs and parameters of a thruster in the arrays of the kernels."""

    drive: int
    alpha: int  # 0, the variable 1, if it cannot turn
    turns: bool
    first: int  # parameter


@dataclass(frozen=True)
class Thruster(Device):
    """A thruster that an input `drive` runs: a shaft speed `n_1` [1/s], or `pwm_1` from -1 to 1.

    `ahead` and `astern` are the thrusts [N] at bollard pull for an input of 1; `astern` is null if
    reverse running is not known: it is then that ahead, and a diagnostic says for how long.
    `alpha` is the input of an azimuth [rad], from `angle_rad` on to starboard; a tunnel is at pi/2.
    """

    PARAMETERS: ClassVar[Mapping[str, Bounds]] = {
        "ahead": Bounds("N", 0.0, 1e7),
        "astern": Bounds("N", 0.0, 1e7),
        "dead_band": Bounds("", 0.0, 0.5),
        "curvature": Bounds("", 0.0, 1.0),
        "advance": Bounds("kg", 0.0, 1e6),
        "crossing": Bounds("s^2/m^2", 0.0, 10.0),
        "angle_rad": Bounds("rad", -3.2, 3.2),
        "x_m": Bounds("m", -250.0, 250.0),
        "y_m": Bounds("m", -50.0, 50.0),
    }

    drive: str
    ahead: Positive
    x_m: float
    y_m: float
    astern: Positive | None = None
    alpha: str | None = None
    angle_rad: float = 0.0
    dead_band: Annotated[float, Ge(0)] = 0.0
    curvature: float = 1.0
    advance: NotNegative = 0.0  # [kg] for an input in 1/s, [kg/s] for one from -1 to 1
    crossing: NotNegative = 0.0

    def inputs(self) -> tuple[str, ...]:
        """What runs it, and its azimuth if it has one."""
        return (self.drive,) if self.alpha is None else (self.drive, self.alpha)

    def ranges(self, x: Array) -> tuple[DataRange, ...]:
        """The input itself, if reverse running is not known."""
        if self.astern is not None:
            return ()
        unit = "1/s" if self.drive.startswith("n") else ""
        return (DataRange(self.drive, unit, x[:, input_index(self.drive)], 0.0, np.inf),)

    def values(self) -> Array:
        """Values of the parameters; reverse running that is not known is that ahead."""
        both = {"astern": self.ahead if self.astern is None else self.astern}
        return np.array([both.get(name, getattr(self, name)) for name in self.PARAMETERS])

    def structure(self, first: int, place: int, places: Mapping[str, int]) -> ThrusterStructure:
        """Inputs and parameters in the arrays of the kernels."""
        turns = self.alpha is not None
        alpha = input_index(self.alpha) if self.alpha is not None else 0
        return ThrusterStructure(input_index(self.drive), alpha, turns, first)


@lean_kernel
def _step(
    structure: ThrusterStructure, parameters: Array, z: Array, wake: Array, force: Array
) -> None:
    """Add the thrust in the flow at its place."""
    at, drive = structure.first, z[structure.drive]
    angle = parameters[at + ANGLE] + (z[structure.alpha] if structure.turns else 0.0)
    c, s = np.cos(angle), np.sin(angle)
    x, y, dead = parameters[at + X_T], parameters[at + Y_T], parameters[at + DEAD]
    u, v = z[U] - y * z[R], z[V] + x * z[R]
    along, across = c * u + s * v, c * v - s * u
    size = abs(drive)
    size = where(size > dead, (size - dead) / (1.0 - dead), 0.0)
    forward = drive >= 0.0
    scale = where(forward, parameters[at + AHEAD], -parameters[at + ASTERN])
    curve = parameters[at + CURVE]
    thrust = scale * (1.0 - curve + curve * size) * size - parameters[at + ADVANCE] * size * along
    thrust = thrust * np.exp(-parameters[at + CROSSING] * across * across)
    force[0] += c * thrust
    force[1] += s * thrust
    force[5] += (x * s - y * c) * thrust


DEVICES[ThrusterStructure] = _step
