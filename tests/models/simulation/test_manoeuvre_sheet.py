"""Measures of manoeuvres on motions whose measures are known, and the criteria of the IMO."""

import numpy as np
import pytest

from seatrial.models.errors import RecordingError
from seatrial.models.notation import OrderedManoeuvre
from seatrial.models.simulation.manoeuvre_sheet import (
    DEVIATION_SHARE,
    SheetEntry,
    Track,
    drawn_values,
    interval,
    limits,
    reverse_spiral,
    sheet,
    spiral,
    stop,
)
from seatrial.models.vessel.basis import Array

ZIGZAG = OrderedManoeuvre("zigzag")


def track(t: Array, psi: Array, helm: Array, speed: float | Array = 2.0) -> Track:
    """A motion along its heading; a length of 10 m."""
    speeds = np.broadcast_to(np.asarray(speed, dtype=float), t.shape)
    ahead = np.concatenate([[0.0], np.diff(t)]) * speeds
    north, east = np.cumsum(ahead * np.cos(psi)), np.cumsum(ahead * np.sin(psi))
    return Track(t, north, east, psi, helm, np.abs(speeds), 10.0)


def spiral_track(rate_of: "dict[str, float]", helms_deg: Array, hold_s: float = 100.0) -> Track:
    """A ship that takes the steady rate of its branch at once."""
    t = np.arange(0.0, hold_s * len(helms_deg), 0.5)
    k = (t // hold_s).astype(int)
    helm = np.radians(helms_deg)[k]
    rate = np.zeros_like(t)
    side = np.sign(helms_deg[0])
    for i in range(len(t)):  # rate = gain delta + jump side, which changes beyond the fold
        if abs(helm[i]) > np.radians(rate_of["fold_deg"]):
            side = np.sign(helm[i])
        rate[i] = rate_of["gain"] * helm[i] + side * rate_of["jump"]
    return track(t, np.cumsum(0.5 * rate), helm)


def test_limits_of_the_overshoot_over_the_ratio_of_length_to_speed() -> None:
    """MSC.137(76): 10 and 25 degrees below 10 s, 20 and 40 from 30 s, lines between."""
    expected = {5: (10, 25), 10: (10, 25), 20: (15, 32.5), 30: (20, 40), 60: (20, 40)}
    for ratio, overshoots in expected.items():
        allowed = limits("zigzag", 10.4, 10.0, ratio)
        assert (allowed["first overshoot"], allowed["second overshoot"]) == overshoots


def test_a_value_on_its_limit_passes_and_one_not_reached_has_no_verdict() -> None:
    assert SheetEntry("advance", 4.5, "L", 4.5).verdict == "pass"
    assert SheetEntry("advance", 4.51, "L", 4.5).verdict == "fail"
    assert SheetEntry("advance", np.nan, "L", 4.5).verdict is None
    assert SheetEntry("advance", 1.0, "L").verdict is None
    assert SheetEntry("advance", 4.4, "L", 4.5, 4.3, 4.6).verdict == "not settled"
    assert SheetEntry("advance", 4.7, "L", 4.5, 4.6, 4.8).verdict == "fail"


def test_the_scale_of_a_model_enters_the_ratio_by_its_root() -> None:
    t = np.arange(0.0, 100.0, 0.1)
    circle = track(t, np.maximum(t - 10.0, 0.0) * 0.1, np.radians(35.0) * (t > 10.0))
    assert sheet(circle).length_over_speed_s == pytest.approx(5.0)
    assert sheet(circle, scale=36.0).length_over_speed_s == pytest.approx(30.0)


def test_a_turn_with_a_pull_out_keeps_its_steady_circle_and_has_a_residual_rate() -> None:
    """Two circles at 0.1 rad/s, then 0.02 rad/s remain."""
    t = np.arange(0.0, 500.0, 0.1)
    rate = np.where(t < 10.0, 0.0, np.where(t < 200.0, 0.1, 0.02))
    helm = np.radians(35.0) * ((t >= 10.0) & (t < 200.0))
    turned = sheet(track(t, np.cumsum(0.1 * rate), helm)).values
    assert turned["steady diameter"] == pytest.approx(2.0 * 2.0 / 0.1 / 10.0, rel=1e-3)
    assert turned["residual yaw rate"] == pytest.approx(np.degrees(0.02), rel=1e-6)


def test_the_loop_of_a_spiral_is_where_the_rate_jumps() -> None:
    there = np.arange(15.0, -16.0, -2.5)
    helms = np.concatenate([there, there[-2::-1]])
    unstable = {"gain": 0.05, "jump": 0.01, "fold_deg": 4.0}
    stable = {"gain": 0.05, "jump": 0.0, "fold_deg": 4.0}
    loop = spiral(spiral_track(unstable, helms))
    assert 5.0 < loop["width of the loop"] < 10.0  # the fold at +-4 degrees, steps of 2.5
    assert loop["residual yaw rate"] == pytest.approx(np.degrees(0.01), rel=1e-6)
    none = spiral(spiral_track(stable, helms))
    assert none["width of the loop"] == pytest.approx(0.0, abs=1e-9)
    assert none["residual yaw rate"] == pytest.approx(0.0, abs=1e-9)


def test_a_reverse_spiral_shows_the_fold() -> None:
    """delta = -a r + b r^3 is folded between -r_f and r_f, r_f^2 = a / (3 b)."""
    a, b, hold = 2.0, 4000.0, 100.0
    rates = np.linspace(0.04, -0.04, 33)
    t = np.arange(0.0, hold * len(rates), 0.5)
    rate = rates[(t // hold).astype(int)]
    folded = track(t, np.cumsum(0.5 * rate), -a * rate + b * rate**3)
    r_f = np.sqrt(a / (3.0 * b))
    width = 2.0 * (a * r_f - b * r_f**3)
    found = reverse_spiral(folded)
    assert found["width of the loop"] == pytest.approx(np.degrees(width), rel=0.02)
    assert found["residual yaw rate"] == pytest.approx(np.degrees(np.sqrt(a / b)), rel=0.05)
    straight = track(t, np.cumsum(0.5 * rate), a * rate)
    assert reverse_spiral(straight)["width of the loop"] == pytest.approx(0.0, abs=1e-9)


def test_a_stop_under_constant_deceleration() -> None:
    """From 2 m/s with 0.02 m/s^2: 100 m in 100 s, along the course."""
    t = np.arange(0.0, 200.0, 0.1)
    speed = np.where(t < 20.0, 2.0, 2.0 - 0.02 * (t - 20.0))
    ended = stop(track(t, np.full_like(t, 0.5), np.where(t < 20.0, 1.0, -1.0), speed))
    assert ended["track reach"] == pytest.approx(10.0, rel=5e-3)
    assert ended["head reach"] == pytest.approx(10.0, rel=5e-3)
    assert ended["lateral deviation"] == pytest.approx(0.0, abs=1e-9)
    assert ended["time to stop"] == pytest.approx(100.0, abs=0.2)
    moving = stop(track(t, np.zeros_like(t), np.where(t < 20.0, 1.0, -1.0), 2.0))
    assert np.isnan(moving["track reach"])


def test_a_half_circle_ends_a_diameter_aside_on_the_reciprocal() -> None:
    t = np.arange(0.0, 10.0 + 10.0 * np.pi, 0.01)
    psi = np.clip(0.1 * (t - 10.0), 0.0, np.pi)
    motion, ordered = track(t, psi, np.where(t < 10.0, 0.0, 0.5)), OrderedManoeuvre("williamson")
    turned = sheet(motion, ordered).values
    assert turned["offset from the track"] == pytest.approx(4.0, rel=1e-2)
    assert turned["error of the heading"] == pytest.approx(0.0, abs=0.1)


def test_intervals_are_the_quantiles_of_the_draws() -> None:
    """Circles of radius U / r: quantiles of the diameters' deviations, over the share."""
    t = np.arange(0.0, 400.0, 0.1)
    deviations = np.random.default_rng(0).normal(0.0, 0.01, 200)

    def sail(rate: float) -> Track:
        return track(t, np.maximum(t - 10.0, 0.0) * rate, np.radians(35.0) * (t > 9.95))

    draws = [sail(0.1 + DEVIATION_SHARE * deviation) for deviation in deviations]
    own, quantity = sheet(sail(0.1)).values, "steady diameter"
    values = drawn_values(own, draws, OrderedManoeuvre("turn"))[quantity]
    low, high = interval(own[quantity], values)
    diameter = 2.0 * 2.0 / 0.1 / 10.0
    drawn = 2.0 * 2.0 / (0.1 + DEVIATION_SHARE * deviations) / 10.0
    expected = diameter + np.quantile(drawn - diameter, [0.05, 0.95]) / DEVIATION_SHARE
    np.testing.assert_allclose((low, high), expected, rtol=1e-3)
    first_order = diameter * (1.0 - np.quantile(deviations, [0.95, 0.05]) / 0.1)
    np.testing.assert_allclose((low, high), first_order, rtol=2e-2)
    assert np.isnan(interval(diameter, np.array([np.nan]))[0])


def zigzag(angle_deg: float) -> Track:
    """A sine of the heading from 20 s on, with the helm of a recording."""
    t = np.arange(0.0, 120.0, 0.1)
    phase = 2.0 * np.pi * np.maximum(t - 20.0, 0.0) / 40.0
    helm = np.radians(10.0) * np.sign(np.cos(phase)) * (t > 15.0)
    return track(t, np.radians(angle_deg) * np.sin(phase), helm)


def test_an_overshoot_that_only_a_drawn_model_reaches_has_no_interval() -> None:
    """The helm of a recording: the model's own track turns away at the third order."""
    drawn = zigzag(14.0)
    away = track(drawn.t, drawn.psi + 0.05 * np.maximum(drawn.t - 80.0, 0.0), drawn.helm)
    known, reached = (sheet(motion, ZIGZAG).values for motion in (away, drawn))
    assert reached.keys() - known.keys()
    assert drawn_values(known, [away, drawn], ZIGZAG).keys() == known.keys()


def test_the_initial_turning_of_a_model_is_to_the_recorded_heading() -> None:
    """Under the helm of a recording a model that turns less is at 14 degrees later, or never."""

    def path(angle_deg: float, turn_deg: float | None) -> float:
        ordered = OrderedManoeuvre("zigzag", turn_deg=turn_deg)
        return sheet(zigzag(angle_deg), ordered).values["initial turning"]

    until = 20.0 + 40.0 / (2.0 * np.pi) * np.arcsin(14.0 / 16.0)
    assert path(16.0, 14.0) == pytest.approx(2.0 * (until - 15.0) / 10.0, abs=0.05)
    assert path(16.0, None) > path(16.0, 14.0)
    assert np.isnan(path(12.0, 14.0))
    found = sheet(zigzag(16.0), OrderedManoeuvre("zigzag", turn_deg=12)).values
    assert found["first overshoot"] == pytest.approx(4.0, abs=0.1)


def test_a_helm_that_does_not_move_is_refused() -> None:
    t = np.arange(0.0, 10.0, 0.1)
    with pytest.raises(RecordingError, match="helm does not move"):
        sheet(track(t, 0.0 * t, 0.0 * t), OrderedManoeuvre("turn"))
