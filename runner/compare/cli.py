"""Shared parts of the commands: the application, the common options and the printing of tables.

The commands are in `commands` and `logbook_commands`. Each command imports what it needs when it
runs, so that --help starts fast.
"""

import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from seatrial.runner.compare.formats import Format, render
from seatrial.runner.compare.grid import Grid
from seatrial.runner.database.mask import styled

DEFAULT_DATABASE = "sqlite:///results/results.db"
app = typer.Typer(
    name="seatrial-results",
    help="Compare the runs that are stored in a results database.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
Database = Annotated[
    str, typer.Option("--database", metavar="URL", help="URL or file of the logbook.")
]
Form = Annotated[Format, typer.Option("--format", "-f", help="Output format of the table.")]
Where = Annotated[
    str | None,
    typer.Option(
        "--where", help='Only runs that meet this condition: "seed<10 and identifier=ls".'
    ),
]
ResultsDir = Annotated[
    Path | None,
    typer.Option("--results-dir", help="Folder of the series files, if not beside the database."),
]
Several = list[str] | None
MOST = 1_000_000_000  # rows that --limit may ask for


def split(texts: Several) -> tuple[str, ...]:
    """Return the values of a repeated or comma-separated option, without empty ones."""
    parts = (part.strip() for text in texts or () for part in text.split(","))
    return tuple(part for part in parts if part)


def axes_of(rows: str | None, columns: str | None) -> tuple[str, str]:
    """Return the factors of rows and columns; the defaults are identifier and disturbance.

    If one option already uses the default of the other, the defaults are exchanged.
    """
    if rows is None:
        rows = "disturbance" if "identifier" in split([columns or ""]) else "identifier"
    if columns is None:
        row_factors = split([rows])
        columns = next((n for n in ("disturbance", "identifier") if n not in row_factors), "none")
    return rows, columns


def shown_path(path: Path) -> Path:
    """Return the path relative to the working directory if it is below it, else unchanged."""
    here = Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else path


def show_grid(grid: Grid, form: Format) -> None:
    """Print one grid."""
    show_grids([grid], form)


def show_grids(grids: Sequence[Grid], form: Format) -> None:
    """Print grids one after the other; on a terminal they are fitted to its width."""
    terminal = sys.stdout.isatty()
    width = None
    if terminal:
        width = shutil.get_terminal_size().columns
    texts = [render(grid, form, width, colour=terminal) for grid in grids]
    if form is Format.JSON and len(texts) > 1:
        typer.echo("[" + ",\n".join(texts) + "]")
    else:
        output = styled(sys.stdout) if form is Format.RICH else sys.stdout
        print("\n\n".join(texts), file=output)
