from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from seatrial.runner.commands import data_commands
from tests.runner import postgres as postgresql
from tests.runner import slurm as cluster
from tests.runner.command import Answer, Command
from tests.runner.postgres import Postgres
from tests.runner.slurm import Slurm


@pytest.fixture
def seatrial(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Command:
    return Command(tmp_path, monkeypatch, capsys)


@pytest.fixture
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


Data = Callable[..., Answer]


@pytest.fixture
def data(capsys: pytest.CaptureFixture[str]) -> Data:
    """Calls `seatrial data WORDS`, which must succeed."""

    def call(*words: str | Path) -> Answer:
        code = data_commands.main([str(word) for word in words])
        assert code == 0
        return Answer(code, *capsys.readouterr())

    return call


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
