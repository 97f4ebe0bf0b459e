"""Claims of trials: if two processes start the same trial at once, exactly one runs it.

On SQLite writers wait for each other, so a claim reads the current state. On PostgreSQL two claims
may both find no run. Then the unique indexes (fingerprint where the status is running; fingerprint
and attempt) accept one insert, and the other claim is repeated. A claim is also repeated if a run
that seems lost has finished in the meantime.
"""

import os
import socket
from collections.abc import Sequence
from datetime import datetime
from typing import Any

from sqlalchemy import ColumnElement, Connection, Insert, select, update
from sqlalchemy.dialects import sqlite

from seatrial.models.errors import LogbookError
from seatrial.runner.database.liveness import (
    STALE_AFTER_S,
    database_now,
    identity,
    is_gone,
    is_stale,
)
from seatrial.runner.database.records import RunClaim, RunStart, plain
from seatrial.runner.database.tables import Base, Reuse, RunRow

_TRIES = 10  # a try fails only if another process changed the rows at the same time
_CHUNK = 500  # databases limit the variables of a query


def claim(
    connection: Connection, start: RunStart, sweep_id: int | None, rerun: bool, moment: datetime
) -> RunClaim:
    """Begin a run of the trial, unless it is running, or finished and `rerun` is False.

    A run that this process began at the same `moment` is returned as new: the server committed it,
    but the connection was lost before the reply. Raises LogbookError if no try succeeds.
    """
    for _ in range(_TRIES):
        attempts = _attempts(connection, RunRow.fingerprint == start.fingerprint)
        begun = _existing(attempts, rerun, moment)
        running = [run for run in attempts if run.status == "running"]
        # They are lost, unless one has ended or is alive after all.
        if begun is None and all(_is_given_up(connection, run) for run in running):
            attempt = 1 + max((run.attempt for run in attempts), default=0)
            row = _row(start, sweep_id, attempt, moment)
            now = database_now(connection.dialect.name)
            statement = _insert_unless_there(connection, RunRow).values(heartbeat_at=now)
            run_id = connection.execute(statement.returning(RunRow.id), row).scalar()
            if run_id is not None:  # otherwise another process was first
                begun = RunClaim(run_id, "new")
        if begun is not None:
            if begun.state != "new" and sweep_id is not None:
                _note_reuse(connection, sweep_id, [begun.run_id])
            return begun
    raise LogbookError(f"trial {start.fingerprint[:12]}: could not be claimed in {_TRIES} tries")


def give_up(connection: Connection, run_id: int, reason: str, *where: ColumnElement[bool]) -> bool:
    """Mark a run as interrupted if it is running and `where` holds; returns whether it was."""
    result = connection.execute(
        update(RunRow)
        .where(RunRow.id == run_id, RunRow.status == "running", *where)
        .values(status="interrupted", error=reason)
        .returning(RunRow.id)
    )
    return result.scalar() is not None


def give_up_gone(connection: Connection, sweep_id: int) -> None:
    """Mark the runs of a sweep as interrupted whose processes on this machine have ended."""
    for run in _attempts(connection, RunRow.sweep_id == sweep_id, RunRow.status == "running"):
        if is_gone(run.process):
            _is_given_up(connection, run)


def _attempts(connection: Connection, *where: ColumnElement[bool]) -> Sequence[Any]:
    """Read the columns that decide whether an attempt counts, in the order of attempts."""
    names = ("id", "attempt", "status", "process", "host", "pid", "started_at")
    columns = [RunRow.__table__.c[name] for name in names]
    stale = is_stale(connection.dialect.name).label("stale")
    return connection.execute(select(*columns, stale).where(*where).order_by(RunRow.attempt)).all()


def _existing(attempts: Sequence[Any], rerun: bool, moment: datetime) -> RunClaim | None:
    """Return the run of the trial that is ours already, finished or running, if there is one."""
    own = (socket.gethostname(), os.getpid(), moment)
    running = [run for run in attempts if run.status == "running"]
    for run in running:
        if (run.host, run.pid, run.started_at) == own:
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
    return give_up(connection, run.id, reason, is_stale(connection.dialect.name))


def _insert_unless_there(connection: Connection, table: type[Base]) -> Insert:
    """Return an INSERT without values, so that SQLAlchemy compiles it only once."""
    if connection.dialect.name == "sqlite":
        return sqlite.insert(table).on_conflict_do_nothing()
    from sqlalchemy.dialects import postgresql  # slow to import

    return postgresql.insert(table).on_conflict_do_nothing()


def _row(
    start: RunStart, sweep_id: int | None, attempt: int, moment: datetime
) -> dict[str, object]:
    """Return the row of a run; the fields of `RunStart` are columns of the table."""
    pid = os.getpid()
    return {
        **{name: plain(value) for name, value in vars(start).items()},
        "sweep_id": sweep_id,
        "attempt": attempt,
        "status": "running",
        "host": socket.gethostname(),
        "pid": pid,
        "started_at": moment,
        "process": identity(pid),
    }


def reuse(connection: Connection, sweep_id: int, run_ids: Sequence[int]) -> set[int]:
    """Store that a sweep takes over runs; returns those that are there and finished."""
    present: set[int] = set()
    for start in range(0, len(run_ids), _CHUNK):
        part = RunRow.id.in_(run_ids[start : start + _CHUNK])
        finished = select(RunRow.id).where(part, RunRow.status == "finished")
        present |= set(connection.scalars(finished))
    _note_reuse(connection, sweep_id, sorted(present))
    return present


def _note_reuse(connection: Connection, sweep_id: int, run_ids: Sequence[int]) -> None:
    rows = [{"sweep_id": sweep_id, "run_id": run_id} for run_id in run_ids]
    if rows:
        connection.execute(_insert_unless_there(connection, Reuse), rows)
