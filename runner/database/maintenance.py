"""Maintenance of a logbook: verification, and deletion of runs and series files.

Series files are removed after their rows, so that no row refers to a missing file. A program that
is killed in between leaves orphaned files, which `verify` lists. The files of interrupted runs are
removed when the run is marked as interrupted, and when a sweep starts.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from itertools import groupby
from operator import attrgetter
from pathlib import Path

from sqlalchemy import ColumnElement, Connection, and_, delete, func, or_, select
from sqlalchemy.exc import DatabaseError, OperationalError

from seatrial.models.errors import LogbookError
from seatrial.runner.database import series_files as files
from seatrial.runner.database.checked_rows import DamagedCellError, read
from seatrial.runner.database.engine import one_line
from seatrial.runner.database.liveness import is_gone, is_stale
from seatrial.runner.database.records import LogbookDefect, SeriesFile, Verification
from seatrial.runner.database.tables import Base, PlannedRow, RunRow, SeriesRow

_CHUNK = 500  # ids in one statement
_ROWS = 10_000  # in memory
UNCHECKED = "series files were not checked: some cells cannot be read"


def verify(connection: Connection, results_dir: Path) -> Verification:
    """Check every page, foreign key and series file; `connection` may be read-only."""
    problems: list[LogbookDefect] = []
    leftover_files: list[Path] = []
    counts = [0, 0]
    try:
        problems += _damage(connection)
        problems += _lost_parents(connection)
        numbers = (RunRow.id, SeriesRow.path.distinct())
        counts = [connection.scalar(select(func.count(number))) or 0 for number in numbers]
        damaged = list(_damaged_tables(connection))
        problems += damaged
        if damaged:
            problems.append(LogbookDefect("database", UNCHECKED))
        else:
            problems += _wrong_files(connection, results_dir)
            leftover_files = orphans(connection, results_dir)
    except DatabaseError as error:
        problems.append(LogbookDefect("database", one_line(error)))
    return Verification(counts[0], counts[1], problems, leftover_files)


def _damage(connection: Connection) -> Iterator[LogbookDefect]:
    """Run SQLite's integrity check; PostgreSQL has its own tool (pg_amcheck)."""
    if connection.dialect.name == "sqlite":
        for line in connection.exec_driver_sql("PRAGMA integrity_check").scalars():
            if line != "ok":
                yield LogbookDefect("database", str(line))


def _damaged_tables(connection: Connection) -> Iterator[LogbookDefect]:
    """Read every cell, and name the first one of each table that cannot be read."""
    for table in Base.metadata.sorted_tables:
        try:
            for _ in read(connection, select(table), _ROWS):
                pass
        except (DamagedCellError, OperationalError) as error:  # such as text that is not UTF-8
            yield LogbookDefect(f"table {table.name}", one_line(error))


def _lost_parents(connection: Connection) -> Iterator[LogbookDefect]:
    """Find rows that refer to a missing run or sweep."""
    for table in Base.metadata.sorted_tables:
        for key in table.foreign_key_constraints:
            (column,), parent = key.columns, key.referred_table
            there = select(parent.c.id).where(parent.c.id == column).exists()
            query = select(func.count()).select_from(table).where(column.is_not(None), ~there)
            if count := connection.scalar(query):
                problem = f"{count} rows refer to no {parent.name}"
                yield LogbookDefect(f"table {table.name}", problem)


def _wrong_files(connection: Connection, results_dir: Path) -> Iterator[LogbookDefect]:
    """Read every series file once, and compare it with its rows."""
    rows = connection.execute(select(SeriesRow.__table__).order_by(SeriesRow.run_id, SeriesRow.id))
    for run_id, of_run in groupby(rows, attrgetter("run_id")):
        names = SeriesFile.__dataclass_fields__
        series = [SeriesFile(*(getattr(row, name) for name in names)) for row in of_run]
        where = f"run {run_id}, series {', '.join(file.kind for file in series)}"
        try:
            for path, of_file in groupby(series, attrgetter("path", "sha256")):
                yield from _wrong_rows(results_dir, where, path[0], list(of_file))
        except LogbookError as error:
            yield LogbookDefect(where, str(error))


def _wrong_rows(
    results_dir: Path, where: str, path: str, series: Sequence[SeriesFile]
) -> Iterator[LogbookDefect]:
    n_rows, columns = files.shape(files.checked(results_dir, series[0]))
    for file in series:
        if n_rows.get(file.kind, 0) != file.n_rows or not file.columns.keys() <= set(columns):
            yield LogbookDefect(
                where,
                f"{path}: got {n_rows.get(file.kind, 0)} rows of {', '.join(columns)};"
                f" expected {file.n_rows} of {', '.join(file.columns)}",
            )


def orphans(connection: Connection, results_dir: Path) -> list[Path]:
    """List the series files that no row refers to, without those of running runs."""
    paths = files.listed(results_dir)  # before the rows are read
    if not paths:
        return []
    known = {Path(path).name for path in connection.scalars(select(SeriesRow.path))}
    alive = and_(RunRow.status == "running", ~is_stale(RunRow.heartbeat_at))
    claimed = connection.execute(select(RunRow.id, RunRow.process).where(alive))
    busy = {run_id for run_id, process in claimed if not is_gone(process)}
    return [
        path
        for path in paths
        if path.name not in known and (files.owner(path) or (None,))[0] not in busy
    ]


def leftovers(connection: Connection, results_dir: Path) -> list[Path]:
    """List the files of interrupted runs, and of runs whose process has ended.

    Only files with the mark of such a run are listed, so files of other logbooks are safe.
    """
    paths = files.listed(results_dir)
    if not paths:
        return []
    lost = RunRow.status.in_(("interrupted", "running"))
    columns = (
        RunRow.id,
        RunRow.status,
        RunRow.process,
        RunRow.fingerprint,
        RunRow.attempt,
        RunRow.started_at,
    )
    owners = {
        (row.id, files.mark(row.fingerprint, row.attempt, row.started_at))
        for row in connection.execute(select(*columns).where(lost))
        if row.status == "interrupted" or is_gone(row.process)
    }
    return [path for path in paths if files.owner(path) in owners]


def prunable(older_than: timedelta | None, statuses: Sequence[str]) -> list[ColumnElement[bool]]:
    """Return conditions on `run`: not running, older than `older_than`, of one of the statuses."""
    stale = and_(RunRow.status == "running", is_stale(RunRow.heartbeat_at))
    conditions: list[ColumnElement[bool]] = [or_(RunRow.status != "running", stale)]
    if older_than is not None:
        now = datetime.now(UTC)
        calendar = now - datetime.min.replace(tzinfo=UTC)
        conditions.append(RunRow.started_at < now - min(older_than, calendar))
    if statuses:
        chosen = RunRow.status.in_(statuses)
        conditions.append(or_(chosen, stale) if "interrupted" in statuses else chosen)
    return conditions


def delete_runs(connection: Connection, run_ids: Sequence[int]) -> tuple[int, list[str]]:
    """Delete runs that are not running; returns their number and the paths of their files.

    Their trials are no longer planned: nobody waits for what was deleted.
    """
    paths: list[str] = []
    deleted = 0
    for first in range(0, len(run_ids), _CHUNK):
        ids = run_ids[first : first + _CHUNK]
        ended = select(RunRow.id).where(RunRow.id.in_(ids), *prunable(None, ())).with_for_update()
        deleted_ids = connection.scalars(ended).all()
        of_runs = select(SeriesRow.path).where(SeriesRow.run_id.in_(deleted_ids)).distinct()
        paths += connection.scalars(of_runs)
        gone = select(RunRow.fingerprint).where(RunRow.id.in_(deleted_ids))
        connection.execute(delete(PlannedRow).where(PlannedRow.fingerprint.in_(gone)))
        connection.execute(delete(RunRow).where(RunRow.id.in_(deleted_ids)))
        deleted += len(deleted_ids)
    return deleted, paths


def remove(results_dir: Path, paths: Sequence[str]) -> list[str]:
    """Remove series files; returns the paths that could not be removed."""
    failures: list[str] = []
    for relative in paths:
        try:
            files.locate(results_dir, relative).unlink(missing_ok=True)
        except (OSError, LogbookError):
            failures.append(relative)
    with suppress(OSError):  # the folder is removed only if it is empty
        (results_dir / files.FOLDER).rmdir()
    return failures
