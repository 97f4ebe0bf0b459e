"""Rotations and the reference in body axes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import (
    body_rates,
    euler_zyx,
    pose_jacobian,
    quaternion_rate,
    reference_in_body,
    reference_in_body_kernel,
    rotation,
    wrap,
)

angles = st.floats(-20.0, 20.0)


def body_velocity(eta_dot: Array, psi: float) -> Array:
    """nu = R(psi)' eta_dot for planar motion; eta_dot NED [m/s, m/s, rad/s], shape (3,)."""
    return np.asarray(rotation(psi).T @ eta_dot, dtype=np.float64)


@given(angles)
def test_rotations_are_orthogonal(psi: float) -> None:
    r = rotation(psi)
    np.testing.assert_allclose(r.T @ r, np.eye(3), atol=1e-14)
    assert np.linalg.det(r) == pytest.approx(1.0)


@given(angles, angles)
def test_rotations_compose(a: float, b: float) -> None:
    np.testing.assert_allclose(rotation(a) @ rotation(b), rotation(a + b), atol=1e-12)


@given(angles)
def test_wrapping_keeps_the_direction(angle: float) -> None:
    wrapped = wrap(angle)
    assert -np.pi < wrapped <= np.pi
    assert np.cos(wrapped) == pytest.approx(np.cos(angle), abs=1e-9)
    assert np.sin(wrapped) == pytest.approx(np.sin(angle), abs=1e-9)


@pytest.mark.parametrize("reference", [reference_in_body, reference_in_body_kernel])
def test_body_reference_is_the_derivative_of_the_path(reference) -> None:  # type: ignore[no-untyped-def]
    def path(t: float) -> np.ndarray:
        return np.array([np.sin(t), 2.0 * np.cos(0.7 * t), 0.3 * t**2])

    t, h = 1.3, 1e-4
    rate = (path(t + h) - path(t - h)) / (2 * h)
    acceleration = (path(t + h) - 2 * path(t) + path(t - h)) / h**2
    eta_d, nu_d, nu_dot_d = np.empty(3), np.empty(3), np.empty(3)
    reference(True, np.column_stack([path(t), rate, acceleration]), eta_d, nu_d, nu_dot_d)
    np.testing.assert_allclose(nu_d, body_velocity(rate, path(t)[2]))
    ahead, behind = (
        body_velocity((path(s + h) - path(s - h)) / (2 * h), path(s)[2]) for s in (t + h, t - h)
    )
    np.testing.assert_allclose(nu_dot_d, (ahead - behind) / (2 * h), atol=1e-5)


def test_angular_velocity_is_that_of_the_rotation_at_every_pitch() -> None:
    """A dive through 86 degrees of pitch and past the vertical, where roll and yaw jump."""
    h, n = 0.01, 6000
    t = h * np.arange(n)
    omega = np.column_stack([0.02 * np.sin(0.7 * t), 0.2 + 0.1 * np.cos(t), 0.005 * np.sin(t)])
    q = np.empty((n, 4))
    q[0] = 1.0, 0.0, 0.0, 0.0
    rate, mean = np.empty(4), 0.5 * (omega[1:] + omega[:-1])
    for k in range(n - 1):
        quaternion_rate(q[k], *mean[k], rate)
        middle = q[k] + 0.5 * h * rate
        quaternion_rate(middle, *mean[k], rate)
        q[k + 1] = (q[k] + h * rate) / np.linalg.norm(q[k] + h * rate)
    attitude = euler_zyx(q)
    assert np.degrees(np.max(np.abs(attitude[:, 1]))) > 86.0
    found = body_rates(attitude, h)
    np.testing.assert_allclose(found, omega, atol=2e-3)
    plain = np.gradient(attitude, h, axis=0)
    turning = np.linalg.solve(pose_jacobian(attitude)[:, 3:, 3:], plain[:, :, None])[:, :, 0]
    assert np.max(np.abs(turning - omega)) > 1.0  # what the angles alone would give


def test_no_angular_velocity_is_taken_across_a_gap() -> None:
    attitude = np.zeros((20, 3))
    attitude[:, 2] = np.concatenate([0.1 * np.arange(10), 2.0 + 0.1 * np.arange(10)])
    starts = np.isin(np.arange(20), (0, 10))
    np.testing.assert_allclose(body_rates(attitude, 1.0, starts)[:, 2], 0.1, atol=1e-12)
    assert np.max(body_rates(attitude, 1.0)[:, 2]) > 0.5
