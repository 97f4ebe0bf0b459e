"""Vessels with controllers and evaluations: it sails, or one line says why not.

All pairs on all vessels, in `make nightly`.
"""

from collections.abc import Iterable
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError, SeatrialError
from seatrial.models.excitation.missions import Mission
from seatrial.runner.configuration.config import Trial
from seatrial.runner.trials import closed_loop
from seatrial.runner.trials import trial as trials
from tests.models.simulation.test_every_combination import objects
from tests.trials import composed, options

ROWS = 20  # instants that are sailed
EXCITATIONS = (
    "rudder_zigzag", "rudder_prbs", "input_prbs", "multisine", "many_sine", "prbs",
)  # fmt: skip
REFUSED = ("dsrv", "beluga_diagonal", "beluga_full", "beluga_linear")  # by every controller


def base(vessel: str) -> Trial:
    """A trial with an excitation that suits the vessel, without controller and evaluation."""
    common = (f"vessel={vessel}", "identifier=none", "controller=none", "evaluation=none")
    for excitation in EXCITATIONS:
        try:
            trial = composed(*common, f"excitation={excitation}")
            trials.check(trial)
        except SeatrialError:
            continue
        return trial
    pytest.fail(f"{vessel}: no excitation suits it")


def part(vessel: str, group: str, name: str) -> Any:
    return None if name == "none" else objects(vessel, group, name)


def sailed(trial: Trial, mission: Mission) -> None:
    """Sail the first instants of a mission with the trial's controller."""
    nominal = trial.vessel.nominal()
    setup = closed_loop.prepare(trial, closed_loop.Streams(0), nominal, mission, deployed=True)
    weather = type(setup.weather)(*(rows[:ROWS] for rows in setup.weather))
    added = None if setup.added is None else setup.added[:ROWS]
    log = replace(setup, weather=weather, added=added).sail().voyage.log
    assert len(log.eta) == ROWS
    assert np.all(np.isfinite(log.eta)) and np.all(np.isfinite(log.tau))  # noqa: PT018


def tried(vessel: str, pairs: Iterable[tuple[str, str]]) -> int:
    """The number of pairs of controller and evaluation that sail; the others say why not."""
    start, ran = base(vessel), 0
    for controller, evaluation in pairs:
        names = {**start.names, "controller": controller, "evaluation": evaluation}
        try:
            trial = replace(
                start, names=names, controller=part(vessel, "controller", controller),
                evaluation=part(vessel, "evaluation", evaluation),
            )  # fmt: skip
            trials.check(trial)
            if trials.skipped(trial) is None:
                assert isinstance(trial.evaluation, Mission)
                sailed(trial, trial.evaluation)
                ran += 1
        except ConfigurationError as error:
            said = str(error)
            assert said, names
            assert "\n" not in said, names
    return ran


@pytest.mark.nightly
@pytest.mark.parametrize("vessel", options("vessel"))
def test_the_matrix(vessel: str) -> None:
    ran = tried(vessel, product(options("controller"), options("evaluation")))
    assert (ran == 0) == (vessel in REFUSED)
