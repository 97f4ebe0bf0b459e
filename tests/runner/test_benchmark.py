"""The benchmark: tasks and their files, cells that are run once, and ranks from the logbook."""

from pathlib import Path

import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.runner.commands import benchmark
from seatrial.runner.compare.benchmark.boards import boards
from seatrial.runner.compare.benchmark.task import GROUP, cells, lacking, located, task_of
from seatrial.runner.compare.frame import open_results
from seatrial.runner.compare.leaderboard import grids
from seatrial.runner.configuration import search_path
from tests.trials import composed

TASKS = search_path.options(GROUP)
SMALL = """
title: Surge under a multisine
trial: [vessel=surge_linear, excitation=multisine, plant.scale=0.8, evaluation=none]
cases:
  calm: {options: [disturbance=calm], seeds: 1}
  noise: {options: [disturbance=noise]}
outputs: [surge]
horizons_s: [1]
seeds: 2
entrants:
  none: [identifier=none]
  ls: [identifier=ls]
"""


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_tasks_are_whole_and_test_on_nothing_that_they_train_on() -> None:
    for name in TASKS:
        task = task_of(name)
        for case in task.cases.values():
            assert not set(case.train) & set(case.test), name


@pytest.mark.parametrize("measured", [False, pytest.param(True, marks=pytest.mark.data)])
def test_the_cells_of_tasks_compose(measured: bool) -> None:
    """One of each entrant: its options first meet in a task whose files are here."""
    seen: set[tuple[str, ...]] = set()
    for name in TASKS:
        task = task_of(name)
        if bool(task.files) == measured:
            assert {file.state for file in located(task)} <= {"found"}
            for label, options in task.entrants.items():
                if options not in seen or not seen:
                    seen.add(options)
                    cell = next(cells(task, [label]))
                    assert composed(*cell.options).seed == 0
    assert seen


def small(folder: Path, text: str = SMALL) -> None:
    (folder / "conf" / "benchmark").mkdir(parents=True)
    (folder / "conf" / "benchmark" / "small.yaml").write_text(text)


@pytest.mark.slow
def test_an_entrant_that_cannot_take_part_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
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
    monkeypatch.setenv("SEATRIAL_DATA", str(tmp_path))
    small(tmp_path, FILES)
    (tmp_path / "a.csv").write_text("abc")
    task = task_of("small")
    files = located(task)
    assert [*lacking(task, files)] == ["one"]
    assert [file.state for file in files] == ["found", "missing"]
    assert {cell.case for cell in cells(task, ["ls"])} == {"two"}
    (tmp_path / "b.csv").write_text("abd")
    assert [file.state for file in located(task)] == ["found", "damaged"]


def test_a_folder_is_the_files_that_are_listed_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SEATRIAL_DATA", str(tmp_path))
    text = FILES.replace("train: [a.csv]}", "train: [run]}").replace("  b.csv: ", "  run/b.csv: ")
    small(tmp_path, text.replace("test: [b.csv]", "test: [run]"))
    (tmp_path / "run").mkdir()
    (tmp_path / "a.csv").write_text("abc")
    task = task_of("small")
    absent = lacking(task, located(task)).values()
    assert [file.name for files in absent for file in files] == ["run/b.csv", "run/b.csv"]
    (tmp_path / "run" / "b.csv").write_text("abc")
    (cell, _) = cells(task, ["ls"])
    assert f'excitation.test=["{tmp_path / "run"}"]' in cell.options


@pytest.mark.nightly
def test_an_entrant_may_bring_its_own_vessel(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A third party adds a YAML and an option: only its cells run, and the table has them."""
    small(tmp_path)
    words = ["--task", "small", "--launcher", "basic"]
    assert benchmark.main(words) == 0
    own = "  own: [vessel=surge_nonlinear, identifier=ls]\n"
    (tmp_path / "conf" / "benchmark" / "small.yaml").write_text(SMALL + own)
    capsys.readouterr()
    assert benchmark.main(words) == 0
    said = capsys.readouterr().out
    assert said.count("3 already in the logbook") == 2
    assert "small, own: sweep 5, 3 runs: 3 finished" in said
    with open_results("sqlite:///results/benchmark/results.db") as results:
        (grid,) = grids(boards(results, ["small"]))
    assert "own" in {row[0].text for row in grid.rows}


def test_a_task_that_is_none_is_one_line(tmp_path: Path) -> None:
    small(tmp_path)
    for old, new, message in (
        ("outputs: [surge]", "outputs: [u]", r"outputs: got 'u', expected some of surge"),
        ("  b.csv: ", "  c.csv: ", r"cases\.one: b\.csv has no SHA-256"),
        ("title: Files", "titel: Files", r"benchmark/small"),
        ("title: Files", "- x", r"small\.yaml"),
    ):
        (tmp_path / "conf" / "benchmark" / "small.yaml").write_text(FILES.replace(old, new))
        with pytest.raises(ConfigurationError, match=message) as error:
            task_of("small")
        assert "\n" not in str(error.value)
