"""Vessels with controllers and evaluations: it sails, or one line says why not.

All pairs on all vessels sail for some instants, and each vessel by force with one controller, and
each controller with a vessel, a short trial; in `make nightly`.
"""

from collections.abc import Iterable
from dataclasses import replace
from itertools import cycle, product
from typing import Any

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError, SeatrialError
from seatrial.models.excitation.missions import Mission
from seatrial.models.notation import DOFS
from seatrial.runner.configuration.config import Trial
from seatrial.runner.trials import closed_loop
from seatrial.runner.trials import trial as trials
from tests.models.simulation.test_every_combination import objects
from tests.trials import FORCED, STEERED, composed, options

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


OF_HELM = ("autopilot", "mpc_heading")  # command inputs
CONTROLLERS = sorted({*options("controller")} - {"none", *OF_HELM})
PRBS = ("excitation=prbs", "excitation.length_s=20", "sample_time_s=0.5", "integration_step_s=0.1")
KEEPING = (*PRBS, "evaluation=station_keeping", "evaluation.duration_s=20")
RUNS = ("excitation=constant_velocity", "excitation.run_s=1", "excitation.rest_s=1")
POSITIONED = ("milliampere_azimuths", "osv")  # whose thrusters give any force
REFUSING = tuple(name for name in STEERED if name not in POSITIONED)
SPATIAL = tuple(name for name in FORCED if name.startswith("beluga"))
PLANAR = tuple(name for name in FORCED if name not in SPATIAL)
SIX = "controller: got a vessel in {}, expected one in surge, sway, yaw, or in some of surge, sway"


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("vessel", "controller"),
    [
        *zip(PLANAR, cycle(CONTROLLERS), strict=False),
        *zip(SPATIAL, ("pid_ff", "lqi", "mpc_integral"), strict=True),
    ],
)
def test_a_vessel_with_a_controller(vessel: str, controller: str) -> None:
    """Under noise; a vessel in six degrees of freedom has no linear design."""
    spatial = vessel in SPATIAL
    mission = (*RUNS, "evaluation=replay") if spatial else KEEPING
    words = (f"vessel={vessel}", *mission, "identifier=none", "disturbance=noise")
    trial = composed(*words, f"controller={controller}")
    assert (trial.vessel.dofs == DOFS) == spatial
    if spatial and controller != "pid_ff":
        with pytest.raises(ConfigurationError) as refusal:
            trials.check(trial)
        assert str(refusal.value).startswith(SIX.format(", ".join(DOFS)))
        assert "\n" not in str(refusal.value)
        return
    trials.check(trial)
    results = trials.run(trial)
    (voyage,) = [one for one in results.series if one.kind == "deployment_nominal"]
    assert all(np.all(np.isfinite(column)) for column in voyage.columns.values())
    radius = [one.value for one in results.diagnostics if one.name == "spectral_radius"]
    assert all(value is not None and value < 1.0 for value in radius), (vessel, controller)
    failed = [one.value for one in results.metrics if one.name in ("failures", "held_commands")]
    assert failed
    assert not any(failed), (vessel, controller)


def test_a_vessel_with_inputs_is_refused_where_forces_are_commanded() -> None:
    """In one line; each vessel with a controller and each controller with a vessel."""
    for vessel, controller in zip(REFUSING, cycle((*CONTROLLERS, *OF_HELM)), strict=False):
        with pytest.raises(ConfigurationError) as refusal:
            trials.check(composed(f"vessel={vessel}", f"controller={controller}", *KEEPING))
        assert "\n" not in str(refusal.value), (vessel, controller)


@pytest.mark.parametrize("controller", OF_HELM)
def test_a_controller_of_the_helm_refuses_a_vessel_that_is_commanded_by_forces(
    controller: str,
) -> None:
    with pytest.raises(ConfigurationError, match="cybership2 is commanded by forces"):
        trials.check(composed("vessel=cybership2", f"controller={controller}", *KEEPING))
