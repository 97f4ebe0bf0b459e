"""A sequence of the helm lasts its steps, goes to both sides, and steers the courses ordered."""

from dataclasses import replace

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.helm_sequence import HelmSequence, HelmStep, join_steps
from seatrial.models.planning.dubins import dubins, length_of
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
    steps = HelmStep("turn", 10.0, train=False), HelmStep("hold", 5.0, 0.2), HelmStep("turn", 5.0)
    t, _, mission = _sailed("kvlcc2", *steps)
    assert mission.duration_s == 20.0
    assert t[-1] == pytest.approx(20.0, abs=0.2)
    split = mission.split(t)
    assert np.array_equal(split.train, t >= 10.0)
    assert np.array_equal(split.test, ~split.train)
    whole = replace(mission, steps=steps[1:]).split(t)
    assert np.any(whole.train)
    assert np.any(whole.test)
    with pytest.raises(ConfigurationError, match="steps"):
        replace(mission, steps=())


def test_a_zigzag_goes_to_both_sides_of_the_start_of_its_input() -> None:
    _, _, mission = _sailed("kvlcc2", HelmStep("hold", 1.0))
    input_start = (0.1, *mission.input_start[1:])
    moved = replace(mission, steps=(HelmStep("zigzag", 10.0, 0.3, 5.0),), input_start=input_start)
    there, back = moved.pieces(0.1)[:2]
    assert there.order - 0.1 == pytest.approx(0.1 - back.order)
    assert there.side == -back.side


def test_a_join_lasts_as_long_as_its_path() -> None:
    start, end = np.zeros(3), np.array([30.0, -20.0, 2.0])
    path = dubins(start, end, 5.0)
    steps = join_steps(path, 5.0, 2.0, np.array([-0.3, 0.3]), 4.0)
    assert sum(step.seconds for step in steps) == pytest.approx(length_of(path) / 2.0 + 4.0)
    turned = np.radians(sum(step.turn_deg for step in steps))
    assert np.angle(np.exp(1j * (turned - 2.0))) == pytest.approx(0.0, abs=1e-9)
    assert all(step.order * step.turn_deg >= 0.0 for step in steps)
