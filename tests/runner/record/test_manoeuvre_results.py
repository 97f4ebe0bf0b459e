"""What the models of a trial predict of its manoeuvre."""

from dataclasses import replace

import numpy as np
import pytest

from seatrial.models.identification.problem import Identified, Problem
from seatrial.models.notation import OrderedManoeuvre
from seatrial.models.simulation.manoeuvre_sheet import DIAGNOSTIC
from seatrial.runner.record.catalogue import MEASURE_HIGH, MEASURE_LOW
from seatrial.runner.trials import manoeuvre_results
from seatrial.runner.trials import trial as trials
from seatrial.runner.trials.closed_loop import Streams
from seatrial.runner.trials.trial import excite
from tests.trials import asked_for

OPTIONS = (
    "vessel=mariner", "excitation=rudder_zigzag", "excitation.helm_deg=20", "controller=none",
    "excitation.turn_deg=20", "evaluation=none", "disturbance=noise", "identifier=ls",
)  # fmt: skip


@pytest.mark.slow
def test_intervals_hold_the_overshoots_of_the_ship() -> None:
    """The model is of the ship's form, so that its overshoots are known well."""
    results = trials.run(asked_for(*OPTIONS))
    values = {(row.model, row.name): row.value for row in results.metrics}
    bounds = {(row.name, row.label): row.value or np.nan for row in results.diagnostics}
    for name in ("first", "second"):
        quantity = f"{name} overshoot"
        true = values["plant", f"manoeuvre_{name}_overshoot"]
        own = values["identified", f"manoeuvre_{name}_overshoot"]
        low, high = (bounds[bound, quantity] for bound in (MEASURE_LOW, MEASURE_HIGH))
        assert low < own < high
        assert high - low < 0.3 * own
        assert abs(true - own) < 2.0 * (high - low)
        assert np.isfinite(values["nominal", f"manoeuvre_{name}_overshoot"])


def test_without_a_model_of_its_own_there_are_no_intervals() -> None:
    """The nominal model sails the manoeuvre all the same; what is no manoeuvre has no measures."""
    results = trials.run(asked_for(*OPTIONS, "identifier=none", "excitation.duration_s=100"))
    assert any(row.name == "manoeuvre_initial_turning" for row in results.metrics)
    assert not any(row.name == MEASURE_LOW for row in results.diagnostics)
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
    length = manoeuvre_results.length_of(trial)
    assert length is not None
    ordered = OrderedManoeuvre(turn_deg=19.0)  # as its map may say
    found = manoeuvre_results.manoeuvres(problem, identified, length, ordered)
    values = {
        (f.name.removeprefix(DIAGNOSTIC), f.label.rpartition(", ")[2]): f.value for f in found
    }
    recorded = {name for name, model in values if model == "measured"}
    reached = {name for name in recorded if values[name, "identified model"] is not None}
    assert "initial_turning" in reached
    assert any("overshoot" in name for name in recorded - reached)
    assert values["change_of_heading", "measured"] == 19.0
    for name in recorded:  # the nominal model is the ship
        assert values[name, "nominal model"] == pytest.approx(values[name, "measured"], rel=1e-2)
