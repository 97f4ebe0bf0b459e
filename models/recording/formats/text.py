"""Text of any layout, exports of InfluxDB, and titled cells of any format as a source."""

import csv
import io
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import reduce
from itertools import count, islice, takewhile
from pathlib import Path
from textwrap import shorten
from typing import TypeAlias

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
)
from seatrial.models.vessel.basis import Array

SEPARATORS = "\t;|, "  # in this order where they fit equally well; " " is any white space
SAMPLE_LINES = 60  # that the layout is found from
MOST_HEADER_LINES = 5
MOST_COLUMNS = 10_000
MAX_NUMBER = 1e30  # larger numbers are not measurements, and their squares could overflow
FEW = 0.5  # share of cells, or rows, below which those that do not fit are left out
MARKS = ("%", "!", "//")  # of comments, where a text begins with two
NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
DATE = re.compile(r"\d{4}[-/.]\d\d?[-/.]\d\d?|\d\d?[-/.]\d\d?[-/.]\d{4}|\d\d?:\d\d", re.ASCII)
SIZES = {"1", "2", "4", "8"}  # bytes of the columns of a glider, in a line below the units
LONG = {  # columns of a table with a row a value, by the names that InfluxDB gives them
    "_time": ("_time", "time", "timestamp"), "_value": ("_value", "value"),
    "_field": ("_field", "field", "path", "name", "variable", "signal", "parameter", "topic"),
}  # fmt: skip
TITLE = re.compile(r"(.*?\S)[\s_]*[\[({](?!\d+[\])])(?:in )?([^\[\](){}]*?)(?: since .*)?[\])}]")
UNITS = {  # of gliders, autopilots and netCDF, as regular expressions
    "": "nodim|bool|enum|instance|UNKNOWN|satellites", "s": "timestamp",
    "deg": r"deg(?:rees?)?_?(?:north|east|[NE]|heading|latitude|longitude)?(?: \(.*)?",
}  # fmt: skip
# Of a time in columns of their own, as their titles begin.
PARTS = {part[:3]: part for part in ("year", "month", "day", "hour", "minute", "second")}
SIDES = {"lat": ("N", "S"), "lon": ("E", "W")}
Cells: TypeAlias = Values | pa.Array | Sequence[str]  # as written, unless they are numbers


def read(path: Path, options: ReadOptions) -> Contents:
    """The columns of a text file; raises RecordingError if it cannot be read as a table."""
    data, left_out = decoded(path, options.text.encoding)
    annotated = re.search(rb"^#(group|datatype|default)\b", data, re.MULTILINE)  # by InfluxDB
    parts = defaultdict[bytes, bytes](bytes)  # of one header each
    for part in re.split(rb"\n\r?\n", data) if annotated else [data]:
        header = re.search(rb"^[^#\s].*", part, re.MULTILINE)
        parts[header[0] if header else b""] += part + b"\n"
    return [s for part in parts.values() for s in _wide(table(path, part, options.text))], left_out


def decoded(path: Path, encoding: str | None) -> tuple[bytes, Sequence[str]]:
    """The text of a file as UTF-8, and what is to be said of it.

    Raises RecordingError if it is no text.
    """
    data, said = path.read_bytes(), list[str]()
    encoding = encoding or ("utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig")
    try:
        data = data if data.isascii() else data.decode(encoding).removeprefix("\ufeff").encode()
    except (UnicodeError, LookupError):
        western = encoding == "utf-8-sig" and not re.search(rb"[\0\x80-\x9f]", data)
        data = data.decode("latin-1").encode() if western else b"\0"
        said = ["the text is not UTF-8: read as latin-1"]
    if b"\0" in data:
        raise RecordingError(
            f"{path}: got binary data or text that is not {encoding[:6].rstrip('-')}, expected a "
            "text file; excitation.text.encoding=latin-1 reads another encoding"
        )
    if not data.strip():
        raise RecordingError(f"{path}: is empty, expected a header and samples")
    return data, said


def table(path: Path, data: bytes, text: TextOptions, name: str | None = None) -> Source:
    """The columns of a text as a source; raises RecordingError if it is not a table."""
    data, commented, separator, white = _plain(data, text)
    head = list(islice(_rows(data, separator), SAMPLE_LINES))
    rows = [row for _, row in head]
    usual = Counter(map(len, rows)).most_common(1)[0][0] if rows else 0
    full = [row for row in rows if len(row) == usual > 1]
    ended = bool(full) and not any(row[-1].strip() for row in full)  # as by MATLAB
    numbered = [row[0].strip() for row in full] == [str(k) for k in range(1, len(full) + 1)]
    for row in rows if ended or numbered else ():  # the header lacks a title
        if len(row) == usual - 1:
            row.insert(usual if ended else 0, "")
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
    if width > MOST_COLUMNS or (text.names and len(text.names) != width):
        wanted = f"{len(text.names)} as in excitation.text.names"
        expected = wanted if text.names else f"at most {MOST_COLUMNS}"
        raise RecordingError(f"{path}: got {width} columns, expected {expected}")
    check_size(path, 8 * (data.count(b"\n") + 1) * width)
    above = [w for line in commented for w in (line.split(), line.split(separator))
             if len(w) == width and not any(map(_is_number, w))]  # fmt: skip
    titles, blank = titles or above[-1:], [""] * width
    written = [title.strip() for title in titles[0]] if titles else blank
    units = titles[1] if len(titles) > 1 and len(titles[1]) == width else blank
    top = head[before - 1][0] if before else 0  # lines above the first sample
    columns, said = _cells(path, data, separator, written, top)

    def cell(row: int, place: int) -> tuple[str, str]:
        samples = (each for each in _rows(data, separator, top) if len(each[1]) == width
                   and [text.strip() for text in each[1]] != written)  # fmt: skip
        line, found = next(islice(samples, row, None))
        return f"line {line}", found[place]

    triples = zip(text.names or written, columns, units, strict=True)
    return table_source(name or path.stem, path, triples, said, cell, decimal)


def _plain(data: bytes, text: TextOptions) -> tuple[bytes, list[str], str, bool]:
    """The text without comments, those above the table, the separator, and if that is white."""
    data, commented = re.sub(rb"\n[ \t]+(?=\r?\n)", b"\n", data), list[str]()
    twice = (m for m in MARKS if re.match(rb"(%b[^\n]*\n){2}" % m.encode(), data))
    if (mark := text.comment and next(twice, text.comment)) and mark.encode() in data:
        above = takewhile(lambda e: not e or e.startswith(mark), map(str.strip, _first(data)))
        commented = [line.lstrip(mark).strip() for line in above]
        sign = rb"^[ \t]*" + re.escape(mark.encode()) + rb"[^\r\n]*"
        data = re.sub(sign, b"", data, flags=re.MULTILINE)
    data = b"\n" * text.skip_lines + b"".join(data.split(b"\n", text.skip_lines)[text.skip_lines :])
    lines = [line for line in _first(data) if line.strip()][:SAMPLE_LINES]

    def most(mark: str) -> int:  # lines that a separator cuts alike; words only if numbers
        rows = (line.split(mark.strip(" ") or None) for line in lines)
        counts = Counter(len(row) for row in rows if len(row) > 1 and (mark != " " or all(
            _is_number(c) or c.lower() in MISSING for c in row)))  # fmt: skip
        return max(counts.values(), default=0)

    separator: str = text.separator or max(SEPARATORS, key=most)
    if separator != " ":
        return data, commented, separator, False
    return b"\n".join(b"\t".join(e.split()) for e in data.split(b"\n")), commented, "\t", True


def _first(data: bytes) -> list[str]:
    """The first lines of a text."""
    return data[:65536].decode(errors="replace").split("\n")


def _rows(data: bytes, separator: str, top: int = 0) -> Iterator[tuple[int, list[str]]]:
    """The line on which each row below `top` lines ends, and its cells; not of blank lines."""
    lines = io.TextIOWrapper(io.BytesIO(data), encoding="utf-8", newline="")
    reader = csv.reader(lines, delimiter=separator)
    return ((reader.line_num, row) for row in reader if row and reader.line_num > top)


def _is_number(cell: str, decimal: str = ".") -> bool:
    return bool(NUMBER.fullmatch(cell.strip().replace(decimal, ".")))


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

    def skip(row: arrow_csv.InvalidRow) -> str:
        other.append(row)
        return "skip"

    stored = arrow_csv.read_csv(
        pa.py_buffer(data),
        arrow_csv.ReadOptions(
            use_threads=False, block_size=len(data), skip_rows=top, column_names=names
        ),
        arrow_csv.ParseOptions(
            delimiter=separator, newlines_in_values=True,
            invalid_row_handler=skip,
        ),
        arrow_csv.ConvertOptions(
            column_types=dict.fromkeys(names, pa.string()), strings_can_be_null=False
        ),
    )  # fmt: skip
    if len(other) >= FEW * (stored.num_rows + len(other)):
        rows = _rows(data, separator, top)
        line, row = next(each for each in rows if len(each[1]) != len(titles))
        raise RecordingError(
            f"{path}, line {line}: got {len(row)} cells, expected {len(titles)} as in the "
            f"header (separator {separator!r})"
        )
    columns = [pc.utf8_trim_whitespace(column.combine_chunks()) for column in stored.columns]
    again = reduce(pc.and_, map(pc.equal, columns, titles))
    counts = {f"rows with more or fewer than {len(titles)} cells": len(other)}
    if any(titles) and again.true_count:
        counts["lines that repeat the header"] = again.true_count
        columns = [pc.filter(column, pc.invert(again)) for column in columns]
    return columns, [f"{there} {reason}" for reason, there in counts.items() if there]


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
    said, result = (
        [*source.left_out, *(why for why, there in counts.items() if there)],
        list[Source](),
    )
    for key, rows in frame.groupby(tags) if tags else [((), frame)]:
        wide = rows.drop_duplicates(keys).pivot(index="_time", columns="_field", values="_value")
        triples = [("_time", wide.index.to_numpy(), "s")]
        for title, values in wide.items():
            cells = values.fillna("").astype(str).to_list() if "_value" in texts else values
            triples.append((str(title), cells, ""))
        name = "/".join(map(str, key)) or source.name
        result.append(table_source(name, source.path, triples, () if result else said))
    return result


def table_source(
    name: str, path: Path, columns: Iterable[tuple[str, Cells, str]],
    left_out: Sequence[str] = (), cell: Callable[[int, int], tuple[str, str]] | None = None,
    decimal: str = ".",
) -> Source:  # fmt: skip
    """Columns by title, cells and unit (empty: not known), (N,) each, as the source `name`.

    `t [s]` is the column `t` in `s`, a column without title is c1, c2 ... Columns whose names
    differ by the unit only keep their titles. Of columns of one title with equal cells one is kept,
    others are `x.1`, `x.2` ...; where titles repeat, those after a title without cells have it
    before them. `left_out` was left out of the table; `cell` is a cell of the file by row and
    number of the column, `decimal` the decimal mark of cells.
    """
    titles, every, known = zip(*columns, strict=True)
    written = [title.strip() or f"c{i}" for i, title in enumerate(titles, 1)]
    read = [column_of_cells(cells, decimal) for cells in every]
    if len(set(written)) < len(written):
        group = ""
        for i, (values, _) in enumerate(read):
            if pd.isna(values).all() and titles[i].strip():
                group = f"{written[i]}."
            elif titles[i].strip():
                written[i] = group + written[i]
    lines, groups = list(left_out), defaultdict[str, list[int]](list)
    for i, title in enumerate(written):
        if any(pd.Series(read[i][0]).equals(pd.Series(read[j][0])) for j in groups[title]):
            lines.append(f"column {title}: stands again, with equal cells")
        else:
            groups[title].append(i)
    parts = {t: m.groups() if (m := TITLE.fullmatch(t)) else (t, "") for t in groups}
    alike, numbers = Counter(plain for plain, _ in parts.values()), dict[str, int]()
    result, units = dict[str, Values](), dict[str, str]()
    for i in sorted(place for places in groups.values() for place in places):
        plain, unit = parts[title := written[i]]
        free = (t for k in count(1) if (t := f"{title}.{k}") not in {*groups, *numbers})
        own = next(free) if len(groups[title]) > 1 else plain if alike[plain] == 1 else title
        numbers[own], unit = i, known[i].strip("[]() ") or unit.strip()
        unit = next((word for word, form in UNITS.items() if re.fullmatch(form, unit)), unit)
        result[own], reason = read[i]
        if scale := re.fullmatch(r"deg[eE](\d)", unit):
            result[own], unit = np.asarray(result[own], float) / 10.0 ** int(scale[1]), "deg"
        units |= {own: unit} if unit else {}
        lines += [f"column {own}: {reason}"] if reason else []
    for own, moments, of in _dates(result):
        result[own], units[own] = moments, "s"
        lines.append(f"columns {', '.join(of)}: read as the time {own}")
    for own, angles in _angles(result, units):
        if units.get(own) not in SIDES:
            lines.append(f"column {own}: degrees and minutes, read as degrees")
        result[own], units[own] = angles, "deg"
    return Source(
        name, path, result, units,
        {own: written[i] for own, i in numbers.items() if own != written[i]},
        tuple(dict.fromkeys(lines)),
        None if cell is None else lambda row, column: cell(row, numbers.get(column, 0)),
    )  # fmt: skip


def column_of_cells(cells: Cells, decimal: str = ".") -> tuple[Values, str]:
    """Cells as numbers, NaN where one is missing, else as text; and what is left out, (N,).

    In a column of numbers, other cells are missing values, if they are few.
    """
    if isinstance(cells, np.ndarray | pd.Series):
        values = np.asarray(cells)
        return values if values.dtype == np.object_ else values.astype(np.float64, copy=False), ""
    cells = pa.array(cells, pa.string())
    plain = cells if decimal == "." else pc.replace_substring(cells, decimal, ".")
    try:
        numbers = plain.cast("float64").to_pandas()  # as most columns are
    except pa.ArrowInvalid:
        numbers = pd.to_numeric(plain.to_pandas(), errors="coerce")
        missing = pc.is_in(pc.ascii_lower(plain), value_set=pa.array(sorted(MISSING)))
        if numbers.count() < (1.0 - FEW) * (len(cells) - missing.true_count):
            coded = cells.dictionary_encode()  # a text once
            texts = np.array(coded.dictionary.to_pylist(), dtype=np.object_)
            return texts[coded.indices.to_numpy()], ""
    values = numbers.where(numbers.abs() <= MAX_NUMBER).to_numpy()
    words = pc.value_counts(pc.filter(cells, pa.array(np.isnan(values)))).to_pylist()
    said = [f"{row['counts']} of {len(cells)} cells are {row['values']}" for row in words
            if row["values"].lower() not in ("", "nan", "+nan")]  # fmt: skip
    reason = shorten(", ".join(said), 200, placeholder=" ...")
    return values, f"{reason}: missing values" if said else ""


def _dates(columns: Mapping[str, Values]) -> Iterator[tuple[str, Array, list[str]]]:
    """Times [s since 1970] of which year, month ... second are columns of their own."""
    groups = defaultdict[str, dict[str, str]](dict)
    for name, values in columns.items():
        match = re.fullmatch(rf"(.*?)[ _.]?({'|'.join(PARTS)})[a-z]*", name, re.IGNORECASE)
        if match and values.dtype != np.object_:
            groups[match[1]][PARTS[match[2].lower()]] = name
    for stem, own in groups.items():
        if len(own) == len(PARTS):
            frame = pd.DataFrame({part: columns[name] for part, name in own.items()})
            moments = pd.to_datetime(frame, errors="coerce") - pd.Timestamp(0)
            yield stem or "date_time", moments.dt.total_seconds().to_numpy(), list(own.values())


def _angles(columns: Mapping[str, Values], units: Mapping[str, str]) -> Iterator[tuple[str, Array]]:
    """Angles [deg] that are written as degrees and minutes: the number DDMM.mm.

    The unit of such numbers is lat or lon, as that of gliders is, or both are of this form by their
    range; a column of letters may stand beside them.
    """
    numbers = [name for name, values in columns.items() if values.dtype != np.object_]
    known = {name: units[name] for name in numbers if units.get(name) in SIDES}
    titled = {kind: name for name in numbers for kind in SIDES
              if re.search(rf"(?i)\b{kind}(g?itude|g)?(?![a-z])", name)}  # fmt: skip
    if len(titled) == 2:
        largest = np.nanmax(np.abs(columns[titled["lat"]]), initial=0.0)
        minutes = [np.nanmax(np.abs(columns[n]) % 100.0, initial=0.0) for n in titled.values()]
        if 90.0 < largest <= 9000.0 and max(minutes) < 60.0:
            known |= {name: kind for kind, name in titled.items()}
    for name, kind in known.items():
        whole = np.trunc(columns[name] / 100.0)
        angles = whole + (columns[name] - 100.0 * whole) / 60.0
        angles[np.abs(angles) > 180.0] = np.nan  # where a glider had no position
        texts = (cells for cells in columns.values() if cells.dtype == np.object_)
        sides = (cells for cells in texts if {""} < {*cells, ""} <= {*SIDES[kind], ""})
        yield name, np.where(next(sides, np.array("")) == SIDES[kind][1], -angles, angles)
