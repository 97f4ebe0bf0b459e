"""Where results come from is told without guessing, and costs next to nothing."""

import subprocess
from pathlib import Path

import pytest

from seatrial.runner.configuration import provenance


@pytest.fixture(autouse=True)
def _forget() -> None:
    provenance.collect.cache_clear()


def git(folder: Path, *arguments: str) -> None:
    identity = ["-c", "user.name=A", "-c", "user.email=a@b.c"]
    subprocess.run(["git", "-C", str(folder), *identity, *arguments], check=True)


def test_the_commit_and_whether_it_was_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(provenance, "ROOT", tmp_path)
    git(tmp_path, "init", "-q")
    (tmp_path / "pyproject.toml").touch()
    (tmp_path / "a.txt").write_text("a")
    git(tmp_path, "add", "a.txt")
    git(tmp_path, "commit", "-q", "-m", "Begin")
    first = provenance.collect()
    assert first.git_commit is not None
    assert len(first.git_commit) == 40
    assert first.git_dirty is False
    (tmp_path / "a.txt").write_text("b")
    assert provenance.collect() is first
    provenance.collect.cache_clear()
    assert provenance.collect().git_dirty is True


def test_the_repository_around_an_installed_package_is_not_ours(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = tmp_path / ".venv" / "lib" / "seatrial"
    package.mkdir(parents=True)
    git(tmp_path, "init", "-q")
    git(tmp_path, "commit", "-q", "--allow-empty", "-m", "Begin another project")
    assert provenance.ROOT.joinpath("pyproject.toml").is_file()
    monkeypatch.setattr(provenance, "ROOT", package)
    assert provenance.collect().git_commit is None
    assert provenance.collect().git_dirty is None


def test_without_git(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(provenance, "ROOT", tmp_path)
    (tmp_path / "pyproject.toml").touch()
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert provenance.collect().git_commit is None
    assert provenance.collect().git_dirty is None
    provenance.collect.cache_clear()
    monkeypatch.setenv("PATH", "")
    assert provenance.collect().git_commit is None
