"""Export of every table as Parquet and CSV, from one snapshot of the database.

Slow to import, because pyarrow is.
"""

import json
from collections.abc import Iterator, Sequence
from pathlib import Path

import pyarrow as pa
from pyarrow import csv, parquet
from sqlalchemy import JSON, Boolean, Connection, Float, Integer, Table, select
from sqlalchemy.types import TypeEngine

from seatrial.models.errors import LogbookError
from seatrial.runner.database.checked_rows import read
from seatrial.runner.database.tables import Base, Utc

FORMATS = ("parquet", "csv")
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
    except OSError as error:
        raise LogbookError(f"{folder}: cannot export: {error.strerror or error}") from error
    except UnicodeEncodeError as error:
        raise LogbookError(f"{folder}: cannot export: expected a name in UTF-8") from error


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
    statement = select(table).order_by(*table.primary_key)
    for rows in read(connection, statement, _BATCH):
        arrays = [
            pa.array(_texts(column.type, values), field.type)
            for column, field, values in zip(
                table.columns, schema, zip(*rows, strict=True), strict=True
            )
        ]
        yield pa.Table.from_arrays(arrays, schema=schema)


def _texts(column: TypeEngine[object], values: Sequence[object]) -> Sequence[object]:
    """Convert JSON values to text."""
    if not isinstance(column, JSON):
        return values
    return [None if value is None else json.dumps(value, ensure_ascii=False) for value in values]


def _arrow(column: TypeEngine[object]) -> pa.DataType:
    """Return the Arrow type of a column."""
    if isinstance(column, Utc):
        return pa.timestamp("us", tz="UTC")
    if isinstance(column, JSON):
        return pa.string()
    for kind, arrow in ((Boolean, pa.bool_()), (Integer, pa.int64()), (Float, pa.float64())):
        if isinstance(column, kind):
            return arrow
    return pa.string()
