"""Tables of text cells, their output (rich, md, csv, latex, json), and the text of numbers."""

import csv
import io
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cache

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from seatrial.runner.database.terminal import visible

Scalar = str | float | int | bool | None
"""A value of a record; dates are ISO text."""
_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


class OutputFormat(StrEnum):
    """Names of the formats; csv and json are for programs, the others for readers."""

    RICH = "rich"
    MD = "md"
    CSV = "csv"
    LATEX = "latex"
    JSON = "json"


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

    @property
    def head(self) -> Sequence[TableCell]:
        """Return the headers as cells."""
        return [*map(TableCell, self.headers)]

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

    def cell(value: Scalar) -> TableCell:
        if value is None or isinstance(value, bool | str):
            return TableCell("" if value is None else str(value))
        return TableCell(number_text(value, digits), sort=float(value))

    records = [dict(zip(headers, row, strict=True)) for row in rows]
    cells = [[*map(cell, row)] for row in rows]
    return TextTable(title, headers, cells, labels, notes, records)


def number_text(value: float, digits: int = 4) -> str:
    """Return a number with `digits` significant digits: 0.04312, 2757, 12346."""
    if isinstance(value, int):
        return str(value)
    if not math.isfinite(value):
        return str(float(value))
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
    raised = re.sub(r"\^(-?\d)", lambda power: power[1].translate(_SUPERSCRIPTS), unit)
    return raised.replace("*", "·")


def with_unit(name: str, unit: str | None) -> str:
    """Return `name [unit]`, or the name alone if there is no unit."""
    shown = unit_text(unit)
    return f"{name} [{shown}]" if shown else name


def one_line(text: str, width: int = 80) -> str:
    """Return the text on one line, cut at `width` characters with an ellipsis."""
    flat = " ".join(text.split())
    return flat if len(flat) <= width else flat[: width - 1].rstrip() + "…"


def render(
    grid: TextTable, form: OutputFormat, width: int | None = None, colour: bool = False
) -> str:
    """Return the grid as text, without a newline at the end.

    `width` [characters] and `colour` apply to `rich` only; without a width nothing is wrapped.
    """
    if form is OutputFormat.RICH:
        return _rich(grid, width, colour)
    own = {"md": _markdown, "csv": _csv, "latex": _latex, "json": _json}
    return own[form](grid)


def _rich(grid: TextTable, width: int | None, colour: bool) -> str:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for index, header in enumerate(grid.headers):
        table.add_column(Text(visible(header)), justify="left" if index < grid.labels else "right")
    for row in grid.rows:
        table.add_row(*(Text(visible(c.text), style="bold" if c.bold else "") for c in row))
    console = Console(
        file=io.StringIO(), width=width or 10_000, force_terminal=colour, highlight=False,
        force_jupyter=False,  # in a notebook, too, the text is returned
    )  # fmt: skip
    with console.capture() as capture:
        if grid.title:
            console.print(Text(visible(grid.title), style="bold"), soft_wrap=width is None)
        console.print(table)
        for note in grid.notes:
            console.print(Text(visible(note)), soft_wrap=width is None)
    return "\n".join(line.rstrip() for line in capture.get().splitlines()).strip("\n")


def _markdown(grid: TextTable) -> str:
    rules = [":---" if index < grid.labels else "---:" for index in range(len(grid.headers))]
    rows = [[_markdown_text(header) for header in grid.headers], rules]
    for row in grid.rows:
        texts = [(_markdown_text(cell.text), cell.bold) for cell in row]
        rows.append([f"**{text}**" if bold and text else text for text, bold in texts])
    title = [f"**{_markdown_text(grid.title)}**", ""] if grid.title else []
    notes = [part for note in grid.notes for part in ("", _markdown_text(note))]
    return "\n".join([*title, *(f"| {' | '.join(cells)} |" for cells in rows), *notes])


def _markdown_text(text: str) -> str:
    for special in ("\\", "|", "*", "`"):
        text = text.replace(special, "\\" + special)
    return text.replace("<", "&lt;").replace("\n", "<br>")


def _csv(grid: TextTable) -> str:
    """Numbers at full precision, booleans as true and false; a missing value is empty."""
    records = grid.as_records()
    names = list(dict.fromkeys(name for record in records for name in record))
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(names or [header.replace("\n", " ") for header in grid.headers])
    for values in ([record.get(name) for name in names] for record in records):
        writer.writerow(
            str(v).lower() if isinstance(v, bool) else "" if v != v else v for v in values
        )
    return out.getvalue().rstrip("\n")


def _json(grid: TextTable) -> str:
    records = [
        {n: None if isinstance(v, float) and not math.isfinite(v) else v for n, v in r.items()}
        for r in grid.as_records()
    ]
    return json.dumps(records, indent=2, allow_nan=False)


_LATEX = str.maketrans({
    **{letter: f"\\{letter}" for letter in "&%$#_{}"}, "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "|": r"\textbar{}",
    "<": r"\textless{}", ">": r"\textgreater{}", "±": r"$\pm$", "×": r"$\times$", "·": r"$\cdot$",
    "²": r"$^2$", "³": r"$^3$", "⁻": r"$^-$", "¹": r"$^1$", "†": r"\dag{}", "‡": r"\ddag{}",
    "§": r"\S{}", "…": r"\dots{}",
})  # fmt: skip


def _latex(grid: TextTable) -> str:
    headers = []
    for header in grid.headers:
        first, *others = header.translate(_LATEX).split("\n")
        lines = r" \\ ".join([first, *others])
        headers.append(rf"\shortstack{{{lines}}}" if others else first)
    rows = []
    for row in grid.rows:
        texts = [(cell.text.replace("\n", " ").translate(_LATEX), cell.bold) for cell in row]
        rows.append([rf"\textbf{{{text}}}" if bold and text else text for text, bold in texts])
    notes = (note.translate(_LATEX) for note in grid.notes)
    first, *others = (" & ".join(cells) + r" \\" for cells in [headers, *rows])
    return "\n".join([
        r"\begin{table}  % needs \usepackage{booktabs}", r"\centering",
        rf"\caption{{{grid.title.translate(_LATEX)}}}",
        rf"\begin{{tabular}}{{{'l' * grid.labels + 'r' * (len(grid.headers) - grid.labels)}}}",
        r"\toprule", first, r"\midrule", *others, r"\bottomrule", r"\end{tabular}",
        *(rf"\par\smallskip{{\footnotesize {note}}}" for note in notes), r"\end{table}",
    ])  # fmt: skip
