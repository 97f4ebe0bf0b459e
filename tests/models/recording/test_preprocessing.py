"""Preprocessing against laws, closed forms and scipy's rotations; velocity against position."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.recording.preprocessing import (
    Differentiation,
    central_difference,
    interpolated,
    outliers,
    quality_checks,
    without_bias,
    without_sign_flips,
)
from seatrial.models.recording.recording import Recording, attitude_of
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import euler_zyx, pose_jacobian
from seatrial.models.vessel.thruster import AzimuthThrusters

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


# Derivatives


def test_bias_of_an_accelerometer() -> None:
    t = np.linspace(0.0, 20.0, 2001)
    velocity, acceleration = np.sin(t), np.cos(t)
    without = without_bias(acceleration + 0.7, velocity, t[1])
    np.testing.assert_allclose(without, acceleration, atol=1e-5)
    at_rest = without_bias(acceleration, np.zeros(2001), t[1])
    assert np.trapezoid(at_rest, t) == pytest.approx(0.0, abs=1e-12)  # zero mean, as in 5.2


def differentiation(**changes: object) -> Differentiation:
    given_options = {
        "method": "central", "window_s": 0.7, "polynomial": 2, "cutoff_hz": 1.0, "order": 4,
    }  # fmt: skip
    return Differentiation(**(given_options | changes))  # type: ignore[arg-type]


def test_savitzky_golay_is_exact_for_its_polynomial_up_to_the_ends() -> None:
    t = 0.1 * np.arange(50)
    slope = differentiation(method="savitzky_golay").derivative(np.stack([t**2, t], 1), 0.1)
    np.testing.assert_allclose(slope, np.stack([2.0 * t, np.ones(50)], 1), atol=1e-10)


def test_filters_pass_slow_motion_in_phase_and_stop_noise() -> None:
    t = 0.1 * np.arange(2000)
    slow, rng = np.sin(2.0 * np.pi * 0.05 * t), np.random.default_rng(5)
    rate = 2.0 * np.pi * 0.05 * np.cos(2.0 * np.pi * 0.05 * t)
    noise = 0.01 * rng.standard_normal(2000)
    inside = slice(50, -50)
    plain = np.std(central_difference(noise, 0.1)[inside])
    for method in ("savitzky_golay", "butterworth"):
        one = differentiation(method=method, cutoff_hz=0.5)
        np.testing.assert_allclose(one.derivative(slow, 0.1)[inside], rate[inside], atol=0.002)
        assert np.std(one.derivative(noise, 0.1)[inside]) < 0.5 * plain


def test_options_of_a_differentiation() -> None:
    with pytest.raises(ConfigurationError, match="window_s must be positive, got 0"):
        differentiation(window_s=0.0)
    with pytest.raises(ConfigurationError, match="window_s must span more than 2 and at most 50"):
        differentiation(method="savitzky_golay", window_s=0.1).derivative(np.zeros(50), 0.1)
    with pytest.raises(ConfigurationError, match="cutoff_hz must lie below 5, got 5"):
        differentiation(method="butterworth", cutoff_hz=5.0).derivative(np.zeros(50), 0.1)
    with pytest.raises(RecordingError, match="got 20 samples, too few for a low-pass"):
        differentiation(method="butterworth").derivative(np.zeros(20), 0.1)


# Acting force


def thrusters(**changes: object) -> AzimuthThrusters:
    given_options = {
        "rpm": ("n1", "n2"), "angle": ("a1", "a2"), "arm_m": (1.8, -1.8),
        "polynomial": (-1.07, 0.00478, 8.7e-6, 6.16e-9, -1.78e-13, -1.31e-16),
        "rpm_limits": (-5400.0, 5300.0),
    }  # fmt: skip
    return AzimuthThrusters(**(given_options | changes))  # type: ignore[arg-type]


def test_force_of_the_thrusters_by_hand() -> None:
    """Jervan (2020), eqs. (5.1) and (5.2), with both thrusters at 1000 rpm."""
    chi = 1000.0
    one = -1.31e-16 * chi**5 - 1.78e-13 * chi**4 + 6.16e-9 * chi**3
    one += 8.7e-6 * chi**2 + 0.00478 * chi - 1.07
    assert one == pytest.approx(18.26, abs=0.01)
    rpm = np.full((4, 2), chi)
    angle = np.array([[0.0, 0.0], [np.pi / 2, np.pi / 2], [np.pi / 2, -np.pi / 2], [0.0, np.pi]])
    expected = [[2.0 * one, 0.0, 0.0], [0.0, 2.0 * one, 0.0], [0.0, 0.0, 3.6 * one], [0.0] * 3]
    np.testing.assert_allclose(thrusters().force(rpm, angle), expected, atol=1e-12)


def test_what_is_wrong_with_thrusters() -> None:
    rpm = np.zeros((5, 2))
    rpm[3, 1] = 5301.0
    with pytest.raises(RecordingError, match="column n2, sample 3: got 5301 rpm, expected -5400"):
        thrusters().force(rpm, rpm)
    with pytest.raises(ConfigurationError, match=r"got \(1, 2, 2\)"):
        thrusters(rpm=("n1",))
    with pytest.raises(ConfigurationError, match="rpm_limits must increase"):
        thrusters(rpm_limits=(1.0, 1.0))
    assert thrusters(rpm=(), angle=()).rpm == ()


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


def test_exact_motion_passes_both_checks() -> None:
    """What is left is the trapezoid's and the central difference's own error, of second order."""
    largest = []
    for period_s, n in ((0.1, 601), (0.05, 1201)):
        largest.append([check.maximum for check in quality_checks(six(period_s, n))])
    assert np.max(largest[1]) < 0.01
    np.testing.assert_allclose(np.log2(np.divide(*largest)), 2.0, atol=0.2)
    assert max(check.maximum for check in quality_checks(circle())) < 1e-3


def test_wrong_sign_and_drift_are_seen() -> None:
    good = circle()
    backward = recording_of(PLANAR, 0.1, good.eta * [-1.0, 1.0, 1.0], good.nu)
    worst = {(c.check, c.dof): c.maximum for c in quality_checks(backward)}
    assert worst["differentiated_position", "surge"] > 0.9  # 2 u, when it sails north
    bias = np.array([0.0, 0.0, 0.01])
    biased = recording_of(PLANAR, 0.1, good.eta, good.nu + bias)
    yaw = next(
        c for c in quality_checks(biased) if (c.check, c.dof) == ("integrated_velocity", "yaw")
    )
    assert yaw.unit == "rad"
    assert yaw.maximum == pytest.approx(0.6)
    np.testing.assert_allclose(yaw.error, -0.01 * biased.t, atol=1e-12)  # measured - calculated
