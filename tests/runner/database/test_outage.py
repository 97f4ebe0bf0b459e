"""A PostgreSQL server that goes away and comes back; heartbeats when clocks were changed."""

import os
import signal
import sqlite3
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Timer

import psycopg
import pytest
from sqlalchemy import event
from sqlalchemy.exc import DBAPIError, OperationalError

from seatrial.models.errors import LogbookError
from seatrial.runner.database import LogbookWriter, outage
from seatrial.runner.database.engine import parse
from tests.runner.command import Command
from tests.runner.database.samples import ago, make_results, make_start, pretend
from tests.runner.postgres import Postgres
from tests.runner.programs import METRICS, ended, sweep, wait


@pytest.fixture
def server(postgres: Postgres) -> Iterator[Postgres]:
    """The tests' server, which is there again afterwards."""
    yield postgres
    if postgres.process.poll() is not None:
        postgres.come_back()


@contextmanager
def away(server: Postgres) -> Iterator[None]:
    """The server leaves, and comes back while something waits for it."""
    server.leave()
    timer = Timer(1.5, server.come_back)
    timer.start()
    yield
    timer.join()


@pytest.mark.slow
def test_who_writes_waits_for_the_server_and_goes_on(server: Postgres, results_dir: Path) -> None:
    url = server.new_database()
    with LogbookWriter.open(url, results_dir=results_dir) as logbook:
        sweep_id = logbook.begin_sweep("s", "c", [], 3)
        first = logbook.begin_run(make_start(1), sweep_id).run_id
        with away(server):
            logbook.finish_run(first, make_results())
        with away(server):
            begun = logbook.begin_run(make_start(2), sweep_id)
        assert begun.state == "new"
        logbook.finish_run(begun.run_id, make_results())
        with away(server), LogbookWriter.open(url, results_dir=results_dir) as again:  # a trial
            assert again.begin_run(make_start(1), sweep_id).state == "finished"
        with away(server):
            assert logbook.sweep_status(sweep_id).counts == {"finished": 2}
        logbook.end_sweep(sweep_id)
        assert logbook.verify().problems == []
        assert [run.metrics for run in logbook.runs()] == [30, 30]


@pytest.mark.slow
def test_a_server_that_stays_away_is_told_in_one_line(
    server: Postgres, results_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert outage.PATIENCE_S == 60.0  # what the manual promises
    monkeypatch.setattr(outage, "PATIENCE_S", 1.0)
    url = server.new_database()
    began = time.monotonic()
    with LogbookWriter.open(url, results_dir=results_dir) as logbook:
        run = logbook.begin_run(make_start(1)).run_id
        server.leave()
        with pytest.raises(LogbookError, match=r"the server did not come back in 1 s$") as caught:
            logbook.finish_run(run, make_results())
        assert "\n" not in str(caught.value)
        assert list(results_dir.glob("series/*")) == []
        waited = time.monotonic()
        with pytest.raises(LogbookError, match="refused"):  # not waited for once more
            logbook.begin_run(make_start(2))
        assert time.monotonic() - waited < 0.9
    assert time.monotonic() - began < 30.0
    server.come_back()
    with LogbookWriter.open(url, results_dir=results_dir) as logbook:
        logbook.begin_run(make_start(3))
        pretend(url, run, heartbeat_at=None)  # as if its process were gone
        assert logbook.begin_run(make_start(1)).state == "new"


@pytest.mark.parametrize(
    ("error", "lost"),
    [
        *((psycopg.OperationalError("closed unexpectedly"), True),
          (psycopg.errors.AdminShutdown("terminating connection"), True),
          (psycopg.errors.CannotConnectNow("the database system is starting up"), True)),
        *((psycopg.errors.LockNotAvailable("could not obtain lock"), False),
          (psycopg.errors.DivisionByZero("division by zero"), False),
          (sqlite3.OperationalError("database is locked"), False)),
    ],
)  # fmt: skip
def test_only_errors_of_the_connection_are_an_outage(error: Exception, lost: bool) -> None:
    """Also when the connection is not yet seen to be closed, or breaks while rows are read."""
    operational = psycopg.OperationalError | sqlite3.OperationalError
    kind = OperationalError if isinstance(error, operational) else DBAPIError
    address = parse("postgresql://host/db")
    outage.expect(address)
    errors = [kind("SELECT 1", {}, error)]

    def task() -> str:
        if errors:
            raise errors.pop()
        return "done"

    if lost:
        assert outage.repeated(address, task) == "done"
    else:
        with pytest.raises(DBAPIError, match=str(error)):
            outage.repeated(address, task)


def lose_answer_of_commit(logbook: LogbookWriter) -> list[str]:
    """The next commit succeeds, but the connection is gone before that is known."""
    lost: list[str] = []

    @event.listens_for(logbook._writer, "commit")
    def _commit(connection: object) -> None:
        if not lost:
            lost.append("once")
            raw = connection.connection.dbapi_connection  # type: ignore[attr-defined]
            raw.commit()
            raw.close()

    return lost


def test_what_was_committed_is_not_done_twice(postgres: Postgres, results_dir: Path) -> None:
    url = postgres.new_database()
    with LogbookWriter.open(url, results_dir=results_dir) as logbook:
        lost = lose_answer_of_commit(logbook)
        sweep_id = logbook.begin_sweep("s", "c", [], 1)
        assert lost.pop()
        begun = logbook.begin_run(make_start(1), sweep_id)
        assert lost.pop()
        assert begun.state == "new"
        logbook.finish_run(begun.run_id, make_results())
        assert lost.pop()
        logbook.end_sweep(sweep_id)
        assert lost
        assert len(logbook.sweeps()) == 1
        (run,) = logbook.runs()
        assert (run.status, run.attempt, run.metrics, run.series) == ("finished", 1, 30, 1)
        assert logbook.verify().problems == []
        with pytest.raises(LogbookError, match="it is finished, expected running"):
            logbook.finish_run(begun.run_id, make_results())


@pytest.mark.slow
def test_a_sweep_goes_on_when_the_server_comes_back(server: Postgres, tmp_path: Path) -> None:
    url = server.new_database()
    many = ("seed=range(0,8)", "excitation.interval_s=600", "hydra/launcher=processes")
    process = sweep(*many, "database=postgresql", folder=tmp_path, SEATRIAL_DATABASE=url)

    def finished() -> bool:
        try:
            with LogbookWriter.read(url) as logbook:
                return any(run.status == "finished" for run in logbook.runs())
        except LogbookError:
            return False

    wait(lambda: finished() or process.poll() is not None)
    server.leave()
    time.sleep(5.0)
    server.come_back()
    code, out, err = ended(process)
    assert code == 0, out + err
    assert "8 finished" in out
    assert "Traceback" not in err
    with LogbookWriter.read(url, results_dir=tmp_path / "results") as logbook:
        assert [run.attempt for run in logbook.runs()] == [1] * 8
        assert logbook.verify().problems == []
        assert len({row[2] for row in logbook.sql(METRICS).rows}) == 8


def test_who_is_stopped_does_not_wait_for_the_server(
    seatrial: Command, server: Postgres, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake = seatrial.pretend()
    monkeypatch.setenv("SEATRIAL_DATABASE", server.new_database())

    class Leaving(set[int]):
        def __contains__(self, seed: object) -> bool:
            server.leave()
            os.kill(os.getpid(), signal.SIGTERM)
            return False

    fake.interrupted = Leaving()
    began = time.monotonic()
    answer = seatrial("-m", "seed=1,2", "database=postgresql")
    assert answer.code == 143
    assert answer.err.splitlines()[-1].startswith("seatrial: interrupted")
    assert time.monotonic() - began < 0.5 * outage.PATIENCE_S


@pytest.mark.parametrize(("ahead_s", "state"), [(3600.0, "new"), (10.0, "busy")])
def test_a_heartbeat_from_the_future_is_no_sign_of_life(
    logbook: LogbookWriter, url: str, ahead_s: float, state: str
) -> None:
    """The database's clock was put back, and nobody has beaten since."""
    run = logbook.begin_run(make_start(1)).run_id
    pretend(url, run, process="another boot/pid:[1]/1/1", heartbeat_at=ago(-ahead_s))
    status = "interrupted" if state == "new" else "running"
    assert logbook.run(run).summary.status == status
    assert logbook.begin_run(make_start(1)).state == state


def test_runs_that_were_alive_when_the_server_left_have_time_for_a_beat(
    server: Postgres, results_dir: Path
) -> None:
    url = server.new_database()
    with LogbookWriter.open(url, results_dir=results_dir) as logbook:
        alive, dead = (logbook.begin_run(make_start(n)).run_id for n in (1, 2))
        server.leave()
        server.come_back()
        for run, seconds in ((alive, 90.0), (dead, 300.0)):
            pretend(url, run, process="another boot/pid:[1]/1/1", heartbeat_at=ago(seconds))
        assert [run.status for run in logbook.runs()] == ["running", "interrupted"]
        assert logbook.begin_run(make_start(1)).state == "busy"
        assert logbook.begin_run(make_start(2)).state == "new"
