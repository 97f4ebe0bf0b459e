"""Measures of manoeuvres: of circles of known size, and of motion that is no manoeuvre."""

import math

import numpy as np
import pytest

from seatrial.runner.compare.benchmark.manoeuvre_scores import measures
from seatrial.runner.record.rows import Series

LENGTH = 7.0
CONFIG = {"vessel": {"length_m": LENGTH}, "excitation": {}}
T = np.arange(0.0, 400.0, 0.1)
BEGIN = 20.0  # [s] of the turn


def circle(radius: float) -> dict[str, np.ndarray]:
    """A straight approach northwards at 1 m/s, then a circle to starboard."""
    turned = np.maximum(T - BEGIN, 0.0) / radius
    ahead = np.minimum(T, BEGIN) + radius * np.sin(turned)
    return {
        "x": ahead, "y": radius * (1.0 - np.cos(turned)), "psi": turned,
        "surge": np.ones_like(T), "sway": np.zeros_like(T),
    }  # fmt: skip


def series(measured: float, predicted: float) -> tuple[Series, Series]:
    """Series `prediction` and `recording` of circles of these radii [m]."""
    columns = {"t": T, "start": 1.0 * (T == 0.0), **circle(measured)}
    columns |= {f"{name}_identified": values for name, values in circle(predicted).items()}
    recorded = {"t": T, "delta": np.radians(35.0) * (T >= BEGIN)}
    return (
        Series("prediction", columns, dict.fromkeys(columns, "")),
        Series("recording", recorded, dict.fromkeys(recorded, "")),
    )


def test_the_advance_and_the_diameters_of_circles() -> None:
    prediction, recording = series(20.0, 22.0)
    found = {one.quantity: one for one in measures(prediction, recording, CONFIG, "turn")}
    for quantity, radii in (("advance", 1.0), ("transfer", 1.0), ("tactical diameter", 2.0)):
        one = found[quantity]
        assert one.measured == pytest.approx(radii * 20.0 / LENGTH, rel=0.01)
        assert one.predicted == pytest.approx(radii * 22.0 / LENGTH, rel=0.01)
        assert one.error == pytest.approx(0.1, abs=0.01)
    assert "helm" not in found  # which is ordered


def test_what_is_not_reached_is_infinitely_wrong() -> None:
    prediction, recording = series(20.0, 1e4)  # hardly turns
    found = {one.quantity: one for one in measures(prediction, recording, CONFIG, "turn")}
    assert math.isnan(found["tactical diameter"].predicted)
    assert found["tactical diameter"].error == math.inf
    prediction.columns["x_identified"][-1] = np.nan  # diverges
    assert all(math.isnan(one.predicted) for one in measures(prediction, recording, CONFIG, "turn"))


def test_initial_turning_is_compared_to_the_same_heading() -> None:
    """Under the recorded helm a model that turns to 12 degrees does not reach the recorded 14."""
    phase = 2.0 * np.pi * np.maximum(T - BEGIN, 0.0) / 40.0
    helm = np.radians(10.0) * np.sign(np.cos(phase)) * (T > BEGIN - 5.0)

    def motion(angle_deg: float) -> dict[str, np.ndarray]:
        psi, zero = np.radians(angle_deg) * np.sin(phase), np.zeros_like(T)
        path = {"x": np.cumsum(0.1 * np.cos(psi)), "y": np.cumsum(0.1 * np.sin(psi))}
        return path | {"psi": psi, "surge": zero + 1.0, "sway": zero}

    columns = {"t": T, "start": 1.0 * (T == 0.0), **motion(14.5)}
    columns |= {f"{name}_identified": values for name, values in motion(12.5).items()}
    prediction = Series("prediction", columns, dict.fromkeys(columns, ""))
    recording = Series("recording", {"t": T, "delta": helm}, {"t": "", "delta": ""})
    found = {one.quantity: one for one in measures(prediction, recording, CONFIG, "zigzag")}
    assert math.isnan(found["initial turning"].predicted)
    assert math.isfinite(found["first overshoot"].predicted)


def test_what_is_no_manoeuvre_has_no_measures() -> None:
    prediction, recording = series(20.0, 22.0)
    recording.columns["delta"][:] = 0.0  # the helm does not move
    assert list(measures(prediction, recording, CONFIG, "turn")) == []
    assert list(measures(prediction, series(20.0, 22.0)[1], {"vessel": {}}, "turn")) == []
