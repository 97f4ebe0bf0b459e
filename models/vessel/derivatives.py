"""Coefficient tables from inertia matrices and hydrodynamic derivatives, named as by Fossen.

Derivatives in a prime system, and their table in SI units:

    X = 1/2 rho L d U^2 sum X'_k phi'_k,   N = 1/2 rho L^2 d U^2 sum N'_k phi'_k

with u' = u / U, v' = v / U, r' = r L / U, p' = p L / U; angles are not scaled, accelerations by
U^2 / L. d is the draught in the system of MMG and the length in that of SNAME (1950). Coefficients
of Abkowitz are about straight motion: u' = (u - U_0) / U. Fossen (2011), section 7.2.5.

A product of k velocities has the coefficient 1/2 rho L d C' L^j U^(2 - k), so that it is a term of
the basis: Y'_v is that of v U, Y'_vvr that of v^2 r / U.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from math import prod
from typing import Literal

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import ACCELERATIONS, DOFS, FORCE_UNIT, POSES, VELOCITIES
from seatrial.models.ranges import Density, Length, NotNegative, Positive, check_ranges
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import N_VARIABLES, VARIABLES, Array, Term
from seatrial.models.vessel.kinematics import cross_matrix
from seatrial.models.vessel.table import Vessel

CoriolisForces = bool | Literal["mmg"]
MUNK = basis.term("uv")


def coriolis(inertia: Array, dofs: Sequence[str]) -> Vessel:
    """C(nu) nu as a table, from the inertia matrix (n_dof, n_dof).

    Kirchhoff's equations: with momenta p1 = M_1 nu (linear) and p2 = M_2 nu (angular),
    C(nu) nu = [omega x p1, omega x p2 + v x p1], hence nu' C(nu) nu = 0. For a planar vessel
    this is Jervan (2020), eq. (2.5), with the terms in m12 and m13 that it leaves out.
    """
    full = np.zeros((6, 6))
    index = [DOFS.index(dof) for dof in dofs]
    full[np.ix_(index, index)] = inertia
    products: dict[Term, Array] = {}
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):  # cross product: a_j b_k - a_k b_j
        for row, left, right in ((i, 3, 0), (3 + i, 3, 3), (3 + i, 0, 0)):
            for sign, a, b in ((1.0, j, k), (-1.0, k, j)):
                _add_product(products, row, VELOCITIES[left + a], sign * full[right + b])
    coefficients = {t: c[index] for t, c in products.items() if np.any(c[index] != 0.0)}
    terms = tuple(sorted(coefficients))
    theta = np.array([coefficients[term] for term in terms]).reshape(len(terms), len(dofs))
    return Vessel("coriolis", tuple(dofs), terms, theta)


def without_munk_moment(forces: Vessel) -> Vessel:
    """Coriolis forces without the yaw moment of u v. Yasukawa and Yoshimura (2015), eq. (4)."""
    theta = np.array(forces.theta)
    if MUNK in forces.terms and "yaw" in forces.dofs:
        theta[forces.terms.index(MUNK), forces.dofs.index("yaw")] = 0.0
    return replace(forces, theta=theta)


def _add_product(products: dict[Term, Array], row: int, factor: str, momentum: Array) -> None:
    """Add factor * (momentum' nu) to one row of the sum of products."""
    for velocity, value in zip(VELOCITIES, momentum, strict=True):
        if value != 0.0:
            entry = products.setdefault(basis.term(factor + velocity), np.zeros(6))
            entry[row] += value


def from_derivatives(
    name: str,
    dofs: Sequence[str],
    inertia: Array,
    derivatives: Mapping[str, float],
    with_coriolis: CoriolisForces = True,
) -> Vessel:
    """Table of a vessel from its inertia matrix and hydrodynamic derivatives.

    Derivatives have the names of Fossen: `X_u`, `X_|u|u`, `Y_vvv`, `N_|v|r`, with the letter of
    the force before the underscore. The table gives the force that a motion requires, so an entry
    is minus the derivative. Jervan (2020), eqs. (2.3)-(2.6); Hoyer (2021), eqs. (2.11)-(2.18).

    Args:
        name: name of the vessel.
        dofs: degrees of freedom.
        inertia: inertia matrix [kg, kg m, kg m^2], shape (n_dof, n_dof); it may include the added
            mass.
        derivatives: derivatives in SI units; they may include the added mass (`X_udot`).
        with_coriolis: whether the Coriolis forces of the inertia matrix are added; `mmg` leaves out
            the Munk moment, which derivatives measured with a drift angle include.

    Returns:
        The coefficient table.

    Raises:
        ConfigurationError: a shape or the name of a derivative is wrong.
    """
    n = len(dofs)
    matrix = np.asarray(inertia, dtype=np.float64)
    if matrix.shape != (n, n):
        raise ConfigurationError(f"inertia: got shape {matrix.shape}, expected ({n}, {n})")
    rows = tuple(map(tuple, matrix.tolist()))
    return _table(name, tuple(dofs), rows, tuple(derivatives.items()), with_coriolis)


@lru_cache(maxsize=64)
def _table(
    name: str,
    dofs: tuple[str, ...],
    inertia: tuple[tuple[float, ...], ...],
    items: tuple[tuple[str, float], ...],
    with_coriolis: CoriolisForces,
) -> Vessel:
    """The table of `from_derivatives`; a trial builds its vessel several times."""
    matrix, derivatives = np.array(inertia), dict(items)
    accelerations = basis.terms(ACCELERATIONS[DOFS.index(dof)] for dof in dofs)
    added = {key: v for key, v in derivatives.items() if parse_derivative(key)[1] in accelerations}
    damping = {key: value for key, value in derivatives.items() if key not in added}
    vessel = Vessel(name, dofs, accelerations, matrix.T)
    vessel = vessel + derivative_table(name, dofs, added)
    if with_coriolis:
        forces = coriolis(vessel.inertia, dofs)
        vessel = vessel + (without_munk_moment(forces) if with_coriolis == "mmg" else forces)
    return vessel + derivative_table(name, dofs, damping)


_OF_MOTION = {  # variables of a degree of freedom
    dof: {velocity, acceleration, *({pose} & {*basis.ANGLES})}
    for dof, pose, velocity, acceleration in zip(
        DOFS, POSES, VELOCITIES, ACCELERATIONS, strict=True
    )
}


def derivative_table(name: str, dofs: Sequence[str], derivatives: Mapping[str, float]) -> Vessel:
    """Table of hydrodynamic or wind derivatives only; its entries are minus the derivatives."""
    rows: dict[Term, Array] = {}
    for key, value in derivatives.items():
        dof, term = parse_derivative(key)
        if dof not in dofs:
            raise ConfigurationError(
                f"derivatives.{key}: got {dof}, expected one of {', '.join(dofs)}"
            )
        factors = {basis.VARIABLES[code % basis.N_VARIABLES] for code in term.codes}
        if lacking := factors & {name for each in {*DOFS} - {*dofs} for name in _OF_MOTION[each]}:
            expected = f"expected the motion in {', '.join(dofs)}"
            raise ConfigurationError(f"derivatives.{key}: got {min(lacking)}, {expected}")
        rows.setdefault(term, np.zeros(len(dofs)))[dofs.index(dof)] -= value
    theta = np.array([*rows.values()]).reshape(len(rows), len(dofs))
    return Vessel(name, tuple(dofs), tuple(rows), theta)


@lru_cache(maxsize=1024)
def parse_derivative(key: str) -> tuple[str, Term]:
    """`Y_|v|r` -> ("sway", the term |v|r); `X_udot` names an added mass, `Y_0` a constant."""
    letter, _, rest = key.partition("_")
    if letter not in tuple("XYZKMN") or not rest:
        raise ConfigurationError(
            f"derivatives.{key}: expected a name such as X_u, X_|u|u, Y_vvv or N_|v|r"
        )
    name = rest if rest.endswith("_dot") else rest.replace("dot", "_dot")
    return DOFS["XYZKMN".index(letter)], basis.term("1" if name == "0" else name)


# Rigid body: inertia and restoring forces about the origin of the body axes.
#
# The centres of gravity r_g and buoyancy r_b are in body axes from the origin CO; the inertia
# matrix refers to CO. Hoyer (2021), sections 2.2.1 and 2.2.2.


# Terms of R(q)' e_3, the direction of gravity in body axes
DOWN = ("sin(theta)", "sin(phi)cos(theta)", "cos(phi)cos(theta)")
Vector3 = tuple[float, float, float]


@dataclass(frozen=True)
class RigidBody:
    """Mass [kg], inertia about CO [kg m^2], weight and buoyancy [N] with their centres [m]."""

    mass_kg: Positive
    inertia_kg_m2: tuple[Vector3, Vector3, Vector3]
    centre_of_gravity_m: Vector3
    weight_n: NotNegative
    buoyancy_n: NotNegative
    centre_of_buoyancy_m: Vector3

    def __post_init__(self) -> None:
        check_ranges(self)
        matrix = np.array(self.inertia_kg_m2)
        if not np.array_equal(matrix, matrix.T):
            raise ConfigurationError(f"inertia_kg_m2 must be symmetric, got {matrix.tolist()}")
        if np.min(np.linalg.eigvalsh(self.inertia())) <= 0.0:
            raise ConfigurationError(
                f"inertia_kg_m2: got {matrix.tolist()}, expected more than the inertia about CO of "
                "a point mass at the centre of gravity"
            )

    def inertia(self) -> Array:
        """M_RB = [m I, -m S(r_g); m S(r_g), I_b], shape (6, 6). Hoyer (2021), eq. (2.9)."""
        arm = self.mass_kg * cross_matrix(self.centre_of_gravity_m)
        return np.block([[self.mass_kg * np.eye(3), -arm], [arm, np.array(self.inertia_kg_m2)]])

    def restoring(self, dofs: tuple[str, ...]) -> Vessel:
        """g(eta) as a table. Hoyer (2021), eq. (2.7).

        With k = R' e_3 = (-sin theta, cos theta sin phi, cos theta cos phi) the forces are
        -(W - B) k and the moments -(W r_g - B r_b) x k.
        """
        net = -(self.weight_n - self.buoyancy_n) * np.eye(3)
        weight, buoyancy = self.weight_n, self.buoyancy_n
        lever = weight * np.array(self.centre_of_gravity_m)
        lever = lever - buoyancy * np.array(self.centre_of_buoyancy_m)
        force = np.vstack([net, -cross_matrix(lever)]) @ np.diag([-1.0, 1.0, 1.0])
        rows = [DOFS.index(dof) for dof in dofs]
        return Vessel("restoring", dofs, basis.terms(DOWN), force[rows].T)


POWERS = ("U^2", "U", "", "/U", "/U^2")  # U^(2 - k)


@dataclass(frozen=True)
class Prime:
    """Scales of a prime system.

    `draught_m`: null for the system of SNAME. `speed_m_s` is U_0 of coefficients about straight
    motion, 0 for those of u itself. With `inertia` the inertia matrix is in this system as well.
    """

    length_m: Length
    draught_m: Positive | None = None
    rho_kg_m3: Density = 1025.0
    speed_m_s: NotNegative = 0.0
    inertia: bool = False

    def __post_init__(self) -> None:
        check_ranges(self)

    @property
    def scale(self) -> float:
        """1/2 rho L d [kg/m]."""
        return 0.5 * self.rho_kg_m3 * self.length_m * (self.draught_m or self.length_m)

    def inertia_matrix(self, matrix: Array, dofs: tuple[str, ...]) -> Array:
        """Inertia in SI units, shape (n_dof, n_dof), if it is given in the prime system."""
        if not self.inertia:
            return matrix
        arms = np.array([1.0 if FORCE_UNIT[dof] == "N" else self.length_m for dof in dofs])
        return np.asarray(self.scale * self.length_m * np.outer(arms, arms) * matrix)

    def dimensional(self, derivatives: Mapping[str, float]) -> dict[str, float]:
        """The derivatives in SI units, by the names of their products, such as `Y_vU`.

        Raises ConfigurationError for a wrong name or more than four velocities.
        """
        si: dict[str, float] = {}
        for key, value in derivatives.items():
            dof, parsed = parse_derivative(key)
            names = Counter(VARIABLES[code % N_VARIABLES] for code in parsed.codes if code)
            angular = sum(names[v] for v in (*VELOCITIES[3:], *ACCELERATIONS[3:]))
            scaled = value * self.scale * self.length_m ** (angular + (FORCE_UNIT[dof] == "Nm"))
            if any(names[a] for a in ACCELERATIONS):
                products = [(parsed.name, self.length_m)]
            else:
                speed = _speed(key, sum(names[v] for v in VELOCITIES))
                products = [(text + speed or "1", each) for text, each in self._expanded(parsed)]
            for text, factor in products:
                label = f"{key[0]}_{basis.term(text)}"
                si[label] = si.get(label, 0.0) + factor * scaled
        return si

    def _expanded(self, parsed: Term) -> list[tuple[str, float]]:
        """The products that a term about straight motion stands for, with their factors."""
        factors = [VARIABLES[code % N_VARIABLES] for code in parsed.codes if 0 < code < N_VARIABLES]
        if not self.speed_m_s or "u" not in factors:
            return [("" if parsed.name == "1" else parsed.name, 1.0)]
        if any(code >= N_VARIABLES for code in parsed.codes):
            raise ConfigurationError(
                f"derivatives: got {parsed} with prime.speed_m_s, expected no magnitudes beside u"
            )
        choices = [
            (("u", 1.0), ("", -self.speed_m_s)) if f == "u" else ((f, 1.0),) for f in factors
        ]
        return [
            ("".join(text for text, _ in each), prod(value for _, value in each))
            for each in product(*choices)
        ]


def _speed(key: str, count: int) -> str:
    """U^(2 - count), for a product of `count` velocities."""
    if count >= len(POWERS):
        raise ConfigurationError(
            f"derivatives.{key}: got {count} velocities, expected at most {len(POWERS) - 1}"
        )
    return POWERS[count]
