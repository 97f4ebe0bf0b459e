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
from textwrap import shorten

import numpy as np
import pandas as pd
import pyarrow as pa
from pyarrow import compute as pc
from pyarrow import csv as arrow_csv

from seatrial.models.errors import RecordingError
from seatrial.models.recording.source import (
    MISSING,
    Contents,
    ReadOptions,
    Source,
    TextOptions,
    Values,
    check_size,
    degrees,
    table_source,
)  # fmt: skip

SEPARATORS = "\t;|,"  # in this order where they fit equally well
SAMPLE_LINES = 60  # that the layout is found from
MOST_HEADER_LINES = 5
MOST_COLUMNS = 10_000
MAX_NUMBER = 1e30  # larger numbers are not measurements, and their squares could overflow
FEW = 0.5  # share of cells, or rows, below which those that do not fit are left out
MOST_WORDS = 5  # different cells of a column that are named
NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
TITLED = re.compile(rb"\s*[^#\s]")
WHITE = re.compile(rb"[ \t\v\f]+")
DATE = re.compile(r"\d{4}[-/.]\d\d?[-/.]\d\d?|\d\d?[-/.]\d\d?[-/.]\d{4}|\d\d?:\d\d", re.ASCII)
ANGLE = (
    r"^(?P<d>\d{1,3})\s*[°º\s]\s*(?P<m>\d{1,2}(?:[.,]\d+)?)\s*['’′]?\s*"
    r"(?P<s>\d{0,2}(?:[.,]\d+)?)\s*(?:[\"″]|'')?\s*(?P<side>[NSEWO])$"
)
IN_DEGREES = "degrees and minutes, read as degrees"
SIZES = {"1", "2", "4", "8"}  # bytes of the columns of a glider, in a line below the units
INFLUX = {  # columns of a table with a row a value, by the names that InfluxDB gives them
    "_time": ("_time", "time", "timestamp"), "_value": ("_value", "value"),
    "_field": ("_field", "field", "path", "name", "variable", "signal", "parameter", "topic"),
}  # fmt: skip
MARKS = (b"%", b"!", b"//")  # of lines above a table that are comments


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
    sources = [s for part in parts.values() for s in _wide(table(path, part, options.text))]
    names = Counter(source.name for source in sources)
    sources = [
        replace(source, name=f"{source.name}/{i}") if names[source.name] > 1 else source
        for i, source in enumerate(sources, 1)
    ]
    return sources, left_out


def decoded(path: Path, encoding: str | None) -> tuple[bytes, tuple[str, ...]]:
    """The text of a file as UTF-8, and what is to be said of it.

    Raises RecordingError if it is no text.
    """
    data = path.read_bytes()
    encoding = encoding or ("utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig")
    said: tuple[str, ...] = ()
    try:
        data = data if data.isascii() else data.decode(encoding).removeprefix("\ufeff").encode()
        wrong = data.find(b"\0")
    except UnicodeError as error:
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
    head = list(islice(_rows(path, data, separator), SAMPLE_LINES))
    usual = Counter(len(row) for _, row in head).most_common(1)[0][0] if head else 0
    if usual > 1 and not any(row[-1].strip() for _, row in head if len(row) == usual):
        # a separator at the end of the rows, which the header lacks
        head = [(line, [*row, ""] if len(row) == usual - 1 else row) for line, row in head]
    counted = [row[0].strip() for _, row in head if len(row) == usual]
    if counted[1:] and counted[0].isdigit() and usual > 1:
        numbers = [str(int(counted[0]) + k) for k in range(len(counted))]
        if counted == numbers:  # rows that are numbered, of which the header says nothing
            head = [(line, ["", *row] if len(row) == usual - 1 else row) for line, row in head]
    decimal = text.decimal or "."
    if text.decimal is None and separator != ",":
        cells = [cell for _, row in head for cell in row]
        counts = [sum(mark in c and _is_number(c, mark) for c in cells) for mark in ",."]
        decimal = "," if counts[0] > counts[1] else "."
    start, header = 0, text.header_lines
    if header is None:
        start, header = _header([row for _, row in head], decimal, white)
    before = start + header
    if len(head) <= before:
        raise RecordingError(f"{path}: got a header and no rows, expected samples below it")
    titles = [row for _, row in head[start:before]]
    width = len(titles[0] if titles else head[before][1])
    if width > MOST_COLUMNS:
        raise RecordingError(f"{path}: got {width} columns, expected at most {MOST_COLUMNS}")
    if text.names and len(text.names) != width:
        raise RecordingError(
            f"{path}: got {width} columns, expected {len(text.names)} as in excitation.text.names"
        )
    for words in (w for line in reversed(commented) for w in (line.split(separator), line.split())):
        if not titles and len(words) == width and not any(map(_is_number, words)):
            titles = [words]
    names = text.names or (titles[0] if titles else [""] * width)
    units = titles[1] if len(titles) > 1 and len(titles[1]) == width else [""] * width
    top = head[before - 1][0] if before else 0  # lines above the first sample
    check_size(path, (data.count(b"\n") + 1) * width)
    columns, reasons = list[Values](), list[str]()
    header_row = [cell.strip() for cell in titles[0]] if titles else [""] * width
    cells, said = _cells(path, data, separator, header_row, top, before)
    for place, column in enumerate(cells):
        values, reason = column_of_cells(column, decimal)
        # of a glider: degrees and minutes, DDMM.mm, more than 180 degrees where it had no position
        if units[place].strip() in ("lat", "lon") and values.dtype != np.object_:
            values = degrees(values)
            values[np.abs(values) > 180.0] = np.nan
            reason = IN_DEGREES
        units[place] = "deg" if reason == IN_DEGREES else units[place]
        columns.append(values)
        reasons.append(reason)

    def cell(row: int, place: int) -> tuple[str, str]:
        rows = islice(_rows(path, data, separator), before, None)
        samples = (each for each in rows if len(each[1]) == width and each[1] not in titles[:1])
        line, found = next(islice(samples, row, None))
        return f"line {line}", found[place]

    return table_source(name or path.stem, path, names, columns, units, reasons, said, cell)


def _plain(data: bytes, text: TextOptions) -> tuple[bytes, list[str], str, bool]:
    """The text without comments, those above the table, the separator, and if that is white."""
    data = re.sub(rb"\n[ \t]+(?=\r?\n)", b"\n", data)
    marks = [text.comment.encode()] if text.comment else []
    marks += [mark for mark in MARKS if text.comment and re.match(rb"(%b[^\n]*\n){2}" % mark, data)]
    commented = list[str]()  # comments above the table, one of which may hold its titles
    for mark in marks:
        sign = rb"[ \t]*" + re.escape(mark) + rb"[^\r\n]*"
        leading = re.match(rb"(?:(?:" + sign + rb")?\r?\n)*", data)
        lines = leading[0].decode().splitlines() if leading else []
        commented += [line.strip().lstrip(mark.decode()).strip() for line in lines if line.strip()]
        data = re.sub(rb"^" + sign, b"", data, flags=re.MULTILINE) if mark in data else data
    data = b"\n" * text.skip_lines + b"".join(data.split(b"\n", text.skip_lines)[text.skip_lines :])
    separator = text.separator
    if separator is None:  # that which cuts most lines into equally many cells
        lines = [e for e in data[:65536].decode(errors="replace").split("\n") if e.strip()]
        lines = lines[:SAMPLE_LINES]
        counts = {mark: Counter(e.count(mark) for e in lines if mark in e) for mark in SEPARATORS}
        most = {mark: max(own.values(), default=0) for mark, own in counts.items()}
        separator = max(most, key=lambda mark: most[mark])
        words = (line.split() for line in lines)
        numbers = (row for row in words if all(_is_number(c) or c.lower() in MISSING for c in row))
        if 2 * most[separator] < len(lines) and len(next(numbers, ())) > 1:
            separator = " "
    if separator != " ":
        return data, commented, separator, False
    rows = (WHITE.sub(b"\t", line.strip()) for line in data.split(b"\n"))
    return b"\n".join(rows), commented, "\t", True


def _rows(path: Path, data: bytes, separator: str) -> Iterator[tuple[int, list[str]]]:
    """The line number on which each row ends, and its cells; blank lines are skipped."""
    lines = io.TextIOWrapper(io.BytesIO(data), encoding="utf-8", newline="")
    reader = csv.reader(lines, delimiter=separator)
    try:
        yield from ((reader.line_num, row) for row in reader if row)
    except csv.Error as error:
        raise RecordingError(
            f"{path}, line {reader.line_num}: {error}, expected comma-separated values"
        ) from error


def _is_number(cell: str, decimal: str = ".") -> bool:
    return bool(NUMBER.fullmatch(cell.strip().replace(decimal, ".")))


def _header(rows: list[list[str]], decimal: str, white: bool) -> tuple[int, int]:
    """Rows before the header, and rows of the header: those above the first sample.

    A sample has a number or a date; between white space, where the words of a title are cells, it
    has nothing else. Lines of one cell or of another length than the samples are a preamble.
    """
    first = len(rows)
    for place, row in enumerate(rows):
        filled = [cell.strip() for cell in row if cell.strip().lower() not in MISSING]
        sampled = [_is_number(cell, decimal) or bool(DATE.match(cell)) for cell in filled]
        sizes = place > 1 and len(row) == len(rows[place - 1]) > 1 and set(filled) <= SIZES
        if (all(sampled) if white else any(sampled)) and not sizes:
            first = place
            break
    if first in (0, len(rows)):
        return 0, min(first, 1)
    width = len(rows[first])
    starts = [
        place
        for place, row in enumerate(rows[:first])
        if len(row) == width and sum(bool(cell.strip()) for cell in row) >= min(width, 2)
    ]
    if not starts:  # a preamble, or a header that is too short
        return (first, 0) if white or first > 1 or len(rows[0]) == 1 < width else (0, 1)
    start = max(starts, key=lambda place: sum(bool(cell.strip()) for cell in rows[place]))
    return start, first - start if first - start <= MOST_HEADER_LINES else 1


def _cells(
    path: Path, data: bytes, separator: str, titles: Sequence[str], top: int, before: int
) -> tuple[list[pa.Array], list[str]]:
    """The cells of each column below `top` lines, and how many rows are left out.

    These are of another length than the `titles`, or repeat them, as a logger does that starts
    again. Raises RecordingError if they are not few; `before` rows are above the first sample.
    """
    width, other = len(titles), list[int]()
    names = [str(place) for place in range(width)]
    texts = arrow_csv.ConvertOptions(
        column_types=dict.fromkeys(names, pa.string()), strings_can_be_null=False
    )
    reading = arrow_csv.ReadOptions(
        use_threads=False, block_size=len(data), skip_rows=top, column_names=names
    )

    def skip(row: arrow_csv.InvalidRow) -> str:
        other.append(row.actual_columns)
        return "skip"

    parsing = arrow_csv.ParseOptions(
        delimiter=separator, newlines_in_values=True, invalid_row_handler=skip
    )
    try:
        stored = arrow_csv.read_csv(pa.py_buffer(data), reading, parsing, texts)
    except pa.ArrowInvalid as error:
        reason = shorten(str(error), 600)
        raise RecordingError(f"{path}: {reason}, expected comma-separated values") from error
    if len(other) >= FEW * (stored.num_rows + len(other)):
        rows = islice(_rows(path, data, separator), before, None)
        line, row = next(row for row in rows if len(row[1]) != width)
        raise RecordingError(
            f"{path}, line {line}: got {len(row)} cells, expected {width} as in the "
            f"header (separator {separator!r})"
        )
    columns = [pc.utf8_trim_whitespace(column.combine_chunks()) for column in stored.columns]
    again = reduce(pc.and_, map(pc.equal, columns, titles)) if any(titles) else None
    repeats = again.true_count if again is not None else 0
    counts = {f"{len(other)} rows with more or fewer than {width} cells": other,
              f"{repeats} lines that repeat the header": repeats}  # fmt: skip
    columns = [pc.filter(column, pc.invert(again)) for column in columns] if repeats else columns
    return columns, [reason for reason, there in counts.items() if there]


def column_of_cells(cells: pa.Array | Sequence[str], decimal: str = ".") -> tuple[Values, str]:
    """Cells as numbers, NaN where one is missing, else as text; and what is left out, (N,).

    In a column of numbers, other cells are missing values, if they are few.
    """
    cells = pa.array(cells, pa.string())
    plain = cells if decimal == "." else pc.replace_substring(cells, decimal, ".")
    try:
        values = plain.cast("float64")  # as most columns are
    except pa.ArrowInvalid:
        missing = pc.is_in(pc.ascii_lower(plain), value_set=pa.array(sorted(MISSING)))
        written = pc.utf8_ltrim(plain, "+")
        number = pc.match_substring_regex(written, f"^(?:{NUMBER.pattern})$")
        if number.true_count < (1.0 - FEW) * (len(cells) - missing.true_count):
            written = pc.replace_substring(cells, ",", ".")
            parts = pc.extract_regex(written, ANGLE).flatten() if len(cells) else ()
            if parts and parts[0].null_count < FEW * len(cells):
                whole, minute, second = (
                    np.array(pc.if_else(pc.equal(p, ""), "0", p).cast("float64")) for p in parts[:3]
                )
                south = pc.is_in(parts[3], value_set=pa.array(["S", "W"])).to_numpy(False)
                angle = whole + minute / 60.0 + second / 3600.0
                return np.where(south, -angle, angle), IN_DEGREES
            coded = cells.dictionary_encode()
            texts = np.array(coded.dictionary.to_pylist(), dtype=np.object_)
            return np.asarray(texts[coded.indices.to_numpy()]), ""
        values = pc.if_else(number, written, None).cast("float64")
    values = np.array(values.to_numpy(zero_copy_only=False))
    values[np.abs(values) > MAX_NUMBER] = np.nan
    words = pc.value_counts(pc.filter(cells, pa.array(np.isnan(values)))).to_pylist()
    counts = {
        word: row["counts"] for row in words
        if (word := row["values"]).lower().strip("+-") not in ("", "nan") or "-" in word
    }  # fmt: skip
    said = [f"{number} of {len(cells)} cells are {word}" for word, number in counts.items()]
    more = [f"{len(said) - MOST_WORDS} others"] if len(said) > MOST_WORDS else []
    return values, ", ".join([*said[:MOST_WORDS], *more]) + ": missing values" if said else ""


def _wide(source: Source) -> list[Source]:
    """The sources of a table with a row a value: one for each measurement and its tags."""
    known = {k: next((n for n in own if n in source.columns), "") for k, own in INFLUX.items()}
    fields = source.columns.get(known["_field"], np.empty(0))
    if not all(known.values()) or fields.dtype != np.object_:
        return [source]
    frame = pd.DataFrame(source.columns).rename(columns={n: k for k, n in known.items()})
    texts = [name for name, values in zip(frame, source.columns.values(), strict=True)
             if values.dtype == np.object_]  # fmt: skip
    tags = [name for name in texts if name not in (*INFLUX, "_start", "_stop", "result")
            and (name == "_measurement" or frame[name].nunique() > 1)]  # fmt: skip
    if "_time" in texts:
        times = pd.to_datetime(frame["_time"], format="ISO8601", utc=True, errors="coerce")
        frame["_time"] = (times - pd.Timestamp(0, tz="UTC")).dt.total_seconds()
    lost = ", ".join(name for name in frame if name not in (*tags, *INFLUX))
    keys = ["_time", "_field"]
    again = int(frame.duplicated([*tags, *keys]).sum())
    counts = {"values have no time": int(frame["_time"].isna().sum()),
              "values at times that repeat": again}  # fmt: skip
    left_out = [*source.left_out, *(f"{n} {line}" for line, n in counts.items() if n)]
    left_out += [f"columns {lost}: not of the values of this long table"] if lost else []
    result = []
    for key, rows in frame.groupby(tags) if tags else [((), frame)]:
        wide = rows.drop_duplicates(keys).pivot(index="_time", columns="_field", values="_value")
        columns: dict[str, Values] = {"_time": wide.index.to_numpy()}
        for name, values in wide.items():
            cells = values.fillna("").astype(str).to_list() if "_value" in texts else None
            columns[str(name)] = column_of_cells(cells)[0] if cells else values.to_numpy()
        name = "/".join(map(str, key if isinstance(key, tuple) else (key,))) or source.name
        result.append(Source(name, source.path, columns, {"_time": "s"}))
    return [replace(result[0], left_out=tuple(left_out)), *result[1:]]
