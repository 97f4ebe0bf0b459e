"""Hydrodynamic derivatives in a prime system, and their table in SI units.

    X = 1/2 rho L d U^2 sum X'_k phi'_k,   N = 1/2 rho L^2 d U^2 sum N'_k phi'_k

with u' = u / U, v' = v / U, r' = r L / U, p' = p L / U; angles are not scaled, accelerations by
U^2 / L. d is the draught in the system of MMG and the length in that of SNAME (1950). Coefficients
of Abkowitz are about straight motion: u' = (u - U_0) / U. Fossen (2011), section 7.2.5.

A product of k velocities has the coefficient 1/2 rho L d C' L^j U^(2 - k), so that it is a term of
the basis: Y'_v is that of v U, Y'_vvr that of v^2 r / U.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from math import prod

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import ACCELERATIONS, FORCE_UNIT, VELOCITIES
from seatrial.models.ranges import NotNegative, Positive, check_ranges
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import N_VARIABLES, VARIABLES, Array, Term
from seatrial.models.vessel.derivatives import parse_derivative

POWERS = ("U^2", "U", "", "/U", "/U^2")  # U^(2 - k)


@dataclass(frozen=True)
class Prime:
    """Scales of a prime system.

    `draught_m`: null for the system of SNAME. `speed_m_s` is U_0 of coefficients about straight
    motion, 0 for those of u itself. With `inertia` the inertia matrix is in this system as well.
    """

    length_m: Positive
    draught_m: Positive | None = None
    rho_kg_m3: Positive = 1025.0
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
