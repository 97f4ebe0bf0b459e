"""Logbooks that the comparison's tests read; what is made once a session is only read."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from seatrial.runner.compare.__main__ import run as run_program
from seatrial.runner.compare.frame import Queries, open_results
from seatrial.runner.database import LogbookWriter
from tests.runner.compare import stored
from tests.runner.compare.browsers import start_browser


def _filled(folder: Path, fill: Callable[[LogbookWriter], None]) -> Path:
    """The folder, with a logbook that was filled."""
    with stored.logbook_at(folder) as logbook:
        fill(logbook)
    return folder


@pytest.fixture(scope="session")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a small logbook whose figures can be worked out by hand.

    Surge force MSE over seeds 0, 1, 2: none/calm 100, 102, 104; ls/calm 50, 51, 55;
    plsr/calm 40, 41, 42 but below the true model; none/noise 200, 210, 220; ls/noise 90 (seed 0),
    seed 1 failed, seed 2 diverged; plsr/noise 80, and nothing (NaN) for seed 1.
    """
    return _filled(tmp_path_factory.mktemp("plain"), stored.fill_plain)


@pytest.fixture
def logbook(tmp_path: Path) -> Iterator[LogbookWriter]:
    """An empty logbook in `tmp_path`, for a test to fill."""
    with stored.logbook_at(tmp_path) as opened:
        yield opened


@pytest.fixture
def folder(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Folder of the logbook that `results` reads: that which the test fills, else `plain`."""
    if "logbook" in request.fixturenames:
        request.getfixturevalue("logbook")
        return tmp_path
    return Path(request.getfixturevalue("plain"))


@pytest.fixture
def results(folder: Path) -> Iterator[Queries]:
    with open_results(f"{folder}/results.db") as opened:
        yield opened


@pytest.fixture(scope="session")
def sailed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a logbook with series and diagnostics, for the figures."""
    return _filled(tmp_path_factory.mktemp("sailed"), stored.fill_sailed)


@pytest.fixture(scope="session")
def ranked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a logbook of the benchmark, for the figure of its ranks."""
    return _filled(tmp_path_factory.mktemp("ranked"), stored.fill_benchmark)


Program = Callable[..., tuple[int, str, str]]


@pytest.fixture
def program(capsys: pytest.CaptureFixture[str]) -> Program:
    """Runs a command line; gives exit code, standard output and standard error."""

    def call(*arguments: str | Path) -> tuple[int, str, str]:
        code = run_program([str(argument) for argument in arguments])
        said = capsys.readouterr()
        return code, said.out, said.err

    return call


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Chromium, started once."""
    started = start_browser()
    try:
        yield started
    finally:
        started.quit()
