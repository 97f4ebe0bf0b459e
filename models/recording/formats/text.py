"""Text files: CSV with any separator, columns between white space, long tables, InfluxDB."""

import csv
import io
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from textwrap import shorten
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from seatrial.models.errors import RecordingError
from seatrial.models.recording.source import (
    LARGEST_BYTES,
    MARKS,
    MAX_NUMBER,
    MISSING,
    FileCell,
    ReadOptions,
    Source,
    TextArray,
    TextOptions,
    check_size,
    column_of_cells,
    is_empty,
)
from seatrial.models.vessel.basis import Array

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa
else:
    import lazy_loader

    pd, pa = lazy_loader.load("pandas"), lazy_loader.load("pyarrow")

SEPARATORS = "\t;|,"  # in this order where they fit equally well
SAMPLE_LINES = 60  # that the layout is found from
MOST_HEADER_LINES = 5
MOST_COLUMNS = 10_000
MOST_TEXTS = 4_000_000  # different cells of text
LONGEST_LINE = 10**6  # bytes
WHITE_LINE = re.compile(rb"^[ \t]+(?=\r?$)", re.MULTILINE)
WHITE = re.compile(rb"[ \t\v\f]+")
NUMBER = r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?"
NUMBER_TEXT = re.compile(NUMBER)
COMMA_NUMBER = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?", re.ASCII)
DATE = re.compile(r"\d{4}[-/.]\d\d?[-/.]\d\d?|\d\d?[-/.]\d\d?[-/.]\d{4}|\d\d?:\d\d", re.ASCII)
TITLE = re.compile(r"(?P<name>.*?\S)[\s_]*[\[(](?P<unit>[^\[\]()]*)[\])]")
SIZES = {"1", "2", "4", "8"}  # bytes of the columns of a glider, in a line below the units
NO_UNITS = {"nodim": "", "bool": "", "enum": "", "timestamp": "s"}  # of the same
ANNOTATION = re.compile(rb"^#(group|datatype|default)\b", re.MULTILINE)  # of InfluxDB
# Titles of a long table, a row a value, in small letters; the first that is there counts.
LONG = {
    "value": ("value", "val"),
    "name": ("field", "name", "variable", "parameter", "signal", "channel", "key", "sensor", "topic"),
    "time": ("time", "timestamp", "datetime", "date", "utc", "ts", "t"),
}  # fmt: skip


class Names(NamedTuple):
    """Names of the columns, and what their titles say besides."""

    names: list[str]
    written: dict[str, str]  # titles that differ from the names
    units: dict[str, str]
    repeated: Mapping[str, tuple[str, ...]]  # titles that several columns have, and their names


def names_of(titles: Sequence[str], below: Sequence[str] = ()) -> Names:
    """The names and units of columns: `t [s]` is `t` in `s`, a column without title is c1, c2 ...

    `below` are the cells of a second line of titles, which hold units. Columns whose names differ
    by the unit only keep their titles; those with equal titles are `x.1`, `x.2` ...
    """
    matches = [TITLE.fullmatch(title) for title in titles]
    plain = [match["name"] if match else title for match, title in zip(matches, titles, strict=True)]
    units = [
        (below[i].strip("[]() ") if below else "") or (match["unit"].strip() if match else "")
        for i, match in enumerate(matches)
    ]
    counts, times, taken = Counter(plain), Counter(titles), set(titles)
    names: list[str] = []
    repeated: dict[str, tuple[str, ...]] = {}
    for place, (name, title) in enumerate(zip(plain, titles, strict=True)):
        if times[title] == 1 or not title:
            names.append((title if counts[name] > 1 else name) or f"c{place + 1}")
            continue
        number = len(repeated.get(title, ())) + 1
        while (single := f"{title}.{number}") in taken:
            number += 1
        taken.add(single)
        repeated[title] = (*repeated.get(title, ()), single)
        names.append(single)
    written = {n: title for n, title in zip(names, titles, strict=True) if times[title] == 1 != n}
    known = zip(names, (NO_UNITS.get(unit, unit) for unit in units), strict=True)
    return Names(
        names,
        {name: title for name, title in written.items() if name != title},
        {name: unit for name, unit in known if unit},
        repeated,
    )


@dataclass(frozen=True, eq=False)
class TextLayout:
    """The text of a file, and where its table stands in it."""

    data: bytes  # UTF-8, without comments
    separator: str
    decimal: str
    header: list[list[str]]  # lines of names; empty if the columns have none
    width: int  # columns
    lines_before: int  # the first row
    rows_before: int  # the same, without blank lines
    repeats: int  # headers that stand among the rows


def read(path: Path, options: ReadOptions) -> list[Source]:
    """The columns of a text file; raises RecordingError if it cannot be read as a table."""
    data, left_out = content(path, options.text)
    text = options.text
    if annotated := ANNOTATION.search(data):
        text = replace(text, comment=None)
    sources: list[Source] = []
    for part in _tables(data) if annotated else [data]:
        sources += _wide(table(path, part, text))
    names = Counter(source.name for source in sources)
    sources = [
        replace(source, name=f"{source.name}/{i + 1}") if names[source.name] > 1 else source
        for i, source in enumerate(sources)
    ]
    sources[0] = replace(sources[0], left_out=(*left_out, *sources[0].left_out))
    return sources


def table(path: Path, data: bytes, text: TextOptions, name: str | None = None) -> Source:
    """The columns of a text as a source; raises RecordingError if it is not a table."""
    layout = _layout(path, data, text)
    titles = [cell.strip() for cell in layout.header[0]] if layout.header else [""] * layout.width
    below = [cell.strip() for cell in layout.header[1]] if len(layout.header) > 1 else []
    names, written, units, repeated = names_of(
        text.names or titles, below if len(below) == layout.width else ()
    )
    columns: dict[str, Array | TextArray] = {}
    left_out = []
    if layout.repeats:
        left_out.append(f"{layout.repeats} lines that repeat the header")
    kept = 0
    for title, cells in zip(names, _cells(path, layout), strict=True):
        columns[title], reason = _values(cells, layout.decimal)
        left_out += [f"column {title}: {reason}"] if reason else []
        if columns[title].dtype == np.object_:
            kept += len(set(map(id, columns[title])))
            if kept > MOST_TEXTS:
                raise RecordingError(f"{path}, column {title}: got text, expected numbers")
        elif units.get(title) in ("lat", "lon"):  # of a glider: degrees and minutes, DDMM.mm
            whole = np.trunc(columns[title] / 100.0)
            columns[title] = whole + (columns[title] - 100.0 * whole) / 60.0
            columns[title][np.abs(columns[title]) > 180.0] = np.nan  # where it had no position
            units[title] = "deg"
            left_out.append(f"column {title}: degrees and minutes, read as degrees")
    positions = {title: i for i, title in enumerate(names)}
    several: dict[str, tuple[str, ...]] = {}
    for title, equals in repeated.items():
        first = columns[equals[0]]
        exact = first.dtype == np.object_
        if all(np.array_equal(first, columns[e], equal_nan=not exact) for e in equals
               if exact == (columns[e].dtype == np.object_)) and len({columns[e].dtype for e in equals}) == 1:  # fmt: skip
            left_out.append(f"column {title}: stands {len(equals)} times with equal cells, once kept")
            columns = {title if n == equals[0] else n: values for n, values in columns.items() if n not in equals[1:]}
            positions[title] = positions[equals[0]]
        else:
            several[title] = equals

    def cell(row: int, column: str) -> FileCell:
        """The line on which a row ends, and the cell of a column; blank lines are not counted."""
        line, found = next(islice(_rows(path, layout), layout.rows_before + row, None))
        return FileCell(f"line {line}", found[positions[column]])

    return Source(
        name or path.stem, path, columns, units, written, several, tuple(left_out), cell
    )


def content(path: Path, text: TextOptions) -> tuple[bytes, tuple[str, ...]]:
    """The text of a file as UTF-8, and what is to be said of it.

    Raises RecordingError if it is no text.
    """
    if path.stat().st_size > LARGEST_BYTES:
        raise RecordingError(
            f"{path}: got {path.stat().st_size / 1e6:.0f} MB of text, expected at most "
            f"{LARGEST_BYTES / 1e6:.0f}; cut the recording, or convert it to Parquet"
        )
    data = path.read_bytes().removeprefix(b"\xef\xbb\xbf")
    encoding = text.encoding or MARKS.get(data[:2])
    said: tuple[str, ...] = ()
    if encoding is None and not data.isascii():
        try:
            data.decode()
        except UnicodeError as error:
            if b"\0" in data or any(0x80 <= byte < 0xA0 for byte in data):
                line = data.count(b"\n", 0, getattr(error, "start", 0)) + 1
                raise RecordingError(
                    f"{path}, line {line}: got binary data or text that is not UTF-8, expected a "
                    "text file; excitation.text.encoding=latin-1 reads another encoding"
                ) from error
            encoding, said = "latin-1", ("the text is not UTF-8: read as latin-1",)
    if encoding is not None:
        try:
            data = data.decode(encoding).removeprefix("\ufeff").encode()
        except UnicodeError as error:
            raise RecordingError(
                f"{path}: got text that is not {encoding}, expected a text file in that encoding"
            ) from error
    if b"\0" in data:
        line = data.count(b"\n", 0, data.index(b"\0")) + 1
        raise RecordingError(f"{path}, line {line}: got binary data, expected a text file")
    if not data.strip():
        raise RecordingError(f"{path}: is empty, expected a header and samples")
    return data, said


def _tables(data: bytes) -> Iterator[bytes]:
    """The tables of an export of InfluxDB, each with its lines where they stood.

    Annotations or an empty line end a table; those with the same titles are one.
    """
    tables: dict[bytes, list[bytes]] = {}
    lines: list[bytes] | None = None
    for number, line in enumerate(data.split(b"\n")):
        if not line.strip() or line.startswith(b"#"):
            lines = None
        elif lines is None:
            known = line.rstrip() in tables
            lines = tables.setdefault(line.rstrip(), [b""] * number)
            if not known:
                lines.append(line)
        else:
            lines += [b""] * (number - len(lines)) + [line]
    for lines in tables.values():
        yield b"\n".join(lines)


def _wide(source: Source) -> list[Source]:
    """The sources of a long table, with a row a value: names that share their times are one.

    Other columns of text, such as the measurement and the tags of InfluxDB, tell sources apart.
    """
    titles = {name.lower().strip("_"): name for name in reversed(source.columns)}
    found = {
        kind: next((titles[word] for word in words if word in titles), None)
        for kind, words in LONG.items()
    }
    value, name, time = found["value"], found["name"], found["time"]
    if value is None or name is None or time is None:
        return [source]
    if source.columns[name].dtype != np.object_ or len(set(source.columns[name])) == len(source):
        return [source]
    others = [column for column in source.columns if column not in (value, name, time)]
    tags = [
        column
        for column in others
        if source.columns[column].dtype == np.object_
        and column.strip("_") not in ("start", "stop", "result")
    ]
    telling = [tag for tag in tags if tag == "_measurement" or len(set(source.columns[tag])) > 1]
    groups = pd.DataFrame({key: source.columns[key] for key in (*telling, name)}).groupby(
        [*telling, name], sort=False
    )
    made: list[Source] = []
    for key, rows in groups.indices.items():
        *of, field = key if isinstance(key, tuple) else (key,)
        base = "/".join(map(str, of)) or source.name
        times, values = source.columns[time][rows], source.columns[value][rows]
        if values.dtype == np.object_:
            values = column_of_cells(values.tolist())
        for known in made:
            if known.name == base and np.array_equal(known.columns[time], times):
                known.columns[str(field)] = values
                break
        else:
            columns: dict[str, Array | TextArray] = {time: times, str(field): values}
            made.append(Source(base, source.path, columns, {k: u for k, u in source.units.items() if k == time}))
    lost = [column for column in others if column not in telling]
    said = f"columns {', '.join(lost)}: not of the values of this long table"
    made[0] = replace(made[0], left_out=(
        *(line for line in source.left_out if not line.startswith(f"column {value}:")),
        *((said,) if lost else ()),
    ))
    return made


def _layout(path: Path, data: bytes, text: TextOptions) -> TextLayout:
    """Find the layout of a text; raises RecordingError if it has no rows."""
    data, commented = _without_comments(WHITE_LINE.sub(b"", data), text.comment)
    if text.skip_lines:
        parts = data.split(b"\n", text.skip_lines)
        data = b"\n" * text.skip_lines + (parts[-1] if len(parts) > text.skip_lines else b"")
    separator = text.separator or _separator(data)
    white = separator == " "
    if white:
        lines = data.split(b"\n")
        if (longest := max(map(len, lines))) > LONGEST_LINE:
            raise RecordingError(
                f"{path}: got a line of {longest} bytes, expected at most {LONGEST_LINE}"
            )
        data = b"\n".join(WHITE.sub(b"\t", line.strip()) for line in lines)
        separator = "\t"
    free = TextLayout(data, separator, ".", [], 0, 0, 0, 0)
    head = list(islice(_rows(path, free), SAMPLE_LINES))
    decimal = text.decimal
    if decimal is None:
        found = [cell.strip() for _, row in head for cell in row]
        commas = sum(bool(COMMA_NUMBER.fullmatch(cell)) for cell in found)
        points = sum("." in cell and _is_number(cell) for cell in found)
        decimal = "," if separator != "," and commas > points else "."
    preamble, header = _header(head, text, decimal, white)
    before = preamble + header
    if len(head) <= before:
        raise RecordingError(f"{path}: got a header and no rows, expected samples below it")
    titles = [row for _, row in head[preamble:before]]
    width = len(titles[0]) if titles else len(head[before][1])
    if width > MOST_COLUMNS:
        raise RecordingError(f"{path}: got {width} columns, expected at most {MOST_COLUMNS}")
    if not titles and commented is not None and not text.names:
        words = _cut(commented, separator)
        words = commented.split() if len(words) != width else words
        titles = [words] if len(words) == width and not any(map(_is_number, words)) else []
    if text.names and len(text.names) != width:
        raise RecordingError(
            f"{path}: got {width} columns, expected {len(text.names)} as in excitation.text.names"
        )
    line = head[before - 1][0] if before else 0
    repeats = 0
    for place, _ in head[preamble:before]:  # a logger that starts again writes its header again
        again = b"\n" + data.split(b"\n", place)[place - 1].rstrip(b"\r")
        start = len(b"\n".join(data.split(b"\n", line)[:line]))
        count = len(re.findall(re.escape(again) + rb"(?=\r?\n)", data[start:]))
        if count and len(again) > 1:
            repeats += count
            data = data[:start] + re.sub(re.escape(again) + rb"(?=\r?\n)", b"\n", data[start:])
    return TextLayout(data, separator, decimal, titles, width, line, before, repeats)


def _rows(path: Path, layout: TextLayout) -> Iterator[tuple[int, list[str]]]:
    """The line number on which each row ends, and its cells; blank lines are skipped."""
    lines = io.TextIOWrapper(io.BytesIO(layout.data), encoding="utf-8", newline="")
    reader = csv.reader(lines, delimiter=layout.separator)
    try:
        for row in reader:
            if row:
                yield reader.line_num, row
    except csv.Error as error:
        raise RecordingError(
            f"{path}, line {reader.line_num}: {error}, expected comma-separated values"
        ) from error


def _is_number(cell: str, decimal: str = ".") -> bool:
    text = cell.strip()
    return bool(NUMBER_TEXT.fullmatch(text.replace(decimal, ".") if decimal != "." else text))


def _without_comments(data: bytes, mark: str | None) -> tuple[bytes, str | None]:
    """The text with empty lines in place of comments, and the last comment before the table."""
    if not mark or mark.encode() not in data:
        return data, None
    sign = re.escape(mark.encode())
    leading = re.match(rb"(?:[ \t]*(?:" + sign + rb"[^\r\n]*)?\r?\n)+", data)
    lines = leading[0].decode().split("\n") if leading else []
    titles = [line.strip().removeprefix(mark).strip() for line in lines if line.strip()]
    pattern = re.compile(rb"^[ \t]*" + sign + rb"[^\r\n]*", re.MULTILINE)
    return pattern.sub(b"", data), titles[-1] if titles else None


def _separator(data: bytes) -> str:
    """The separator that cuts most lines into equally many cells."""
    lines = [line for line in data[:65536].decode(errors="replace").split("\n") if line.strip()]
    lines = lines[:SAMPLE_LINES]
    best, most = ",", 0
    for candidate in SEPARATORS:
        counts = Counter(len(_cut(line, candidate)) for line in lines)
        counts.pop(1, None)
        counts.pop(0, None)
        agreeing = max(counts.values(), default=0)
        if agreeing > most:
            best, most = candidate, agreeing
    words = [line.split() for line in lines]
    numbers = [row for row in words if all(_is_number(word) or is_empty(word) for word in row)]
    return " " if 2 * most < len(lines) and numbers and len(numbers[0]) > 1 else best


def _cut(line: str, separator: str) -> list[str]:
    try:
        return next(csv.reader([line], delimiter=separator), [])
    except csv.Error:
        return []


def _header(
    head: list[tuple[int, list[str]]], text: TextOptions, decimal: str, white: bool
) -> tuple[int, int]:
    """Rows before the header, and rows of the header."""
    if text.header_lines is not None:
        return 0, text.header_lines
    samples = []
    for place, (_, row) in enumerate(head):
        filled = [cell.strip() for cell in row if not is_empty(cell)]
        sampled = [_is_number(cell, decimal) or bool(DATE.match(cell)) for cell in filled]
        # Between white space, the words of a title are cells: a sample has nothing but numbers.
        is_sample = all(sampled) if white else any(sampled)
        sizes = place > 1 and len(row) > 1 and not any(samples) and set(filled) <= SIZES
        samples.append(is_sample and not (sizes and len(row) == len(head[place - 1][1])))
    first = samples.index(True) if True in samples else None
    if first == 0:
        return 0, 0
    width = len(head[0][1]) if first is None else len(head[first][1])
    # Lines of one cell, or of another length than the samples, are a title.
    starts = [
        i for i, (_, row) in enumerate(head[:first])
        if len(row) == width and sum(bool(cell.strip()) for cell in row) >= min(width, 2)
    ]  # fmt: skip
    if first is None or not starts:
        title = first is not None and (white or first > 1 or len(head[0][1]) == 1 < width)
        return (first or 0, 0) if title else (0, 1)
    header = first - starts[0]
    return starts[0], header if header <= MOST_HEADER_LINES else 1


def _cells(path: Path, layout: TextLayout) -> "list[pa.ChunkedArray]":
    """The columns below the header, as text without surrounding spaces."""
    from pyarrow import compute as pc
    from pyarrow import csv as arrow_csv

    check_size(path, (layout.data.count(b"\n") + 1) * layout.width)
    names = [str(index) for index in range(layout.width)]
    try:
        cells = arrow_csv.read_csv(
            pa.py_buffer(layout.data),
            arrow_csv.ReadOptions(
                use_threads=False,
                block_size=len(layout.data),
                skip_rows=layout.lines_before,
                column_names=names,
            ),
            arrow_csv.ParseOptions(delimiter=layout.separator, newlines_in_values=True),
            arrow_csv.ConvertOptions(
                column_types=dict.fromkeys(names, pa.string()), strings_can_be_null=False
            ),
        )
    except pa.ArrowInvalid as error:  # name the first row whose length differs from the header
        for line, row in islice(_rows(path, layout), layout.rows_before, None):
            if len(row) != layout.width:
                raise RecordingError(
                    f"{path}, line {line}: got {len(row)} cells, expected {layout.width} as in the "
                    f"header (separator {layout.separator!r})"
                ) from error
        reason = shorten(str(error), 600)
        raise RecordingError(f"{path}: {reason}, expected comma-separated values") from error
    return [pc.utf8_trim_whitespace(column) for column in cells.columns]


def _values(column: "pa.ChunkedArray", decimal: str) -> tuple[Array | TextArray, str]:
    """A column as numbers, NaN where one is missing, or as text, (N,); and what was left out."""
    from pyarrow import compute as pc

    pointed = column if decimal == "." else pc.replace_substring(column, decimal, ".")
    reason = ""
    try:
        values = pointed.cast("float64")
    except pa.ArrowInvalid:
        missing = pc.is_in(pc.utf8_lower(column), value_set=pa.array(sorted(MISSING)))
        written = pc.utf8_ltrim(pc.if_else(missing, None, pointed), "+")
        try:
            values = written.cast("float64")
            words = pc.value_counts(pc.filter(column, missing)).to_pylist()
            said = [f"{w['counts']} of {len(column)} cells are {w['values']}" for w in words
                    if w["values"].strip("+-").lower() not in ("", "nan") or w["values"] == "-"]  # fmt: skip
            reason = ", ".join(said) + ": missing values" if said else ""
        except pa.ArrowInvalid:
            values = None
            numbers = pc.match_substring_regex(written, f"^(?:{NUMBER})$")
            if (count := pc.sum(numbers).as_py() or 0) > len(column) // 2:
                odd = pc.filter(column, pc.invert(pc.fill_null(numbers, True)))
                reason = f"{len(odd)} of {len(column)} cells are no numbers ({odd[0]}): read as text"
    if values is not None:
        array = np.array(values.to_numpy())
        if np.all((np.abs(array) < MAX_NUMBER) | np.isnan(array)):
            return array, reason
    coded = pointed.combine_chunks().dictionary_encode()
    texts = np.array(coded.dictionary.to_pylist(), dtype=np.object_)
    return np.asarray(texts[coded.indices.to_numpy()]), reason
