"""Waters and tracks as files: degrees and metres say the same, and GPX is read by any parser."""

import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pymap3d
import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.models.recording.recording import Recording
from seatrial.runner.commands.next import GPX, positions, read_waters, write_files

ORIGIN = (63.4, 10.4)
RING = [[0.0, 0.0], [200.0, 0.0], [200.0, 100.0], [0.0, 100.0], [0.0, 0.0]]  # x east, y north
HOLE = [[80.0, 40.0], [90.0, 40.0], [90.0, 50.0], [80.0, 40.0]]


def _file(folder: Path, rings: object) -> Path:
    path = folder / "area.geojson"
    feature = {"type": "Feature", "properties": {}, "geometry": {"type": "Polygon"}}
    feature["geometry"] = {"type": "Polygon", "coordinates": rings}
    path.write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    return path


def test_degrees_and_metres_are_the_same_waters(tmp_path: Path) -> None:
    metres = read_waters(_file(tmp_path, [RING, HOLE]), None, 2.0)
    assert metres.area == ((0.0, 0.0), (0.0, 200.0), (100.0, 200.0), (100.0, 0.0))
    assert len(metres.obstacles) == 1
    degrees = [positions(np.array(ring)[:, ::-1], ORIGIN).tolist() for ring in (RING, HOLE)]
    again = read_waters(_file(tmp_path, degrees), ORIGIN, 2.0)
    assert np.array(again.area) == pytest.approx(np.array(metres.area), abs=0.01)


@pytest.mark.parametrize("text", ["{", "[]", '{"type": "Point", "coordinates": [0, 0]}'])
def test_what_is_no_area_is_refused_in_one_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "area.geojson"
    path.write_text(text)
    with pytest.raises(ConfigurationError, match="polygon") as refused:
        read_waters(path, None, 0.0)
    assert "\n" not in str(refused.value)
    with pytest.raises(ConfigurationError, match="cannot be read"):
        read_waters(tmp_path / "none.geojson", None, 0.0)


def test_files_hold_the_track(tmp_path: Path) -> None:
    t = np.arange(0.0, 60.0, 0.5)
    eta = np.column_stack([t, 0.5 * t, 0.0 * t])
    zero = np.zeros((len(t), 3))
    motion = Recording(("surge", "sway", "yaw"), t, eta, zero, zero, zero, zero)
    files = write_files(tmp_path, {}, motion, None, ORIGIN)
    assert {file.suffix for file in files} == {".yaml", ".geojson", ".svg", ".gpx"}
    root = ElementTree.parse(tmp_path / "track.gpx").getroot()
    points = root.findall(f".//{{{GPX}}}trkpt")
    lat, lon = (
        np.array([float(point.attrib[name]) for point in points]) for name in ("lat", "lon")
    )
    north, east, _ = pymap3d.geodetic2ned(lat, lon, 0.0, *ORIGIN, 0.0)
    assert np.column_stack([north, east]) == pytest.approx(eta[::2, :2], abs=0.02)
    line = json.loads((tmp_path / "track.geojson").read_text())
    assert line["coordinates"][0] == pytest.approx([10.4, 63.4])
