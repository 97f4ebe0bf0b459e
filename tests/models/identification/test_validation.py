"""Predictions of the held-out part: exact for the truth; one step hides what a free run shows."""

from dataclasses import replace

import numpy as np
import pytest

from seatrial.models.errors import IdentificationError
from seatrial.models.identification.validation import (
    HORIZONS,
    Ahead,
    InertiaError,
    combined,
    prediction,
    scores,
)
from seatrial.models.vessel.basis import terms
from seatrial.models.vessel.table import Vessel


def errors(model, recording, thruster=None):
    ready = prediction(model, recording, thruster)
    return {name: ready.over(name) for name in HORIZONS}


@pytest.mark.parametrize("disturbance", ["calm", "constant"])
def test_the_truth_predicts_the_ferry(lap, disturbance):
    """By steps of 0.1 s where the plant took 0.025 s; in six minutes ahead that error grows."""
    one = lap(disturbance, 0)
    held_out = one.problem.validation
    true = errors(one.truth, held_out, one.thruster)
    nominal = errors(one.problem.nominal, held_out, one.thruster)
    for name in HORIZONS:
        assert true[name].limited == 0.0
        assert np.all(true[name].rmse < 0.05 * nominal[name].rmse), name
    assert np.max(true["ten_step"].rmse) < 1e-3


def test_ten_steps_are_ten_steps(make, signal):
    """By hand, from every measured state: Euler there, RK4 here, so with small steps of force."""
    truth, nominal = make.surge(60.0, 20.0), make.surge(100.0, 30.0)
    recording = make.driven(truth, signal("many_sine"), integrator="rk4")
    decay = np.exp(-30.0 / 100.0 * 0.1)  # the exact solution of a linear model over a sample
    reached, rest = 10, []
    for k in range(len(recording) - reached):
        u = recording.nu[k, 0]
        for i in range(k, k + reached):
            u = decay * u + (1.0 - decay) * recording.tau[i, 0] / 30.0
        rest.append(u - recording.nu[k + reached, 0])
    expected = np.sqrt(np.mean(np.square(rest)))
    assert errors(nominal, recording)["ten_step"].rmse[1] == pytest.approx(expected, rel=1e-6)
    assert errors(truth, recording)["ten_step"].rmse[1] < 1e-12


def test_predictions_do_not_cross_a_gap(make, signal):
    truth = make.surge(60.0, 20.0)
    recording = make.driven(truth, signal("many_sine"), integrator="rk4")
    parted = recording.part(np.delete(np.arange(1000), slice(300, 500)))
    for found in errors(truth, parted).values():
        assert np.max(found.rmse) < 1e-12


def test_one_step_hides_a_bias_that_a_free_run_shows(make, signal):
    """Under measurement noise the right model and one a fifth too heavy look alike one step on."""
    truth, wrong = make.surge(60.0, 20.0), make.surge(72.0, 24.0)
    recording = make.driven(truth, signal("many_sine"), integrator="rk4", noise=0.02)
    right, biased = errors(truth, recording), errors(wrong, recording)
    assert biased["one_step"].rmse[1] == pytest.approx(right["one_step"].rmse[1], rel=0.05)
    assert biased["free_run"].rmse[1] > 2.0 * right["free_run"].rmse[1]


def test_a_model_that_runs_away_has_figures_and_says_so(make, signal):
    recording = make.driven(make.surge(60.0, 20.0), signal("many_sine"))
    found = errors(make.surge(60.0, 20.0, "|u|u", -40.0), recording)["free_run"]
    assert np.all(np.isfinite(found.rmse))
    assert found.limited > 0.5
    assert found.diverged


def test_a_light_model_under_a_large_force_has_not_diverged(make, signal):
    """Damping bounds its velocity by the force over it, however fast it gets there."""
    recording = make.driven(make.surge(60.0, 20.0), signal("many_sine"), integrator="rk4")
    strongest = float(np.max(np.abs(recording.tau)))
    light = prediction(make.surge(1.0, 20.0), recording, None)
    assert strongest > light.course.limit  # of the velocity, and so of an acceleration in a second
    assert not light.over("free_run").diverged
    assert np.nanmax(np.abs(light.motion()[:, 1])) < 1.01 * strongest / 20.0


def test_the_time_that_a_free_run_held_is_that_of_the_exact_solution(make, signal):
    """m du/dt = d u grows as exp(d t / m); the rate of the position, u, reaches the limit first."""
    recording = make.driven(make.surge(60.0, 20.0), signal("many_sine"))
    still = replace(recording, tau=np.zeros_like(recording.tau), tau_actual=None)
    start = 0.5
    still.nu[:] = start
    ready = prediction(make.surge(60.0, -30.0), still, None)
    growth = 30.0 / 60.0
    expected = np.log(ready.course.limit / start) / growth
    assert ready.held_s() == pytest.approx(expected, abs=2.0 * ready.course.step_s)
    stable = prediction(make.surge(60.0, 30.0), still, None)
    assert stable.held_s() == pytest.approx(ready.course.step_s * (len(still) - 1))


def test_only_what_is_predicted_counts(make, signal):
    """Restarts at every other sample are predictions of one step, on one grid of starts.

    The errors at the restarts themselves are zero, and must not flatter the figure.
    """
    recording = make.driven(make.surge(60.0, 20.0), signal("many_sine"), integrator="rk4")
    ready = prediction(make.surge(72.0, 24.0), recording, None)
    restarted, ahead = ready.restarted(2), ready.ahead(1, grids=1)
    np.testing.assert_allclose(restarted.rmse, ahead.rmse, rtol=1e-12)
    np.testing.assert_allclose(restarted.std, ahead.std, rtol=1e-12)


def test_scores_are_those_of_their_definitions(make, signal):
    truth, biased = make.surge(60.0, 20.0), make.surge(72.0, 24.0)
    recording = make.driven(truth, signal("many_sine"), integrator="rk4", noise=0.02)
    ready = prediction(biased, recording, None)
    spread = ready.mean_motion()
    np.testing.assert_allclose(spread, np.std(np.hstack([recording.eta, recording.nu]), axis=0))
    ahead = ready.over("free_run")
    fit, r2, vaf = scores(ahead, spread)
    errors, _ = ready.deviations()
    measured = recording.nu[:, 0]
    e = errors[1:, 1]
    np.testing.assert_allclose(fit[1], 100.0 * (1.0 - np.sqrt(np.mean(e**2)) / np.std(measured)))
    np.testing.assert_allclose(r2[1], 1.0 - np.mean(e**2) / np.var(measured))
    np.testing.assert_allclose(vaf[1], 100.0 * (1.0 - np.var(e) / np.var(measured)))
    assert combined(np.array([np.nan, 40.0, 60.0])) == 50.0


def test_an_axis_at_rest_has_no_score():
    ahead = Ahead(np.ones(4), 0.0, np.ones(4))
    fit = scores(ahead, np.array([2.0, 0.0, 1.0, 0.0])).fit
    np.testing.assert_allclose(fit, [50.0, np.nan, 0.0, np.nan])


def test_what_cannot_predict_says_why(make, signal):
    recording = make.driven(make.surge(60.0, 20.0), signal("many_sine"))
    turned = Vessel("t", ("surge",), terms(["u_dot", "cos(psi)"]), np.ones((2, 1)))
    with pytest.raises(IdentificationError, match=r"cos\(psi\) cannot be predicted in surge"):
        prediction(turned, recording, None)
    heavy = make.surge(60.0, 20.0)
    with pytest.raises(InertiaError, match="inertia of the model is not positive definite"):
        prediction(replace(heavy, theta=-heavy.theta), recording, None)
