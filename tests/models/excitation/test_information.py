"""D-optimal mixes: designs known from the literature, the equivalence theorem, SLSQP."""

import numpy as np
import pytest
from scipy.optimize import minimize

from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.information import (
    information,
    inseparable,
    largest_remainder,
    log_det,
    optimal,
    scaled,
    sensitivities,
)


def polynomial(degree: int, points: np.ndarray) -> np.ndarray:
    """Information of one measurement of a polynomial at each point, (Q, n, n)."""
    rows = np.vander(points, degree + 1, increasing=True)
    return np.einsum("qi,qj->qij", rows, rows)


@pytest.mark.parametrize(
    ("degree", "support"),
    [
        (1, [-1.0, 1.0]),
        (2, [-1.0, 0.0, 1.0]),
        (3, [-1.0, -1.0 / np.sqrt(5.0), 1.0 / np.sqrt(5.0), 1.0]),
        (4, [-1.0, -np.sqrt(3.0 / 7.0), 0.0, np.sqrt(3.0 / 7.0), 1.0]),
    ],
)
def test_polynomials_are_measured_where_guest_found(degree: int, support: list[float]) -> None:
    """Guest (1958): equal weights at the ends and where the Legendre polynomial is extreme."""
    points = np.unique(np.concatenate([np.linspace(-0.9, 0.9, 8), support]))
    found = optimal(polynomial(degree, points), [f"x^{i}" for i in range(degree + 1)])
    chosen = np.isin(points, support)
    np.testing.assert_allclose(found.share[chosen], 1.0 / (degree + 1), atol=1e-3)
    np.testing.assert_allclose(found.share[~chosen], 0.0, atol=1e-3)


def manoeuvres(seed: int, q: int = 11, n: int = 13) -> np.ndarray:
    """Information of random manoeuvres of any rank, scaled, (Q, n, n)."""
    rng = np.random.default_rng(seed)
    samples = [rng.standard_normal((rng.integers(4, 40), n)) for _ in range(q)]
    return scaled(np.array([information(x * rng.uniform(0.1, 2.0, n)) for x in samples]))


def by_slsqp(gammas: np.ndarray) -> np.ndarray:
    q = len(gammas)

    def slope(w: np.ndarray) -> np.ndarray:
        return -sensitivities(gammas, w)

    found = minimize(
        lambda w: -log_det(gammas, w), np.full(q, 1.0 / q), jac=slope, method="SLSQP",
        bounds=[(0.0, 1.0)] * q, options={"ftol": 1e-14, "maxiter": 1000},
        constraints={"type": "eq", "fun": lambda w: np.sum(w) - 1.0},
    )  # fmt: skip
    assert found.success
    return found.x


@pytest.mark.parametrize("seed", range(6))
def test_the_optimum_is_that_of_slsqp(seed: int) -> None:
    gammas = manoeuvres(seed)
    found = optimal(gammas, [str(i) for i in range(13)])
    assert found.gap <= 1e-6
    np.testing.assert_allclose(found.share, by_slsqp(gammas), atol=1e-4)


@pytest.mark.parametrize("seed", range(6))
def test_the_equivalence_theorem_holds(seed: int) -> None:
    """Kiefer and Wolfowitz (1960): max_q d_q = n, reached by every manoeuvre that is in the mix."""
    gammas = manoeuvres(seed)
    share = optimal(gammas, [str(i) for i in range(13)]).share
    d = sensitivities(gammas, share)
    assert np.max(d) <= 13.0 + 1e-6
    np.testing.assert_allclose(d[share > 1e-3], 13.0, atol=1e-4)
    assert share @ d == pytest.approx(13.0)  # tr(Gamma^-1 Gamma) = n
    rng = np.random.default_rng(seed)
    best = log_det(gammas, share)
    assert all(log_det(gammas, other) < best for other in rng.dirichlet(np.ones(11), 500))


def test_the_optimum_does_not_depend_on_units() -> None:
    gammas, units = manoeuvres(0), np.geomspace(1e-4, 1e4, 13)
    other = optimal(gammas * np.outer(units, units), [str(i) for i in range(13)])
    names = [str(i) for i in range(13)]
    np.testing.assert_allclose(other.share, optimal(gammas, names).share, atol=1e-6)


def test_one_manoeuvre_is_the_whole_mix() -> None:
    found = optimal(manoeuvres(2, q=1, n=3), ["a", "b", "c"])
    assert found.share.tolist() == [1.0]
    assert found.gap <= 1e-6


def test_manoeuvres_that_cannot_tell_terms_apart_are_refused() -> None:
    phi = np.random.default_rng(0).standard_normal((50, 2))
    same = np.column_stack([phi, phi[:, 1]])
    gammas = np.array([information(same), information(2.0 * same)])
    with pytest.raises(ConfigurationError, match="do not tell v, v r apart"):
        optimal(gammas, ["u", "v", "v r"])
    assert inseparable(information(phi), ["u", "v"]) == ()


def test_largest_remainder() -> None:
    """The textbook case of Hamilton's method: 100,000 votes, ten seats."""
    votes = np.array([47_000, 16_000, 15_900, 12_000, 6_000, 3_100]) / 100_000
    assert largest_remainder(votes, 10).tolist() == [5, 2, 1, 1, 1, 0]
    assert largest_remainder(np.ones(4), 6).tolist() == [2, 2, 1, 1]
    assert largest_remainder(np.array([0.5, 0.0, 0.5]), 6).tolist() == [3, 0, 3]


@pytest.mark.parametrize("seed", range(20))
def test_rounding_keeps_the_sum_and_the_quota(seed: int) -> None:
    rng = np.random.default_rng(seed)
    share = rng.dirichlet(np.full(11, 0.3))
    total = int(rng.integers(1, 60))
    counts = largest_remainder(share, total)
    assert counts.sum() == total
    assert np.all(np.abs(counts - share * total) < 1.0 + 1e-9)
