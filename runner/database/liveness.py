"""Who is doing a run, and whether it still is.

A run that is under way has a heartbeat in its row, every 5 s by the database's clock. One without
a heartbeat for a minute is given up: it is shown as interrupted, and may be done again. On the
machine that was doing it there is no need to wait: a process that is gone is gone.
"""

import logging
from functools import cache
from pathlib import Path
from threading import Event, Lock, Thread
from typing import Any

from sqlalchemy import ColumnElement, Engine, update
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.sql.functions import FunctionElement
from sqlalchemy.types import Boolean, DateTime

from seatrial.models.errors import LogbookError
from seatrial.runner.database.engine import one_line
from seatrial.runner.database.tables import Run

HEARTBEAT_S = 5.0
STALE_AFTER_S = 60.0


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
    """Whether a heartbeat column is empty, or STALE_AFTER_S off the database's clock."""

    type = Boolean()
    inherit_cache = True


@compiles(is_stale)
def _is_stale(element: Any, compiler: Any, **options: Any) -> str:
    return stale(compiler.process(element.clauses, **options), compiler.dialect.name)


def stale(column: str, dialect: str) -> str:
    """SQL of whether a heartbeat is stale, on `sqlite` or `postgresql`.

    So is one from the future: the clock was put back, and no beat has come since. A PostgreSQL
    server that has just come back gives the runs that were alive when it left time for a beat.
    """
    patience = f"{STALE_AFTER_S:.0f} seconds"
    if dialect == "sqlite":
        past, future = (f"strftime('%Y-%m-%d %H:%M:%f000', 'now', '{s}{patience}')" for s in "-+")
        return f"({column} IS NULL OR {column} < {past} OR {column} > {future})"
    now, interval = "timezone('utc', clock_timestamp())", f"interval '{patience}'"
    came = "timezone('utc', pg_postmaster_start_time())"
    back = f"{came} > {now} - {interval} AND {column} > {came} - 2 * {interval}"
    silent = f"{column} < {now} - {interval} AND NOT ({back})"
    return f"({column} IS NULL OR {column} > {now} + {interval} OR {silent})"


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
