"""Inertia and drag of a hull from its dimensions: first values, until better ones are known.

They are right within a factor of two or three. Added mass and cross-flow drag are integrals of
two-dimensional values over a hull of constant draught; forces of lift, which couple sway and yaw
when a vessel moves ahead, are left out.
"""

from dataclasses import dataclass

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import PLANAR
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.vessel.derivatives import from_derivatives
from seatrial.models.vessel.scales import GRAVITY, GYRATION, WATER, scales
from seatrial.models.vessel.table import Vessel

BLOCK = 0.6  # block coefficient of a hull whose mass or draught is not known
SLENDERNESS, FULLNESS = 3.0, 3.0  # length over beam, and beam over draught, likewise
RESISTANCE = 0.006  # total resistance over the dynamic pressure on the wetted surface
CROSS_FLOW = 0.8  # drag coefficient of a section in cross flow, as in Faltinsen (1990)
# Time in which linear drag alone takes 63 % of the speed, in units of sqrt(L / g)
SLOWING, TURNING = 50.0, 10.0
LENGTHS = 0.1, 1000.0  # [m]
SIZES = 0.005, 1.0  # beam and draught, in lengths
BLOCKS = 0.02, 1.0  # a catamaran has little, a barge has most


@dataclass(frozen=True)
class Hull:
    """Dimensions of a hull that floats; raises ConfigurationError if they do not fit together."""

    length_m: Positive
    beam_m: Positive
    draught_m: Positive
    mass_kg: Positive

    def __post_init__(self) -> None:
        check_ranges(self)
        low, high = LENGTHS
        if not low <= self.length_m <= high:
            raise ConfigurationError(f"length: got {self.length_m:g} m, expected {low} to {high:g}")
        low, high = SIZES[0] * self.length_m, SIZES[1] * self.length_m
        for name, size in (("beam", self.beam_m), ("draught", self.draught_m)):
            if not low <= size <= high:
                raise ConfigurationError(
                    f"{name}: got {size:.4g} m, expected {low:g} to {high:g} m for a length of "
                    f"{self.length_m:g} m"
                )
        box = WATER * self.length_m * self.beam_m * self.draught_m
        if not BLOCKS[0] <= self.mass_kg / box <= BLOCKS[1]:
            raise ConfigurationError(
                f"mass: got {self.mass_kg:g} kg, expected {BLOCKS[0]:g} to {BLOCKS[1]:g} times the "
                f"{box:.4g} kg of water in length x beam x draught"
            )


def hull(
    length_m: float,
    beam_m: float | None = None,
    draught_m: float | None = None,
    mass_kg: float | None = None,
) -> Hull:
    """A hull of which only the length must be known; Archimedes gives draught or mass."""
    beam = length_m / SLENDERNESS if beam_m is None else beam_m
    area = BLOCK * WATER * length_m * beam
    if draught_m is None and mass_kg is not None:
        draught_m = mass_kg / area
        if not SIZES[0] * length_m <= draught_m <= SIZES[1] * length_m:
            raise ConfigurationError(
                f"mass: got {mass_kg:g} kg, expected {SIZES[0] * area * length_m:.4g} to "
                f"{SIZES[1] * area * length_m:.4g} kg for this length and beam"
            )
    draught_m = draught_m or beam / FULLNESS
    return Hull(length_m, beam, draught_m, area * draught_m if mass_kg is None else mass_kg)


def rigid_body(hull: Hull) -> dict[str, float]:
    """Mass [kg] and moment of inertia in yaw [kg m^2] about amidships, with r_z = 0.25 L."""
    return {"m": hull.mass_kg, "I_z": hull.mass_kg * (GYRATION * hull.length_m) ** 2}


def derivatives(hull: Hull) -> dict[str, float]:
    """Added mass and drag in surge, sway and yaw, in SI units.

    X_udot by Soding (1982), as in Fossen (2021); sway and yaw by half ellipses as sections,
    a_22 = pi rho T^2 / 2, as in Newman (1977). Quadratic drag in surge on the wetted surface of
    Denny and Mumford, in sway and yaw by the cross flow, as in Faltinsen (1990). Linear drag from
    time constants, as in Fossen (2021).
    """
    L, T = hull.length_m, hull.draught_m
    volume = hull.mass_kg / WATER
    X_udot = -2.7 * WATER * volume ** (5.0 / 3.0) / L**2
    Y_vdot = -0.5 * np.pi * WATER * T**2 * L
    N_rdot = Y_vdot * L**2 / 12.0
    wetted = 1.7 * L * T + volume / T
    froude = np.sqrt(L / GRAVITY)
    body = rigid_body(hull)
    return {
        "X_udot": X_udot,
        "Y_vdot": Y_vdot,
        "N_rdot": N_rdot,
        "X_u": -(body["m"] - X_udot) / (SLOWING * froude),
        "X_|u|u": -0.5 * WATER * wetted * RESISTANCE,
        "Y_v": -(body["m"] - Y_vdot) / (SLOWING * froude),
        "Y_|v|v": -0.5 * WATER * CROSS_FLOW * T * L,
        "N_r": -(body["I_z"] - N_rdot) / (TURNING * froude),
        "N_|r|r": -0.5 * WATER * CROSS_FLOW * T * L**4 / 32.0,
    }


def model(hull: Hull) -> Vessel:
    """The table of these estimates in surge, sway and yaw."""
    body = rigid_body(hull)
    inertia = np.diag([body["m"], body["m"], body["I_z"]])
    return from_derivatives("hull", PLANAR, inertia, derivatives(hull))


def limits(hull: Hull) -> tuple[float, ...]:
    """Largest forces [N, N, Nm] that its thrusters may have, sized for a service speed."""
    return tuple(scales(model(hull), None, hull.length_m).limits.tolist())
