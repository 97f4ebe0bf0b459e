"""Preprocessing against laws, closed forms and scipy's rotations."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import butter, sosfiltfilt
from scipy.spatial.transform import Rotation

from models.basis import Array
from models.preprocessing import central_difference, euler_zyx, without_sign_flips


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
