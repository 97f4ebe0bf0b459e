"""Text files: CSV with any separator, columns between white space, long tables, InfluxDB."""

import csv
import io
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
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
    MAX_NUMBER,
    MISSING,
    NUMBER,
    Contents,
    FileCell,
    ReadOptions,
    Source,
    TextOptions,
    Values,
    check_size,
    table_source,
)  # fmt: skip

SEPARATORS = "\t;|,"  # in this order where they fit equally well
SAMPLE_LINES = 60  # that the layout is found from
MOST_HEADER_LINES = 5
MOST_COLUMNS = 10_000
LONGEST_LINE = 10**6  # bytes
WHITE = re.compile(rb"[ \t\v\f]+")
DATE = re.compile(r"\d{4}[-/.]\d\d?[-/.]\d\d?|\d\d?[-/.]\d\d?[-/.]\d{4}|\d\d?:\d\d", re.ASCII)
SIZES = {"1", "2", "4", "8"}  # bytes of the columns of a glider, in a line below the units
# Titles of a long table, a row a value, in small letters; the first that is there counts.
VALUE = ("value", "val")
FIELD = ("field", "name", "variable", "parameter", "signal", "channel", "key", "sensor")
TIME = ("time", "timestamp", "datetime", "date", "utc", "ts", "t")


def read(path: Path, options: ReadOptions) -> Contents:
    """The columns of a text file; raises RecordingError if it cannot be read as a table."""
    data, left_out = decoded(path, options.text.encoding)
    parts = [data]
    if re.search(rb"^#(group|datatype|default)\b", data, re.MULTILINE):  # of InfluxDB
        # Annotations or an empty line end a table; lines keep their numbers.
        tables: dict[bytes, list[bytes]] = {}
        lines: list[bytes] | None = None
        for number, line in enumerate(data.split(b"\n")):
            if not line.strip() or line.startswith(b"#"):
                lines = None
                continue
            lines = tables.setdefault(line.rstrip(), []) if lines is None else lines
            lines += [*[b""] * (number - len(lines)), line]
        parts = [b"\n".join(lines) for lines in tables.values()]
    sources = [source for part in parts for source in _wide(table(path, part, options.text))]
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
    data, commented, separator, white = _plain(path, data, text)
    head = list(islice(_rows(path, data, separator), SAMPLE_LINES))
    usual = Counter(len(row) for _, row in head).most_common(1)[0][0] if head else 0
    if usual > 1 and not any(row[-1].strip() for _, row in head if len(row) == usual):
        # a separator at the end of the rows, which the header lacks
        head = [(line, [*row, ""] if len(row) == usual - 1 else row) for line, row in head]
    decimal = text.decimal or "."
    if text.decimal is None and separator != ",":
        found = [cell for _, row in head for cell in row]
        commas = sum("," in cell and _is_number(cell, ",") for cell in found)
        decimal = "," if commas > sum("." in cell and _is_number(cell) for cell in found) else "."
    start, header = _header([row for _, row in head], decimal, white)
    if text.header_lines is not None:
        start, header = 0, text.header_lines
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
    for words in (_cut(commented, separator), commented.split()):
        if not titles and len(words) == width and not any(map(_is_number, words)):
            titles = [words]
    line = head[before - 1][0] if before else 0
    data, left_out = _without_headers(data, [place for place, _ in head[start:before]], line)
    columns: list[Values] = []
    reasons: list[str] = []
    names = text.names or (titles[0] if titles else [""] * width)
    units = titles[1] if len(titles) > 1 and len(titles[1]) == width else [""] * width
    texts = 0
    for place, cells in enumerate(_cells(path, data, separator, width, line, before)):
        cells = pc.utf8_trim_whitespace(cells.combine_chunks())
        values, reason = column_of_cells(cells, decimal)
        texts += len(set(map(id, values))) if values.dtype == np.object_ else 0
        check_size(path, 8 * texts)  # different texts take more memory than numbers
        # of a glider: degrees and minutes, DDMM.mm
        if units[place].strip() in ("lat", "lon") and values.dtype != np.object_:
            whole = np.trunc(values / 100.0)
            values = whole + (values - 100.0 * whole) / 60.0
            values[np.abs(values) > 180.0] = np.nan  # where it had no position
            units[place], reason = "deg", "degrees and minutes, read as degrees"
        columns.append(values)
        reasons.append(reason)

    def cell(row: int, place: int) -> FileCell:
        line, cells = next(islice(_rows(path, data, separator), before + row, None))
        return FileCell(f"line {line}", cells[place])

    return table_source(name or path.stem, path, names, columns, units, reasons, left_out, cell)


def _plain(path: Path, data: bytes, text: TextOptions) -> tuple[bytes, str, str, bool]:
    """The text without comments, the last of them, the separator, and whether that is white."""
    data = re.sub(rb"\n[ \t]+(?=\r?\n)", b"\n", data)
    commented = ""  # the last comment before the table, which may hold its titles
    if text.comment and (mark := text.comment.encode()) in data:
        sign = rb"[ \t]*" + re.escape(mark) + rb"[^\r\n]*"
        if leading := re.match(rb"(?:(?:" + sign + rb")?\r?\n)*", data):
            words = [line.strip() for line in leading[0].decode().splitlines() if line.strip()]
            commented = words[-1].removeprefix(text.comment).strip() if words else ""
        data = re.sub(rb"^" + sign, b"", data, flags=re.MULTILINE)
    data = b"\n" * text.skip_lines + b"".join(data.split(b"\n", text.skip_lines)[text.skip_lines :])
    separator = text.separator or _separator(data)
    if separator != " ":
        return data, commented, separator, False
    lines = data.split(b"\n")
    if (longest := max(map(len, lines))) > LONGEST_LINE:
        raise RecordingError(
            f"{path}: got a line of {longest} bytes, expected at most {LONGEST_LINE}"
        )
    return b"\n".join(WHITE.sub(b"\t", line.strip()) for line in lines), commented, "\t", True


def _without_headers(data: bytes, places: Sequence[int], line: int) -> tuple[bytes, list[str]]:
    """The text without headers below the first: a logger that starts again writes it again."""
    top, repeats = b"\n".join(data.split(b"\n", line)[:line]), 0
    for place in places:
        again = b"\n" + data.split(b"\n", place)[place - 1].rstrip(b"\r")
        if len(again) > 1 and data.find(again, len(top)) >= 0:
            found_again = re.compile(re.escape(again) + rb"(?=\r?\n)")
            rest, number = found_again.subn(b"\n", data[len(top) :])
            data, repeats = top + rest, repeats + number
    return data, [f"{repeats} lines that repeat the header"] if repeats else []


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


def _is_empty(cell: str) -> bool:
    return cell.strip().lower() in MISSING


def _cut(line: str, separator: str) -> list[str]:
    try:
        return next(csv.reader([line], delimiter=separator), [])
    except csv.Error:
        return []


def _separator(data: bytes) -> str:
    """The separator that cuts most lines into equally many cells; " " for white space."""
    lines = [line for line in data[:65536].decode(errors="replace").split("\n") if line.strip()]
    lines = lines[:SAMPLE_LINES]
    most = {
        mark: max((n for size, n in counts.items() if size > 1), default=0)
        for mark in SEPARATORS
        for counts in (Counter(len(_cut(line, mark)) for line in lines),)
    }
    best = max(most, key=lambda mark: most[mark])
    words = [line.split() for line in lines]
    numbers = [row for row in words if all(_is_number(cell) or _is_empty(cell) for cell in row)]
    return " " if 2 * most[best] < len(lines) and numbers and len(numbers[0]) > 1 else best


def _header(rows: list[list[str]], decimal: str, white: bool) -> tuple[int, int]:
    """Rows before the header, and rows of the header: those above the first sample.

    A sample has a number or a date; between white space, where the words of a title are cells, it
    has nothing else. Lines of one cell or of another length than the samples are a preamble.
    """
    first = len(rows)
    for place, row in enumerate(rows):
        filled = [cell.strip() for cell in row if not _is_empty(cell)]
        sampled = [_is_number(cell, decimal) or bool(DATE.match(cell)) for cell in filled]
        sizes = place > 1 and len(row) == len(rows[place - 1]) > 1 and set(filled) <= SIZES
        if (all(sampled) if white else any(sampled)) and not sizes:
            first = place
            break
    if first == 0:
        return 0, 0
    if first == len(rows):
        return 0, 1
    width = len(rows[first])
    starts = [
        place
        for place, row in enumerate(rows[:first])
        if len(row) == width and sum(bool(cell.strip()) for cell in row) >= min(width, 2)
    ]
    if not starts:  # a preamble, or a header that is too short
        return (first, 0) if white or first > 1 or len(rows[0]) == 1 < width else (0, 1)
    return starts[0], first - starts[0] if first - starts[0] <= MOST_HEADER_LINES else 1


def _cells(
    path: Path, data: bytes, separator: str, width: int, lines_before: int, rows_before: int
) -> list[pa.ChunkedArray]:
    """The columns below the header, as text."""
    check_size(path, (data.count(b"\n") + 1) * width)
    names = [str(place) for place in range(width)]
    try:
        cells = arrow_csv.read_csv(
            pa.py_buffer(data),
            arrow_csv.ReadOptions(
                use_threads=False, block_size=len(data), skip_rows=lines_before, column_names=names
            ),
            arrow_csv.ParseOptions(delimiter=separator, newlines_in_values=True),
            arrow_csv.ConvertOptions(
                column_types=dict.fromkeys(names, pa.string()), strings_can_be_null=False
            ),
        )
    except pa.ArrowInvalid as error:  # name the first row whose length differs from the header
        for line, row in islice(_rows(path, data, separator), rows_before, None):
            if len(row) != width:
                raise RecordingError(
                    f"{path}, line {line}: got {len(row)} cells, expected {width} as in the "
                    f"header (separator {separator!r})"
                ) from error
        reason = shorten(str(error), 600)
        raise RecordingError(f"{path}: {reason}, expected comma-separated values") from error
    columns: list[pa.ChunkedArray] = cells.columns
    return columns


def column_of_cells(cells: pa.Array | Sequence[str], decimal: str = ".") -> tuple[Values, str]:
    """Cells as numbers, NaN where one is missing, else as text; and what is left out, (N,)."""
    cells = pa.array(cells, pa.string())
    cells = cells if decimal == "." else pc.replace_substring(cells, decimal, ".")
    missing = pc.is_in(pc.ascii_lower(cells), value_set=pa.array(sorted(MISSING)))
    written = pc.utf8_ltrim(pc.if_else(missing, None, cells), "+")
    try:
        values = np.array(written.cast("float64").to_numpy(zero_copy_only=False))
        if np.all((np.abs(values) < MAX_NUMBER) | np.isnan(values)):
            counts = pc.value_counts(pc.filter(cells, missing)).to_pylist()
            said = [
                f"{word['counts']} of {len(cells)} cells are {word['values']}"
                for word in counts
                if word["values"].lower().strip("+-") not in ("", "nan") or "-" in word["values"]
            ]
            return values, ", ".join(said) + ": missing values" if said else ""
        reason = ""
    except pa.ArrowInvalid:
        numbers = pc.match_substring_regex(written, f"^(?:{NUMBER.pattern})$")
        odd = pc.filter(cells, pc.invert(pc.fill_null(numbers, True)))
        few = len(odd) < (len(cells) - missing.true_count) / 2
        reason = f"{len(odd)} of {len(cells)} cells are no numbers ({odd[0]}): text" if few else ""
    coded = cells.dictionary_encode()
    texts = np.array(coded.dictionary.to_pylist(), dtype=np.object_)
    return np.asarray(texts[coded.indices.to_numpy()]), reason


def _wide(source: Source) -> list[Source]:
    """The sources of a long table, with a row a value: names that share their times are one.

    Other columns of text, such as the measurement and the tags of InfluxDB, tell sources apart.
    """
    titles = {name.lower().strip("_"): name for name in reversed(source.columns)}
    value, name, time = (
        next((titles[word] for word in words if word in titles), "")
        for words in (VALUE, FIELD, TIME)
    )
    fields = source.columns.get(name, np.zeros(0))
    if not (value and time) or fields.dtype != np.object_ or len(set(fields)) == len(source):
        return [source]
    others = [column for column in source.columns if column not in (value, name, time)]
    tags = [
        column
        for column in others
        if (values := source.columns[column]).dtype == np.object_
        and column.strip("_") not in ("start", "stop", "result")
        and (column == "_measurement" or len(set(values)) > 1)
    ]
    frame = pd.DataFrame({key: source.columns[key] for key in (*tags, name)})
    wide: dict[tuple[object, ...], Source] = {}
    for key, rows in frame.groupby([*tags, name], sort=False).indices.items():
        *of, field = map(str, key if isinstance(key, tuple) else (key,))
        times, values = source.columns[time][rows], source.columns[value][rows]
        if values.dtype == np.object_:
            values, _ = column_of_cells(values.tolist())
        units = {time: source.units[time]} if time in source.units else {}
        base = "/".join(of) or source.name
        same = wide.setdefault((base, *times), Source(base, source.path, {time: times}, units))
        same.columns[field] = values
    left_out = [line for line in source.left_out if not line.startswith(f"column {value}:")]
    if lost := [column for column in others if column not in tags]:
        left_out.append(f"columns {', '.join(lost)}: not of the values of this long table")
    first, *further = wide.values()
    return [replace(first, left_out=tuple(left_out)), *further]
