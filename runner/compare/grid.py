"""Tables of text cells, ready for output, and the formatting of numbers and units."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache

Scalar = str | float | int | bool | None
"""A value of a record; dates are ISO text."""
_SUPERSCRIPTS = {"^2": "²", "^3": "³", "^-1": "⁻¹", "^-2": "⁻²"}


@dataclass(frozen=True)
class TableCell:
    """Text of a cell; a sortable table sorts by `sort`; `prose` may be wrapped."""

    text: str
    bold: bool = False
    sort: float | None = None
    prose: bool = False


@dataclass(frozen=True)
class TextTable:
    """A titled table: headers (levels separated by newlines), cells, and notes under it.

    The first `labels` columns name the row, the others hold numbers. `records` hold the same data
    at full precision for CSV and JSON, one record for each line; without them the cells are used.
    """

    title: str
    headers: Sequence[str]
    rows: Sequence[Sequence[TableCell]]
    labels: int = 1
    notes: Sequence[str] = ()
    records: Sequence[Mapping[str, Scalar]] | None = field(default=None, repr=False)

    def as_records(self) -> Sequence[Mapping[str, Scalar]]:
        """Return the records for CSV and JSON."""
        if self.records is not None:
            return self.records
        names = [header.replace("\n", " ") for header in self.headers]
        return [dict(zip(names, (cell.text for cell in row), strict=True)) for row in self.rows]


def grid_of(
    title: str, headers: Sequence[str], rows: Sequence[Sequence[Scalar]], labels: int = 1,
    notes: Sequence[str] = (), digits: int = 4,
) -> TextTable:  # fmt: skip
    """Return a grid of plain values; its records keep their full precision.

    `headers` name the columns, of which the first `labels` name the row; `rows` hold one value for
    each column, `notes` stand under the table, and numbers have `digits` significant digits.
    """
    cells = list[list[TableCell]]()
    for row in rows:
        cells.append([])
        for value in row:
            if value is None or isinstance(value, bool | str):
                cells[-1].append(TableCell("" if value is None else str(value)))
            else:
                cells[-1].append(TableCell(number_text(value, digits), sort=float(value)))
    records = [dict(zip(headers, row, strict=True)) for row in rows]
    return TextTable(title, headers, cells, labels, notes, records)


def number_text(value: float, digits: int = 4) -> str:
    """Return a number with `digits` significant digits: 0.04312, 2757, 12346."""
    if isinstance(value, int):
        return str(value)
    if not math.isfinite(value):
        return "nan" if math.isnan(value) else ("inf" if value > 0 else "-inf")
    if value == 0.0:
        return "0"
    size = int(f"{value:.{digits - 1}e}".partition("e")[2])  # after rounding: 9.96 is 10
    if not -4 <= size < 6:
        return f"{value:.{digits - 1}e}"
    return f"{value:.{max(0, digits - 1 - size)}f}"


@cache
def unit_text(unit: str | None) -> str:
    """Return a unit as it is printed: `N^2` becomes N²; `1` and None become empty."""
    if unit is None or unit in ("", "1", "-"):
        return ""
    for plain, raised in _SUPERSCRIPTS.items():
        unit = unit.replace(plain, raised)
    return unit.replace("*", "·")


def with_unit(name: str, unit: str | None) -> str:
    """Return `name [unit]`, or the name alone if there is no unit."""
    shown = unit_text(unit)
    return f"{name} [{shown}]" if shown else name


def one_line(text: str, width: int = 80) -> str:
    """Return the text on one line, cut at `width` characters with an ellipsis."""
    flat = " ".join(text.split())
    return flat if len(flat) <= width else flat[: width - 1].rstrip() + "…"
