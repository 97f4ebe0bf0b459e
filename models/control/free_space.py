"""Lines between a hull and the obstacles around it, which bound a convex free space.

The axis n with the largest separation s = min n'(p + R(psi) v) - max n' q between two convex
polygons is a normal of an edge, or lies along the difference of two corners. It is their distance,
or if they overlap minus the depth. Martinsen et al. (2019); Ericson (2005), section 5.2.1.
"""

import numpy as np

from seatrial.models.compiled import kernel, lean_kernel
from seatrial.models.vessel.basis import Array, Codes


@lean_kernel
def _separation(north: float, east: float, hull: Array, polygon: Array, best: Array) -> None:
    """Write (n, max n' q, separation) of an axis to `best` if it separates more."""
    length = np.sqrt(north * north + east * east)
    if length < 1e-12:
        return
    north, east = north / length, east / length
    near, far = np.inf, -np.inf
    for i in range(hull.shape[0]):
        near = min(near, north * hull[i, 0] + east * hull[i, 1])
    for i in range(polygon.shape[0]):
        far = max(far, north * polygon[i, 0] + east * polygon[i, 1])
    if near - far > best[3]:
        best[0], best[1], best[2], best[3] = north, east, far, near - far


@lean_kernel
def _line(hull: Array, polygon: Array, best: Array) -> None:
    """Write (n, max n' q, separation) of the best axis between two convex polygons."""
    best[3] = -np.inf
    for i in range(polygon.shape[0]):
        for j in range(hull.shape[0]):
            _separation(hull[j, 0] - polygon[i, 0], hull[j, 1] - polygon[i, 1], hull, polygon, best)
    for corners in (hull, polygon):
        for i in range(corners.shape[0]):
            j = (i + 1) % corners.shape[0]
            ahead, aside = corners[j, 0] - corners[i, 0], corners[j, 1] - corners[i, 1]
            _separation(-aside, ahead, hull, polygon, best)
            _separation(aside, -ahead, hull, polygon, best)


@kernel
def separating_lines(hull: Array, poses: Array, corners: Array, first: Codes, lines: Array) -> None:
    """Write the lines (n, max n' q) of the nearest obstacles at every pose, nearest first.

    Args:
        hull: convex polygon in body axes [m], shape (m, 2).
        poses: north, east [m] and heading [rad], shape (N, 3).
        corners: those of all obstacles, convex polygons, one after the other [m], shape (M, 2).
        first: where each begins, and M; shape (n_obstacles + 1,).
        lines: result, shape (N, n_lines, 3); rows without an obstacle are (0, 0, -inf).
    """
    turned, best, distances = np.zeros_like(hull), np.zeros(4), np.zeros(lines.shape[1])
    for k in range(poses.shape[0]):
        c, s = np.cos(poses[k, 2]), np.sin(poses[k, 2])
        for i in range(hull.shape[0]):
            turned[i, 0] = poses[k, 0] + c * hull[i, 0] - s * hull[i, 1]
            turned[i, 1] = poses[k, 1] + s * hull[i, 0] + c * hull[i, 1]
        for j in range(lines.shape[1]):
            distances[j] = np.inf
            lines[k, j, 0], lines[k, j, 1], lines[k, j, 2] = 0.0, 0.0, -np.inf
        for obstacle in range(first.shape[0] - 1):
            _line(turned, corners[first[obstacle] : first[obstacle + 1]], best)
            j = lines.shape[1]
            while j > 0 and best[3] < distances[j - 1]:
                j -= 1
                if j + 1 < lines.shape[1]:
                    distances[j + 1] = distances[j]
                    for i in range(3):
                        lines[k, j + 1, i] = lines[k, j, i]
            if j < lines.shape[1]:
                distances[j] = best[3]
                for i in range(3):
                    lines[k, j, i] = best[i]
