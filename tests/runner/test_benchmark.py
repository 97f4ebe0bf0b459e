"""The benchmark: tasks and their files, cells that are run once, and ranks from the logbook."""

import json
import os
from pathlib import Path

import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.runner import benchmark, search_path
from seatrial.runner import trial as trials
from seatrial.runner.compare import leaderboard
from seatrial.runner.compare.benchmark.cells import cells, entrants_of, lacking
from seatrial.runner.compare.benchmark.task import GROUP, located, task_of
from tests.trials import composed

TASKS = search_path.options(GROUP)
DATA = os.environ.get("SEATRIAL_DATA")
SMALL = """
title: Surge under a multisine
trial: [vessel=surge_linear, excitation=multisine, plant.scale=0.8, evaluation=none]
cases:
  calm: {options: [disturbance=calm], seeds: 1}
  noise: {options: [disturbance=noise]}
outputs: [surge]
horizons_s: [1]
seeds: 12
entrants:
  none: [identifier=none]
  ls: [identifier=ls]
"""


def data(name: str) -> Path:
    path = Path(DATA or "") / name
    if not DATA or not path.exists():
        pytest.skip(f"there is no {path}: no outside data")
    return path


@pytest.mark.parametrize("name", TASKS)
def test_a_task_is_whole_and_its_cells_compose(name: str) -> None:
    task = task_of(name)
    for file in task.files:
        data(file)
    assert {file.state for file in located(task)} <= {"found"}
    for label in entrants_of(task):
        cell = next(cells(name, task, entrants_of(task, [label])))
        assert composed(*cell.options).seed == 0


@pytest.mark.parametrize("name", TASKS)
def test_nothing_is_tested_on_that_was_trained_on(name: str) -> None:
    for case in task_of(name).cases.values():
        assert not set(case.train) & set(case.test)


def small(folder: Path, text: str = SMALL) -> None:
    (folder / "conf" / "benchmark").mkdir(parents=True)
    (folder / "conf" / "benchmark" / "small.yaml").write_text(text)


def test_cells_are_run_once_and_ranked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    small(tmp_path)
    words = ["--task", "small", "--launcher", "basic"]
    assert benchmark.main(words) == 0
    assert "small, ls: sweep 2, 13 runs: 13 finished" in capsys.readouterr().out
    assert benchmark.main(words) == 0
    assert "13 already in the logbook" in capsys.readouterr().out
    (grid,) = leaderboard.leaderboards("sqlite:///results/benchmark/results.db", ["small"])
    rows = {row[0].text: row for row in grid.rows}
    assert list(rows) == ["ls", "none", *list(rows)[2:]]
    assert {"mean_motion", "persistence"} == set(list(rows)[2:])
    assert float(rows["ls"][1].text) == 1.0
    assert rows["ls"][0].bold
    assert not rows["none"][0].bold
    assert float(rows["mean_motion"][2].text) == pytest.approx(0.0, abs=1e-9)


def test_an_entrant_that_cannot_take_part_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    small(tmp_path)
    words = ["--task", "small", "--entrant", "linearised_twice", "--launcher", "basic"]
    assert benchmark.main(words) == 1
    assert "small, linearised_twice: cannot take part: " in capsys.readouterr().out


FILES = """
title: Files
source: {name: a, url: b, licence: c, get: copy it}
trial: [vessel=surge_linear]
cases:
  one: {train: [a.csv], test: [b.csv]}
  two: {train: [a.csv]}
outputs: [surge]
files:
  a.csv: ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad
  b.csv: ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad
"""


def test_missing_and_damaged_files_are_named_and_their_cases_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SEATRIAL_DATA", str(tmp_path))
    small(tmp_path, FILES)
    (tmp_path / "a.csv").write_text("abc")
    task = task_of("small")
    assert [lack.case for lack in lacking(task)] == ["one"]
    assert [file.state for file in located(task)] == ["found", "missing"]
    assert {cell.case for cell in cells("small", task, {"ls": ("identifier=ls",)})} == {"two"}
    (tmp_path / "b.csv").write_text("abd")
    assert [file.state for file in located(task)] == ["found", "damaged"]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("outputs: [surge]", "outputs: [u]", r"outputs: got 'u', expected some of surge"),
        ("  b.csv: ", "  c.csv: ", r"cases\.one: b\.csv has no SHA-256"),
        ("title: Files", "titel: Files", r"benchmark/small"),
        ("title: Files", "- x", r"small\.yaml"),
    ],
)
def test_a_task_that_is_none_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, old: str, new: str, message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    small(tmp_path, FILES.replace(old, new))
    with pytest.raises(ConfigurationError, match=message) as error:
        task_of("small")
    assert "\n" not in str(error.value)


@pytest.mark.slow
def test_what_is_identified_does_not_depend_on_the_files_that_are_tested_on() -> None:
    """Selection uses training files alone: other test files, the same coefficients."""
    train = json.dumps([str(data("beluga/surge-1.csv")), str(data("beluga/sway-1.csv"))])
    thetas = []
    for test in ("random-1", "heave-1"):
        options = ("vessel=beluga_linear", "excitation=recording", "identifier=auto")
        trial = composed(
            *options, "evaluation=none", "controller=none", f"excitation.train={train}",
            f"excitation.test={json.dumps([str(data(f'beluga/{test}.csv'))])}",
        )  # fmt: skip
        rows = trials.run(trial).coefficients
        thetas.append({(r.dof, r.term): r.value for r in rows if r.model == "identified"})
    assert thetas[0] == thetas[1]
