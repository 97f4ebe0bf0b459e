"""Gaussian process of the residual force: no worse than nothing, and what the terms follow."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError
from seatrial.models.identification.gaussian_process import (
    ParametricTerms,
    Prior,
    ProcessData,
    projection_warnings,
)
from seatrial.models.identification.residual import Samples
from seatrial.models.identification.validation import prediction
from seatrial.models.vessel import basis


def values(found, name: str) -> dict:
    return {f.label or f.dof: f.value for f in found.diagnostics if f.name == name}


@pytest.fixture(scope="session")
def fitted(lap, identifier):
    """fitted(weather, seed, option=value, ...) -> what is identified, once for all tests."""

    @cache
    def found(weather: str, seed: int = 0, **options):
        process = identifier("gaussian_process", **options)
        return process.identify(lap(weather, seed).problem, np.random.default_rng(0))

    return found


def free_run(problem, model) -> np.ndarray:
    """Errors of the velocities (n_dof,) over the part held out."""
    return prediction(model, problem.validation, problem.thruster, None).over("free_run").rmse[3:]


@pytest.mark.parametrize("kernel", ["rbf", "matern"])
def test_calm_water_is_predicted_far_better_than_by_the_nominal_model(calm, fitted, kernel) -> None:
    found = fitted("calm", kernel=kernel)
    none = free_run(calm.problem, calm.problem.nominal)
    assert np.all(free_run(calm.problem, found.model) < 0.01 * none)
    assert min(values(found, "projection_r2").values()) > 0.99


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.nightly) for k in (1, 2))])
def test_noise_leaves_it_close_to_the_plant(lap, fitted, seed) -> None:
    noisy, found = lap("noise", seed), fitted("noise", seed)
    mine, none, plant = (
        free_run(noisy.problem, model)
        for model in (found.model, noisy.problem.nominal, noisy.truth)
    )
    assert np.all(mine < 0.5 * none)
    assert np.all(mine < 1.5 * plant)


@pytest.mark.parametrize("base", ["physical", "inertia", "none"])
def test_the_model_that_predicts_the_blocks_best_is_taken(constant, identifier, rng, base) -> None:
    found = identifier("gaussian_process", base=base).identify(constant.problem, rng)
    errors, chosen = values(found, "left_out_error"), values(found, "chosen")
    (name,) = [label for label, value in chosen.items() if value == 1.0]
    assert errors[name] == min(errors.values())
    if name == "none":
        assert np.all(found.residual.theta == 0.0)


def test_a_force_of_noise_keeps_the_nominal_model(calm, identifier, rng) -> None:
    training = calm.problem.training
    fitted = calm.problem.nominal.inverse(training.nu_dot, training.nu)
    tau = fitted + 10.0 * rng.standard_normal(fitted.shape)
    problem = replace(calm.problem, training=replace(training, tau=tau, tau_filtered=tau))
    found = identifier("gaussian_process", lowpass_hz=None).identify(problem, rng)
    change = (found.model - calm.problem.nominal).inverse(training.nu_dot, training.nu)
    assert np.all(np.sqrt(np.mean(change**2, axis=0)) < 0.02 * np.std(fitted, axis=0))


def test_the_posterior_mean_is_that_of_scikit_learn() -> None:
    """Every sample an inducing point, no base, independent residuals: the exact posterior."""
    rng = np.random.default_rng(1)
    nu = rng.uniform(-1.0, 1.0, (80, 2))
    y = np.sin(3.0 * nu[:, 0]) + nu[:, 1] ** 2 + 0.3 * rng.standard_normal(80)
    kernel, noise = ConstantKernel(2.0) * RBF([0.7, 0.9]), 0.09
    data = samples_of(nu, y)
    prior = Prior(kernel, np.ones(2), 1.0, noise)
    found = data.posterior(prior, ParametricTerms([], np.zeros(0)), 0, 2)
    at = rng.uniform(-2.0, 2.0, (50, 2))
    mean = prior.covariance(at, nu) @ found.weights[:, 0]
    exact = GaussianProcessRegressor(kernel, alpha=found.noise, optimizer=None).fit(nu, y)
    np.testing.assert_allclose(mean, exact.predict(at), atol=1e-5)
    assert found.left_out_r2 > 0.5


def test_far_from_the_recording_the_process_is_nothing() -> None:
    rng = np.random.default_rng(2)
    nu = rng.uniform(-1.0, 1.0, (80, 2))
    data = samples_of(nu, 5.0 + nu[:, 0])
    prior = Prior(ConstantKernel(25.0) * RBF([1.0, 1.0]), np.ones(2), 1.0, 0.01)
    weights = data.posterior(prior, ParametricTerms([], np.zeros(0)), 0, 2).weights[:, 0]
    near, far = prior.covariance(np.array([[0.0, 0.0], [20.0, 0.0]]), nu) @ weights
    assert near == pytest.approx(5.0, rel=0.05)
    assert abs(far) < 1e-6


def samples_of(nu: np.ndarray, y: np.ndarray) -> ProcessData:
    terms = basis.terms(["u", "v"])
    samples = Samples(terms, nu, y[:, None], y[:, None], np.zeros((len(y), 2)), 0.1)
    return ProcessData(samples, nu, lambda columns: columns, np.arange(len(y)), nu, np.ones(2))


def test_few_terms_cannot_follow_and_it_says_so(calm, identifier, fitted, rng) -> None:
    few = identifier("gaussian_process", basis=["u_dot", "v_dot", "r_dot", "u"], cubic=False)
    r2 = values(few.identify(calm.problem, rng), "projection_r2")
    whole = values(fitted("calm", kernel="rbf"), "projection_r2")
    assert min(r2.values()) < 0.9 < min(whole.values())


def test_a_poor_projection_is_a_warning_of_one_line() -> None:
    (warning,) = projection_warnings(
        [Diagnostic("projection_r2", "surge", 0.95), Diagnostic("projection_r2", "sway", 0.42)]
    )
    assert warning.startswith("sway: the terms follow")
    assert "R^2 = 0.42, expected at least 0.9" in warning
    assert "\n" not in warning


def test_the_inertia_stays_within_its_bounds(lap, fitted) -> None:
    nominal = np.diag(lap("noise").problem.nominal.inertia)
    found = (fitted("noise", 0, inertia_factor=1.01), fitted("noise", 0))
    ratios = [np.diag(one.model.inertia) / nominal for one in found]
    assert np.all((ratios[0] > 1.0 / 1.011) & (ratios[0] < 1.011))
    assert np.any(np.abs(ratios[1] - 1.0) > 0.02)


@pytest.mark.parametrize("options", [{"kernel": "cosine"}, {"base": "ls"}, {"subsample": 5}])
def test_options_are_checked(identifier, options) -> None:
    with pytest.raises(ConfigurationError, match=next(iter(options))):
        identifier("gaussian_process", **options)
