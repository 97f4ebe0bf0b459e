"""Errors of free runs over blocks left out, and the rule that chooses by them."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from seatrial.models.errors import IdentificationError
from seatrial.models.identification.cross_validation import (
    CrossValidation,
    FoldErrors,
    best_of,
    one_standard_error_rule,
)
from seatrial.models.identification.problem import Identified, Identifier, NoIdentifier, Problem
from seatrial.models.identification.validation import prediction
from seatrial.models.vessel.table import Vessel
from tests.models.identification.known_results import Failing, Given, chosen, labels


@dataclass(frozen=True)
class Seen(Identifier):
    """An identifier that notes the training parts it is given."""

    parts: list[np.ndarray]

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        assert len(problem.validation) == len(problem.training)
        self.parts.append(problem.training.t)
        return NoIdentifier().identify(problem, rng)


def judged(blocks: CrossValidation, identifier: Identifier) -> FoldErrors:
    return blocks.errors(blocks.models(identifier))


def left_out(*blocks: float) -> FoldErrors:
    return FoldErrors(np.array(blocks)[:, None], np.ones(len(blocks)))


def test_an_axis_without_skill_decides_nothing() -> None:
    """Of two that are worse than the mean motion on an axis, neither gains by being less so."""
    poor, poorer = (
        FoldErrors(np.array([[own, x]] * 2), np.ones(2)) for own, x in ((0.3, 1.5), (0.2, 9.0))
    )
    assert poor.error == pytest.approx((0.3 + 1.0) / 2.0)
    assert poor.worse(poorer)
    assert not poorer.worse(poor)
    assert poorer.worse_axes(poor).tolist() == [False, True]
    np.testing.assert_allclose(left_out(4.0, 2.0).capped[:, 0], [4.0 / 3.0, 2.0 / 3.0])


def test_a_force_without_its_term_is_no_matter_of_chance() -> None:
    """Without the term every free run is poorer than the mean motion; with it one goes astray."""
    errors = {"none": left_out(*[1.1] * 9), "ned_force": left_out(*[0.1] * 8, 3.0)}
    assert one_standard_error_rule(errors) == "ned_force"
    equal = {"none": left_out(0.93, 0.93), "ned_force": left_out(0.9, 0.9)}
    assert one_standard_error_rule(equal) == "none"


def test_the_first_within_one_standard_error_is_chosen() -> None:
    errors = {
        "simple": left_out(0.9, 0.8, 0.85),
        "better": left_out(0.6, 0.38, 0.5),
        "best": left_out(0.5, 0.45, 0.4),
    }  # better is worse by 0.04 on average, with a standard error of 0.06; simple by 0.4 +- 0.03
    assert one_standard_error_rule(errors) == "better"
    assert one_standard_error_rule({"best": errors["best"], "better": errors["better"]}) == "best"
    one = {"a": left_out(0.93), "b": left_out(0.9)}  # no spread: hardly anything does not matter
    assert one_standard_error_rule(one) == "a"
    assert one_standard_error_rule(one | {"a": left_out(0.95)}) == "b"


def test_worse_is_by_more_than_a_standard_error_or_than_as_much_again() -> None:
    """Of two blocks the standard error of the mean is half of their difference."""
    reference, steady = left_out(0.5, 0.5), left_out(*[0.1] * 6)
    for blocks, other, worse in (
        ((0.69, 0.51), reference, True), ((0.71, 0.49), reference, False),
        ((*[0.09] * 5, 1.05), steady, True), ((*[0.09] * 5, 0.6), steady, False),
        ((*[0.09] * 5, 400.0), steady, True), ((0.05, 0.1, 0.2, 0.1, 0.1, 0.15), steady, False),
    ):  # fmt: skip
        assert left_out(*blocks).worse(other) == worse
        assert left_out(*blocks).worse_axes(other).tolist() == [worse]
    errors = {"explodes": left_out(*[0.09] * 5, 400.0), "steady": steady}
    assert one_standard_error_rule(errors) == "steady"


def test_errors_are_those_of_predictions_over_the_spread_of_training(calm) -> None:
    problem = calm.problem
    own = CrossValidation(problem, horizon_s=0.2).runs(problem.nominal, problem.validation)
    ahead = prediction(problem.nominal, problem.validation, problem.thruster).restarted(2)
    expected = ahead.rmse[3:] / np.std(problem.training.nu, axis=0)
    np.testing.assert_allclose(own.nrmse, expected, rtol=1e-9)


def test_an_axis_that_moves_less_than_twice_its_noise_decides_nothing(calm, rng) -> None:
    training = calm.problem.training
    slow = np.sqrt(2.0) * np.sin(2.0 * np.pi * training.t / 60.0)
    for size, axes in ((1.1, [0, 2]), (3.0, [0, 1, 2])):
        nu = training.nu.copy()
        nu[:, 1] = 0.1 * (size * slow + rng.standard_normal(len(slow)))
        moved = replace(calm.problem, training=replace(training, nu=nu))
        assert CrossValidation(moved).axes == axes


def test_the_true_model_has_no_error_and_the_nominal_one_its_own(calm) -> None:
    blocks = CrossValidation(calm.problem)
    assert blocks.axes == [0, 1, 2]
    truth, nominal = (judged(blocks, Given(factor)) for factor in (0.5, 1.0))
    assert np.all(truth.nrmse < 1e-3)
    assert np.all(nominal.nrmse > 0.1)
    np.testing.assert_array_equal(nominal.nrmse, blocks.nominal.nrmse)
    assert not np.any(truth.worse_axes(nominal))
    assert np.all(nominal.worse_axes(truth))


def test_without_skill_the_nominal_equation_stays_unless_it_is_worse_beyond_chance(
    calm, monkeypatch
) -> None:
    """No model predicts sway or yaw; the nominal one of sway has twice the error of the other."""
    nominal = calm.problem.nominal
    errors = {False: [0.2, 4.0, 1.5], True: [0.1, 2.0, 1.4]}  # by whether the model is another one

    def known(blocks: CrossValidation, models: list[Vessel]) -> FoldErrors:
        squares = np.tile(errors[models[0] is not nominal], (3, 1))
        squares[:, 2] += [-0.3, 0.0, 0.3 if models[0] is nominal else 0.5]
        return FoldErrors(squares, np.ones(3))

    monkeypatch.setattr(CrossValidation, "errors", known)
    assert CrossValidation(calm.problem).score([calm.truth] * 3).nominal_axes == (2,)


def test_every_sample_is_left_out_once_and_never_seen(calm) -> None:
    training, parts = calm.problem.training, []
    found = judged(CrossValidation(calm.problem, folds=4), Seen(parts))
    assert len(parts) == 4
    outside = [np.setdiff1d(training.t, part) for part in parts]
    np.testing.assert_array_equal(np.sort(np.concatenate(outside)), training.t)
    np.testing.assert_array_equal(found.weights, np.ones(4))


def test_white_noise_hides_no_error_of_a_model(calm, rng) -> None:
    """What is left of the noise is far below it, and a wrong model is as wrong as without it."""
    training = calm.problem.training
    spread = np.std(training.nu, axis=0)
    noise = 0.3 * spread * rng.standard_normal(training.nu.shape)
    noisy = replace(calm.problem, training=replace(training, nu=training.nu + noise))
    truth, wrong = (judged(CrossValidation(noisy), Given(f)).nrmse for f in (0.5, 0.7))
    assert np.all(truth < 0.15)
    clean = CrossValidation(calm.problem)
    np.testing.assert_allclose(wrong, judged(clean, Given(0.7)).nrmse, rtol=0.2)
    assert clean.smoothed.nu is training.nu


def test_the_best_alternative_is_identified_on_the_whole(calm) -> None:
    alternatives = {"fails": Failing(), "wrong": Given(0.8), "true": Given(0.5)}
    found = best_of(alternatives, CrossValidation(calm.problem), np.random.default_rng(0))
    np.testing.assert_array_equal(found.model.theta, (0.5 * calm.problem.nominal).theta)
    assert chosen(found) == "true"
    assert labels(found, "chosen") == ["wrong", "true"]
    fits = {(f.label, f.dof): f.value for f in found.diagnostics if f.name == "left_out_fit"}
    assert len(fits) == 6
    assert all(fits["true", dof] > fits["wrong", dof] for dof in calm.problem.nominal.dofs)
    (error,) = (f.value for f in found.diagnostics if (f.name, f.i) == ("left_out_error", 0))
    nrmse = [1.0 - fit / 100.0 for (label, _), fit in fits.items() if label == "wrong"]
    assert error == pytest.approx(np.sqrt(np.mean(np.minimum(nrmse, 1.0) ** 2)))


def test_without_a_usable_alternative_the_reason_is_given(calm) -> None:
    alternatives, blocks = {name: Failing() for name in "ab"}, CrossValidation(calm.problem)
    with pytest.raises(IdentificationError, match=r"no alternative .*: a: always"):
        best_of(alternatives, blocks, np.random.default_rng(0))


@pytest.mark.parametrize(
    ("name", "options", "expected"),
    [
        ("ridge", {"tune": {"penalty": [1e6, 1e-6]}}, "[penalty = 1e-06]"),
        ("plsr", {"tune": {"max_order": [1, 24]}, "bootstrap": None}, "[max_order = 24]"),
        ("ls", {"tune": {"basis": ["linear", "physical"]}}, "[basis = physical]"),
    ],
)
def test_tune_finds_a_planted_good_value(calm, identifier, name: str, options, expected) -> None:
    """A penalty that lets nothing change, one latent variable, or no nonlinear damping lose."""
    found = identifier(name, **options).identify(calm.problem, np.random.default_rng(0))
    assert chosen(found) == expected
