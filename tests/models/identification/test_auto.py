"""Selection by cross-validated free-run error picks the truth, and the simpler of equals."""

from dataclasses import dataclass

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.models.identification.auto import Auto, one_standard_error
from seatrial.models.identification.problem import Identified, Identifier, NoIdentifier, Problem
from seatrial.runner import trial as trials
from tests.trials import composed


@dataclass(frozen=True)
class Given(Identifier):
    """An identifier that returns a factor of the nominal model, whatever the data."""

    factor: float

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        model = self.factor * problem.nominal
        return Identified(model, model - problem.nominal)


@dataclass(frozen=True)
class Failing(Identifier):
    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        raise IdentificationError("always")


def pick(candidates, problem) -> tuple[str, Identified]:
    found = Auto(candidates, 12, 10.0, None).identify(problem, np.random.default_rng(0))
    chosen = [f.label for f in found.findings if f.name == "auto_chosen" and f.value == 1.0]
    assert len(chosen) == 1
    return chosen[0], found


def test_the_true_model_wins(calm) -> None:
    wrong = {f"{factor}": Given(factor) for factor in (1.0, 0.7, 0.4)}
    chosen, found = pick({**wrong, "true": Given(0.5)}, calm.problem)
    assert chosen == "true"
    np.testing.assert_allclose(found.model.theta, calm.truth.on(found.model.terms).theta)
    errors = {f.label: f.value for f in found.findings if f.name == "auto_error" and f.j == 0}
    assert errors["true"] < 0.01 * min(errors[name] for name in wrong)


def test_of_equals_the_first_is_taken_and_a_failing_one_never(calm) -> None:
    chosen, _ = pick({"fails": Failing(), "a": Given(0.5), "b": Given(0.5)}, calm.problem)
    assert chosen == "a"
    with pytest.raises(IdentificationError, match="no candidate"):
        pick({"fails": Failing()}, calm.problem)


def test_one_standard_error_rule() -> None:
    errors = {
        "simple": np.array([1.3, 1.1, 1.2]),
        "better": np.array([0.6, 0.4, 0.5]),
        "best": np.array([0.5, 0.45, 0.4]),
    }  # better is worse by 0.05 on average, with a standard error of 0.05; simple by 0.75 +- 0.06
    assert one_standard_error(errors) == "better"


def test_the_held_out_part_is_not_looked_at(calm) -> None:
    broken = Problem(
        calm.problem.training, calm.problem.training.part(slice(0, 2)), calm.problem.nominal,
        calm.problem.thruster,
    )  # fmt: skip
    assert pick({"none": NoIdentifier(), "true": Given(0.5)}, broken)[0] == "true"


def test_the_configured_candidates_on_noise() -> None:
    trial = composed(
        "identifier=auto", "disturbance=noise", "identifier.candidates.ls.lowpass_hz=0.5"
    )
    trials.check(trial)
    results = trials.run(trial)
    chosen = {d.label: d.value for d in results.diagnostics if d.name == "auto_chosen"}
    assert list(chosen) == ["none", "ls", "ridge", "plsr"]
    assert chosen["none"] == 0.0
    errors = {row.model: row.value for row in results.metrics if row.name == "e_pos_mae"}
    assert errors["identified"] < 0.7 * errors["nominal"]


@pytest.mark.parametrize(("folds", "horizon"), [(1, 20.0), (4, 0.0)])
def test_ranges(folds: int, horizon: float) -> None:
    with pytest.raises(ConfigurationError, match="must be"):
        Auto({"none": NoIdentifier()}, folds, horizon, None)
