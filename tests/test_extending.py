"""A part of every role from outside of the project: the files of CONTRIBUTING.md, as they stand.

They are written to an empty folder, and a trial runs with each of them from the command line.
"""

import os
import re
import sqlite3
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FILE = re.compile(
    r"^```(?:python|yaml)\n# ([\w/]+\.(?:py|yaml))\n(.*?)^```$", re.MULTILINE | re.DOTALL
)
SHORT = ("excitation=waypoints", "excitation.interval_s=20")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    files = FILE.findall((ROOT / "CONTRIBUTING.md").read_text())
    assert len(files) == 11
    for name, text in files:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path


def run(folder: Path, module: str, *arguments: str) -> str:
    """What a program prints in a folder that holds nothing of the project."""
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-m", module, *arguments],
        cwd=folder, env=environment, capture_output=True, text=True, timeout=280,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def rows(folder: Path, query: str) -> list[tuple[object, ...]]:
    with sqlite3.connect(folder / "results" / "results.db") as database:
        return database.execute(query).fetchall()


def test_a_trial_runs_with_each(folder: Path) -> None:
    trial = ("seatrial.runner", "--config-dir", "conf", "vessel=tug")
    run(folder, *trial, *SHORT, "disturbance=squalls", "identifier=scaling")
    controlled = ("excitation=circle", "excitation.duration_s=120", "controller=pd")
    run(folder, *trial, *controlled, "identifier=none", "metrics=[{_target_: speeds.LargestSpeed}]")
    elsewhere = folder / "elsewhere"  # where nobody knows the types of these parts
    elsewhere.mkdir()
    run(elsewhere, "seatrial.runner", *SHORT, "identifier=none")
    choices = rows(
        folder, "select vessel, disturbance, excitation, identifier, controller from run"
    )
    assert choices == [
        ("tug", "squalls", "waypoints", "scaling", "pid_ff"),
        ("tug", "calm", "circle", "none", "pd"),
    ]
    assert rows(folder, "select distinct status from run") == [("finished",)]
    ((factor,),) = rows(folder, "select value from diagnostic where name = 'factor'")
    assert isinstance(factor, float)
    speeds = rows(folder, "select model, unit from metric where name = 'speed_max'")
    assert speeds == [("nominal", "m/s"), ("identified", "m/s")]
    (file,) = {
        Path(line).stem
        for line in run(folder, "seatrial.runner.compare", "plot", "speed_figure").split()
    }
    assert file == "speeds"


def test_the_options_of_a_part_are_checked_and_listed(folder: Path) -> None:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    for option, message in (
        ("disturbance.others.squalls.length_s=-1", "must be positive, got -1"),
        ("identifier=scalin", "scaling"),
        ("identifier=none identifier._target_=seatrial.models.excitation.setpoints.Step", "Step"),
    ):
        command = [
            "seatrial.runner",
            "--config-dir",
            "conf",
            "disturbance=squalls",
            *option.split(),
        ]
        done = subprocess.run(
            [sys.executable, "-m", *command],
            cwd=folder, env=environment, capture_output=True, text=True, timeout=100,
        )  # fmt: skip
        assert done.returncode == 2
        assert done.stderr.count("\n") == 1, done.stderr
        assert message in done.stderr
