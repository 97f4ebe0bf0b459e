"""What free runs over blocks left out predict worse than the nominal model does not stay."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from seatrial.models.identification import auto
from seatrial.models.identification.auto import held_to_nominal, with_nominal_axes
from seatrial.models.identification.cross_validation import BlockScore, CrossValidation
from seatrial.models.identification.physical_constraints import damping_terms, unphysical
from seatrial.models.identification.problem import Identified, Identifier, Problem, choose_basis
from seatrial.models.simulation.statespace import StateSpace
from seatrial.models.vessel.table import Vessel
from tests.models.conftest import configured


def identified(model: Vessel, nominal: Vessel) -> Identified:
    residual = model - nominal
    return Identified(model, residual, np.ones_like(residual.theta))


@dataclass(frozen=True)
class Given(Identifier):
    """An identifier with protections that returns a given result."""

    result: Identified
    protected = True

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        return self.result


def judged(problem: Problem, model: Vessel, result: Identified) -> Identified:
    """The result beside the nominal model, by a model on every block."""
    validation = CrossValidation(problem)
    score = validation.score([model] * len(validation.blocks))
    return held_to_nominal(result, score, problem)


def kept(result: Identified) -> list[str]:
    return [f.dof for f in result.diagnostics if f.name == "worse_than_nominal"]


def braked(table: Vessel, axis: int, factor: float) -> Vessel:
    """A table with another force in one equation."""
    theta = table.theta.copy()
    theta[:, axis] *= factor
    return replace(table, theta=theta)


def test_the_truth_stays(calm) -> None:
    result = identified(calm.truth, calm.problem.nominal)
    again = judged(calm.problem, calm.truth, result)
    assert kept(again) == []
    assert again is result


def test_one_axis_that_is_worse_keeps_its_nominal_equation(calm) -> None:
    """The plant is half the nominal model; a yaw of five times as much is further off than that."""
    nominal, axis = calm.problem.nominal, 2
    model = braked(calm.truth, axis, 5.0)
    again = judged(calm.problem, model, identified(model, nominal))
    own = [k for k, dof in enumerate(nominal.dofs) if dof not in kept(again)]
    assert own
    assert axis not in own
    theta, before, truth = (t.on(nominal.terms).theta for t in (again.model, nominal, calm.truth))
    np.testing.assert_allclose(theta[:, axis], before[:, axis])
    np.testing.assert_allclose(theta[:, own], truth[:, own])
    assert np.all(np.isnan(again.std_error[:, axis]))
    assert unphysical(again.model, nominal, calm.problem.training.nu) is None


def test_nominal_equations_are_not_drawn_and_the_mixture_must_be_possible(calm, rng) -> None:
    """Inertia that couples sway and yaw is positive with its own terms, not with a nominal one."""
    nominal, axis = calm.problem.nominal, 1
    spread = SimpleNamespace(draw=lambda found, *_: 3.0 * found.model)  # of one model
    result = replace(identified(calm.truth, nominal), spread=spread)
    drawn = with_nominal_axes(result, nominal, (axis,), "lost").spread.draw(result, rng)
    theta, before, own = (t.on(nominal.terms).theta for t in (drawn, nominal, 3.0 * calm.truth))
    np.testing.assert_array_equal(theta[:, axis], before[:, axis])
    np.testing.assert_allclose(theta[:, [0, 2]], own[:, [0, 2]])
    table, names = nominal.theta.copy(), [term.name for term in nominal.terms]
    sway, yaw = names.index("v_dot"), names.index("r_dot")
    table[sway, 1] *= 100.0
    table[sway, 2] = table[yaw, 1] = np.sqrt(0.5 * table[sway, 1] * table[yaw, 2])
    result = identified(replace(nominal, theta=table), nominal)
    score = BlockScore(CrossValidation(calm.problem).nominal, (axis,), ())
    assert kept(held_to_nominal(result, score, calm.problem)) == list(nominal.dofs)


def test_equations_that_belong_together_stay_or_go_together(calm) -> None:
    """One axis that is worse with a model that is better as a whole; then all further off."""
    validation, nominal = CrossValidation(calm.problem), calm.problem.nominal
    models = [braked(calm.truth, 2, 2.5)] * len(validation.blocks)
    assert validation.score(models).nominal_axes == (2,)
    score = validation.score(models, together=True)
    assert score.nominal_axes == ()
    assert score.models == tuple(models)
    for factor in (5.0, -5.0):  # no mass can be negative
        score = validation.score([factor * calm.truth] * len(models), together=True)
        assert score.nominal_axes == (0, 1, 2)
        assert score.models == (nominal,) * len(models)


def test_a_state_space_model_is_not_divided(calm, rng) -> None:
    """The same table loses its yaw where its equations can be exchanged, and nothing where not."""
    model, nominal = braked(calm.truth, 2, 2.5), calm.problem.nominal
    linear = StateSpace(np.eye(1), np.eye(1), np.eye(1), np.eye(1), 1.0)
    for space, lost in ((None, ["yaw"]), (linear, [])):
        given = replace(identified(model, nominal), state_space=space, control_model=linear)
        found = auto.identified(Given(given), calm.problem, rng)
        assert kept(found) == lost
        assert (found.control_model is linear) == (not lost)


def test_equations_without_skill_go_together(constant) -> None:
    """A constant force that neither model knows: no worse than the nominal one is not enough."""
    validation = CrossValidation(constant.problem)
    for model, lost in ((constant.problem.nominal, (0, 1, 2)), (constant.truth, ())):
        score = validation.score([model] * len(validation.blocks), together=True)
        assert score.nominal_axes == lost


@pytest.mark.parametrize("options", [{}, {"refinement": "free_run"}, {"inertia_factor": None}])
def test_a_regression_that_fails_is_not_the_result(
    calm, identifier, rng, monkeypatch, options: dict[str, object]
) -> None:
    """Whatever was fitted, each axis is at least as good as its nominal equation, unless asked."""
    nominal, axis = calm.problem.nominal, 2
    factor = 5.0 if options else -5.0  # a mass below zero, where blocks judge: it runs away
    wrong = identified(braked(calm.truth, axis, factor), nominal)
    ls = identifier("ls", **options)
    monkeypatch.setattr(type(ls), "estimated", lambda self, problem, rng: wrong)
    found = auto.identified(ls, calm.problem, rng)
    assert (nominal.dofs[axis] in kept(found)) == ("inertia_factor" not in options)


def test_a_hull_with_thrusters_is_fitted_as_one_whose_forces_are_commanded() -> None:
    """Inertia is free, and damping dissipates; where the table holds a rudder neither is known."""
    names = ("blueboat", "mariner", "esso_osaka_table")
    boat, ship, table = (configured("vessel", name).nominal() for name in names)
    assert [vessel.bare_hull for vessel in (boat, ship, table)] == [True, False, False]
    assert {*boat.accelerations} <= {term.name for term in choose_basis("full", (), boat)}
    assert damping_terms(boat)
    assert not damping_terms(ship)
