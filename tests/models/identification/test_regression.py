"""Least squares against the plant that sailed."""

import numpy as np
import pytest

from models.errors import ConfigurationError, IdentificationError

AXES = ("surge", "sway", "yaw")


def diagonal(vessel) -> np.ndarray:
    return np.diag(vessel.inertia)


@pytest.mark.parametrize("basis", ["full", "physical"])
def test_filtered_force_makes_least_squares_exact(calm, identifier, rng, basis) -> None:
    found = identifier("ls", force="filtered", basis=basis).identify(calm.problem, rng)
    truth = calm.residual.on(found.residual.terms).theta
    real = truth != 0.0
    assert np.max(np.abs(found.residual.theta[real] / truth[real] - 1.0)) < 1e-3
    assert np.max(np.abs(found.residual.theta[~real]), initial=0.0) < 1e-3


def test_commanded_force_is_biased_by_the_thruster_lag(calm, identifier, rng) -> None:
    found = identifier("ls", force="commanded").identify(calm.problem, rng)
    error = np.abs(diagonal(found.model) / diagonal(calm.truth) - 1.0)
    assert np.max(error) > 0.01


def test_inertia_under_noise(lap, identifier, rng) -> None:
    ls = identifier("ls", lowpass_hz=0.5)
    truth = diagonal(lap("calm").truth)
    found = [diagonal(ls.identify(lap("noise", s).problem, rng).model) for s in range(20)]
    assert np.max(np.abs(np.mean(found, axis=0) / truth - 1.0)) < 0.02


def test_condition_number_is_that_of_the_standardised_columns(calm, identifier, rng) -> None:
    ls = identifier("ls")
    found = ls.identify(calm.problem, rng)
    samples = ls.samples(calm.problem.training, calm.problem.nominal, calm.thruster)
    columns = samples.phi[:, samples.varying]
    columns = (columns - columns.mean(axis=0)) / columns.std(axis=0)
    reported = {f.dof: f.value for f in found.findings if f.name == "condition_number"}
    assert reported == pytest.approx(dict.fromkeys(AXES, np.linalg.cond(columns)))


def test_a_term_that_does_not_vary_gets_zero_and_is_named(calm, identifier, rng) -> None:
    ls = identifier("ls", basis="physical", extra_terms=["1", "cos(theta)"])
    found = ls.identify(calm.problem, rng)
    assert not np.any(found.residual.row("cos(theta)"))
    assert [f.label for f in found.findings if f.name == "dropped_term"] == ["cos(theta)"]
    assert found.std_error is not None
    row = [str(one) for one in found.residual.terms].index("cos(theta)")
    assert np.all(np.isnan(found.std_error[row]))


def test_terms_that_cannot_be_told_apart_are_named(calm, identifier, rng) -> None:
    ls = identifier("ls", basis=["u_dot", "1", "cos(phi)", "cos(psi)", "r^2", "|r|r", "r"])
    training = calm.problem.training
    one_way = training.part(training.nu[:, 2] > 1e-3)
    problem = type(calm.problem)(
        one_way, calm.problem.validation, calm.problem.nominal, calm.thruster
    )
    with pytest.raises(IdentificationError, match=r"r\^2"):
        ls.identify(problem, rng)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"lowpass_hz": -1.0}, "lowpass_hz must be positive, got -1.0"),
        ({"basis": "all"}, "basis: got 'all', expected full, physical or a list of terms"),
        ({"basis": ["u", "uu", "u^2"]}, "is given twice"),
        ({"extra_terms": ["speed"]}, "expected factors"),
        ({"force": "thrust"}, "force: got 'thrust'"),
        ({"force": "filtered", "thruster": "none"}, "needs a thruster lag"),
        ({"force": "actual", "thruster": "estimated"}, "force must be filtered or null"),
    ],
)
def test_options_are_checked_where_they_are_made(identifier, changes, message) -> None:
    with pytest.raises(ConfigurationError) as caught:
        identifier("ls", **changes)
    assert message in str(caught.value)


def test_a_combination_that_cannot_work_is_refused(identifier, calm) -> None:
    nominal = calm.problem.nominal
    with pytest.raises(ConfigurationError, match="has no known thruster lag"):
        identifier("ls", force="filtered").check(nominal, None, True)
    with pytest.raises(ConfigurationError, match="term w has w, but milliampere moves in"):
        identifier("ls", extra_terms=["w"]).check(nominal, calm.thruster, False)
