"""Folders that cannot be written, files that were damaged: one line, and nothing lost."""

import multiprocessing
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from multiprocessing.connection import Connection
from pathlib import Path

import pytest

from seatrial.models.errors import LogbookError
from seatrial.runner.database import LogbookWriter
from tests.runner.database.samples import make_results, make_start

NOBODY = 65534


@pytest.fixture
def shared() -> Iterator[Path]:
    """A folder that every user can enter."""
    folder = Path(tempfile.mkdtemp(prefix="seatrial-test-"))
    folder.chmod(0o755)
    yield folder
    shutil.rmtree(folder)


def fill(folder: Path) -> str:
    url = f"sqlite:///{folder}/results.db"
    with LogbookWriter.open(url, results_dir=folder) as logbook:
        logbook.finish_run(logbook.begin_run(make_start()).run_id, make_results())
    return url


def as_nobody(url: str, *tasks: Callable[[str], object]) -> list[object]:
    """What each task gives, or the error it meets, to a user who may not write here."""
    here, there = multiprocessing.Pipe(duplex=False)
    process = multiprocessing.get_context("forkserver").Process(
        target=_as_nobody, args=(url, tasks, there)
    )
    process.start()
    there.close()
    said = [here.recv() for _ in tasks]
    process.join(30)
    return said


def _as_nobody(url: str, tasks: Sequence[Callable[[str], object]], to: Connection) -> None:
    if os.getuid() == 0:
        with tempfile.TemporaryDirectory() as folder:
            read_statuses(fill(Path(folder)))  # imports everything while it may still be read
        os.setgroups([])
        os.setgid(NOBODY)
        os.setuid(NOBODY)
    for task in tasks:
        try:
            to.send(task(url))
        except BaseException as error:
            to.send(f"{type(error).__name__}: {error}")


def read_statuses(url: str) -> list[str]:
    with LogbookWriter.read(url) as reader:
        reader.series(1, "recording")
        return [run.status for run in reader.runs()]


def write_a_run(url: str) -> None:
    folder = Path(url.removeprefix("sqlite:///")).parent
    with LogbookWriter.open(url, results_dir=folder) as logbook:
        logbook.finish_run(logbook.begin_run(make_start(2)).run_id, make_results())


def test_a_read_only_folder_can_be_read_and_says_that_it_cannot_be_written(shared: Path) -> None:
    url = fill(shared)
    (shared / "results.db-wal").touch()  # as a reader leaves it that is open when a sweep ends
    shared.chmod(0o555)
    before, said, after = as_nobody(url, read_statuses, write_a_run, read_statuses)
    assert before == after == ["finished"]
    assert isinstance(said, str)
    assert said.startswith(f"LogbookError: {shared}/results.db: ")
    assert "readonly" in said or "cannot open" in said
    assert "\n" not in said
    shared.chmod(0o755)


def test_a_reader_who_may_not_write_sees_what_a_writer_has_just_written(shared: Path) -> None:
    url = fill(shared)
    shared.chmod(0o555)
    with LogbookWriter.open(url, results_dir=shared) as logbook:
        logbook.begin_run(make_start(3))
        assert as_nobody(url, read_statuses) == [["finished", "running"]]
    shared.chmod(0o755)


def test_a_series_folder_that_cannot_be_written_leaves_the_run_under_way(shared: Path) -> None:
    url = fill(shared)
    (shared / "series").rename(shared / "away")
    (shared / "series").touch()
    with LogbookWriter.open(url, results_dir=shared) as logbook:
        run = logbook.begin_run(make_start(2)).run_id
        with pytest.raises(LogbookError, match=r"run-000002-\w+.parquet: cannot be written"):
            logbook.finish_run(run, make_results())
        assert logbook.run(run).summary.status == "running"


def test_a_folder_that_cannot_be_made_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(LogbookError, match=r"file/results.db: cannot create the folder"):
        LogbookWriter.open(f"sqlite:///{tmp_path}/file/results.db", results_dir=tmp_path)
    (tmp_path / "folder.db").mkdir()
    with pytest.raises(LogbookError, match=r"folder.db: got a folder, expected a SQLite file"):
        LogbookWriter.open(f"sqlite:///{tmp_path}/folder.db", results_dir=tmp_path)


@pytest.mark.parametrize("page", [1, 5, 20, None])
def test_damaged_pages_and_missing_ones_are_told(tmp_path: Path, page: int | None) -> None:
    """Garbage in a page is found by `verify`, and by whoever reads it; nobody sees a traceback."""
    url = fill(tmp_path)
    path = tmp_path / "results.db"
    content = bytearray(path.read_bytes())
    assert len(content) > 21 * 4096
    if page is None:
        del content[5000:]
    else:
        content[page * 4096 : page * 4096 + 2000] = b"\xa5" * 2000
    path.write_bytes(content)
    with pytest.raises(LogbookError, match=f"^{path}: .*malformed|found by verify"):
        read_all(url)


def read_all(url: str) -> None:
    with LogbookWriter.read(url) as reader:
        found = reader.verify().problems
        reader.runs()
        reader.coefficients(1)
        reader.metrics(1)
    if found:
        raise LogbookError("found by verify")
