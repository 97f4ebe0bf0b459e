"""Configurations of the user's: files that are no YAML, and the folders that are searched."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from seatrial.runner.configuration import plugins
from tests.runner.command import Command

REFUSED = {
    "open": ("a: [1, 2\n", "line 2: expected ',' or ']'"),
    "twice": ("a: 1\nb: 2\na: 3\n", "line 3: found duplicate key a, expected YAML"),
    "inside": ("a: {b: 1, b: 2}\n", "line 1: found duplicate key b, expected YAML"),
    "object": ("a: !!python/object:os.system x\n", "line 1: could not determine a constructor"),
    "list": ("- a\n- b\n", "list.yaml: got a list, expected options"),
    "loop": ("a: &a [*a]\n", "maximum recursion depth exceeded"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_file_that_is_no_yaml(
    name: str, seatrial: Command, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """In one line, also inside a sweep."""
    text, message = REFUSED[name]
    folder = tmp_path_factory.mktemp("conf")
    (folder / "vessel").mkdir()
    (folder / "vessel" / f"{name}.yaml").write_text(text)
    for mode in ([], ["-m"]):
        said = seatrial.refuses("--config-dir", str(folder), *mode, f"vessel={name}")
        assert f"{name}.yaml" in said
        assert message in said


IDENTIFIER = "_target_: seatrial.models.identification.problem.NoIdentifier\n"
CALM = "_target_: seatrial.models.weather.disturbance.Disturbance\n"
OTHER = "_target_: seatrial.models.identification.least_squares.LeastSquares\n"


def option(folder: Path, name: str, text: str = IDENTIFIER) -> Path:
    """A folder of configurations with one option more."""
    path = folder / f"{name}.yaml"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return folder


def package(folder: Path, name: str, text: str = "") -> Path:
    """A package with a folder of configurations, installed in `folder`."""
    (folder / name).mkdir(parents=True)
    (folder / name / "__init__.py").write_text(text)
    about = folder / f"{name}-1.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1\n")
    (about / "entry_points.txt").write_text(f"[seatrial.plugins]\n{name} = {name}\n")
    return folder / name / "conf"


@pytest.fixture(autouse=True)
def _no_plugins_of_before() -> Iterator[None]:
    plugins._plugins.cache_clear()
    yield
    plugins._plugins.cache_clear()


@pytest.fixture
def four(seatrial: Command, monkeypatch: pytest.MonkeyPatch) -> Command:
    """A working folder with an option from each of the four places."""
    folder = seatrial.folder
    option(folder / "conf", "identifier/here")
    named = [option(folder / f"named{i}", f"identifier/from_named{i}") for i in (1, 2)]
    option(folder / "given", "disturbance/given", CALM)
    option(package(folder / "installed", "fleet_of_tests"), "identifier/packed")
    monkeypatch.setenv("SEATRIAL_CONF", os.pathsep.join(map(str, named)))
    monkeypatch.syspath_prepend(folder / "installed")
    return seatrial


def test_a_sweep_takes_options_from_every_folder(four: Command) -> None:
    four.pretend()
    names = ("from_named1", "from_named2", "here", "packed")
    sweep = ("-m", "--config-dir", "given", "disturbance=given", f"identifier={','.join(names)}")
    answer = four(*sweep, "dry_run=true")
    assert answer.out.count("new ") == 4, answer.err
    answer = four.succeeds(*sweep)
    assert "4 runs: 4 finished" in answer.out
    four.succeeds("identifier=here", "disturbance=calm")


def test_the_projects_option_wins_and_the_other_is_named_once(seatrial: Command) -> None:
    option(seatrial.folder / "conf", "identifier/ls", IDENTIFIER)
    answer = seatrial("identifier=ls", "--cfg", "job")
    assert "problem.NoIdentifier" not in answer.out
    seatrial.pretend()
    answer = seatrial("-m", "identifier=ls", "seed=0,1")
    assert "2 runs: 2 finished" in answer.out
    assert answer.err.count("not used") == 1
    assert answer.err.startswith("seatrial: conf/identifier/ls.yaml is not used")


def test_of_two_folders_of_the_user_the_first_wins(
    seatrial: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    option(seatrial.folder / "conf", "identifier/twice", IDENTIFIER)
    option(seatrial.folder / "named", "identifier/twice", OTHER)
    monkeypatch.setenv("SEATRIAL_CONF", "named")
    answer = seatrial("identifier=twice", "--cfg", "job")
    assert "least_squares.LeastSquares" in answer.out
    assert answer.err.startswith("seatrial: conf/identifier/twice.yaml is not used")
    answer = seatrial("--config-dir", "conf", "identifier=twice", "--cfg", "job")
    assert "problem.NoIdentifier" in answer.out
    assert answer.err.startswith("seatrial: named/identifier/twice.yaml is not used")


def test_a_folder_that_does_not_exist_is_refused(
    seatrial: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SEATRIAL_CONF", "nowhere")
    assert seatrial.refuses("seed=1") == "SEATRIAL_CONF: got nowhere, expected a folder"


def test_a_misspelt_option_of_the_users_is_suggested(seatrial: Command) -> None:
    option(seatrial.folder / "conf", "identifier/regatta", IDENTIFIER)
    answer = seatrial("identifier=regata")
    assert answer.code == 2
    assert "did you mean regatta?" in answer.err
