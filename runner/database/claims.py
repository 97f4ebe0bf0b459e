"""Claims of trials: if two processes start the same trial at once, exactly one runs it.

On SQLite writers wait for each other, so a claim reads the current state. On PostgreSQL two claims
may both find no run. Then the unique indexes (fingerprint where the status is running; fingerprint
and attempt) accept one insert, and the other claim is repeated. A claim is also repeated if a run
that seems lost has finished in the meantime.

A running run has a heartbeat in its row every 5 s, by the database's clock. A run without a
heartbeat for a minute is shown as interrupted and may be run again. On the machine of the run the
process itself is checked, without waiting.
"""

import logging
import os
import socket
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from threading import Event
from typing import Any

from sqlalchemy import (
    Boolean,
    ColumnClause,
    ColumnElement,
    Connection,
    DateTime,
    Engine,
    Insert,
    literal_column,
    select,
    update,
)
from sqlalchemy.dialects import sqlite
from sqlalchemy.exc import SQLAlchemyError

from seatrial.models.errors import LogbookError
from seatrial.runner.database.engine import Address, one_line
from seatrial.runner.database.outage import repeated
from seatrial.runner.database.records import AT_ONCE, RunClaim, plain
from seatrial.runner.database.tables import Base, Reuse, RunRow

HEARTBEAT_S = 5.0
STALE_AFTER_S = 60.0
TRIES = 10  # a try fails only if another process changed the rows at the same time
# The time of the database's clock, UTC without a zone.
CLOCKS = {
    "sqlite": "strftime('%Y-%m-%d %H:%M:%f000', 'now')",
    "postgresql": "timezone('utc', clock_timestamp())",
}
_log = logging.getLogger(__name__)


def stale(dialect: str) -> ColumnClause[bool]:
    """Return SQL that tests whether the heartbeat of a row of `run` is stale.

    A heartbeat in the future is stale, too: the clock was set back, and no heartbeat came since.
    After a restart of a PostgreSQL server, the runs that were alive before it have time for a
    heartbeat.
    """
    column, patience, now = "run.heartbeat_at", f"{STALE_AFTER_S:.0f} seconds", CLOCKS[dialect]
    if dialect == "sqlite":
        past, future = (now.replace("'now'", f"'now', '{sign}{patience}'") for sign in "-+")
        late = f"{column} < {past} OR {column} > {future}"
    else:
        restart, interval = "timezone('utc', pg_postmaster_start_time())", f"interval '{patience}'"
        restarted = f"{restart} > {now} - {interval} AND {column} > {restart} - 2 * {interval}"
        late = f"{column} < {now} - {interval} AND NOT ({restarted})"
        late = f"{column} > {now} + {interval} OR {late}"
    return literal_column(f"({column} IS NULL OR {late})", Boolean())


def identity(pid: int | str) -> str | None:
    """Return a name of process `pid` that is unique over all machines, containers and boots.

    None if it does not run here, or on a machine that does not tell.
    """
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
        space = Path("/proc/self/ns/pid").readlink()
        stat = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    state, start = stat[0], stat[19]  # the latter in clock ticks since boot
    return None if state in "ZX" else f"{boot}/{space}/{pid}/{start}"


def is_gone(process: str | None) -> bool:
    """Return whether `process` (an identity) ran here and has ended; False if unknown."""
    own, parts = identity(os.getpid()), (process or "").rsplit("/", 2)
    here = own is not None and own.rsplit("/", 2)[0] == parts[0]
    return here and identity(parts[1]) != process


def beat(engine: Engine, address: Address, begun: Mapping[int, object], ended: Event) -> None:
    """Update the heartbeat of the runs that have begun until the end: the task of a thread."""
    now = literal_column(CLOCKS[address.dialect], DateTime())
    running = update(RunRow).where(RunRow.status == "running").values(heartbeat_at=now)

    def transaction() -> None:
        with engine.begin() as connection:
            connection.execute(running.where(RunRow.id.in_([*begun])))

    while not ended.wait(HEARTBEAT_S):
        try:
            repeated(address, transaction)
        except (SQLAlchemyError, LogbookError) as error:
            # The next heartbeat may succeed; if none does, the run counts as interrupted.
            _log.warning("no heartbeat for runs %s: %s", [*begun], one_line(error))


def claim(
    connection: Connection, start: RunRow, sweep_id: int | None, rerun: bool, moment: datetime
) -> RunClaim:
    """Begin a run of the trial, unless it is running, or finished and `rerun` is False.

    `start` has the columns that are known before. A run that this process began at the same
    `moment` is returned as new: the server committed it, but the connection was lost before the
    reply. Raises LogbookError if no try succeeds.
    """
    own = {"host": socket.gethostname(), "pid": os.getpid(), "started_at": moment}
    given = {name: value for name, value in vars(start).items() if name in RunRow.__table__.c}
    row = {name: plain(value) for name, value in given.items()} | own
    row |= {"status": "running", "sweep_id": sweep_id, "process": identity(os.getpid())}
    now = literal_column(CLOCKS[connection.dialect.name], DateTime())
    # Without the row's values, so that SQLAlchemy compiles the statement only once.
    statement = _insert_unless_there(connection, RunRow).values(heartbeat_at=now)
    for _ in range(TRIES):
        attempts = _attempts(connection, RunRow.fingerprint == start.fingerprint)
        begun = _existing(attempts, rerun, own)
        running = [run for run in attempts if run.status == "running"]
        # They are lost, unless one has ended or is alive after all.
        if begun is None and all(_is_given_up(connection, run) for run in running):
            row["attempt"] = 1 + max((run.attempt for run in attempts), default=0)
            run_id = connection.execute(statement.returning(RunRow.id), row).scalar()
            if run_id is not None:  # otherwise another process was first
                return RunClaim(run_id, "new")
        if begun is not None:
            if begun.state != "new" and sweep_id is not None:
                _note_reuse(connection, sweep_id, [begun.run_id])
            return begun
    raise LogbookError(f"trial {start.fingerprint[:12]}: could not be claimed in {TRIES} tries")


def give_up(connection: Connection, run_id: int, reason: str, *where: ColumnElement[bool]) -> bool:
    """Mark a run as interrupted if it is running and `where` holds; returns whether it was."""
    running = update(RunRow).where(RunRow.id == run_id, RunRow.status == "running", *where)
    values = {"status": "interrupted", "error": reason}
    return connection.execute(running.values(values).returning(RunRow.id)).scalar() is not None


def give_up_gone(connection: Connection, sweep_id: int) -> None:
    """Mark the runs of a sweep as interrupted whose processes on this machine have ended."""
    for run in _attempts(connection, RunRow.sweep_id == sweep_id, RunRow.status == "running"):
        if is_gone(run.process):
            _is_given_up(connection, run)


def _attempts(connection: Connection, *where: ColumnElement[bool]) -> Sequence[Any]:
    """Read the columns that decide whether an attempt counts, in the order of attempts."""
    names = ("id", "attempt", "status", "process", "host", "pid", "started_at")
    columns = [RunRow.__table__.c[name] for name in names]
    query = select(*columns, stale(connection.dialect.name).label("stale")).where(*where)
    return connection.execute(query.order_by(RunRow.attempt)).all()


def _existing(attempts: Sequence[Any], rerun: bool, own: dict[str, object]) -> RunClaim | None:
    """Return the run of the trial that is ours already, finished or running, if there is one."""
    running = [run for run in attempts if run.status == "running"]
    for run in running:
        if all(getattr(run, name) == value for name, value in own.items()):
            return RunClaim(run.id, "new")
    finished = [run.id for run in attempts if run.status == "finished"]
    if finished and not rerun:
        return RunClaim(finished[-1], "finished")
    for run in running:
        if not (run.stale or is_gone(run.process)):
            return RunClaim(run.id, "busy")
    return None


def _is_given_up(connection: Connection, run: Any) -> bool:
    process = f"process {run.pid} on {run.host}"
    if is_gone(run.process):
        return give_up(connection, run.id, f"{process} has ended")
    reason = f"{process} had no heartbeat for {STALE_AFTER_S:.0f} s"
    return give_up(connection, run.id, reason, stale(connection.dialect.name))


def _insert_unless_there(connection: Connection, table: type[Base]) -> Insert:
    if connection.dialect.name == "sqlite":
        return sqlite.insert(table).on_conflict_do_nothing()
    from sqlalchemy.dialects import postgresql  # slow to import

    return postgresql.insert(table).on_conflict_do_nothing()


def reuse(connection: Connection, sweep_id: int, run_ids: Sequence[int]) -> set[int]:
    """Store that a sweep takes over runs; returns those that are there and finished."""
    present: set[int] = set()
    for first in range(0, len(run_ids), AT_ONCE):
        own = RunRow.id.in_(run_ids[first : first + AT_ONCE])
        present |= {*connection.scalars(select(RunRow.id).where(own, RunRow.status == "finished"))}
    _note_reuse(connection, sweep_id, sorted(present))
    return present


def _note_reuse(connection: Connection, sweep_id: int, run_ids: Sequence[int]) -> None:
    rows = [{"sweep_id": sweep_id, "run_id": run_id} for run_id in run_ids]
    if rows:
        connection.execute(_insert_unless_there(connection, Reuse), rows)
