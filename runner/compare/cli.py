"""What the commands share: the program, its common options, and how tables are printed.

The commands are in `commands` and `logbook_commands`. Neither imports anything slow: every command
imports what it needs, so that --help is at once.
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from seatrial.runner.compare.formats import Format

if TYPE_CHECKING:
    from seatrial.runner.compare.grid import Grid


DEFAULT_DATABASE = "sqlite:///results/results.db"
app = typer.Typer(
    name="seatrial-results",
    help="Compare the runs that are stored in a results database.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
Database = Annotated[
    str, typer.Option("--database", metavar="URL", help="URL or plain file of the logbook.")
]
Form = Annotated[Format, typer.Option("--format", "-f", help="How the table is written.")]
Where = Annotated[
    str | None,
    typer.Option("--where", help='Only runs that meet this, as "seed<10 and identifier=ls".'),
]
ResultsDir = Annotated[
    Path | None,
    typer.Option("--results-dir", help="Folder of the series files, if not beside the database."),
]
Several = list[str] | None


def split(texts: Several) -> tuple[str, ...]:
    """Options that may be repeated or parted by commas, as one list."""
    parts = (part.strip() for text in texts or () for part in text.split(","))
    return tuple(part for part in parts if part)


def axes_of(rows: str | None, columns: str | None) -> tuple[str, str]:
    """Factors of rows and columns: those given, else identifier and disturbance.

    Where one of these defaults is taken by the other option, they change places.
    """
    if rows is None:
        rows = "disturbance" if "identifier" in split([columns or ""]) else "identifier"
    if columns is None:
        taken = split([rows])
        columns = next((n for n in ("disturbance", "identifier") if n not in taken), "none")
    return rows, columns


def shown_path(path: Path) -> Path:
    """The path from here where it leads down, else the whole path."""
    here = Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else path


def show_grid(grid: "Grid", form: Format) -> None:
    """Print one grid."""
    show_grids([grid], form)


def show_grids(grids: Sequence["Grid"], form: Format) -> None:
    """Print grids one after the other; on a terminal as wide as that, else as wide as they are."""
    from seatrial.runner.compare.formats import render

    terminal = sys.stdout.isatty()
    width = None
    if terminal:
        import shutil

        width = shutil.get_terminal_size().columns
    texts = [render(grid, form, width, colour=terminal) for grid in grids]
    if form is Format.JSON and len(texts) > 1:
        typer.echo("[" + ",\n".join(texts) + "]")
    else:
        typer.echo("\n\n".join(texts))
