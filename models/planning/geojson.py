"""Shapes of GeoJSON files, in metres: RFC 7946, and files whose coordinates are metres."""

import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.vessel.basis import Array

if TYPE_CHECKING:
    import pymap3d
    import shapely
else:
    import lazy_loader

    pymap3d = lazy_loader.load("pymap3d")  # slow to import
    shapely = lazy_loader.load("shapely")

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
