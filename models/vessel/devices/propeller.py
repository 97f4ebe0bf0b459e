"""A fixed-pitch propeller behind the hull, by its open-water characteristic.

    X_P = (1 - t_P) rho n^2 D_P^4 K_T(J),   J = u (1 - w_P) / (n D_P),
    K_T = k_0 + k_1 J + k_2 J^2

Yasukawa and Yoshimura (2015), eqs. (8) to (10). With n^2 K_T(J) = k_0 n^2 + k_1 n s + k_2 s^2,
s = u (1 - w_P) / D_P, the thrust is continuous at n = 0.

The wake fraction depends on the drift at the propeller, beta_P = beta - x_P' r':

    exponential:  w_P = w_P0 exp(-C_1 beta_P^2)
    yasukawa:     (1 - w_P) / (1 - w_P0) = 1 + (1 - exp(-C_1 |beta_P|)) (C_2 - 1)
    quadratic:    1 - w_P = 1 - w_P0 + C_1 (v' + x_P' r')^2

with C_2 for each sign of beta_P, eq. (16). The first is that of Kose et al., C_1 = 4, the last that
of Son and Nomoto (1982).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal, NamedTuple

import numpy as np

from seatrial.models.compiled import lean_kernel
from seatrial.models.elementary import where
from seatrial.models.ranges import Positive
from seatrial.models.vessel.basis import INDEX, Array
from seatrial.models.vessel.devices.device import (
    DEVICES,
    Bounds,
    DataRange,
    Device,
    device_forces,
    input_index,
    installed,
)

U, V, R, SPEED, OVER_SPEED, BETA = (INDEX[name] for name in ("u", "v", "r", "U", "1/U", "beta"))
D_P, K_0, K_1, K_2, W_P0, C_1, C_2_PLUS, C_2_MINUS, T_P, X_P, RHO, LENGTH = range(12)


WAKES = ("exponential", "yasukawa", "quadratic")
EXPONENTIAL, _, QUADRATIC = range(len(WAKES))


class PropellerStructure(NamedTuple):
    """Input and parameters of a propeller in the arrays of the kernels."""

    n: int
    first: int  # parameter
    place: int  # in `wake`
    wake: int  # position in WAKES


@dataclass(frozen=True)
class Propeller(Device):
    """A propeller on the centre line that an input `n` [1/s] drives.

    `x_P` is its position in ship lengths, forward of midship. `C_2` has no effect on the
    exponential wake. The thrust is valid where K_T is: from bollard pull to the speed without
    thrust; `diagnostics` of a run count what lies outside.
    """

    PARAMETERS: ClassVar[Mapping[str, Bounds]] = {
        "diameter_m": Bounds("m", 0.01, 15.0),
        "k_0": Bounds("", 0.05, 1.0),
        "k_1": Bounds("", -1.0, 0.0),
        "k_2": Bounds("", -1.0, 0.5),
        "w_P0": Bounds("", 0.0, 0.7),
        "C_1": Bounds("", 0.0, 10.0),
        "C_2_plus": Bounds("", 0.0, 3.0),
        "C_2_minus": Bounds("", 0.0, 3.0),
        "t_P": Bounds("", 0.0, 0.5),
        "x_P": Bounds("", -1.0, 0.0),
        "rho_kg_m3": Bounds("kg/m^3", 900.0, 1100.0),
        "length_m": Bounds("m", 0.1, 500.0),
    }

    LOADS: ClassVar[tuple[str, ...]] = ("thrust",)

    diameter_m: Positive
    k_0: float
    k_1: float
    k_2: float
    w_P0: float
    t_P: float
    length_m: Positive
    x_P: float = -0.5
    C_1: float = 4.0
    C_2_plus: float = 1.0
    C_2_minus: float = 1.0
    rho_kg_m3: Positive = 1025.0
    wake: Literal["exponential", "yasukawa", "quadratic"] = "exponential"
    n: str = "n"

    def inputs(self) -> tuple[str, ...]:
        """The shaft speed."""
        return (self.n,)

    def structure(self, first: int, place: int, places: Mapping[str, int]) -> PropellerStructure:
        """Input and parameters in the arrays of the kernels."""
        return PropellerStructure(input_index(self.n), first, place, WAKES.index(self.wake))

    def loads(self, x: Array) -> Array:
        """The thrust, of which the hull takes the share t_P."""
        ahead = device_forces(installed({"propeller": self}), x)[:, :1]
        return np.asarray(ahead / (1.0 - self.t_P))

    def ranges(self, x: Array) -> tuple[DataRange, ...]:
        """J = u (1 - w_P0) / (n D_P) ahead, up to that without thrust; no data for n < 0."""
        n, none = x[:, input_index(self.n)], np.full(len(x), np.nan)
        advance = x[:, U] * (1.0 - self.w_P0) / self.diameter_m
        ratio = np.divide(advance, n, out=none, where=n > 0.0)
        roots = np.roots([self.k_2, self.k_1, self.k_0])
        free = [float(root.real) for root in roots if abs(root.imag) < 1e-12 and root.real > 0.0]
        highest = min(free, default=np.inf)
        return DataRange("J", "", ratio, 0.0, highest), DataRange("n", "1/s", n, 0.0, np.inf)


@lean_kernel
def drift(z: Array, position: float, length: float) -> float:
    """Drift angle [rad] at a position in ship lengths: beta - x' r', r' = r L / U."""
    return -z[BETA] - position * z[R] * length * z[OVER_SPEED]  # type: ignore[no-any-return]


@lean_kernel
def _step(
    structure: PropellerStructure, parameters: Array, z: Array, wake: Array, force: Array
) -> None:
    """Add the thrust, and write the velocities at and far behind the propeller."""
    at, n = structure.first, z[structure.n]
    diameter, w_0, c_1 = parameters[at + D_P], parameters[at + W_P0], parameters[at + C_1]
    beta = drift(z, parameters[at + X_P], parameters[at + LENGTH])
    if structure.wake == EXPONENTIAL:
        flow = 1.0 - w_0 * np.exp(-c_1 * beta * beta)
    elif structure.wake == QUADRATIC:
        turn = parameters[at + X_P] * z[R] * parameters[at + LENGTH]
        aside = (z[V] + turn) * z[OVER_SPEED]
        flow = 1.0 - w_0 + c_1 * aside * aside
    else:
        c_2 = where(beta >= 0.0, parameters[at + C_2_PLUS], parameters[at + C_2_MINUS])
        flow = (1.0 - w_0) * (1.0 + (1.0 - np.exp(-c_1 * abs(beta))) * (c_2 - 1.0))
    inflow = z[U] * flow
    s = inflow / diameter
    loading = (parameters[at + K_0] * n + parameters[at + K_1] * s) * n + parameters[
        at + K_2
    ] * s * s
    d_2 = diameter * diameter
    force[0] += (1.0 - parameters[at + T_P]) * parameters[at + RHO] * d_2 * d_2 * loading
    jet = inflow * inflow + 8.0 / np.pi * d_2 * loading  # u_P^2 (1 + 8 K_T / (pi J^2))
    wake[structure.place] = inflow
    wake[structure.place + 1] = np.sqrt(where(jet > 0.0, jet, 0.0))


DEVICES[PropellerStructure] = _step
