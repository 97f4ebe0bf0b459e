"""Maintenance of a logbook: verification, and export of every table.

Series files are removed after their rows, and written before them, so that no row refers to a
missing file. A program that is killed in between leaves a file without a row: `verify` lists it.
"""

from collections import Counter
from collections.abc import Iterator
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING

from sqlalchemy import (
    JSON,
    BigInteger,
    Boolean,
    Connection,
    Float,
    Integer,
    Table,
    Text,
    cast,
    func,
    select,
)
from sqlalchemy.exc import DatabaseError

from seatrial.models.errors import LogbookError
from seatrial.runner.database import series_files as files
from seatrial.runner.database.claims import is_gone, stale
from seatrial.runner.database.engine import one_line
from seatrial.runner.database.records import Verification
from seatrial.runner.database.tables import Base, RunRow, SeriesRow, Utc

if TYPE_CHECKING:
    import pyarrow as pa
else:
    import lazy_loader

    pa = lazy_loader.load("pyarrow")

BATCH = 10_000  # rows held at once by an export


def verify(connection: Connection, results_dir: Path) -> Verification:
    """Check every page, foreign key and series file; `connection` may be read-only."""
    problems: list[tuple[str, str]] = []
    unused: list[Path] = []
    counts = [0, 0]
    try:
        problems += _damage(connection)
        numbers = (RunRow.id, SeriesRow.path.distinct())
        counts = [connection.scalar(select(func.count(number))) or 0 for number in numbers]
        problems += _wrong_files(connection, results_dir)
        unused = _orphans(connection, results_dir)
    except (DatabaseError, ValueError, TypeError) as error:  # the latter of a damaged cell
        problems.append(("database", one_line(error)))
    return Verification(counts[0], counts[1], problems, unused)


def _damage(connection: Connection) -> Iterator[tuple[str, str]]:
    """Run SQLite's own checks; PostgreSQL has its own tool (pg_amcheck)."""
    if connection.dialect.name != "sqlite":
        return
    for line in connection.exec_driver_sql("PRAGMA integrity_check").scalars():
        if line != "ok":
            yield "database", str(line)
    rows = connection.exec_driver_sql("PRAGMA foreign_key_check")
    for (table, parent), count in Counter((table, parent) for table, _, parent, _ in rows).items():
        yield f"table {table}", f"{count} rows refer to no {parent}"


def _wrong_files(connection: Connection, results_dir: Path) -> Iterator[tuple[str, str]]:
    """Read every series file once, and compare its checksum with that of its rows."""
    rows = connection.execute(select(SeriesRow.__table__).order_by(SeriesRow.run_id, SeriesRow.id))
    for (run_id, _), group in groupby(rows, attrgetter("run_id", "path")):
        series = [SeriesRow(**row._asdict()) for row in group]
        try:
            files.checked(results_dir, series[0])
        except LogbookError as error:
            yield f"run {run_id}, series {', '.join(file.kind for file in series)}", str(error)


def _orphans(connection: Connection, results_dir: Path) -> list[Path]:
    """List the series files that no row refers to, without those of running runs."""
    folder = results_dir / files.FOLDER
    paths = sorted(path for path in folder.glob("*") if path.is_file())  # before the rows are read
    known = {Path(path).name for path in connection.scalars(select(SeriesRow.path))}
    alive = select(RunRow.id, RunRow.process).where(RunRow.status == "running")
    claimed = connection.execute(alive.where(~stale(connection.dialect.name)))
    busy = {run_id for run_id, process in claimed if not is_gone(process)}
    unused = {path: files.NAME.fullmatch(path.name) for path in paths if path.name not in known}
    return [path for path, match in unused.items() if not match or int(match["run"]) not in busy]


def export(connection: Connection, folder: Path) -> list[Path]:
    """Write every table to `folder`, as TABLE.parquet and TABLE.csv; returns the paths.

    Times are UTC; JSON columns are text. A file is renamed into place when it is complete. Raises
    LogbookError if the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tables = Base.metadata.sorted_tables
        return [path for table in tables for path in _written(connection, table, folder)]
    except (OSError, ValueError, TypeError) as error:  # the latter of a damaged cell
        reason = getattr(error, "strerror", None) or one_line(error)
        raise LogbookError(f"{folder}: cannot export: {reason}") from error


def _written(connection: Connection, table: Table, folder: Path) -> list[Path]:
    from pyarrow import csv, parquet

    arrow = {Utc: pa.timestamp("us", tz="UTC"), Boolean: pa.bool_(), Float: pa.float64()}
    arrow |= {Integer: pa.int64(), BigInteger: pa.int64()}
    kinds = {each.name: arrow.get(type(each.type), pa.string()) for each in table.columns}
    texts = [cast(each, Text) if isinstance(each.type, JSON) else each for each in table.columns]
    query = select(*texts).order_by(*table.primary_key).execution_options(yield_per=BATCH)
    paths = [folder / f"{table.name}.{suffix}" for suffix in ("parquet", "csv")]
    unfinished = [path.with_name(f".{path.name}.tmp") for path in paths]
    schema = pa.schema(kinds)
    try:
        with (
            parquet.ParquetWriter(unfinished[0], schema, compression="zstd") as columns,
            csv.CSVWriter(unfinished[1], schema) as lines,
        ):
            for rows in connection.execute(query).partitions():
                values = zip(kinds.values(), zip(*rows, strict=True), strict=True)
                batch = pa.table([pa.array(own, kind) for kind, own in values], schema=schema)
                columns.write_table(batch)
                lines.write_table(batch)
        for temporary, path in zip(unfinished, paths, strict=True):
            temporary.replace(path)
    finally:
        for temporary in unfinished:
            temporary.unlink(missing_ok=True)
    return paths
