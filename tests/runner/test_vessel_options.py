"""An own vessel of a few lines in an empty folder, with every controller; errors of `auto`."""

import json
import sqlite3
from pathlib import Path

import pytest

from tests.runner.command import Command

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
    with sqlite3.connect(folder / "results" / "results.db") as database:
        (text,) = database.execute("select config from run order by id desc").fetchone()
    result: dict[str, dict[str, object]] = json.loads(text)
    return result


@pytest.mark.parametrize("vessel", SIZES)
def test_the_default_trial_of_an_own_vessel(vessel: str, own: Path, seatrial: Command) -> None:
    assert len((VESSEL + SIZES[vessel]).splitlines()) <= 12
    answer = seatrial("--config-dir", str(own), f"vessel={vessel}", "identifier=ls")
    assert answer.code == 0, answer.err
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
    answer = seatrial(*options, *SHORT, "disturbance=[noise,wind]")
    assert answer.code == 0, answer.err
    with sqlite3.connect(seatrial.folder / "results" / "results.db") as database:
        query = "select value from metric where name = 'e_pos_mae' and model = 'nominal'"
        ((error,),) = database.execute(query).fetchall()
    assert error < 5.0


def test_numbers_can_be_given_in_the_vessel_and_in_the_option(own: Path, seatrial: Command) -> None:
    seatrial.pretend()
    mine = ("--config-dir", str(own), "vessel=limits", "+vessel.tuning.pid.kp=[7.0,8.0,9.0]")
    assert seatrial(*mine, "controller.ki=[1.0,2.0,3.0]", "disturbance=noise").code == 0
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
    said = seatrial.refuses("~vessel")
    assert said.startswith("vessel: got none, expected an option of the group")
