"""Restricted waters: an area, polygonal obstacles in it, and a clearance from both.

Positions are (north, east) [m]. The clearance is the distance of the vessel's reference point:
half its length and a margin. Rounded corners are approximated by polygons outside the arcs, so a
path that counts as clear is never closer than the clearance.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError
from seatrial.models.ranges import NotNegative, check_ranges
from seatrial.models.vessel.basis import Array

if TYPE_CHECKING:
    import shapely
else:
    import lazy_loader

    shapely = lazy_loader.load("shapely")  # slow to import

Corners = tuple[tuple[float, ...], ...]
QUARTER = 16  # sides of the polygon in a quarter of a circle
OUTSIDE = 1.0 / np.cos(np.pi / (4.0 * QUARTER))  # relative radius of a polygon around the circle


@dataclass(frozen=True)
class Waters:
    """An area and the obstacles in it, each a polygon of (north, east) [m]."""

    area: Corners
    obstacles: tuple[Corners, ...]
    clearance_m: NotNegative

    def __post_init__(self) -> None:
        check_ranges(self)
        for name, corners in self.named.items():
            if len(corners) < 3 or any(len(corner) != 2 for corner in corners):
                raise ConfigurationError(
                    f"{name}: expected at least three corners, each (north, east)"
                )
            if not _polygon(corners).is_valid:
                raise ConfigurationError(f"{name}: the polygon crosses or touches itself")

    @property
    def named(self) -> dict[str, Corners]:
        """Every polygon by the name of its option."""
        return {"area": self.area} | {
            f"obstacles[{i}]": corners for i, corners in enumerate(self.obstacles)
        }

    def free(self, margin_m: float = 0.0, without: Sequence[int] = ()) -> "shapely.Geometry":
        """The positions with the clearance and a margin [m], as a shapely geometry.

        The obstacles with an index in `without` are ignored.
        """
        distance = (self.clearance_m + margin_m) * OUTSIDE
        area = shapely.buffer(_polygon(self.area), -distance, quad_segs=QUARTER)
        obstacles = [corners for i, corners in enumerate(self.obstacles) if i not in without]
        occupied = [
            shapely.buffer(_polygon(corners), distance, quad_segs=QUARTER) for corners in obstacles
        ]
        free = shapely.difference(area, shapely.union_all(occupied)) if occupied else area
        shapely.prepare(free)
        return free

    @cached_property
    def bounds(self) -> tuple[float, float, float, float]:
        """Limits of the area [m]: (least north, largest north, least east, largest east)."""
        points = np.array(self.area)
        (n0, e0), (n1, e1) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
        return n0, n1, e0, e1

    def in_the_way(self, point: Sequence[float]) -> str | None:
        """Why a vessel cannot be at a point (north, east) [m], in words; None if it can."""
        at = shapely.Point(point[0], point[1])
        if not _polygon(self.area).contains(at):
            return "it lies outside area"
        for i, corners in enumerate(self.obstacles):
            if _polygon(corners).intersects(at):
                return f"it lies inside obstacles[{i}]"
        if self.free().covers(at):
            return None
        gaps = {f"obstacles[{i}]": _polygon(c).distance(at) for i, c in enumerate(self.obstacles)}
        gaps["the edge of area"] = _polygon(self.area).exterior.distance(at)
        nearest = min(gaps, key=lambda name: gaps[name])
        return (
            f"it is {gaps[nearest]:.3g} m from {nearest}, expected at least the clearance_m of "
            f"{self.clearance_m:g}"
        )

    def distance(self, points: Array) -> Array:
        """Distance [m], (N,), of points (N, 2) to the nearest obstacle or edge; 0 if not free."""
        area = _polygon(self.area)
        at = shapely.points(points)
        occupied = shapely.union_all([_polygon(corners) for corners in self.obstacles])
        edge = np.where(shapely.covers(area, at), shapely.distance(area.exterior, at), 0.0)
        obstacle = shapely.distance(occupied, at) if self.obstacles else edge
        return np.asarray(np.minimum(edge, obstacle))

    def separated_by(self, start: Sequence[float], goal: Sequence[float]) -> str | None:
        """The obstacles that separate two free points [m], in words; None if they are connected.

        A smallest set of at most two obstacles is named if there is one.
        """
        numbers = range(len(self.obstacles))
        if self._connected(start, goal, ()):
            return None
        for size in (1, 2):
            for removed in combinations(numbers, size):
                if self._connected(start, goal, removed):
                    return " and ".join(f"obstacles[{i}]" for i in removed)
        if self._connected(start, goal, tuple(numbers)):
            return "the obstacles"
        return "the edge of area"

    def _connected(
        self, start: Sequence[float], goal: Sequence[float], without: Sequence[int]
    ) -> bool:
        points = [shapely.Point(at[0], at[1]) for at in (start, goal)]
        free = self.free(without=without)
        return any(all(part.covers(at) for at in points) for part in shapely.get_parts(free))


def _polygon(corners: Corners) -> "shapely.Polygon":
    return shapely.Polygon(corners)


def simplified(path: Array, tolerance_m: float) -> Array:
    """The corners (n, 2) of a path (N, 2) [m] simplified within a tolerance [m]."""
    if not np.any(path != path[0]):
        return path[:1]
    return np.asarray(shapely.get_coordinates(shapely.LineString(path).simplify(tolerance_m)))


def inside(free: "shapely.Geometry", points: Array) -> NDArray[np.bool_]:
    """Whether points (..., 2) [m] lie in a free geometry, shape (...)."""
    return np.asarray(shapely.intersects_xy(free, points[..., 0], points[..., 1]))


def clear(free: "shapely.Geometry", path: Array, origins: Array) -> NDArray[np.bool_]:
    """Whether a path (n, 2) from each of the origins (M, 2) stays in a free geometry, (M,)."""
    if len(path) == 1:
        return inside(free, origins + path[0])
    lines = shapely.linestrings(origins[:, None, :] + path)
    return np.asarray(shapely.covers(free, lines))
