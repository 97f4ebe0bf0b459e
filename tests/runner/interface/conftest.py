"""A logbook that Python has filled: one trial, and a sweep of four."""

from contextlib import chdir
from pathlib import Path

import pytest

import seatrial as st


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The working folder in which the trials are started."""
    return tmp_path_factory.mktemp("python")


@pytest.fixture(scope="session")
def run(folder: Path) -> st.Run:
    """A trial with a deployment."""
    with chdir(folder):
        return st.run(identifier="ls", identifier__basis="physical", seed=3)


@pytest.fixture(scope="session")
def sweep(folder: Path, run: st.Run) -> st.Logbook:
    """Two identifiers and two seeds, in noise."""
    with chdir(folder):
        return st.sweep(
            ["identifier=none,ls"], disturbance="noise", evaluation="none", seed=range(2)
        )


@pytest.fixture
def here(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The same folder, as the working folder."""
    monkeypatch.chdir(folder)
    return folder
