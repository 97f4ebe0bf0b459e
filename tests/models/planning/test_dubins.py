"""Paths of Dubins end where they should, and no path of three arcs is shorter."""

from itertools import product

import numpy as np
import pytest
from scipy.optimize import least_squares

from seatrial.models.planning.dubins import Arc, dubins, length_of, poses_at
from seatrial.models.vessel.basis import Array

R = 1.5


def _error(path: tuple[Arc, ...], start: Array, end: Array) -> Array:
    last = poses_at(start, path, R, np.array([length_of(path)]))[0]
    turn = np.angle(np.exp(1j * (last[2] - end[2])))
    return np.array([*(last[:2] - end[:2]), turn])


def _poses(seed: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    pair = rng.uniform(-4.0, 4.0, (2, 3))
    pair[:, 2] *= np.pi / 4.0
    return pair[0], pair[1]


@pytest.mark.parametrize("seed", range(50))
def test_it_ends_at_the_pose_and_is_no_shorter_than_the_line(seed: int) -> None:
    start, end = _poses(seed)
    path = dubins(start, end, R)
    assert _error(path, start, end) == pytest.approx(np.zeros(3), abs=1e-9)
    assert all(arc.length_m >= 0.0 for arc in path)
    assert length_of(path) >= np.hypot(*(end[:2] - start[:2])) - 1e-9


@pytest.mark.parametrize("seed", [1, 4])
def test_a_search_over_three_arcs_of_any_sides_finds_no_shorter_path(seed: int) -> None:
    start, end = _poses(seed)
    rng, found = np.random.default_rng(seed), []
    for sides in product((-1, 0, 1), repeat=3):

        def error(lengths: Array, sides: tuple[int, ...] = sides) -> Array:
            arcs = tuple(Arc(s, n) for s, n in zip(sides, lengths, strict=True))
            return _error(arcs, start, end)

        for _ in range(4):
            guess = rng.uniform(0.0, 6.0, 3)
            solution = least_squares(error, guess, bounds=(0.0, 2.0 * np.pi * R + 12.0))
            if solution.cost < 1e-12:
                found.append(float(np.sum(solution.x)))
    assert min(found) == pytest.approx(length_of(dubins(start, end, R)), abs=1e-4)


def test_a_straight_path_is_the_distance_and_the_mirror_image_is_as_long() -> None:
    start, ahead = np.array([1.0, 2.0, 0.3]), np.array([1.0, 2.0, 0.3])
    ahead[:2] += 5.0 * np.array([np.cos(0.3), np.sin(0.3)])
    assert length_of(dubins(start, ahead, R)) == pytest.approx(5.0)
    first, last = _poses(7)
    mirror = np.array([1.0, -1.0, -1.0])
    there = length_of(dubins(first, last, R))
    assert length_of(dubins(mirror * first, mirror * last, R)) == pytest.approx(there)
