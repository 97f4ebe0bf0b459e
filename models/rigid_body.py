"""The rigid body and its buoyancy: inertia and restoring forces about the vehicle's origin.

Positions r_g of gravity and r_b of buoyancy are in body axes from the origin CO; the inertia
matrix is the one about CO. Hoyer (2021), sections 2.2.1 and 2.2.2.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models import basis
from models.basis import DOFS, Array
from models.errors import ConfigurationError
from models.vessel import Vessel

# R(q)' e_3, the direction of gravity in body axes, is made of these
DOWN = ("sin(theta)", "sin(phi)cos(theta)", "cos(phi)cos(theta)")

Vector3 = tuple[float, float, float]


def cross_matrix(a: Sequence[float] | Array) -> Array:
    """S(a) with S(a) b = a x b, shape (3, 3)."""
    x, y, z = a
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


@dataclass(frozen=True)
class RigidBody:
    """Mass [kg], inertia about CO [kg m^2], weight and buoyancy [N], and where they act [m]."""

    mass_kg: float
    inertia_kg_m2: tuple[Vector3, Vector3, Vector3]
    centre_of_gravity_m: Vector3
    weight_n: float
    buoyancy_n: float
    centre_of_buoyancy_m: Vector3

    def __post_init__(self) -> None:
        if not self.mass_kg > 0.0:
            raise ConfigurationError(f"mass_kg must be positive, got {self.mass_kg}")
        for name in ("weight_n", "buoyancy_n"):
            if not getattr(self, name) >= 0.0:
                raise ConfigurationError(f"{name} must not be negative, got {getattr(self, name)}")
        matrix = np.array(self.inertia_kg_m2)
        if not np.array_equal(matrix, matrix.T):
            raise ConfigurationError("inertia_kg_m2 must be symmetric")
        if np.min(np.linalg.eigvalsh(self.inertia())) <= 0.0:
            raise ConfigurationError(
                "inertia_kg_m2: about CO it must exceed that of the mass at the centre of gravity"
            )

    def inertia(self) -> Array:
        """M_RB = [m I, -m S(r_g); m S(r_g), I_b], shape (6, 6). Hoyer (2021), eq. (2.9)."""
        arm = self.mass_kg * cross_matrix(self.centre_of_gravity_m)
        return np.block(
            [[self.mass_kg * np.eye(3), -arm], [arm, np.array(self.inertia_kg_m2)]],
        )

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
