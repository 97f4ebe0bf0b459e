"""Metrics against hand-worked numbers."""

import numpy as np
import pytest

from seatrial.models.simulation import metrics


def test_means() -> None:
    error = np.array([[1.0, -2.0], [-3.0, 0.0]])
    np.testing.assert_allclose(metrics.mean_square(error), [5.0, 2.0])
    np.testing.assert_allclose(metrics.mean_absolute(error), [2.0, 1.0])


def test_tracking_errors() -> None:
    reference = np.array([[3.0, 4.0, np.pi - 0.1]])
    pose = np.array([[0.0, 0.0, -np.pi + 0.1]])
    assert metrics.position_error(reference, pose) == pytest.approx([5.0])
    assert metrics.heading_error(reference, pose) == pytest.approx([-0.2])
    assert metrics.position_error(np.array([[2.0]]), np.array([[-1.0]])) == pytest.approx([3.0])


def test_power_and_iaew() -> None:
    tau, nu = np.array([[10.0, -2.0, 3.0]]), np.array([[1.0, 6.0, -2.0]])
    assert metrics.position_power(tau, nu) == pytest.approx([2.0])  # |10 - 12|
    assert metrics.heading_power(tau, nu) == pytest.approx([6.0])
    assert metrics.iaew(np.array([1.0, -1.0]), np.array([2.0, 3.0]), 0.5) == pytest.approx(2.5)


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
