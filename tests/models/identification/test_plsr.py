"""PLSR of the lack of fit against the thesis's figures and the plant that sailed."""

from dataclasses import replace

import numpy as np
import pytest
from sklearn.cross_decomposition import PLSRegression

from seatrial.models.errors import IdentificationError
from seatrial.models.identification.problem import lack_of_fit
from tests.models.identification.known_results import diagnostics

THESIS_MSE = (659.2, 1191.6, 1737.4)  # Jervan (2020), Table 4.5: N^2, N^2, (Nm)^2
THESIS_TRACKING = 0.086  # Table 4.10 [m]


@pytest.fixture(scope="module")
def thesis(calm, estimator):
    """The thesis's way: commanded force, orders chosen on the test part."""
    plsr = estimator("plsr", force="commanded", selection="test", bootstrap=None)
    return plsr, plsr.identify(calm.problem, np.random.default_rng(0))


def test_reaches_the_thesis(calm, thesis) -> None:
    rest = lack_of_fit(calm.problem.validation, thesis[1].model, "commanded")
    assert np.all(np.mean(rest**2, axis=0) <= THESIS_MSE)


def test_its_feedforward_reaches_the_thesis(thesis, replay) -> None:
    log = replay(thesis[1].model).log
    error = np.hypot(*(log.eta_d - log.eta)[:, :2].T)
    assert np.mean(error) <= THESIS_TRACKING


def test_the_order_is_the_minimum_on_the_test_part(calm, thesis) -> None:
    rest = lack_of_fit(calm.problem.validation, thesis[1].model, "commanded")
    for k, dof in enumerate(calm.problem.nominal.dofs):
        mse = {f.i: f.value for f in diagnostics(thesis[1], "order_mse") if f.dof == dof}
        (order,) = [f.value for f in diagnostics(thesis[1], "selected_order") if f.dof == dof]
        assert sorted(mse) == list(range(1, 31))
        assert min(mse, key=mse.get) == order
        assert mse[int(order)] == pytest.approx(np.mean(rest[:, k] ** 2), rel=1e-9)
    assert [f.label for f in diagnostics(thesis[1], "selected_order")] == ["test"] * 3


def test_coefficients_equal_scikit_learn(calm, estimator, rng) -> None:
    plsr = estimator("plsr", force="commanded", selection="test", bootstrap=None)
    problem = calm.problem
    found = plsr.identify(problem, rng)
    samples = plsr.samples(problem.training, problem.nominal, problem.thruster)
    beta = np.array([max(one.order, 1) for one in samples.terms[1:]])
    x = samples.phi[:, 1:] - samples.phi[:, 1:].mean(axis=0)
    x /= x.std(axis=0) * beta
    y = (samples.epsilon - samples.epsilon.mean(axis=0)) / samples.epsilon.std(axis=0)
    predicted = samples.phi @ found.residual.theta
    for k, f in enumerate(diagnostics(found, "selected_order")):
        peer = PLSRegression(int(f.value), scale=False, tol=1e-20, max_iter=100_000)
        expected = peer.fit(x, y).predict(x)[:, k]
        scaled = (predicted[:, k] - samples.epsilon[:, k].mean()) / samples.epsilon[:, k].std()
        np.testing.assert_allclose(scaled, expected, atol=1e-8)


@pytest.mark.parametrize("name", ["plsr", "surface_plsr"])
def test_scaled_coefficients_are_those_before_the_scales(calm, estimator, rng, name) -> None:
    """Jervan (2020), (3.12): Theta = Theta_pre std Y / (beta std X), with beta of (4.8)."""
    method, problem = estimator(name, force="commanded", bootstrap=None), calm.problem
    found = method.identify(problem, rng)
    samples = method.samples(problem.training, problem.nominal, problem.thruster)
    names, dofs = [str(term) for term in samples.terms], problem.nominal.dofs
    theta = np.zeros_like(found.residual.theta)
    for f in diagnostics(found, "scaled_coefficient"):
        i, k = names.index(f.label), dofs.index(f.dof)
        scale = samples.terms[i].order * np.std(samples.phi[:, i])
        theta[i, k] = f.value * np.std(samples.epsilon[:, k]) / scale
    theta[0] = np.mean(samples.epsilon - samples.phi @ theta, axis=0)  # (3.13)
    np.testing.assert_allclose(theta, found.residual.theta, rtol=1e-9, atol=1e-9)


def test_filtered_force_makes_it_exact(calm, estimator, rng) -> None:
    plsr = estimator("plsr", force="filtered", bootstrap=None)
    found = plsr.identify(calm.problem, rng)
    truth = calm.residual.on(found.residual.terms).theta
    real = truth != 0.0
    assert np.max(np.abs(found.residual.theta[real] / truth[real] - 1.0)) < 1e-6
    assert [f.label for f in diagnostics(found, "selected_order")] == ["blocked"] * 3


def test_columns_of_the_heading_make_it_exact_under_a_constant_force(
    constant, estimator, rng
) -> None:
    plsr = estimator("plsr", extra_terms=["cos(psi)", "sin(psi)"], bootstrap=None)
    found = plsr.identify(constant.problem, rng).residual
    np.testing.assert_allclose(found.row("cos(psi)"), [-200.0, -100.0, 0.0], atol=1e-4)
    np.testing.assert_allclose(found.row("sin(psi)"), [-100.0, 200.0, 0.0], atol=1e-4)


def test_blocked_selection_never_sees_the_test_part(calm, estimator) -> None:
    plsr = estimator("plsr", bootstrap=None, force="commanded")
    problem = calm.problem
    blind = type(problem)(problem.training, problem.training, problem.nominal, problem.thruster)
    found = [plsr.identify(p, np.random.default_rng(0)) for p in (problem, blind)]
    np.testing.assert_array_equal(found[0].residual.theta, found[1].residual.theta)


def test_too_few_samples_are_refused(calm, estimator, rng) -> None:
    plsr = estimator("plsr", basis="linear", bootstrap=None)
    problem = replace(calm.problem, training=calm.problem.training.part(slice(9)))
    with pytest.raises(IdentificationError, match="9 samples for 6 folds, expected at least 12"):
        plsr.identify(problem, rng)


def test_bootstrap_errors_are_reproducible(lap, estimator) -> None:
    plsr = estimator("plsr", lowpass_hz=0.5, bootstrap=50)
    problem = lap("noise", 0).problem
    found = [plsr.identify(problem, np.random.default_rng(3)).std_error for _ in range(2)]
    np.testing.assert_array_equal(*found)
    assert np.all(found[0] > 0.0)
