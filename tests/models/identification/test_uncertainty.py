"""Standard errors against known variances and against the spread over replications."""

import numpy as np
import pytest

from seatrial.models.identification.uncertainty import (
    block_bootstrap,
    enlargement,
    long_run_share,
    parameter_covariance,
    stationary_covariance,
)
from seatrial.models.vessel.basis import terms


def autoregression(rng: np.random.Generator, n: int, rho: float) -> np.ndarray:
    """x_i = rho x_(i-1) + white noise of variance 1."""
    from scipy.signal import lfilter

    return lfilter([1.0], [1.0, -rho], rng.standard_normal(n + 500))[500:]


@pytest.mark.parametrize("rho", [0.0, 0.7, 0.95])
@pytest.mark.parametrize("kind", ["stationary", "bootstrap"])
def test_error_of_the_contrast_of_two_halves_of_an_autoregression(kind, rho) -> None:
    n = 20_000
    gain = np.where(np.arange(n) < n // 2, -1.0, 1.0)[:, None] / n
    found = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        e = autoregression(rng, n, rho)[:, None]
        if kind == "stationary":
            found.append(np.sqrt(stationary_covariance(gain, e[:, 0])[0, 0]))
        else:
            found.append(block_bootstrap(lambda rest: np.sum(gain * rest), e, 400, 200, rng))
    assert np.mean(found) == pytest.approx(1.0 / (1.0 - rho) / np.sqrt(n), rel=0.15)


def test_a_slow_disturbance_in_white_noise_is_seen_by_a_wide_bandwidth() -> None:
    """Hardly correlated neighbours, var = 0.05 / (1 - rho)^2 + 1 for sums: 21 times white noise."""
    n, length, rho = 6000, 500, 0.95
    gain, truth = np.ones((n, 1)) / n, (0.05 / (1.0 - rho) ** 2 + 1.0) / n
    usual, wide, shares = [], [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        slow = autoregression(rng, n, rho)
        e = (np.sqrt(0.05) * slow + rng.standard_normal(n))[:, None]
        usual.append(stationary_covariance(gain, e[:, 0])[0, 0])
        wide.append(stationary_covariance(gain, e[:, 0], length)[0, 0])
        shares.append(long_run_share(e, 200.0)[0])
        assert long_run_share(rng.standard_normal((n, 2)), 50.0) == pytest.approx(1.0, abs=0.4)
    assert np.mean(usual) < 0.7 * truth
    assert np.mean(wide) == pytest.approx(enlargement(length / n) * truth, rel=0.2)
    assert np.mean(shares) == pytest.approx(21.0 / (1.0 + 0.05 / (1.0 - rho**2)), rel=0.25)


@pytest.mark.parametrize("width", [None, 30.0])
def test_a_covariance_has_the_variance_of_every_combination(width: float | None) -> None:
    rng = np.random.default_rng(3)
    gain, rest = rng.standard_normal((500, 3)), autoregression(rng, 500, 0.8)
    mix = np.array([[1.0, -2.0, 0.5]])
    covariance = stationary_covariance(gain, rest, width)
    mixed = stationary_covariance(gain @ mix.T, rest, width)
    np.testing.assert_allclose(mix @ covariance @ mix.T, mixed, rtol=1e-9)
    assert np.all(np.linalg.eigvalsh(covariance) > 0.0)


def test_white_residuals_give_the_textbook_error(identifier, calm, rng) -> None:
    ls = identifier("ls", force="actual", basis="physical")
    training = calm.problem.training.part(slice(None))
    noise = rng.standard_normal(training.tau_actual.shape)
    object.__setattr__(training, "tau_actual", training.tau_actual + noise)
    problem = type(calm.problem)(
        training, calm.problem.validation, calm.problem.nominal, calm.thruster
    )
    found = ls.identify(problem, rng)
    phi = ls.samples(training, problem.nominal, None).phi
    textbook = np.sqrt(np.diag(np.linalg.inv(phi.T @ phi)))
    ratio = found.std_error / textbook[:, None]
    assert np.all((ratio > 0.8) & (ratio < 1.25))


@pytest.mark.nightly
def test_reported_errors_agree_with_the_spread(lap, identifier) -> None:
    """Relative errors of the three diagonal inertia entries, over a hundred recordings."""
    ls, error, reported = identifier("ls", lowpass_hz=0.5, basis="physical"), [], []
    for seed in range(100):
        sailed = lap("noise", seed)
        truth = np.diag(sailed.truth.inertia)
        found = ls.identify(sailed.problem, np.random.default_rng(seed))
        rows = [found.residual.terms.index(one) for one in terms(["u_dot", "v_dot", "r_dot"])]
        error.append(np.diag(found.model.inertia) / truth - 1.0)
        reported.append(np.diag(found.std_error[rows]) / truth)
    ratio = np.mean(reported, axis=0) / np.std(error, axis=0, ddof=1)
    about_mean = np.abs(error - np.mean(error, axis=0)) < 1.96 * np.array(reported)
    assert np.all((ratio > 0.5) & (ratio < 2.0))
    assert np.all(np.mean(about_mean, axis=0) > 0.85)


def test_an_interval_of_a_fixed_width_covers_where_the_sum_has_few_parts() -> None:
    """The mean of white noise, with a bandwidth of a sixth of the record."""
    rng, n, gain = np.random.default_rng(0), 600, np.ones((600, 1))
    inside, narrow = [], []
    for _ in range(2000):
        e = rng.standard_normal(n)
        deviation = np.sqrt(stationary_covariance(gain, e - np.mean(e), n / 6)[0, 0])
        inside.append(abs(np.sum(e)) <= 1.96 * deviation)
        narrow.append(abs(np.sum(e)) <= 1.96 * deviation / np.sqrt(enlargement(1 / 6)))
    assert np.mean(narrow) < 0.935
    assert np.mean(inside) == pytest.approx(0.95, abs=0.01)


def columns() -> np.ndarray:
    """Two columns that are nearly alike: their sum is known far better than each, (N, 2)."""
    rng = np.random.default_rng(0)
    one, other = np.repeat(rng.standard_normal((2, 60)), 50, axis=1)
    return np.stack([one, one + 0.05 * other], axis=1)


def estimated(
    J: np.ndarray, e: np.ndarray, prior: float = 0.0, tau: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Estimates (2,) of parameters that are zero, and their covariance."""
    p = np.linalg.solve(J.T @ J + tau * prior * np.eye(2), J.T @ e)
    rest = (e - J @ p)[:, None]
    return p, parameter_covariance(J, rest, np.full(2, prior), tau, 2, None)


@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_the_covariance_of_parameters_is_that_of_the_estimates(rho: float) -> None:
    """Of each parameter and of their sum."""
    J = columns()
    fits = [estimated(J, autoregression(np.random.default_rng(s), len(J), rho)) for s in range(400)]
    true = np.cov(np.array([estimate for estimate, _ in fits]).T)
    own = np.mean([covariance for _, covariance in fits[:40]], axis=0)
    for mix in np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]):
        assert mix @ own @ mix == pytest.approx(mix @ true @ mix, rel=0.25)


def test_a_prior_has_its_share_whatever_the_residuals_say() -> None:
    """Where the data say nothing the variance is the prior's, else tau H^-1 for white residuals."""
    rng, J = np.random.default_rng(3), columns()
    _, nothing = estimated(1e-6 * J, rng.standard_normal(len(J)), prior=4.0, tau=7.0)
    np.testing.assert_allclose(np.diag(nothing), 0.25, rtol=1e-6)
    _, something = estimated(J, rng.standard_normal(len(J)), prior=30.0)
    inverse = np.linalg.inv(J.T @ J + 30.0 * np.eye(2))
    np.testing.assert_allclose(something, inverse, atol=0.1 * np.max(inverse))
