"""What is sailed by `seatrial next` as files: the waters read, tracks and figures written.

Positions are in metres, x east and y north, or with an origin in longitude and latitude.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.planning.harbour import in_metres, shapes_of
from seatrial.models.planning.planner import Waters
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel.basis import Array

if TYPE_CHECKING:
    import pandas as pd
    import pymap3d
    import shapely
else:
    import lazy_loader

    pd = lazy_loader.load("pandas")  # slow to import
    pymap3d = lazy_loader.load("pymap3d")
    shapely = lazy_loader.load("shapely")

Origin = tuple[float, float] | None  # latitude, longitude [deg]
GPX = "http://www.topografix.com/GPX/1/1"


def read_waters(path: Path, origin: Origin, clearance_m: float) -> Waters:
    """The area of a GeoJSON file: its first polygon; its holes and the others are obstacles.

    Raises ConfigurationError for a file without a polygon, or positions that are no positions.
    """
    try:
        shapes = shapes_of(path.read_text(encoding="utf-8"))[1]
        about = None if origin is None else origin[::-1]
        parts = [part for _, shape in shapes for part in shapely.get_parts(in_metres(shape, about))]
    except OSError as error:
        raise ConfigurationError(f"{path}: cannot be read: {error.strerror}") from error
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from error
    rings = [tuple(ring.coords[:-1]) for part in parts if part.geom_type == "Polygon"
             for ring in (part.exterior, *part.interiors)]  # fmt: skip
    if not rings:
        raise ConfigurationError(f"{path}: got no polygon, expected one of the area")
    return Waters(rings[0], rings[1:], clearance_m)


def positions(track: Array, origin: Origin) -> Array:
    """(x, y) of a track (N, 2) of (north, east) [m]: metres, or longitude and latitude [deg]."""
    if origin is None:
        return np.round(track[:, ::-1], 2)
    return np.round(np.column_stack(pymap3d.ned2geodetic(*track.T, 0.0, *origin, 0.0)[1::-1]), 7)


def write_files(
    folder: Path, motion: Recording, marks: Sequence[tuple[float, str]], waters: Waters | None,
    origin: Origin,
) -> list[Path]:  # fmt: skip
    """Write the expected track: CSV, GeoJSON, a figure, and GPX if there is an origin.

    `marks` are the begin [s] and the name of each manoeuvre. Returns the files.
    """
    files = [folder / f"track.{kind}" for kind in ("geojson", "csv", "svg", "gpx")]
    at = np.searchsorted(motion.t - motion.t[0], [begin for begin, _ in marks])
    at = np.minimum(at.astype(np.int64), len(motion) - 1)
    track = motion.eta[:: max(1, round(1.0 / motion.period_s)), :2]
    line, points = (positions(each, origin).tolist() for each in (track, motion.eta[at, :2]))
    shapes: list[tuple[str, Any, Any]] = [("LineString", line, {"name": "expected track"})]
    shapes += [("Point", point, {"name": name, "seconds": begin})
               for point, (begin, name) in zip(points, marks, strict=True)]  # fmt: skip
    features = [
        {"type": "Feature", "properties": own, "geometry": {"type": kind, "coordinates": xy}}
        for kind, xy, own in shapes
    ]
    files[0].write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    acting = motion.tau if motion.inputs is None else motion.inputs
    names = [f"tau_{dof}" for dof in motion.dofs] if motion.inputs is None else motion.input_names
    table = np.round(np.column_stack([motion.t, motion.eta, acting]), 6)
    pd.DataFrame(table, columns=["t", "north", "east", "psi", *names]).to_csv(files[1], index=False)
    _draw(files[2], motion, [name for _, name in marks], motion.eta[at, :2], waters)
    if origin is None:
        return files[:3]
    root = ElementTree.Element("gpx", xmlns=GPX, version="1.1", creator="seatrial")
    for (lon, lat), (_, name) in zip(points, marks, strict=True):
        point = ElementTree.SubElement(root, "wpt", lat=str(lat), lon=str(lon))
        ElementTree.SubElement(point, "name").text = name
    segment = ElementTree.SubElement(ElementTree.SubElement(root, "trk"), "trkseg")
    for lon, lat in line:
        ElementTree.SubElement(segment, "trkpt", lat=str(lat), lon=str(lon))
    ElementTree.ElementTree(root).write(files[3], encoding="utf-8", xml_declaration=True)
    return files


def _draw(
    file: Path, motion: Recording, names: Sequence[str], points: Array, waters: Waters | None
) -> None:
    """Draw the track and the beginnings of manoeuvres in the waters, north up."""
    from matplotlib.figure import Figure  # slow to import

    figure = Figure(figsize=(6.0, 6.0), layout="constrained")
    axes = figure.add_subplot(xlabel="east [m]", ylabel="north [m]", aspect="equal")
    for name, ring in ({} if waters is None else waters.named).items():
        axes.fill(*np.array(ring)[:, ::-1].T, fill=name != "area", color="0.7")
    axes.plot(motion.eta[:, 1], motion.eta[:, 0])
    for i, (name, (north, east)) in enumerate(zip(names, points, strict=True), 1):
        axes.plot(east, north, "o", label=f"{i}: {name}")
        axes.annotate(str(i), (east, north))
    axes.legend(fontsize="x-small")
    figure.savefig(file)
