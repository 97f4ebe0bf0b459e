"""Disturbance cases: measurement noise and constant forces, realised from seeded generators."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models import basis
from models.basis import DOFS, Array
from models.errors import ConfigurationError
from models.simulation import Weather
from models.vessel import PLANAR, Vessel


@dataclass(frozen=True)
class MeasurementNoise:
    """Standard deviations of white Gaussian noise, drawn once a sample. Jervan, Table 4.14."""

    position_m: float
    angle_deg: float
    velocity_m_s: float
    angular_rate_deg_s: float
    acceleration_m_s2: float
    angular_acceleration_deg_s2: float

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value < 0.0:
                raise ConfigurationError(f"{name} must not be negative, got {value}")

    def deviations(self, dofs: Sequence[str]) -> Array:
        """Standard deviation of pose, velocity and acceleration, shape (3, n_dof), in SI."""
        linear = [self.position_m, self.velocity_m_s, self.acceleration_m_s2]
        angular = [self.angle_deg, self.angular_rate_deg_s, self.angular_acceleration_deg_s2]
        columns = [linear if dof in DOFS[:3] else np.radians(angular) for dof in dofs]
        return np.array(columns).T


@dataclass(frozen=True)
class ConstantForce:
    """A force that is constant in NED. Jervan (2020), Table 4.16.

    A vessel that moves along one axis only meets its northward part.
    """

    north_n: float
    east_n: float
    moment_nm: float

    def ned(self, dofs: Sequence[str]) -> Array:
        """The force over `dofs` [N, Nm], shape (n_dof,)."""
        parts = {"surge": self.north_n, "sway": self.east_n, "yaw": self.moment_nm}
        return np.array([parts.get(dof, 0.0) for dof in dofs])

    def table(self, dofs: tuple[str, ...]) -> Vessel:
        """The same as terms of the force that a motion needs: tau = F(nu_dot, nu) - R(psi)' f."""
        force = self.ned(dofs)
        if dofs != PLANAR:
            return Vessel("constant force", dofs, basis.terms(["1"]), -force[None, :])
        north, east, moment = force
        theta = [[0.0, 0.0, -moment], [-north, -east, 0.0], [-east, north, 0.0]]
        names = basis.terms(["1", "cos(psi)", "sin(psi)"])
        return Vessel("constant force", dofs, names, np.array(theta))


@dataclass(frozen=True)
class Disturbance:
    """A disturbance case, composed of parts; a part that is None is absent."""

    noise: MeasurementNoise | None
    force: ConstantForce | None

    def realise(self, n: int, dofs: Sequence[str], noise_rng: np.random.Generator) -> Weather:
        """One realisation of n control instants; the same generator gives the same weather."""
        deviations = np.zeros((3, len(dofs))) if self.noise is None else self.noise.deviations(dofs)
        draws = noise_rng.standard_normal((n, 3, len(dofs))) * deviations
        force = np.zeros(len(dofs)) if self.force is None else self.force.ned(dofs)
        pose, velocity, acceleration = (np.ascontiguousarray(draws[:, i]) for i in range(3))
        return Weather(pose, velocity, acceleration, np.tile(force, (n, 1)))

    def table(self, dofs: tuple[str, ...]) -> Vessel:
        """What the disturbance adds to the force a motion needs, as far as it is a table."""
        if self.force is None:
            return Vessel("undisturbed", dofs, (), np.zeros((0, len(dofs))))
        return self.force.table(dofs)
