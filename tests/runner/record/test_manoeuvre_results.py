"""What the models of a trial predict of its manoeuvre."""

import numpy as np
import pytest

from seatrial.runner import trial as trials
from seatrial.runner.database.records import Results
from seatrial.runner.record.catalogue import MEASURE_HIGH, MEASURE_LOW
from tests.trials import asked_for

OPTIONS = (
    "vessel=mariner", "excitation=rudder_zigzag", "excitation.helm_deg=20", "controller=none",
    "excitation.turn_deg=20", "evaluation=none", "disturbance=noise", "identifier=ls",
)  # fmt: skip


def results_of(*options: str) -> Results:
    return trials.run(asked_for(*OPTIONS, *options))


@pytest.mark.slow
def test_intervals_hold_the_overshoots_of_the_ship() -> None:
    """The model is of the ship's form, so that its overshoots are known well."""
    results = results_of()
    values = {(row.model, row.name): row.value for row in results.metrics}
    bounds = {(row.name, row.label): row.value for row in results.diagnostics}
    for name in ("first", "second"):
        quantity = f"{name} overshoot"
        true = values["plant", f"manoeuvre_{name}_overshoot"]
        own = values["identified", f"manoeuvre_{name}_overshoot"]
        low, high = (bounds[bound, quantity] for bound in (MEASURE_LOW, MEASURE_HIGH))
        assert low is not None
        assert high is not None
        assert low < own < high
        assert high - low < 0.3 * own
        assert abs(true - own) < 2.0 * (high - low)
        assert np.isfinite(values["nominal", f"manoeuvre_{name}_overshoot"])


def test_without_a_model_of_its_own_there_are_no_intervals() -> None:
    """The nominal model sails the manoeuvre all the same; a mission is no manoeuvre."""
    results = results_of("identifier=none", "excitation.duration_s=100")
    assert any(row.name == "manoeuvre_initial_turning" for row in results.metrics)
    assert not any(row.name == MEASURE_LOW for row in results.diagnostics)


def test_what_is_no_manoeuvre_has_no_measures() -> None:
    trial = asked_for(
        "vessel=mariner", "excitation=rudder_prbs", "identifier=none", "controller=none",
        "evaluation=none", "disturbance=calm",
    )  # fmt: skip
    assert not any(row.name.startswith("manoeuvre_") for row in trials.run(trial).metrics)
