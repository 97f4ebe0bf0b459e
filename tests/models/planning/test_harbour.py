"""Harbours: contacts between samples, convex parts, and what a change of units leaves as it is."""

import json

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from seatrial.models.planning.harbour import (
    clearances,
    contacts,
    convex_parts,
    distances,
    harbour_of,
    hull_outline,
    placed,
    separating_lines,
)
from seatrial.models.vessel.kinematics import in_ned

HULL = hull_outline(1.0, 0.3)
CORNER = ((2.0, -2.0), (2.0, 2.0), (-3.0, 2.0), (-3.0, 3.0), (3.0, 3.0), (3.0, -2.0))


def chart(units: str, start: shapely.Geometry, quay: shapely.Geometry, side: str,
          **others: shapely.Geometry) -> str:  # fmt: skip
    """The GeoJSON text of a harbour of shapes in (north, east)."""
    shapes = {"start": start, "quay": quay, **others}
    features = [
        {"properties": {"role": role, "side": side},
         "geometry": json.loads(shapely.to_geojson(shapely.transform(one, lambda x: x[:, ::-1])))}
        for role, one in shapes.items()
    ]  # fmt: skip
    return json.dumps({"units": units, "features": features})


def wandering(seed: int) -> np.ndarray:
    """A motion among islands with steps of up to half a length and half a radian."""
    rng = np.random.default_rng(seed)
    return np.cumsum(rng.uniform(-0.5, 0.5, (40, 3)), axis=0)


def islands(seed: int) -> shapely.Geometry:
    rng = np.random.default_rng([seed, 1])
    centres, sizes = rng.uniform(-3.0, 3.0, (6, 2)), rng.uniform(0.02, 0.5, 6)
    around = zip(centres, sizes, strict=True)
    return shapely.union_all([shapely.Point(*at).buffer(size, 2) for at, size in around])


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 10**6))
def test_contacts_and_clearance_agree_with_dense_sampling(seed: int) -> None:
    """At 200 poses between two samples; contacts deeper than the tolerance are found."""
    poses, land, tolerance = wandering(seed)[:12], islands(seed), 1e-3
    at, found = clearances(land, HULL, poses, tolerance)
    t = np.linspace(0.0, 11.0, 11 * 200 + 1)
    often = np.column_stack([np.interp(t, np.arange(12), column) for column in poses.T])
    dense, apart = distances(land, HULL, often), 1.2 / 200  # at most, of a corner in a step
    assert np.min(found) <= np.min(dense) + tolerance
    assert np.min(found) >= np.min(dense) - apart
    assert {*map(tuple, poses)} <= {*map(tuple, at)}
    if np.min(dense) > apart:
        assert contacts(found) == 0
    inner = shapely.buffer(land, -tolerance)
    if np.min(distances(inner, HULL, often)) <= 0.0:
        assert contacts(found) > 0


def test_a_contact_between_two_samples_is_found() -> None:
    """A hull that jumps over a thin wall: both samples are clear of it."""
    wall = shapely.box(-0.01, -5.0, 0.01, 5.0)
    poses = np.array([[-2.0, 0.0, 0.0], [2.0, 0.0, 0.0], [-2.0, 0.0, 0.0]])
    assert np.all(distances(wall, HULL, poses) > 0.0)
    assert contacts(clearances(wall, HULL, poses, 1e-3)[1]) == 2
    assert contacts(clearances(wall, HULL, poses[:1], 1e-3)[1]) == 0


def test_a_turn_between_two_samples_meets_what_its_ends_do_not() -> None:
    """The bow of a hull that turns by 180 deg sweeps over a pole abeam, at half the turn."""
    pole = shapely.Point(0.0, 0.4).buffer(0.01)
    poses = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, np.pi]])
    at, found = clearances(pole, HULL, poses, 1e-3)
    assert contacts(found) == 1
    assert at[found <= 0.0, 2].mean() == pytest.approx(0.5 * np.pi, abs=0.06)


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 10**6))
def test_convex_parts_are_convex_and_cover_the_land_once(seed: int) -> None:
    """Of unions of polygons and of land around water, a ring."""
    ring = shapely.difference(shapely.box(-6.0, -6.0, 6.0, 6.0), shapely.box(-5.0, -5.0, 5.0, 5.0))
    land = shapely.union_all([islands(seed), shapely.Polygon(CORNER), ring])
    parts = [shapely.Polygon(part) for part in convex_parts(land)]
    for part in parts:
        assert part.convex_hull.area == pytest.approx(part.area, rel=1e-6)
    assert sum(part.area for part in parts) == pytest.approx(land.area, rel=1e-6)
    assert shapely.union_all(parts).symmetric_difference(land).area < 1e-6 * land.area


def test_a_corner_takes_two_parts_and_a_convex_obstacle_one() -> None:
    assert len(convex_parts(shapely.Polygon(CORNER))) == 2
    assert len(convex_parts(shapely.MultiPoint([(0, 0), (1, 0), (2, 2), (0, 1)]).convex_hull)) == 1


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 10**6), st.floats(-3.0, 3.0), st.floats(0.1, 100.0))
def test_clearance_scales_and_does_not_depend_on_the_frame(
    seed: int, turn: float, scale: float
) -> None:
    poses, land = wandering(seed)[:15], islands(seed)
    moved = np.column_stack([scale * in_ned(poses[:, :2], turn) + [7.0, -5.0], poses[:, 2] + turn])
    other = shapely.transform(land, lambda xy: scale * in_ned(xy, turn) + [7.0, -5.0])
    _, first = clearances(land, HULL, poses, 1e-3)
    _, second = clearances(other, scale * HULL, moved, 1e-3 * scale)
    assert np.min(second) / scale == pytest.approx(np.min(first), abs=1e-3)
    assert (contacts(first) > 0) == (contacts(second) > 0) or np.min(first) < 1e-3


def test_a_chart_in_lengths_is_scaled_by_the_vessel() -> None:
    start = shapely.Polygon([(-3.0, -2.5), (-3.0, -1.0), (-1.5, -1.0)])
    quay = shapely.LineString([(0.4, 2.0), (1.4, 2.0)])
    text = chart("lengths", start, quay, "starboard", obstacle=shapely.Polygon(CORNER))
    small, large = harbour_of(text, 1.0), harbour_of(text, 70.0)
    np.testing.assert_allclose(large.face, small.face * [70.0, 70.0, 1.0])
    assert large.land.area == pytest.approx(70.0**2 * small.land.area)
    # on the side of the water: to the west of a quay that is to starboard of a northern heading
    np.testing.assert_allclose(small.face + 0.2 * small.away, [0.9, 1.8, 0.0], atol=1e-12)


def test_land_is_all_around_water() -> None:
    water, quay = shapely.box(0.0, 0.0, 10.0, 6.0), shapely.LineString([(3.0, 0.0), (5.0, 0.0)])
    pond = harbour_of(chart("metres", shapely.Point(1.0, 1.0), quay, "port", water=water), 2.0)
    inside, outside = ([4.0, 3.0, 0.5], [4.0, 6.5, 0.5])
    found = distances(pond.land, HULL, np.array([inside, outside]))
    assert found[0] > 0.0 == found[1]


def test_the_outline_has_the_length_and_the_beam() -> None:
    np.testing.assert_allclose(np.ptp(hull_outline(73.2, 16.0), axis=0), [73.2, 16.0])
    quarter = placed(HULL, np.array([[1.0, 2.0, 0.5 * np.pi]]))[0]
    np.testing.assert_allclose(np.max(quarter, axis=0), [1.15, 2.5])  # the bow is to the east


SHIP = np.array([[2.5, 0.0], [1.0, 1.4], [-2.5, 1.4], [-2.5, -1.4], [1.0, -1.4]])


def polygon(rng: np.random.Generator) -> np.ndarray:
    corners = rng.normal(size=(7, 2)) * rng.uniform(0.5, 4.0)
    ring = shapely.convex_hull(shapely.MultiPoint(corners + rng.uniform(-12.0, 12.0, 2)))
    return np.asarray(shapely.get_coordinates(ring)[:-1])


def test_lines_separate_by_the_distance_and_the_nearest_come_first() -> None:
    rng = np.random.default_rng(2)
    obstacles = [polygon(rng) for _ in range(6)]
    poses = np.column_stack([rng.uniform(-10.0, 10.0, (200, 2)), rng.uniform(-4.0, 4.0, 200)])
    lines = separating_lines(SHIP, poses, obstacles, 3)
    apart = 0
    for pose, three in zip(poses, lines, strict=True):
        corners = placed(SHIP, pose[None])[0]
        distances = shapely.distance(shapely.Polygon(corners), [*map(shapely.Polygon, obstacles)])
        for line, distance in zip(three, np.sort(distances), strict=False):
            separation = np.min(corners @ line[:2]) - line[2]
            assert np.hypot(*line[:2]) == pytest.approx(1.0)
            assert max(separation, 0.0) == pytest.approx(distance, abs=1e-9)
            assert any(np.max(one @ line[:2]) == pytest.approx(line[2]) for one in obstacles)
            apart += separation > 0.0
    assert 50 < apart < 590


def test_a_place_without_an_obstacle_has_a_line_infinitely_far_away() -> None:
    square = np.array([[5.0, 5.0], [7.0, 5.0], [7.0, 7.0], [5.0, 7.0]])
    lines = separating_lines(SHIP, np.zeros((1, 3)), [square], 2)
    assert lines[0, 1].tolist() == [0.0, 0.0, -1e6]
