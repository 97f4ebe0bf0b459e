"""Numbers that follow from the vessel: own vessels of a few lines, tuned ones, and refusals."""

import json
from pathlib import Path

import pytest

from tests.runner.command import Command
from tests.runner.programs import rows

VESSEL = """\
_target_: seatrial.models.vessel.parameters.VesselParameters
name: launch
dofs: [surge, sway, yaw]
inertia: [[3000.0, 0.0, 0.0], [0.0, 3500.0, 80.0], [0.0, 80.0, 6000.0]]
derivatives: {X_u: -40.0, X_|u|u: -120.0, Y_v: -60.0, Y_|v|v: -300.0, N_r: -150.0, N_|r|r: -900.0}
"""
SIZES = {"limits": "force_limits: [1200.0, 800.0, 2000.0]\n", "length": "length_m: 5.0\n"}
SHORT = ("evaluation=four_corner", "excitation=single_ramp", "identifier=none")


@pytest.fixture
def own(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of configurations with the vessels of `SIZES`, and one that states neither."""
    folder = tmp_path_factory.mktemp("own")
    (folder / "vessel").mkdir()
    for name, line in (SIZES | {"neither": ""}).items():
        (folder / "vessel" / f"{name}.yaml").write_text(VESSEL + line)
    return folder


def config(folder: Path) -> dict[str, dict[str, object]]:
    """The configuration of the last trial, as it is stored."""
    (text,) = rows(folder, "select config from run order by id desc")[0]
    result: dict[str, dict[str, object]] = json.loads(str(text))
    return result


@pytest.mark.parametrize("vessel", SIZES)
def test_the_default_trial_of_an_own_vessel(vessel: str, own: Path, seatrial: Command) -> None:
    assert len((VESSEL + SIZES[vessel]).splitlines()) <= 12
    seatrial.succeeds("--config-dir", str(own), f"vessel={vessel}", "identifier=ls")
    stored = config(seatrial.folder)
    assert "auto" not in json.dumps({**stored, "identifier": None})
    assert stored["plant"]["scale"] == 1.0


MORE = (
    pytest.param(name, marks=pytest.mark.nightly)
    for name in ("lqi", "mpc_condensed", "mpc_integral", "mpc_reduced")
)


@pytest.mark.slow
@pytest.mark.parametrize("controller", ["mpc_standard", *MORE])
def test_every_controller_tracks_with_derived_weights(
    controller: str, own: Path, seatrial: Command
) -> None:
    """Its positions stay within a length of the reference on average."""
    options = ("--config-dir", str(own), "vessel=limits", f"controller={controller}")
    seatrial.succeeds(*options, *SHORT, "disturbance=[noise,wind]")
    query = "select value from metric where name = 'e_pos_mae' and model = 'nominal'"
    ((error,),) = rows(seatrial.folder, query)
    assert float(str(error)) < 5.0


def test_numbers_can_be_given_in_the_vessel_and_in_the_option(own: Path, seatrial: Command) -> None:
    seatrial.pretend()
    mine = ("--config-dir", str(own), "vessel=limits", "+vessel.tuning.pid.kp=[7.0,8.0,9.0]")
    seatrial.succeeds(*mine, "controller.ki=[1.0,2.0,3.0]", "disturbance=noise")
    stored = config(seatrial.folder)
    assert stored["controller"]["kp"] == [7.0, 8.0, 9.0]
    assert stored["controller"]["ki"] == [1.0, 2.0, 3.0]
    shown = seatrial(*mine, "--cfg", "job", "--package", "controller").out
    assert "- 8.0" in shown
    assert "auto" not in shown


def test_a_vessel_without_enough(own: Path, seatrial: Command) -> None:
    seatrial.pretend()
    said = seatrial.refuses("--config-dir", str(own), "vessel=neither")
    assert said.endswith(
        ": cannot be derived from vessel launch: expected force_limits or length_m, got neither"
    )
    said = seatrial.refuses(
        "--config-dir", str(own), "vessel=neither", "+vessel.velocity_limits=[9.0,9.0,9.0]"
    )
    assert said.startswith("excitation.reference_filter.bandwidth_rad_s: cannot be derived from")
    said = seatrial.refuses("evaluation=setpoints", "evaluation.duration_s=auto")
    assert said.startswith("evaluation.duration_s: got auto, expected a number: ")
    said = seatrial.refuses("vessel=tanker", "controller=lqi")
    assert said.endswith("cannot be derived: tanker is commanded by delta, n")


# Derived gains and weights beside those that were tuned by hand, on the vessel's own missions.
PID = tuple(f"vessel.tuning.pid.{gain}=null" for gain in ("kp", "ki", "kd"))
LINEAR = tuple(
    f"vessel.tuning.control.{name}=null"
    for name in (
        *("period_s", "horizon", "error_weight", "input_weight", "increment_weight"),
        *("process", "measurement", "bias_walk"),
    )
)
LAP = ("controller=pid_ff",)
RUNS = ("controller=pid_ff", "excitation=constant_velocity")
CORNERS = ("excitation=single_ramp", "evaluation=four_corner")
PLANAR = ("milliampere", "modulus_ship", "supply_vessel")
CASES = {
    **{f"{vessel} pid_ff": (vessel, LAP, PID) for vessel in PLANAR},
    **{f"{name} pid_ff": (name, RUNS, PID) for name in ("beluga_diagonal", "beluga_full")},
    **{
        f"{vessel} {controller}": (vessel, (*CORNERS, f"controller={controller}"), LINEAR)
        for vessel in PLANAR
        for controller in ("lqi", "mpc_standard", "mpc_integral")
    },
}


@pytest.mark.nightly
@pytest.mark.parametrize("case", CASES)
def test_derived_numbers_track_within_5_percent_of_tuned_ones(case: str, seatrial: Command) -> None:
    """Calm, and under noise on average over two seeds."""
    vessel, mission, derived = CASES[case]
    weather = ("--variant", "disturbance=calm seed=0", "--variant", "disturbance=noise seed=0,1")
    for given in ((), derived):
        chosen = (f"vessel={vessel}", *mission, *given, "identifier=none")
        seatrial.succeeds("-m", *weather, *chosen)
    found = rows(
        seatrial.folder,
        "select avg(value) from metric join run on run.id = run_id where name = 'e_pos_mae'"
        " and model = 'nominal' group by disturbance, sweep_id order by disturbance, sweep_id",
    )
    errors = [float(str(value)) for (value,) in found]
    assert len(errors) == 4
    for by_hand, own in zip(errors[::2], errors[1::2], strict=True):
        assert own <= 1.05 * by_hand
