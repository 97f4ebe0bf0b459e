"""Who is doing a run, and whether it still is.

A run that is under way has a heartbeat in its row, every 5 s by the database's clock. One without
a heartbeat for a minute is given up: it is shown as interrupted, and may be done again. On the
machine that was doing it there is no need to wait: a process that is gone is gone.

Of two processes that start a trial at once, exactly one gets to do it. On SQLite the writers
queue, so what a claim sees is so. On PostgreSQL two claims may both see nothing; then the unique
indexes (fingerprint where the status is running; fingerprint and attempt) let one insert through,
and the other looks again. So does one that takes a run for lost whose process has just finished
it, and ended.
"""

import logging
import os
import socket
from collections.abc import Sequence
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from threading import Event, Lock, Thread
from typing import Any

from sqlalchemy import ColumnElement, Connection, Engine, Row, select, update
from sqlalchemy.dialects import sqlite
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.sql.functions import FunctionElement
from sqlalchemy.types import Boolean, DateTime

from seatrial.models.errors import LogbookError
from seatrial.runner.database.engine import one_line, without_passwords
from seatrial.runner.database.records import Begun, RunStart, plain
from seatrial.runner.database.tables import Base, Reuse, Run

HEARTBEAT_S = 5.0
STALE_AFTER_S = 60.0
_TRIES = 10  # each further one needs another process to have come between
_CHOICES = ("vessel", "disturbance", "excitation", "identifier", "controller", "evaluation")


class database_now(FunctionElement[Any]):  # noqa: N801 - it reads as an SQL function
    """The time of the database's clock, UTC without a zone."""

    type = DateTime()
    inherit_cache = True


@compiles(database_now, "sqlite")
def _sqlite_now(element: ColumnElement[Any], compiler: Any, **_: Any) -> str:
    return "strftime('%Y-%m-%d %H:%M:%f000', 'now')"


@compiles(database_now, "postgresql")
def _postgresql_now(element: ColumnElement[Any], compiler: Any, **_: Any) -> str:
    return "timezone('utc', clock_timestamp())"


class is_stale(FunctionElement[Any]):  # noqa: N801
    """Whether a heartbeat column is empty or older than STALE_AFTER_S by the database's clock."""

    type = Boolean()
    inherit_cache = True


@compiles(is_stale)
def _is_stale(element: Any, compiler: Any, **options: Any) -> str:
    column = compiler.process(element.clauses, **options)
    return f"({column} IS NULL OR {column} < {stale_before(compiler.dialect.name)})"


def stale_before(dialect: str) -> str:
    """SQL of the time before which a heartbeat is stale, on `sqlite` or `postgresql`."""
    if dialect == "sqlite":
        return f"strftime('%Y-%m-%d %H:%M:%f000', 'now', '-{STALE_AFTER_S:.0f} seconds')"
    return f"timezone('utc', clock_timestamp()) - interval '{STALE_AFTER_S:.0f} seconds'"


@cache
def _machine() -> str | None:
    """This boot of this machine, and within it this container; None where that is unknown."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        namespace = Path("/proc/self/ns/pid").readlink()
    except OSError:
        return None
    return f"{boot}/{namespace}"


def _state(pid: str) -> tuple[str, str] | None:
    """State letter and start [clock ticks since boot] of a process; None where there is none."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    return fields[0], fields[19]


def identity(pid: int) -> str | None:
    """A name of process `pid` that no other process, on this or another machine, ever has."""
    machine, state = _machine(), _state(str(pid))
    return f"{machine}/{pid}/{state[1]}" if machine and state else None


def is_gone(process: str | None) -> bool:
    """Whether `process` (an identity) ran here and runs no more; False where that is unknown."""
    machine, _, rest = (process or "").rpartition("]/")
    if not machine or f"{machine}]" != _machine():
        return False
    pid, _, start = rest.partition("/")
    state = _state(pid)
    return state is None or state[0] in "ZX" or state[1] != start


# The sign of life of the runs of this process: a thread that touches their rows every 5 s.


_log = logging.getLogger(__name__)


class Heartbeat:
    """Touches the rows of the watched runs; starts with the first of them."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._runs: set[int] = set()
        self._lock = Lock()
        self._stopped = Event()
        self._thread: Thread | None = None

    def watch(self, run_id: int) -> None:
        """Keep the row of a run fresh from now on."""
        with self._lock:
            self._runs.add(run_id)
            if self._thread is None:
                self._thread = Thread(target=self._beat, name="heartbeat", daemon=True)
                self._thread.start()

    def forget(self, run_id: int) -> None:
        """Leave the row of a run alone from now on."""
        with self._lock:
            self._runs.discard(run_id)

    def stop(self) -> None:
        """End the thread, once a beat that is under way is done."""
        self._stopped.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _beat(self) -> None:
        while not self._stopped.wait(HEARTBEAT_S):
            with self._lock:
                runs = sorted(self._runs)
            if runs:
                self._touch(runs)

    def _touch(self, runs: list[int]) -> None:
        try:
            with self._engine.begin() as connection:
                connection.execute(
                    update(Run)
                    .where(Run.id.in_(runs), Run.status == "running")
                    .values(heartbeat_at=database_now())
                )
        except (SQLAlchemyError, LogbookError) as error:
            # The next beat may pass; if none does, the run counts as interrupted.
            _log.warning("no heartbeat for runs %s: %s", runs, one_line(error))


def claim(connection: Connection, start: RunStart, sweep_id: int | None, rerun: bool) -> Begun:
    """Begin a run of the trial, unless it is under way, or finished and no `rerun` is asked for."""
    for _ in range(_TRIES):
        attempts = _attempts(connection, start.fingerprint)
        begun = _done_already(attempts, rerun)
        if begun is None and _lost_are_given_up(connection, attempts):
            attempt = 1 + max((run.attempt for run in attempts), default=0)
            begun = _insert(connection, start, sweep_id, attempt)
        if begun is not None:
            if begun.state != "new" and sweep_id is not None:
                _note_reuse(connection, sweep_id, begun.run_id)
            return begun
    raise LogbookError(f"trial {start.fingerprint[:12]}: could not be claimed in {_TRIES} tries")


def give_up(connection: Connection, run_id: int, reason: str, *where: ColumnElement[bool]) -> bool:
    """Mark a run as interrupted, if it still is under way and `where` holds; whether it was."""
    marked = connection.execute(
        update(Run)
        .where(Run.id == run_id, Run.status == "running", *where)
        .values(status="interrupted", error=reason)
        .returning(Run.id)
    )
    return marked.scalar() is not None


def _attempts(connection: Connection, fingerprint: str) -> Sequence[Row[Any]]:
    stale = is_stale(Run.heartbeat_at).label("stale")
    return connection.execute(
        select(Run.id, Run.attempt, Run.status, Run.process, Run.host, Run.pid, stale)
        .where(Run.fingerprint == fingerprint)
        .order_by(Run.attempt)
    ).all()


def _done_already(attempts: Sequence[Row[Any]], rerun: bool) -> Begun | None:
    """The answer where nothing is to be done."""
    finished = [run.id for run in attempts if run.status == "finished"]
    if finished and not rerun:
        return Begun(finished[-1], "finished")
    for run in attempts:
        if run.status == "running" and not (run.stale or is_gone(run.process)):
            return Begun(run.id, "busy")
    return None


def _lost_are_given_up(connection: Connection, attempts: Sequence[Row[Any]]) -> bool:
    """Give up the runs under way; False where one has ended, or stirred, since it was looked at."""
    return all(_is_given_up(connection, run) for run in attempts if run.status == "running")


def _is_given_up(connection: Connection, run: Row[Any]) -> bool:
    process = f"process {run.pid} on {run.host}"
    if is_gone(run.process):
        return give_up(connection, run.id, f"{process} is gone")
    silent = f"{process} gave no sign of life for {STALE_AFTER_S:.0f} s"
    return give_up(connection, run.id, silent, is_stale(Run.heartbeat_at))


def _insert(
    connection: Connection, start: RunStart, sweep_id: int | None, attempt: int
) -> Begun | None:
    """The new run, or None where another process came first."""
    statement = _insert_unless_there(connection, Run).values(heartbeat_at=database_now())
    row = _row(start, sweep_id, attempt)
    run_id = connection.execute(statement.returning(Run.id), row).scalar()
    return Begun(run_id, "new") if run_id is not None else None


def _insert_unless_there(connection: Connection, table: type[Base]) -> Any:
    """A statement to be executed with a row, which is not in it: then it is compiled once."""
    if connection.dialect.name == "sqlite":
        return sqlite.insert(table).on_conflict_do_nothing()
    from sqlalchemy.dialects import postgresql  # seldom needed

    return postgresql.insert(table).on_conflict_do_nothing()


def _row(start: RunStart, sweep_id: int | None, attempt: int) -> dict[str, Any]:
    pid = os.getpid()
    return {
        "sweep_id": sweep_id,
        "fingerprint": start.fingerprint,
        "attempt": attempt,
        "status": "running",
        **{name: getattr(start, name) for name in _CHOICES},
        "seed": int(start.seed),
        "config": clean(start.config),
        "overrides": clean(start.overrides),
        "git_commit": start.git_commit,
        "git_dirty": start.git_dirty,
        "versions": clean(start.versions),
        "command": clean(start.command),
        "host": socket.gethostname(),
        "pid": pid,
        "started_at": datetime.now(UTC),
        "process": identity(pid),
    }


def clean(value: Any) -> Any:
    """What goes into the database of a configuration: plain JSON, and no password."""
    value = plain(value)
    if isinstance(value, str):
        return without_passwords(value)
    if isinstance(value, dict):
        return {key: clean(item) for key, item in value.items()}
    if isinstance(value, list):
        return [clean(item) for item in value]
    return value


def _note_reuse(connection: Connection, sweep_id: int, run_id: int) -> None:
    row = {"sweep_id": sweep_id, "run_id": run_id}
    connection.execute(_insert_unless_there(connection, Reuse), row)
