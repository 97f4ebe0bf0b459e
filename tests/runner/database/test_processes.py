"""Many processes write at once, and any of them may die at any moment."""

import random
import sqlite3
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from seatrial.runner.database import LogbookWriter
from seatrial.runner.database.engine import parse
from tests.runner.database import workers
from tests.runner.database.samples import make_results, make_start
from tests.runner.database.workers import Worker


def run_all(task: Callable[..., None], url: str, results_dir: Path) -> None:
    """Eight workers start at once, the first of them make the database, and all end well."""
    for worker in [Worker(task, url, results_dir, number) for number in range(8)]:
        worker.finish()


@pytest.mark.slow
def test_eight_processes_write_a_thousand_runs(url: str, results_dir: Path) -> None:
    run_all(workers.write_own, url, results_dir)
    with LogbookWriter.read(url, results_dir=results_dir) as reader:
        runs = reader.runs()
        assert sorted(run.seed for run in runs) == list(range(1000))
        assert {run.status for run in runs} == {"finished"}
        assert {run.attempt for run in runs} == {1}
        assert {run.metrics for run in runs} == {30}
        assert {run.coefficients for run in runs} == {100}
        assert reader.verify().problems == []


def test_a_trial_that_eight_processes_start_is_run_by_one(url: str, results_dir: Path) -> None:
    run_all(workers.write_shared, url, results_dir)
    with LogbookWriter.read(url, results_dir=results_dir) as reader:
        runs = reader.runs()
        assert sorted(run.seed for run in runs) == list(range(100))
        assert {(run.status, run.attempt) for run in runs} == {("finished", 1)}
        assert len(set(reader.sql("SELECT DISTINCT note FROM run").rows)) > 1


@pytest.mark.slow
def test_a_killed_writer_leaves_a_whole_logbook(url: str, results_dir: Path) -> None:
    """Four kills at random moments: what was reported finished is whole, and the rest resumes."""
    LogbookWriter.open(url, results_dir=results_dir).close()
    moments, reported = random.Random(1), set()
    for _ in range(2):
        pair = [Worker(workers.write_until_killed, url, results_dir, n) for n in (0, 1)]
        for worker in pair:
            worker.wait_until_it_speaks()
            time.sleep(moments.uniform(0.0, 0.1))
            worker.kill()
        reported |= {int(line) for worker in pair for line in worker.said()}
        whole(url, results_dir, reported)
    with LogbookWriter.open(url, results_dir=results_dir) as logbook:
        interrupted = [run for run in logbook.runs() if run.status == "interrupted"]
        for run in interrupted:
            begun = logbook.begin_run(make_start(run.seed))
            if begun.state == "new":
                logbook.finish_run(begun.run_id, make_results())
        assert all(run.status == "finished" for run in logbook.runs() if not run.superseded)
        assert logbook.verify().problems == []


def whole(url: str, results_dir: Path, reported: set[int]) -> None:
    """The database is sound and every finished run has all of its rows and files."""
    address = parse(url)
    if address.path is not None:
        with closing(sqlite3.connect(address.path)) as plain:
            assert plain.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
            assert plain.execute("PRAGMA foreign_key_check").fetchall() == []
    with LogbookWriter.read(url, results_dir=results_dir) as reader:
        runs = {run.run_id: run for run in reader.runs()}
        for run in runs.values():
            stored = (run.metrics, run.coefficients, run.series)
            assert stored == ((30, 100, 1) if run.status == "finished" else (0, 0, 0))
            assert run.status in ("finished", "interrupted")
        assert all(runs[run_id].status == "finished" for run_id in reported)
        assert reader.verify().problems == []  # a row without its file would be one


@pytest.mark.parametrize(("number", "place"), [(0, "results.db"), (1, "/series/run-")])
def test_a_full_disk_leaves_a_whole_logbook(tmp_path: Path, number: int, place: str) -> None:
    results_dir = tmp_path / "results"
    url = f"sqlite:///{results_dir}/results.db"
    worker = Worker(workers.write_until_full, url, results_dir, number)
    worker.finish()
    (line,) = worker.said()
    assert place in line
    assert "full" in line or "too large" in line or "I/O error" in line, line
    with LogbookWriter.open(url, results_dir=results_dir) as logbook:
        runs = logbook.runs()
        assert {run.metrics for run in runs if run.status == "finished"} <= {30}
        assert {run.metrics for run in runs if run.status != "finished"} <= {0}
        assert logbook.verify().problems == []
        again = logbook.begin_run(make_start(5000))
        logbook.finish_run(again.run_id, make_results())
