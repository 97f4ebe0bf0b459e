"""Over how long errors of predictions say something of the model, and where chance decides."""

import numpy as np
import pytest

from seatrial.models.identification.validation import RESTART_S, prediction, restart_length
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel import basis
from seatrial.models.vessel.table import Vessel

DOFS = ("surge", "sway", "yaw")


def unstable(rate: float) -> Vessel:
    """A table with M = I whose yaw rate grows as exp(rate t)."""
    terms = basis.terms(["u_dot", "v_dot", "r_dot", "u", "v", "r"])
    theta = np.vstack([np.eye(3), np.diag([1.0, 1.0, -rate])])
    return Vessel("unstable", DOFS, terms, theta)


def still(n: int = 400, period_s: float = 0.1) -> Recording:
    rng = np.random.default_rng(0)
    nu = 0.1 * rng.standard_normal((n, 3))
    zero = np.zeros((n, 3))
    return Recording(DOFS, period_s * np.arange(n), zero, nu, zero, zero, zero)


@pytest.mark.parametrize(("rate", "period_s"), [(0.2, 0.1), (0.2, 0.5), (0.5, 0.1), (2.0, 0.1)])
def test_it_is_three_times_the_time_in_which_an_error_grows_by_e(
    rate: float, period_s: float
) -> None:
    length = restart_length(unstable(rate), still(period_s=period_s))
    assert length == pytest.approx(3.0 / rate, rel=1e-6)


@pytest.mark.parametrize("rate", [-1.0, 0.0, 0.01])
def test_a_model_whose_errors_hardly_grow_is_predicted_over_the_whole_time(rate: float) -> None:
    assert restart_length(unstable(rate), still()) == RESTART_S


def test_it_is_no_less_than_ten_samples() -> None:
    assert restart_length(unstable(100.0), still(period_s=1.0)) == 10.0


def test_chance_decides_the_free_run_of_an_unstable_vessel_only() -> None:
    recording, noise = still(), np.array([0.0, 0.0, 0.0, 1e-3, 1e-3, 1e-3])
    stable = prediction(unstable(-1.0), recording, None).sensitivity(noise)
    grown = prediction(unstable(0.3), recording, None).sensitivity(noise)
    assert np.all(stable < 0.02)
    assert grown[2] > 1.0
    assert np.all(prediction(unstable(0.3), recording, None).sensitivity(0.0 * noise) == 0.0)
