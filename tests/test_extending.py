"""A part of every role from outside of the project, from CONTRIBUTING.md and docs/howto/plugins.md.

They are written to an empty folder, and a trial runs with each of them from the command line.
"""

from pathlib import Path

import pytest

from tests.test_plugins import rows, run, written


@pytest.mark.nightly
def test_a_trial_runs_with_a_part_of_each_role(tmp_path: Path) -> None:
    folder = written(written(tmp_path), "CONTRIBUTING.md", 9)
    trial = ("seatrial.runner", "--config-dir", "conf", "vessel=tug")
    mission = ("excitation=waypoints", "excitation.interval_s=20")
    run(folder, *trial, *mission, "disturbance=squalls", "identifier=scaling")
    controlled = ("excitation=circle", "excitation.duration_s=120", "controller=pd")
    run(folder, *trial, *controlled, "identifier=none", "metrics=[{_target_: speeds.LargestSpeed}]")
    elsewhere = folder / "elsewhere"  # where nobody knows the types of these parts
    elsewhere.mkdir()
    run(elsewhere, "seatrial.runner", *mission, "identifier=none")
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
    plugin = {"SEATRIAL_PLUGINS": "speed_figure"}
    files = run(folder, "seatrial.runner.compare", "plot", "speeds", **plugin).split()
    assert {Path(file).stem for file in files} == {"speeds"}
