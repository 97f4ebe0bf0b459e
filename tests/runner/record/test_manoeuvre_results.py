"""What the models of a trial predict of its manoeuvre."""

from dataclasses import replace

import numpy as np
import pytest

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.identification.problem import Identified, Problem
from seatrial.models.notation import OrderedManoeuvre
from seatrial.models.simulation.manoeuvre_sheet import DIAGNOSTIC
from seatrial.runner.trials import manoeuvre_results
from seatrial.runner.trials import trial as trials
from seatrial.runner.trials.closed_loop import Streams
from seatrial.runner.trials.trial import excite, identify
from tests.trials import asked_for

OPTIONS = (
    "vessel=mariner", "excitation=rudder_zigzag", "excitation.helm_deg=20", "controller=none",
    "excitation.turn_deg=20", "evaluation=none", "disturbance=noise", "identifier=ls",
)  # fmt: skip


def compared(found: list[Diagnostic]) -> dict[tuple[str, str], float | None]:
    """The values by quantity and by what they are of."""
    return {
        (row.name.removeprefix(DIAGNOSTIC), (row.label or "").rpartition(", ")[2]): row.value
        for row in found
    }


@pytest.mark.slow
def test_intervals_hold_the_overshoots_of_the_ship() -> None:
    """The model is of the ship's form, so that its overshoots are known well."""
    seeds = Streams(0)
    trial = asked_for(*OPTIONS, "excitation.duration_s=400", "model_error=false")
    recording, ship = excite(trial, seeds).recording, trial.vessel.nominal()
    problem = Problem(recording, recording, ship, None)
    identified = identify(trial, problem, seeds)
    length_m, ordered = trial.vessel.scales.length_m, OrderedManoeuvre("zigzag")
    found = manoeuvre_results.recorded_manoeuvres(problem, identified, length_m, ordered)
    values = {key: value or np.nan for key, value in compared(found).items()}
    for name in ("first_overshoot", "second_overshoot"):
        own, low, high = (values[name, of] for of in ("identified model", "low", "high"))
        assert low < own < high
        assert low < values[name, "measured"] < high
        assert high - low < 0.4 * own
        assert np.isfinite(values[name, "nominal model"])


def test_the_measures_of_a_manoeuvre_are_those_of_every_model() -> None:
    """The nominal model sails the manoeuvre, too; what is no manoeuvre has no measures."""
    results = trials.run(asked_for(*OPTIONS, "identifier=none", "excitation.duration_s=100"))
    models = {row.model for row in results.metrics if row.name == "manoeuvre_initial_turning"}
    assert models == {"nominal", "identified", "plant"}
    other = ("vessel=mariner", "excitation=rudder_prbs", "controller=none", "evaluation=none")
    results = trials.run(asked_for(*other, "identifier=none"))
    assert not any(row.name.startswith("manoeuvre_") for row in results.metrics)


def test_a_measure_is_compared_with_the_one_of_its_name() -> None:
    """A model that turns away reaches fewer overshoots than were recorded, and has no others."""
    calm = ("disturbance=calm", "identifier=none", "excitation.duration_s=400")
    trial = asked_for(*OPTIONS, *calm)
    recording = excite(trial, Streams(0)).recording
    ship = trial.vessel.nominal()
    rate = [term.name for term in ship.terms].index("r")
    theta = np.array(ship.theta)
    theta[rate, ship.dofs.index("yaw")] *= 3.0
    astray = replace(ship, theta=theta)
    identified = Identified(astray, astray + (-1.0) * ship)
    problem = Problem(recording, recording, ship, None)
    length, ordered = trial.vessel.scales.length_m, OrderedManoeuvre(turn_deg=19.0)  # as of a map
    found = manoeuvre_results.recorded_manoeuvres(problem, identified, length, ordered)
    values = compared(found)
    recorded = {name for name, model in values if model == "measured"}
    reached = {name for name in recorded if values[name, "identified model"] is not None}
    assert "initial_turning" in reached
    assert any("overshoot" in name for name in recorded - reached)
    assert values["change_of_heading", "measured"] == 19.0
    for name in recorded:  # the nominal model is the ship
        assert values[name, "nominal model"] == pytest.approx(values[name, "measured"], rel=1e-2)
