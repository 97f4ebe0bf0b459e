from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.runner.command import Command
from tests.runner.postgres import Postgres, served


@pytest.fixture
def seatrial(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Command:
    return Command(tmp_path, monkeypatch, capsys)


@pytest.fixture(scope="session")
def postgres_server() -> Iterator[Postgres]:
    yield from served()


@pytest.fixture
def postgres(postgres_server: Postgres) -> Postgres:
    postgres_server.used = 0
    return postgres_server
