"""Vessels with controllers: a short trial, or one line that says why there is none.

Each vessel by force has one controller and each controller a vessel; `make nightly` has them all.
"""

from itertools import cycle

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import DOFS
from seatrial.runner.trials import trial as trials
from tests.trials import FORCED, STEERED, composed, options

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


def sails(vessel: str, controller: str) -> None:
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
    (sailed,) = [one for one in results.series if one.kind == "deployment_nominal"]
    assert all(np.all(np.isfinite(column)) for column in sailed.columns.values())
    radius = [one.value for one in results.diagnostics if one.name == "spectral_radius"]
    assert all(value is not None and value < 1.0 for value in radius), (vessel, controller)
    failed = [one.value for one in results.metrics if one.name in ("failures", "held_commands")]
    assert failed
    assert not any(failed), (vessel, controller)


def refused(vessel: str, controller: str) -> None:
    """In one line, for an excitation by forces on the axes of a vessel with inputs."""
    with pytest.raises(ConfigurationError) as refusal:
        trials.check(composed(f"vessel={vessel}", f"controller={controller}", *KEEPING))
    assert "\n" not in str(refusal.value), (vessel, controller)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("vessel", "controller"),
    [
        *zip(PLANAR, cycle(CONTROLLERS), strict=False),
        *zip(SPATIAL, ("pid_ff", "lqi", "mpc_integral"), strict=True),
    ],
)
def test_a_vessel_with_a_controller(vessel: str, controller: str) -> None:
    sails(vessel, controller)


def test_a_vessel_with_inputs_is_refused_where_forces_are_commanded() -> None:
    """Each vessel with a controller and each controller with a vessel."""
    for vessel, controller in zip(REFUSING, cycle((*CONTROLLERS, *OF_HELM)), strict=False):
        refused(vessel, controller)


@pytest.mark.parametrize("controller", OF_HELM)
def test_a_controller_of_the_helm_refuses_a_vessel_that_is_commanded_by_forces(
    controller: str,
) -> None:
    with pytest.raises(ConfigurationError, match="cybership2 is commanded by forces"):
        trials.check(composed("vessel=cybership2", f"controller={controller}", *KEEPING))
