"""Intervals of tracking errors: drawn plants under the controller of the identified model."""

from dataclasses import replace

import numpy as np
import pytest

from seatrial.models.excitation.missions import Mission
from seatrial.models.identification.model_error import ModelError
from seatrial.models.identification.problem import Identified
from seatrial.runner.configuration.config import Trial
from seatrial.runner.trials.closed_loop import Streams, prepare
from seatrial.runner.trials.deployment_metrics import HIGH, LOW, mission_metrics, tracking_intervals
from tests.trials import asked_for, excited

OPTIONS = (
    "vessel=surge_linear", "excitation=multisine", "disturbance=noise", "identifier=ls",
    "identifier.basis=physical", "evaluation=setpoints", "evaluation.duration_s=100",
    "controller=pid_ff",
)  # fmt: skip


def trial_and_model() -> tuple[Trial, Identified]:
    trial = asked_for(*OPTIONS)
    problem, _ = excited(*OPTIONS)
    return trial, trial.identifier.identify(problem, np.random.default_rng(0))


def bounds(trial: Trial, identified: Identified) -> dict[str, float]:
    """Bounds of the position error by name, that of the identified model as its own plant too."""
    mission, seeds = trial.evaluation, Streams(0)
    assert isinstance(mission, Mission)
    model = identified.model
    own = prepare(trial, seeds, model, mission, deployed=True, true=model).sail()
    found = tracking_intervals(trial, seeds, identified, mission, own)
    values = {row.name: row.value for row in found if row.label == "e_pos_mae"}
    rows = mission_metrics(own, "identified")
    values |= {row.name: row.value for row in rows if row.name == "e_pos_mae"}
    return {name: value for name, value in values.items() if value is not None}


def test_an_interval_grows_with_the_model_error() -> None:
    trial, identified = trial_and_model()
    widths = []
    for force in (None, 0.1, 0.4):
        error = (
            None
            if force is None
            else ModelError(1.0, np.array([force]), 1.0, np.ones(1), np.zeros(2))
        )
        values = bounds(trial, replace(identified, model_error=error))
        assert values[LOW] < values[HIGH]
        widths.append(values[HIGH] - values[LOW])
        if force is None:  # near the model's own
            assert values["e_pos_mae"] == pytest.approx(values[LOW], rel=0.2)
    assert widths[0] < widths[1] < widths[2]


def test_without_a_distribution_or_time_there_is_no_interval() -> None:
    trial, identified = trial_and_model()
    assert set(bounds(trial, replace(identified, spread=None))) == {"e_pos_mae"}
    mission, seeds = trial.evaluation, Streams(0)
    assert isinstance(mission, Mission)
    own = prepare(trial, seeds, identified.model, mission, deployed=True).sail()
    planned = replace(own, design=replace(own.design, ahead=10))
    (row,) = tracking_intervals(trial, seeds, identified, mission, planned)
    assert row.name == "no_tracking_interval"
