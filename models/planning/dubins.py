"""Shortest paths of a vessel that turns on circles of one radius and sails ahead only.

Dubins (1957), On curves of minimal length with a constraint on average curvature; the six words by
Shkel and Lumelsky (2001), Classification of the Dubins set, eqs. (5) to (12). Positions are (north,
east) [m], a heading grows to starboard, so S is a turn to starboard and P one to port.
"""

from typing import NamedTuple

import numpy as np

from seatrial.models.vessel.basis import Array

TURN = 2.0 * np.pi


class Arc(NamedTuple):
    """A turn to starboard (side 1), to port (-1), or a straight line (0)."""

    side: int
    length_m: float


def dubins(start: Array, end: Array, radius_m: float) -> tuple[Arc, ...]:
    """The shortest path between two poses (3,) [m, m, rad], of three arcs."""
    paths = [
        tuple(Arc(side, radius_m * n) for side, n in zip(sides, lengths, strict=True))
        for sides, lengths in _words(*_normalised(start, end, radius_m))
    ]
    return min(paths, key=length_of)


def length_of(path: tuple[Arc, ...]) -> float:
    """Length of a path [m]."""
    return sum(arc.length_m for arc in path)


def poses_along(start: Array, path: tuple[Arc, ...], radius_m: float, step_m: float) -> Array:
    """Poses (N, 3) [m, m, rad] along a path, the start first, at most `step_m` apart."""
    poses = [np.asarray(start, dtype=np.float64)[None]]
    for side, length in path:
        s = np.linspace(0.0, length, max(2, int(np.ceil(length / step_m)) + 1))[1:]
        x, y, psi = poses[-1][-1]
        if side:
            turned = psi + side * s / radius_m
            north = x + side * radius_m * (np.sin(turned) - np.sin(psi))
            east = y - side * radius_m * (np.cos(turned) - np.cos(psi))
        else:
            turned, north, east = np.full_like(s, psi), x + s * np.cos(psi), y + s * np.sin(psi)
        poses.append(np.column_stack([north, east, turned]))
    return np.vstack(poses)


def _normalised(start: Array, end: Array, radius_m: float) -> tuple[float, float, float]:
    """Distance over the radius, and both headings from the line between the positions."""
    north, east = (end[:2] - start[:2]) / radius_m
    line = np.arctan2(east, north)
    return float(np.hypot(north, east)), float(start[2] - line), float(end[2] - line)


def _words(d: float, a: float, b: float) -> list[tuple[tuple[int, ...], tuple[float, ...]]]:
    """Sides and lengths over the radius of the words that exist."""
    found = []
    for side in (1, -1):  # the mirror image of a word has the headings negated
        alpha, beta = side * a, side * b
        sa, sb, ca, cb = np.sin(alpha), np.sin(beta), np.cos(alpha), np.cos(beta)
        cab = np.cos(alpha - beta)
        square = 2.0 + d**2 - 2.0 * cab + 2.0 * d * (sa - sb)  # same sides: SLS
        line = np.arctan2(cb - ca, d + sa - sb)
        found.append(((side, 0, side), (line - alpha, np.sqrt(max(square, 0.0)), beta - line)))
        square = d**2 - 2.0 + 2.0 * cab + 2.0 * d * (sa + sb)  # other sides: SLP
        if square >= 0.0:
            p = float(np.sqrt(square))
            line = np.arctan2(-ca - cb, d + sa + sb) - np.arctan2(-2.0, p)
            found.append(((side, 0, -side), (line - alpha, p, line - beta)))
        cosine = (6.0 - d**2 + 2.0 * cab + 2.0 * d * (sb - sa)) / 8.0  # three turns: SPS
        if abs(cosine) <= 1.0:
            p = TURN - float(np.arccos(cosine))
            t = 0.5 * p - alpha + np.arctan2(cb - ca, d + sa - sb)
            found.append(((side, -side, side), (t, p, beta - alpha - t + p)))
    return [
        (
            sides,
            tuple(float(n if s == 0 else n % TURN) for s, n in zip(sides, lengths, strict=True)),
        )
        for sides, lengths in found
    ]
