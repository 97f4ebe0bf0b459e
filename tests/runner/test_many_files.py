"""Trials on several recordings, through the command line."""

import json
import sqlite3
from pathlib import Path

import numpy as np
import pytest

from seatrial.runner.__main__ import main
from seatrial.runner.compare.__main__ import run as compared
from tests.data import DATA


@pytest.mark.data
def test_beluga_on_several_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """The pooled mean square is that of the files, weighed by their samples; a table shows each."""
    folder = DATA / "beluga"
    monkeypatch.chdir(tmp_path)
    words = ["seatrial", "vessel=beluga_diagonal", "excitation=recording", "identifier=ls"]
    words += [f"excitation.train=[{folder}/surge-1.csv,{folder}/sway-1.csv]"]
    words += [f"excitation.test=[{folder}/heave-1.csv,{folder}/ran*-1.csv]"]
    monkeypatch.setattr("sys.argv", [*words, "excitation.initial_s=5"])
    assert main() == 0, capfd.readouterr().err
    with sqlite3.connect(tmp_path / "results" / "results.db") as database:
        diagnostics = database.execute(
            "select name, dof, value, i, j, label from diagnostic where name like 'file_%'"
        ).fetchall()
        pooled = database.execute(
            "select dof, value from metric where name = 'force_mse' and model = 'identified'"
        ).fetchall()
    seconds = {row[5]: row[2] for row in diagnostics if row[0] == "file_duration"}
    assert list(seconds) == ["heave-1.csv", "random-1.csv"]
    assert seconds["random-1.csv"] == pytest.approx(300.0 - 5.0, abs=0.2)
    samples = np.array(list(seconds.values())) / 0.1 + 1.0
    for dof, value in pooled:
        parts = [r[2] for r in diagnostics if (r[0], r[1], r[4]) == ("file_force_mse", dof, 1)]
        assert value == pytest.approx(np.average(parts, weights=samples), rel=1e-9)
    monkeypatch.setattr("sys.argv", ["seatrial-results"])
    capfd.readouterr()
    words = ["--metric", "force_mse", "--rows", "file", "--columns", "none", "--format", "json"]
    assert compared(["table", *words]) == 0
    shown = {(row["file"], row["dof"]): row["mean"] for row in json.loads(capfd.readouterr().out)}
    each = {(r[5].partition(", ")[0], r[1]): r[2] for r in diagnostics
            if r[0] == "file_force_mse" and r[4] == 1}  # fmt: skip
    assert shown == each | {("pooled", dof): value for dof, value in pooled}
    assert compared(["table", "--metric", "force_mae", "--rows", "file"]) == 2
    error = capfd.readouterr().err
    assert "no run has force_mae by file, expected one of force_mse," in error
    free = {
        (r[3], r[1]) for r in diagnostics if r[0] == "file_velocity_rmse_free_run" and r[4] == 1
    }
    assert {number for number, _ in free} == {0, 1}
