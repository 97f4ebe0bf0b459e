"""The sine and cosine of the blocks against the library's."""

import numpy as np
import pytest

from seatrial.models.identification.sine import cosine_and_sine


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
