"""Keeping a logbook in order: is everything there and right, and what may go.

Series files are removed after their rows, never before, so that no row points to nothing; what a
program that died in between leaves over is an orphan, which `verify` names. Those of runs that
were given up are removed when that is done, and when a sweep starts.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from sqlalchemy import (
    ColumnElement,
    Connection,
    ForeignKeyConstraint,
    Row,
    Table,
    and_,
    delete,
    func,
    or_,
    select,
)
from sqlalchemy.exc import DatabaseError

from seatrial.models.errors import LogbookError
from seatrial.runner.database import series_files as files
from seatrial.runner.database.engine import one_line
from seatrial.runner.database.liveness import is_gone, is_stale
from seatrial.runner.database.records import Problem, SeriesFile, Verification
from seatrial.runner.database.scrub import stored_passwords
from seatrial.runner.database.tables import Base, Run, Series

_CHUNK = 500  # ids in one statement


def verify(connection: Connection, results_dir: Path) -> Verification:
    """Look at every page, foreign key and series file; `connection` may be read-only."""
    problems: list[Problem] = []
    left: list[Path] = []
    runs = stored = 0
    try:
        problems += _damage(connection)
        problems += _lost_parents(connection)
        problems += stored_passwords(connection)
        runs = connection.scalar(select(func.count()).select_from(Run)) or 0
        rows = connection.execute(select(Series.__table__).order_by(Series.id)).all()
        stored = len(rows)
        problems += [found for row in rows if (found := _wrong_file(row, results_dir))]
        left = orphans(connection, results_dir)
    except DatabaseError as error:
        problems.append(Problem("database", one_line(error)))
    return Verification(runs, stored, problems, left)


def _damage(connection: Connection) -> Iterator[Problem]:
    """What SQLite finds wrong with its file; PostgreSQL has its own tools (pg_amcheck)."""
    if connection.dialect.name == "sqlite":
        for line in connection.exec_driver_sql("PRAGMA integrity_check").scalars():
            if line != "ok":
                yield Problem("database", str(line))


def _lost_parents(connection: Connection) -> Iterator[Problem]:
    """Rows that point to a run or a sweep that is not there."""
    for table in Base.metadata.sorted_tables:
        for key in table.foreign_key_constraints:
            lost = connection.scalar(_without_parent(table, key))
            if lost:
                parent = key.referred_table.name
                yield Problem(f"table {table.name}", f"{lost} rows point to no {parent}")


def _without_parent(table: Table, key: ForeignKeyConstraint) -> Any:
    (column,), parent = key.columns, key.referred_table
    there = select(parent.c.id).where(parent.c.id == column).exists()
    return select(func.count()).select_from(table).where(column.is_not(None), ~there)


def _wrong_file(row: Row[Any], results_dir: Path) -> Problem | None:
    where = f"run {row.run_id}, series {row.kind}"
    file = SeriesFile(row.kind, row.path, row.format, row.n_rows, row.sha256, row.columns)
    try:
        content = files.checked(results_dir, file)
        n_rows, columns = files.shape(content)
    except LogbookError as error:
        return Problem(where, str(error))
    if (n_rows, set(columns)) != (file.n_rows, set(file.columns)):
        return Problem(
            where,
            f"{row.path}: got {n_rows} rows of {', '.join(columns)};"
            f" expected {file.n_rows} of {', '.join(file.columns)}",
        )
    return None


def orphans(connection: Connection, results_dir: Path) -> list[Path]:
    """Series files that no row points to, but for those of runs that are under way."""
    found = files.listed(results_dir)  # before the rows are read
    if not found:
        return []
    known = {Path(path).name for path in connection.scalars(select(Series.path))}
    alive = and_(Run.status == "running", ~is_stale(Run.heartbeat_at))
    claimed = connection.execute(select(Run.id, Run.process).where(alive))
    busy = {run_id for run_id, process in claimed if not is_gone(process)}
    return [
        path
        for path in found
        if path.name not in known and (files.owner(path) or (None,))[0] not in busy
    ]


def leftovers(connection: Connection, results_dir: Path) -> list[Path]:
    """Files of runs that were given up, or whose process is gone: nobody will name them.

    Only files with the mark of such a run, so that none of another logbook is among them.
    """
    found = files.listed(results_dir)
    if not found:
        return []
    lost = Run.status.in_(("interrupted", "running"))
    columns = (Run.id, Run.status, Run.process, Run.fingerprint, Run.attempt, Run.started_at)
    owners = {
        (row.id, files.mark(row.fingerprint, row.attempt, row.started_at))
        for row in connection.execute(select(*columns).where(lost))
        if row.status == "interrupted" or is_gone(row.process)
    }
    return [path for path in found if files.owner(path) in owners]


def prunable(older_than: timedelta | None, statuses: Sequence[str]) -> list[ColumnElement[bool]]:
    """Conditions on `run`: ended or given up, begun more than `older_than` ago, of a status."""
    stale = and_(Run.status == "running", is_stale(Run.heartbeat_at))
    conditions: list[ColumnElement[bool]] = [or_(Run.status != "running", stale)]
    if older_than is not None:
        conditions.append(Run.started_at < datetime.now(UTC) - older_than)
    if statuses:
        chosen = Run.status.in_(statuses)
        conditions.append(or_(chosen, stale) if "interrupted" in statuses else chosen)
    return conditions


def delete_runs(connection: Connection, run_ids: Sequence[int]) -> tuple[int, list[str]]:
    """Delete runs that are not under way; the answer is their number and their files' paths."""
    paths: list[str] = []
    deleted = 0
    for first in range(0, len(run_ids), _CHUNK):
        ids = run_ids[first : first + _CHUNK]
        ended = select(Run.id).where(Run.id.in_(ids), *prunable(None, ())).with_for_update()
        gone = connection.scalars(ended).all()
        paths += connection.scalars(select(Series.path).where(Series.run_id.in_(gone)))
        connection.execute(delete(Run).where(Run.id.in_(gone)))
        deleted += len(gone)
    return deleted, paths


def remove(results_dir: Path, paths: Sequence[str]) -> list[str]:
    """Remove series files; the answer names those that could not be removed."""
    left: list[str] = []
    for relative in paths:
        try:
            files.locate(results_dir, relative).unlink(missing_ok=True)
        except (OSError, LogbookError):
            left.append(relative)
    with suppress(OSError):  # when it is empty
        (results_dir / files.FOLDER).rmdir()
    return left
