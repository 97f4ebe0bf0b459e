"""Force signals against Hoyer (2021), section 6.3 and Figure 6.1."""

import numpy as np
import pytest

from seatrial.models.excitation.signals import (
    many_sine,
    pulses,
    single_ramp,
    single_sine,
    triple_ramp,
)

TIMES = 0.1 * np.arange(1000)


def test_pulses_rest_before_between_and_after():
    force = triple_ramp(TIMES)
    for begin, height in ((10.0, 10.0), (40.0, 30.0), (70.0, 60.0)):
        on = np.abs(TIMES - begin - 9.95) < 10.0
        np.testing.assert_array_equal(force[on], height)
    assert np.sum(force != 0.0) == 600


@pytest.mark.parametrize("step_s", [0.01, 0.05, 0.1, 0.2, 1.0])
def test_edges_do_not_depend_on_rounding(step_s):
    t = step_s * np.arange(round(100.0 / step_s))
    assert np.sum(triple_ramp(t) == 30.0) == round(20.0 / step_s)


def test_single_ramp_is_its_middle_pulse():
    np.testing.assert_array_equal(single_ramp(TIMES), pulses(TIMES, (30.0,)))
    assert single_ramp(np.array([9.9, 10.0, 29.9, 30.0, 50.0])).tolist() == [0, 30, 30, 0, 0]


def test_sines():
    np.testing.assert_allclose(single_sine(TIMES), 60.0 * np.sin(2.0 * np.pi * TIMES / 5.0))
    expected = sum(10.0 * np.sin(2.0 * np.pi * TIMES / p) for p in range(1, 101, 10))
    np.testing.assert_allclose(many_sine(TIMES), expected)
