"""A harbour as polygons, the outline of a hull, and the distance between them along a motion.

Between two samples the pose changes linearly. No point of a hull then moves further than
m = |dp| + R |dpsi|, with the distance R of its farthest corner from the origin of the body. So the
distance d between hull and obstacles is at least (d_0 + d_1 - m) / 2 everywhere between them: the
bound of conservative advancement, Mirtich (1996), Impulse-based dynamic simulation of rigid body
systems, section 2.3.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.planning.lattice import Corners
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import in_ned

if TYPE_CHECKING:
    import shapely
else:
    import lazy_loader

    shapely = lazy_loader.load("shapely")  # slow to import

SHOULDER = 0.7  # of the length from the stern: where the sides end and the bow begins
FLAT = 1e-9  # share of its area by which a polygon may fall short of its convex hull
ROUNDS = 60  # halvings of a sampling interval, at most: to less than rounding


@dataclass(frozen=True)
class HarbourChart:
    """Polygons of a harbour, corners (north, east), in metres or in lengths of the vessel.

    `water`, if given, is the water: all around it is land. The vessel starts at a point of the
    polygon `start` (or at its only point) with a heading between two. `quay` is a line along the
    face of the quay in the heading of the berthed vessel, at the middle of which it lies, with the
    quay on its `side`.
    """

    units: Literal["metres", "lengths"]
    obstacles: tuple[Corners, ...]
    start: Corners
    headings_deg: tuple[float, float]
    quay: Corners
    side: Literal["port", "starboard"]
    water: Corners | None = None

    def scaled(self, length_m: float) -> "Harbour":
        """The harbour in metres, for a vessel of a length [m]."""
        scale = length_m if self.units == "lengths" else 1.0
        water = () if self.water is None else (scale * np.array(self.water),)
        solid = tuple(scale * np.array(corners) for corners in self.obstacles)
        start, quay = scale * np.array(self.start), scale * np.array(self.quay)
        every = np.vstack([*solid, *water, start, quay])
        low, high = np.min(every, axis=0) - length_m, np.max(every, axis=0) + length_m
        area = np.array(
            [[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]]
        )
        around = [shapely.difference(shapely.Polygon(area), shapely.Polygon(one)) for one in water]
        land = shapely.union_all([*(shapely.Polygon(corners) for corners in solid), *around])
        along = quay[1] - quay[0]
        heading = float(np.arctan2(along[1], along[0]))
        return Harbour(area, land, start, np.radians(self.headings_deg), np.mean(quay, axis=0),
                       heading, 1.0 if self.side == "starboard" else -1.0)  # fmt: skip


class Harbour(NamedTuple):
    """A harbour in metres, NED; polygons are arrays (n, 2)."""

    area: Array  # rectangle around all
    land: "shapely.Geometry"
    start: Array
    headings: Array  # (2,) [rad]
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

    def width(self) -> float:
        """Distance [m] from the face of the quay to what is opposite; infinite for open water."""
        reach = float(np.ptp(self.area))
        ray = shapely.LineString([self.face + 1e-6 * reach * self.away,
                                  self.face + reach * self.away])  # fmt: skip
        met = shapely.intersection(ray, self.land)
        return float("inf") if met.is_empty else float(shapely.Point(*self.face).distance(met))


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
    parts: list[Array] = []
    for polygon in shapely.get_parts(land):
        pieces = [polygon] if _convex(polygon) else _united(polygon)
        parts += [shapely.get_coordinates(shapely.normalize(one))[:-1] for one in pieces]
    return tuple(parts)


def _convex(shape: "shapely.Geometry") -> bool:
    """Whether a shape is one convex polygon."""
    missing = float(shapely.convex_hull(shape).area) - float(shape.area)
    return shape.geom_type == "Polygon" and missing <= FLAT * float(shape.area)


def _united(polygon: "shapely.Geometry") -> "list[shapely.Geometry]":
    """The triangles of a polygon, united greedily to larger convex polygons."""
    done: list[shapely.Geometry] = []
    left = list(shapely.get_parts(shapely.constrained_delaunay_triangles(polygon)))
    while left:
        piece = left.pop()
        joined = [(i, shapely.union(piece, other)) for i, other in enumerate(left)
                  if shapely.touches(piece, other)]  # fmt: skip
        match = next(((i, both) for i, both in joined if _convex(both)), None)
        if match is None:
            done.append(piece)
        else:
            left[match[0]] = shapely.convex_hull(match[1])
    return done


def start_pose(
    harbour: Harbour, free: "shapely.Geometry", rng: np.random.Generator, tries: int = 1000
) -> Array:
    """A pose drawn evenly over the start and its headings, at a free position, (3,).

    Raises ConfigurationError if there is none.
    """
    corners = harbour.start
    shape = shapely.Polygon(corners) if len(corners) > 2 else shapely.Point(*corners[0])
    inside = shapely.intersection(shape, free)
    heading = float(rng.uniform(*harbour.headings))
    drawn = rng.uniform(np.min(corners, axis=0), np.max(corners, axis=0), (tries, 2))
    good = drawn[shapely.covers(inside, shapely.points(drawn))]
    if not len(good):
        raise ConfigurationError("it does not contain the start with room to turn")
    return np.array([*good[0], heading])
