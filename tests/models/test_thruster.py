"""The thruster lag against its closed form."""

import numpy as np
import pytest
from scipy.signal import lti, step

from models.errors import ConfigurationError
from models.thruster import SecondOrderLag, acting_force, no_lag, step_lag


@pytest.mark.parametrize("period", [0.01, 0.1, 0.5])
def test_step_response_is_exact_at_any_sample_time(period: float) -> None:
    n = round(5.0 / period)
    forces = acting_force(SecondOrderLag(2.0, 0.8), np.full((n, 1), 7.0), period)[:, 0]
    _, exact = step(lti([4.0], [1.0, 3.2, 4.0]), T=period * np.arange(n))
    np.testing.assert_allclose(forces, 7.0 * exact, atol=1e-8)


def test_without_lag_the_force_is_the_command_of_the_sample_before() -> None:
    commands = np.random.default_rng(0).normal(size=(20, 3))
    forces = acting_force(None, commands, 0.1)
    np.testing.assert_array_equal(forces[0], 0.0)
    np.testing.assert_array_equal(forces[1:], commands[:-1])
    assert no_lag().direct


def test_compiled_step_equals_the_readable_one() -> None:
    lag = SecondOrderLag(2.0, 0.8).table(0.1)
    commands = np.random.default_rng(1).normal(size=(30, 2))
    state, forces = np.zeros((2, 2)), []
    for command in commands:
        forces.append(state[:, 0].copy())
        step_lag(lag, state, command)
    np.testing.assert_allclose(
        acting_force(SecondOrderLag(2.0, 0.8), commands, 0.1), forces, rtol=1e-13, atol=1e-15
    )


@pytest.mark.parametrize("options", [(0.0, 0.8), (2.0, -1.0)])
def test_ranges(options: tuple[float, float]) -> None:
    with pytest.raises(ConfigurationError, match="must be positive, got"):
        SecondOrderLag(*options)
