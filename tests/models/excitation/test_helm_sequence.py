"""A sequence of the helm lasts its steps, goes to both sides, and steers the courses ordered."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.helm_sequence import HelmSequence, HelmStep, join
from seatrial.models.vessel.basis import Array
from tests.trials import composed, sailed


def _sailed(vessel: str, *steps: HelmStep) -> tuple[Array, Array, HelmSequence]:
    """Times, heading turned [deg] and the mission of a vessel in calm water."""
    trial = composed(
        f"vessel={vessel}", "excitation=helm_sequence", "controller=none", "evaluation=none"
    )
    assert isinstance(trial.excitation, HelmSequence)
    mission = replace(trial.excitation, steps=steps)
    voyage = sailed(trial, mission).voyage
    return voyage.t, np.degrees(voyage.log.eta[:, 2]), mission


def test_a_turn_ends_on_the_course_ordered() -> None:
    _, heading, _ = _sailed("kvlcc2", HelmStep("turn", 150.0, 0.4, 90.0))
    assert heading[-1] == pytest.approx(90.0, abs=2.0)


@pytest.mark.slow
def test_an_input_that_is_not_zero_at_the_start_steers_the_course() -> None:
    steps = HelmStep("turn", 20.0), HelmStep("turn", 40.0, 15.0, 60.0)
    t, heading, _ = _sailed("otter", *steps)
    assert heading[t < 20.0] == pytest.approx(0.0, abs=1.0)
    assert heading[-1] == pytest.approx(60.0, abs=5.0)


def test_steps_last_their_time_and_train_what_they_say_and_some_are_needed() -> None:
    steps = HelmStep("turn", 10.0), HelmStep("hold", 5.0, 0.2), HelmStep("turn", 5.0)
    t, _, mission = _sailed("kvlcc2", *steps)
    assert mission.duration_s == 20.0
    assert [*mission.rows()][1:] == [(5.0, "hold, delta 11.5 deg"), (5.0, "straight")]
    assert t[-1] == pytest.approx(20.0, abs=0.2)
    split = mission.split(t)
    assert np.array_equal(split.train, (t >= 10.0) & (t < 15.0))
    assert np.array_equal(split.test, ~split.train)
    whole = replace(mission, steps=steps[1:2]).split(t)
    assert np.any(whole.train)
    assert np.any(whole.test)
    with pytest.raises(ConfigurationError, match="duration_s = 0"):
        replace(mission, steps=())


def test_a_zigzag_goes_to_both_sides_of_the_start_of_its_input() -> None:
    _, _, mission = _sailed("kvlcc2", HelmStep("hold", 1.0))
    input_start = (0.1, *mission.input_start[1:])
    moved = replace(mission, steps=(HelmStep("zigzag", 10.0, 0.3, 5.0),), input_start=input_start)
    there, back = moved.pieces(0.1)[:2]
    assert there.order - 0.1 == pytest.approx(0.1 - back.order)
    assert there.side == -back.side


R, HELM = 1.5, np.array([-0.3, 0.3])


def _end(start: Array, lengths: Array, sides: tuple[int, ...]) -> Array:
    """The pose after an arc, a line and an arc of lengths [m]."""
    pose = start.copy()
    for side, length in zip(sides, lengths, strict=True):
        turn = side * length / R
        chord, course = length * np.sinc(turn / (2.0 * np.pi)), pose[2] + 0.5 * turn
        pose += [chord * np.cos(course), chord * np.sin(course), turn]
    return pose


def _poses(seed: int) -> tuple[Array, Array]:
    pair = np.random.default_rng(seed).uniform(-4.0, 4.0, (2, 3))
    pair[:, 2] *= np.pi / 4.0
    return pair[0], pair[1]


def _miss(reached: Array, end: Array) -> Array:
    turn = np.angle(np.exp(1j * (reached[2] - end[2])))
    return np.array([*(reached[:2] - end[:2]), turn])


@pytest.mark.parametrize("seed", range(20))
def test_a_join_ends_at_the_pose(seed: int) -> None:
    start, end = _poses(seed)
    first, last = join(start, end, R, 1.0, HELM, 4.0)
    turns = np.radians([first.turn_deg, last.turn_deg])
    line = first.seconds - R * abs(turns[0])
    assert last.seconds == pytest.approx(R * abs(turns[1]) + 4.0)
    lengths = np.array([R * abs(turns[0]), line, R * abs(turns[1])])
    reached = _end(start, lengths, (int(np.sign(turns[0])), 0, int(np.sign(turns[1]))))
    assert _miss(reached, end) == pytest.approx(np.zeros(3), abs=1e-6)
    assert all(step.order * step.turn_deg > 0.0 for step in (first, last))


def test_a_search_over_arc_line_and_arc_finds_no_shorter_join() -> None:
    start, end = _poses(1)
    rng, found = np.random.default_rng(1), []
    for sides in ((1, 0, 1), (1, 0, -1), (-1, 0, 1), (-1, 0, -1)):
        for _ in range(8):
            solution = least_squares(
                lambda x, sides=sides: _miss(_end(start, x, sides), end),
                rng.uniform(0.0, 6.0, 3), bounds=(0.0, 2.0 * np.pi * R + 12.0),
            )  # fmt: skip
            if solution.cost < 1e-12:
                found.append(float(np.sum(solution.x)))
    steps = join(start, end, R, 1.0, HELM, 0.0)
    assert min(found) == pytest.approx(sum(step.seconds for step in steps), abs=1e-4)


def test_a_straight_join_has_no_turn() -> None:
    ahead = np.array([5.0 * np.cos(0.3), 5.0 * np.sin(0.3), 0.3])
    steps = join(np.array([0.0, 0.0, 0.3]), ahead, R, 2.0, HELM, 1.0)
    assert sum(step.seconds for step in steps) == pytest.approx(3.5)
    assert all(abs(step.turn_deg) < 1e-6 for step in steps)
