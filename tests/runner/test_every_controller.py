"""Every vessel with every controller: a short trial, or one line that says why there is none."""

import numpy as np
import pytest

from docs.vessels import CONF, parameters_of, vessels
from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import DOFS
from seatrial.runner import trial as trials
from tests.runner.command import Command
from tests.runner.programs import rows
from tests.trials import composed

OF_HELM = ("autopilot", "mpc_heading")  # command inputs
CONTROLLERS = sorted(
    {path.stem for path in (CONF / "controller").glob("*.yaml")} - {"none", *OF_HELM}
)
PRBS = ("excitation=prbs", "excitation.length_s=20", "sample_time_s=0.5", "integration_step_s=0.1")
KEEPING = (*PRBS, "evaluation=station_keeping", "evaluation.duration_s=20")
RUNS = ("excitation=constant_velocity", "excitation.run_s=1", "excitation.rest_s=1")
STEERED = tuple(name for name in vessels() if parameters_of(name).inputs)
POSITIONED = ("milliampere_azimuths", "osv")  # whose thrusters give any force
FORCED = tuple(name for name in vessels() if name not in STEERED)
SIX = "controller: got a vessel in {}, expected one in surge, sway, yaw, or in some of surge, sway"


@pytest.mark.parametrize("vessel", FORCED)
def test_every_vessel_with_every_controller(vessel: str) -> None:
    """Under noise; a vessel in six degrees of freedom has no linear design."""
    spatial = parameters_of(vessel).dofs == DOFS
    mission = (*RUNS, "evaluation=replay") if spatial else KEEPING
    words = (f"vessel={vessel}", *mission, "identifier=none", "disturbance=noise")
    for controller in CONTROLLERS:
        trial = composed(*words, f"controller={controller}")
        if spatial and controller != "pid_ff":
            with pytest.raises(ConfigurationError) as refusal:
                trials.check(trial)
            assert str(refusal.value).startswith(SIX.format(", ".join(DOFS)))
            assert "\n" not in str(refusal.value)
            continue
        trials.check(trial)
        results = trials.run(trial)
        (sailed,) = [one for one in results.series if one.kind == "deployment_nominal"]
        assert all(np.all(np.isfinite(column)) for column in sailed.columns.values())
        radius = [one.value for one in results.diagnostics if one.name == "spectral_radius"]
        assert all(value is not None and value < 1.0 for value in radius), (vessel, controller)
        failed = [one.value for one in results.metrics if one.name in ("failures", "held_commands")]
        assert failed
        assert not any(failed), (vessel, controller)


@pytest.mark.parametrize("vessel", [name for name in STEERED if name not in POSITIONED])
def test_a_vessel_with_inputs_is_refused_where_forces_are_commanded(vessel: str) -> None:
    """In one line, with every controller, for an excitation by forces on its axes."""
    for controller in (*CONTROLLERS, *OF_HELM):
        with pytest.raises(ConfigurationError) as refusal:
            trials.check(composed(f"vessel={vessel}", f"controller={controller}", *KEEPING))
        assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("controller", OF_HELM)
def test_a_controller_of_the_helm_refuses_a_vessel_that_is_commanded_by_forces(
    controller: str,
) -> None:
    with pytest.raises(ConfigurationError, match="cybership2 is commanded by forces"):
        trials.check(composed("vessel=cybership2", f"controller={controller}", *KEEPING))


@pytest.mark.slow
def test_cybership_from_its_paper_sails_with_every_controller(seatrial: Command) -> None:
    """A four-corner test in noise and wind: within half a length and five degrees on average."""
    answer = seatrial(
        "-m", "vessel=cybership2", f"controller={','.join(CONTROLLERS)}", "identifier=none",
        "excitation=single_ramp", "evaluation=four_corner", "disturbance=[noise,wind]",
    )  # fmt: skip
    assert answer.code == 0, answer.err
    query = "SELECT value FROM metric WHERE model = 'nominal' AND name = '{}'"
    for metric, most in (("e_pos_mae", 0.5 * 1.255), ("e_psi_mae", 5.0)):
        errors = [value for (value,) in rows(seatrial.folder, query.format(metric))]
        assert len(errors) == len(CONTROLLERS)
        assert all(isinstance(value, float) and value < most for value in errors), metric
