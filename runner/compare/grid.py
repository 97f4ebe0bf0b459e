"""A table ready to be shown, whatever it holds, and the figures in its cells."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache

Scalar = str | float | int | bool | None
"""What a record may hold; dates come as ISO text."""
_SUPERSCRIPTS = {"^2": "²", "^3": "³", "^-1": "⁻¹", "^-2": "⁻²"}


@dataclass(frozen=True)
class Cell:
    """Text of a cell; `sort` is what a sortable table orders it by; prose may be wrapped."""

    text: str
    bold: bool = False
    sort: float | None = None
    prose: bool = False


@dataclass(frozen=True)
class Grid:
    """A titled table: headers (levels parted by newlines), cells, notes under it.

    The first `labels` columns name the row, the others hold figures. `records` are the same facts
    for machines, full precision, one object a line of a CSV file; without them the cells are used.
    """

    title: str
    headers: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    labels: int = 1
    notes: Sequence[str] = ()
    records: Sequence[Mapping[str, Scalar]] | None = field(default=None, repr=False)

    def as_records(self) -> Sequence[Mapping[str, Scalar]]:
        """The facts for CSV and JSON."""
        if self.records is not None:
            return self.records
        names = [header.replace("\n", " ") for header in self.headers]
        return [dict(zip(names, (cell.text for cell in row), strict=True)) for row in self.rows]


def grid_of(
    title: str,
    headers: Sequence[str],
    rows: Sequence[Sequence[Scalar]],
    labels: int = 1,
    notes: Sequence[str] = (),
    digits: int = 4,
) -> Grid:
    """A grid of plain values; records keep their full precision."""
    cells = [[value_cell(value, digits) for value in row] for row in rows]
    records = [dict(zip(headers, row, strict=True)) for row in rows]
    return Grid(title, headers, cells, labels, notes, records)


def value_cell(value: Scalar, digits: int = 4) -> Cell:
    """A cell for one plain value."""
    if isinstance(value, bool) or value is None or isinstance(value, str):
        return Cell("" if value is None else str(value))
    return Cell(number_text(value, digits), sort=float(value))


def number_text(value: float, digits: int = 4) -> str:
    """A figure with `digits` significant digits, whole thousands kept: 0.04312, 2757, 12346."""
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
    """A unit as it is printed: `N^2` becomes N², `1` and nothing stay empty."""
    if unit is None or unit in ("", "1", "-"):
        return ""
    for plain, raised in _SUPERSCRIPTS.items():
        unit = unit.replace(plain, raised)
    return unit.replace("*", "·")


def with_unit(name: str, unit: str | None) -> str:
    """`name [unit]`, or the name alone where there is no unit."""
    shown = unit_text(unit)
    return f"{name} [{shown}]" if shown else name


def one_line(text: str, width: int = 80) -> str:
    """The text without line breaks, cut at `width` columns with an ellipsis."""
    flat = " ".join(text.split())
    return flat if len(flat) <= width else flat[: width - 1].rstrip() + "…"
