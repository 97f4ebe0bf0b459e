"""Files of tables: workbooks of Excel, a source a sheet, and Parquet files."""

import csv
import io
from dataclasses import replace
from datetime import date, time
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import compute as pc
from pyarrow import parquet

from seatrial.models.errors import RecordingError
from seatrial.models.recording.formats.text import table
from seatrial.models.recording.source import Contents, ReadOptions, Values, check_size, table_source


def read_excel(path: Path, options: ReadOptions) -> Contents:
    """The sheets of a workbook, read like the text that their cells would be."""
    import openpyxl

    sources, left_out = [], []
    text = replace(options.text, separator=",", decimal=".", encoding=None, comment=None)
    book = openpyxl.load_workbook(path, read_only=True, data_only=True)
    for sheet in book.worksheets:
        check_size(path, (sheet.max_row or 0) * (sheet.max_column or 0))
        written = io.StringIO()
        writer = csv.writer(written, lineterminator="\n")
        for row in sheet.iter_rows(max_col=sheet.max_column, values_only=True):
            cells = [c.isoformat() if isinstance(c, date | time) else c for c in row]
            cells = [int(c) if isinstance(c, bool) else c for c in cells]
            writer.writerow([] if all(c is None for c in cells) else cells)
        try:
            sources.append(table(path, written.getvalue().encode(), text, sheet.title))
        except RecordingError as error:
            left_out.append(f"sheet {sheet.title}: {str(error).removeprefix(f'{path}: ')}")
    book.close()
    return sources, left_out


def read_parquet(path: Path, options: ReadOptions) -> Contents:
    """The columns of a Parquet file, date-times as text, units from the metadata of fields."""
    with parquet.ParquetFile(path) as file:
        groups = [file.metadata.row_group(i) for i in range(file.metadata.num_row_groups)]
        check_size(path, file.metadata.num_rows * file.metadata.num_columns)
        check_size(path, sum(group.total_byte_size for group in groups) // 16)  # of long texts
        stored = file.read(use_threads=False)
    columns: list[Values] = []
    titles, units, left_out = [], [], []
    for field, column in zip(stored.schema, stored.columns, strict=True):
        values = _column(column)
        if values is None:
            left_out.append(f"column {field.name}: of type {field.type}, no numbers and no text")
        else:
            columns.append(values)
            # pandas writes an index without a name so
            titles.append("index" if field.name == "__index_level_0__" else field.name)
            units.append((field.metadata or {}).get(b"unit", b"").decode())
    return [table_source(path.stem, path, titles, columns, units)], left_out


def _column(column: pa.ChunkedArray) -> Values | None:
    """A column as numbers, NaN for null, or as text; None if it is neither, shape (N,)."""
    if pa.types.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    kind = column.type
    if pa.types.is_temporal(kind) or pa.types.is_string(kind) or pa.types.is_large_string(kind):
        return np.array(pc.fill_null(column.cast("string"), "").to_pylist(), dtype=np.object_)
    if pa.types.is_boolean(kind):
        column = column.cast("int8")
    if pa.types.is_primitive(kind) or pa.types.is_null(kind) or pa.types.is_decimal(kind):
        return np.array(pc.cast(column, "float64", safe=False).to_numpy(), dtype=np.float64)
    return None
