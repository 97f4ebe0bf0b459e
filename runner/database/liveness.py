"""The process of a run, and whether it is still alive.

A running run has a heartbeat in its row every 5 s, by the database's clock. A run without a
heartbeat for a minute is shown as interrupted and may be run again. On the machine of the run the
process itself is checked, without waiting.
"""

import logging
from datetime import datetime
from functools import cache
from pathlib import Path
from threading import Event, Lock, Thread

from sqlalchemy import Boolean, ColumnElement, DateTime, Engine, literal_column, update
from sqlalchemy.exc import SQLAlchemyError

from seatrial.models.errors import LogbookError
from seatrial.runner.database.engine import Address, one_line
from seatrial.runner.database.outage import repeated
from seatrial.runner.database.tables import RunRow

HEARTBEAT_S = 5.0
STALE_AFTER_S = 60.0
# The time of the database's clock, UTC without a zone.
_CLOCKS = {
    "sqlite": "strftime('%Y-%m-%d %H:%M:%f000', 'now')",
    "postgresql": "timezone('utc', clock_timestamp())",
}


def database_now(dialect: str) -> ColumnElement[datetime]:
    """The time of the database's clock, UTC without a zone."""
    return literal_column(_CLOCKS[dialect], DateTime())


def is_stale(dialect: str) -> ColumnElement[bool]:
    """Whether the heartbeat of a row of `run` is stale."""
    return literal_column(stale("run.heartbeat_at", dialect), Boolean())


def stale(column: str, dialect: str) -> str:
    """Return SQL that tests whether a heartbeat is stale, for `sqlite` or `postgresql`.

    A heartbeat in the future is stale, too: the clock was set back, and no heartbeat came since.
    After a restart of a PostgreSQL server, the runs that were alive before it have time for a
    heartbeat.
    """
    patience = f"{STALE_AFTER_S:.0f} seconds"
    if dialect == "sqlite":
        past, future = (f"strftime('%Y-%m-%d %H:%M:%f000', 'now', '{s}{patience}')" for s in "-+")
        return f"({column} IS NULL OR {column} < {past} OR {column} > {future})"
    now, interval = _CLOCKS[dialect], f"interval '{patience}'"
    restart = "timezone('utc', pg_postmaster_start_time())"
    restarted = f"{restart} > {now} - {interval} AND {column} > {restart} - 2 * {interval}"
    expired = f"{column} < {now} - {interval} AND NOT ({restarted})"
    return f"({column} IS NULL OR {column} > {now} + {interval} OR {expired})"


@cache
def _machine() -> str | None:
    """Identify this boot of this machine and this container; None if that is not possible."""
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        return f"{boot}/{Path('/proc/self/ns/pid').readlink()}"
    except OSError:
        return None


def _state(pid: str) -> tuple[str, str] | None:
    """Read the state letter and start [clock ticks since boot] of a process; None if it is gone."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    return fields[0], fields[19]


def identity(pid: int) -> str | None:
    """Return a name of process `pid` that is unique over all processes and machines."""
    machine, state = _machine(), _state(str(pid))
    return f"{machine}/{pid}/{state[1]}" if machine and state else None


def is_gone(process: str | None) -> bool:
    """Return whether `process` (an identity) ran here and has ended; False if unknown."""
    machine, _, rest = (process or "").rpartition("]/")
    if not machine or f"{machine}]" != _machine():
        return False
    pid, _, start = rest.partition("/")
    state = _state(pid)
    return state is None or state[0] in "ZX" or state[1] != start


_log = logging.getLogger(__name__)


class Heartbeat:
    """A thread that updates the heartbeat of the watched runs; starts with the first of them."""

    def __init__(self, engine: Engine, address: Address) -> None:
        self._engine = engine
        self._address = address
        self._runs: set[int] = set()
        self._lock = Lock()
        self._stopped = Event()
        self._thread: Thread | None = None

    def watch(self, run_id: int) -> None:
        """Start the heartbeat of a run."""
        with self._lock:
            self._runs.add(run_id)
            if self._thread is None:
                self._thread = Thread(target=self._beat, name="heartbeat", daemon=True)
                self._thread.start()

    def forget(self, run_id: int) -> None:
        """Stop the heartbeat of a run."""
        with self._lock:
            self._runs.discard(run_id)

    def stop(self) -> None:
        """End the thread after the current heartbeat."""
        self._stopped.set()
        if self._thread is not None and self._thread.is_alive():  # or Ctrl-C came as it started
            self._thread.join()
        self._thread = None

    def _beat(self) -> None:
        while not self._stopped.wait(HEARTBEAT_S):
            with self._lock:
                runs = sorted(self._runs)
            if runs:
                self._touch(runs)

    def _touch(self, runs: list[int]) -> None:
        alive = update(RunRow).where(RunRow.id.in_(runs), RunRow.status == "running")

        def beat() -> None:
            with self._engine.begin() as connection:
                now = database_now(self._address.dialect)
                connection.execute(alive.values(heartbeat_at=now))

        try:
            repeated(self._address, beat)
        except (SQLAlchemyError, LogbookError) as error:
            # The next heartbeat may succeed; if none does, the run counts as interrupted.
            _log.warning("no heartbeat for runs %s: %s", runs, one_line(error))
