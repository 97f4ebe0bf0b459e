"""Parquet files: one source; date-times and text as text, the unit from a field's metadata."""

from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import compute as pc
from pyarrow import parquet

from seatrial.models.errors import RecordingError
from seatrial.models.recording.formats.text import names_of
from seatrial.models.recording.source import (
    LARGEST_BYTES,
    ReadOptions,
    Source,
    TextArray,
    check_size,
    foreign,
)
from seatrial.models.vessel.basis import Array


def read(path: Path, options: ReadOptions) -> list[Source]:
    """The columns of a Parquet file; raises RecordingError if it cannot be read."""
    with foreign(path, "a Parquet file"), parquet.ParquetFile(path) as file:
        check_size(path, file.metadata.num_rows * file.metadata.num_columns)
        groups = range(file.metadata.num_row_groups)
        size = sum(file.metadata.row_group(group).total_byte_size for group in groups)
        if size > 2 * LARGEST_BYTES:
            raise RecordingError(f"{path}: got {size / 1e6:.0f} MB, cut the recording")
        table = file.read(use_threads=False)
        titles = [str(name) for name in table.column_names]
        # pandas writes an index without a name so
        titles = ["index" if title == "__index_level_0__" else title for title in titles]
        names, written, units, repeated = names_of(titles)
        columns, left_out = {}, []
        for name, field, column in zip(names, table.schema, table.columns, strict=True):
            values = _column(column)
            if values is None:
                left_out.append(f"column {name}: of type {field.type}, no numbers and no text")
            else:
                columns[name] = values
            if unit := (field.metadata or {}).get(b"unit"):
                units[name] = unit.decode()
    return [Source(path.stem, path, columns, units, written, repeated, tuple(left_out))]


def _column(column: pa.ChunkedArray) -> Array | TextArray | None:
    """A column as numbers, NaN for null, or as text; None if it is neither, shape (N,)."""
    kind = column.type
    if pa.types.is_dictionary(kind):
        column, kind = column.cast(kind.value_type), kind.value_type
    if pa.types.is_boolean(kind):
        column = column.cast("int8")
    if pa.types.is_null(kind) or pa.types.is_decimal(kind) or pa.types.is_primitive(kind):
        if not pa.types.is_temporal(kind):
            return np.array(pc.cast(column, "float64", safe=False).to_numpy(), dtype=np.float64)
    if pa.types.is_temporal(kind) or pa.types.is_string(kind) or pa.types.is_large_string(kind):
        texts = pc.fill_null(column.cast("string"), "")
        return np.array(texts.to_pylist(), dtype=np.object_)
    return None
