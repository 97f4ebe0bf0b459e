"""What the formats share: cells as numbers, and columns with titles as a source."""

import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import count
from pathlib import Path
from textwrap import shorten
from typing import TypeAlias

import numpy as np
import pandas as pd
import pyarrow as pa
from pyarrow import compute as pc

from seatrial.models.recording.source import MISSING, Source, Values
from seatrial.models.vessel.basis import Array

MAX_NUMBER = 1e30  # larger numbers are not measurements, and their squares could overflow
FEW = 0.5  # share of cells, or rows, below which those that do not fit are left out
NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
TITLE = re.compile(r"(.*?\S)[\s_]*[\[({](?!\d+[\])])(?:in )?([^\[\](){}]*?)(?: since .*)?[\])}]")
PARTS = ("yea", "mon", "day", "hou", "min", "sec")  # of a time in columns of their own
UNITS = {  # of gliders, autopilots and netCDF, as regular expressions
    "": "nodim|bool|enum|instance|UNKNOWN|satellites", "s": "timestamp",
    "deg": r"deg(?:rees?)?_?(?:north|east|[NE]|heading|latitude|longitude)?(?: \(.*)?",
}  # fmt: skip
SIDES = {"lat": ("N", "S"), "lon": ("E", "W")}
ANGLE = re.compile(
    r"(\d{1,3})\s*[°º\s]\s*(\d{1,2}(?:[.,]\d+)?)\s*['’′]?\s*"
    r"(\d{0,2}(?:[.,]\d+)?)\s*(?:[\"″]|'')?\s*([NSEWO])"
)
Cells: TypeAlias = Values | pa.Array | Sequence[str]  # as written, unless they are numbers


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
    columns, lines = list(columns), list(left_out)
    repeated = len({title for title, *_ in columns}) < len(columns)
    read, written = list[tuple[Values, str]](), list[str]()
    group, groups = "", defaultdict[str, list[int]](list)
    for i, (title, cells, _) in enumerate(columns):
        read.append(column_of_cells(cells, decimal))
        values = read[i][0]
        if repeated and title.strip():
            empty = pd.isna(values).all()
            group, title = (f"{title}.", title) if empty else (group, group + title)
        written.append(title.strip() or f"c{i + 1}")
        if any(pd.Series(values).equals(pd.Series(read[j][0])) for j in groups[written[i]]):
            lines.append(f"column {written[i]}: stands again, with equal cells")
        else:
            groups[written[i]].append(i)
    parts = {t: m.groups() if (m := TITLE.fullmatch(t)) else (t, "") for t in groups}
    alike, numbers = Counter(plain for plain, _ in parts.values()), dict[str, int]()
    result, units = dict[str, Values](), dict[str, str]()
    for i in sorted(place for places in groups.values() for place in places):
        plain, unit = parts[title := written[i]]
        free = (t for k in count(1) if (t := f"{title}.{k}") not in {*groups, *numbers})
        own = next(free) if len(groups[title]) > 1 else plain if alike[plain] == 1 else title
        numbers[own], unit = i, columns[i][2].strip("[]() ") or unit.strip()
        unit = next((known for known, form in UNITS.items() if re.fullmatch(form, unit)), unit)
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
    titles = {own: written[i] for own, i in numbers.items() if own != written[i]}
    return Source(
        name, path, result, units, titles, tuple(dict.fromkeys(lines)),
        None if cell is None else lambda row, column: cell(row, numbers[column]),
    )  # fmt: skip


def column_of_cells(cells: Cells, decimal: str = ".") -> tuple[Values, str]:
    """Cells as numbers, NaN where one is missing, else as text; and what is left out, (N,).

    In a column of numbers, other cells are missing values, if they are few.
    """
    if isinstance(cells, np.ndarray):
        return cells if cells.dtype == np.object_ else cells.astype(np.float64, copy=False), ""
    cells = pa.array(cells, pa.string())
    plain = cells if decimal == "." else pc.replace_substring(cells, decimal, ".")
    try:
        numbers = plain.cast("float64")  # as most columns are
    except pa.ArrowInvalid:
        missing = pc.is_in(pc.ascii_lower(plain), value_set=pa.array(sorted(MISSING)))
        plain = pc.utf8_ltrim(plain, "+")
        number = pc.match_substring_regex(plain, f"^(?:{NUMBER.pattern})$")
        if number.true_count < (1.0 - FEW) * (len(cells) - missing.true_count):
            coded = cells.dictionary_encode()  # a text once
            texts = np.array(coded.dictionary.to_pylist(), dtype=np.object_)
            return texts[coded.indices.to_numpy()], ""
        numbers = pc.if_else(number, plain, None).cast("float64")
    values = np.array(numbers.to_numpy(zero_copy_only=False))
    values[np.abs(values) > MAX_NUMBER] = np.nan
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
            groups[match[1]][match[2].lower()] = name
    for stem, own in groups.items():
        if set(own) == set(PARTS):
            year, month, day, *clock = (np.asarray(columns[own[part]], float) for part in PARTS)
            whole = np.nan_to_num([year - 1970.0, month - 1.0, day - 1.0]).astype(np.int64)
            months = whole[0].astype("datetime64[Y]").astype("datetime64[M]") + whole[1]
            midnight = (months.astype("datetime64[D]") + whole[2]).astype("datetime64[s]")
            t = midnight.astype(np.float64) + np.array([3600.0, 60.0, 1.0]) @ clock
            yield stem or "date_time", t + 0.0 * (year + month + day), list(own.values())


def _angles(columns: Mapping[str, Values], units: Mapping[str, str]) -> Iterator[tuple[str, Array]]:
    """Angles [deg] that are written as degrees and minutes: `40°30.5'S`, or the number DDMM.mm.

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
    for name, values in columns.items():
        first = next(filter(None, values), "") if values.dtype == np.object_ else ""
        if isinstance(first, str) and ANGLE.fullmatch(first):
            parts = pd.Series(values).str.replace(",", ".").str.extract(f"^{ANGLE.pattern}$")
            size = parts[[0, 1, 2]].replace("", "0").astype(float) @ [1.0, 1.0 / 60.0, 1.0 / 3600.0]
            if size.isna().mean() < FEW:
                yield name, np.where(parts[3].isin(["S", "W"]), -size, size)
