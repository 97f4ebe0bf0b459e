"""Turning circle, zig-zag and constant-velocity runs, sailed."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.manoeuvres import ConstantVelocity
from seatrial.models.excitation.missions import NO_REFERENCE
from seatrial.models.notation import PLANAR
from seatrial.models.simulation.voyage import Voyage
from seatrial.runner.trials.trial import check, skipped
from tests.trials import composed, sailed


def calm(*overrides: str) -> tuple[Any, Voyage]:
    trial = composed("identifier=none", "disturbance=calm", *overrides)
    check(trial)
    return trial, sailed(trial).voyage


def test_a_turning_circle_closes() -> None:
    trial, voyage = calm("excitation=turning_circle", "excitation.duration_s=600")
    log = voyage.log
    straight = voyage.t < 30.0
    np.testing.assert_allclose(log.eta[straight, 1:], 0.0, atol=1e-6)
    np.testing.assert_array_equal(log.tau[:, 0], 150.0)
    assert log.eta[-1, 2] > 4 * np.pi
    late = voyage.t > 400.0
    np.testing.assert_allclose(log.nu[late], np.tile(log.nu[-1], (late.sum(), 1)), rtol=1e-3)
    turn = np.argmin(np.abs(log.eta[:, 2] - (log.eta[-1, 2] - 2 * np.pi)))  # one round before
    np.testing.assert_allclose(log.eta[turn, :2], log.eta[-1, :2], atol=0.2)
    assert trial.excitation.open_loop


@pytest.mark.parametrize("turn", [10.0, 20.0])
def test_a_zigzag_steers_back_each_time(turn: float) -> None:
    _, voyage = calm("excitation=zigzag", f"excitation.turn_deg={turn}")
    log = voyage.log
    moment = log.tau[:, 2]
    assert np.all(moment[voyage.t < 30.0 - 1e-9] == 0.0)
    steered = moment[voyage.t > 30.0]
    assert set(np.abs(steered)) == {120.0}
    assert steered[0] > 0.0  # to starboard first
    changes = np.flatnonzero(np.diff(np.sign(moment)) != 0.0)[1:]
    assert len(changes) >= 4
    heading = np.degrees(log.eta[changes + 1, 2])
    expected = turn * np.where(np.arange(len(heading)) % 2 == 0, 1.0, -1.0)
    assert np.all(np.abs(heading) >= turn)
    step = np.degrees(0.1 * np.max(np.abs(log.nu[:, 2])))  # between two instants
    np.testing.assert_allclose(heading, expected, atol=step)


def runs(**changes: Any) -> ConstantVelocity:
    mission = composed("vessel=beluga_diagonal", "excitation=constant_velocity").excitation
    assert isinstance(mission, ConstantVelocity)
    return replace(mission, **changes)


def test_the_runs_are_those_of_the_table() -> None:
    """Hoyer (2021), Table 5.2: 6 + 6 + 3 + 8 + 6 + 3 x 2 pairs."""
    mission = runs()
    assert len(mission.runs) == 35
    assert mission.duration_s == 35 * 60.0
    together = [one for one in mission.runs if set(one) == {"surge", "heave"}]
    assert {(one["surge"], one["heave"]) for one in together} == {
        (surge, heave) for surge in (0.1, 0.2) for heave in (0.05, 0.1, 0.15)
    }
    with pytest.raises(ConfigurationError, match=r"velocities\.surge\+sway: got \[0\.1\]"):
        runs(velocities={"surge+sway": ((0.1,),)})
    t = 0.1 * np.arange(round(mission.duration_s / 0.1))
    parameters, _ = mission.guidance(t, np.zeros(6))
    rate = np.diff(parameters.setpoints, axis=0) / 0.1  # type: ignore[attr-defined]
    first = (t[:-1] > 7.6) & (t[:-1] < 22.3)
    np.testing.assert_allclose(rate[first][:, 0], 0.05, atol=1e-9)
    back = (t[:-1] > 37.6) & (t[:-1] < 52.3)
    np.testing.assert_allclose(rate[back][:, 0], -0.05, atol=1e-9)
    np.testing.assert_allclose(parameters.setpoints[-1], 0.0, atol=1e-12)  # type: ignore[attr-defined]
    assert np.max(rate[:, 5]) == pytest.approx(0.6)
    assert np.max(rate[:, 3]) == 0.0


def test_pairs_alternate_between_training_and_testing() -> None:
    mission = runs()
    t = 0.1 * np.arange(round(mission.duration_s / 0.1))
    split = mission.split(t)
    pair = (t / 60.0 + 1e-9).astype(int)
    np.testing.assert_array_equal(split.train, pair % 2 == 0)
    most = runs(train_fraction=0.75).split(t).train
    assert np.mean(most) == pytest.approx(27 / 35)  # the nearest above three quarters of 35 pairs


def test_runs_in_axes_that_a_vessel_has_not_are_left_out() -> None:
    assert len(composed("excitation=constant_velocity").excitation.runs) == 26
    assert len(composed("vessel=surge_linear", "excitation=constant_velocity").excitation.runs) == 6
    with pytest.raises(ConfigurationError, match=r"excitation\.velocities: 1 runs"):
        runs(axes=("surge",), velocities={"surge": (0.1,), "heave": (0.1,)}).check(("surge",))


def test_six_axes_are_sailed_at_the_asked_velocity() -> None:
    """The vehicle follows the runs, turned by more than a half, and stays level."""
    _, voyage = calm("vessel=beluga_full", "excitation=constant_velocity")
    log = voyage.log
    assert np.max(np.abs(log.eta_d[:, 5])) > np.pi
    error = np.abs(log.eta_d - log.eta)
    assert np.mean(error[:, :3]) < 0.02
    assert np.mean(error[:, 5]) < 0.05
    assert np.max(np.abs(log.eta[:, 3:5])) < 0.3


@pytest.mark.parametrize("excitation", ["turning_circle", "zigzag"])
def test_what_does_not_suit_is_refused(excitation: str) -> None:
    with pytest.raises(ConfigurationError, match="needs a vessel in surge and yaw"):
        check(composed("vessel=surge_linear", f"excitation={excitation}"))
    mission: Any = composed(f"excitation={excitation}").excitation
    with pytest.raises(ConfigurationError, match="in yaw, expected at most the thrusters' 20"):
        mission.check_limits({"surge": 500.0, "sway": 500.0, "yaw": 20.0}, 0.1)
    with pytest.raises(ConfigurationError, match="approach_s"):
        replace(mission, approach_s=400.0)
    with pytest.raises(ConfigurationError, match="turn_deg"):
        composed("excitation=zigzag", "excitation.turn_deg=0")


def test_an_open_loop_needs_no_controller_and_cannot_be_replayed() -> None:
    trial, voyage = calm("excitation=prbs", "controller=none", "evaluation=none")
    assert np.all(np.abs(voyage.log.tau[:, 0]) == 100.0)
    np.testing.assert_array_equal(voyage.log.tau_fb, 0.0)
    assert skipped(composed("excitation=prbs")) == NO_REFERENCE
    assert trial.controller is None
    with pytest.raises(ConfigurationError, match="needs a controller"):
        check(composed("controller=none", "excitation=prbs", "excitation.loop=closed"))


def test_a_signal_is_added_to_the_closed_loop() -> None:
    options = ("excitation=prbs", "excitation.loop=closed", "excitation.length_s=60")
    _, voyage = calm(*options, "excitation.train_fraction=0.4")
    log = voyage.log
    np.testing.assert_allclose(
        np.abs(log.tau - log.tau_fb), np.tile([100.0, 100.0, 80.0], (600, 1))
    )
    assert np.max(np.abs(log.tau_fb)) > 10.0
    _, free = calm(*options[:1], options[2])
    assert np.abs(log.eta[-1, 0]) < np.abs(free.log.eta[-1, 0])  # it is held


@pytest.mark.parametrize(
    "excitation",
    [
        "single_ramp", "triple_ramp", "single_sine", "many_sine", "prbs", "multisine",
        "prbs_waypoints", "zigzag", "turning_circle", "four_corner", "constant_velocity",
        "waypoints",
    ],
)  # fmt: skip
def test_every_excitation_takes_an_offset(excitation: str) -> None:
    offset = "excitation.offset={surge: 30.0, yaw: -7.0}"
    mission: Any = composed(f"excitation={excitation}", offset).excitation
    t = 0.1 * np.arange(round(mission.duration_s / 0.1))
    moved, plain = (
        one.force(t, PLANAR, np.random.default_rng(3))
        for one in (mission, replace(mission, offset=None))
    )
    change = moved if plain is None else moved - plain
    np.testing.assert_allclose(change, np.tile([30.0, 0.0, -7.0], (len(t), 1)), atol=1e-9)
    with pytest.raises(ConfigurationError, match=r"excitation\.offset: got heave"):
        replace(mission, offset={"heave": 1.0}).check(PLANAR)
    with pytest.raises(ConfigurationError, match=r"sway.*the thrusters' 1000"):
        replace(mission, offset={"sway": 2000.0}).check_limits(dict.fromkeys(PLANAR, 1000.0), 0.1)
