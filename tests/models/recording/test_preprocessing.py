"""Preprocessing against laws, closed forms and scipy's rotations; velocity against position."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from seatrial.models.recording.consistency import quality_checks
from seatrial.models.recording.recording import Recording, attitude_of
from seatrial.models.recording.signals import (
    central_difference,
    interpolated,
    outliers,
    without_sign_flips,
)
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import euler_zyx, pose_jacobian

PLANAR = ("surge", "sway", "yaw")
ALL = ("surge", "sway", "heave", "roll", "pitch", "yaw")


def scalar_first(rotations: Rotation) -> Array:
    return np.asarray(np.roll(rotations.as_quat(), 1, axis=-1))


def test_central_difference_is_exact_for_parabolas_and_of_second_order() -> None:
    t = np.linspace(0.0, 3.0, 31)
    parabola = np.column_stack([t**2 - 3.0 * t, 2.0 * t])
    rate = central_difference(parabola, 0.1)
    np.testing.assert_allclose(rate, np.column_stack([2.0 * t - 3.0, np.full(31, 2.0)]), atol=1e-12)
    errors = []
    for n in (201, 401):
        t = np.linspace(0.0, 3.0, n)
        errors.append(np.max(np.abs(central_difference(np.sin(t), t[1]) - np.cos(t))))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.05)


def test_sign_flips_are_removed_and_rotations_kept() -> None:
    headings = np.linspace(0.0, 6.0 * np.pi, 200)
    smooth = scalar_first(Rotation.from_euler("z", headings[:, None]))
    flipped = np.where(smooth[:, :1] < 0.0, -smooth, smooth)  # a recorder that keeps w positive
    assert np.max(np.abs(np.diff(flipped, axis=0))) > 1.0
    repaired = without_sign_flips(flipped)
    assert np.max(np.abs(np.diff(repaired, axis=0))) < 0.1
    np.testing.assert_allclose(np.abs(np.sum(repaired * flipped, axis=1)), 1.0)
    np.testing.assert_allclose(without_sign_flips(-flipped), -repaired)


@given(st.floats(-3.14, 3.14), st.floats(-1.57, 1.57), st.floats(-3.14, 3.14))
def test_euler_zyx_is_scipys(phi: float, theta: float, psi: float) -> None:
    rotation = Rotation.from_euler("ZYX", [[psi, theta, phi]])
    angles = euler_zyx(scalar_first(rotation))
    again = Rotation.from_euler("ZYX", angles[:, ::-1])
    assert (again * rotation.inv()).magnitude()[0] < 1e-6
    if abs(theta) < 1.5:
        np.testing.assert_allclose(angles, [[phi, theta, psi]], atol=1e-9)


# Outliers


def test_spikes_are_outliers_and_nothing_else_is() -> None:
    t = 0.1 * np.arange(400)
    clean = np.sin(0.3 * t) + np.where(t > 20.0, 1.0, 0.0) + 0.2 * np.maximum(t - 30.0, 0.0)
    assert not np.any(outliers(clean))  # neither the step nor the ramp nor the ends
    noise = 0.001 * np.random.default_rng(2).standard_normal(400)
    spiked = clean + noise
    places = [0, 60, 150, 399]
    spiked[places] += [1.0, -1.0, 5.0, 1.0]
    found = outliers(spiked)
    assert np.all(found[places])
    repaired = interpolated(t, spiked, found)
    inside = [60, 150]
    np.testing.assert_allclose(repaired[inside], clean[inside], atol=0.01)
    np.testing.assert_array_equal(repaired[~found], spiked[~found])


def test_share_of_white_noise_that_is_taken_for_outliers() -> None:
    """(x - mean) / s of ten others is Student's t with 9 degrees of freedom, times sqrt(1.1)."""
    from scipy.stats import t as student

    expected = 2.0 * student.sf(3.0 / np.sqrt(1.1), 9)
    share = np.mean(outliers(np.random.default_rng(3).standard_normal(200_000)))
    assert expected == pytest.approx(0.0187, abs=0.0002)
    assert share == pytest.approx(expected, rel=0.05)


def recording_of(dofs: tuple[str, ...], period_s: float, eta: Array, nu: Array) -> Recording:
    zero = np.zeros_like(nu)
    t = period_s * np.arange(len(nu))
    return Recording(dofs, t, eta, nu, zero, zero, attitude_of(dofs, eta))


def circle(n: int = 601, period_s: float = 0.1) -> Recording:
    """A steady turn: u = 0.5 m/s, r = 0.1 rad/s, hence a circle of 5 m."""
    t = period_s * np.arange(n)
    psi = 0.3 + 0.1 * t
    eta = np.column_stack([5.0 * np.sin(psi), -5.0 * np.cos(psi), psi])
    return recording_of(PLANAR, period_s, eta, np.tile([0.5, 0.0, 0.1], (n, 1)))


def six(period_s: float, n: int) -> Recording:
    """Smooth angles and positions; the velocities follow from exact derivatives."""
    t = period_s * np.arange(n)
    frequencies, sizes = np.array([0.3, 0.4, 0.5]), np.array([0.4, 0.5, 2.5])
    angles = sizes * np.sin(np.outer(t, frequencies))
    angle_rates = sizes * frequencies * np.cos(np.outer(t, frequencies))
    positions, rates = 2.0 * np.sin(angles), 2.0 * np.cos(angles) * angle_rates
    eta, eta_dot = np.hstack([positions, angles]), np.hstack([rates, angle_rates])
    nu = np.linalg.solve(pose_jacobian(angles), eta_dot[..., None])[..., 0]
    return recording_of(ALL, period_s, eta, nu)


def test_jacobian_is_the_derivative_of_the_rotation() -> None:
    """R_dot = R S(omega), with angle rates T omega; R against scipy's."""
    rng = np.random.default_rng(1)
    angles = rng.uniform([-3.0, -1.4, -3.0], [3.0, 1.4, 3.0], (20, 3))
    omega = rng.standard_normal((20, 3))
    jacobian = pose_jacobian(angles)
    rotation = Rotation.from_euler("ZYX", angles[:, ::-1])
    np.testing.assert_allclose(jacobian[:, :3, :3], rotation.as_matrix(), atol=1e-12)
    h = 1e-6
    moved = rotation * Rotation.from_rotvec(h * omega)
    change = np.angle(np.exp(1j * (moved.as_euler("ZYX")[:, ::-1] - angles))) / h
    expected = np.einsum("nij,nj->ni", jacobian[:, 3:, 3:], omega)
    np.testing.assert_allclose(change, expected, atol=1e-4)


def errors(recording: Recording) -> np.ndarray:
    """The largest errors of both checks, (2, n_dof)."""
    return np.array([np.max(np.abs(a - b), axis=0) for a, b in quality_checks(recording).values()])


def test_exact_motion_passes_both_checks() -> None:
    """What is left is the trapezoid's and the central difference's own error, of second order."""
    largest = []
    for period_s, n in ((0.1, 601), (0.05, 1201)):
        largest.append(errors(six(period_s, n)))
    assert np.max(largest[1]) < 0.01
    np.testing.assert_allclose(np.log2(np.divide(*largest)), 2.0, atol=0.2)
    assert np.max(errors(circle())) < 1e-3


def test_wrong_sign_and_drift_are_seen() -> None:
    good = circle()
    backward = recording_of(PLANAR, 0.1, good.eta * [-1.0, 1.0, 1.0], good.nu)
    assert errors(backward)[1, 0] > 0.9  # 2 u, when it sails north
    bias = np.array([0.0, 0.0, 0.01])
    biased = recording_of(PLANAR, 0.1, good.eta, good.nu + bias)
    assert errors(biased)[0, 2] == pytest.approx(0.6)
    pose, integral = quality_checks(biased)["integrated_velocity"]
    np.testing.assert_allclose((pose - integral)[:, 2], -0.01 * biased.t, atol=1e-12)
