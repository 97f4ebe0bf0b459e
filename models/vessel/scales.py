"""Length, time, force and speed scales of a vessel, from which its tuning is derived.

With Froude's law lengths scale with L, times with sqrt(L / g), speeds with sqrt(g L), and so do all
numbers here: a model at a scale of 1 : lambda has the tuning of the ship, scaled.

Inertia and drag of a hull from its dimensions: first values, until better ones are known.

They are right within a factor of two or three. Added mass and cross-flow drag are integrals of
two-dimensional values over a hull of constant draught; forces of lift, which couple sway and yaw
when a vessel moves ahead, are left out.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import DOFS, PLANAR
from seatrial.models.ranges import Length, Positive, check_ranges
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.derivatives import from_derivatives
from seatrial.models.vessel.table import Vessel

GRAVITY = 9.81  # [m/s^2]
WATER = 1025.0  # density [kg/m^3]
# Radius of gyration in yaw of ships and vehicles over their length, Fossen (2021), section 3.3.
GYRATION = 0.25
VOLUME_RATIO = (
    0.02  # volume over length cubed, of vessels without yaw: between a ship's and a vehicle's
)
LARGEST_FROUDE = 0.4  # hull speed of a displacement vessel
# Speeds for which the thrusters are sized if their limits are unknown: ahead and across in units of
# sqrt(g L), turning in units of sqrt(g / L)
SERVICE = 0.25, 0.15, 0.4
RUN_UP = 20.0  # time to reach that speed without drag, in units of sqrt(L / g)
ACCURACY, STEPS = 1e-12, 200  # of attainable speeds, relative to the largest
BEYOND = 10.0  # a simulation at so many times the attainable speed has diverged


@dataclass(frozen=True, eq=False)
class Scales:
    """Scales of a vessel, by degree of freedom where they are arrays of shape (n_dof,)."""

    dofs: tuple[str, ...]
    length_m: float
    inertia: Array  # diagonal of M [kg, kg m^2]
    limits: Array  # largest force of the thrusters [N, Nm]
    speeds: Array  # attainable speed [m/s, rad/s]
    drag: Array  # force that half the attainable speed needs [N, Nm]

    @property
    def angular(self) -> NDArray[np.bool_]:
        """Whether a degree of freedom is a rotation, shape (n_dof,)."""
        return _angular(self.dofs)

    @property
    def time_s(self) -> float:
        """sqrt(L / g) [s]."""
        return float(np.sqrt(self.length_m / GRAVITY))

    @property
    def speed_m_s(self) -> float:
        """sqrt(g L) [m/s], the speed of Froude number 1."""
        return float(np.sqrt(GRAVITY * self.length_m))

    @property
    def acceleration(self) -> Array:
        """Largest acceleration from rest [m/s^2, rad/s^2], shape (n_dof,)."""
        return self.limits / self.inertia

    @property
    def velocity_limits(self) -> tuple[float, ...]:
        """Speeds beyond which a simulation has diverged [m/s, rad/s]."""
        return tuple((BEYOND * self.speeds).tolist())

    def each(self, linear: float, angular: float) -> Array:
        """A number for the translations and another for the rotations, shape (n_dof,)."""
        return np.where(self.angular, angular, linear)

    def of(self, dof: str, values: Array) -> float:
        """The value of a degree of freedom; 0 if the vessel does not have it."""
        return float(values[self.dofs.index(dof)]) if dof in self.dofs else 0.0


def scales(model: Vessel, limits: tuple[float, ...] | None, length_m: float | None) -> Scales:
    """Scales of a vessel from its table, thrust limits [N, Nm] and length [m].

    One of the two suffices. The length follows from the radius of gyration in yaw, or from the mass
    in surge. The limits follow from the drag and inertia at a service speed.

    Raises ConfigurationError if both are missing, or the table gives no length.
    """
    if limits is None and length_m is None:
        raise ConfigurationError(f"{model.name}: expected force_limits or length_m, got neither")
    inertia = np.diag(model.inertia)
    if np.min(inertia) <= 0.0:
        raise ConfigurationError(
            f"{model.name}: expected a positive inertia on every axis, got {inertia.tolist()}"
        )
    length, still = length_m or _length(model), np.zeros((len(model.dofs), len(model.dofs)))
    at_rest = model.inverse(still, still)  # force without motion [N, Nm], once for each axis
    unit = np.sqrt(GRAVITY * length) / np.where(_angular(model.dofs), length, 1.0)
    if limits is None:
        ahead, across, turning = SERVICE
        speed = unit * np.where(_angular(model.dofs), turning, across)
        if "surge" in model.dofs:
            speed[model.dofs.index("surge")] *= ahead / across
        run_up = inertia * speed / (RUN_UP * np.sqrt(length / GRAVITY))
        thrust = np.maximum(_drag(model, speed, at_rest), run_up)
    else:
        thrust = np.array(limits, dtype=np.float64)
    largest = LARGEST_FROUDE * unit * np.where(_angular(model.dofs), 2.0, 1.0)  # at the bow
    speeds = _attainable(model, at_rest, thrust, largest)
    drag = _drag(model, 0.5 * speeds, at_rest)
    return Scales(model.dofs, length, inertia, thrust, speeds, drag)


def _angular(dofs: tuple[str, ...]) -> NDArray[np.bool_]:
    return np.array([DOFS.index(dof) >= 3 for dof in dofs])


def _length(model: Vessel) -> float:
    """Length [m]: r_z = GYRATION L with r_z^2 = I_z / m, or m = BLOCK rho L^3."""
    masses = np.diag(model.inertia)[~_angular(model.dofs)]
    if not len(masses):
        raise ConfigurationError(f"{model.name}: expected length_m, as no mass is known, got none")
    mass = float(masses[0])
    if "yaw" not in model.dofs:
        return float(np.cbrt(mass / (VOLUME_RATIO * WATER)))
    yaw = model.dofs.index("yaw")
    return float(np.sqrt(model.inertia[yaw, yaw] / mass)) / GYRATION


def _drag(model: Vessel, speeds: Array, at_rest: Array) -> Array:
    """Force along each axis [N, Nm] that a speed on this axis alone needs, shape (n_dof,)."""
    nu = np.diag(speeds)
    return np.asarray(np.diag(model.inverse(np.zeros_like(nu), nu) - at_rest))


def _attainable(model: Vessel, at_rest: Array, limits: Array, largest: Array) -> Array:
    """Speed at which the drag equals the limit, at most `largest` [m/s, rad/s].

    By the Illinois form of the false position, on all axes at once: Dowell and Jarratt (1971), A
    modified regula falsi method for computing the root of an equation, BIT 11.
    """
    before, speeds = np.zeros_like(largest), largest
    less, excess = -limits, _drag(model, largest, at_rest) - limits
    reached, step = excess > 0.0, largest
    for _ in range(STEPS):
        if not np.any(np.abs(step) > ACCURACY * largest):
            break
        step = np.zeros_like(largest)
        np.divide(excess * (before - speeds), excess - less, out=step, where=reached)
        value = _drag(model, speeds + step, at_rest) - limits
        crossed = value * excess < 0.0
        before, less = np.where(crossed, (speeds, excess), (before, 0.5 * less))
        speeds, excess = speeds + step, value
    return speeds


BLOCK_COEFFICIENT = 0.6  # block coefficient of a hull whose mass or draught is not known
SLENDERNESS, FULLNESS = 3.0, 3.0  # length over beam, and beam over draught, likewise
RESISTANCE = 0.006  # total resistance over the dynamic pressure on the wetted surface
CROSS_FLOW = 0.8  # drag coefficient of a section in cross flow, as in Faltinsen (1990)
# Time in which linear drag alone takes 63 % of the speed, in units of sqrt(L / g)
SLOWING, TURNING = 50.0, 10.0
SIZES = 0.005, 1.0  # beam and draught, in lengths
BLOCKS = 0.02, 1.0  # a catamaran has little, a barge has most


@dataclass(frozen=True)
class Hull:
    """Dimensions of a hull that floats; raises ConfigurationError if they do not fit together."""

    length_m: Length
    beam_m: Positive
    draught_m: Positive
    mass_kg: Positive

    def __post_init__(self) -> None:
        check_ranges(self)
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
    if not length_m > 0.0:
        raise ConfigurationError(f"length: got {length_m:g} m, expected more than 0")
    beam = length_m / SLENDERNESS if beam_m is None else beam_m
    area = BLOCK_COEFFICIENT * WATER * length_m * beam
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
