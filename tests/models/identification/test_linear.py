"""Factorisations piece by piece against those of LAPACK at once."""

import numpy as np
import pytest

from seatrial.models.identification import linear


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(linear, "TOGETHER", 50)


def matrix(n: int) -> np.ndarray:
    """Seven columns of very different sizes, two of them nearly the same."""
    x = np.random.default_rng(0).standard_normal((n, 7)) * 10.0 ** np.arange(-3, 4)
    x[:, 1] = 1e-7 * x[:, 0] + x[:, 2] / 100.0
    return x


@pytest.mark.parametrize("n", [7, 60, 100, 149, 731])
def test_q_and_r_are_those_of_the_whole(n: int) -> None:
    x = matrix(n)
    Q, R = linear.qr(x.copy())
    np.testing.assert_allclose(Q @ R, x, atol=1e-15 * np.linalg.norm(x))
    np.testing.assert_allclose(Q.T @ Q, np.eye(7), atol=1e-13)
    np.testing.assert_array_equal(R, np.triu(R))


@pytest.mark.parametrize("n", [7, 60, 100, 149, 731])
def test_singular_values_are_those_of_the_whole(n: int) -> None:
    x = matrix(n)
    u, s, vt = linear.svd(x.copy())
    np.testing.assert_allclose(u * s @ vt, x, atol=1e-14 * np.linalg.norm(x))
    np.testing.assert_allclose(u.T @ u, np.eye(7), atol=1e-13)
    np.testing.assert_allclose(s, np.linalg.svd(x, compute_uv=False), atol=1e-14 * s[0])
