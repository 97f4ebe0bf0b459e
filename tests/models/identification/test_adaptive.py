"""Identification while sailing: when it happens, what it keeps, and what it is worth."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.models.identification.problem import Identified, Problem
from seatrial.runner.record.rows import Results
from seatrial.runner.trials import trial as trials
from tests.trials import composed

FERRY = ("controller=pid_ff", "controller.thruster_lead=true", "identifier=ls", "disturbance=calm")
WATCHED = "update={{window_s: 120, every_s: 10, trigger: {}, threshold: {}, lowpass_hz: null}}"


def run(*options: str) -> Results:
    return trials.run(composed(*FERRY, *options))


def errors(results: Results) -> dict[str, float]:
    """Mean error of the position by model [m]."""
    return {m.model: float(m.value or 0.0) for m in results.metrics if m.name == "e_pos_mae"}


def times(results: Results) -> list[float]:
    return [float(d.value or 0.0) for d in results.diagnostics if d.name == "update"]


@pytest.mark.parametrize(("trigger", "threshold"), [("feedback", 0.4), ("residual", 0.3)])
def test_a_wrong_model_is_replaced_once(trigger: str, threshold: float) -> None:
    """The nominal inertia is twice the true one; the first window is enough to learn that."""
    results = run(WATCHED.format(trigger, threshold))
    assert times(results) == [120.0]
    found = errors(results)
    assert found["identified"] < found["adaptive"] < 0.3 * found["nominal"]
    versions = {c.model for c in results.coefficients if c.model.startswith("adaptive")}
    assert versions == {"adaptive_1"}
    mass = {(c.model, c.dof, c.term): c.value for c in results.coefficients}
    assert mass["adaptive_1", "surge", "u_dot"] == pytest.approx(0.5 * 2389.657, rel=1e-6)
    assert {s.kind for s in results.series} >= {"deployment_adaptive"}


def test_a_plant_that_changes_in_mid_mission_is_followed() -> None:
    change = "plant.change={at_s: 300, scale: 0.8}"
    results = run(WATCHED.format("feedback", 0.4), change)
    found = errors(results)
    assert found["adaptive"] < found["identified"] < found["nominal"]
    assert times(results)[0] == 120.0
    assert any(time > 300.0 for time in times(results))
    last = f"adaptive_{len(times(results))}"
    mass = {(c.model, c.dof, c.term): c.value for c in results.coefficients}
    assert mass[last, "surge", "u_dot"] == pytest.approx(0.8 * 2389.657, rel=1e-3)


@pytest.mark.slow
def test_the_change_of_the_plant_is_met_by_every_deployment_and_no_excitation() -> None:
    changed = run("plant.change={at_s: 1, scale: 2.0}")
    same = run()
    assert errors(changed)["nominal"] != errors(same)["nominal"]
    masses = [
        next(c.value for c in r.coefficients if c.model == "identified" and c.term == "u_dot")
        for r in (changed, same)
    ]
    assert masses[0] == masses[1]


def test_a_good_model_is_left_alone() -> None:
    results = run(WATCHED.format("feedback", 50.0))
    assert times(results) == []
    found = errors(results)
    assert found["adaptive"] == pytest.approx(found["nominal"], rel=1e-12)


def nothing(problem: Problem) -> Identified:
    raise IdentificationError("too little to go by")


def worse(problem: Problem) -> Identified:
    return Identified(3.0 * problem.nominal, 2.0 * problem.nominal)


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (nothing, "too little to go by"),
        (worse, "the candidate does not explain the end of the window better than the last model"),
    ],
)
def test_a_window_without_a_better_model_changes_nothing(
    monkeypatch: pytest.MonkeyPatch, answer: Callable[[Problem], Identified], reason: str
) -> None:
    one = replace(composed(*FERRY, WATCHED.format("feedback", 0.4)), model_error=False)
    identify, calls = type(one.identifier).identify, []

    def instead(self: Any, problem: Problem, rng: Any) -> Identified:
        calls.append(len(problem.training))
        # the first is the trial's own identification
        return identify(self, problem, rng) if len(calls) == 1 else answer(problem)

    monkeypatch.setattr(type(one.identifier), "identify", instead)
    results = trials.run(one)
    assert times(results) == []
    refused = [d.label for d in results.diagnostics if d.name == "update_refused"]
    assert len(refused) == len(calls) - 1 > 0
    assert reason in refused
    assert all(n == 900 for n in calls[1:])  # three quarters of 120 s


@pytest.mark.nightly
def test_another_controller_keeps_its_memory() -> None:
    results = trials.run(
        composed(
            "controller=lqi", "identifier=ls", "disturbance=calm",
            WATCHED.format("residual", 0.3),
        )
    )  # fmt: skip
    assert times(results) != []
    series = next(s for s in results.series if s.kind == "deployment_adaptive")
    changes = np.abs(np.diff(series.columns["tau_surge"]))
    at = round(times(results)[0] / 0.1)
    assert changes[at - 5 : at + 6].max() < 0.2 * changes.max()


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("update={window_s: 0, every_s: 1, trigger: feedback, threshold: 1, lowpass_hz: null}",
         "update.window_s must be positive"),
        ("update={window_s: 1, every_s: 1, trigger: luck, threshold: 1, lowpass_hz: null}",
         "update.trigger: got 'luck'"),
        ("update={window_s: 1}", "update.every_s is missing"),
        ("update=3", "update: got 3, expected a group of options"),
        ("plant.change={at_s: -1, scale: 1}", "plant.change.at_s must be positive"),
    ],
)  # fmt: skip
def test_wrong_options_are_refused(option: str, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        composed(*FERRY, option)
