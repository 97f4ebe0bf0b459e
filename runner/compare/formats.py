"""Output formats of a grid: rich, md, csv, latex, json, html."""

import csv
import io
import json
import math
from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import TYPE_CHECKING

from markupsafe import Markup
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from seatrial.runner.compare.grid import TableCell, TextTable
from seatrial.runner.database.terminal import visible

if TYPE_CHECKING:
    from seatrial.runner.compare import page
else:
    import lazy_loader

    page = lazy_loader.load("seatrial.runner.compare.page", suppress_warning=True)


class OutputFormat(StrEnum):
    """Names of the formats; csv and json are for programs, the others for readers."""

    RICH = "rich"
    MD = "md"
    CSV = "csv"
    LATEX = "latex"
    JSON = "json"
    HTML = "html"


def render(
    grid: TextTable, form: OutputFormat, width: int | None = None, colour: bool = False
) -> str:
    """Return the grid as text, without a newline at the end.

    `width` [characters] and `colour` apply to `rich` only; without a width nothing is wrapped.
    """
    if form is OutputFormat.RICH:
        return _rich(grid, width, colour)
    return _WRITERS[form](grid)


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
    text = json.dumps(records, indent=2, ensure_ascii=False, allow_nan=False)
    if visible(text) == text:
        return text
    return json.dumps(records, indent=2, allow_nan=False)  # escaped as JSON has it


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
    return "\n".join([
        r"\begin{table}  % needs \usepackage{booktabs}",
        r"\centering",
        rf"\caption{{{grid.title.translate(_LATEX)}}}",
        rf"\begin{{tabular}}{{{'l' * grid.labels + 'r' * (len(grid.headers) - grid.labels)}}}",
        r"\toprule",
        " & ".join(headers) + r" \\",
        r"\midrule",
        *(" & ".join(cells) + r" \\" for cells in rows),
        r"\bottomrule",
        r"\end{tabular}",
        *(rf"\par\smallskip{{\footnotesize {note}}}" for note in notes),
        r"\end{table}",
    ])  # fmt: skip


def html_table(grid: TextTable) -> Markup:
    """Return the table as HTML; on a page it has its own scroll bar, and its headings sort it.

    On a phone the first column stays in view with the other labels in small print, so that the
    values follow it at once.
    """
    return page.table(grid, [TableCell(header) for header in grid.headers])


_WRITERS: Mapping[OutputFormat, Callable[[TextTable], str]] = {
    OutputFormat.MD: _markdown, OutputFormat.CSV: _csv, OutputFormat.LATEX: _latex,
    OutputFormat.JSON: _json,
    OutputFormat.HTML: lambda grid: html_table(grid).encode("ascii", "xmlcharrefreplace").decode(),
}  # fmt: skip
