"""Where results come from, and commands that repeat them as the user has the programs."""

import subprocess
import sys
from pathlib import Path

import pytest

from seatrial.runner.compare.runs import repeat_command
from seatrial.runner.configuration import fingerprint, invocation
from seatrial.runner.configuration.invocation import DEFAULT_DATABASE
from seatrial.runner.database import engine
from seatrial.runner.sweeps.console import compare


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of the project, of which nothing is known yet."""
    fingerprint.collect.cache_clear()
    (tmp_path / "pyproject.toml").touch()
    monkeypatch.setattr(fingerprint, "ROOT", tmp_path)
    command = [str(tmp_path) if word == str(invocation.ROOT) else word for word in fingerprint.GIT]
    monkeypatch.setattr(fingerprint, "GIT", command)
    return tmp_path


def git(folder: Path, *arguments: str) -> None:
    identity = ["-c", "user.name=A", "-c", "user.email=a@b.c"]
    subprocess.run(["git", "-C", str(folder), *identity, *arguments], check=True)


def test_the_commit_and_whether_it_was_changed(checkout: Path) -> None:
    git(checkout, "init", "-q")
    (checkout / "a.txt").write_text("a")
    git(checkout, "add", "a.txt")
    git(checkout, "commit", "-q", "-m", "Begin")
    first = fingerprint.collect()
    assert first.git_commit is not None
    assert len(first.git_commit) == 40
    assert first.git_dirty is False
    (checkout / "a.txt").write_text("b")
    assert fingerprint.collect() is first
    fingerprint.collect.cache_clear()
    assert fingerprint.collect().git_dirty is True


def test_the_repository_around_an_installed_package_is_not_ours(checkout: Path) -> None:
    git(checkout, "init", "-q")
    git(checkout, "commit", "-q", "--allow-empty", "-m", "Begin another project")
    (checkout / "pyproject.toml").unlink()
    assert fingerprint.collect().git_commit is None
    assert fingerprint.collect().git_dirty is None


def test_without_git(checkout: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(checkout.parent))
    assert fingerprint.collect().git_commit is None
    assert fingerprint.collect().git_dirty is None
    fingerprint.collect.cache_clear()
    monkeypatch.setenv("PATH", "")
    assert fingerprint.collect().git_commit is None


SCRIPT = "/home/somebody/.venv/bin/seatrial"


@pytest.mark.parametrize(
    ("typed", "checkout", "trials", "results"),
    [
        (["python", "-m", "runner"], True, "python -m runner", "python -m runner.compare"),
        (["python", SCRIPT], True, "seatrial", "seatrial-results"),
        (["python", f"{SCRIPT}-results", "retry"], True, "seatrial", "seatrial-results"),
        (["python", "-m", "seatrial.runner"], False, "seatrial", "seatrial-results"),
        (["python", SCRIPT, "-m"], False, "seatrial", "seatrial-results"),
    ],
)
def test_the_programs_are_named_as_they_were_started(
    typed: list[str], checkout: bool, trials: str, results: str,
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    if not checkout:
        monkeypatch.setattr(invocation, "in_checkout", lambda: False)
    monkeypatch.setattr(sys, "orig_argv", typed)
    monkeypatch.chdir(tmp_path)
    address = engine.parse(f"sqlite:///{tmp_path}/results/results.db")
    again = repeat_command(["seed=1"], address, rerun=True)
    assert again == f"{trials} seed=1 rerun=true"
    typed = f"{trials} -m --config-dir 'my options' seed=1,2"
    again = repeat_command(["seed=1"], address, rerun=False, typed=typed)
    assert again == f"{trials} --config-dir 'my options' seed=1"
    assert compare("show", DEFAULT_DATABASE, "1") == f"{results} show 1"


def test_a_typed_command_is_kept_without_the_place_of_the_script() -> None:
    typed = ["/usr/bin/python", SCRIPT, "-m", "seed=range(0,2)"]
    assert invocation.typed_command(typed) == "seatrial -m 'seed=range(0,2)'"
    typed = ["python", "-m", "runner", "-m", "seed=1,2"]
    assert invocation.typed_command(typed) == "python -m runner -m seed=1,2"


def test_a_checkout_is_known_by_its_project_file(tmp_path: Path) -> None:
    assert invocation.in_checkout()
    assert not invocation.in_checkout(tmp_path)
