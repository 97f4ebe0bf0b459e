"""Shared parts of the commands: the application, the options and the printing of tables.

The commands are in `commands` and `logbook_commands`; the options of `table` and `plot` are
dataclasses. This module and the commands are imported by --help and therefore import nothing slow:
they take it from the package, as `compare.frame`, which loads it at its first use.
"""

import inspect
import shutil
import sys
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, get_args, get_type_hints

import typer

from seatrial.models.errors import SeatrialError
from seatrial.runner.compare.figures import figures
from seatrial.runner.compare.formats import OutputFormat, render
from seatrial.runner.compare.grid import TextTable
from seatrial.runner.configuration.invocation import DEFAULT_DATABASE, program_version
from seatrial.runner.record.catalogue import all_declared
from seatrial.runner.record.vocabulary import DOF_ORDER, Stage

if TYPE_CHECKING:
    frame: Any
    runs: Any
else:  # by name: they take their requests from here
    import lazy_loader

    frame = lazy_loader.load("seatrial.runner.compare.frame", suppress_warning=True)
    runs = lazy_loader.load("seatrial.runner.compare.runs", suppress_warning=True)

MOST_CELLS = 250_000  # of a table, at about 3 kB
app = typer.Typer(name="seatrial-results", no_args_is_help=True, pretty_exceptions_enable=False)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"{app.info.name} {program_version()}")
        raise typer.Exit


@app.callback()
def _program(
    version: Annotated[
        bool,
        typer.Option("--version", is_eager=True, callback=_show_version, help="Show the version."),
    ] = False,
) -> None:
    """Compare the runs that are stored in a results database."""


Database = Annotated[
    str,
    typer.Option(
        "--database",
        metavar="URL",
        help="URL or file of the logbook; SEATRIAL_DATABASE for the URL in this variable.",
    ),
]
Form = Annotated[OutputFormat, typer.Option("--format", "-f", help="Output format of the table.")]
Where = Annotated[
    str | None,
    typer.Option(
        "--where", help='Only runs that meet this condition: "seed<10 and identifier=ls".'
    ),
]
Sweep = Annotated[
    str | None,
    typer.Option("--sweep", help="Number or name of a sweep, or all.  [default: the newest sweep]"),
]
EverySweep = Annotated[
    str | None, typer.Option("--sweep", help="Number or name of a sweep, or all.  [default: all]")
]
Tag = Annotated[
    str | None, typer.Option("--tag", help="Only sweeps with this tag, all of them by default.")
]
Pool = Annotated[
    list[str] | None,
    typer.Option("--pool", help="Factors that a cell may average over, or all.", metavar="NAME"),
]
ResultsDir = Annotated[
    Path | None,
    typer.Option("--results-dir", help="Folder of the series files, if not beside the database."),
]
Several = list[str] | None
T = TypeVar("T")
MAX_ROWS = 1_000_000_000  # rows that --limit may ask for


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


def show_grid(grid: TextTable, form: OutputFormat) -> None:
    """Print one grid."""
    show_grids([grid], form)


def show_grids(grids: Sequence[TextTable], form: OutputFormat) -> None:
    """Print grids one after the other; on a terminal they are fitted to its width."""
    terminal = sys.stdout.isatty()
    width = None
    if terminal:
        width = shutil.get_terminal_size().columns
    texts = [render(grid, form, width, colour=terminal) for grid in grids]
    if form is OutputFormat.JSON and len(texts) > 1:
        typer.echo("[" + ",\n".join(texts) + "]")
    else:
        print("\n\n".join(texts))


def taking(options: type[T]) -> Callable[[Callable[[T], None]], Callable[..., None]]:
    """Turn a function of one dataclass into a command; the fields become its options."""

    def command_of(function: Callable[[T], None]) -> Callable[..., None]:
        def command(**values: object) -> None:
            function(options(**values))

        command.__name__, command.__doc__ = function.__name__, function.__doc__
        command.__annotations__ = get_type_hints(options, include_extras=True)
        command.__signature__ = inspect.signature(options)  # type: ignore[attr-defined]
        return command

    return command_of


def _completing(names: Callable[[], Iterable[str]]) -> Callable[[str], list[str]]:
    """Return the completion of an option with comma-separated values."""

    def completed(incomplete: str) -> list[str]:
        given, comma, last = incomplete.rpartition(",")
        return [f"{given}{comma}{name}" for name in names() if name.startswith(last)]

    return completed


def _run_numbers(incomplete: str) -> list[tuple[str, str]]:
    """Return the numbers of the newest runs in the default folder; none if it cannot be read."""
    with suppress(SeatrialError), frame.open_results(DEFAULT_DATABASE) as opened:
        numbers: list[tuple[str, str]] = runs.numbers(opened, incomplete)
        return numbers
    return []


RunNumber = Annotated[int, typer.Argument(help="Number of the run.", autocompletion=_run_numbers)]
METRIC_NAMES = _completing(lambda: [metric.name for metric in all_declared()])
DOF_NAMES = _completing(lambda: [*DOF_ORDER, "all"])
STAGE_NAMES = _completing(lambda: get_args(Stage))
MODEL_NAMES = _completing(lambda: ["nominal", "identified", "plant", "all"])
STATISTIC_NAMES = _completing(
    lambda: ["mean", "std", "n", "median", "min", "max", "q05", "q25", "q75", "q95", "ci"]
)


@dataclass(frozen=True)
class TableOptions:
    """Options of `table`."""

    rows: Annotated[
        str | None,
        typer.Option(
            "--rows", "-r", help="Factors of the rows, comma-separated.  [default: identifier]"
        ),
    ] = None
    columns: Annotated[
        str | None,
        typer.Option(
            "--columns", "-c", help="Factors of the columns, or none.  [default: disturbance]"
        ),
    ] = None
    metric: Annotated[
        Several,
        typer.Option(
            "--metric",
            "-m",
            help="Metric (see: metrics); repeated or comma-separated.",
            autocompletion=METRIC_NAMES,
        ),
    ] = None
    coefficient: Annotated[
        Several,
        typer.Option("--coefficient", help="Term whose coefficient is shown, such as u_dot."),
    ] = None
    coefficients: Annotated[
        bool, typer.Option("--coefficients", help="All coefficients, by DOF and term.")
    ] = False
    dof: Annotated[
        Several,
        typer.Option(help="surge, sway, yaw, position, ... or all.", autocompletion=DOF_NAMES),
    ] = None
    stage: Annotated[
        Several,
        typer.Option(help="validation, deployment, identification.", autocompletion=STAGE_NAMES),
    ] = None
    model: Annotated[
        Several,
        typer.Option(
            help="nominal, identified, plant, or all.  [default: identified]",
            autocompletion=MODEL_NAMES,
        ),
    ] = None
    statistic: Annotated[
        Several,
        typer.Option(
            "--statistic",
            "-s",
            help="mean, std, n, median, min, max, q05 ... q95, ci.",
            autocompletion=STATISTIC_NAMES,
        ),
    ] = None
    interval: Annotated[
        Literal["t", "bootstrap"], typer.Option(help="Kind of the 95 % interval `ci`.")
    ] = "t"
    baseline: Annotated[
        Several,
        typer.Option(help="Reference, such as identifier=none; adds ratio, paired test and wins."),
    ] = None
    where: Where = None
    sweep: Sweep = None
    tag: Tag = None
    pool: Pool = None
    digits: Annotated[int, typer.Option(min=1, max=15, help="Significant digits.")] = 4
    cells: Annotated[int, typer.Option(min=1, help="Most cells, rows times columns.")] = MOST_CELLS
    database: Database = DEFAULT_DATABASE
    form: Form = OutputFormat.RICH


def _completed(incomplete: str) -> list[str]:
    return [name for name in figures() if name.startswith(incomplete)]


@dataclass(frozen=True)
class PlotOptions:
    """Options of `plot`."""

    kind: Annotated[
        str,
        typer.Argument(
            help="Kind of figure: a name below, or the name of a module with a figure.",
            autocompletion=_completed,
        ),
    ]
    run: Annotated[
        int | None,
        typer.Option(
            "--run",
            help="Run of a figure over time.  [default: newest]",
            autocompletion=_run_numbers,
        ),
    ] = None
    metric: Annotated[
        str, typer.Option("--metric", "-m", help="Metric of the bars.", autocompletion=METRIC_NAMES)
    ] = "force_mse"
    rows: Annotated[
        str | None,
        typer.Option("--rows", "-r", help="Factor of the colours.  [default: identifier]"),
    ] = None
    columns: Annotated[
        str | None,
        typer.Option("--columns", "-c", help="Factor of the groups.  [default: disturbance]"),
    ] = None
    dof: Annotated[
        Several, typer.Option(help="Only these degrees of freedom.", autocompletion=DOF_NAMES)
    ] = None
    model: Annotated[str, typer.Option(help="nominal, identified or plant.")] = "identified"
    facet: Annotated[
        str | None, typer.Option("--facet", help="One figure for each level of this factor.")
    ] = None
    band: Annotated[
        float | None,
        typer.Option("--band", metavar="PERCENT", help="Level of the bands about a prediction."),
    ] = None
    log: Annotated[
        bool | None,
        typer.Option(
            "--log/--linear", help="Scale of the bars.  [default: by the range of the values]"
        ),
    ] = None
    width: Annotated[
        str | None,
        typer.Option(
            "--width",
            metavar="column|page|MM",
            help="A PDF for print of this width, 86 or 178 mm or a number, instead of PNG and SVG.",
            autocompletion=_completing(lambda: ["column", "page"]),
        ),
    ] = None
    where: Where = None
    sweep: Sweep = None
    tag: Tag = None
    pool: Pool = None
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="Folder of the files.  [default: figures in the results folder]"
        ),
    ] = None
    database: Database = DEFAULT_DATABASE
    results_dir: ResultsDir = None
