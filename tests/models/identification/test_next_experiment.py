"""The expected interval is that of Bayes' rule, and more information never widens it."""

from itertools import chain, combinations_with_replacement, pairwise

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.models.identification.free_run import course_of, free_run
from seatrial.models.identification.next_experiment import (
    NORMAL_90,
    Purpose,
    doubted,
    information,
    learnt,
    ranked,
)
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from tests.trials import composed

MASS, SHARE, N = 4.0, 0.25, 300  # less than a segment
MEAN, COVARIANCE = np.array([2.0, 1.0]), np.array([[0.05, 0.03], [0.03, 0.08]])  # of u, |u|u


def _vessel(damping: Array) -> Vessel:
    theta = np.array([[MASS], [damping[0]], [damping[1]]])
    return Vessel("toy", ("surge",), basis.terms(["u_dot", "u", "|u|u"]), theta)


def _draws(count: int = 60) -> list[Vessel]:
    z = np.random.default_rng(0).standard_normal((count, 2))
    z = z @ np.linalg.inv(np.linalg.cholesky(z.T @ z / count)).T  # exactly white
    return [_vessel(MEAN + SHARE * c) for c in z @ np.linalg.cholesky(COVARIANCE).T]


BELIEF = learnt(_vessel(MEAN), _draws(), SHARE)


def _motion(model: Vessel, start: float = 0.3) -> Recording:
    """A free run under a force that varies."""
    t = 0.1 * np.arange(N, dtype=np.float64)
    zero, wind = np.zeros((N, 1)), np.zeros((N, 3))
    tau = 3.0 * np.sin(0.3 * t)[:, None] + 2.0 * np.sin(0.8 * t)[:, None]
    still = Recording(("surge",), t, zero, zero + start, zero, tau, wind)
    moved = free_run(model, course_of(still, None, None, None, 100.0), "rk4")
    return Recording(("surge",), t, moved[:, :1], moved[:, 1:], zero, tau, wind)


def test_draws_tell_their_covariance() -> None:
    assert BELIEF.free.labels == ("surge.u", "surge.|u|u")
    assert BELIEF.basis @ BELIEF.basis.T == pytest.approx(COVARIANCE)
    with pytest.raises(ConfigurationError, match="nothing of the model is uncertain"):
        learnt(_vessel(MEAN), [_vessel(MEAN)] * 5, SHARE)


def test_derivatives_are_those_of_free_runs_without_what_the_start_explains() -> None:
    motion = _motion(BELIEF.at(np.zeros(2)))
    J, rest = BELIEF.free_runs(motion, None, np.array([0.2]))
    assert rest == pytest.approx(np.zeros((N, 1)), abs=1e-9)
    step = 1e-4

    def change(u: Array, start: float) -> Array:
        return (_motion(BELIEF.at(u), start).nu - motion.nu)[:, 0] / step

    own = np.column_stack([change(step * u, 0.3) for u in np.eye(2)])
    start = change(np.zeros(2), 0.3 + step)
    own -= np.outer(start, start @ own) / (start @ start)
    assert J[:, 0] == pytest.approx(own, abs=1e-3 * np.max(np.abs(own)))
    told = information(J, np.array([0.2]))
    assert told == pytest.approx(own.T @ own / 0.2**2, rel=1e-2)


def test_a_prediction_that_is_linear_has_its_exact_gradient() -> None:
    a = np.array([0.7, -1.1])

    def value(u: Array) -> Array:
        if u[0] > 0.5:  # what some draws cannot do
            raise ConfigurationError("no")
        return np.array([a @ BELIEF.at(u).theta[1:, 0]])

    own, gradient = BELIEF.gradient(value, np.zeros(2))
    assert own == pytest.approx([a @ MEAN])
    width = Purpose("z", gradient).width()
    assert width == pytest.approx(NORMAL_90 * np.sqrt(a @ COVARIANCE @ a))
    with pytest.raises(ConfigurationError, match="expected more than 2"):
        BELIEF.gradient(lambda u: np.array([np.nan]) if np.any(u) else np.ones(1), np.zeros(2))


def test_more_information_never_widens() -> None:
    rng = np.random.default_rng(1)
    purpose = Purpose("coefficients", rng.standard_normal((3, 5)))
    parts = rng.standard_normal((20, 5, 2))
    told = parts @ parts.transpose(0, 2, 1)
    widths = [purpose.width(told[:k].sum(axis=0)) for k in range(21)]
    assert all(b <= a + 1e-12 for a, b in pairwise(widths))
    assert widths[-1] < 0.9 * widths[0]


def test_what_narrows_most_in_a_second_is_first() -> None:
    purpose = Purpose("z", np.array([[1.0, 0.0]]))
    told = np.array([np.diag([0.0, 9.0]), np.diag([3.0, 0.0]), np.diag([3.0, 0.0])])
    assert ranked(purpose, np.zeros((2, 2)), told, np.array([1.0, 20.0, 10.0]), 0.9) == [2, 1, 0]
    widths = [purpose.width(each) for each in told]
    assert widths == pytest.approx(NORMAL_90 * np.array([1.0, 0.5, 0.5]))


@pytest.mark.parametrize("name", ["z", "coefficients"])
def test_a_plan_is_no_longer_than_a_d_optimal_design_and_near_the_shortest(name: str) -> None:
    """The shortest by trying all sets of up to four."""
    rng, longer = np.random.default_rng(2), list[float]()
    for _ in range(12):
        purpose = Purpose(name, rng.standard_normal((3, 6)))
        parts, seconds = rng.standard_normal((9, 6, 2)), rng.uniform(1.0, 3.0, 9)
        told = parts @ parts.transpose(0, 2, 1)
        H, design = np.eye(6), list[int]()
        for _ in range(4):
            gain = np.linalg.slogdet(H + told)[1] - np.linalg.slogdet(H)[1]
            design.append(int(np.argmax(gain / seconds)))
            H = H + told[design[-1]]
        target = purpose.width(H - np.eye(6)) * (1.0 + 1e-9)
        known, spent = np.zeros((6, 6)), 0.0
        while purpose.width(known) > target:
            first = ranked(purpose, known, told, seconds, target)[0]
            known, spent = known + told[first], spent + seconds[first]
        assert spent <= np.sum(seconds[design]) + 1e-9
        sets = chain.from_iterable(combinations_with_replacement(range(9), k) for k in range(1, 5))
        reaching = [s for s in map(list, sets) if purpose.width(told[s].sum(axis=0)) <= target]
        longer.append(spent / min(np.sum(seconds[s]) for s in reaching))
    assert np.median(longer) < 1.05


def test_a_doubt_leaves_accelerations_and_dimensions() -> None:
    model = composed("vessel=kvlcc2", "excitation=rudder_turn", "controller=none").vessel.nominal()
    belief = doubted(model, 0.2)
    assert not any(label.endswith(("_dot", "area_m2")) for label in belief.free.labels)
    assert "sway.vU" in belief.free.labels
    assert NORMAL_90 * np.diag(belief.basis) == pytest.approx(0.2 * np.abs(belief.free.values))
    drawn = belief.at(np.random.default_rng(0).standard_normal(len(belief.free)))
    assert np.array_equal(drawn.inertia, model.inertia)
