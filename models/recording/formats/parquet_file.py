"""Parquet files: one source; date-times and text as text, the unit from a field's metadata."""

from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import compute as pc
from pyarrow import parquet

from seatrial.models.errors import RecordingError
from seatrial.models.recording.formats.bounded import bounded
from seatrial.models.recording.formats.titles import names_of
from seatrial.models.recording.source import (
    LARGEST_BYTES,
    ReadOptions,
    Source,
    TextArray,
    check_size,
)
from seatrial.models.vessel.basis import Array

EXPECTED = "a Parquet file"


def read(path: Path, options: ReadOptions) -> list[Source]:
    """The columns of a Parquet file; raises RecordingError if it cannot be read."""
    with bounded(path, EXPECTED), parquet.ParquetFile(path) as file:
        check_size(path, file.metadata.num_rows * file.metadata.num_columns)
        groups = range(file.metadata.num_row_groups)
        size = sum(file.metadata.row_group(group).total_byte_size for group in groups)
        if size > 2 * LARGEST_BYTES:
            raise RecordingError(f"{path}: got {size / 1e6:.0f} MB, cut the recording")
        table = file.read(use_threads=False)
        titles = [str(name) for name in table.column_names]
        names, written, units, repeated = names_of(titles)
        columns = {}
        for name, field, column in zip(names, table.schema, table.columns, strict=True):
            if name not in repeated and (values := column_of(column)) is not None:
                columns[name] = values
            unit = (field.metadata or {}).get(b"unit")
            if unit:
                units[name] = unit.decode()
    return [Source(path.stem, path, columns, units, written, repeated)]


def column_of(column: pa.ChunkedArray) -> Array | TextArray | None:
    """A column as numbers, NaN for null, or as text; None if it is neither, shape (N,)."""
    kind = column.type
    if pa.types.is_dictionary(kind):
        column, kind = column.cast(kind.value_type), kind.value_type
    if pa.types.is_boolean(kind) or pa.types.is_integer(kind) or pa.types.is_floating(kind):
        if pa.types.is_boolean(kind):
            column = column.cast("int8")
        return np.array(pc.cast(column, "float64", safe=False).to_numpy(), dtype=np.float64)
    if pa.types.is_temporal(kind) or pa.types.is_string(kind) or pa.types.is_large_string(kind):
        texts = pc.fill_null(column.cast("string"), "")
        return np.array(texts.to_pylist(), dtype=np.object_)
    return None
