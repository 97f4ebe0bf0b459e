"""Least squares against the plant that sailed."""

from dataclasses import replace

import numpy as np
import pytest

from seatrial.models.errors import IdentificationError
from seatrial.models.identification.problem import Problem
from seatrial.models.vessel.derivatives import from_derivatives
from tests.models.identification.known_results import diagnostics

AXES = ("surge", "sway", "yaw")
HEADING = ["cos(psi)", "sin(psi)"]


def diagonal(vessel) -> np.ndarray:
    return np.diag(vessel.inertia)


@pytest.mark.slow
def test_inertia_under_noise(lap, estimator, rng) -> None:
    ls = estimator("ls", lowpass_hz=0.5)
    truth = diagonal(lap("calm").truth)
    found = [diagonal(ls.identify(lap("noise", s).problem, rng).model) for s in range(10)]
    assert np.max(np.abs(np.mean(found, axis=0) / truth - 1.0)) < 0.02


def test_condition_number_is_that_of_the_standardised_columns(calm, estimator, rng) -> None:
    ls = estimator("ls")
    found = ls.identify(calm.problem, rng)
    samples = ls.samples(calm.problem.training, calm.problem.nominal, calm.thruster)
    columns = samples.phi[:, np.ptp(samples.phi, axis=0) > 1e-12]
    columns = (columns - columns.mean(axis=0)) / columns.std(axis=0)
    reported = {f.dof: f.value for f in found.diagnostics if f.name == "condition_number"}
    assert reported == pytest.approx(dict.fromkeys(AXES, np.linalg.cond(columns)))


def test_a_term_that_does_not_vary_gets_zero_and_is_named(calm, estimator, rng) -> None:
    ls = estimator("ls", basis="physical", extra_terms=["1", "cos(theta)"])
    found = ls.identify(calm.problem, rng)
    assert not np.any(found.residual.row("cos(theta)"))
    assert [f.label for f in found.diagnostics if f.name == "dropped_term"] == ["cos(theta)"]
    row = [str(one) for one in found.residual.terms].index("cos(theta)")
    assert np.all(np.isnan(found.std_error[row]))


def one_way(problem):
    """The problem of what was recorded while the vessel turned to starboard."""
    turning = problem.training.nu[:, 2] > 1e-3
    return replace(problem, training=problem.training.part(turning))


def test_terms_that_cannot_be_told_apart_are_named(calm, estimator, rng) -> None:
    ls = estimator("ls", basis=["u_dot", "1", "cos(phi)", "cos(psi)", "r^2", "|r|r", "r"])
    with pytest.raises(IdentificationError, match=r"r\^2"):
        ls.identify(one_way(calm.problem), rng)


def relative_error(found, truth) -> float:
    """Largest relative error of the residual's coefficients that are not zero."""
    table = truth.on(found.residual.terms).theta
    real = table != 0.0
    return float(np.max(np.abs(found.residual.theta[real] / table[real] - 1.0)))


@pytest.mark.parametrize("basis", ["full", "physical"])
@pytest.mark.parametrize("name", ["ls", "ridge"])
def test_a_constant_ned_force_is_found_exactly(constant, estimator, rng, name, basis) -> None:
    found = estimator(name, basis=basis, extra_terms=HEADING).identify(constant.problem, rng)
    assert found.residual.coefficient("surge", "cos(psi)") == pytest.approx(-200.0, abs=1e-6)
    assert found.residual.coefficient("surge", "sin(psi)") == pytest.approx(-100.0, abs=1e-6)
    assert relative_error(found, constant.residual) < 1e-6


@pytest.mark.parametrize("disturbance", ["calm", "constant"])
def test_the_thruster_lag_is_found_from_the_recording(lap, estimator, rng, disturbance) -> None:
    ls = estimator("ls", thruster="estimated", extra_terms=HEADING)
    found = ls.identify(replace(lap(disturbance).problem, thruster=None), rng)
    assert diagnostics(found, "thruster_natural_frequency")[0].value == pytest.approx(2.0, abs=1e-3)
    assert diagnostics(found, "thruster_damping")[0].value == pytest.approx(0.8, abs=1e-3)
    assert relative_error(found, lap(disturbance).residual) < 1e-3


def test_the_thruster_lag_is_found_under_noise(lap, estimator, rng) -> None:
    ls = estimator("ls", thruster="estimated", lowpass_hz=0.5, basis="physical")
    found = ls.identify(lap("noise", 0).problem, rng)
    assert diagnostics(found, "thruster_natural_frequency")[0].value == pytest.approx(2.0, rel=0.05)
    assert diagnostics(found, "thruster_damping")[0].value == pytest.approx(0.8, rel=0.05)


@pytest.mark.parametrize("alike", [False, True])
def test_ridge_equals_scikit_learn(calm, estimator, rng, alike: bool) -> None:
    """Of terms that cannot be told apart, r^2 and |r|r of one that turns one way, each has half."""
    from sklearn.linear_model import Ridge

    options = {"basis": ["1", "r_dot", "r^2", "|r|r", "r"]} if alike else {"force": "commanded"}
    problem = one_way(calm.problem) if alike else calm.problem
    ridge = estimator("ridge", penalty=0.01, **options)
    found = ridge.identify(problem, rng)
    samples = ridge.samples(problem.training, problem.nominal, problem.thruster)
    x = samples.phi[:, 1:]
    scale = x.std(axis=0)
    peer = Ridge(alpha=0.01 * len(x), solver="svd").fit(x / scale, samples.epsilon)
    theta, rtol = found.residual.theta, 1e-6 if alike else 1e-8
    np.testing.assert_allclose(theta[1:], peer.coef_.T / scale[:, None], rtol=rtol)
    np.testing.assert_allclose(theta[0], peer.intercept_, rtol=rtol)
    assert np.all(np.isfinite(found.std_error))
    if alike:
        np.testing.assert_allclose(theta[2], theta[3], rtol=rtol)
        by_validation = estimator("ridge", **options).identify(problem, rng)
        assert np.all(np.isfinite(by_validation.residual.theta))


def test_the_penalty_minimises_generalised_cross_validation(lap, estimator, rng) -> None:
    ridge = estimator("ridge", lowpass_hz=0.5)
    problem = lap("noise", 2).problem
    found = ridge.identify(problem, rng)
    samples = ridge.samples(problem.training, problem.nominal, problem.thruster)
    x = samples.phi[:, 1:] - samples.phi[:, 1:].mean(axis=0)
    x /= x.std(axis=0)
    y = samples.epsilon - samples.epsilon.mean(axis=0)
    n = len(x)

    def gcv(penalty: float, k: int) -> float:
        """By its definition, with the hat matrix applied and its trace counted."""
        solve = np.linalg.solve(x.T @ x + penalty * n * np.eye(x.shape[1]), x.T)
        rest = y[:, k] - x @ (solve @ y[:, k])
        return n * np.sum(rest**2) / (n - 1.0 - np.sum(solve.T * x)) ** 2

    for k, chosen in enumerate(f.value for f in diagnostics(found, "ridge_penalty")):
        assert gcv(chosen, k) <= min(gcv(p, k) for p in np.geomspace(1e-9, 1.0, 46)) * (1 + 1e-9)


@pytest.mark.parametrize("axes", ["sway", "sway and yaw"])
@pytest.mark.parametrize("name", ["ls", "ridge", "plsr", "iv"])
def test_what_nothing_pushes_is_known_relative_to_the_inertia(
    make, estimator, rng, name, axes
) -> None:
    """Two thrusters push ahead; a rudder pushes sway and yaw in a fixed proportion."""
    inertia = np.array([[10.0, 0.0, 0.0], [0.0, 15.0, 1.0], [0.0, 1.0, 5.0]])
    drag = {"X_u": -4.0, "Y_v": -9.0, "Y_r": -2.0, "N_v": -1.0, "N_r": -6.0}
    nominal = from_derivatives("boat", AXES, inertia, drag)
    truth = from_derivatives("boat", AXES, inertia, {**drag, "Y_v": -12.0, "N_r": -5.0})
    t = 0.1 * np.arange(2000)
    turn = 3.0 * np.sin(0.5 * t) + 2.0 * np.sin(1.3 * t + 1.0)
    tau = np.column_stack([4.0 + 6.0 * np.sin(0.21 * t), (axes != "sway") * turn, -2.0 * turn])
    motion = make.driven(truth, tau)
    motion = replace(motion, nu_dot=truth.forward(tau, motion.nu))
    problem = Problem(motion, motion, nominal, None)
    found = estimator(name, basis="physical").identify(problem, rng)
    np.testing.assert_allclose(found.model.theta, truth.on(found.model.terms).theta, atol=0.05)


def test_what_pushes_in_the_training_part_decides_for_the_held_out_part(
    make, estimator, rng
) -> None:
    inertia, drag = np.diag([10.0, 15.0, 5.0]), {"X_u": -4.0, "Y_v": -9.0, "N_r": -6.0}
    nominal = from_derivatives("boat", AXES, inertia, drag)
    truth = from_derivatives("boat", AXES, 1.2 * inertia, drag)
    t = 0.1 * np.arange(2000)
    tau = np.column_stack([4.0 + np.sin(0.21 * t), 3.0 * np.sin(0.7 * t), np.sin(0.5 * t)])
    motions = []
    for pushed in (tau, tau * [1.0, 0.0, 1.0]):
        motion = make.driven(truth, pushed)
        motions.append(replace(motion, nu_dot=truth.forward(pushed, motion.nu)))
    plsr = estimator("plsr", basis="physical", selection="test", bootstrap=None)
    found = plsr.identify(Problem(*motions, nominal, None), rng)
    np.testing.assert_allclose(found.model.inertia, truth.inertia, atol=0.05)
