"""Examined recordings: maps and reports from the command line, clock offsets, and refusals."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from seatrial.models.recording.diagnosis import examine
from seatrial.models.recording.recorded_file import RecordedFile
from seatrial.models.recording.recording import Recording
from seatrial.models.recording.sampling import sampling
from seatrial.runner.commands import data_commands
from seatrial.runner.commands.recording_report import _advice
from seatrial.runner.configuration.recording_map import options_of, reader_of
from tests.data import DATA
from tests.runner.command import Command

PLANAR = ("surge", "sway", "yaw")
MAPS: dict[str, dict[str, object]] = {
    "esso": {
        "time": "t", "resample_hz": 10,
        "position": {"surge": "x_position_mid", "sway": "y_position_mid", "yaw": "psi_hat"},
        "velocity": {"surge": "u_velo", "sway": "vm_velo", "yaw": "r_angvelo"},
        "inputs": {"delta": "delta_rudder", "n": "n_prop"},
    },
    "blueboat": {
        "time": {"column": "original_timestamp", "unit": "ms"}, "resample_hz": 10,
        "position": {"surge": "x_ned", "sway": "y_ned", "yaw": {"column": "yaw", "unit": "deg"}},
        "velocity": {"surge": "surge", "sway": "sway", "yaw": "yaw_rate"},
        "inputs": {"left": "left_force", "right": "right_force"},
    },
    "kvlcc2/hsva": {
        "time": "c1", "frames": {"velocity": "earth"},
        "position": {"surge": "c2", "sway": "c3", "yaw": {"column": "c4", "unit": "deg"}},
        "velocity": {"surge": "c5", "sway": "c6", "yaw": {"column": "c7", "unit": "deg/s"}},
        "inputs": {"delta": {"column": "-c9", "unit": "deg"}, "n": "c10"},
    },
}  # fmt: skip


def mapped(file: Path, columns: dict[str, object]) -> RecordedFile:
    return reader_of(file, options_of(dict(columns)))


@pytest.mark.data
@pytest.mark.parametrize("name", MAPS)
def test_recordings_with_the_right_map_have_no_problem_of_units_or_frames(name: str) -> None:
    """Delays are real: the velocities of some runs of the Esso Osaka are 0.2 to 0.8 s behind."""
    files = sorted((DATA / name).rglob("*.csv")) or sorted((DATA / name).glob("*.dat"))
    assert files
    for file in files[::6]:
        known = examine(mapped(file, MAPS[name]), PLANAR)
        assert known is not None
        assert not known.result.untrusted
        assert {problem.kind for problem in known.problems} <= {"clock"}, file


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize("name", ["nlp1", "qp1"])
def test_a_folder_of_topics_is_mapped_and_examined(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, out = DATA / "milliampere" / name, tmp_path / "map.yaml"
    assert data_commands.main(["map", str(folder), "--out", str(out)]) == 0
    text = out.read_text()
    assert len(text.splitlines()) <= 15
    node = yaml.safe_load(text)
    if name == "nlp1":  # it turns far enough to tell: the estimate's velocities are along the earth
        assert node["frames"] == {"velocity": "earth"}
    else:  # the twist is behind the pose of the same message, by stamps that are whole
        assert node["delay_s"]["velocity"] == pytest.approx(0.35, abs=0.05)
    html = tmp_path / "page.html"
    words = ["check", str(folder), "--map", str(out), "--html", str(html)]
    assert data_commands.main(words) == 0
    shown = capsys.readouterr().out
    assert "no problem" in shown
    assert "vectorVS330/heading" in shown
    if name == "nlp1":
        assert "navigation/nav_estimate: 442 rows in 490 s, 0.937 Hz, 15 gaps" in shown
    assert "<svg" in html.read_text()


def test_a_source_whose_ordinary_steps_count_as_gaps() -> None:
    """A tenth of 100 s at 0.9 Hz is left: the option that keeps the rest is named."""
    t = np.concatenate([10.0 * k + 0.1 * np.arange(10) for k in range(11)])
    zero = np.zeros((len(t), 1))
    recording = Recording(("surge",), t, zero, zero, zero, zero, np.zeros((len(t), 3)))
    slow = sampling(np.arange(0.0, 101.0, 1.0 / 0.9))
    advice = list(_advice({"fix": sampling(np.arange(0.0, 101.0, 0.1)), "pose": slow}, recording))
    assert advice[0] == (
        "11 of 101 s are kept, the rest is in gaps: excitation.max_gap_s=2.8 bridges the steps of "
        "pose"
    )
    even = replace(recording, t=0.1 * np.arange(len(t)))
    assert not any("max_gap_s" in line for line in _advice({"pose": slow}, even))


BELUGA = ("vessel=beluga_diagonal", "excitation=recording", "identifier=none")


@pytest.mark.slow
@pytest.mark.data
def test_a_recording_that_agrees_with_nothing_is_refused_unless_trusted(seatrial: Command) -> None:
    table = pd.read_csv(DATA / "beluga" / "sway-1.csv")
    path = seatrial.folder / "other.csv"
    other = np.roll(table["yaw_vel"].to_numpy(), len(table) // 2)
    table.assign(yaw_vel=other).to_csv(path, index=False)
    answer = seatrial(*BELUGA, f"excitation.path={path}")
    assert answer.code == 2
    assert len(answer.err.strip().splitlines()) == 1
    assert "yaw: got a correlation of" in answer.err
    assert "excitation.trust=true overrides" in answer.err
    answer = seatrial(*BELUGA, f"excitation.path={path}", "excitation.trust=true")
    assert answer.code == 0, answer


@pytest.mark.data
def test_a_trial_warns_of_knots_in_one_line(seatrial: Command) -> None:
    table = pd.read_csv(DATA / "beluga" / "sway-1.csv")
    path = seatrial.folder / "knots.csv"
    table.assign(surge_vel=table["surge_vel"] * 3600.0 / 1852.0).to_csv(path, index=False)
    answer = seatrial(*BELUGA, f"excitation.path={path}")
    assert answer.code == 0, answer
    lines = [line for line in (answer.out + answer.err).splitlines() if "recording:" in line]
    assert len(lines) == 1
    assert "excitation.columns.velocity.surge: {column: surge_vel, unit: knot}" in lines[0]
