"""Restricted waters: what is clear keeps its distance, and what is in the way is named."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from seatrial.models.errors import ConfigurationError
from seatrial.models.planning.planner import Waters, clear, inside, simplified

AREA = ((0.0, 0.0), (60.0, 0.0), (60.0, 40.0), (0.0, 40.0))
QUAY = ((15.0, 10.0), (30.0, 10.0), (30.0, 20.0), (15.0, 20.0))
NEAR = (
    "it is 0.x m from the nearest edge or obstacle (0: no water), expected at least the "
    "clearance_m of 1"
)
WALL = ((28.0, -1.0), (32.0, -1.0), (32.0, 41.0), (28.0, 41.0))


@st.composite
def triangles(draw: st.DrawFn) -> tuple[tuple[float, float], ...]:
    north, east = draw(st.floats(5.0, 55.0)), draw(st.floats(5.0, 35.0))
    size, turn = draw(st.floats(1.0, 8.0)), draw(st.floats(0.0, 2.0))
    angles = turn + np.array([0.0, 2.1, 4.2])
    return tuple((north + size * np.cos(a), east + size * np.sin(a)) for a in angles)


@settings(deadline=None, max_examples=40)
@given(st.lists(triangles(), min_size=1, max_size=5), st.floats(0.0, 4.0), st.integers(0, 10**6))
def test_what_is_clear_keeps_its_distance(fields, clearance: float, seed: int) -> None:
    """By distances to the polygons themselves, densely along paths."""
    waters = Waters(AREA, tuple(fields), clearance)
    rng = np.random.default_rng(seed)
    path = np.cumsum(rng.normal(0.0, 1.5, (8, 2)), axis=0)
    origins = rng.uniform(0.0, 50.0, (60, 2))
    kept = origins[clear(waters.free(), path, origins)]
    edges = shapely.Polygon(AREA)
    for origin in kept:
        line = shapely.LineString(origin + path)
        dense = line.segmentize(0.05)
        points = shapely.points(shapely.get_coordinates(dense))
        for one in fields:
            assert np.min(shapely.distance(shapely.Polygon(one), points)) >= clearance - 1e-9
        assert np.all(shapely.covers(edges, points))
        assert np.min(shapely.distance(edges.exterior, points)) >= clearance - 1e-9


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 10**6), st.floats(0.01, 0.5))
def test_a_simplified_path_strays_by_its_tolerance_at_most(seed: int, tolerance: float) -> None:
    path = np.cumsum(np.random.default_rng(seed).normal(0.0, 0.2, (200, 2)), axis=0)
    corners = shapely.LineString(simplified(path, tolerance))
    assert np.max(shapely.distance(corners, shapely.points(path))) <= tolerance + 1e-12


def test_distances_and_points() -> None:
    waters = Waters(AREA, (QUAY,), 1.0)
    points = np.array([[5.0, 5.0], [10.0, 15.0], [20.0, 15.0], [-3.0, 5.0]])
    np.testing.assert_allclose(waters.distance(points), [5.0, 5.0, 0.0, 0.0])
    assert inside(waters.free(), points).tolist() == [True, True, False, False]


@pytest.mark.parametrize(
    ("point", "said"),
    [
        ((5.0, 5.0), None),
        ((-1.0, 5.0), NEAR.replace("0.x", "0")),
        ((20.0, 15.0), NEAR.replace("0.x", "0")),
        ((14.5, 15.0), NEAR.replace("0.x", "0.5")),
        ((0.4, 5.0), NEAR.replace("0.x", "0.4")),
    ],
)
def test_what_is_in_the_way_of_a_point_is_said(point, said) -> None:
    assert Waters(AREA, (QUAY,), 1.0).in_the_way(np.array(point)) == said


@pytest.mark.parametrize(
    ("area", "obstacles", "clearance", "message"),
    [
        (AREA[:2], (), 1.0, "area: expected at least three corners (north, east)"),
        (AREA, (QUAY, ((1.0,),)), 1.0, "obstacles[1]: expected at least three corners"),
        (AREA, (QUAY[:2] + QUAY[:1:-1],), 1.0, "obstacles[0]: expected at least three corners"),
        (AREA, (), -1.0, "clearance_m must not be negative, got -1"),
    ],
)
def test_polygons_are_checked(area, obstacles, clearance, message) -> None:
    with pytest.raises(ConfigurationError) as caught:
        Waters(area, obstacles, clearance)
    assert message in str(caught.value)
