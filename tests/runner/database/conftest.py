"""Databases to test on: every storage test runs on SQLite and on PostgreSQL."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from seatrial.runner.database import LogbookWriter
from tests.runner.postgres import Postgres


@pytest.fixture(params=["sqlite", "postgresql"])
def url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """An address where there is no logbook yet, on each dialect."""
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path}/results/results.db"
    server: Postgres = request.getfixturevalue("postgres")
    return server.new_database()


@pytest.fixture
def results_dir(tmp_path: Path) -> Path:
    return tmp_path / "results"


@pytest.fixture
def logbook(url: str, results_dir: Path) -> Iterator[LogbookWriter]:
    with LogbookWriter.open(url, results_dir=results_dir) as opened:
        yield opened
