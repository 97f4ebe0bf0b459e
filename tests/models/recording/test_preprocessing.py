"""Preprocessing against laws, closed forms and scipy's rotations."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import butter, sosfiltfilt
from scipy.spatial.transform import Rotation

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.recording.preprocessing import (
    AzimuthThrusters,
    Differentiation,
    central_difference,
    common_rate,
    interpolated,
    outliers,
    without_bias,
    without_sign_flips,
)
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import euler_zyx


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


def test_central_difference_of_two_samples() -> None:
    np.testing.assert_allclose(central_difference(np.array([1.0, 3.0]), 0.5), [4.0, 4.0])


def test_central_difference_commutes_with_a_zero_phase_filter() -> None:
    """Why nu_dot may be differentiated first and low-passed later."""
    x = np.random.default_rng(0).standard_normal(2000).cumsum()
    sections = butter(4, 0.1, output="sos")
    one = central_difference(sosfiltfilt(sections, x), 0.1)
    other = sosfiltfilt(sections, central_difference(x, 0.1))
    inside = slice(200, -200)
    np.testing.assert_allclose(one[inside], other[inside], atol=1e-9 * np.max(np.abs(one)))


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


def test_euler_zyx_at_the_vertical_is_a_number() -> None:
    assert np.all(np.isfinite(euler_zyx(np.array([[np.sqrt(0.5), 0.0, np.sqrt(0.5) + 1e-9, 0.0]]))))


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


def test_with_itself_among_ten_no_sample_can_be_an_outlier() -> None:
    """Why the sample is left out of its own mean: the largest possible distance is 2.85 s."""
    ten = np.zeros(10)
    ten[5] = 1e6
    assert np.abs(ten[5] - np.mean(ten)) / np.std(ten, ddof=1) < 2.85
    assert np.flatnonzero(outliers(np.append(ten, 0.0))).tolist() == [5]


def test_constant_and_short_signals_have_no_outliers() -> None:
    assert not np.any(outliers(np.full(100, 0.1)))
    assert not np.any(outliers(np.array([0.0, 0.0, 9.0, 0.0])))
    everything = np.ones(3, dtype=bool)
    np.testing.assert_array_equal(interpolated(np.arange(3.0), np.ones(3), everything), 1.0)


# One grid


def test_common_rate_is_exact_for_straight_lines_and_within_all_channels() -> None:
    rng = np.random.default_rng(4)
    one, two = (np.sort(rng.uniform(a, b, 200)) for a, b in ((0.0, 9.0), (1.0, 10.0)))
    grid, values = common_rate({"x": (one, 3.0 * one), "y": (two, 1.0 - two)}, 10.0)
    assert grid[0] == two[0]
    assert one[-1] - 0.1 < grid[-1] <= one[-1]
    np.testing.assert_allclose(np.diff(grid), 0.1)
    np.testing.assert_allclose(values["x"], 3.0 * grid)
    np.testing.assert_allclose(values["y"], 1.0 - grid)


def test_common_rate_keeps_samples_that_are_on_the_grid() -> None:
    t = 0.1 * np.arange(1001)
    grid, values = common_rate({"x": (t, np.sin(t))}, 10.0)
    assert len(grid) == 1001
    np.testing.assert_allclose(values["x"], np.sin(t), atol=1e-12)


def test_channels_that_do_not_overlap() -> None:
    early, late = np.linspace(0.0, 1.0, 5), np.linspace(2.0, 3.0, 5)
    with pytest.raises(RecordingError, match="b begins at 2 s, a ends at 1 s"):
        common_rate({"a": (early, early), "b": (late, late)}, 10.0)


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


def test_force_turns_with_the_thrusters() -> None:
    rng = np.random.default_rng(6)
    rpm, angle, turn = rng.uniform(-5000, 5000, (9, 2)), rng.uniform(-3, 3, (9, 2)), 0.7
    force, turned = thrusters().force(rpm, angle), thrusters().force(rpm, angle + turn)
    c, s = np.cos(turn), np.sin(turn)
    np.testing.assert_allclose(turned[:, :2], force[:, :2] @ [[c, s], [-s, c]])


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
