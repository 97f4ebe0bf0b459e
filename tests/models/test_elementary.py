"""Functions without branches against the library's."""

import numpy as np
import pytest

from seatrial.models.elementary import angle_of, cosine_and_sine


@pytest.mark.parametrize("reach", [1e-300, 1e-8, 1.0, 10.0, 1e3, 1.6e6])
def test_they_are_the_librarys(reach):
    angles = np.random.default_rng(0).uniform(-reach, reach, 20_000)
    found = np.array([cosine_and_sine(x) for x in angles]).T
    np.testing.assert_allclose(found[0], np.cos(angles), rtol=0.0, atol=2.3e-16)
    np.testing.assert_allclose(found[1], np.sin(angles), rtol=0.0, atol=2.3e-16)
    if reach <= 1.0:
        np.testing.assert_allclose(found[1], np.sin(angles), rtol=4.5e-16)


def test_quarters_of_a_turn():
    angles = 0.5 * np.pi * np.arange(-8, 9)
    found = np.array([cosine_and_sine(x) for x in angles]).T
    np.testing.assert_allclose(found, [np.cos(angles), np.sin(angles)], rtol=1e-12, atol=0.0)


@pytest.mark.parametrize("x", [np.nan, np.inf, -np.inf])
def test_what_is_no_angle_has_none(x):
    assert np.all(np.isnan(cosine_and_sine(x)))


def test_the_readable_function_is_the_compiled_one():
    for x in np.linspace(-20.0, 20.0, 999):
        assert cosine_and_sine(x) == cosine_and_sine.py_func(x)


@pytest.mark.parametrize("scale", [1e-300, 1e-8, 1.0, 1e8])
def test_the_angle_of_a_vector_is_the_librarys(scale):
    y, x = np.random.default_rng(1).standard_normal((2, 20_000)) * [[scale], [1.0]]
    expected = np.arctan2(y, x)
    np.testing.assert_allclose([angle_of(*one) for one in zip(y, x, strict=True)], expected,
                               rtol=4.5e-16)  # fmt: skip
    np.testing.assert_allclose([angle_of(*one) for one in zip(x, y, strict=True)],
                               np.arctan2(x, y), rtol=4.5e-16)  # fmt: skip


def test_angles_of_the_axes():
    assert [angle_of(0.0, 1.0), angle_of(1.0, 0.0), angle_of(0.0, -1.0), angle_of(-2.0, 0.0)] == [
        0.0, 0.5 * np.pi, np.pi, -0.5 * np.pi,
    ]  # fmt: skip
    assert angle_of(0.0, 0.0) == 0.0
    assert np.isnan(angle_of(np.nan, 1.0))
