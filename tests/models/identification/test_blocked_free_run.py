"""Errors of free runs over blocks left out, and the rule that chooses by them."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from seatrial.models.errors import IdentificationError
from seatrial.models.identification.blocked_free_run import (
    Blocks,
    Contest,
    LeftOut,
    best_of,
    first_equal,
    first_within,
)
from seatrial.models.identification.problem import Identified, Identifier, NoIdentifier, Problem
from tests.models.identification.known_results import Failing, Given


@dataclass(frozen=True)
class Seen(Identifier):
    """An identifier that notes the training parts it is given."""

    parts: list[np.ndarray]

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        assert len(problem.validation) == len(problem.training)
        self.parts.append(problem.training.t)
        return NoIdentifier().identify(problem, rng)


def left_out(*runs: float) -> LeftOut:
    return LeftOut(np.array(runs)[:, None], np.full(len(runs), 100.0))


def test_a_force_without_its_term_is_no_matter_of_chance() -> None:
    """Without the term every free run is as poor as the mean motion; with it one goes astray."""
    errors = {"none": left_out(*[1.1] * 9), "ned_force": left_out(*[0.2] * 8, 6.0)}
    assert first_within(errors) == "none"
    assert first_equal(errors) == "ned_force"
    equal = {"none": left_out(1.03, 1.03), "ned_force": left_out(1.0, 1.0)}
    assert first_equal(equal) == "none"


def test_the_first_within_one_standard_error_is_chosen() -> None:
    errors = {
        "simple": left_out(1.3, 1.1, 1.2),
        "better": left_out(0.6, 0.4, 0.5),
        "best": left_out(0.5, 0.45, 0.4),
    }  # better is worse by 0.05 on average, with a standard error of 0.05; simple by 0.75 +- 0.06
    assert first_within(errors) == "better"
    assert first_within({"best": errors["best"], "better": errors["better"]}) == "best"
    one = {"a": left_out(1.03), "b": left_out(1.0)}  # no spread: hardly anything does not matter
    assert first_within(one) == "a"
    assert first_within(one | {"a": left_out(1.05)}) == "b"


def test_one_run_that_explodes_is_no_matter_of_chance() -> None:
    """Its mean excess is about its own standard error."""
    steady, explodes = left_out(*[0.1] * 6), left_out(*[0.09] * 5, 400.0)
    mean, error = explodes.excess(steady)
    assert mean[0] == pytest.approx(error[0], rel=0.1)
    assert explodes.exceeds(steady)
    assert not left_out(0.05, 0.1, 0.2, 0.1, 0.1, 0.15).exceeds(steady)
    assert first_within({"explodes": explodes, "steady": steady}) == "steady"
    assert explodes.exceeds(steady, 2.0)


def test_the_true_model_has_no_error_and_the_nominal_one_its_own(calm) -> None:
    blocks = Blocks(calm.problem)
    assert blocks.axes == [0, 1, 2]
    truth, nominal = (blocks.judge(Given(factor)) for factor in (0.5, 1.0))
    assert np.all(truth.nrmse < 1e-3)
    assert np.all(nominal.nrmse > 0.1)
    assert blocks.worse(truth, nominal) is None
    assert "worse than the nominal model: NRMSE in surge" in (blocks.worse(nominal, truth) or "")


def test_every_sample_is_left_out_once_and_never_seen(calm) -> None:
    training, parts = calm.problem.training, []
    judged = Blocks(calm.problem, folds=4).judge(Seen(parts))
    assert len(parts) == 4
    outside = [np.setdiff1d(training.t, part) for part in parts]
    np.testing.assert_array_equal(np.sort(np.concatenate(outside)), training.t)
    assert np.sum(judged.samples) == len(training) - len(judged.samples)


def test_white_noise_hides_no_error_of_a_model(calm, rng) -> None:
    """What is left of the noise is far below it, and a wrong model is as wrong as without it."""
    training = calm.problem.training
    spread = np.std(training.nu, axis=0)
    noise = 0.3 * spread * rng.standard_normal(training.nu.shape)
    noisy = replace(calm.problem, training=replace(training, nu=training.nu + noise))
    truth, wrong = (Blocks(noisy).judge(Given(factor)).nrmse for factor in (0.5, 0.7))
    assert np.all(truth < 0.15)
    np.testing.assert_allclose(wrong, Blocks(calm.problem).judge(Given(0.7)).nrmse, rtol=0.2)
    assert Blocks(calm.problem).smoothed.nu is training.nu


def test_the_best_alternative_is_identified_on_the_whole(calm) -> None:
    alternatives = {"fails": Failing(), "wrong": Given(0.8), "true": Given(0.5)}
    found = best_of(alternatives, Blocks(calm.problem), np.random.default_rng(0))
    np.testing.assert_array_equal(found.model.theta, (0.5 * calm.problem.nominal).theta)
    chosen = {f.label: f.value for f in found.diagnostics if f.name == "chosen"}
    assert chosen == {"wrong": 0.0, "true": 1.0}
    fits = {(f.label, f.dof): f.value for f in found.diagnostics if f.name == "left_out_fit"}
    assert len(fits) == 6
    assert all(fits["true", dof] > fits["wrong", dof] for dof in calm.problem.nominal.dofs)


def test_without_a_usable_alternative_the_reason_is_given(calm) -> None:
    with pytest.raises(IdentificationError, match=r"no alternative .*: a: always"):
        best_of({"a": Failing(), "b": Failing()}, Blocks(calm.problem), np.random.default_rng(0))


def test_alternatives_of_one_candidate_compete_first(calm) -> None:
    blocks = Blocks(calm.problem)
    candidates = {"one": {"one[a]": Given(0.9), "one[b]": Given(0.55)}, "two": {"two": Given(0.6)}}
    errors, reasons = Contest(candidates, blocks).run()
    assert list(errors) == ["one[b]", "two"]
    assert reasons["one[a]"].startswith("quick estimate: NRMSE ")
    assert first_within(errors) == "one[b]"


def test_a_candidate_must_be_better_than_the_reference_beyond_chance(calm) -> None:
    """One that is nearly the nominal model is better than it, but not by what matters."""
    blocks = Blocks(calm.problem)
    reference = blocks.judge(NoIdentifier())
    candidates = {name: {name: Given(x)} for name, x in (("near", 0.995), ("true", 0.5))}
    errors, reasons = Contest(candidates, blocks, reference).run()
    assert list(errors) == ["true"]
    assert reasons["near"].startswith("no better than the nominal model, beyond chance: NRMSE ")
    assert blocks.judge(Given(0.995)).error < reference.error


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
    chosen = [f.label for f in found.diagnostics if f.name == "chosen" and f.value == 1.0]
    assert chosen == [expected]
