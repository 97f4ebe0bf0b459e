"""Docking: the same start for every competitor, a timetable clear of the land, and bad input."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.docking import Docking
from seatrial.models.planning.harbour import clearances, harbour_of
from seatrial.runner.configuration.fingerprint import fingerprint
from seatrial.runner.configuration.search_path import HARBOURS
from seatrial.runner.trials.checks import check
from seatrial.runner.trials.closed_loop import Streams, drawn
from tests.trials import composed

QUIET = ("evaluation=docking", "identifier=none")
QUAY = {"type": "LineString", "coordinates": [[20.0, -5.0], [20.0, 5.0]]}


def docking(*overrides: str, seed: int = 0) -> Docking:
    trial = composed(*QUIET, *overrides, f"seed={seed}")
    evaluation = drawn(trial, Streams(seed)).evaluation
    assert isinstance(evaluation, Docking)
    return evaluation


def ring(*corners: list[float]) -> dict[str, object]:
    return {"type": "Polygon", "coordinates": [[*corners, corners[0]]]}


def collection(units: str | None = "metres", **shapes: object) -> dict[str, object]:
    """A quay in the east with the start in the west; shapes replace those of their role."""
    roles: dict[str, object] = {
        "obstacle": ring([20.0, -60.0], [30.0, -60.0], [30.0, 60.0], [20.0, 60.0]),
        "start": ring([-20.0, -9.0], [-10.0, -9.0], [-10.0, 9.0], [-20.0, 9.0]),
        "quay": QUAY,
    } | shapes
    features = [
        {"type": "Feature", "geometry": shape, "properties": {"role": role, "side": "starboard"}}
        for role, shape in roles.items()
    ]
    units_of = {} if units is None else {"units": units}
    return {"type": "FeatureCollection", "features": features, **units_of}


def written(folder: Path, content: dict[str, object]) -> str:
    path = folder / "harbour.geojson"
    path.write_text(json.dumps(content))
    return f"evaluation.harbour={path}"


@pytest.mark.parametrize("vessel", ["cybership2", "supply_vessel"])
def test_the_timetable_is_clear_of_the_land_and_ends_in_the_berth(vessel: str) -> None:
    for seed, name in enumerate(sorted(path.stem for path in HARBOURS.glob("*.geojson"))):
        mission = docking(f"vessel={vessel}", f"evaluation.harbour={name}", seed=seed)
        poses, length = mission.poses, mission.vessel.scales.length_m
        hull, land = mission.hull, mission.harbours[name].land
        _, clearance = clearances(land, hull, poses, 1e-3 * length)
        assert np.min(clearance) == pytest.approx(mission.gap * length, rel=1e-6)
        rest = round(mission.rests[1] / mission.reference_filter.bandwidth_rad_s / mission.period_s)
        assert np.all(poses[-rest:] == poses[-1])
        step = np.max(np.abs(np.diff(poses, axis=0)), axis=0)
        most = np.array(mission.speed)[[0, 0, 2]] * mission.period_s
        assert np.all(step <= most * [1.0, 1.0, 1.25])  # an arc is not all of its primitive
        assert mission.duration_s <= replace(mission, poses=None).length().seconds


def test_every_competitor_starts_at_the_same_place_and_seeds_differ() -> None:
    first = docking("controller=pid_ff", seed=3)
    second = docking("controller=mpc_integral", "disturbance=wind", "plant.scale=0.7", seed=3)
    np.testing.assert_array_equal(first.poses, second.poses)
    starts = {tuple(docking(seed=seed).start) for seed in range(4)}
    assert len(starts) == 4


def test_starts_in_lengths_do_not_depend_on_the_vessel() -> None:
    """Position over length and heading, for vessels of 1.3 m and 73 m."""
    small, large = docking("vessel=cybership2", seed=5), docking("vessel=supply_vessel", seed=5)
    assert {*small.harbour} == {*large.harbour}
    np.testing.assert_allclose(
        small.start[:2] / small.vessel.scales.length_m,
        large.start[:2] / large.vessel.scales.length_m,
    )
    assert small.start[2] == pytest.approx(large.start[2])


def test_longitude_and_latitude_are_metres_about_the_origin() -> None:
    """By pymap3d from the same corners in metres, at 63 deg north."""
    pymap3d = pytest.importorskip("pymap3d")
    origin = (10.4, 63.43)

    def degrees(shape: dict[str, object]) -> dict[str, object]:
        lines = shape["coordinates"] if shape["type"] == "Polygon" else [shape["coordinates"]]
        turned = [
            [pymap3d.enu2geodetic(*at, 0.0, origin[1], origin[0], 0.0)[1::-1] for at in line]
            for line in lines  # type: ignore[attr-defined]
        ]
        return {**shape, "coordinates": turned if shape["type"] == "Polygon" else turned[0]}

    metres = collection()
    geodetic = {**collection(None), "origin": origin}
    features = geodetic["features"]
    assert isinstance(features, list)
    for feature in features:
        feature["geometry"] = degrees(feature["geometry"])
    first, second = (harbour_of(json.dumps(content), 5.0) for content in (metres, geodetic))
    # height above the ellipsoid: the plane of the metres rises by less than 1 mm in 60 m
    for name in ("land", "start"):
        one, other = getattr(first, name), getattr(second, name)
        assert one.hausdorff_distance(other) < 1e-3
    np.testing.assert_allclose(second.face, first.face, atol=1e-3)
    np.testing.assert_allclose(second.away, first.away, atol=1e-5)


def test_the_fingerprint_depends_on_the_content_of_a_harbour(tmp_path: Path) -> None:
    node = {"evaluation": {"harbour": [str(tmp_path / "harbour.geojson"), "basin"]}}
    written(tmp_path, collection())
    before = fingerprint(node, {}, "")
    assert before == fingerprint(node, {}, "")
    written(tmp_path, collection(units="lengths"))
    assert before != fingerprint(node, {}, "")


BAD = {
    "start": (
        {"obstacle": ring([-30.0, -60.0], [30.0, -60.0], [30.0, -59.0], [-30.0, -59.0]),
         "start": ring([-20.0, -59.9], [-10.0, -59.9], [-10.0, -59.1], [-20.0, -59.1])},
        (), "does not contain the start",
    ),
    "target": (
        {"water": ring([-60.0, -60.0], [20.0, -60.0], [20.0, 1.0], [-60.0, 1.0]),
         "obstacle": ring([-60.0, -60.0], [-59.0, -60.0], [-59.0, -59.0], [-60.0, -59.0])},
        (), "does not contain the target",
    ),
    "basin": (
        {"water": ring([18.5, -60.0], [20.0, -60.0], [20.0, 60.0], [18.5, 60.0])},
        (), "wider than the basin",
    ),
    "speed": ({}, ("evaluation.speed=[50.0,1.0,1.0]",), "full thrust"),
    "planar": ({}, ("vessel=surge_linear", "excitation=constant_velocity"), "surge, sway, yaw"),
    "steered": (
        {}, ("vessel=kvlcc2", "excitation=heading_changes", "controller=autopilot"), "forces",
    ),
    "option": ({}, ("evaluation.harbour=basn",), "or some of"),
    "role": ({"quay": ring([0.0, 0.0], [1.0, 0.0], [1.0, 1.0])}, (), "quay of 4 points"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line_before_anything_runs(case: str, tmp_path: Path) -> None:
    shapes, overrides, message = BAD[case]
    harbour = written(tmp_path, collection(**shapes))
    with pytest.raises(ConfigurationError, match=message) as raised:
        check(composed(*QUIET, harbour, *overrides))
    assert "\n" not in str(raised.value)
    assert str(raised.value).startswith("evaluation")
