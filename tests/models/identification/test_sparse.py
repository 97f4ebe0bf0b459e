"""Sparse regression: least squares at threshold zero, and the plant's own terms in calm water."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.models.identification.cross_validation import CrossValidation
from seatrial.models.identification.sparse import sparsest
from seatrial.models.recording.recording import Recording

pytest.importorskip("pysindy", reason="no pysindy: pip install -e '.[rivals]'")

ALGORITHMS = ("stlsq", "sr3")
EXACT: dict[str, Any] = {"lowpass_hz": None, "penalty": 0.0, "inertia_factor": None}


def left(residual: Any, k: int) -> set[str]:
    """Terms of one degree of freedom but the constant, the intercept."""
    names = {str(t) for t, row in zip(residual.terms, residual.theta, strict=True) if row[k] != 0.0}
    return names - {"1"}


def stay_noise(recording: Recording, rng: np.random.Generator) -> Recording:
    """The recording with a force of pure noise: nothing explains it."""
    tau = np.std(recording.tau, axis=0) * rng.standard_normal(recording.tau.shape)
    return replace(recording, tau=tau, tau_filtered=tau)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
@pytest.mark.parametrize("disturbance", ["noise", "constant"])
def test_threshold_zero_is_least_squares(lap, identifier, rng, algorithm, disturbance) -> None:
    problem = lap(disturbance).problem
    options = {**EXACT, "threshold": 0.0, "algorithm": algorithm}
    found = identifier("sparse", **options).fitted(problem)
    ls = identifier("ls", lowpass_hz=None, inertia_factor=None).identify(problem, rng)
    scale = np.max(np.abs(ls.residual.theta), axis=0)
    np.testing.assert_allclose(found.residual.theta / scale, ls.residual.theta / scale, atol=1e-8)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_calm_water_leaves_the_terms_of_the_plant(calm, identifier, rng, algorithm) -> None:
    found = identifier("sparse", **EXACT, algorithm=algorithm).identify(calm.problem, rng)
    for k, _ in enumerate(calm.residual.dofs):
        true = left(calm.residual, k)
        assert 5 < len(true) < 12 < len(found.residual.terms)
        assert left(found.residual, k) == true
    own = found.residual.on(calm.residual.terms).theta
    np.testing.assert_allclose(own, calm.residual.theta, rtol=1e-4, atol=1e-3)


def test_what_predicts_worse_than_the_nominal_model_is_left_out(lap, identifier, rng) -> None:
    """All 31 terms fitted to noise lose in free runs, and are not the result."""
    problem = lap("noise").problem
    option = identifier("sparse", **EXACT, threshold=0.0)
    blocks, nominal = CrossValidation(problem), problem.nominal
    raw, guarded = option.fitted(problem).model, option.identify(problem, rng).model
    own, kept, reference = (
        np.mean(blocks.runs(model, problem.validation).nrmse ** 2)
        for model in (raw, guarded, nominal)
    )
    assert own > 1.1 * reference
    assert kept <= reference


def test_more_is_left_out_with_a_larger_threshold(lap, identifier, rng) -> None:
    problem = lap("noise").problem
    counts = []
    for threshold in (0.0, 0.03, 0.3, 1e3):
        found = identifier("sparse", **EXACT, threshold=threshold).fitted(problem)
        counts.append(sum(len(left(found.residual, k)) for k in range(3)))
    assert counts[0] == 3 * 30
    assert counts[-1] == 0
    assert counts == sorted(counts, reverse=True)
    assert len(set(counts)) == len(counts)


def test_a_force_that_nothing_explains_leaves_no_terms(calm, identifier, rng) -> None:
    problem = replace(
        calm.problem,
        training=stay_noise(calm.problem.training, rng),
        nominal=1e-9 * calm.problem.nominal,
    )
    found = identifier("sparse", **EXACT).identify(problem, rng)
    assert all(left(found.residual, k) == set() for k in range(3))


def test_the_sparsest_choice_within_a_standard_error() -> None:
    errors = np.array([[1.0, 1.2, 0.8], [1.1, 1.1, 0.8], [3.0, 3.1, 2.9]])
    assert sparsest(errors, 0.0) == 1
    assert sparsest(errors, 10.0) == 2
    assert sparsest(errors[::-1], 0.0) == 2


def test_without_pysindy_it_is_refused(calm, identifier, monkeypatch) -> None:
    monkeypatch.setattr("seatrial.models.identification.sparse.find_spec", lambda name: None)
    with pytest.raises(ConfigurationError) as refused:
        identifier("sparse").check(calm.problem.nominal, calm.thruster, False)
    assert str(refused.value) == (
        "identifier=sparse: pysindy is not installed: pip install 'seatrial[rivals]'"
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"algorithm": "lasso"}, "algorithm"),
        ({"threshold": -0.1}, "threshold"),
        ({"relaxation": 0.0}, "relaxation"),
        ({"folds": 1}, "folds"),
    ],
)
def test_options_are_checked(identifier, options, message) -> None:
    with pytest.raises(ConfigurationError, match=message):
        identifier("sparse", **options)
