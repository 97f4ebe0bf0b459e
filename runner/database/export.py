"""Export of every table as Parquet and CSV, from one snapshot of the database.

Slow to import, because pyarrow is.
"""

from collections.abc import Iterator
from pathlib import Path

import pyarrow as pa
from pyarrow import csv, parquet
from sqlalchemy import JSON, Boolean, Connection, Float, Integer, Table, Text, cast, select
from sqlalchemy.types import TypeEngine

from seatrial.models.errors import LogbookError
from seatrial.runner.database.engine import one_line
from seatrial.runner.database.tables import Base, Utc

FORMATS = ("parquet", "csv")
ARROW: dict[type, pa.DataType] = {
    Utc: pa.timestamp("us", tz="UTC"), Boolean: pa.bool_(), Integer: pa.int64(),
    Float: pa.float64(),
}  # fmt: skip
_BATCH = 10_000  # rows held at once


def export(connection: Connection, folder: Path) -> list[Path]:
    """Write every table to `folder`, as TABLE.parquet and TABLE.csv; returns the paths.

    Times are UTC; JSON columns are text. A file is renamed into place when it is complete. Raises
    LogbookError if the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return [
            path
            for table in Base.metadata.sorted_tables
            for path in _table(connection, table, folder)
        ]
    except (OSError, ValueError, TypeError) as error:  # the latter of a damaged cell
        reason = getattr(error, "strerror", None) or one_line(error)
        raise LogbookError(f"{folder}: cannot export: {reason}") from error


def _table(connection: Connection, table: Table, folder: Path) -> list[Path]:
    schema = pa.schema([(column.name, _arrow(column.type)) for column in table.columns])
    paths = [folder / f"{table.name}.{suffix}" for suffix in FORMATS]
    unfinished = [path.with_name(f".{path.name}.tmp") for path in paths]
    try:
        with (
            parquet.ParquetWriter(unfinished[0], schema, compression="zstd") as columns,
            csv.CSVWriter(unfinished[1], schema) as lines,
        ):
            for batch in _batches(connection, table, schema):
                columns.write_table(batch)
                lines.write_table(batch)
        for temporary, path in zip(unfinished, paths, strict=True):
            temporary.replace(path)
    finally:
        for temporary in unfinished:
            temporary.unlink(missing_ok=True)
    return paths


def _batches(connection: Connection, table: Table, schema: pa.Schema) -> Iterator[pa.Table]:
    texts = [cast(each, Text) if isinstance(each.type, JSON) else each for each in table.columns]
    statement = select(*texts).order_by(*table.primary_key).execution_options(yield_per=_BATCH)
    for rows in connection.execute(statement).partitions():
        columns = zip(schema, zip(*rows, strict=True), strict=True)
        arrays = [pa.array(values, field.type) for field, values in columns]
        yield pa.Table.from_arrays(arrays, schema=schema)


def _arrow(column: TypeEngine[object]) -> pa.DataType:
    """Return the Arrow type of a column; JSON is text."""
    return next((arrow for kind, arrow in ARROW.items() if isinstance(column, kind)), pa.string())
