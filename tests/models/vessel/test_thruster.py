"""The thruster lag against its closed form."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lti

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import PLANAR
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import FirstOrderLag, SecondOrderLag, acting_force, no_lag
from tests.models.control.sailing import drift, weather


@pytest.mark.parametrize("period", [0.01, 0.1, 0.5])
@pytest.mark.parametrize(
    ("lag", "exact"),
    [
        (SecondOrderLag(2.0, 0.8), lti([4.0], [1.0, 3.2, 4.0])),
        (FirstOrderLag(time_constant_s=0.7), lti([1.0], [0.7, 1.0])),
    ],
)
def test_step_responses_are_exact_at_any_sample_time(
    lag: SecondOrderLag, exact: lti, period: float
) -> None:
    t = period * np.arange(round(5.0 / period))
    forces = acting_force(lag, np.full((len(t), 1), 7.0), period)[:, 0]
    np.testing.assert_allclose(forces, 7.0 * exact.step(T=t)[1], atol=1e-8)


def test_without_lag_the_force_is_the_command_of_the_sample_before() -> None:
    commands = np.random.default_rng(0).normal(size=(20, 3))
    forces = acting_force(None, commands, 0.1)
    np.testing.assert_array_equal(forces[0], 0.0)
    np.testing.assert_array_equal(forces[1:], commands[:-1])
    assert np.all(no_lag(3).direct)


def test_the_delay_is_that_of_a_slow_command() -> None:
    t = 0.01 * np.arange(5000)
    for lag in (SecondOrderLag(2.0, 0.8), FirstOrderLag(time_constant_s=0.7)):
        ramp = acting_force(lag, t[:, None], 0.01)[:, 0]
        assert t[-1] - ramp[-1] == pytest.approx(lag.delay_s, abs=0.01)


@pytest.mark.parametrize(
    "lag",
    [
        SecondOrderLag(2.0, 0.3, amplitude_limit=(5.0, 500.0), rate_limit=(4.0, 1e3)),
        FirstOrderLag(time_constant_s=0.2, amplitude_limit=(5.0, 500.0), rate_limit=(4.0, 1e3)),
    ],
)
def test_limits_of_size_and_rate_hold(lag: SecondOrderLag) -> None:
    commands = np.random.default_rng(0).choice([-20.0, 20.0], size=(60, 2)).repeat(20, axis=0)
    forces = acting_force(lag, commands, 0.05)
    assert np.max(np.abs(forces[:, 0])) == pytest.approx(5.0)
    assert np.max(np.abs(np.diff(forces[:, 0]))) <= 4.0 * 0.05 + 1e-12
    free = acting_force(replace(lag, amplitude_limit=None, rate_limit=None), commands, 0.05)
    np.testing.assert_allclose(forces[:, 1], free[:, 1], atol=1e-9)  # its limits are far away


def test_a_rate_limit_makes_a_step_a_ramp() -> None:
    lag = FirstOrderLag(time_constant_s=0.01, rate_limit=(2.0,))
    forces = acting_force(lag, np.full((30, 1), 3.0), 0.1)[:, 0]
    np.testing.assert_allclose(forces, np.minimum(0.2 * np.arange(30), 3.0), atol=0.05)


def test_a_simulation_and_the_filter_agree_on_a_limited_thruster(milliampere: Vessel) -> None:
    lag = SecondOrderLag(2.0, 0.8, amplitude_limit=(30.0,) * 3, rate_limit=(40.0,) * 3)
    command = np.random.default_rng(0).normal(size=(40, 3)).repeat(10, axis=0) * 40.0
    acting = drift(milliampere, weather(400), lag=lag, step_s=0.025, added=command).log.tau_actual
    np.testing.assert_allclose(acting_force(lag, command, 0.1), acting, atol=1e-9)
    assert np.max(np.abs(acting)) == 30.0


@pytest.mark.parametrize("name", ["amplitude_limit", "rate_limit"])
def test_wrong_limits_are_refused(name: str) -> None:
    with pytest.raises(ConfigurationError, match=name):
        SecondOrderLag(2.0, 0.8, **{name: (1.0, 0.0)})  # type: ignore[arg-type]
    with pytest.raises(ConfigurationError, match=f"{name}: got 1 numbers, expected 3"):
        SecondOrderLag(2.0, 0.8, **{name: (1.0,)}).check(PLANAR)  # type: ignore[arg-type]
    with pytest.raises(ConfigurationError, match="time_constant_s"):
        FirstOrderLag(time_constant_s=0.0)
