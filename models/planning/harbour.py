"""Shapes of GeoJSON files, a harbour of them, the outline of a hull, and their distances.

Between two samples the pose changes linearly. No point of a hull then moves further than
m = |dp| + R |dpsi|, with the distance R of its farthest corner from the origin of the body. So the
distance d between hull and obstacles is at least (d_0 + d_1 - m) / 2 everywhere between them: the
bound of conservative advancement, Mirtich (1996), Impulse-based dynamic simulation of rigid body
systems, section 2.3.
"""

import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import in_ned

if TYPE_CHECKING:
    import pymap3d
    import shapely
else:
    import lazy_loader

    pymap3d = lazy_loader.load("pymap3d")  # slow to import
    shapely = lazy_loader.load("shapely")

UNITS, SIDES = ("lengths", "metres", None), ("port", "starboard")
SHOULDER = 0.7  # of the length from the stern: where the sides end and the bow begins
FLAT = 1e-9  # share of its area by which a polygon may fall short of its convex hull
TINY = 1e-12  # [m]
TRIES = 1000  # positions that are drawn for a start
Shape = tuple[Mapping[str, Any], "shapely.Geometry"]  # with its properties


def shapes_of(text: str) -> tuple[Mapping[str, Any], list[Shape]]:
    """The content of a GeoJSON text and its shapes; raises ConfigurationError, in one line."""
    try:
        content = json.loads(text)
        nodes = [(one.get("properties") or {}, one.get("geometry", one))
                 for one in content.get("features", [content])]  # fmt: skip
        shapes = [(own, shapely.from_geojson(json.dumps(node))) for own, node in nodes]
        if wrong := [shape for _, shape in shapes if not shape.is_valid]:
            raise ValueError(shapely.is_valid_reason(wrong[0]))
    except (ValueError, TypeError, AttributeError, shapely.GEOSException) as error:
        reason = " ".join(str(error).split())
        raise ConfigurationError(f"got {reason}, expected polygons of GeoJSON") from error
    return content, shapes


def in_metres(
    shape: "shapely.Geometry", origin: Sequence[float] | None, scale: float = 1.0
) -> "shapely.Geometry":
    """A shape in (north, east) [m] from one in (east, north), or in (longitude, latitude) [deg].

    Degrees are on WGS 84, as in RFC 7946, about an `origin` (longitude, latitude).
    """

    def north_east(xy: Array) -> Array:
        if origin is None:
            return np.asarray(scale * xy[:, ::-1])
        if np.any(np.abs(xy) > (360.0, 90.0)):
            raise ConfigurationError(f"got {xy[0].tolist()}, expected longitude and latitude [deg]")
        return np.column_stack(pymap3d.geodetic2ned(*xy.T[::-1], 0.0, *origin[1::-1], 0.0)[:2])

    return shapely.transform(shape, north_east)


class Harbour(NamedTuple):
    """A harbour in metres, NED."""

    area: Array  # corners of a rectangle around all, (4, 2)
    land: "shapely.Geometry"
    parts: tuple[Array, ...]  # convex ones of the land, (n, 2) each
    start: "shapely.Geometry"  # polygon of positions at the start, or the only one
    headings: Array  # at the start, from and to [rad]
    face: Array  # (3,) middle of the berth, on the face of the quay, and the heading in the berth
    away: Array  # (3,) unit vector from the quay to the water, and 0

    def start_pose(self, free: "shapely.Geometry", rng: np.random.Generator) -> Array:
        """A pose (3,) drawn evenly over the start and its headings, at a free position.

        Raises ConfigurationError if there is none.
        """
        low, high = np.reshape(self.start.bounds, (2, 2))
        heading = float(rng.uniform(*self.headings))
        drawn = rng.uniform(low, high, (TRIES, 2))
        inside = shapely.intersection(self.start, free)
        good = drawn[shapely.covers(inside, shapely.points(drawn))]
        if not len(good):
            raise ConfigurationError("it does not contain the start with room to turn")
        return np.array([*good[0], heading])


def harbour_of(text: str, length_m: float) -> Harbour:
    """The harbour of a GeoJSON text for a vessel of a length [m]; raises ConfigurationError.

    It is a FeatureCollection, each feature with a `role` in its properties: `obstacle` (the
    default; polygons), `water` (a polygon: all around it is land), `start` (a polygon or point,
    with `headings_deg`) and `quay` (a line along its face in the heading of the berthed vessel,
    which lies at the middle, with the `side` of the quay). The member `units` says what
    coordinates (east, north) are: `lengths` of the vessel or `metres`. Without it they are degrees
    about the longitude and latitude in `origin`, by default the quay's first point.
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

    def placed(shape: "shapely.Geometry") -> "shapely.Geometry":
        return in_metres(shape, origin, length_m if units == "lengths" else 1.0)

    solid, water = ([placed(shape) for _, shape in of(role)] for role in ("obstacle", "water"))
    start, quay = placed(start), placed(quay)
    south, west, north, east = shapely.total_bounds([*water, *solid, start, quay])
    area = shapely.box(south - length_m, west - length_m, north + length_m, east + length_m)
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
    return np.asarray(
        shapely.distance(shapely.polygons(placed(hull, poses)), land), dtype=np.float64
    )


def clearances(
    land: "shapely.Geometry", hull: Array, poses: Array, tolerance_m: float
) -> tuple[Array, Array]:
    """Distances along a motion that is linear between its poses, by conservative advancement.

    An interval is halved while it may hold a contact or the smallest distance, until it is
    known within the tolerance.

    Args:
        land: the obstacles.
        hull: corners in body axes [m], (m, 2).
        poses: unwrapped headings [m, m, rad], (N, 3).
        tolerance_m: of contacts and of the smallest distance [m].

    Returns:
        Times, in samples, and distances [m] at them, (M,) each with M >= N.
    """
    reach = float(np.max(np.hypot(*hull.T)))
    t, d = np.arange(len(poses), dtype=np.float64), distances(land, hull, poses)
    while True:
        at = interpolated(poses, t)
        moved = np.hypot(*np.diff(at[:, :2], axis=0).T) + reach * np.abs(np.diff(at[:, 2]))
        least = 0.5 * (d[:-1] + d[1:] - moved)
        unsure = (least <= 0.0) & (np.maximum(d[:-1], d[1:]) > 0.0) & (moved > tolerance_m)
        unsure |= least < np.min(d) - tolerance_m
        if not np.any(unsure):
            return t, d
        between = 0.5 * (t[:-1] + t[1:])[unsure]
        d = np.concatenate([d, distances(land, hull, interpolated(poses, between))])
        t = np.concatenate([t, between])
        order = np.argsort(t, kind="stable")
        t, d = t[order], d[order]


def interpolated(poses: Array, t: Array) -> Array:
    """Poses (M, 3) at times (M,), in samples, of a motion that is linear between poses (N, 3)."""
    return np.column_stack([np.interp(t, np.arange(len(poses)), column) for column in poses.T])


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
    Returns shape (N, count, 3); rows without an obstacle are (0, 0, -inf).
    """
    turned = placed(hull, poses)
    lines = np.zeros((len(poses), max(count, len(obstacles)), 4))  # (n, max n' q, separation)
    lines[:, :, 2:] = -np.inf, np.inf
    for k, polygon in enumerate(obstacles):
        between = (turned[:, :, None] - polygon).reshape(len(poses), -1, 2)
        same = np.broadcast_to(polygon, (len(poses), *polygon.shape))
        sides = [np.roll(corners, -1, axis=1) - corners for corners in (turned, same)]
        normals = np.concatenate(sides, axis=1)[:, :, ::-1] * (-1.0, 1.0)
        axes = np.concatenate([between, normals, -normals], axis=1)
        size = np.hypot(axes[:, :, 0], axes[:, :, 1])
        axes /= np.maximum(size, TINY)[:, :, None]
        far = np.max(axes @ polygon.T, axis=2)
        apart = np.min(axes @ turned.swapaxes(1, 2), axis=2) - far
        apart[size < TINY] = -np.inf  # corners that touch
        best = np.argmax(apart, axis=1)[:, None]
        values = np.concatenate([axes, far[:, :, None], apart[:, :, None]], axis=2)
        lines[:, k] = np.take_along_axis(values, best[:, :, None], axis=1)[:, 0]
    nearest = np.argsort(lines[:, :, 3], axis=1, kind="stable")[:, :count]
    return np.asarray(np.take_along_axis(lines, nearest[:, :, None], axis=1)[:, :, :3])
