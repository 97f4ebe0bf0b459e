"""Force signals: their shapes, spectra and limits, and what a vessel does under them."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.forcing import Forcing
from seatrial.models.excitation.guidance import ReferenceFilter
from seatrial.models.excitation.signals import (
    Legs,
    Multisine,
    Prbs,
    Pulses,
    Ramp,
    SharedSignal,
    Sines,
    Steady,
    multisine,
    prbs,
)
from seatrial.models.notation import PLANAR
from tests.trials import composed

T = 0.1 * np.arange(1200)
FILTER, PRBS = ReferenceFilter(0.5, 0.7), Prbs(5.0, 12.0)


def forcing(signal: Any, **changes: Any) -> Forcing:
    options: dict[str, Any] = {
        "signal": signal, "axes": PLANAR, "amplitude": {"surge": 10.0, "sway": 20.0, "yaw": 30.0},
        "offset": {}, "order": "together", "loop": "open", "length_s": 100.0, "time_scale": 1.0,
        "hold": FILTER, "train_fraction": 0.5,
    }  # fmt: skip
    return Forcing(**(options | changes))


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("single_ramp", lambda t: 30.0 * ((t >= 10) & (t < 30))),
        ("single_sine", lambda t: 60.0 * np.sin(2 * np.pi * t / 5.0)),
        ("many_sine", lambda t: sum(10.0 * np.sin(2 * np.pi * t / p) for p in range(1, 92, 10))),
        (
            "triple_ramp",
            lambda t: (
                10.0 * ((t >= 10) & (t < 30))
                + 30.0 * ((t >= 40) & (t < 60))
                + 60.0 * ((t >= 70) & (t < 90))
            ),
        ),
    ],
)
def test_the_inputs_of_the_thesis(name: str, value: Callable[[Any], Any]) -> None:
    """Hoyer (2021), section 6.3 and Fig. 6.1, with the surge models."""
    mission = composed("vessel=surge_linear", f"excitation={name}").excitation
    t = 0.1 * np.arange(round(mission.duration_s / 0.1))
    found = mission.force(t, ("surge",), rng())[:, 0]
    np.testing.assert_allclose(found, value(np.round(t, 9)), atol=1e-9)


def test_a_binary_signal_is_held_between_its_limits() -> None:
    t = 0.1 * np.arange(200_000)
    signal = prbs(t, 5.0, 12.0, rng())
    assert set(np.unique(signal)) == {-1.0, 1.0}
    held = 0.1 * np.diff(np.flatnonzero(np.diff(signal)))
    assert held.min() >= 4.9
    assert held.max() <= 12.1
    assert np.mean(held) == pytest.approx(8.5, abs=0.2)
    assert abs(np.mean(signal)) < 0.03


def test_every_axis_has_a_binary_signal_of_its_own() -> None:
    t = 0.1 * np.arange(60_000)
    force = forcing(PRBS, length_s=6000.0).force(t, PLANAR, rng())
    correlation = np.corrcoef(force.T) - np.eye(3)
    assert np.max(np.abs(correlation)) < 0.15
    np.testing.assert_array_equal(np.abs(force), np.tile([10.0, 20.0, 30.0], (60_000, 1)))
    again = forcing(PRBS, length_s=6000.0).force(t, PLANAR, rng())
    np.testing.assert_array_equal(force, again)


def test_a_multisine_has_its_lines_and_a_low_crest() -> None:
    t = 0.1 * np.arange(4000)
    lines = []
    for axis in range(3):
        signal = multisine(t, 0.01, 0.2, axis, 3)
        assert np.max(np.abs(signal)) == pytest.approx(1.0)
        assert np.max(np.abs(signal)) / np.std(signal) < 2.1
        size = np.abs(np.fft.rfft(signal)) / len(t)
        present = np.flatnonzero(size > 1e-9)
        assert present.min() / 400.0 >= 0.01 - 1e-9
        assert present.max() / 400.0 <= 0.2 + 1e-9
        np.testing.assert_allclose(size[present], size[present[0]], rtol=1e-6)
        lines.append(set(present))
    assert sum(map(len, lines)) == len(set.union(*lines)) == 77  # 4 to 80 over 400 s


def test_axes_in_turn_are_excited_one_after_the_other() -> None:
    mission = forcing(Pulses((1.0,)), order="in_turn", length_s=40.0)
    assert mission.duration_s == 120.0
    t = 0.1 * np.arange(1200)
    force = mission.force(t, PLANAR, rng())
    for i, amplitude in enumerate((10.0, 20.0, 30.0)):
        on = (t >= 40 * i + 10 - 1e-9) & (t < 40 * i + 30 - 1e-9)
        np.testing.assert_allclose(force[:, i], amplitude * on)
    train = mission.split(t).train
    np.testing.assert_array_equal(train, (t + 1e-6) % 40.0 < 20.0)


def test_time_can_run_slower_and_an_offset_be_added() -> None:
    slow = forcing(
        Sines((1.0,), (5.0,)), axes=("surge",), time_scale=4.0, offset={"surge": 3.0, "yaw": 1.0}
    )
    assert slow.duration_s == 400.0
    t = 0.1 * np.arange(4000)
    force = slow.force(t, PLANAR, rng())
    np.testing.assert_allclose(force[:, 0], 3.0 + 10.0 * np.sin(2 * np.pi * t / 20.0), atol=1e-9)
    np.testing.assert_array_equal(force[:, 1], 0.0)
    np.testing.assert_array_equal(force[:, 2], 1.0)


def test_amplitudes_are_checked_against_the_thrusters() -> None:
    mission = forcing(PRBS, offset={"sway": 5.0})
    mission.check_limits({"surge": 10.0, "sway": 25.0, "yaw": 30.0}, 0.1)
    with pytest.raises(ConfigurationError, match=r"the force reaches 25 in sway, .* 24"):
        mission.check_limits({"surge": 10.0, "sway": 24.0, "yaw": 30.0}, 0.1)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: forcing(PRBS, length_s=0.0), "length_s"),
        (lambda: forcing(PRBS, time_scale=-1.0), "time_scale"),
        (lambda: forcing(PRBS, amplitude={"surge": 1.0}), "amplitude"),
        (lambda: forcing(PRBS, train_fraction=1.0), "train_fraction"),
        (lambda: forcing(PRBS).check(("surge",)), r"excitation\.axes: got sway"),
        (lambda: Prbs(0.0, 1.0), "shortest_s must be at least"),
        (lambda: Prbs(3.0, 2.0), "shortest_s must be at most longest_s"),
        (lambda: Multisine(0.1, 0.1), "lowest_hz must be positive and below"),
        (lambda: Sines((1.0,), ()), "periods_s must be 1 positive numbers"),
        (lambda: Sines((1.0,), (0.0,)), "periods_s must be 1 positive numbers"),
        (lambda: multisine(T[:100], 0.001, 0.05, 0, 1), "no line between"),
        (lambda: Ramp(0.0), "length_s must be positive, got 0"),
        (lambda: Legs((), 10.0), "legs: got 0 in 10 s"),
    ],
)
def test_what_cannot_be_sailed_is_refused(make: Callable[[], Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        make()


def test_a_closed_loop_keeps_its_controller_and_gets_the_force_as_well() -> None:
    mission = forcing(PRBS, loop="closed")
    assert not mission.open_loop
    assert mission.steering(PLANAR, 0.1) is None
    parameters, _ = mission.guidance(T, np.array([1.0, 2.0, 0.3]))
    np.testing.assert_array_equal(parameters.setpoints[7], [1.0, 2.0, 0.3])  # type: ignore[attr-defined]
    force = mission.force(T, PLANAR, rng())
    assert force is not None
    assert np.all(force[:, 0] != 0.0)
    waypoints = composed().excitation
    assert waypoints.force(T, PLANAR, rng()) is None
    assert not waypoints.open_loop


def test_a_signal_beside_way_points_lasts_as_long_as_these() -> None:
    mission = composed("excitation=prbs_waypoints").excitation
    assert mission.duration_s == mission.base.duration_s == 720.0
    parameters, _ = mission.guidance(T, np.zeros(3))
    expected, _ = mission.base.guidance(T, np.zeros(3))
    np.testing.assert_array_equal(parameters.setpoints, expected.setpoints)


def test_legs_push_and_counter_push() -> None:
    legs = Legs(((1.0, 0.0), (0.0, 0.5), (-1.0, -1.0)), 60.0)
    ahead, aside = (legs.sample(T, axis, 2, rng()) for axis in range(2))
    assert ahead[[0, 99, 100, 199, 200, 399, 400, 500, 599]].tolist() == [
        1.0, 1.0, -1.0, -1.0, 0.0, 0.0, -1.0, 1.0, 1.0
    ]  # fmt: skip
    assert set(aside[200:300]) == {0.5}
    for values in (ahead, aside):  # every leg takes back the momentum that it gave
        assert np.sum(values) == pytest.approx(0.0)
        assert not np.any(values[600:])


def test_a_ramp_rises_and_falls() -> None:
    ramp = Ramp(60.0).sample(T, 0, 1, rng())
    assert ramp[[0, 150, 300, 450, 600, 900]] == pytest.approx([0.0, 0.5, 1.0, 0.5, 0.0, 0.0])
    assert np.trapezoid(ramp, T) == pytest.approx(30.0, abs=1e-6)


def test_shares_are_by_axis() -> None:
    shared = SharedSignal(Steady(), (0.5, 0.0, -1.0))
    assert [shared.sample(T, axis, 3, rng())[0] for axis in range(3)] == [0.5, 0.0, -1.0]
