"""Separating lines against the distances of another library."""

import numpy as np
import pytest
import shapely

from seatrial.models.control.free_space import separating_lines
from seatrial.models.vessel.basis import Array

HULL = np.array([[2.5, 0.0], [1.0, 1.4], [-2.5, 1.4], [-2.5, -1.4], [1.0, -1.4]])


def polygon(rng: np.random.Generator) -> Array:
    corners = rng.normal(size=(7, 2)) * rng.uniform(0.5, 4.0)
    ring = shapely.convex_hull(shapely.MultiPoint(corners + rng.uniform(-12.0, 12.0, 2)))
    return np.asarray(shapely.get_coordinates(ring)[:-1])


def placed(pose: Array) -> Array:
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.asarray(pose[:2] + HULL @ np.array([[c, s], [-s, c]]))


def test_lines_separate_by_the_distance_and_the_nearest_come_first() -> None:
    rng = np.random.default_rng(2)
    obstacles = [polygon(rng) for _ in range(6)]
    poses = np.column_stack([rng.uniform(-10.0, 10.0, (200, 2)), rng.uniform(-4.0, 4.0, 200)])
    lines = np.zeros((200, 3, 3))
    first = np.cumsum([0, *map(len, obstacles)])
    separating_lines(HULL, poses, np.vstack(obstacles), first, lines)
    apart = 0
    for pose, three in zip(poses, lines, strict=True):
        corners = placed(pose)
        distances = shapely.distance(shapely.Polygon(corners), [*map(shapely.Polygon, obstacles)])
        for line, distance in zip(three, np.sort(distances), strict=False):
            separation = np.min(corners @ line[:2]) - line[2]
            assert np.hypot(*line[:2]) == pytest.approx(1.0)
            assert max(separation, 0.0) == pytest.approx(distance, abs=1e-9)
            assert any(np.max(one @ line[:2]) == pytest.approx(line[2]) for one in obstacles)
            apart += separation > 0.0
    assert 50 < apart < 590


def test_a_place_without_an_obstacle_has_a_line_infinitely_far_away() -> None:
    lines, square = np.ones((1, 2, 3)), np.array([[5.0, 5.0], [7.0, 5.0], [7.0, 7.0], [5.0, 7.0]])
    separating_lines(HULL, np.zeros((1, 3)), square, np.array([0, 4]), lines)
    assert lines[0, 1].tolist() == [0.0, 0.0, -np.inf]
