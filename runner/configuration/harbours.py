"""Harbours: GeoJSON files of polygons, whose content becomes the option `charts` of a docking.

A file is a FeatureCollection, each feature with a `role` in its properties: `obstacle` (the
default; polygons), `water` (a polygon: all around it is land), `start` (a polygon or point, with
`headings_deg`) and `quay` (a line in the heading of the berthed vessel, with the `side` of the
quay). The member `units` says what coordinates (east, north) are: `lengths` of the vessel or
`metres`. Without it they are longitude and latitude [deg] on WGS 84, as in RFC 7946, and `origin`,
longitude and latitude too, becomes the origin in NED; by default the quay's first point.
"""

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from seatrial.models.errors import ConfigurationError
from seatrial.runner.configuration.invocation import meant
from seatrial.runner.configuration.search_path import HARBOURS, harbour_file

if TYPE_CHECKING:  # what is slow to import
    import numpy as np
    import pymap3d
    import shapely
else:
    import lazy_loader

    np = lazy_loader.load("numpy")
    pymap3d = lazy_loader.load("pymap3d")
    shapely = lazy_loader.load("shapely")

UNITS = ("lengths", "metres")
SIDES = ("port", "starboard")
Corners = list[list[float]]


def with_harbours(node: object) -> object:
    """The options of an evaluation with the content of its harbours; raises ConfigurationError."""
    if not isinstance(node, Mapping) or "harbour" not in node or "charts" in node:
        return node
    names = node["harbour"] if isinstance(node["harbour"], list | tuple) else [node["harbour"]]
    return {**node, "harbour": [*names], "charts": {str(name): read_chart(name) for name in names}}


def read_chart(name: object) -> dict[str, object]:
    """The options of a chart, corners (north, east); raises ConfigurationError."""
    path, where = harbour_file(name), f"evaluation.harbour: {name}"
    known = sorted(file.stem for file in HARBOURS.glob("*.geojson"))
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        features = content["features"]
        shapes = [(one.get("properties") or {}, _shape(one["geometry"])) for one in features]
    except OSError as error:
        hint = meant(str(name), known)
        raise ConfigurationError(
            f"{where}: {hint or f'expected a GeoJSON file or one of {known}; '}{error.strerror}"
        ) from error
    except (ValueError, KeyError, TypeError, AttributeError, shapely.GEOSException) as error:
        reason = " ".join(str(error).split())
        raise ConfigurationError(
            f"{where}: got {reason}, expected a FeatureCollection of GeoJSON"
        ) from error
    units = content.get("units")
    if units is not None and units not in UNITS:
        raise ConfigurationError(f"{where}: units: got {units!r}, expected one of {UNITS} or none")
    start = _only(shapes, "start", ("Polygon", "Point"), where)
    quay = _only(shapes, "quay", ("LineString",), where)
    waters = [shape for own, shape in shapes if own.get("role") == "water"]
    solid = [part for own, shape in shapes if own.get("role", "obstacle") == "obstacle"
             for part in shapely.get_parts(shape)]  # fmt: skip
    solid += [shapely.Polygon(hole) for water in waters for hole in water.interiors]
    origin = content.get("origin", shapely.get_coordinates(quay[1])[0])

    def corners(shape: "shapely.Geometry") -> Corners:
        return _corners(shape, origin if units is None else None)

    if (side := quay[0].get("side")) not in SIDES or len(corners(quay[1])) != 2:
        raise ConfigurationError(
            f"{where}: quay: got side {side!r}, expected two points and {SIDES}"
        )
    return {
        "units": units or "metres",
        "obstacles": [corners(part) for part in solid],
        "start": corners(start[1]),
        "headings_deg": start[0].get("headings_deg", [-180.0, 180.0]),
        "quay": corners(quay[1]),
        "side": side,
        "water": corners(waters[0]) if waters else None,
    }


def _shape(geometry: Mapping[str, Any]) -> "shapely.Geometry":
    """The geometry of a feature; raises ValueError for a polygon that crosses itself."""
    shape = shapely.from_geojson(json.dumps(geometry))
    if not shapely.is_valid(shape):
        raise ValueError(shapely.is_valid_reason(shape))
    return shape


def _only(
    shapes: "list[tuple[dict[str, Any], shapely.Geometry]]", role: str, kinds: tuple[str, ...],
    where: str,
) -> "tuple[dict[str, Any], shapely.Geometry]":  # fmt: skip
    """The only feature of a role, with its properties; raises ConfigurationError."""
    own = [one for one in shapes if one[0].get("role") == role and one[1].geom_type in kinds]
    if len(own) != 1:
        raise ConfigurationError(
            f"{where}: got {len(own)} features with role {role}, expected one {' or '.join(kinds)}"
        )
    return own[0]


def _corners(shape: "shapely.Geometry", origin: object) -> Corners:
    """The corners (north, east) of a shape without holes; `origin` is that of degrees, or None."""
    outer = shape.exterior if shape.geom_type == "Polygon" else shape
    coordinates = shapely.get_coordinates(outer)
    east, north = coordinates[:-1].T if shape.geom_type == "Polygon" else coordinates.T
    if origin is not None:
        longitude, latitude = np.asarray(origin, dtype=np.float64)
        north, east, _ = pymap3d.geodetic2ned(north, east, 0.0, latitude, longitude, 0.0)
    result: Corners = np.column_stack([np.atleast_1d(north), np.atleast_1d(east)]).tolist()
    return result
