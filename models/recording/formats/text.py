"""Text files: CSV with any separator, columns between white space, exports of InfluxDB."""

import csv
import io
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import reduce
from itertools import islice
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
from pyarrow import compute as pc
from pyarrow import csv as arrow_csv

from seatrial.models.errors import RecordingError
from seatrial.models.recording.formats.columns import FEW, NUMBER, table_source
from seatrial.models.recording.source import (
    MISSING,
    Contents,
    ReadOptions,
    Source,
    TextOptions,
    check_size,
)

SEPARATORS = "\t;|,"  # in this order where they fit equally well
SAMPLE_LINES = 60  # that the layout is found from
MOST_HEADER_LINES = 5
MOST_COLUMNS = 10_000
TITLED = re.compile(rb"\s*[^#\s]")
DATE = re.compile(r"\d{4}[-/.]\d\d?[-/.]\d\d?|\d\d?[-/.]\d\d?[-/.]\d{4}|\d\d?:\d\d", re.ASCII)
SIZES = {"1", "2", "4", "8"}  # bytes of the columns of a glider, in a line below the units
LONG = {  # columns of a table with a row a value, by the names that InfluxDB gives them
    "_time": ("_time", "time", "timestamp"), "_value": ("_value", "value"),
    "_field": ("_field", "field", "path", "name", "variable", "signal", "parameter", "topic"),
}  # fmt: skip
MARKS = ("%", "!", "//")  # of comments, where a text begins with two


def read(path: Path, options: ReadOptions) -> Contents:
    """The columns of a text file; raises RecordingError if it cannot be read as a table."""
    data, left_out = decoded(path, options.text.encoding)
    if b"% LOGSTART" in data[:4096]:  # of MOOS
        lines = (b"\t".join(line.split(None, 3)) for line in data.replace(b'"', b"'").splitlines())
        lines = (line for line in lines if not line.startswith(b"%"))
        data = b"\n".join([b"_time\t_field\tprocess\t_value", *lines])
    parts = {b"": data}
    if re.search(rb"^#(group|datatype|default)\b", data, re.MULTILINE):  # tables of InfluxDB
        parts = {}
        for part in re.split(rb"\n\r?\n", data):
            header = next((line for line in part.split(b"\n") if TITLED.match(line)), b"")
            parts[header] = parts.get(header, b"") + b"\n" + part
        parts.pop(b"", None)
    return [s for part in parts.values() for s in _wide(table(path, part, options.text))], left_out


def decoded(path: Path, encoding: str | None) -> tuple[bytes, tuple[str, ...]]:
    """The text of a file as UTF-8, and what is to be said of it.

    Raises RecordingError if it is no text.
    """
    data, said = path.read_bytes(), tuple[str, ...]()
    encoding = encoding or ("utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig")
    try:
        data = data if data.isascii() else data.decode(encoding).removeprefix("\ufeff").encode()
        wrong = data.find(b"\0")
    except (UnicodeError, LookupError) as error:
        wrong = getattr(error, "start", 0)
        if encoding == "utf-8-sig" and not re.search(rb"[\0\x80-\x9f]", data):
            wrong, data = -1, data.decode("latin-1").encode()
            said = ("the text is not UTF-8: read as latin-1",)
    if wrong >= 0:
        line = data.count(b"\n", 0, wrong) + 1
        raise RecordingError(
            f"{path}, line {line}: got binary data or text that is not {encoding[:6].rstrip('-')}, "
            "expected a text file; excitation.text.encoding=latin-1 reads another encoding"
        )
    if not data.strip():
        raise RecordingError(f"{path}: is empty, expected a header and samples")
    return data, said


def table(path: Path, data: bytes, text: TextOptions, name: str | None = None) -> Source:
    """The columns of a text as a source; raises RecordingError if it is not a table."""
    data, commented, separator, white = _plain(data, text)
    head = list(islice(_rows(data, separator), SAMPLE_LINES))
    rows = [row for _, row in head]
    _pad(rows)
    decimal = text.decimal or "."
    if text.decimal is None and separator != ",":
        cells = [cell for row in rows for cell in row]
        counts = [sum(mark in c and _is_number(c, mark) for c in cells) for mark in ",."]
        decimal = "," if counts[0] > counts[1] else "."
    start, header = 0, text.header_lines
    if header is None:
        start, header = _header(rows, decimal, white)
    before = start + header
    if len(head) <= before:
        raise RecordingError(f"{path}: got a header and no rows, expected samples below it")
    titles = rows[start:before]
    width = len((titles or rows[before:])[0])
    if width > MOST_COLUMNS:
        raise RecordingError(f"{path}: got {width} columns, expected at most {MOST_COLUMNS}")
    if text.names and len(text.names) != width:
        raise RecordingError(
            f"{path}: got {width} columns, expected {len(text.names)} as in excitation.text.names"
        )
    check_size(path, (data.count(b"\n") + 1) * width)
    above = [w for line in commented for w in (line.split(), line.split(separator))
             if len(w) == width and not any(map(_is_number, w))]  # fmt: skip
    titles, blank = titles or above[-1:], [""] * width
    written = [title.strip() for title in titles[0]] if titles else blank
    units = titles[1] if len(titles) > 1 and len(titles[1]) == width else blank
    top = head[before - 1][0] if before else 0  # lines above the first sample
    columns, said = _cells(path, data, separator, written, top)

    def cell(row: int, place: int) -> tuple[str, str]:
        below = (each for each in _rows(data, separator) if each[0] > top)
        samples = (each for each in below if len(each[1]) == width
                   and [text.strip() for text in each[1]] != written)  # fmt: skip
        line, found = next(islice(samples, row, None))
        return f"line {line}", found[place]

    triples = zip(text.names or written, columns, units, strict=True)
    return table_source(name or path.stem, path, triples, said, cell, decimal)


def _plain(data: bytes, text: TextOptions) -> tuple[bytes, list[str], str, bool]:
    """The text without comments, those above the table, the separator, and if that is white."""
    data, commented = re.sub(rb"\n[ \t]+(?=\r?\n)", b"\n", data), list[str]()
    twice = (m for m in MARKS if re.match(rb"(%b[^\n]*\n){2}" % m.encode(), data))
    if mark := text.comment and next(twice, text.comment):
        sign = rb"[ \t]*" + re.escape(mark.encode()) + rb"[^\r\n]*"
        leading = re.match(rb"(?:(?:" + sign + rb")?\r?\n)*", data)
        lines = leading[0].decode().split("\n") if leading else []
        commented = [line.strip().lstrip(mark).strip() for line in lines]
        data = re.sub(rb"^" + sign, b"", data, flags=re.M) if mark.encode() in data else data
    data = b"\n" * text.skip_lines + b"".join(data.split(b"\n", text.skip_lines)[text.skip_lines :])
    separator: str | None = text.separator
    if separator is None:  # that which cuts most lines into equally many cells
        lines = [e for e in data[:65536].decode(errors="replace").split("\n") if e.strip()]
        lines = lines[:SAMPLE_LINES]
        counts = {mark: Counter(e.count(mark) for e in lines if mark in e) for mark in SEPARATORS}
        words = (e.split() for e in lines)  # numbers between white space
        rows = (row for row in words if all(_is_number(c) or c.lower() in MISSING for c in row))
        counts[" "] = Counter(len(row) for row in rows if len(row) > 1)
        separator = max(counts, key=lambda mark: max(counts[mark].values(), default=0))
    if separator != " ":
        return data, commented, separator, False
    return b"\n".join(b"\t".join(e.split()) for e in data.split(b"\n")), commented, "\t", True


def _rows(data: bytes, separator: str) -> Iterator[tuple[int, list[str]]]:
    """The line number on which each row ends, and its cells; blank lines are skipped."""
    lines = io.TextIOWrapper(io.BytesIO(data), encoding="utf-8", newline="")
    reader = csv.reader(lines, delimiter=separator)
    return ((reader.line_num, row) for row in reader if row)


def _is_number(cell: str, decimal: str = ".") -> bool:
    return bool(NUMBER.fullmatch(cell.strip().replace(decimal, ".")))


def _pad(rows: list[list[str]]) -> None:
    """Add a title, an empty one, to a header that is shorter by one than the rows below it.

    Programs number rows, or end them with a separator, and do not say so in the header.
    """
    usual = Counter(map(len, rows)).most_common(1)[0][0] if rows else 0
    full = [row for row in rows if len(row) == usual > 1]
    ended = bool(full) and not any(row[-1].strip() for row in full)
    first = full[0][0].strip() if len(full) > 1 else ""
    numbers = [str(int(first) + k) for k in range(len(full))] if first.isdigit() else None
    if ended or numbers == [row[0].strip() for row in full]:
        for row in (row for row in rows if len(row) == usual - 1):
            row.insert(usual if ended else 0, "")


def _header(rows: list[list[str]], decimal: str, white: bool) -> tuple[int, int]:
    """Rows before the header, and rows of the header: those above the first sample.

    A sample has a number or a date; between white space, where the words of a title are cells, it
    has nothing else. Lines of one cell or of another length than the samples are a preamble.
    """
    for first, row in enumerate(rows):
        filled = [cell.strip() for cell in row if cell.strip().lower() not in MISSING]
        sampled = [_is_number(cell, decimal) or bool(DATE.match(cell)) for cell in filled]
        sizes = first > 1 and len(row) == len(rows[first - 1]) > 1 and set(filled) <= SIZES
        if (all(sampled) if white else any(sampled)) and not sizes:
            break
    else:
        return 0, min(len(rows), 1)
    full = [sum(bool(cell.strip()) for cell in row) for row in rows[:first]]
    width = len(rows[first])
    starts = [k for k in range(first) if len(rows[k]) == width and full[k] >= min(width, 2)]
    if not starts:  # a preamble, or a header that is too short
        return (0, 1) if first == 1 < len(rows[0]) and not white else (first, 0)
    start = max(starts, key=lambda k: full[k])
    return start, first - start if first - start <= MOST_HEADER_LINES else 1


def _cells(
    path: Path, data: bytes, separator: str, titles: Sequence[str], top: int
) -> tuple[list[pa.Array], list[str]]:
    """The cells of each column below `top` lines, and how many rows are left out.

    These are of another length than the `titles`, or repeat them, as a logger does that starts
    again. Raises RecordingError if they are not few.
    """
    names, other = [str(place) for place in range(len(titles))], list[arrow_csv.InvalidRow]()
    texts = arrow_csv.ConvertOptions(
        column_types=dict.fromkeys(names, pa.string()), strings_can_be_null=False
    )
    reading = arrow_csv.ReadOptions(
        use_threads=False, block_size=len(data), skip_rows=top, column_names=names
    )

    def skip(row: arrow_csv.InvalidRow) -> str:
        other.append(row)
        return "skip"

    parsing = arrow_csv.ParseOptions(
        delimiter=separator, newlines_in_values=True, invalid_row_handler=skip
    )
    stored = arrow_csv.read_csv(pa.py_buffer(data), reading, parsing, texts)
    if len(other) >= FEW * (stored.num_rows + len(other)):
        below = (each for each in _rows(data, separator) if each[0] > top)
        line, row = next(each for each in below if len(each[1]) != len(titles))
        raise RecordingError(
            f"{path}, line {line}: got {len(row)} cells, expected {len(titles)} as in the "
            f"header (separator {separator!r})"
        )
    columns = [pc.utf8_trim_whitespace(column.combine_chunks()) for column in stored.columns]
    counts = {f"{len(other)} rows with more or fewer than {len(titles)} cells": len(other)}
    again = reduce(pc.and_, map(pc.equal, columns, titles))
    if any(titles) and again.true_count:
        counts[f"{again.true_count} lines that repeat the header"] = again.true_count
        columns = [pc.filter(column, pc.invert(again)) for column in columns]
    return columns, [reason for reason, there in counts.items() if there]


def _wide(source: Source) -> list[Source]:
    """The sources of a table with a row a value: one for each measurement and its tags."""
    known = {k: next((n for n in own if n in source.columns), "") for k, own in LONG.items()}
    if not all(known.values()) or source.columns[known["_field"]].dtype != np.object_:
        return [source]
    frame = pd.DataFrame(source.columns).rename(columns={n: k for k, n in known.items()})
    texts, keys = [*frame.select_dtypes(exclude="number")], ["_time", "_field"]
    tags = [name for name in texts if name not in (*LONG, "_start", "_stop", "result")
            and (name == "_measurement" or frame[name].nunique() > 1)]  # fmt: skip
    if "_time" in texts:
        times = pd.to_datetime(frame["_time"], format="ISO8601", utc=True, errors="coerce")
        frame["_time"] = (times - pd.Timestamp(0, tz="UTC")).dt.total_seconds()
    lost = ", ".join(name for name in frame if name not in (*tags, *LONG))
    again = frame.duplicated([*tags, *keys]).sum()
    counts = {f"columns {lost}: not of the values of this long table": lost,
              f"{frame['_time'].isna().sum()} values have no time": frame["_time"].isna().any(),
              f"{again} values at times that repeat": again}  # fmt: skip
    result = []
    for key, rows in frame.groupby(tags) if tags else [((), frame)]:
        wide = rows.drop_duplicates(keys).pivot(index="_time", columns="_field", values="_value")
        wide = wide.fillna("").astype(str) if "_value" in texts else wide
        columns = {"_time": wide.index.to_numpy()} | {
            str(n): v.to_list() if "_value" in texts else v.to_numpy() for n, v in wide.items()
        }
        triples = ((n, cells, "s" if n == "_time" else "") for n, cells in columns.items())
        result.append(table_source("/".join(map(str, key)) or source.name, source.path, triples))
    said = (*source.left_out, *(reason for reason, there in counts.items() if there))
    return [replace(result[0], left_out=(*said, *result[0].left_out)), *result[1:]]
