"""A harbour, the outline of a hull, and their distances.

Between two samples the pose changes linearly. No point of a hull then moves further than
m = |dp| + R |dpsi|, with the distance R of its farthest corner from the origin of the body. So the
distance d between hull and obstacles is at least (d_0 + d_1 - m) / 2 everywhere between them: the
bound of conservative advancement, Mirtich (1996), Impulse-based dynamic simulation of rigid body
systems, section 2.3.
"""

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.planning.geojson import Shape, in_metres, shapes_of
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import in_ned

if TYPE_CHECKING:
    import shapely
else:
    import lazy_loader

    shapely = lazy_loader.load("shapely")  # slow to import

UNITS, SIDES = ("lengths", "metres", None), ("port", "starboard")
SHOULDER = 0.7  # of the length from the stern: where the sides end and the bow begins
FLAT = 1e-9  # share of its area by which a polygon may fall short of its convex hull
TINY, NOWHERE = 1e-12, 1e6  # [m]


class Harbour(NamedTuple):
    """A harbour in metres, NED."""

    area: Array  # corners of a rectangle around all, (4, 2)
    land: "shapely.Geometry"
    parts: tuple[Array, ...]  # convex ones of the land, (n, 2) each
    start: "shapely.Geometry"  # polygon of positions at the start, or the only one
    headings: Array  # at the start, from and to [rad]
    face: Array  # (3,) middle of the berth, on the face of the quay, and the heading in the berth
    away: Array  # (3,) unit vector from the quay to the water, and 0


def harbour_of(text: str, length_m: float) -> Harbour:
    """The harbour of a GeoJSON text for a vessel of a length [m]; raises ConfigurationError.

    It is a FeatureCollection of features with a `role`: `obstacle` (the default; polygons), `water`
    (a polygon: all around it is land), `start` (a polygon or point, with `headings_deg`) and `quay`
    (a line along its face as the vessel heads, with its `side`). Coordinates (east, north) are in
    `units`, `lengths` or `metres`, or in degrees about `origin`; docs/docking.md says more.
    """
    content, shapes = shapes_of(text)

    def of(role: str) -> list[Shape]:
        return [one for one in shapes if one[0].get("role", "obstacle") == role]

    if got := [role for role in ("start", "quay") if len(of(role)) != 1]:
        raise ConfigurationError(f"got {len(of(got[0]))} features with role {got[0]}, expected one")
    [(beginning, start)], [(berth, quay)] = of("start"), of("quay")
    along, units, side = shapely.get_coordinates(quay), content.get("units"), berth.get("side")
    if len(along) != 2 or side not in SIDES or units not in UNITS:
        raise ConfigurationError(
            f"got a quay of {len(along)} points with side {side!r} and units {units!r}, expected "
            f"two points, one of {SIDES} and one of {UNITS}"
        )
    origin = content.get("origin", along[0]) if units is None else None
    placed = partial(in_metres, origin=origin, scale=length_m if units == "lengths" else 1.0)
    solid, water = ([placed(shape) for _, shape in of(role)] for role in ("obstacle", "water"))
    start, quay = placed(start), placed(quay)
    edges = shapely.total_bounds([*water, *solid, start, quay])
    area = shapely.box(*(edges + length_m * np.array([-1.0, -1.0, 1.0, 1.0])))
    around = [shapely.difference(area, shapely.union_all(water))] if water else []
    land = shapely.union_all([*solid, *around])
    first, last = shapely.get_coordinates(quay)
    heading = float(np.arctan2(*(last - first)[::-1]))
    away = in_ned(np.array([0.0, -1.0 if side == "starboard" else 1.0]), heading)
    return Harbour(
        shapely.get_coordinates(area)[:-1], land, convex_parts(land), start,
        np.radians(beginning.get("headings_deg", (-180.0, 180.0))),
        np.array([*(0.5 * (first + last)), heading]), np.array([*away, 0.0]),
    )  # fmt: skip


def hull_outline(length_m: float, beam_m: float) -> Array:
    """Corners of a convex hull seen from above, (5, 2) [m], body axes, bow to +x."""
    bow, shoulder, side = 0.5 * length_m, (SHOULDER - 0.5) * length_m, 0.5 * beam_m
    return np.array([[bow, 0.0], [shoulder, side], [-bow, side], [-bow, -side], [shoulder, -side]])


def placed(hull: Array, poses: Array) -> Array:
    """Corners of a hull (m, 2) at poses (N, 3) [m, m, rad], NED, shape (N, m, 2)."""
    turned = in_ned(np.broadcast_to(hull, (len(poses), *hull.shape)), poses[:, 2, None])
    return np.asarray(turned + poses[:, None, :2])


def distances(land: "shapely.Geometry", hull: Array, poses: Array) -> Array:
    """Distance [m] of a hull (m, 2) at poses (N, 3) from the land, (N,); 0 where they meet."""
    return np.asarray(shapely.distance(shapely.polygons(placed(hull, poses)), land))


def clearances(
    land: "shapely.Geometry", hull: Array, poses: Array, tolerance_m: float
) -> tuple[Array, Array]:
    """Distances along a motion that is linear between its poses, by conservative advancement.

    An interval is halved while it may hold a contact or the smallest distance, until it is known
    within the tolerance. The hull (m, 2) is in body axes [m], at poses (N, 3) [m, m, rad] with
    unwrapped headings. Returns poses of the motion, (M, 3), and the distances [m] at them, (M,).
    """
    reach = float(np.max(np.hypot(*hull.T)))
    d = distances(land, hull, poses)
    while True:
        moved = np.hypot(*np.diff(poses[:, :2], axis=0).T) + reach * np.abs(np.diff(poses[:, 2]))
        least = 0.5 * (d[:-1] + d[1:] - moved)
        unsure = (least <= 0.0) & (np.maximum(d[:-1], d[1:]) > 0.0) & (moved > tolerance_m)
        unsure |= least < np.min(d) - tolerance_m
        if not np.any(unsure):
            return poses, d
        between, after = 0.5 * (poses[:-1] + poses[1:])[unsure], np.flatnonzero(unsure) + 1
        poses = np.insert(poses, after, between, axis=0)
        d = np.insert(d, after, distances(land, hull, between))


def contacts(distance: Array) -> int:
    """How many times a distance (N,) becomes zero; a motion that begins there counts."""
    return int(np.sum(np.diff(distance <= 0.0, prepend=False) & (distance <= 0.0)))


def convex_parts(land: "shapely.Geometry") -> tuple[Array, ...]:
    """Convex polygons (n, 2) with the area of a geometry: united triangles of its polygons."""
    done: list[shapely.Geometry] = []
    for polygon in shapely.get_parts(land):
        left = [*shapely.get_parts(shapely.constrained_delaunay_triangles(polygon))]
        while left:
            piece = left.pop()
            for i, other in enumerate(left):
                both = shapely.convex_hull(shapely.union(piece, other))
                if both.area <= (1.0 + FLAT) * (piece.area + other.area):
                    left[i] = both
                    break
            else:
                done.append(piece)
    return tuple(shapely.get_coordinates(shapely.normalize(one))[:-1] for one in done)


def separating_lines(hull: Array, poses: Array, obstacles: Sequence[Array], count: int) -> Array:
    """Lines (n, max n' q) between a hull and the nearest obstacles, nearest first.

    The axis n with the largest separation s = min n'(p + R(psi) v) - max n' q between two convex
    polygons is a normal of an edge, or lies along the difference of two corners. It is their
    distance, or if they overlap minus the depth; the lines bound a convex free space. Martinsen et
    al. (2019); Ericson (2005), section 5.2.1.

    The hull (m, 2) is in body axes [m], at poses (N, 3) [m, m, rad]; obstacles are (n, 2) each [m].
    Returns shape (N, count, 3); rows without an obstacle are (0, 0, -NOWHERE).
    """
    turned, at = placed(hull, poses), np.arange(len(poses))
    corners = np.swapaxes(turned, 0, 1)
    lines = [np.tile((0.0, 0.0, -NOWHERE, np.inf), (len(poses), 1))] * count
    for polygon in obstacles:
        between = (turned[:, :, None] - polygon).reshape(len(poses), -1, 2)
        same = np.broadcast_to(polygon, (len(poses), *polygon.shape))
        sides = [np.roll(ring, -1, axis=1) - ring for ring in (turned, same)]
        normals = np.concatenate(sides, axis=1)[:, :, ::-1] * (-1.0, 1.0)
        north, east = np.moveaxis(np.concatenate([between, normals, -normals], axis=1), 2, 0)
        size = np.hypot(north, east)
        north, east = (axis / np.maximum(size, TINY) for axis in (north, east))
        far = np.max([north * q[0] + east * q[1] for q in polygon], axis=0)
        near = np.min([north * p[:, :1] + east * p[:, 1:] for p in corners], axis=0)
        apart = np.where(size > TINY, near - far, -np.inf)  # else corners that touch
        best = at, np.argmax(apart, axis=1)
        lines.append(np.column_stack([north[best], east[best], far[best], apart[best]]))
    every = np.stack(lines, axis=1)  # (n, max n' q, separation)
    nearest = np.argsort(every[:, :, 3], axis=1, kind="stable")[:, :count]
    return np.asarray(np.take_along_axis(every, nearest[:, :, None], axis=1)[:, :, :3])
