"""Text of any layout, exports of InfluxDB, and titled cells of any format as a source."""

import csv
import io
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain, count, islice
from pathlib import Path
from textwrap import shorten
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from pyarrow import compute as pc
from pyarrow import csv as arrow

from seatrial.models.errors import RecordingError
from seatrial.models.recording.source import MISSING, ReadOptions, Source, Values, check_size

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


def read(path: Path, options: ReadOptions) -> tuple[list[Source], Sequence[str]]:
    """The columns of a text file; raises RecordingError if it cannot be read as a table."""
    data, left_out = decoded(path, options.text.encoding)
    annotated = re.search(rb"^#(group|datatype|default)\b", data[:4096], re.M)  # by InfluxDB
    parts = re.split(rb"\n\r?\n(?=#)", data.strip()) if annotated else [data]
    return _wide([table(path, part, options) for part in parts]), left_out


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
        got = f"{path}: got binary data or text that is not {encoding}"
        raise RecordingError(f"{got}; excitation.text.encoding=latin-1 reads another encoding")
    if not data or data.isspace():
        raise RecordingError(f"{path}: is empty, expected a header and samples")
    return data, said


def table(path: Path, data: bytes, options: ReadOptions, name: str | None = None) -> Source:
    """The columns of a text as a source; raises RecordingError if it is not a table.

    A few rows of another length than the header are left out.
    """
    names = options.text.names
    data, commented, separator, white = _plain(data, options)
    head = list(islice(_rows(data, separator), SAMPLE_LINES))
    rows = [row for _, row in head]
    start, before = _header(rows, white, options.text.header_lines)
    if len(head) <= before:
        raise RecordingError(f"{path}: got a header and no rows, expected samples below it")
    titles = rows[start:before]
    width = len((titles or rows[before:])[0])
    if width > MOST_COLUMNS or (names and len(names) != width):
        wanted = f"{len(names)} as in excitation.text.names" if names else f"at most {MOST_COLUMNS}"
        raise RecordingError(f"{path}: got {width} columns, expected {wanted}")
    check_size(path, 8 * (data.count(b"\n") + 1) * width)
    above = [w for line in commented for w in (line.split(), line.split(separator))
             if len(w) == width and not any(map(_is_number, w))]  # fmt: skip
    titles, blank = titles or above[-1:], [""] * width
    written = [title.strip() for title in titles[0]] if titles else blank
    units = titles[1] if len(titles) > 1 and len(titles[1]) == width else blank
    top = head[before - 1][0] if before else 0  # lines above the first sample
    keys, other = [str(place) for place in range(width)], list[arrow.InvalidRow]()

    def skip(row: arrow.InvalidRow) -> str:
        other.append(row)
        return "skip"

    reading = arrow.ReadOptions(use_threads=False, skip_rows=top, column_names=keys)
    reading.block_size = len(data)
    stored = arrow.read_csv(
        pa.py_buffer(data), reading,
        arrow.ParseOptions(delimiter=separator, newlines_in_values=True, invalid_row_handler=skip),
        arrow.ConvertOptions(column_types=dict.fromkeys(keys, pa.string())),
    )  # fmt: skip
    if len(other) >= FEW * (stored.num_rows + len(other)):
        line, row = next(each for each in _rows(data, separator, top) if len(each[1]) != width)
        got = f"{path}, line {line}: got {len(row)} cells, expected {width}"
        raise RecordingError(f"{got} as in the header (separator {separator!r})")
    columns = [pc.utf8_trim_whitespace(column.combine_chunks()) for column in stored.columns]

    def cell(row: int, place: int) -> tuple[str, str]:
        samples = (each for each in _rows(data, separator, top) if len(each[1]) == width)
        line, found = next(islice(samples, row, None))
        return f"line {line}", found[place]

    said = [f"{len(other)} rows with more or fewer than {width} cells"] if other else []
    triples = zip(names or written, columns, units, strict=True)
    return table_source(name or path.stem, path, triples, said, cell)


def _plain(data: bytes, options: ReadOptions) -> tuple[bytes, list[str], str, bool]:
    """The text without comments and decimal commas, comments above, separator, if that is white."""
    skipped, above = options.text.skip_lines, list[str]()
    data = re.sub(rb"\n[ \t]+(?=\r?\n)", b"\n", data)
    head = data[:65536].decode(errors="replace")
    twice = (mark for mark in MARKS if re.match(rf"(\s*{mark}.*\n){{2}}", head))
    if mark := options.text.comment and next(twice, options.text.comment):
        sign = rf"^[ \t]*(?:{re.escape(mark)})+(.*)"
        above = re.findall(sign, head, re.MULTILINE)
        if mark.encode() in data:
            data = re.sub(sign.encode(), b"", data, flags=re.MULTILINE)
    data = b"\n" * skipped + b"".join(data.split(b"\n", skipped)[skipped:])
    lines = [line.strip(" \r") for line in data[:65536].decode(errors="replace").split("\n")]
    lines = [line for line in lines if line][:SAMPLE_LINES]

    def most(mark: str) -> int:  # lines that a separator cuts alike; words only if numbers
        rows = (line.split(mark.strip(" ") or None) for line in lines)
        counts = Counter(len(row) for row in rows if len(row) > 1 and (mark != " " or all(
            _is_number(c) or c.lower() in MISSING for c in row)))  # fmt: skip
        return max(counts.values(), default=0)

    separator: str = options.text.separator or max(SEPARATORS, key=most)
    cells = [cell for line in lines for cell in line.split(separator.strip(" ") or None)]
    points, commas = (sum(mark in c and _is_number(c, mark) for c in cells) for mark in ".,")
    decimal = options.text.decimal or ("," if commas > points and separator != "," else ".")
    if decimal == ",":
        data = re.sub(rb"(?<=\d),(?=\d)", b".", data)
    if separator != " ":
        return data, above, separator, False
    return b"\n".join(b"\t".join(e.split()) for e in data.split(b"\n")), above, "\t", True


def _rows(data: bytes, separator: str, top: int = 0) -> Iterator[tuple[int, list[str]]]:
    """The line on which each row below `top` lines ends, and its cells; not of blank lines."""
    lines = io.TextIOWrapper(io.BytesIO(data), "utf-8", newline="")
    reader = csv.reader(lines, delimiter=separator)
    return ((reader.line_num, row) for row in reader if row and reader.line_num > top)


def _is_number(cell: str, decimal: str = ".") -> bool:
    return bool(NUMBER.fullmatch(cell.strip().replace(decimal, ".")))


def _header(rows: list[list[str]], white: bool, wanted: int | None) -> tuple[int, int]:
    """The rows before the header and before the first sample; `wanted` are those of the header.

    A sample has a number or a date; between white space, where words are cells, nothing else. Rows
    of one cell or of another length than the samples are a preamble. A header without a title for
    the numbers of R's rows, or the end of MATLAB's, gets an empty one.
    """
    usual = Counter(map(len, rows)).most_common(1)[0][0] if rows else 0
    samples = [row for row in rows if len(row) == usual > 1]
    ended = bool(samples) and not any(row[-1].strip() for row in samples)
    numbered = [row[0].strip() for row in samples] == [str(k + 1) for k in range(len(samples))]
    for row in rows if ended or numbered else ():
        if len(row) == usual - 1:
            row.insert(usual if ended else 0, "")
    if wanted is not None:
        return 0, wanted
    for first, row in enumerate(rows):
        filled = [cell.strip() for cell in row if cell.strip().lower() not in MISSING]
        sampled = [_is_number(cell) or bool(DATE.match(cell)) for cell in filled]
        sizes = first > 1 and len(row) == len(rows[first - 1]) > 1 and set(filled) <= SIZES
        if (all(sampled) if white else any(sampled)) and not sizes:
            break
    else:
        return 0, min(len(rows), 1)
    full = [sum(bool(cell.strip()) for cell in row) for row in rows[:first]]
    width = len(rows[first])
    starts = [k for k in range(first) if len(rows[k]) == width and full[k] >= min(width, 2)]
    if not starts:  # a preamble, or a header that is too short
        return (0, 1) if first == 1 < len(rows[0]) and not white else (first, first)
    start = max(starts, key=lambda k: full[k])
    return start, first if first - start <= MOST_HEADER_LINES else start + 1


def _wide(parts: list[Source]) -> list[Source]:
    """The sources of tables with a row a value: one for each measurement and its tags."""
    columns = parts[0].columns
    known = {k: next((n for n in own if n in columns), "") for k, own in LONG.items()}
    alike = all({*known.values()} <= {*part.columns} for part in parts)
    if not alike or columns[known["_field"]].dtype != np.object_:
        return parts
    frame = pd.concat([pd.DataFrame(part.columns) for part in parts])
    frame = frame.rename(columns={name: k for k, name in known.items()})
    texts, keys = [*frame.select_dtypes(exclude="number")], ["_time", "_field"]
    tags = [name for name in texts if name not in (*LONG, "_start", "_stop", "result")
            and (name == "_measurement" or frame[name].nunique() > 1)]  # fmt: skip
    if "_time" in texts:
        times = pd.to_datetime(frame["_time"], format="ISO8601", utc=True, errors="coerce")
        frame["_time"] = (times - pd.Timestamp(0, tz="UTC")).dt.total_seconds()
    lost = ", ".join(name for name in frame if name not in (*tags, *LONG))
    unique = frame.dropna(subset="_time").drop_duplicates([*tags, *keys])
    said, result = [line for part in parts for line in part.left_out], list[Source]()
    said += [f"columns {lost}: not of the values of this long table"] if lost else []
    if count := len(frame) - len(unique):
        said.append(f"{count} values without a time, or at times that repeat")
    for key, rows in unique.groupby(tags) if tags else [((), unique)]:
        wide = rows.pivot(index="_time", columns="_field", values="_value")
        cells = wide.fillna("").astype(str) if "_value" in texts else wide
        triples = [("_time", wide.index, "s"), *((str(n), x, "") for n, x in cells.items())]
        name = "/".join(map(str, key)) or parts[0].name
        result.append(table_source(name, parts[0].path, triples, () if result else said))
    return result


def table_source(
    name: str, path: Path, columns: Iterable[tuple[str, Any, str]], left_out: Sequence[str] = (),
    cell: Callable[[int, int], tuple[str, str]] | None = None,
) -> Source:  # fmt: skip
    """Columns by title, cells and unit (empty: not known), (N,) each, as the source `name`.

    `t [s]` is the column `t` in `s`, a column without title is c1, c2 ... Columns whose names
    differ by the unit only keep their titles. Of columns of one title with equal cells one is kept,
    others are `x.1`, `x.2` ...; where titles repeat, those after a title without cells have it
    before them. Angles of the units lat and lon may have a column of letters beside them. `cell` is
    a cell of the file by row and number of the column.
    """
    titles, every, known = zip(*columns, strict=True)
    written = [title.strip() or f"c{i}" for i, title in enumerate(titles, 1)]
    read, group = [column_of_cells(cells) for cells in every], ""
    repeated = len(set(written)) < len(written)
    lines, places = list(left_out), defaultdict[str, list[int]](list)
    for i, (values, _) in enumerate(read):
        if repeated and titles[i].strip():
            empty, title = pd.isna(values).all(), written[i]
            group, written[i] = (f"{title}.", title) if empty else (group, group + title)
        if any(pd.Series(values).equals(pd.Series(read[j][0])) for j in places[written[i]]):
            lines.append(f"column {written[i]}: stands again, with equal cells")
        else:
            places[written[i]].append(i)
    parts = {t: m.groups() if (m := TITLE.fullmatch(t)) else (t, "") for t in places}
    alike, numbers = Counter(plain for plain, _ in parts.values()), dict[str, int]()
    result, units = dict[str, Values](), dict[str, str]()
    for i in sorted(chain.from_iterable(places.values())):
        plain, unit = parts[title := written[i]]
        free = (t for k in count(1) if (t := f"{title}.{k}") not in {*places, *numbers})
        own = next(free) if len(places[title]) > 1 else plain if alike[plain] == 1 else title
        numbers[own], unit = i, known[i].strip("[]() ") or unit.strip()
        unit = next((word for word, form in UNITS.items() if re.fullmatch(form, unit)), unit)
        result[own], reason = read[i]
        if scale := re.fullmatch(r"deg[eE](\d)", unit):
            result[own], unit = np.asarray(result[own], float) / 10.0 ** int(scale[1]), "deg"
        units |= {own: unit} if unit else {}
        lines += [f"column {own}: {reason}"] if reason else []
    lines += _dates(result, units)
    texts = [cells for cells in result.values() if cells.dtype == np.object_]
    for own, kind in units.items():  # degrees and minutes as the number DDMM.mm
        if kind in SIDES and result[own].dtype != np.object_:
            whole = np.trunc(result[own] / 100.0)
            angles = whole + (result[own] - 100.0 * whole) / 60.0
            angles[np.abs(angles) > 180.0] = np.nan  # where a glider had no position
            sides = (cells for cells in texts if {""} < {*cells, ""} <= {*SIDES[kind], ""})
            result[own] = np.where(next(sides, np.array("")) == SIDES[kind][1], -angles, angles)
            units[own] = "deg"
    changed = {own: written[i] for own, i in numbers.items() if own != written[i]}
    place = None if cell is None else lambda row, column: cell(row, numbers.get(column, 0))
    return Source(name, path, result, units, changed, tuple(dict.fromkeys(lines)), place)


def column_of_cells(cells: Any) -> tuple[Values, str]:
    """Cells as numbers, NaN where one is missing, else as text; and what is left out, (N,).

    `cells` are numbers, date-times or texts. A few texts among numbers are missing values.
    """
    if not isinstance(cells, pa.Array | list):
        values = pd.Series(cells)
        if pd.api.types.is_numeric_dtype(values):
            return values.to_numpy(np.float64, na_value=np.nan), ""
        cells = values.astype(str).mask(values.isna(), "").to_list()
    cells = pa.array(cells, pa.string())
    fits = pc.match_substring_regex(cells, f"^{NUMBER.pattern}$")
    missing = pc.is_in(pc.ascii_lower(cells), value_set=pa.array(sorted(MISSING)))
    if fits.true_count < (1.0 - FEW) * (len(cells) - missing.true_count):
        return cells.to_pandas().to_numpy(np.object_), ""
    numbers = pc.if_else(fits, pc.utf8_ltrim(cells, "+"), None).cast("float64").to_pandas()
    values = numbers.where(numbers.abs() <= MAX_NUMBER).to_numpy()
    words = pc.value_counts(pc.filter(cells, pa.array(np.isnan(values)))).to_pylist()
    said = [f"{row['counts']} of {len(cells)} cells are {row['values']}" for row in words
            if row["values"].lower() not in ("", "nan", "+nan")]  # fmt: skip
    reason = shorten(", ".join(said), 200, placeholder=" ...")
    return values, f"{reason}: missing values" if said else ""


def _dates(columns: dict[str, Values], units: dict[str, str]) -> Iterator[str]:
    """Add times [s since 1970] of which year, month ... second are columns of their own."""
    groups = defaultdict[str, dict[str, str]](dict)
    for name, values in columns.items():
        match = re.fullmatch(rf"(.*?)[ _.]?({'|'.join(PARTS)})[a-z]*", name, re.IGNORECASE)
        if match and values.dtype != np.object_:
            groups[match[1]][PARTS[match[2].lower()]] = name
    for stem, own in groups.items():
        if len(own) == len(PARTS):
            frame = pd.DataFrame({part: columns[name] for part, name in own.items()})
            moments = pd.to_datetime(frame, errors="coerce") - pd.Timestamp(0)
            name = stem or "date_time"
            columns[name], units[name] = moments.dt.total_seconds().to_numpy(), "s"
            yield f"columns {', '.join(own.values())}: read as the time {name}"
