"""A run that shows no sign of life is given up; one that does is left alone."""

import os
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from seatrial.models.errors import LogbookError
from seatrial.runner.database import LogbookWriter, claims, engine
from seatrial.runner.database.engine import parse
from seatrial.runner.record.rows import Results
from tests.runner.database.samples import ago, gone, make_start, pretend
from tests.runner.postgres import Postgres
from tests.runner.programs import wait


@pytest.fixture
def elsewhere(logbook: LogbookWriter, url: str) -> int:
    """A run that a process on another machine is doing."""
    run = logbook.begin_run(make_start(1)).run_id
    pretend(url, run, process="another boot/pid:[1]/1/1", host="island")
    return run


def test_a_run_with_a_fresh_heartbeat_is_busy(
    logbook: LogbookWriter, url: str, elsewhere: int
) -> None:
    begun = logbook.begin_run(make_start(1))
    assert (begun.state, begun.run_id) == ("busy", elsewhere)
    assert logbook.run(elsewhere).summary.status == "running"
    pretend(url, elsewhere, heartbeat_at=ago(claims.STALE_AFTER_S - 10))  # almost stale
    assert logbook.begin_run(make_start(1)).state == "busy"


@pytest.mark.parametrize("silent", [True, False])
def test_a_run_without_a_heartbeat_is_interrupted_and_done_again(
    logbook: LogbookWriter, url: str, elsewhere: int, silent: bool
) -> None:
    # The tests' PostgreSQL has just started, which gives younger beats a minute: test_outage.py.
    age_s = claims.STALE_AFTER_S * (1.0 if parse(url).path else 3.0) + 5.0
    pretend(url, elsewhere, heartbeat_at=ago(age_s) if silent else None)
    assert logbook.run(elsewhere).summary.status == "interrupted"
    begun = logbook.begin_run(make_start(1))
    assert begun.state == "new"
    old, new = logbook.runs()
    assert (old.status, old.superseded) == ("interrupted", True)
    assert "on island had no heartbeat for 60 s" in str(old.error)
    assert (new.status, new.attempt) == ("running", 2)
    with pytest.raises(LogbookError, match="it is interrupted, expected running"):
        logbook.finish_run(elsewhere, Results())


def test_a_process_that_is_gone_from_here_is_not_waited_for(
    logbook: LogbookWriter, url: str
) -> None:
    run = logbook.begin_run(make_start(1)).run_id
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    pretend(url, run, process=claims.identity(child.pid), pid=child.pid)
    assert logbook.begin_run(make_start(1)).state == "busy"
    child.kill()
    time.sleep(0.1)  # not waited for yet: a zombie is as good as gone
    assert logbook.run(run).summary.status == "interrupted"
    assert logbook.begin_run(make_start(1)).state == "new"
    child.communicate()
    assert "has ended" in str(logbook.run(run).summary.error)


@pytest.mark.parametrize("sign", ["its process is gone", "its heartbeat is old"])
def test_a_run_that_ends_while_it_is_taken_for_lost_is_not_done_again(
    postgres: Postgres, results_dir: Path, monkeypatch: pytest.MonkeyPatch, sign: str
) -> None:
    """On SQLite this cannot be: nobody else writes during a claim."""
    url = postgres.new_database()
    with LogbookWriter.open(url, results_dir=results_dir) as logbook:
        run = logbook.begin_run(make_start(1)).run_id
        gone = sign == "its process is gone"
        if not gone:
            pretend(url, run, heartbeat_at=ago(1000))

        def ends_meanwhile(process: str | None) -> bool:
            pretend(url, run, status="finished")
            return gone

        monkeypatch.setattr(claims, "is_gone", ends_meanwhile)
        begun = logbook.begin_run(make_start(1))
        assert (begun.state, begun.run_id) == ("finished", run)
        assert len(logbook.runs()) == 1


def test_who_is_gone() -> None:
    own = claims.identity(os.getpid())
    assert own is not None
    assert not claims.is_gone(own)
    machine, pid, start = own.rsplit("/", 2)
    assert claims.is_gone(f"{machine}/{pid}/{int(start) - 1}")  # its number was given again
    assert claims.is_gone(gone())
    assert not claims.is_gone(f"another {gone()}")
    assert not claims.is_gone(None)
    assert not claims.is_gone("nonsense")


def test_a_run_under_way_keeps_its_heart_beating(
    url: str, results_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(claims, "HEARTBEAT_S", 0.02)
    with LogbookWriter.open(url, results_dir=results_dir) as logbook:
        run = logbook.begin_run(make_start()).run_id

        def beats() -> bool:
            beat = logbook.run(run).heartbeat_at
            return beat is not None and abs(beat - datetime.now(UTC)) < timedelta(seconds=5)

        pretend(url, run, heartbeat_at=ago(1000))
        wait(beats)
        logbook.finish_run(run, Results())
        pretend(url, run, heartbeat_at=ago(1000))
        time.sleep(0.2)
        assert not beats()


def test_a_heartbeat_that_fails_does_not_end_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(claims, "HEARTBEAT_S", 0.02)
    monkeypatch.setattr(engine, "BUSY_TIMEOUT_S", 0.05)
    path = tmp_path / "results.db"
    with LogbookWriter.open(f"sqlite:///{path}", results_dir=tmp_path) as logbook:
        run = logbook.begin_run(make_start()).run_id
        with closing(sqlite3.connect(path, isolation_level=None, timeout=30)) as other:
            other.execute("BEGIN IMMEDIATE")
            wait(lambda: caplog.records)
            other.execute("ROLLBACK")
        logbook._writer.dispose()  # its connections give up after 50 ms; those to come do not
        monkeypatch.setattr(engine, "BUSY_TIMEOUT_S", 30.0)
        logbook.finish_run(run, Results())
    assert "no heartbeat for runs [1]: database is locked" in caplog.text


def test_a_database_that_vanishes_is_not_made_anew(tmp_path: Path) -> None:
    path = tmp_path / "results.db"
    with LogbookWriter.open(f"sqlite:///{path}", results_dir=tmp_path) as logbook:
        path.unlink()
        with pytest.raises(LogbookError, match=r"results\.db: cannot open the database file"):
            logbook.begin_run(make_start())
        assert not path.exists()
