"""Positioning missions and their reference models."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.guidance import ReferenceFilter
from seatrial.models.excitation.setpoints import AccelerationLimited, Setpoints, Step
from seatrial.models.notation import PLANAR
from seatrial.models.simulation.registry import REFERENCES
from seatrial.models.simulation.voyage import outlook
from seatrial.models.vessel.parameters import Plant
from tests.models.control.sailing import lqi, ship, voyage, weather

POSES = ((0.0, 0.0, 0.0), (4.0, -2.0, 90.0))
MISSION = Setpoints("there", {"there": POSES}, 2.0, 100.0, Step())


def sail_reference(limits: Any, setpoints: np.ndarray, period_s: float) -> np.ndarray:
    """State (N, n_dof, 3) of a reference model that follows set-points."""
    table = limits.table(period_s)
    state, states = np.zeros((setpoints.shape[1], 3)), []
    for setpoint in setpoints:
        REFERENCES[type(table)](table, state, setpoint)
        states.append(state.copy())
    return np.array(states)


@pytest.mark.parametrize("distance", [0.01, 0.3, 10.0, -4.0])
def test_the_limited_reference_keeps_its_limits_and_arrives_in_the_least_time(
    distance: float,
) -> None:
    v, a, h = 0.5, 0.1, 0.1
    limits = AccelerationLimited((v,), (a,))
    x = sail_reference(limits, np.full((600, 1), distance), h)[:, 0]
    assert np.all(np.abs(x[:, 1]) <= v + 1e-12)
    assert np.all(np.abs(x[:, 2]) <= a + 1e-9)
    np.testing.assert_allclose(np.diff(x[:, 0], prepend=0.0), h * x[:, 1], atol=1e-12)
    np.testing.assert_allclose(np.diff(x[:, 1], prepend=0.0), h * x[:, 2], atol=1e-12)
    assert x[-1, 0] == pytest.approx(distance, abs=1e-9)
    assert np.max(x[:, 0] / distance) <= 1.0 + 1e-9  # no overshoot
    far = abs(distance) > v * v / a
    least = abs(distance) / v + v / a if far else 2.0 * np.sqrt(abs(distance) / a)
    arrived = h * np.argmax(np.abs(x[:, 0] - distance) < 1e-3 * abs(distance))
    early = np.sqrt(2e-3 * abs(distance) / a)  # what remains at a thousandth
    assert least - early - 3 * h <= arrived <= least + 3 * h


def test_a_set_point_that_turns_back_is_followed() -> None:
    setpoints = np.concatenate([np.full(40, 10.0), np.full(400, -1.0)])[:, None]
    x = sail_reference(AccelerationLimited((1.0,), (0.2,)), setpoints, 0.1)[:, 0]
    assert np.all(np.abs(x[:, 2]) <= 0.2 + 1e-9)
    assert x[-1, 0] == pytest.approx(-1.0, abs=1e-9)
    assert np.min(x[:, 0]) >= -1.0 - 1e-9


def test_poses_share_the_duration_and_are_scaled() -> None:
    MISSION.check(PLANAR)
    guidance, _ = MISSION.guidance(np.arange(100.0), np.zeros(3))
    np.testing.assert_array_equal(guidance.setpoints[:50], np.zeros((50, 3)))
    np.testing.assert_allclose(guidance.setpoints[50:], np.tile([8.0, -4.0, np.pi / 2], (50, 1)))
    MISSION.check(("surge",))
    guidance, _ = MISSION.guidance(np.arange(100.0), np.zeros(1))
    np.testing.assert_array_equal(guidance.setpoints[:, 0], np.repeat([0.0, 8.0], 50))


@pytest.mark.parametrize("limits", [Step(), AccelerationLimited((0.5, 0.5, 0.1), (0.1, 0.1, 0.02)),
                                    ReferenceFilter(0.5, 0.7)])  # fmt: skip
def test_the_outlook_is_what_will_be_asked_for(limits: Any) -> None:
    """What a preview knows is to the last digit what the loop logs."""
    mission = replace(MISSION, reference_filter=limits)
    guidance, _ = mission.guidance(np.arange(100.0), np.zeros(3))
    sailed, _ = voyage(lqi(), guidance.setpoints)
    plant, met = Plant(ship(), None, (9.0,) * 3), weather(100)
    ahead = outlook(plant, met, guidance, Step().table(1.0), np.zeros(3))
    np.testing.assert_array_equal(ahead.reference, sailed.log.eta_d)
    own = outlook(plant, met, guidance, limits.table(1.0), np.zeros(3)).reference
    assert own.shape == (100, 3)
    np.testing.assert_allclose(own[-1], guidance.setpoints[-1], rtol=0.35)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"schedule": "here"}, "schedule: got 'here', expected one of there"),
        ({"schedules": {"there": ((0.0, 1.0),)}}, "expected a list of"),
        ({"scale": 0.0}, "scale must be positive"),
        ({"duration_s": -1.0}, "duration_s must be positive"),
    ],
)
def test_wrong_missions_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        replace(MISSION, **changes)


def test_what_does_not_suit_the_vessel_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="evaluation=there needs a vessel in surge"):
        MISSION.check(("heave",))
    limited = replace(MISSION, reference_filter=AccelerationLimited((1.0,), (1.0,)))
    with pytest.raises(ConfigurationError, match="got 1 numbers, expected 3"):
        limited.check(PLANAR)
    with pytest.raises(ConfigurationError, match="acceleration must be 2 positive numbers"):
        AccelerationLimited((1.0, 1.0), (1.0, 0.0))
