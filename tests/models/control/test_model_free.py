"""Control of a vessel whose model comes from its data alone: DSR, then LQ or predictive control.

The experiment of Bargouth (2022), appendix O, as it works: physical drag, process noise without a
mean and a hundredth of the source's, PRBS of 1e5 N, 2e5 N and 1e7 Nm held for 50 to 120 s beside a
closed loop with a Kalman filter, 7,200 s at 1 Hz, measurement noise of 0.05 m and 0.0005 rad, L = 8
and J = 20. The competitor is the same controller on the vessel's own model.
"""

from typing import Any

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from seatrial.models.control.estimator import filter_gain
from seatrial.models.control.linear_design import design_model, every
from seatrial.models.errors import ConfigurationError
from seatrial.models.simulation.statespace import StateSpace
from seatrial.models.vessel.basis import Array
from seatrial.runner.record.rows import Results
from seatrial.runner.trials import trial as trials
from tests.trials import composed

EXPERIMENT = (
    "vessel=supply_vessel", "excitation=prbs", "excitation.loop=closed",
    "excitation.length_s=1440",  # times ten: half of 14,400 s is for training
    "excitation.amplitude={surge: 1e5, sway: 2e5, yaw: 1e7}",
    "disturbance=rough", "disturbance.wind=null", "disturbance.current=null",
    "disturbance.waves=null",
    "+disturbance.process={_target_: seatrial.models.weather.noise.ProcessNoise, "
    "distribution: uniform, size: [1.5e-4, 1.5e-4, 5e-7]}",
    "evaluation=setpoints", "sample_time_s=1.0", "integration_step_s=1.0",
    "identifier=dsr", "identifier.period_s=1.0",
    # its own model, not the vessel's where that predicts better, nor none where it gains energy
    "identifier.physical_form=optional", "deploy_unphysical=true",
)  # fmt: skip
FULL_NOISE = "disturbance.process.size=[1.5e-2, 1.5e-2, 5e-5]"
AS_PRINTED = (
    "identifier.L=2", "identifier.J=2", "identifier.variant=closed", "identifier.stable=false",
)  # fmt: skip


def run(*options: str) -> Results:
    try:
        return trials.run(composed(*EXPERIMENT, *options))
    except trials.TrialDiverged as error:
        return error.results


def errors(results: Results, model: str) -> Array:
    """Mean error of surge, sway [m] and yaw [deg]; infinite where the vessel ran away."""
    found = {m.dof: m.value for m in results.metrics if (m.model, m.name) == (model, "error_mae")}
    return np.array([found.get(dof, np.inf) for dof in ("surge", "sway", "yaw")], dtype=float)


def ratios(controller: str, seeds: range, *options: str) -> Array:
    """Error of the identified model over that of the vessel's own, shape (seeds, 3)."""
    rows = []
    for seed in seeds:
        results = run(f"controller={controller}", f"seed={seed}", *options)
        rows.append(errors(results, "identified") / errors(results, "nominal"))
    return np.array(rows)


@pytest.mark.slow
def test_a_model_from_data_controls_nearly_as_well() -> None:
    assert np.all(ratios("mpc_integral", range(1)) <= 1.5)


@pytest.mark.nightly
@pytest.mark.parametrize("controller", ["lqi", "mpc_integral"])
def test_over_ten_seeds(controller: str) -> None:
    assert np.all(np.median(ratios(controller, range(10)), axis=0) <= 1.5)


@pytest.mark.nightly
def test_the_source_s_options_fail_at_its_noise_and_it_shows() -> None:
    """L = J = 2: no sampled continuous motion, and a vessel that is lost by hundreds of metres."""
    results = run("controller=lqi", FULL_NOISE, *AS_PRINTED)
    assert np.all(errors(results, "identified") > 10.0 * errors(results, "nominal"))
    form = [d for d in results.diagnostics if d.name == "physical_form"]
    assert form[0].value == 0.0
    assert "which a sampled continuous model cannot have" in str(form[0].label)


@pytest.mark.nightly
def test_at_the_sources_noise_it_is_its_options_that_fail() -> None:
    """Without a mean the noise alone is borne: L = 8 and J = 20 do as well as the true model."""
    assert np.all(np.median(ratios("lqi", range(3), FULL_NOISE), axis=0) <= 1.5)


def test_a_controller_faster_than_its_model_is_refused_before_any_work() -> None:
    for controller, own in (("0.75", "0.75 s"), ("0.5", "0.5 s")):
        one = composed(
            *EXPERIMENT, "controller=lqi", "sample_time_s=0.25", "integration_step_s=0.25",
            f"controller.period_s={controller}",
        )  # fmt: skip
        with pytest.raises(ConfigurationError, match=f"got {own}, expected a multiple of .* 1 s"):
            trials.check(one)
    trials.check(composed(*EXPERIMENT, "controller=lqi", "controller.period_s=2"))


@pytest.mark.nightly
def test_its_options_are_worse_at_little_noise_too() -> None:
    printed = np.median(ratios("mpc_integral", range(3), *AS_PRINTED), axis=0)
    assert np.all(printed > 1.5)


@pytest.mark.nightly
def test_a_pid_takes_the_physical_form() -> None:
    results = run("controller=pid_ff")
    assert np.all(errors(results, "identified") <= 1.5 * errors(results, "nominal"))


def product(controller: str, identifier: str, *more: str) -> Any:
    return pytest.param(controller, identifier, *more, marks=pytest.mark.nightly)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("controller", "identifier"),
    [
        *(("lqi", "ls"), ("mpc_integral", "plsr")),
        *(product("mpc_integral", name) for name in ("ls", "ridge", "output_error")),
        *(product("lqi", name) for name in ("plsr", "ridge", "output_error")),
    ],
)
def test_any_identified_table_serves_linear_control(controller: str, identifier: str) -> None:
    more = ("identifier.basis=physical",) if identifier == "ls" else ()
    results = trials.run(
        composed(f"controller={controller}", f"identifier={identifier}", "disturbance=calm", *more)
    )
    found = {m.model: m.value for m in results.metrics if m.name == "e_pos_mae"}
    assert float(found["identified"] or 1.0) < float(found["nominal"] or 0.0)


def test_a_slower_controller_takes_a_model_of_several_of_its_periods() -> None:
    """Prediction over two periods is that of one, twice; the gain is that of the slower filter."""
    rng = np.random.default_rng(0)
    A = rng.normal(size=(4, 4))
    A *= 0.9 / np.max(np.abs(np.linalg.eigvals(A)))
    B, C = rng.normal(size=(4, 2)), rng.normal(size=(2, 4))
    Q, R = np.eye(4), 0.3 * np.eye(2)
    M = filter_gain(A, C, Q, R)
    K, P = A @ M, solve_discrete_are(A.T, C.T, Q, R)
    F = np.linalg.cholesky(C @ P @ C.T + R)
    model = StateSpace(A, B, C, np.zeros((2, 2)), 0.5, K=K, F=F)
    slow = every(model, 2)
    assert slow.period_s == 1.0
    u = rng.normal(size=(50, 2))
    np.testing.assert_allclose(slow.simulate(u), model.simulate(np.repeat(u, 2, axis=0))[::2])
    assert slow.K is not None
    A2, Q2 = A @ A, A @ Q @ A.T + Q
    np.testing.assert_allclose(slow.K, A2 @ filter_gain(A2, C, Q2, R), rtol=1e-6)
    assert design_model(model, (1.0, 1.0), 1.0).model.period_s == 1.0
