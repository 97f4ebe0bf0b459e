"""A model that creates energy is stored and flagged, and deployed only if that is asked for."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from seatrial.models.identification.problem import Identified, Identifier, Problem
from seatrial.models.vessel.basis import term
from seatrial.runner.record.rows import Results
from seatrial.runner.trials import trial as trials
from tests.trials import composed


@dataclass(frozen=True)
class Pushed(Identifier):
    """The true model of the ferry but for a linear damping in surge, which pushes it."""

    damping: float  # [kg/s]

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        theta = 0.5 * problem.nominal.theta
        theta[problem.nominal.terms.index(term("u")), 0] = self.damping
        model = replace(problem.nominal, theta=theta)
        return Identified(model, model - problem.nominal)


def results_of(damping: float, *overrides: str) -> Results:
    trial = replace(composed("identifier=none", *overrides), identifier=Pushed(damping))
    trials.check(trial)
    return trials.run(trial)


def deployed(results: Results) -> set[str]:
    rows = [row for row in results.metrics if row.name == "e_pos_mae"]
    assert {row.model for row in rows} == {"nominal", "identified"}  # withheld: without a value
    return {row.model for row in rows if row.value is not None}


def flags(results: Results) -> list[str]:
    return [one.label for one in results.diagnostics if one.name == "unphysical"]


def test_it_is_stored_and_flagged_but_not_deployed(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("WARNING"):
        results = results_of(-200.0)
    (reason,) = flags(results)
    assert reason.startswith("its damping creates energy at ")
    assert results.note is not None
    assert results.note.startswith("the identified model is not deployed: its damping creates")
    assert results.note.endswith("deploy_unphysical=true deploys it")
    assert results.note in caplog.messages
    assert deployed(results) == {"nominal"}
    assert not [one for one in results.series if one.kind == "deployment_identified"]
    assert [one for one in results.series if one.kind == "deployment_nominal"]
    stored = [
        row.value
        for row in results.coefficients
        if (row.model, row.dof, row.term) == ("identified", "surge", "u")
    ]
    assert stored == pytest.approx([-200.0])


def test_it_is_deployed_if_that_is_asked_for() -> None:
    results = results_of(-200.0, "deploy_unphysical=true")
    assert len(flags(results)) == 1
    assert results.note is None
    assert deployed(results) == {"nominal", "identified"}


def test_a_physical_model_has_no_flag() -> None:
    results = results_of(14.0)
    assert flags(results) == []
    assert results.note is None
    assert deployed(results) == {"nominal", "identified"}
