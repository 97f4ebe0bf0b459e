"""Rotations and the reference in body axes."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import (
    body_rates,
    cross_matrix,
    euler_zyx,
    frame_of_angles,
    pose_jacobian,
    quaternion_rate,
    reference_in_body,
    reference_in_body_kernel,
    wrap,
)

angles = st.floats(-20.0, 20.0)


@given(angles)
def test_wrapping_keeps_the_direction(angle: float) -> None:
    wrapped = wrap(angle)
    assert -np.pi < wrapped <= np.pi
    assert np.cos(wrapped) == pytest.approx(np.cos(angle), abs=1e-9)
    assert np.sin(wrapped) == pytest.approx(np.sin(angle), abs=1e-9)


@pytest.mark.parametrize("reference", [reference_in_body, reference_in_body_kernel])
@pytest.mark.parametrize("axes", [[0, 1, 5], [0, 1, 2, 3, 4, 5]])
def test_body_reference_is_the_derivative_of_the_path(
    reference: Callable[..., None], axes: list[int]
) -> None:
    """R v = dp/dt, S(omega) = R' dR/dt, and the derivative of both velocities."""

    def path(t: float) -> Array:
        pose = [np.sin(t), np.cos(2 * t), 0.1 * t**2, 0.4 * np.sin(t), 0.7 * t, 0.3 * t**2]
        return np.where(np.isin(range(6), axes), pose, 0.0)

    def frame(t: float) -> Array:
        found = np.empty((3, 3))
        frame_of_angles(path(t)[3:], found)
        return found

    def slope(of: Callable[[float], Array], t: float, h: float = 1e-4) -> Array:
        return np.asarray((of(t + h) - of(t - h)) / (2 * h))

    def motion(t: float) -> Array:
        rates = slope(path, t), slope(lambda s: slope(path, s), t)
        found, whole = np.zeros((3, len(axes))), np.zeros((3, 6))
        reference(len(axes) == 3, np.column_stack([path(t), *rates])[axes], *found)
        whole[:, axes] = found
        return whole[1:]

    t = 0.9
    nu, nu_dot = motion(t)
    np.testing.assert_allclose(frame(t) @ nu[:3], slope(path, t)[:3], atol=1e-6)
    np.testing.assert_allclose(cross_matrix(nu[3:]), frame(t).T @ slope(frame, t), atol=1e-6)
    np.testing.assert_allclose(nu_dot, slope(lambda s: motion(s)[0], t, 1e-3), atol=1e-5)


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
