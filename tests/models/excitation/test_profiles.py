"""Force profiles: what they give and when."""

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.signals import Legs, Ramp, SharedSignal, Steady

T = np.arange(0.0, 120.0, 0.1)
RNG = np.random.default_rng(0)


def test_legs_push_and_counter_push() -> None:
    legs = Legs(((1.0, 0.0), (0.0, 0.5), (-1.0, -1.0)), 60.0)
    ahead, aside = (legs.sample(T, axis, 2, RNG) for axis in range(2))
    assert ahead[[0, 99, 100, 199, 200, 399, 400, 500, 599]].tolist() == [
        1.0, 1.0, -1.0, -1.0, 0.0, 0.0, -1.0, 1.0, 1.0
    ]  # fmt: skip
    assert set(aside[200:300]) == {0.5}
    for values in (ahead, aside):  # every leg takes back the momentum that it gave
        assert np.sum(values) == pytest.approx(0.0)
        assert not np.any(values[600:])


def test_a_ramp_rises_and_falls() -> None:
    ramp = Ramp(60.0).sample(T, 0, 1, RNG)
    assert ramp[[0, 150, 300, 450, 600, 900]] == pytest.approx([0.0, 0.5, 1.0, 0.5, 0.0, 0.0])
    assert np.trapezoid(ramp, T) == pytest.approx(30.0, abs=1e-6)


def test_shares_are_by_axis() -> None:
    shared = SharedSignal(Steady(), (0.5, 0.0, -1.0))
    assert [shared.sample(T, axis, 3, RNG)[0] for axis in range(3)] == [0.5, 0.0, -1.0]


def test_lengths_are_checked() -> None:
    with pytest.raises(ConfigurationError, match="length_s must be positive, got 0"):
        Ramp(0.0)
    with pytest.raises(ConfigurationError, match="legs: got 0 in 10 s"):
        Legs((), 10.0)
