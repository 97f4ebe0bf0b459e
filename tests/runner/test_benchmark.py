"""The benchmark: tasks and their files, cells that are run once; nothing is tuned on test files."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError, IdentificationError
from seatrial.models.identification.problem import Problem
from seatrial.models.vessel.table import Vessel
from seatrial.runner.commands import benchmark
from seatrial.runner.compare.benchmark import GROUP, cells, located, task_of
from seatrial.runner.compare.frame import open_results
from seatrial.runner.compare.leaderboard import boards, leaderboard
from seatrial.runner.configuration import search_path
from seatrial.runner.configuration.config import Trial
from seatrial.runner.trials.closed_loop import ExcitationData, Streams
from seatrial.runner.trials.trial import excite, identify
from tests.trials import composed

pytestmark = pytest.mark.usefixtures("own_folder")
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


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of outside data with one of the two files."""
    monkeypatch.setenv("SEATRIAL_DATA", str(tmp_path))
    (tmp_path / "a.csv").write_text("abc")
    return tmp_path


def test_missing_and_damaged_files_are_named_and_their_cases_left_out(files: Path) -> None:
    small(files, FILES)
    task = task_of("small")
    found = located(task)
    assert [file.state for file in found] == ["found", "missing"]
    lacking = {cell.case: [file.name for file in cell.lacking] for cell in cells(task, ["ls"])}
    assert lacking == {"one": ["b.csv"], "two": []}
    (files / "b.csv").write_text("abd")
    assert [file.state for file in located(task)] == ["found", "damaged"]


def test_a_folder_is_the_files_that_are_listed_of_it(files: Path) -> None:
    text = FILES.replace("train: [a.csv]}", "train: [run]}").replace("  b.csv: ", "  run/b.csv: ")
    small(files, text.replace("test: [b.csv]", "test: [run]"))
    (files / "run").mkdir()
    task = task_of("small")
    absent = [file.name for cell in cells(task, ["ls"]) for file in cell.lacking]
    assert absent == ["run/b.csv", "run/b.csv"]
    (files / "run" / "b.csv").write_text("abc")
    (cell, _) = cells(task, ["ls"])
    assert f'excitation.test=["{files / "run"}"]' in cell.options


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
        grid = leaderboard(*boards(results, ["small"]))
    assert "own" in {row[0].text for row in grid.rows}


def test_a_task_that_is_none_is_one_line(tmp_path: Path) -> None:
    small(tmp_path)
    for old, new, message in (
        ("outputs: [surge]", "outputs: [u]", r"outputs\[0\]: got 'u', expected one of surge"),
        ("  b.csv: ", "  c.csv: ", r"cases\.one: b\.csv has no SHA-256"),
        ("title: Files", "titel: Files", r"benchmark/small"),
        ("title: Files", "- x", r"small\.yaml"),
    ):
        (tmp_path / "conf" / "benchmark" / "small.yaml").write_text(FILES.replace(old, new))
        with pytest.raises(ConfigurationError, match=message) as error:
            task_of("small")
        assert "\n" not in str(error.value)


# An entrant finds the same model whatever is tested on: each of a task, on the first seconds of
# its training data, with the test data permuted, scaled and shortened.
LEAST, SECONDS = 300, 60.0  # samples, and time, of the training data that are used
TASK = "blueboat"  # the quickest one


def excited() -> ExcitationData:
    """The recording of the task's first case whose files are there; else the test skips."""
    first = next(cells(task_of(TASK), ["none"]))
    if first.lacking:
        pytest.skip(f"the files of {TASK} are not there: needs SEATRIAL_DATA=FOLDER with them")
    trial = composed(*first.options)
    return excite(trial, Streams(trial.seed))


def problems(trial: Trial, data: ExcitationData) -> list[Problem]:
    """The same training data with different test data."""
    period = float(np.median(np.diff(data.recording.t)))
    first = np.cumsum(data.training) <= max(LEAST, int(SECONDS / period))
    training = data.recording.part(data.training & first)
    testing = data.recording.part(data.testing)
    backward = replace(testing, nu=3.0 * testing.nu[::-1], eta=testing.eta[::-1])
    other = testing.part(slice(0, len(testing.t) // 2))
    return [
        Problem(training, held_out, trial.vessel.nominal(), trial.vessel.thruster)
        for held_out in (testing, backward, other)
    ]


def found(trial: Trial, problem: Problem) -> tuple[str, np.ndarray]:
    """The model that is identified: its terms, coefficients and parameters of devices."""
    try:
        model: Vessel = identify(trial, problem, Streams(trial.seed)).model
    except IdentificationError as error:
        return str(error), np.zeros(0)
    terms = ", ".join(term.name for term in model.terms)
    return terms, np.concatenate([model.theta.ravel(), model.installed.parameters])


@pytest.mark.nightly
@pytest.mark.timeout(1800)
def test_the_model_does_not_depend_on_what_is_tested_on(subtests: pytest.Subtests) -> None:
    data, known = excited(), task_of(TASK)
    for entrant in known.entrants:
        with subtests.test(entrant):
            trial = composed(*next(cells(known, [entrant])).options)
            results = [found(trial, problem) for problem in problems(trial, data)]
            for terms, values in results[1:]:
                assert terms == results[0][0]
                np.testing.assert_array_equal(values, results[0][1])


def test_the_law_sees_an_entrant_that_looks_at_the_test_data() -> None:
    """Jervan's choice of the order by the test data, which no task has."""
    options = (
        "vessel=milliampere", "excitation=waypoints", "excitation.interval_s=60",
        "disturbance=noise", "evaluation=none", "identifier=plsr", "identifier.selection=test",
        "identifier.bootstrap=null",
    )  # fmt: skip
    trial = composed(*options)
    results = [found(trial, one) for one in problems(trial, excite(trial, Streams(trial.seed)))]
    assert any(not np.array_equal(values, results[0][1]) for _, values in results[1:])
