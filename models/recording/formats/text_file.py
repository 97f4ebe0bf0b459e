"""Text files: CSV with any separator, and columns between white space (.dat, .txt)."""

from itertools import islice
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING

import numpy as np

from seatrial.models.errors import RecordingError
from seatrial.models.recording.formats.text_layout import TextLayout, cells, layout_of
from seatrial.models.recording.source import (
    LARGEST_BYTES,
    MAX_NUMBER,
    FileCell,
    ReadOptions,
    Source,
    TextArray,
    TextOptions,
    check_size,
)
from seatrial.models.vessel.basis import Array

if TYPE_CHECKING:
    import pyarrow as pa

NUMBER = r"^(?P<number>[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)$"
MISSING = r"^([+-]?[nN][aA][nN])?$"
MOST_TEXTS = 4_000_000  # different cells of text
MARKS = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}


def read(path: Path, options: ReadOptions) -> list[Source]:
    """The columns of a text file; raises RecordingError if it cannot be read as a table."""
    text = options.text
    layout = layout_of(path, _content(path, text, options.format or "csv"), text)
    names, written, units, repeated = layout.named()
    columns: dict[str, Array | TextArray] = {}
    texts = _texts(path, layout, [i for i, name in enumerate(names) if name not in repeated])
    kept = 0
    for name, column in zip((n for n in names if n not in repeated), texts, strict=True):
        columns[name] = _values(column, layout.decimal)
        if columns[name].dtype == np.object_:
            kept += len(set(map(id, columns[name])))
            if kept > MOST_TEXTS:
                raise RecordingError(f"{path}, column {name}: got text, expected numbers")
    positions = {name: i for i, name in enumerate(names)}

    def cell(row: int, column: str) -> FileCell:
        """The line on which a row ends, and the cell of a column; blank lines are not counted."""
        line, found = next(islice(cells(path, layout), layout.rows_before + row, None))
        return FileCell(f"line {line}", found[positions[column]])

    return [Source(path.stem, path, columns, units, written, repeated, cell)]


def _content(path: Path, text: TextOptions, format_: str) -> bytes:
    """The text of a file as UTF-8, without comments; raises RecordingError if it is no text."""
    expected = "expected a CSV file" if format_ == "csv" else "expected a text file"
    if path.stat().st_size > LARGEST_BYTES:
        raise RecordingError(
            f"{path}: got {path.stat().st_size / 1e6:.0f} MB of text, expected at most "
            f"{LARGEST_BYTES / 1e6:.0f}; cut the recording, or convert it to Parquet"
        )
    data = path.read_bytes()
    encoding = text.encoding or MARKS.get(data[:2])
    if encoding is None and b"\0" in data:
        line = data.count(b"\n", 0, data.index(b"\0")) + 1
        raise RecordingError(f"{path}, line {line}: got binary data, {expected}")
    try:
        if encoding is None:
            data = data.removeprefix(b"\xef\xbb\xbf")
            data.decode()
        else:
            data = data.decode(encoding).removeprefix("\ufeff").encode()
    except UnicodeError as error:
        if encoding is not None:
            raise RecordingError(
                f"{path}: got text that is not {encoding}, {expected} in that encoding"
            ) from error
        if format_ != "dat" or any(0x80 <= byte < 0xA0 for byte in data):
            start = getattr(error, "start", 0)
            line = data.count(b"\n", 0, start) + 1
            raise RecordingError(
                f"{path}, line {line}: got binary data or text that is not UTF-8, {expected}; "
                "excitation.text.encoding=latin-1 reads another encoding"
            ) from error
        data = data.decode("latin-1").encode()
    if b"\0" in data:
        raise RecordingError(f"{path}: got binary data, {expected}")
    if not data.strip():
        raise RecordingError(f"{path}: is empty, expected a header and samples")
    return data


def _texts(path: Path, layout: TextLayout, indices: list[int]) -> "list[pa.ChunkedArray]":
    """The columns at the given indices, below the header, as text without surrounding spaces."""
    import pyarrow as pa  # slow to import
    from pyarrow import compute as pc
    from pyarrow import csv as arrow_csv

    check_size(path, (layout.data.count(b"\n") + 1) * layout.width)
    names = [str(index) for index in range(layout.width)]
    types = {names[index]: pa.string() for index in indices}
    try:
        table = arrow_csv.read_csv(
            pa.py_buffer(layout.data),
            arrow_csv.ReadOptions(
                use_threads=False,
                block_size=len(layout.data),
                skip_rows=layout.lines_before,
                column_names=names,
            ),
            arrow_csv.ParseOptions(delimiter=layout.separator, newlines_in_values=True),
            arrow_csv.ConvertOptions(
                include_columns=list(types), column_types=types, strings_can_be_null=False
            ),
        )
    except pa.ArrowInvalid as error:
        raise _not_a_row(path, layout, str(error)) from error
    return [pc.utf8_trim_whitespace(column) for column in table.columns]


def _not_a_row(path: Path, layout: TextLayout, reason: str) -> RecordingError:
    """Error for the first row whose length differs from the header, else the reader's reason."""
    for line, row in islice(cells(path, layout), layout.rows_before, None):
        if len(row) != layout.width:
            return RecordingError(
                f"{path}, line {line}: got {len(row)} cells, expected {layout.width} as in the "
                f"header (separator {layout.separator!r})"
            )
    return RecordingError(f"{path}: {shorten(reason, 600)}, expected comma-separated values")


def _values(column: "pa.ChunkedArray", decimal: str) -> Array | TextArray:
    """A column as numbers, NaN for an empty cell; as text if a cell is something else, (N,)."""
    from pyarrow import compute as pc

    pointed = column if decimal == "." else pc.replace_substring(column, decimal, ".")
    written = pc.struct_field(pc.extract_regex(pointed, NUMBER), "number")  # null: not a number
    values = np.array(pc.utf8_ltrim(written, "+").cast("float64").to_numpy())
    missing = pc.match_substring_regex(column, MISSING).to_numpy()
    if np.all((np.abs(values) < MAX_NUMBER) | missing):
        return values
    coded = pointed.combine_chunks().dictionary_encode()
    texts = np.array(coded.dictionary.to_pylist(), dtype=np.object_)
    return np.asarray(texts[coded.indices.to_numpy()])
