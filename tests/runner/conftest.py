from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.runner import postgres as postgresql
from tests.runner import slurm as cluster
from tests.runner.command import Command
from tests.runner.postgres import Postgres
from tests.runner.slurm import Slurm


@pytest.fixture
def seatrial(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Command:
    return Command(tmp_path, monkeypatch, capsys)


@pytest.fixture(scope="session")
def postgres_server() -> Iterator[Postgres]:
    yield from postgresql.served()


@pytest.fixture
def postgres(postgres_server: Postgres) -> Postgres:
    postgres_server.used = 0
    return postgres_server


@pytest.fixture(scope="session")
def slurm() -> Iterator[Slurm]:
    yield from cluster.served()
