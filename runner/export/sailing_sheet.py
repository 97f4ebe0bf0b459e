"""What is sailed by `seatrial next` as files: the waters read, tracks and figures written.

Positions are in metres, x east and y north, or with an origin in longitude and latitude.
"""

import csv
import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.planning.lattice import Corners, Waters
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel.basis import Array

if TYPE_CHECKING:
    import pymap3d
    import shapely
else:
    import lazy_loader

    pymap3d = lazy_loader.load("pymap3d")
    shapely = lazy_loader.load("shapely")

Origin = tuple[float, float] | None  # latitude, longitude [deg]
GPX = "http://www.topografix.com/GPX/1/1"
ELLIPSOID_M = 0.0  # height of the origin


def read_waters(path: Path, origin: Origin, clearance_m: float) -> Waters:
    """The area of a GeoJSON file: its first polygon; its holes and the others are obstacles.

    Raises ConfigurationError for a file without a polygon, or positions that are no positions.
    """
    try:
        shape = shapely.from_geojson(path.read_text(encoding="utf-8"))
        # of collections of polygons, and of those of several parts
        parts = [part for part in shapely.get_parts(shapely.get_parts(shape))
                 if part.geom_type == "Polygon"]  # fmt: skip
        rings = [
            [_metres(corner, origin) for corner in ring.coords[:-1]]
            for part in parts
            for ring in (part.exterior, *part.interiors)
        ]
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, shapely.GEOSException) as error:
        reason = " ".join(str(error).split())
        raise ConfigurationError(f"{path}: got no GeoJSON ({reason}), expected polygons") from error
    if not rings:
        raise ConfigurationError(f"{path}: got no polygon, expected one of the area")
    return Waters(tuple(rings[0]), tuple(map(tuple, rings[1:])), clearance_m)


def _metres(position: Sequence[float], origin: Origin) -> tuple[float, ...]:
    """(north, east) [m] of a position."""
    x, y = float(position[0]), float(position[1])
    if origin is None:
        return y, x
    if abs(y) > 90.0 or abs(x) > 360.0:
        raise ValueError(f"position {x:g}, {y:g}, expected longitude and latitude")
    north, east, _ = pymap3d.geodetic2ned(y, x, ELLIPSOID_M, *origin, ELLIPSOID_M)
    return float(north), float(east)


def positions(track: Array, origin: Origin) -> Array:
    """(x, y) of a track (N, 2) of (north, east) [m]: metres, or longitude and latitude [deg]."""
    if origin is None:
        return track[:, ::-1]
    down = np.zeros(len(track))
    lat, lon, _ = pymap3d.ned2geodetic(track[:, 0], track[:, 1], down, *origin, ELLIPSOID_M)
    return np.column_stack([lon, lat])


def write_files(
    folder: Path, motion: Recording, marks: Sequence[tuple[float, str]], waters: Waters | None,
    origin: Origin,
) -> list[Path]:  # fmt: skip
    """Write the expected track: CSV, GeoJSON, a figure, and GPX if there is an origin.

    Args:
        folder: where.
        motion: the expected motion.
        marks: begin [s] and name of each manoeuvre.
        waters: its limits, if there are any.
        origin: of the positions.

    Returns:
        The files.
    """
    step = max(1, round(1.0 / motion.period_s))
    xy = np.round(positions(motion.eta[::step, :2], origin), 2 if origin is None else 7).tolist()
    feature = {"type": "LineString", "coordinates": xy}
    features = [{"type": "Feature", "properties": {"name": "expected track"}, "geometry": feature}]
    for begin, name in marks:
        geometry = {"type": "Point", "coordinates": xy[min(round(begin), len(xy) - 1)]}
        properties = {"name": name, "seconds": begin}
        features.append({"type": "Feature", "properties": properties, "geometry": geometry})
    files = [folder / "track.geojson", folder / "track.csv", folder / "track.svg"]
    collection = {"type": "FeatureCollection", "features": features}
    files[0].write_text(json.dumps(collection), encoding="utf-8")
    acting = motion.tau if motion.inputs is None else motion.inputs
    names = [f"tau_{dof}" for dof in motion.dofs] if motion.inputs is None else motion.input_names
    with files[1].open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["t", "north", "east", "psi", *names])
        writer.writerows(np.round(np.column_stack([motion.t, motion.eta, acting]), 6).tolist())
    _draw(files[2], motion, marks, waters)
    if origin is not None:
        files.append(folder / "track.gpx")
        files[3].write_bytes(gpx(xy, [(xy[min(round(b), len(xy) - 1)], n) for b, n in marks]))
    return files


def gpx(track: Sequence[Sequence[float]], marks: Sequence[tuple[Sequence[float], str]]) -> bytes:
    """GPX 1.1 of a track and way-points of (longitude, latitude) [deg]."""
    root = ElementTree.Element("gpx", xmlns=GPX, version="1.1", creator="seatrial")
    for (lon, lat), name in marks:
        point = ElementTree.SubElement(root, "wpt", lat=str(lat), lon=str(lon))
        ElementTree.SubElement(point, "name").text = name
    line = ElementTree.SubElement(root, "trk")
    ElementTree.SubElement(line, "name").text = "expected track"
    segment = ElementTree.SubElement(line, "trkseg")
    for lon, lat in track:
        ElementTree.SubElement(segment, "trkpt", lat=str(lat), lon=str(lon))
    return bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True))


def _draw(
    file: Path, motion: Recording, marks: Sequence[tuple[float, str]], waters: Waters | None
) -> None:
    """Draw the track in its waters, north up."""
    from matplotlib.figure import Figure  # slow to import

    figure = Figure(figsize=(6.0, 6.0), layout="constrained")
    axes = figure.add_subplot()
    rings: list[Corners] = [] if waters is None else [waters.area, *waters.obstacles]
    for ring in rings:
        axes.fill(*np.array(ring)[:, ::-1].T, fill=ring is not rings[0], facecolor="0.85",
                  edgecolor="0.4")  # fmt: skip
    axes.plot(motion.eta[:, 1], motion.eta[:, 0])
    for i, (begin, name) in enumerate(marks, 1):
        k = min(int(np.searchsorted(motion.t - motion.t[0], begin)), len(motion) - 1)
        axes.plot(motion.eta[k, 1], motion.eta[k, 0], "o", label=f"{i}: {name}")
        axes.annotate(str(i), (motion.eta[k, 1], motion.eta[k, 0]))
    axes.set(xlabel="east [m]", ylabel="north [m]", aspect="equal")
    if marks:
        axes.legend(fontsize="x-small")
    figure.savefig(file)
