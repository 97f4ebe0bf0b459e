"""Maintenance of a logbook: verification, and which runs may be deleted.

Series files are removed after their rows, and written before them, so that no row refers to a
missing file. A program that is killed in between leaves a file without a row: `verify` lists it.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import groupby
from operator import attrgetter
from pathlib import Path

from sqlalchemy import ColumnElement, Connection, and_, func, or_, select
from sqlalchemy.exc import DatabaseError

from seatrial.models.errors import LogbookError
from seatrial.runner.database import series_files as files
from seatrial.runner.database.engine import one_line
from seatrial.runner.database.liveness import is_gone, is_stale
from seatrial.runner.database.records import LogbookDefect, SeriesFile, Verification
from seatrial.runner.database.tables import RunRow, SeriesRow


def verify(connection: Connection, results_dir: Path) -> Verification:
    """Check every page, foreign key and series file; `connection` may be read-only."""
    problems: list[LogbookDefect] = []
    unused: list[Path] = []
    counts = [0, 0]
    try:
        problems += _damage(connection)
        numbers = (RunRow.id, SeriesRow.path.distinct())
        counts = [connection.scalar(select(func.count(number))) or 0 for number in numbers]
        problems += _wrong_files(connection, results_dir)
        unused = orphans(connection, results_dir)
    except (DatabaseError, ValueError, TypeError) as error:  # the latter of a damaged cell
        problems.append(LogbookDefect("database", one_line(error)))
    return Verification(counts[0], counts[1], problems, unused)


def _damage(connection: Connection) -> Iterator[LogbookDefect]:
    """Run SQLite's own checks; PostgreSQL has its own tool (pg_amcheck)."""
    if connection.dialect.name != "sqlite":
        return
    for line in connection.exec_driver_sql("PRAGMA integrity_check").scalars():
        if line != "ok":
            yield LogbookDefect("database", str(line))
    rows = connection.exec_driver_sql("PRAGMA foreign_key_check")
    for (table, parent), count in Counter((table, parent) for table, _, parent, _ in rows).items():
        yield LogbookDefect(f"table {table}", f"{count} rows refer to no {parent}")


def _wrong_files(connection: Connection, results_dir: Path) -> Iterator[LogbookDefect]:
    """Read every series file once, and compare its checksum with that of its rows."""
    rows = connection.execute(select(SeriesRow.__table__).order_by(SeriesRow.run_id, SeriesRow.id))
    for (run_id, _), group in groupby(rows, attrgetter("run_id", "path")):
        series = [SeriesFile(r.kind, r.path, r.n_rows, r.sha256, r.columns) for r in group]
        try:
            files.checked(results_dir, series[0])
        except LogbookError as error:
            kinds = ", ".join(file.kind for file in series)
            yield LogbookDefect(f"run {run_id}, series {kinds}", str(error))


def orphans(connection: Connection, results_dir: Path) -> list[Path]:
    """List the series files that no row refers to, without those of running runs."""
    paths = files.listed(results_dir)  # before the rows are read
    if not paths:
        return []
    known = {Path(path).name for path in connection.scalars(select(SeriesRow.path))}
    alive = and_(RunRow.status == "running", ~is_stale(connection.dialect.name))
    claimed = connection.execute(select(RunRow.id, RunRow.process).where(alive))
    busy = {run_id for run_id, process in claimed if not is_gone(process)}
    return [path for path in paths if path.name not in known and files.owner(path) not in busy]


def prunable(dialect: str, statuses: Sequence[str] = ()) -> list[ColumnElement[bool]]:
    """Return conditions on `run`: not running, and of one of the statuses, if any are given."""
    stale = and_(RunRow.status == "running", is_stale(dialect))
    conditions: list[ColumnElement[bool]] = [or_(RunRow.status != "running", stale)]
    if statuses:
        chosen = RunRow.status.in_(statuses)
        conditions.append(or_(chosen, stale) if "interrupted" in statuses else chosen)
    return conditions
