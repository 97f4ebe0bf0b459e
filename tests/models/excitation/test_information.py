"""D-optimal mixes (literature, equivalence theorem), and what data can tell apart."""

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.models.excitation.information import (
    inseparable,
    largest_remainder,
    log_det,
    optimal,
    persistence,
    scaled,
    spectral_lines,
)
from seatrial.models.notation import PLANAR
from seatrial.models.recording.recording import Recording, attitude_of
from seatrial.models.vessel import basis
from seatrial.models.vessel.derivatives import from_derivatives
from seatrial.models.vessel.table import Vessel

DOFS = ("surge",)


def information(phi: np.ndarray) -> np.ndarray:
    return np.asarray(phi.T @ phi / len(phi))


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
    share, _ = optimal(polynomial(degree, points), [f"x^{i}" for i in range(degree + 1)])
    chosen = np.isin(points, support)
    np.testing.assert_allclose(share[chosen], 1.0 / (degree + 1), atol=1e-3)
    np.testing.assert_allclose(share[~chosen], 0.0, atol=1e-3)


def manoeuvres(seed: int, q: int = 11, n: int = 13) -> np.ndarray:
    """Information of random manoeuvres of any rank, scaled, (Q, n, n)."""
    rng = np.random.default_rng(seed)
    samples = [rng.standard_normal((rng.integers(4, 40), n)) for _ in range(q)]
    return scaled(np.array([information(x * rng.uniform(0.1, 2.0, n)) for x in samples]))


@pytest.mark.parametrize("seed", range(6))
def test_the_equivalence_theorem_holds(seed: int) -> None:
    """Kiefer and Wolfowitz (1960): max_q d_q = n, reached by every manoeuvre that is in the mix."""
    gammas = manoeuvres(seed)
    share, gap = optimal(gammas, [str(i) for i in range(13)])
    assert gap <= 1e-6
    inverse = np.linalg.inv(np.tensordot(share, gammas, axes=1))
    d = np.trace(inverse @ gammas, axis1=1, axis2=2)
    assert np.max(d) <= 13.0 + 1e-6
    np.testing.assert_allclose(d[share > 1e-3], 13.0, atol=1e-4)
    assert share @ d == pytest.approx(13.0)  # tr(Gamma^-1 Gamma) = n
    rng = np.random.default_rng(seed)
    best = log_det(gammas, share)
    assert all(log_det(gammas, other) < best for other in rng.dirichlet(np.ones(11), 500))


def test_the_optimum_does_not_depend_on_units() -> None:
    gammas, units = manoeuvres(0), np.geomspace(1e-4, 1e4, 13)
    names = [str(i) for i in range(13)]
    other, _ = optimal(gammas * np.outer(units, units), names)
    np.testing.assert_allclose(other, optimal(gammas, names)[0], atol=1e-6)


def test_manoeuvres_that_cannot_tell_terms_apart_are_refused() -> None:
    phi = np.random.default_rng(0).standard_normal((50, 2))
    same = np.column_stack([phi, phi[:, 1]])
    gammas = np.array([information(same), information(2.0 * same)])
    with pytest.raises(ConfigurationError, match="do not separate v, v r"):
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


def recording(
    nu: np.ndarray, dofs: tuple[str, ...] = DOFS, tau: np.ndarray | None = None
) -> Recording:
    t = 0.1 * np.arange(len(nu))
    nu_dot = np.gradient(nu, 0.1, axis=0)
    eta = np.cumsum(nu, axis=0) * 0.1
    force = nu if tau is None else tau
    return Recording(dofs, t, eta, nu, nu_dot, force, attitude_of(dofs, eta))


def surge() -> Vessel:
    return from_derivatives("s", DOFS, np.array([[60.0]]), {"X_u": -20.0, "X_|u|u": -2.0})


def test_a_varied_motion_tells_all_terms_apart() -> None:
    t = 0.1 * np.arange(2000)
    nu = (np.sin(0.1 * t) + 0.5 * np.sin(0.73 * t))[:, None]
    (found,) = persistence(recording(nu), surge())
    assert found.warning() is None
    assert (found.rank, len(found.terms)) == (3, 3)
    phi = basis.evaluate(surge().terms, recording(nu).variables())
    scaled = phi / np.linalg.norm(phi, axis=0)
    assert found.condition == pytest.approx(np.linalg.cond(scaled))


def test_a_steady_motion_cannot_tell_damping_terms_apart() -> None:
    nu = 0.5 + 0.001 * np.sin(0.1 * np.arange(1000))[:, None]
    (found,) = persistence(recording(nu), surge())
    assert ("u", "|u|u") in found.inseparable or ("|u|u", "u") in found.inseparable
    assert "not separable" in (found.warning() or "")
    assert found.rank == 2


def test_what_does_not_move_is_not_excited() -> None:
    t = 0.1 * np.arange(1000)
    nu = np.column_stack([np.sin(0.3 * t), np.zeros(1000), np.zeros(1000)])
    vessel = from_derivatives(
        "v", PLANAR, np.diag([1.0, 2.0, 3.0]), {"X_u": -1.0, "Y_v": -1.0, "N_r": -1.0}
    )
    reports = persistence(recording(nu, PLANAR), vessel)
    assert reports[0].unexcited == ("vr",)
    assert reports[1].unexcited == ("v_dot", "ur", "v")
    assert reports[1].rank == 0
    said = "yaw: 0 of 3 terms separable, 0 spectral lines: r_dot, uv, r not excited"
    assert reports[2].warning() == said


def test_spectral_lines_are_counted() -> None:
    t = 0.1 * np.arange(4000)
    lines = [np.sin(2 * np.pi * k * t / 400.0) for k in (5, 12, 40)]
    assert spectral_lines(lines[0]) == 1
    assert spectral_lines(3.0 + sum(lines)) == 3
    assert spectral_lines(np.full(100, 7.0)) == 0
    assert spectral_lines(np.zeros(100)) == 0
    burst = np.concatenate([np.zeros(3000), 3.0 + sum(lines), np.zeros(5000)])
    assert spectral_lines(burst) == 3  # rest before and after it adds none


def test_lines_are_those_of_the_whole_experiment() -> None:
    """23 lines on every third multiple of 1 / 720 s, which half of it does not resolve."""
    t = 0.1 * np.arange(7200)
    force = sum(np.sin(2 * np.pi * (4 + 3 * k) * t / 720.0 + k * k) for k in range(23))[:, None]
    nu = (np.sin(0.1 * t) + 0.5 * np.sin(0.73 * t))[:, None]
    whole = recording(nu, tau=force)
    half = whole.part(t < 360.0)
    (found,) = persistence(half, surge(), whole)
    assert found.lines == 23
    assert persistence(half, surge())[0].lines < 23
