"""Degrees of freedom, the letters of their motion and their units, as in Fossen (2021), Table 2.1.

A position is measured in metres along north, east and down, an angle in radians.
"""

from collections.abc import Sequence

DOFS = ("surge", "sway", "heave", "roll", "pitch", "yaw")
PLANAR = ("surge", "sway", "yaw")
ROLLING = ("surge", "sway", "roll", "yaw")
POSES = ("x", "y", "z", "phi", "theta", "psi")
VELOCITIES = ("u", "v", "w", "p", "q", "r")
ACCELERATIONS = tuple(f"{name}_dot" for name in VELOCITIES)
FORCE_UNIT = {dof: "N" if dof in DOFS[:3] else "Nm" for dof in DOFS}
SQUARE_UNIT = {dof: "N^2" if dof in DOFS[:3] else "(Nm)^2" for dof in DOFS}
POSE_UNIT = {dof: "m" if dof in DOFS[:3] else "rad" for dof in DOFS}
VELOCITY_UNIT = {dof: f"{unit}/s" for dof, unit in POSE_UNIT.items()}
ACCELERATION_UNIT = {dof: f"{unit}/s^2" for dof, unit in POSE_UNIT.items()}


def poses_of(dofs: Sequence[str]) -> tuple[str, ...]:
    """Names of the pose of each degree of freedom: x, y, z, phi, theta, psi."""
    return tuple(POSES[DOFS.index(dof)] for dof in dofs)


def velocities_of(dofs: Sequence[str]) -> tuple[str, ...]:
    """Letters of the body velocities: u, v, w, p, q, r."""
    return tuple(VELOCITIES[DOFS.index(dof)] for dof in dofs)


def accelerations_of(dofs: Sequence[str]) -> tuple[str, ...]:
    """Names of the body accelerations: u_dot and so on."""
    return tuple(ACCELERATIONS[DOFS.index(dof)] for dof in dofs)
