"""The expected interval is that of Bayes' rule, and more information never widens it."""

from itertools import pairwise

import numpy as np
import pytest

from seatrial.models.excitation.next_experiment import (
    NORMAL_90,
    Belief,
    Purpose,
    believed,
    doubted,
    ranked,
    scale_of,
)
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from tests.trials import composed

MASS, SIGMA, SHARE, N = 4.0, 0.3, 0.25, 80
COVARIANCE = np.array([[0.5, 0.3], [0.3, 0.8]])  # of the damping u, |u|u


def _vessel(damping: Array) -> Vessel:
    theta = np.array([[MASS], [damping[0]], [damping[1]]])
    return Vessel("toy", ("surge",), basis.terms(["u_dot", "u", "|u|u"]), theta)


def _belief(count: int = 60) -> Belief:
    rng, mean = np.random.default_rng(0), np.array([2.0, 1.0])
    z = rng.standard_normal((count, 2))
    z = z @ np.linalg.inv(np.linalg.cholesky(z.T @ z / count)).T  # exactly white
    changes = z @ np.linalg.cholesky(COVARIANCE).T
    return believed(_vessel(mean), [_vessel(mean + SHARE * c) for c in changes], SHARE)


def _motion(size: float = 1.0) -> Recording:
    t = 0.1 * np.arange(N, dtype=np.float64)
    nu = size * np.sin(t)[:, None]
    zero = np.zeros((N, 1))
    return Recording(("surge",), t, zero, nu, zero, zero, np.zeros((N, 3)))


def test_the_update_is_that_of_bayes_for_a_linear_model() -> None:
    belief, motion = _belief(), _motion()
    information = belief.information(motion, np.array([SIGMA]))
    posterior = belief.basis @ np.linalg.inv(np.eye(2) + information) @ belief.basis.T
    u = motion.nu[:, 0]
    phi = np.column_stack([u, np.abs(u) * u]) / MASS
    exact = np.linalg.inv(np.linalg.inv(COVARIANCE) + phi.T @ phi / SIGMA**2)
    assert posterior[1:, 1:] == pytest.approx(exact, rel=1e-6)
    assert posterior[0] == pytest.approx(np.zeros(3), abs=1e-12)


def test_a_prediction_that_is_linear_has_its_exact_gradient() -> None:
    belief, a = _belief(), np.array([0.7, -1.1])
    values = np.array([a @ draw.theta[1:] for draw in belief.draws])
    gradient = belief.gradient(values, a @ belief.model.theta[1:])
    prior = Purpose("z", gradient).width()
    assert prior == pytest.approx(NORMAL_90 * np.sqrt(a @ COVARIANCE @ a))
    values[3] = np.nan  # a draw that does not reach it
    assert belief.gradient(values, a @ belief.model.theta[1:]) == pytest.approx(gradient)


def test_more_information_never_widens() -> None:
    rng = np.random.default_rng(1)
    purpose = Purpose("coefficients", rng.standard_normal((3, 5)))
    parts = rng.standard_normal((20, 5, 2))
    told = parts @ parts.transpose(0, 2, 1)
    widths = [purpose.width(*told[:k]) for k in range(21)]
    assert all(b <= a + 1e-12 for a, b in pairwise(widths))
    assert widths[-1] < 0.9 * widths[0]


def test_what_narrows_most_in_a_second_is_first() -> None:
    purpose = Purpose("z", np.array([[1.0, 0.0]]))
    told = np.array([np.diag([0.0, 9.0]), np.diag([3.0, 0.0]), np.diag([3.0, 0.0])])
    assert ranked(purpose, np.zeros((2, 2)), told, np.array([1.0, 20.0, 10.0])) == [2, 1, 0]
    widths = [purpose.width(each) for each in told]
    assert widths == pytest.approx(NORMAL_90 * np.array([1.0, 0.5, 0.5]))


def test_the_scale_is_that_of_the_errors_that_were_assumed() -> None:
    """What a regression leaves open with errors that count a fifth has the scale of a fifth."""
    rng = np.random.default_rng(2)
    phi = rng.standard_normal((300, 4))
    own = phi.T @ phi / 5.0  # of the identification; whitens what is known
    A = np.linalg.cholesky(np.linalg.inv(own))
    assert scale_of(A.T @ (phi.T @ phi) @ A) == pytest.approx(1.0 / 5.0)


def test_a_doubt_leaves_accelerations_and_dimensions() -> None:
    model = composed("vessel=kvlcc2", "excitation=rudder_turn", "controller=none").vessel.nominal()
    rng = np.random.default_rng(0)
    drawn = [doubted(model, 0.2, rng, 1.0) for _ in range(300)]
    for other in drawn[:5]:
        assert np.array_equal(other.inertia, model.inertia)
        rudder = dict(zip(other.installed.labels, other.installed.parameters, strict=True))
        assert rudder["rudder.area_m2"] == pytest.approx(0.0539)
    k = [term.name for term in model.terms].index("vU")
    ratio = np.array([other.theta[k, 1] for other in drawn]) / model.theta[k, 1]
    assert np.quantile(np.abs(ratio - 1.0), 0.9) == pytest.approx(0.2, rel=0.15)
