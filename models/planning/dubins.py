"""Shortest paths of a vessel that turns on circles of one radius and sails ahead only.

Dubins (1957), On curves of minimal length with a constraint on average curvature. Positions are
(north, east) [m], a heading grows to starboard. As complex numbers, a turn to the side s (1 to
starboard, -1 to port) at heading psi is about c = p + i s R exp(i psi), and the six words follow
from the centres of the first and the last turn, D = c_2 - c_1 apart:

    arc s, line, arc e    D = (L + i (e - s) R) exp(i theta)
    arc s, arc -s, arc s  |D| = 4 R cos a,  tangents at theta = arg D +- a + s pi / 2
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from seatrial.models.vessel.basis import Array

TURN = 2.0 * np.pi
ROUNDING = 1e-9  # [rad] by which a turn may fall short of none


class Arc(NamedTuple):
    """A turn to starboard (side 1), to port (-1), or a straight line (0)."""

    side: int
    length_m: float


def dubins(start: Array, end: Array, radius_m: float) -> tuple[Arc, ...]:
    """The shortest path between two poses (3,) [m, m, rad], of three arcs."""
    paths, (first, last), R = [], (float(start[2]), float(end[2])), radius_m

    def arc(side: int, angle: float) -> Arc:
        turned = (side * angle + ROUNDING) % TURN - ROUNDING
        return Arc(side, R * max(float(turned), 0.0))

    def centre(pose: Array, side: int) -> complex:
        return complex(complex(*pose[:2]) + 1j * side * R * np.exp(1j * pose[2]))

    for s in (1, -1):
        for e in (1, -1):
            D, aside = centre(end, e) - centre(start, s), (e - s) * R
            if (square := abs(D) ** 2 - aside**2) >= 0.0:
                theta = float(np.angle(D) - np.arctan2(aside, np.sqrt(square)))
                line = Arc(0, float(np.sqrt(square)))
                paths.append((arc(s, theta - first), line, arc(e, last - theta)))
            if e == s and abs(D) <= 4.0 * R:
                a = float(np.arccos(abs(D) / (4.0 * R)))
                for lean in (a, -a):
                    theta = float(np.angle(D)) + lean + 0.5 * s * np.pi
                    then = theta - 2.0 * lean + np.pi
                    turns = arc(s, theta - first), arc(-s, then - theta), arc(s, last - then)
                    paths.append(turns)
    return min(paths, key=length_of)


def length_of(path: tuple[Arc, ...]) -> float:
    """Length of a path [m]."""
    return sum(arc.length_m for arc in path)


def poses_at(start: Array, path: Sequence[Arc], radius_m: float, s: Array) -> Array:
    """Poses (N, 3) [m, m, rad] at distances s (N,) [m] along a path."""
    north, east, psi = (np.full(len(s), value) for value in start)
    for side, length in path:
        run = np.clip(s, 0.0, length)
        turn, s = side * run / radius_m, s - length
        chord, course = run * np.sinc(turn / TURN), psi + 0.5 * turn  # sinc: sin(turn / 2) / ...
        north, east = north + chord * np.cos(course), east + chord * np.sin(course)
        psi = psi + turn
    return np.column_stack([north, east, psi])
