"""Measures of manoeuvres: of circles of known size, and of motion that is no manoeuvre."""

import math

import numpy as np
import pytest

from seatrial.runner.compare.benchmark.manoeuvre_scores import measures
from seatrial.runner.database.records import Series

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


def test_what_is_no_manoeuvre_has_no_measures() -> None:
    prediction, recording = series(20.0, 22.0)
    recording.columns["delta"][:] = 0.0  # the helm does not move
    assert measures(prediction, recording, CONFIG, "turn") == []
    assert measures(prediction, series(20.0, 22.0)[1], {"vessel": {}}, "turn") == []
