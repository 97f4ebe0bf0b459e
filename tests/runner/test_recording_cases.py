"""Small logs as people's loggers write them: the command of each, and what a user should see."""

import re
import shlex
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from tests.data import DATA
from tests.runner.programs import ROOT, completed

PLAIN = {"surge": "north", "sway": "east", "yaw": "heading"}
SPEED = {"surge": "u", "sway": "v", "yaw": "r"}
FORCE = {"surge": "force_x", "sway": "force_y", "yaw": "moment_z"}
TWIST = {
    "surge": "odom:twist.twist.linear.x", "sway": "odom:twist.twist.linear.y",
    "yaw": "odom:twist.twist.angular.z",
}  # fmt: skip
WHOLE = {"position": PLAIN, "velocity": SPEED, "force": FORCE}
POSE = {part: f"odom:pose.pose.orientation.{part}" for part in "wxyz"}


def is_map(**wanted: object) -> Callable[[str, str], bool]:
    """Whether the map that is printed holds all that is wanted."""

    def holds(out: str, err: str) -> bool:
        node = yaml.safe_load(out)
        return all(node.get(key) == value for key, value in wanted.items())

    return holds


def says(*parts: str, never: str = "Traceback") -> Callable[[str, str], bool]:
    """Whether all of the texts are printed, and the other one is not."""

    def said(out: str, err: str) -> bool:
        text = re.sub(r"\s+", " ", f"{out} {err}")
        return all(part in text for part in parts) and never not in text

    return said


ODOMETRY = is_map(
    position={"surge": "odom:pose.pose.position.x", "sway": "odom:pose.pose.position.y"},
    orientation=POSE, velocity=TWIST,
    force={"surge": "tau:force.x", "sway": "tau:force.y", "yaw": "tau:torque.z"},
)  # fmt: skip
AUTOPILOT = is_map(
    time={"column": "TimeUS", "unit": "us"}, inputs={"pwm_1": "RCOU:C1", "pwm_2": "RCOU:C3"},
    position={"surge": "XKF1:PN", "sway": "XKF1:PE", "yaw": {"column": "XKF1:Yaw", "unit": "deg"}},
)  # fmt: skip
CASES: dict[str, tuple[Callable[[str, str], bool], ...]] = {
    "bag_ros1_odometry": (ODOMETRY,),
    "bag_unknown_message": (ODOMETRY, says("/ballast", "boat_msgs/msg/Ballast", never="KeyError")),
    "column_twice": (is_map(time="time", **WHOLE), says("column time")),
    "date_day_first": (says("no problem", "1500 299.8 5 "),),
    "folder_of_autopilot_messages": (AUTOPILOT,),
    "heading_is_recorded": (
        says("no velocity in surge and sway is recorded", never="the heading is not recorded"),
    ),
    "heading_unwrapped_check": (
        says("no problem: pose and velocity are consistent", "yaw 1.000 1.000 yes",
             never="problem: yaw"),
    ),
    "map_edited_is_another_trial": (says("run 2 finished", "1.94 times", never="already in"),),
    "map_without_velocities": (is_map(time="time", position=PLAIN, force=FORCE),),
    "missing_as_text": (
        is_map(velocity=SPEED, position={**PLAIN, "yaw": "psi"}),
        says("3 of 1500 cells are N/A", "1 of 1500 cells are null"),
    ),
    "roll_in_degrees": (
        is_map(velocity=SPEED, position={
            "surge": "x", "sway": "y",
            **{dof: {"column": dof, "unit": "deg"} for dof in ("roll", "pitch", "yaw")},
        }),
    ),
    "time_TimeUS": (is_map(time={"column": "TimeUS", "unit": "us"}, **WHOLE),),
    "time_influx": (is_map(time="_time", **WHOLE),),
    "trial_without_velocities": (says("run 1 finished"),),
    "units_in_names_of_inputs": (
        is_map(inputs={"delta": {"column": "rudder_deg", "unit": "deg"},
                       "n": {"column": "shaft_rpm", "unit": "rpm"}}),
    ),
}  # fmt: skip


@pytest.mark.data
@pytest.mark.parametrize("name", CASES)
def test_a_user_sees_what_is_expected(name: str, tmp_path: Path) -> None:
    folder = tmp_path / name
    shutil.copytree(DATA / "cases" / name, folder)
    program = f"{shlex.quote(sys.executable)} -m seatrial.runner"
    command = (folder / "cmd.txt").read_text().replace("seatrial ", f"{program} ")
    answer = completed("bash", "-c", command, folder=folder, PYTHONPATH=str(ROOT))
    assert answer.returncode == 0, answer.stderr
    for check in CASES[name]:
        assert check(answer.stdout, answer.stderr), (answer.stdout, answer.stderr)
