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

from seatrial.models.compiled import kernel
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

UNITS, SIDES = ("lengths", "metres"), ("port", "starboard")
SHOULDER = 0.7  # of the length from the stern: where the sides end and the bow begins
FLAT = 1e-9  # share of its area by which a polygon may fall short of its convex hull
ROUNDS = 60  # halvings of a sampling interval, at most: to less than rounding
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
    start: "shapely.Geometry"  # polygon of positions at the start, or the only one
    headings: Array  # at the start, from and to [rad]
    face: Array  # (2,) middle of the berth, on the face of the quay
    heading: float  # of the berthed vessel [rad]
    side: float  # of the quay seen from the vessel: 1 starboard, -1 port

    @property
    def away(self) -> Array:
        """Unit vector from the quay to the water, (2,)."""
        return in_ned(np.array([0.0, -self.side]), self.heading)

    def berth(self, distance_m: float) -> Array:
        """The pose along the quay, so far from its face, (3,) [m, m, rad]."""
        return np.array([*(self.face + distance_m * self.away), self.heading])

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
    beginning, start = _only(shapes, "start", "Polygon", "Point")
    berth, quay = _only(shapes, "quay", "LineString")
    along, units, side = shapely.get_coordinates(quay), content.get("units"), berth.get("side")
    if side not in SIDES or len(along) != 2:
        raise ConfigurationError(f"quay: got side {side!r}, expected two points and {SIDES}")
    if units not in (None, *UNITS):
        raise ConfigurationError(f"units: got {units!r}, expected one of {UNITS} or none")
    origin = content.get("origin", along[0]) if units is None else None

    def placed(shape: "shapely.Geometry") -> "shapely.Geometry":
        return in_metres(shape, origin, length_m if units == "lengths" else 1.0)

    water = [placed(shape) for own, shape in shapes if own.get("role") == "water"]
    solid = [placed(shape) for own, shape in shapes if own.get("role", "obstacle") == "obstacle"]
    start, quay = placed(start), placed(quay)
    south, west, north, east = shapely.total_bounds([*water, *solid, start, quay])
    area = shapely.box(south - length_m, west - length_m, north + length_m, east + length_m)
    around = [shapely.difference(area, shapely.union_all(water))] if water else []
    headings = np.radians(beginning.get("headings_deg", (-180.0, 180.0)))
    first, last = shapely.get_coordinates(quay)
    heading = float(np.arctan2(*(last - first)[::-1]))
    return Harbour(shapely.get_coordinates(area)[:-1], shapely.union_all([*solid, *around]), start,
                   headings, 0.5 * (first + last), heading,
                   1.0 if side == "starboard" else -1.0)  # fmt: skip


def _only(shapes: Sequence[Shape], role: str, *kinds: str) -> Shape:
    """The only feature of a role; raises ConfigurationError."""
    own = [one for one in shapes if one[0].get("role") == role and one[1].geom_type in kinds]
    if len(own) != 1:
        raise ConfigurationError(
            f"got {len(own)} features with role {role}, expected one {' or '.join(kinds)}"
        )
    return own[0]


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
    for _ in range(ROUNDS):
        at = interpolated(poses, t)
        moved = np.hypot(*np.diff(at[:, :2], axis=0).T) + reach * np.abs(np.diff(at[:, 2]))
        least = 0.5 * (d[:-1] + d[1:] - moved)
        unsure = (least <= 0.0) & (np.maximum(d[:-1], d[1:]) > 0.0) & (moved > tolerance_m)
        unsure |= least < np.min(d) - tolerance_m
        if not np.any(unsure):
            break
        between = 0.5 * (t[:-1] + t[1:])[unsure]
        order = np.argsort(np.concatenate([t, between]), kind="stable")
        d = np.concatenate([d, distances(land, hull, interpolated(poses, between))])[order]
        t = np.concatenate([t, between])[order]
    return t, d


def interpolated(poses: Array, t: Array) -> Array:
    """Poses (M, 3) at times (M,), in samples, of a motion that is linear between poses (N, 3)."""
    return np.column_stack([np.interp(t, np.arange(len(poses)), column) for column in poses.T])


def contacts(distance: Array) -> int:
    """How many times a distance (N,) becomes zero; a motion that begins there counts."""
    touching = np.concatenate([[False], distance <= 0.0])
    return int(np.sum(touching[1:] & ~touching[:-1]))


def convex_parts(land: "shapely.Geometry") -> tuple[Array, ...]:
    """Convex polygons (n, 2) with the area of a geometry.

    A polygon that is not convex is triangulated, and neighbours are united while that is convex.
    """
    done: list[shapely.Geometry] = []
    for polygon in shapely.get_parts(land):
        triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(polygon))
        left = [polygon] if _convex(polygon) else list(triangles)
        while left:
            piece = left.pop()
            joined = [(i, shapely.union(piece, other)) for i, other in enumerate(left)
                      if shapely.touches(piece, other)]  # fmt: skip
            match = next(((i, both) for i, both in joined if _convex(both)), None)
            if match is None:
                done.append(piece)
            else:
                left[match[0]] = shapely.convex_hull(match[1])
    return tuple(shapely.get_coordinates(shapely.normalize(one))[:-1] for one in done)


def _convex(shape: "shapely.Geometry") -> bool:
    """Whether a shape is one convex polygon."""
    missing = float(shapely.convex_hull(shape).area) - float(shape.area)
    return shape.geom_type == "Polygon" and missing <= FLAT * float(shape.area)


@kernel
def _separate(axes: Array, hulls: Array, polygon: Array, best: Array) -> None:
    """Write (n, max n' q, separation) (N, 4) of the best of axes (N, A, 2) for hulls (N, m, 2)."""
    for k in range(len(axes)):
        best[k, 3] = -np.inf
        for north, east in axes[k]:
            size, near, far = np.sqrt(north * north + east * east), np.inf, -np.inf
            for p in hulls[k]:
                near = min(near, north * p[0] + east * p[1])
            for q in polygon:
                far = max(far, north * q[0] + east * q[1])
            if size > TINY and (near - far) / size > best[k, 3]:  # else corners that touch
                best[k, 0], best[k, 1] = north / size, east / size
                best[k, 2], best[k, 3] = far / size, (near - far) / size


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
        sides = np.roll(polygon, -1, axis=0) - polygon
        same = np.broadcast_to(sides, (len(poses), *sides.shape))
        sides = np.concatenate([np.roll(turned, -1, axis=1) - turned, same], axis=1)
        normals = sides[:, :, ::-1] * (-1.0, 1.0)
        _separate(
            np.concatenate([between, normals, -normals], axis=1), turned, polygon, lines[:, k]
        )
    nearest = np.argsort(lines[:, :, 3], axis=1, kind="stable")[:, :count]
    return np.asarray(np.take_along_axis(lines, nearest[:, :, None], axis=1)[:, :, :3])
