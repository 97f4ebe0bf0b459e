"""Examined recordings: maps of the guide, reports from the command line, and refusals."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml

from seatrial.models.errors import ConfigurationError
from seatrial.models.recording.column_map import Column, ColumnMap
from seatrial.models.recording.diagnosis import examine
from seatrial.models.recording.recorded_file import RecordedFile
from seatrial.models.recording.source import ReadOptions, read_sources
from seatrial.runner.configuration.named_files import options_of, reader_of
from tests.data import DATA
from tests.runner.command import Command
from tests.runner.compare.conftest import Program
from tests.runner.compare.conftest import program as program
from tests.runner.conftest import Data
from tests.runner.programs import rows

PLANAR = ("surge", "sway", "yaw")
PAGE = (Path(__file__).parents[2] / "docs" / "howto" / "recordings.md").read_text("utf-8")
MAPS = dict(re.findall(r"```yaml\n# (\w+)\.yaml\n(.*?)```", PAGE, re.S))
FILES = {
    "esso": "esso/zigzag/zigzag_31-Jul-2020_13_42_53.csv",
    "blueboat": "blueboat/fixed_00000220.csv",
    "hsva": "kvlcc2/hsva/HSVA_CPMC_KVLCC2_Z_20_05.dat",
    "marin": "kvlcc2/marin/MARIN_FREE_KVLCC2_zz_10_m.dat",
    "milliampere": "milliampere/qp1",
}


def test_every_map_of_the_guide_has_a_file() -> None:
    assert set(MAPS) == set(FILES)
    assert all(len(text.splitlines()) <= 15 for text in MAPS.values())


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.parametrize("name", FILES)
def test_a_map_of_the_guide_has_no_problem(name: str, tmp_path: Path, data: Data) -> None:
    (tmp_path / "map.yaml").write_text(MAPS[name])
    shown = data("check", DATA / FILES[name], "--map", tmp_path / "map.yaml").out
    assert "no problem: pose and velocity are consistent" in shown


@pytest.mark.data
@pytest.mark.parametrize("name", ["esso", "blueboat", "hsva"])
def test_recordings_with_the_right_map_have_no_problem_of_units_or_frames(name: str) -> None:
    """Delays are real: the velocities of some runs of the Esso Osaka are 0.2 to 0.8 s behind."""
    folder = DATA / ("kvlcc2/hsva" if name == "hsva" else name)
    files = sorted(folder.rglob("*.csv")) or sorted(folder.glob("*.dat"))
    assert files
    for file in files[::6]:
        known = examine(reader_of(file, options_of(yaml.safe_load(MAPS[name]))), PLANAR)
        assert known is not None
        assert not known.result.untrusted
        assert {problem.kind for problem in known.problems} <= {"clock"}, file


def test_an_input_is_zero_at_neutral_and_one_at_full(tmp_path: Path) -> None:
    """A pulse of 1511 us is no thrust, 1900 us all of it, 1122 us all of it astern."""
    path = tmp_path / "log.csv"
    path.write_text("t,x,y,psi,pwm\n0.0,0,0,0,1511\n0.1,0,0,0,1900\n0.2,0,0,0,1122\n")
    spec = Column("pwm", neutral=1511.0, full=1900.0)
    reading = RecordedFile(path="log.csv", columns=ColumnMap("t", inputs={"pwm_1": spec}))
    values = reading.signals(path, read_sources(path, ReadOptions()), ()).values["inputs.pwm_1"]
    np.testing.assert_allclose(values, [0.0, 1.0, -1.0])
    with pytest.raises(ConfigurationError, match="expected a name, and two numbers"):
        ColumnMap("t", inputs={"pwm_1": Column("pwm", neutral=1900.0, full=1900.0)})


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize("name", ["nlp1", "qp1"])
def test_a_folder_of_topics_is_mapped_and_examined(name: str, tmp_path: Path, data: Data) -> None:
    folder, out = DATA / "milliampere" / name, tmp_path / "map.yaml"
    data("map", folder, "--out", out)
    text = out.read_text()
    assert len(text.splitlines()) <= 15
    node = yaml.safe_load(text)
    if name == "nlp1":  # it turns far enough to tell: the estimate's velocities are along the earth
        assert node["frames"] == {"velocity": "earth"}
    else:  # the twist is behind the pose of the same message, by stamps that are whole
        assert node["delay_s"]["velocity"] == pytest.approx(0.35, abs=0.05)
    html = tmp_path / "page.html"
    shown = data("check", folder, "--map", out, "--html", html).out
    assert "no problem" in shown
    assert "vectorVS330/heading" in shown
    if name == "nlp1":
        assert "navigation/nav_estimate: 15 gaps" in shown
    assert "<svg" in html.read_text()


BELUGA = ("vessel=beluga_diagonal", "excitation=recording", "identifier=none")


@pytest.mark.slow
@pytest.mark.data
def test_a_recording_that_agrees_with_nothing_is_refused_unless_trusted(seatrial: Command) -> None:
    table = pd.read_csv(DATA / "beluga" / "sway-1.csv")
    path = seatrial.folder / "other.csv"
    other = np.roll(table["yaw_vel"].to_numpy(), len(table) // 2)
    table.assign(yaw_vel=other).to_csv(path, index=False)
    said = seatrial.refuses(*BELUGA, f"excitation.path={path}")
    assert "yaw: got a correlation of" in said
    assert "excitation.trust=true overrides" in said
    seatrial.succeeds(*BELUGA, f"excitation.path={path}", "excitation.trust=true")


@pytest.mark.data
def test_a_trial_warns_of_knots_in_one_line(seatrial: Command) -> None:
    table = pd.read_csv(DATA / "beluga" / "sway-1.csv")
    path = seatrial.folder / "knots.csv"
    table.assign(surge_vel=table["surge_vel"] * 3600.0 / 1852.0).to_csv(path, index=False)
    answer = seatrial.succeeds(*BELUGA, f"excitation.path={path}")
    lines = [line for line in (answer.out + answer.err).splitlines() if "recording:" in line]
    assert len(lines) == 1
    assert "excitation.columns.velocity.surge: {column: surge_vel, unit: knot}" in lines[0]


@pytest.mark.data
def test_beluga_on_several_runs(seatrial: Command, program: Program) -> None:
    """The pooled mean square is that of the files, weighed by their samples; a table shows each."""
    folder = DATA / "beluga"
    seatrial.succeeds(
        "vessel=beluga_diagonal", "excitation=recording", "identifier=ls",
        f"excitation.train=[{folder}/surge-1.csv,{folder}/sway-1.csv]",
        f"excitation.test=[{folder}/heave-1.csv,{folder}/ran*-1.csv]", "excitation.initial_s=5",
    )  # fmt: skip
    query = "select name, dof, value, i, j, label from diagnostic where name like 'file_%'"
    diagnostics: list[Any] = rows(seatrial.folder, query)
    query = "select dof, value from metric where name = 'force_mse' and model = 'identified'"
    pooled: list[Any] = rows(seatrial.folder, query)
    seconds = {row[5]: row[2] for row in diagnostics if row[0] == "file_duration"}
    assert list(seconds) == ["heave-1.csv", "random-1.csv"]
    assert seconds["random-1.csv"] == pytest.approx(300.0 - 5.0, abs=0.2)
    samples = np.array(list(seconds.values())) / 0.1 + 1.0
    for dof, value in pooled:
        parts = [r[2] for r in diagnostics if (r[0], r[1], r[4]) == ("file_force_mse", dof, 1)]
        assert value == pytest.approx(np.average(parts, weights=samples), rel=1e-9)
    words = ("--metric", "force_mse", "--rows", "file", "--columns", "none", "--format", "json")
    code, out, _ = program("table", *words)
    assert code == 0
    shown = {(row["file"], row["dof"]): row["mean"] for row in json.loads(out)}
    each = {(r[5].partition(", ")[0], r[1]): r[2] for r in diagnostics
            if r[0] == "file_force_mse" and r[4] == 1}  # fmt: skip
    assert shown == each | {("pooled", dof): value for dof, value in pooled}
    code, _, error = program("table", "--metric", "force_mae", "--rows", "file")
    assert code == 2
    assert "no run has force_mae by file, expected one of force_mse," in error
    free = {
        (r[3], r[1]) for r in diagnostics if r[0] == "file_velocity_rmse_free_run" and r[4] == 1
    }
    assert {number for number, _ in free} == {0, 1}
