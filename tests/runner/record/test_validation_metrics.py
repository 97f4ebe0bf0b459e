"""Rows of the predictions on the held-out part."""

from dataclasses import replace

import numpy as np

from seatrial.models.identification.problem import Identified, Problem
from seatrial.runner.record.validation_metrics import prediction_metrics
from tests.models.identification.conftest import driven, surge


def test_a_model_that_cannot_be_simulated_has_every_row_without_a_value() -> None:
    nominal = surge(60.0, 20.0)
    recording = driven(nominal, 10.0 * np.sin(0.1 * np.arange(300)))
    problem = Problem(recording, recording, nominal, None)
    impossible = replace(nominal, theta=-nominal.theta)
    rows, reasons = prediction_metrics(problem, Identified(impossible, impossible), None)
    named = {
        model: {(row.name, row.dof): row.value for row in rows if row.model == model}
        for model in ("nominal", "identified")
    }
    assert set(named["identified"]) == set(named["nominal"])
    known = {name: v for (name, _), v in named["identified"].items() if v and np.isfinite(v)}
    horizons = ("one_step", "ten_step", "restarts", "free_run")
    assert known == {f"limited_share_{name}": 1.0 for name in horizons}
    assert named["identified"]["held_free_run", "all"] == 0.0
    assert [reason.name for reason in reasons] == ["no_prediction"]
