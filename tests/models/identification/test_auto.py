"""The best candidate on blocks left out, never worse than the nominal model, and never an error."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from seatrial.models.diagnostics import nominal_equations
from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.models.identification.auto import Auto
from seatrial.models.identification.cross_validation import CrossValidation
from seatrial.models.identification.problem import Identified, Identifier, NoIdentifier, Problem
from seatrial.models.vessel.basis import Term, terms
from seatrial.runner.trials import trial as trials
from tests.data import DATA
from tests.models.identification.known_results import Failing, Given, chosen, diagnostics, labels
from tests.trials import composed


@dataclass(frozen=True)
class Damped(Identifier):
    """The true inertia, and damping that is scaled in one degree of freedom."""

    dof: int
    factor: float

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        theta = 0.5 * problem.nominal.theta
        theta[7:, self.dof] *= self.factor  # the rows after the inertia and the Coriolis forces
        model = replace(problem.nominal, theta=theta)
        return Identified(model, model - problem.nominal)


@dataclass(frozen=True)
class FailingOnAll(Given):
    """True on parts of the training data, with an error on the whole of it."""

    samples: int

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        if len(problem.training) >= self.samples:
            raise IdentificationError("too much of it")
        return super().identify(problem, rng)


@dataclass(frozen=True)
class Refined(Given):
    """A factor of the nominal model, at first a rough one; `made` notes those asked for."""

    rough: float
    made: list[float]
    terms: tuple[Term, ...] = ()  # beyond those of the nominal model

    def quick(self) -> Identifier:
        return replace(self, factor=self.rough)

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        self.made.append(self.factor)
        model = self.factor * problem.nominal.on(problem.nominal.terms + self.terms)
        return Identified(model, model - problem.nominal)


def identified(candidates, problem, reserve: tuple[str, ...] = ()) -> Identified:
    auto = Auto(candidates, 6, 10.0, None, reserve)
    return auto.identify(problem, np.random.default_rng(0))


def values(found: Identified, name: str) -> dict[str, float]:
    return {f.label: f.value for f in found.diagnostics if f.name == name}


def test_the_true_model_wins(calm) -> None:
    wrong = {f"{factor}": Given(factor) for factor in (1.0, 0.7, 0.4)}
    found = identified({**wrong, "fails": Failing(), "true": Given(0.5)}, calm.problem)
    assert chosen(found) == "true"
    assert "fails: always" in labels(found, "left_out")
    assert not values(found, "fallback")
    np.testing.assert_allclose(found.model.theta, calm.truth.on(found.model.terms).theta)
    errors = values(found, "left_out_error")
    assert errors["true"] < 0.01 * errors["none"]
    nominal = CrossValidation(calm.problem, 6, 10.0).nominal.nrmse
    for name, least, most in (("true", 0.0, 0.01), ("none", nominal - 1e-9, nominal + 1e-9)):
        fits = [f for f in diagnostics(found, "left_out_fit") if f.label == name]
        assert [f.dof for f in fits] == ["surge", "sway", "yaw"]
        nrmse = np.array([1.0 - 0.01 * f.value for f in fits])
        assert np.all((nrmse >= least) & (nrmse <= most))
        assert errors[name] == pytest.approx(np.sqrt(np.mean(np.minimum(nrmse, 1.0) ** 2)))


def test_if_all_fail_the_nominal_model_is_the_result(calm) -> None:
    cases = {"fails": Failing(), "light": Given(-1.0), "later": FailingOnAll(0.5, 3600)}
    found = identified(cases, calm.problem)
    np.testing.assert_array_equal(found.model.theta, calm.problem.nominal.theta)
    assert len(found.residual.terms) == 0
    assert chosen(found) == "none"
    assert labels(found, "fallback") == ["no candidate predicts the blocks left out better"]
    assert {one.partition(":")[0] for one in labels(found, "left_out")} == set(cases)
    assert any(
        "on the whole training part: too much of it" in one for one in labels(found, "left_out")
    )


@pytest.mark.parametrize("dof", [0, 1, 2])
def test_an_axis_that_loses_keeps_its_nominal_equation(calm, dof: int) -> None:
    """Exact but in one degree of freedom, where it is worse: the others are taken all the same."""
    found = identified({"mixed": Damped(dof, 12.0)}, calm.problem)
    assert chosen(found) == "mixed"
    nominal, own = calm.problem.nominal, [k for k in range(3) if k != dof]
    assert [f.dof for f in found.diagnostics if f.name == "worse_than_nominal"] == [
        nominal.dofs[dof]
    ]
    theta = found.model.on(nominal.terms).theta
    np.testing.assert_allclose(theta[:, dof], nominal.theta[:, dof])
    np.testing.assert_allclose(theta[:, own], 0.5 * nominal.theta[:, own])
    (note,) = found.notes
    assert note.startswith("chosen: mixed; ")
    kept = f"nominal equations: {nominal.dofs[dof]}: the identified one simulates worse"
    assert str(nominal_equations(found.diagnostics)).startswith(kept)


def test_the_reserve_is_tried_only_where_no_other_is_admissible(calm) -> None:
    candidates = {"true": Given(0.5), "half": Given(0.6), "near": Given(0.995)}
    assert chosen(identified(candidates, calm.problem, reserve=("true",))) == "half"
    last = {name: candidates[name] for name in ("true", "near")}
    assert chosen(identified(last, calm.problem, reserve=("true",))) == "true"


def test_without_further_terms_only_a_better_quick_estimate_is_refined(calm) -> None:
    """One that is as good as another may be the same, as where all terms are linear."""
    made: list[float] = []
    pairs = {"first": (0.55, 0.7), "same": (0.5, 0.7), "poor": (0.52, 0.9), "good": (0.54, 0.6)}
    candidates = {name: Refined(*pair, made) for name, pair in pairs.items()}
    candidates["more"] = Refined(0.51, 0.9, made, terms(["uvr"]))
    found = identified(candidates, calm.problem)
    assert {0.55, 0.54, 0.51} <= {*made}
    assert not {0.5, 0.52} & {*made}
    unrefined = [
        one for one in labels(found, "left_out") if "no better than that of another" in one
    ]
    assert [one.partition(":")[0] for one in unrefined] == ["same", "poor"]


def test_one_that_is_better_by_chance_alone_is_refused(calm) -> None:
    found = identified({"near": Given(0.995)}, calm.problem)
    assert chosen(found) == "none"
    (reason,) = labels(found, "left_out")
    assert reason.startswith("near: no better than the nominal model, beyond chance: NRMSE ")


def test_no_skill_is_said(calm) -> None:
    """A log whose forces have the wrong sign: no model beats the mean motion."""
    training = calm.problem.training
    wrong = replace(training, tau=-3.0 * training.tau, tau_filtered=None, tau_actual=None)
    found = identified({"true": Given(0.5)}, replace(calm.problem, training=wrong))
    assert any(warning.startswith("no skill: ") for warning in found.warnings)
    assert {f.dof for f in found.diagnostics if f.name == "no_skill"}
    assert not identified({"true": Given(0.5)}, calm.problem).warnings


def test_the_held_out_part_is_not_looked_at(calm) -> None:
    problem = calm.problem
    broken = replace(problem, validation=problem.training.part(slice(0, 2)))
    first, second = (
        identified({"wrong": Given(0.7), "true": Given(0.5)}, one) for one in (problem, broken)
    )
    assert first.diagnostics == second.diagnostics
    np.testing.assert_array_equal(first.model.theta, second.model.theta)


def test_an_axis_that_did_not_move_keeps_the_nominal_equation(make, calm) -> None:
    problem = calm.problem
    tau = np.zeros((2000, 3))
    t = 0.1 * np.arange(len(tau))
    tau[:, 0] = 300.0 * np.sign(np.sin(0.2 * t)) + 100.0 * np.sin(0.07 * t)
    recording = make.driven(calm.truth, tau, integrator="rk4")
    straight = Problem(recording, recording, problem.nominal, None)
    found = identified({"half": Given(0.5)}, straight)
    assert chosen(found) == "half"
    assert {f.dof for f in found.diagnostics if f.name == "did_not_move"} == {"sway", "yaw"}
    nominal = problem.nominal.on(found.model.terms).theta
    np.testing.assert_allclose(found.model.theta[:, 0], 0.5 * nominal[:, 0])
    np.testing.assert_array_equal(found.model.theta[:, 1:], nominal[:, 1:])
    fits = {f.dof for f in found.diagnostics if f.name == "left_out_fit"}
    assert fits == {"surge"}


def test_where_nothing_moved_the_nominal_model_is_the_result(make, milliampere) -> None:
    recording = make.forced(np.zeros((500, 3)), milliampere.dofs)
    still = Problem(recording, recording, milliampere, None)
    found = identified({"half": Given(0.5)}, still)
    assert found.model is milliampere
    assert values(found, "fallback") == {"no velocity moved by more than its noise": 1.0}


@pytest.mark.parametrize(("folds", "horizon"), [(1, 20.0), (4, 0.0)])
def test_ranges(folds: int, horizon: float) -> None:
    with pytest.raises(ConfigurationError, match="must be"):
        Auto({"none": NoIdentifier()}, folds, horizon, None)


@pytest.mark.slow
def test_the_configured_candidates_on_noise() -> None:
    trial = composed("identifier=auto", "disturbance=noise")
    trials.check(trial)
    results = trials.run(trial)
    names = {d.label: d.value for d in results.diagnostics if d.name == "chosen"}
    assert names["none"] == 0.0
    assert sum(names.values()) == 1.0
    for metric in ("e_pos_mae", "velocity_rmse_free_run"):
        errors = {
            model: np.linalg.norm(
                [r.value for r in results.metrics if (r.name, r.model) == (metric, model)]
            )
            for model in ("nominal", "identified")
        }
        assert 0.0 < errors["identified"] < 0.7 * errors["nominal"]


def test_none_returns_the_nominal_model(calm, identifier, rng) -> None:
    found = identifier("none").identify(calm.problem, rng)
    assert found.model is calm.problem.nominal
    assert found.residual.terms == ()


@pytest.mark.nightly
@pytest.mark.data
@pytest.mark.parametrize("vessel", ["beluga_linear", "beluga_diagonal", "beluga_full"])
def test_every_axis_of_random_1_is_predicted_better_than_without(vessel: str) -> None:
    trial = composed(
        f"vessel={vessel}", "identifier=auto", "controller=none", "evaluation=none",
        "excitation=recording", f"excitation.path={DATA}/beluga/random-1.csv",
    )  # fmt: skip
    assert trial.excitation.train_fraction == 0.5
    trials.check(trial)
    results = trials.run(trial)
    errors = {
        (row.model, row.dof): row.value
        for row in results.metrics
        if (row.name, row.stage) == ("velocity_rmse_free_run", "validation")
    }
    worse = {
        dof: (errors["identified", dof], errors["nominal", dof])
        for dof in trial.vessel.dofs
        if not errors["identified", dof] < errors["nominal", dof]
    }
    assert worse == {}
    assert len(trial.vessel.dofs) == 6
    assert np.all(np.isfinite(list(errors.values())))
