"""A vessel without further options makes a trial that can be run, whatever commands it."""

from pathlib import Path

import pytest
import yaml

from seatrial.models.errors import ConfigurationError
from seatrial.runner.sweeps import job
from seatrial.runner.sweeps.in_process import composed
from tests.runner.command import Command
from tests.runner.test_conf import check_ranges
from tests.trials import CONF

pytestmark = pytest.mark.usefixtures("own_folder")
DEFAULTS = {"excitation": "waypoints", "controller": "pid_ff", "evaluation": "replay"}
CHOSEN = {
    "milliampere": DEFAULTS,
    "osv": DEFAULTS,  # positioned by its thrusters
    "beluga_full": DEFAULTS | {"excitation": "constant_velocity"},
    "frigate": {
        "excitation": "rudder_zigzag",
        "controller": "autopilot",
        "evaluation": "heading_changes",
    },
    "otter": DEFAULTS | {"excitation": "input_prbs", "controller": "none"},
    "dsrv": DEFAULTS | {"excitation": "input_prbs", "controller": "none"},
}


def names(*overrides: str) -> dict[str, str]:
    chosen = composed(overrides).names
    return {group: chosen[group] for group in DEFAULTS}


@pytest.mark.slow
def test_every_vessel_can_be_run_without_further_options() -> None:
    for vessel in sorted(path.stem for path in (CONF / "vessel").glob("*.yaml")):
        trial = job.prepare(composed([f"vessel={vessel}"]))
        check_ranges(trial.vessel)
        if vessel in CHOSEN:
            assert {group: trial.names[group] for group in DEFAULTS} == CHOSEN[vessel]


def test_the_command_line_and_experiments_choose_first() -> None:
    steered = names("vessel=mariner", "excitation=rudder_zigzag", "evaluation=none")
    assert steered == {
        "excitation": "rudder_zigzag", "controller": "autopilot", "evaluation": "none"
    }  # fmt: skip
    assert names("vessel=mariner", "controller=mpc_heading")["controller"] == "mpc_heading"
    with pytest.raises(ConfigurationError, match="excitation=waypoints: commands forces"):
        job.prepare(composed(["vessel=otter", "excitation=waypoints"]))
    job.prepare(composed(["vessel=osv", "excitation=input_prbs", "controller=pid_ff"]))
    with pytest.raises(ConfigurationError, match="controller=pid_ff commands forces"):
        job.prepare(composed(["vessel=osv", "excitation=heading_changes", "controller=pid_ff"]))
    of_experiment = names("experiment=hoyer_table_7_5", "vessel=beluga_full")
    assert of_experiment == names("experiment=hoyer_table_7_5")


@pytest.mark.parametrize(
    ("words", "excitation", "controller"),
    [
        ("controller=none", "prbs", "none"),
        ("controller=lqi", "waypoints", "lqi"),
        ("excitation=prbs", "prbs", "pid_ff"),
        ("vessel=beluga_full controller=none", "prbs", "none"),
        ("vessel=mariner controller=none", "rudder_zigzag", "none"),
        ("vessel=otter controller=autopilot", "heading_changes", "autopilot"),
        ("vessel=otter excitation=path_following", "path_following", "autopilot"),
        ("vessel=otter excitation=input_prbs", "input_prbs", "none"),
    ],
)
def test_what_is_not_named_follows_the_vessel_and_what_is(
    words: str, excitation: str, controller: str
) -> None:
    order = composed(words.split())
    assert (order.names["excitation"], order.names["controller"]) == (excitation, controller)
    job.prepare(order)  # it can be run


def test_in_a_sweep_each_trial_is_followed_and_vessels_say_what_they_chose(
    seatrial: Command,
) -> None:
    words = ["-m", "vessel=otter,mariner", "controller=none,autopilot", "dry_run=true"]
    printed = seatrial(*words).out
    chosen = "excitation=input_prbs evaluation=replay or excitation=heading_changes"
    assert f"vessel=otter chooses {chosen}" in printed
    assert "4 trials: 4 new" in printed


def test_a_file_of_ones_own_chooses_as_well(tmp_path: Path) -> None:
    craft = yaml.safe_load((CONF / "vessel" / "otter.yaml").read_text())
    (tmp_path / "craft.yaml").write_text(yaml.safe_dump(craft))
    assert names("vessel=craft.yaml") == CHOSEN["otter"]
    own = {"defaults": [{"override /excitation@_global_.excitation": "multisine"}, "_self_"]}
    (tmp_path / "own.yaml").write_text(yaml.safe_dump(own | craft))
    assert names("vessel=own.yaml") == DEFAULTS | {"excitation": "multisine"}
    (tmp_path / "based.yaml").write_text("defaults: [otter]\nlength_m: 2.1\n")
    assert names("vessel=based.yaml") == CHOSEN["otter"]
    (tmp_path / "wrong.yaml").write_text("dofs: [yaw]\ninputs: {n: {low: a}}\ndevices: {b: 3}\n")
    with pytest.raises(ConfigurationError, match="vessel"):
        job.prepare(composed(["vessel=wrong.yaml"]))
