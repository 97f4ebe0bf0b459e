"""Way-points, line of sight, positioning missions, and reference models."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.signal import lti, step

from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.guidance import (
    LineOfSight,
    ReferenceFilter,
    straight_line_setpoints,
)
from seatrial.models.excitation.missions import Operation, Replay, Waypoints
from seatrial.models.excitation.setpoints import AccelerationLimited, Setpoints, Step
from seatrial.models.notation import PLANAR
from seatrial.models.simulation.registry import GUIDANCE, REFERENCES
from seatrial.models.simulation.voyage import outlook
from seatrial.models.vessel.parameters import Plant
from tests.models.control.sailing import lqi, ship, voyage, weather

FILTER, OF_SURGE = ReferenceFilter(0.5, 0.7), AccelerationLimited((1.0,), (1.0,))
LAP = Waypoints(((0.0, 1.0, 90.0),), 60.0, "line", 0.675, 0.795, FILTER, 0.5)
POSES = ((0.0, 0.0, 0.0), (4.0, -2.0, 90.0))
MISSION = Setpoints("there", {"there": POSES}, 2.0, 100.0, Step())
POINTS = np.array([[0.0, -15.0, -np.pi / 2], [15.0, -15.0, 0.0], [15.0, -15.0, np.pi]])


def test_the_filter_is_the_third_order_system_of_the_thesis() -> None:
    w, d = FILTER.bandwidth_rad_s, FILTER.damping
    a, b, _ = FILTER.table(0.1)
    state, seen = np.zeros(3), []
    for _ in range(600):
        seen.append(state[0])
        state = a @ state + b
    gain = 2 * d + 1
    system = lti([w**3], [1.0, gain * w, gain * w * w, w**3])
    _, exact = step(system, T=0.1 * np.arange(600))
    np.testing.assert_allclose(seen, exact, atol=1e-9)
    np.testing.assert_allclose(state, [1.0, 0.0, 0.0], atol=1e-6)


def test_the_setpoint_moves_on_straight_lines_and_waits() -> None:
    t = 0.1 * np.arange(1800)
    setpoints = straight_line_setpoints(POINTS, 60.0, t, 0.675, 0.795)
    np.testing.assert_allclose(setpoints[0], 0.0)
    np.testing.assert_allclose(setpoints[599], POINTS[0])
    travelled = np.hypot(*setpoints[:, :2].T)
    arrival = 15.0 / 0.675  # the way is longer than the turn
    assert np.all(travelled[t < arrival] < 15.0)
    np.testing.assert_allclose(travelled[(t > arrival) & (t < 60.0)], 15.0)
    half = np.argmin(np.abs(t - arrival / 2))
    np.testing.assert_allclose(setpoints[half], POINTS[0] / 2, atol=0.05)
    turning = (t > 120.0) & (t < 120.0 + np.pi / 0.795)  # a turn on the spot
    np.testing.assert_allclose(np.diff(setpoints[turning, 2]) / 0.1, 0.795, rtol=1e-6)


def follow(sight: LineOfSight, poses: np.ndarray) -> np.ndarray:
    parameters, state = sight.build(np.zeros(3))
    setpoints = np.empty((len(poses), 3))
    for pose, setpoint in zip(poses, setpoints, strict=True):
        GUIDANCE[type(parameters)](parameters, state, 0, pose, setpoint)
    return setpoints


def test_the_sight_point_lies_on_the_leg_and_on_the_circle() -> None:
    sight = LineOfSight(((0.0, 0.0), (40.0, 30.0)), 6.0)
    pose = np.array([8.0, 9.0, 0.3])  # 2.4 m off the leg
    x, y, heading = follow(sight, pose[None])[0]
    assert x * 30.0 == pytest.approx(y * 40.0)
    assert np.hypot(x - 8.0, y - 9.0) == pytest.approx(6.0)
    assert heading == pytest.approx(np.arctan2(y - 9.0, x - 8.0))


def test_way_points_are_passed_in_turn_and_the_heading_unrolls() -> None:
    corners = ((0.0, 0.0), (20.0, 0.0), (20.0, 20.0), (0.0, 20.0), (0.0, 0.0), (20.0, 0.0))
    sight = LineOfSight(corners, 3.0)
    legs = [np.linspace(a, b, 40) for a, b in pairwise(corners)]
    track = np.vstack(legs)
    setpoints = follow(sight, np.column_stack([track, np.zeros(len(track))]))
    assert setpoints[-1, 2] == pytest.approx(2.0 * np.pi, abs=1e-6)  # a full turn, not a jump
    assert np.max(np.abs(np.diff(setpoints[:, 2]))) < 2.0
    np.testing.assert_allclose(setpoints[-1, :2], corners[-1])


def test_missions_that_need_the_plane_refuse_one_axis() -> None:
    crossing = Operation(LineOfSight(((0.0, 0.0), (1.0, 0.0)), 6.0), FILTER, 240.0)
    for mission in (LAP, crossing):
        mission.check(PLANAR)
        with pytest.raises(ConfigurationError, match="needs a vessel in surge, sway, yaw"):
            mission.check(("surge",))
    Replay().check(("surge",))
    assert LAP.duration_s == 60.0


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
                                    FILTER])  # fmt: skip
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
    ("make", "message"),
    [
        (lambda: LineOfSight(((0.0, 0.0),), 6.0), "at least two"),
        (lambda: LineOfSight(((0.0, 0.0), (0.0, 0.0)), 6.0), "equal"),
        (lambda: LineOfSight(((0.0, 0.0), (1.0, 0.0)), 0.0), "radius_m must be positive"),
        (lambda: replace(LAP, train_fraction=0.0), "train_fraction must be positive"),
        (lambda: replace(LAP, train_fraction=1.0), "train_fraction must be below 1"),
        (lambda: replace(MISSION, schedule="here"), "schedule: got 'here', expected one of there"),
        (lambda: replace(MISSION, schedules={"there": ()}), "got 'there', expected one of there"),
        (lambda: replace(MISSION, scale=0.0), "scale must be positive"),
        (lambda: replace(MISSION, duration_s=-1.0), "duration_s must be positive"),
        (lambda: MISSION.check(("heave",)), "set-points needs a vessel in surge"),
        (
            lambda: replace(MISSION, reference_filter=OF_SURGE).check(PLANAR),
            "expected speed and acceleration in each of surge, sway",
        ),
        (lambda: AccelerationLimited((1.0, 1.0), (1.0, 0.0)), "acceleration must be positive"),
    ],
)
def test_what_cannot_be_sailed_is_refused(make: Callable[[], Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        make()
