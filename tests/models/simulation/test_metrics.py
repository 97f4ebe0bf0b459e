"""Metrics against hand-worked numbers and signals whose figures are known."""

import numpy as np
import pytest
from scipy.signal import lti

from seatrial.models.simulation import metrics

H = 0.1


def test_tracking_errors() -> None:
    reference = np.array([[3.0, 4.0, np.pi - 0.1]])
    pose = np.array([[0.0, 0.0, -np.pi + 0.1]])
    assert metrics.position_error(reference, pose) == pytest.approx([5.0])
    assert metrics.heading_error(reference, pose) == pytest.approx([-0.2])
    assert metrics.position_error(np.array([[2.0]]), np.array([[-1.0]])) == pytest.approx([3.0])


def test_power() -> None:
    tau, nu = np.array([[10.0, -2.0, 3.0]]), np.array([[1.0, 6.0, -2.0]])
    assert metrics.position_power(tau, nu) == pytest.approx([2.0])  # |10 - 12|
    assert metrics.heading_power(tau, nu) == pytest.approx([6.0])


def test_the_curve_of_the_iaew_ends_at_its_value_and_has_its_slope() -> None:
    """IAEW = E W: its derivative is |e| W + E P, of (3.18); constant e and P make it |e| P t^2."""
    rng = np.random.default_rng(0)
    t = H * np.arange(1, 2001)
    error, power = np.sin(0.05 * t), 2.0 + np.cos(0.03 * t)
    curve = metrics.cumulative_iaew(error, power, H)
    assert curve[-1] == pytest.approx(metrics.iaew(error, power, H), rel=1e-12)
    integrals = H * np.cumsum(np.abs(error)), H * np.cumsum(power)
    slope = np.abs(error) * integrals[1] + integrals[0] * power
    np.testing.assert_allclose(np.gradient(curve, H)[1:-1], slope[1:-1], rtol=0.02, atol=1.0)
    constant = metrics.cumulative_iaew(np.full(2000, -3.0), np.full(2000, 5.0), H)
    np.testing.assert_allclose(constant, 15.0 * t**2, rtol=1e-12)
    assert np.all(np.diff(metrics.cumulative_iaew(rng.standard_normal(100), power[:100], H)) > 0.0)


def test_relative_errors_leave_out_what_is_truly_zero() -> None:
    errors = metrics.relative_errors(np.array([1.1, 0.5]), np.array([1.0, 0.0]))
    assert errors[0] == pytest.approx(0.1)
    assert np.isnan(errors[1])


def test_a_fit_better_than_the_truth_is_told_from_an_exact_one() -> None:
    mse = np.array([90.0, 99.5, 1e-12, 110.0])
    plant = np.array([100.0, 100.0, 1e-9, 100.0])
    variance = np.full(4, 1000.0)
    found = metrics.below_true_model(mse, plant, variance)
    assert found.tolist() == [True, False, False, False]


def mission(steps: list[float], seconds: float) -> tuple[np.ndarray, np.ndarray]:
    rows = round(seconds / H)
    setpoint = np.repeat(steps, rows)[:, None]
    return H * np.arange(len(setpoint)), setpoint


@pytest.mark.parametrize("damping", [0.2, 0.5, 0.7])
def test_a_second_order_step_has_its_textbook_figures(damping: float) -> None:
    t, setpoint = mission([0.0, 2.0], 100.0)
    _, response = lti([1.0], [1.0, 2.0 * damping, 1.0]).step(T=t[:1000])
    pose = 2.0 * np.concatenate([np.zeros(1000), response])[:, None]
    where = metrics.stands(setpoint, 300)
    found = metrics.step_responses(setpoint, pose, where, H, 0)
    peak = 100.0 * np.exp(-np.pi * damping / np.sqrt(1.0 - damping**2))
    assert found["overshoot"][0] == pytest.approx(peak, rel=1e-2)
    envelope = -np.log(0.05 * np.sqrt(1.0 - damping**2)) / damping
    assert 0.6 * envelope < found["settling_time"][0] <= envelope + H
    share = pose[1000:, 0] / 2.0
    rise = (np.argmax(share >= 0.9) - np.argmax(share >= 0.1)) * H
    assert found["rise_time"][0] == pytest.approx(rise)
    assert found["early_share"][0] == pytest.approx(0.0, abs=1e-9)


def test_a_first_order_step_rises_in_its_time_constants() -> None:
    t, setpoint = mission([1.0, -3.0], 100.0)
    pose = np.where(t < 100.0, 1.0, -3.0 + 4.0 * np.exp(-(t - 100.0) / 5.0))[:, None]
    found = metrics.step_responses(setpoint, pose, metrics.stands(setpoint, 300), H, 0)
    assert found["rise_time"][0] == pytest.approx(5.0 * np.log(9.0), abs=2 * H)
    assert found["settling_time"][0] == pytest.approx(5.0 * np.log(20.0), abs=2 * H)
    assert found["overshoot"][0] == 0.0


def test_what_moves_before_the_step_is_told() -> None:
    _, setpoint = mission([0.0, 1.0, 1.0, 0.0], 50.0)
    pose = np.clip((np.arange(len(setpoint)) * H - 45.0) / 20.0, 0.0, 1.0)[:, None]
    where = metrics.stands(setpoint, 300)
    assert where == [slice(0, 500), slice(500, 1500), slice(1500, 2000)]
    found = metrics.step_responses(setpoint, pose, where[:2], H, 0)
    assert found["early_share"][0] == pytest.approx(25.0)


def test_what_never_settles_or_never_steps_is_not_a_number() -> None:
    _, setpoint = mission([0.0, 1.0], 50.0)
    both = np.column_stack([setpoint[:, 0], np.zeros(len(setpoint))])
    pose = np.column_stack([1.5 * both[:, 0], both[:, 1]])
    found = metrics.step_responses(both, pose, metrics.stands(both, 300), H, 0)
    assert np.isnan(found["settling_time"][0])
    assert found["overshoot"][0] == pytest.approx(50.0)
    assert all(np.isnan(values[1]) for values in found.values())


def test_the_preview_of_the_next_step_is_left_out() -> None:
    """The error of the last 4 s is the next step's preview; before it, it is 0.2."""
    _, setpoint = mission([0.0, 1.0], 120.0)
    error = np.full((2400, 1), -0.2)
    error[1160:1200] = 50.0
    where = metrics.stands(setpoint, 300)
    assert metrics.steady_state_error(error[:2400], where, H, 40)[0] == pytest.approx(0.2)
    assert metrics.steady_state_error(error, where, H, 0)[0] > 0.4
    assert np.isnan(metrics.steady_state_error(error[:500], [slice(0, 500)], H, 0)[0])


def test_noise_about_the_set_point_is_no_steady_error() -> None:
    t, setpoint = mission([3.0], 120.0)
    error = 0.5 * np.sin(2.0 * np.pi * t / 6.0)[:, None]
    steady = metrics.steady_state_error(error, metrics.stands(setpoint, 300), H, 0)
    assert steady[0] == pytest.approx(0.0, abs=1e-12)


def test_a_moving_set_point_is_no_stand() -> None:
    setpoint = np.concatenate([np.zeros(400), np.linspace(0.0, 1.0, 100), np.ones(400)])[:, None]
    where = metrics.stands(setpoint, 300)
    assert [stand.stop - stand.start for stand in where] == [401, 401]
    found = metrics.step_responses(setpoint, setpoint, where, H, 0)
    assert all(np.all(np.isnan(values)) for values in found.values())  # no step between them
