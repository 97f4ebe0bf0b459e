"""The Kalman filter against the Riccati equation, another library, and what it should find."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from seatrial.models.control.estimator import Kalman, estimate, filter_gain, memory, observer_of
from seatrial.models.control.linear_design import design_model
from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import PLANAR
from seatrial.models.simulation.statespace import StateSpace
from seatrial.models.weather.current import Current
from seatrial.models.weather.disturbance import Disturbance
from tests.models.control.sailing import (
    KALMAN,
    LIMITS,
    WINDAGE,
    double_integrators,
    lqi,
    ship,
    steady,
    voyage,
    weather,
)


def random_system(seed: int) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(4, 4))
    A *= 0.95 / np.max(np.abs(np.linalg.eigvals(A)))
    C, G = rng.normal(size=(2, 4)), rng.normal(size=(4, 4))
    return A, C, G @ G.T, np.diag(rng.uniform(0.5, 2.0, 2))


@pytest.mark.parametrize("seed", range(5))
def test_the_filter_and_the_predictor_gain_are_told_apart(seed: int) -> None:
    """K = A M: the predictor's gain of python-control's dlqe, the filter's of MATLAB's."""
    A, C, Q, R = random_system(seed)
    M = filter_gain(A, C, Q, R)
    P = solve_discrete_are(A.T, C.T, Q, R)
    K = A @ P @ C.T @ np.linalg.inv(C @ P @ C.T + R)
    np.testing.assert_allclose(A @ M, K, rtol=1e-9, atol=1e-12)
    control: Any = pytest.importorskip("control")
    predictor, covariance, _ = control.dlqe(A, np.eye(4), C, Q, R)
    np.testing.assert_allclose(A @ M, predictor, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(covariance, P, rtol=1e-8)


def test_no_steady_state_is_refused() -> None:
    A = np.diag([2.0, 0.5])  # unstable and not observed
    with pytest.raises(ConfigurationError, match="no steady-state gain"):
        filter_gain(A, np.array([[0.0, 1.0]]), np.eye(2), np.eye(1))


def test_an_identified_models_own_gain_is_taken_back_to_the_filters() -> None:
    A, C, Q, R = random_system(2)
    K = A @ filter_gain(A, C, Q, R)
    B = np.random.default_rng(3).normal(size=(4, 2))
    model = StateSpace(A, B, C, np.zeros((2, 2)), 1.0, K=K)
    design = design_model(model, (1.0, 1.0), 1.0)
    M, _ = KALMAN.gains(design)
    np.testing.assert_allclose(M, filter_gain(A, C, Q, R), rtol=1e-8)
    for changes, message in (
        ({"kalman": replace(KALMAN, estimate_bias=True)}, "estimate_bias"),
        ({"estimator": "measured"}, "cannot be measured"),
    ):
        two = {"limits": (1.0,) * 2, "error_weight": (1.0,) * 2, "input_weight": (1.0,) * 2}
        with pytest.raises(ConfigurationError, match=message):
            lqi(wind=None, **two, **changes).build(model, 1.0)
    with pytest.raises(ConfigurationError, match="without innovations gain"):
        KALMAN.gains(design_model(replace(model, K=None), (1.0, 1.0), 1.0))


@pytest.mark.parametrize("axis", [0, 1])
def test_the_filter_follows_an_exact_model_exactly(axis: int) -> None:
    """No noise, its own model, every force known: the prediction is the motion."""
    n = 200
    setpoints = np.zeros((n, 3))
    setpoints[:, axis] = 5.0
    met = weather(n, wind_ned=steady(n, 9.0, axis * np.pi / 2))
    plant = double_integrators() + WINDAGE.table(("surge", "sway", "yaw"))
    controller = lqi(kalman=replace(KALMAN, measurement=(1e3, 1e3, 10.0)))  # hardly corrects
    sailed, state = voyage(controller, setpoints, model=double_integrators(), plant=plant, met=met)
    assert np.max(np.abs(sailed.log.eta[:, axis])) > 2.0
    np.testing.assert_allclose(state.x[:2], sailed.log.eta[-1, :2], atol=5e-3)
    np.testing.assert_allclose(state.x[3:5], sailed.log.nu[-1, :2], atol=5e-4)


def test_a_bias_is_estimated_and_turns_with_the_vessel() -> None:
    """A force that is fixed in NED stays one while the vessel turns a quarter."""
    n = 1500
    setpoints = np.zeros((n, 3))
    setpoints[600:, 2] = np.pi / 2
    force = np.tile([4e4, -6e4, 5e5], (n, 1))
    kalman = replace(KALMAN, estimate_bias=True)
    _, state = voyage(lqi(kalman=kalman), setpoints, met=weather(n, force_ned=force))
    np.testing.assert_allclose(state.bias, force[0], rtol=0.02)


def test_a_lost_measurement_is_left_out() -> None:
    n = 400
    noise = np.zeros((n, 3))
    noise[100:160] = np.nan  # a minute without a position
    sailed, state = voyage(lqi(), np.zeros((n, 3)), met=weather(n, pose_noise=noise))
    assert np.all(np.isfinite(sailed.log.tau))
    assert np.all(np.abs(sailed.log.eta[:, :2]) < 0.5)
    assert np.all(np.isfinite(state.x))


def test_the_measured_state_is_used_as_it_is() -> None:
    n = 50
    sailed, state = voyage(lqi(estimator="measured"), np.tile([1.0, 1.0, 0.1], (n, 1)))
    log = sailed.log
    c, s = np.cos(log.eta[-1, 2]), np.sin(log.eta[-1, 2])
    u, v, r = log.nu[-1]
    ned = [c * u - s * v, s * u + c * v, r]
    np.testing.assert_allclose(state.x, [*log.eta[-1], *ned], atol=1e-12)


MOMENT_NM, TIME_CONSTANT_S = 2e6, 60.0


def innovations(kalman: Kalman, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Innovations in heading, their expected deviation, and errors of the moment, each over n s.

    The vessel turns as the model of the filter says: a double integrator with white accelerations
    and the yaw moment of a slow current.
    """
    rng = np.random.default_rng(4)
    current = Current(0.0, 0.0, "slow", 0.0, TIME_CONSTANT_S, 1.0, MOMENT_NM)
    moment = Disturbance(current=current).realise(n, PLANAR, rng, rng, 1.0).force_ned[:, 2]
    acceleration = moment / 4.5e10 + KALMAN.process[2] * rng.standard_normal(n)
    rate = np.concatenate([[0.0], np.cumsum(acceleration)])
    heading = np.concatenate([[0.0], np.cumsum(rate[:-1] + 0.5 * acceleration)])
    observer = observer_of(design_model(double_integrators(), LIMITS, 1.0), "kalman", kalman)
    past, eta, rest = memory(6, 3, 3), np.zeros(3), np.zeros(3)
    errors = np.zeros((n, 2))
    for k in range(n):
        eta[2] = heading[k] + KALMAN.measurement[2] * rng.standard_normal()
        estimate(observer, past, eta, rest)
        past.instant[0] += 1
        errors[k] = observer.error[2], past.bias[2] - moment[k]
    expected = np.linalg.inv(np.eye(3) - observer.C @ observer.M) * np.square(KALMAN.measurement)
    return errors[:, 0], np.sqrt(expected[2, 2]), errors[:, 1]


def test_the_moment_of_a_current_in_the_model_of_the_filter() -> None:
    """With (2.9) in its model the filter is the optimal one: white innovations of known size."""
    n, start = 40_000, 1000
    walk = (0.0, 0.0, MOMENT_NM * np.sqrt(2.0 / TIME_CONSTANT_S))
    moved = replace(
        KALMAN, bias_walk=walk, estimate_bias=True, bias_time_constant_s=TIME_CONSTANT_S
    )
    found, deviation, error = (
        part[start:] if np.ndim(part) else part for part in innovations(moved, n)
    )
    count = n - start
    assert abs(np.mean(found)) < 4.0 * deviation / np.sqrt(count)
    assert np.std(found) == pytest.approx(deviation, rel=4.0 / np.sqrt(2.0 * count))
    for lag in (1, 2, 5, 10, 30, 60):
        correlation = np.mean(found[:-lag] * found[lag:]) / np.mean(found**2)
        assert abs(correlation) < 4.0 / np.sqrt(count)
    assert abs(np.mean(error)) < 4.0 * np.std(error) * np.sqrt(2.0 * TIME_CONSTANT_S / count)
    assert np.std(error) < 0.8 * MOMENT_NM
    blind = innovations(KALMAN, n)[0][start:]
    assert np.mean(blind[:-1] * blind[1:]) > 0.1 * np.mean(blind**2)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"process": (1.0, 0.0, 1.0)}, "process must be 3 numbers, positive"),
        ({"measurement": (1.0, 0.0, 1.0)}, "measurement must be 3 numbers, positive"),
        ({"bias_walk": (0.0, 0.0, 0.0)}, "3 numbers, one of them positive"),
        ({"bias_walk": (1.0, -1.0, 1.0)}, "bias_walk must not be negative"),
    ],
)
def test_wrong_deviations_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        replace(KALMAN, **changes)


def test_what_does_not_fit_the_vessel_is_refused() -> None:
    design = design_model(ship(), LIMITS, 1.0)
    with pytest.raises(ConfigurationError, match="got 1 numbers, expected 3"):
        Kalman((1.0,), (1.0,), (1.0,), False).gains(design)
    with pytest.raises(ConfigurationError, match="expected kalman for kalman"):
        observer_of(design, "measured", replace(KALMAN, estimate_bias=True))
