"""Motion primitives lead from the lattice to the lattice, without a jump or a kink."""

import numpy as np
import pytest

from seatrial.models.planning.planner import (
    HEADING_STEP,
    HEADINGS,
    Pace,
    PlanningTask,
    Waters,
    basic,
    nearest,
    shortest_arcs,
    turned,
)

PACE = Pace(0.5, 0.4, 0.1)


@pytest.mark.parametrize("heading", range(HEADINGS))
@pytest.mark.parametrize("cell", [0.7, 2.0])
def test_basic_primitives_end_on_the_lattice(heading: int, cell: float) -> None:
    for path in basic(heading, cell, PACE).values():
        end = turned(path, heading * HEADING_STEP)[-1]
        np.testing.assert_allclose(end, nearest(end, cell) * (cell, cell, HEADING_STEP), atol=1e-9)


@pytest.mark.parametrize("heading", [0, 1])
def test_basic_primitives_are_sailed_ahead_at_their_pace(heading: int) -> None:
    for own in basic(heading, 2.0, PACE).values():
        path = np.vstack([np.zeros(3), own])
        move = np.diff(path, axis=0)
        length, turn = np.hypot(move[:, 0], move[:, 1]), np.abs(move[:, 2])
        assert np.max(length) <= 0.5 * 0.1 + 1e-9
        assert np.max(turn) <= 0.4 * 0.1 + 1e-9
        course = np.arctan2(move[:, 1], move[:, 0])[length > 1e-9]
        middle = 0.5 * (path[1:, 2] + path[:-1, 2])[length > 1e-9]
        np.testing.assert_allclose(course, middle, atol=2e-2)  # heading along the path


def test_turns_to_both_sides_mirror_each_other() -> None:
    moves = basic(0, 2.0, PACE)
    np.testing.assert_allclose(moves["arc_port"] * [1.0, -1.0, -1.0], moves["arc_starboard"])
    assert moves["arc_starboard"][-1] == pytest.approx([4.0, 2.0, HEADING_STEP])
    assert moves["pivot_starboard"][-1] == pytest.approx([0.0, 0.0, HEADING_STEP])


@pytest.mark.parametrize("seed", range(10))
def test_arcs_lead_to_their_pose_along_the_heading(seed: int) -> None:
    end = np.random.default_rng(seed).uniform(-4.0, 4.0, 3)
    arcs = shortest_arcs(np.zeros(3), end, 1.5)
    poses = arcs.poses(np.linspace(0.0, 1.0, 4001))
    miss = np.exp(1j * poses[-1, 2]) - np.exp(1j * end[2])
    np.testing.assert_allclose([*(poses[-1, :2] - end[:2]), abs(miss)], 0.0, atol=1e-8)
    move = np.diff(poses, axis=0)
    length = np.hypot(move[:, 0], move[:, 1])
    assert np.sum(length) == pytest.approx(np.sum(arcs.lengths), rel=1e-5)
    assert np.max(np.abs(move[:, 2])) <= np.sum(arcs.lengths) / 4000 / 1.5 + 1e-9
    middle = 0.5 * (poses[1:, 2] + poses[:-1, 2])
    np.testing.assert_allclose(move[:, 0], length * np.cos(middle), atol=1e-6)
    np.testing.assert_allclose(move[:, 1], length * np.sin(middle), atol=1e-6)


@pytest.mark.parametrize("heading", range(HEADINGS))
def test_a_manoeuvre_is_closed_by_a_passage_to_the_nearest_pose(heading: int) -> None:
    t = np.linspace(0.0, 1.0, 50)[1:, None]
    free = t * np.array([7.3, -2.1, 9.9])
    waters, ends = Waters(((0.0, 0.0), (9.0, 0.0), (0.0, 9.0)), (), 0.0), np.zeros((2, 3))
    task = PlanningTask(waters, {"own": free}, {"own": 1}, *ends, 2.0, PACE, hold=5)
    whole = task.paths(heading)["own"]
    np.testing.assert_allclose(whole[:49], turned(free, heading * HEADING_STEP))
    end = whole[-1]
    np.testing.assert_allclose(end, nearest(end, 2.0) * (2.0, 2.0, HEADING_STEP), atol=1e-12)
    np.testing.assert_array_equal(whole[-5:], np.tile(end, (5, 1)))
    assert np.hypot(*(end - whole[48])[:2]) <= np.sqrt(2.0) + 1e-9
    assert abs(end[2] - whole[48, 2]) <= 0.5 * HEADING_STEP + 1e-9
    assert np.max(np.hypot(*np.diff(whole[48:, :2], axis=0).T)) <= 0.05 + 1e-9
