"""Degrees of freedom, the letters of their motion and their units, as in Fossen (2021), Table 2.1.

A position is measured in metres along north, east and down, an angle in radians.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from seatrial.models.ranges import Positive

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
# Measures of a manoeuvre by their names on its sheet, with their units; L: ship lengths.
MEASURES = {
    "advance": "L", "transfer": "L", "tactical diameter": "L", "steady diameter": "L",
    "track at 10 deg": "L", "time to 90 deg": "s", "time to 180 deg": "s", "speed loss": "%",
    "drift angle": "deg", "yaw rate": "deg/s", "residual yaw rate": "deg/s",
    "width of the loop": "deg", "initial turning": "L", "period P": "s", "track reach": "L",
    "head reach": "L", "lateral deviation": "L", "time to stop": "s", "change of heading": "deg",
    "offset from the track": "L", "error of the heading": "deg",
    "largest distance from the track": "L", "helm": "deg",
    **{f"{n} overshoot": "deg" for n in ("first", "second", "third", "fourth")},
    **{f"{n} overshoot, time": "s" for n in ("first", "second", "third", "fourth")},
}  # fmt: skip
Manoeuvre = Literal["turn", "zigzag", "spiral", "reverse_spiral", "williamson", "stop"]


@dataclass(frozen=True)
class OrderedManoeuvre:
    """What was ordered in a recorded manoeuvre; None: what its helm and heading tell."""

    kind: Manoeuvre | None = None
    helm_deg: Positive | None = None
    turn_deg: Positive | None = None  # change of heading at which the helm of a zig-zag is put over


def poses_of(dofs: Sequence[str]) -> tuple[str, ...]:
    """Names of the pose of each degree of freedom: x, y, z, phi, theta, psi."""
    return tuple(POSES[DOFS.index(dof)] for dof in dofs)


def velocities_of(dofs: Sequence[str]) -> tuple[str, ...]:
    """Letters of the body velocities: u, v, w, p, q, r."""
    return tuple(VELOCITIES[DOFS.index(dof)] for dof in dofs)


def accelerations_of(dofs: Sequence[str]) -> tuple[str, ...]:
    """Names of the body accelerations: u_dot and so on."""
    return tuple(ACCELERATIONS[DOFS.index(dof)] for dof in dofs)
