"""Predictive control in the loop: previews, limits, failures, and the compiled step."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from seatrial.models.control.horizon import Solver
from seatrial.models.control.mpc import _prepare
from seatrial.models.errors import ConfigurationError
from tests.models.control.sailing import (
    INCREMENT_WEIGHT,
    KALMAN,
    LIMITS,
    appendix_k,
    mpc,
    note,
    ship,
    steady,
    voyage,
    weather,
)

KINDS = ("standard", "reduced", "condensed", "integral")


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_compiled_step_is_the_problem_in_python(kind: str) -> None:
    """Where no limit is met the linear law and the quadratic program command the same."""
    n = 300
    met = weather(n, wind_ned=steady(n, 6.0, 2.0), current_ned=steady(n, 0.3, 1.0))
    wide = tuple(100.0 * limit for limit in LIMITS)
    weight = tuple(1e4 * w for w in (INCREMENT_WEIGHT if kind == "integral" else (70, 100, 50)))
    options = {"limits": wide, "input_weight": weight, "horizon": 40}
    compiled, _ = voyage(mpc(kind, limited=False, **options), appendix_k(n), met=met)
    python, _ = voyage(mpc(kind, limited=True, **options), appendix_k(n), met=met)
    assert np.max(np.abs(python.log.tau) / wide) < 1.0
    np.testing.assert_allclose(compiled.log.tau / LIMITS, python.log.tau / LIMITS, atol=1e-6)
    assert len(compiled.step_times) < 3 < len(python.step_times)


def test_the_forecast_of_an_unknown_force_decays_as_its_process() -> None:
    """d_i = exp(-i h / T) b over the horizon; a random walk keeps its value."""
    bias, steps = np.array([1e4, -2e4, 3e5]), 10
    for time_constant_s, decay in ((20.0, np.exp(-1.0 / 20.0)), (None, 1.0)):
        kalman = replace(KALMAN, estimate_bias=True, bias_time_constant_s=time_constant_s)
        parameters, past = mpc("condensed", limited=False, kalman=kalman).build(ship(), 1.0)
        past.bias[:] = bias
        _prepare(parameters, past, *np.zeros((3, 3)))
        first = len(past.x) + 3 * steps
        forecast = parameters.theta[first : first + 3 * steps].reshape(steps, 3) * LIMITS
        expected = decay ** np.arange(steps)[:, None] * bias
        np.testing.assert_allclose(forecast, expected, rtol=1e-12)


@pytest.mark.parametrize("kind", ["condensed", "integral"])
def test_a_preview_moves_before_the_step_and_none_does_not(kind: str) -> None:
    n = 1200
    tracks = {
        preview: voyage(mpc(kind, horizon=40, preview=preview), appendix_k(n))[0].log
        for preview in ("none", "setpoint")
    }
    step = int(np.argmax(tracks["none"].eta_d[:, 0] > 0.0))
    early = {p: (log.eta[step] - log.eta[step - 10]) / log.eta_d[step] for p, log in tracks.items()}
    assert np.all(np.abs(early["none"]) < 1e-3)
    assert np.all(early["setpoint"] > 0.05)
    errors = {p: np.mean(np.abs(log.eta_d - log.eta), axis=0) for p, log in tracks.items()}
    assert np.all(errors["setpoint"] < 0.7 * errors["none"])


def test_a_wind_that_is_known_ahead_disturbs_less() -> None:
    n = 300
    wind = steady(n, 4.0, 1.2)
    wind[150:] *= 3.0
    errors = [
        np.sqrt(np.mean(np.square(
            voyage(mpc("integral", preview=preview), np.zeros((n, 3)),
                   met=weather(n, wind_ned=wind))[0].log.eta), axis=0))
        for preview in ("setpoint", "setpoint_and_wind")
    ]  # fmt: skip
    assert np.all(errors[1] < 0.7 * errors[0])


def test_an_estimated_bias_takes_the_place_of_integral_action() -> None:
    """Without both a current leaves an error."""
    n = 1200
    met = weather(n, current_ned=np.tile([0.5, -0.5], (n, 1)))
    errors = []
    for estimated in (False, True):
        controller = mpc("condensed", horizon=40, kalman=replace(KALMAN, estimate_bias=estimated))
        log = voyage(controller, appendix_k(n), met=met)[0].log
        errors.append(np.abs((log.eta_d - log.eta)[1140:].mean(axis=0)))
    assert np.all(errors[0][:2] > 0.02)
    assert np.all(errors[1] < [0.1, 0.1, np.radians(0.1)])


def test_limits_and_rates_are_kept() -> None:
    n = 300
    rates = (1e4, 2e4, 1e6)
    met = weather(n, wind_ned=steady(n, 10.0, 1.0))
    sailed, state = voyage(mpc("integral", rate_limits=rates), appendix_k(n), met=met)
    tau = sailed.log.tau
    assert np.all(np.abs(tau) <= np.array(LIMITS) * (1 + 1e-9))
    change = np.abs(np.diff(tau, axis=0))
    # the last command is seen from axes that turned since
    assert np.all(change <= np.array(rates) * 1.0 + 0.01 * np.array(LIMITS))
    assert np.max(change / rates) > 0.99
    assert state.failures[0] == 0


def test_a_failed_problem_holds_the_last_command_and_is_counted(monkeypatch: Any) -> None:
    n = 100
    solve, calls = Solver.solve, []

    def sometimes(self: Solver, theta: Any) -> Any:
        calls.append(1)
        return None if 40 <= len(calls) < 60 else solve(self, theta)

    monkeypatch.setattr(Solver, "solve", sometimes)
    sailed, state = voyage(
        mpc("condensed"), appendix_k(n), met=weather(n, wind_ned=steady(n, 9, 1))
    )
    tau = sailed.log.tau
    assert state.failures[0] == 20
    np.testing.assert_array_equal(tau[39:59], np.tile(tau[38], (20, 1)))
    assert not np.array_equal(tau[59], tau[38])
    assert np.all(sailed.log.held == 0.0)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("limited", [True, False])
def test_what_is_not_a_number_never_reaches_the_vessel(kind: str, limited: bool) -> None:
    n = 120
    noise = np.zeros((n, 3))
    noise[30:40, 1] = np.nan
    noise[70] = np.inf
    wind = steady(n, 8.0, 1.0)
    wind_noise = np.zeros((n, 2))
    wind_noise[50:55] = np.nan  # an anemometer that fails
    met = weather(n, pose_noise=noise, wind_ned=wind, wind_noise=wind_noise)
    for estimator in ("kalman", "measured"):
        controller = mpc(kind, horizon=10, limited=limited, estimator=estimator)
        sailed, state = voyage(controller, np.zeros((n, 3)), met=met)
        assert np.all(np.isfinite(sailed.log.tau))
        assert np.all(np.isfinite(sailed.log.eta))
        # of the wind, and of the pose where it is not filtered
        assert 5 <= state.failures[0] <= (5 if estimator == "kalman" else 18)
        assert np.all(np.isfinite(state.x))
        assert np.all(np.abs(sailed.log.eta[-1, :2]) < 5.0)


def test_the_reported_radius_is_the_loops_own() -> None:
    """1.025 with the weights of appendix K and 10 steps: the voyage grows, in the calm."""
    K = {"error_weight": (1e2, 1e0, 1e3), "horizon": 10}
    radius = note(mpc("integral", **K), "spectral_radius")
    assert radius == pytest.approx(1.025, abs=5e-4)
    assert note(mpc("integral"), "spectral_radius") < 1.0
    start = np.array([1e-6, 0.0, 0.0])
    controller = mpc("integral", limited=False, wind=None, estimator="measured", **K)
    sailed, _ = voyage(controller, np.zeros((700, 3)), start=start, plant=ship(drag=0.0))
    size = np.abs(sailed.log.eta[:, 0])
    growth = (np.max(size[600:]) / np.max(size[200:300])) ** (1.0 / 400.0)
    assert growth == pytest.approx(radius, abs=2e-3)


@pytest.mark.parametrize("kind", KINDS)
def test_the_radius_is_that_of_the_simulated_design_model(kind: str) -> None:
    controller = mpc(kind, limited=False, wind=None, estimator="measured", horizon=30)
    plant = ship(drag=0.0)
    start = np.array([1.0, 0.0, 0.0])
    sailed, _ = voyage(controller, np.zeros((400, 3)), start=start, plant=plant, model=plant)
    size = np.abs(sailed.log.eta[:, 0]) + np.abs(sailed.log.nu[:, 0])
    decay = (np.max(size[300:350]) / np.max(size[150:200])) ** (1.0 / 150.0)
    assert decay <= note(controller, "spectral_radius", plant) + 5e-3


@pytest.mark.parametrize(
    ("kind", "changes", "message"),
    [
        ("condensed", {"horizon": 0}, "horizon must be at least 1"),
        ("integral", {"rate_limits": (1.0, 0.0, 1.0)}, "rate_limits must be 3 numbers, positive"),
        ("reduced", {"limits": (1.0, 1.0, -1.0)}, "limits must be 3 numbers, positive"),
        ("standard", {"error_weight": (-1.0, 1.0, 1.0)}, "error_weight must be 3 numbers"),
    ],
)
def test_wrong_options_are_refused(kind: str, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        mpc(kind, **changes)
