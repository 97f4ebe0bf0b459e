"""The robust identifier finds the plant and its disturbance, with intervals that cover."""

from dataclasses import replace

import numpy as np
import pytest

from seatrial.models.errors import IdentificationError
from seatrial.models.identification.problem import Problem
from seatrial.models.vessel.table import Vessel
from tests.models.identification.known_results import chosen
from tests.trials import asked_for, excited

SWEPT = ("excitation=multisine", "controller=none", "plant.scale=0.8")


def assert_recovered(model: Vessel, truth: Vessel, rtol: float) -> None:
    """Every coefficient of the truth, and zero where it has none."""
    union = truth.terms + tuple(term for term in model.terms if term not in truth.terms)
    np.testing.assert_allclose(model.on(union).theta, truth.on(union).theta, rtol=rtol, atol=1e-6)


def test_the_calm_plant_is_recovered(calm, identifier) -> None:
    found = identifier("robust").identify(calm.problem, np.random.default_rng(0))
    assert chosen(found) == "[none]"
    assert_recovered(found.model, calm.truth, 1e-3)


def test_an_axis_without_force_or_motion_keeps_the_nominal_equation() -> None:
    """The surge of a vessel that dives at a speed that is held."""
    words = "vessel=dsrv", "controller=none", "evaluation=none"
    (problem, truth), auto = excited(*words), asked_for(*words, "identifier=auto").identifier
    assert np.all(problem.training.nu[:, 0] == problem.training.nu[0, 0])
    found = auto.identify(problem, np.random.default_rng(0)).model
    np.testing.assert_array_equal(found.on(truth.terms).theta[:, 0], truth.theta[:, 0])


@pytest.mark.slow
def test_a_constant_force_is_chosen_and_recovered(constant, identifier) -> None:
    found = identifier("robust").identify(constant.problem, np.random.default_rng(0))
    assert chosen(found) == "[ned_force]"
    assert_recovered(found.model, constant.truth, 5e-3)
    for term in ("cos(psi)", "sin(psi)"):
        force, truth = (table.row(term) for table in (found.model, constant.truth))
        assert np.any(truth != 0.0)
        np.testing.assert_allclose(force, truth, rtol=1e-4, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 3, 5, 12])  # of three blocks, one hid what the others say
def test_a_constant_force_is_chosen_beside_noise(identifier, seed: int) -> None:
    problem, _ = excited("disturbance=[constant,noise]", f"seed={seed}")
    assert chosen(identifier("robust").identify(problem, np.random.default_rng(0))) == "[ned_force]"


@pytest.mark.slow
def test_a_wind_is_chosen_and_recovered(identifier) -> None:
    """Wind areas to a thousandth; damping to what a lap shows beside a wind of its own noise."""
    problem, truth = excited("disturbance=wind")
    found = identifier("robust").identify(problem, np.random.default_rng(0))
    assert chosen(found) == "[windage]"
    for dof, term in (("surge", "V_qu_q"), ("sway", "V_qv_q"), ("yaw", "u_qv_q")):
        expected = truth.coefficient(dof, term)
        assert expected != 0.0
        assert found.model.coefficient(dof, term) == pytest.approx(expected, rel=2e-3)
    np.testing.assert_allclose(np.diag(found.model.inertia), np.diag(truth.inertia), rtol=5e-3)


@pytest.mark.parametrize("share", [0.02, 1.0])
def test_an_axis_that_other_forces_moved_keeps_the_nominal_equation(
    make, calm, identifier, rng, share: float
) -> None:
    """Where most of the yaw moment is not recorded, no moment fits best: an inertia near zero."""
    t = 0.1 * np.arange(3000)
    tau = np.column_stack([300.0 * np.sin(0.05 * t), 200.0 * np.sin(0.08 * t), np.zeros_like(t)])
    moment = 300.0 * rng.standard_normal(30).repeat(100)
    moved = make.driven(calm.truth, tau + np.outer(moment, [0.0, 0.0, 1.0]), integrator="rk4")
    tau[:, 2] = share * moment
    recording = replace(moved, nu_dot=np.gradient(moved.nu, 0.1, axis=0), tau=tau, tau_actual=None)
    problem = Problem(recording, recording, calm.problem.nominal, None)
    options = {"disturbance": "none", "refinement": "none", "inertia_factor": None}
    found = identifier("robust", **options).identify(problem, rng)
    assert {f.dof for f in found.diagnostics if f.name == "not_excited"} == (
        {"yaw"} if share < 0.1 else set()
    )


def test_a_recording_that_other_forces_moved_says_so(calm, identifier, rng) -> None:
    slight = replace(calm.problem.training, tau=1e-3 * calm.problem.training.tau)
    slight = replace(slight, tau_filtered=None, tau_actual=None)
    problem = replace(calm.problem, training=slight)
    with pytest.raises(IdentificationError, match=r"below 10 % .* on every axis"):
        identifier("robust", disturbance="none", thruster="none").identify(problem, rng)


def test_without_refinement_it_is_the_regression(calm, identifier) -> None:
    options = {"refinement": "none", "disturbance": "none"}
    found = identifier("robust", **options).identify(calm.problem, np.random.default_rng(0))
    assert found.std_error is None
    assert not [f for f in found.diagnostics if f.name == "evaluations"]
    inertia, truth = np.diag(found.model.inertia), np.diag(calm.truth.inertia)
    np.testing.assert_allclose(inertia, truth, rtol=1e-3)


def test_a_planted_good_prior_is_chosen(lap, identifier) -> None:
    """A prior so narrow that nothing can change loses against one that lets the data speak."""
    option = identifier(
        "robust", disturbance="none", refinement="none", tune={"prior": [1e-5, 1.0]}
    )
    found = option.identify(lap("noise", 0).problem, np.random.default_rng(0))
    assert chosen(found) == "[prior = 1.0]"


def test_nothing_that_is_not_measured_is_estimated(lap, identifier) -> None:
    option = identifier("robust")
    problem = lap("noise", 0).problem
    assert problem.training.wind is None
    assert list(option.alternatives(problem)) == ["[none]", "[ned_force]"]


def test_a_force_from_ahead_is_recovered_in_surge(identifier) -> None:
    problem, truth = excited("vessel=surge_nonlinear", "disturbance=constant", *SWEPT)
    option = identifier("robust")
    assert list(option.alternatives(problem)) == ["[none]", "[ned_force]"]
    found = option.identify(problem, np.random.default_rng(0))
    assert chosen(found) == "[ned_force]"
    assert truth.coefficient("surge", "1") == -5.0
    assert_recovered(found.model, truth, 1e-3)


def test_a_force_constant_in_ned_is_recovered_in_six_degrees_of_freedom(identifier) -> None:
    """The attitude turns it into the body: ten coefficients that two parameters hold."""
    problem, truth = excited("vessel=beluga_diagonal", "disturbance=constant", *SWEPT)
    option = identifier("robust", disturbance="ned_force", refinement="none", lowpass_hz=None)
    found = option.identify(problem, np.random.default_rng(0)).model
    forces = [t for t in truth.terms if "(psi)" in t.name]
    assert np.count_nonzero(truth.on(forces).theta) == 10
    np.testing.assert_allclose(found.on(forces).theta, truth.on(forces).theta, rtol=0.01, atol=1e-9)
    inertia, expected = (np.diag(table.inertia) for table in (found, truth))
    np.testing.assert_allclose(inertia, expected, rtol=0.02)


@pytest.mark.nightly
def test_intervals_cover(lap, identifier) -> None:
    """What is called 95 % covers true coefficients that are not zero, over 20 seeds of noise."""
    option, hits, counted = identifier("robust"), 0, 0
    for seed in range(20):
        noisy = lap("noise", seed)
        found = option.identify(noisy.problem, np.random.default_rng(0))
        truth = noisy.truth.on(found.residual.terms).theta
        error = np.abs(found.model.on(found.residual.terms).theta - truth)
        known = (truth != 0.0) & np.isfinite(found.std_error)
        hits += np.count_nonzero(error[known] <= 1.96 * found.std_error[known])
        counted += np.count_nonzero(known)
    assert counted > 20 * 20
    assert hits / counted >= 0.85
