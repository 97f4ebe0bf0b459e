"""What the commands share: their options, and how a function becomes a command.

This module and the commands are imported by --help and therefore import nothing slow: that is
loaded at its first use.
"""

import inspect
import shutil
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, is_dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer
from typer.main import get_command

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.figures import figures
from seatrial.runner.compare.formats import OutputFormat, render
from seatrial.runner.compare.grid import TextTable
from seatrial.runner.configuration.invocation import DEFAULT_DATABASE, program_version
from seatrial.runner.record.catalogue import all_declared

if TYPE_CHECKING:
    frame: Any
else:  # by name: it imports options from here
    import lazy_loader

    frame = lazy_loader.load("seatrial.runner.compare.frame", suppress_warning=True)

MOST_CELLS = 250_000  # of a table, at about 3 kB
MAX_ROWS = 1_000_000_000  # rows that --limit may ask for
LATEST = 0  # the number of the newest run, before it is known
Several = list[str] | None
Names = tuple[str, ...]
F = TypeVar("F", bound=Callable[..., Any])
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


def _completing(names: Callable[[], Iterable[str]]) -> Callable[[str], list[str]]:
    """Return the completion of an option with comma-separated values."""

    def completed(incomplete: str) -> list[str]:
        given, comma, last = incomplete.rpartition(",")
        return [f"{given}{comma}{name}" for name in names() if name.startswith(last)]

    return completed


def is_run(text: str) -> bool:
    """Return whether a text names a run: by its number, or as the latest."""
    return text == "latest" or bool(text.isascii() and text.isdigit() and int(text))


def _run_number(text: str) -> int:
    if not is_run(text):
        raise typer.BadParameter(f"got {text!r}, expected the number of a run, or latest")
    return LATEST if text == "latest" else int(text)


METRIC_NAMES = _completing(lambda: [metric.name for metric in all_declared()])
RunNumber = Annotated[
    int, typer.Argument(help="Number of the run, or latest.", parser=_run_number, metavar="RUN")
]
Database = Annotated[
    str,
    typer.Option(
        "--database",
        metavar="URL",
        help="URL or file of the logbook; SEATRIAL_DATABASE for the URL in this variable.",
    ),
]
ResultsDir = Annotated[
    Path | None,
    typer.Option("--results-dir", help="Folder of the series files, if not beside the database."),
]
Form = Annotated[OutputFormat, typer.Option("--format", "-f", help="Output format of the table.")]
Where = Annotated[
    str | None,
    typer.Option(
        "--where", help='Only runs that meet this condition: "seed<10 and identifier=ls".'
    ),
]
SWEEP = "Sweeps of this number, name or tag, or all."
Sweep = Annotated[str | None, typer.Option("--sweep", help=f"{SWEEP}  [default: the newest sweep]")]
EverySweep = Annotated[str | None, typer.Option("--sweep", help=f"{SWEEP}  [default: all]")]
Pool = Annotated[
    Several,
    typer.Option("--pool", help="Factors that a cell may average over, or all.", metavar="NAME"),
]
Rows = Annotated[
    str | None,
    typer.Option(
        "--rows", "-r", help="Factors of the rows, comma-separated.  [default: identifier]"
    ),
]
Columns = Annotated[
    str | None,
    typer.Option(
        "--columns", "-c", help="Factors of the columns, or none.  [default: disturbance]"
    ),
]
Dofs = Annotated[Several, typer.Option("--dof", help="surge, sway, yaw, position, ... or all.")]


@dataclass(frozen=True)
class TableOptions:
    """Options of `table`, and what follows from them.

    Levels that are empty mean all of them, and so do the names of coefficients.
    """

    rows: Rows = None
    columns: Columns = None
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
        Several, typer.Option(help="Term whose coefficient is shown, such as u_dot.")
    ] = None
    coefficients: Annotated[
        bool, typer.Option("--coefficients", help="All coefficients, by DOF and term.")
    ] = False
    dof: Dofs = None
    stage: Annotated[Several, typer.Option(help="validation, deployment, identification.")] = None
    model: Annotated[
        Several, typer.Option(help="nominal, identified, plant, or all.  [default: identified]")
    ] = None
    statistic: Annotated[
        Several,
        typer.Option("--statistic", "-s", help="mean, std, n, median, min, max, q05 ... q95, ci."),
    ] = None
    baseline: Annotated[
        Several,
        typer.Option(help="Reference, such as identifier=none; adds ratio, paired test and wins."),
    ] = None
    where: Where = None
    sweep: Sweep = None
    pool: Pool = None
    digits: Annotated[int, typer.Option(min=1, max=15, help="Significant digits.")] = 4
    cells: Annotated[int, typer.Option(min=1, help="Most cells, rows times columns.")] = MOST_CELLS

    def __post_init__(self) -> None:
        if self.of_coefficients and self.metric:
            raise ConfigurationError("--metric and --coefficient: got both, expected one of them")
        rows, columns = self.axes
        for twice in set(rows) & set(columns):
            raise ConfigurationError(
                f"--rows and --columns: both name {twice}, expected one of them"
            )
        for text in split(self.baseline):
            if not all(text.partition("=")):
                raise ConfigurationError(
                    f"--baseline: got {text!r}, expected a factor and its level such as"
                    " identifier=none"
                )

    @property
    def of_coefficients(self) -> bool:
        """Whether the numbers are coefficients."""
        return bool(self.coefficient) or self.coefficients

    @property
    def names(self) -> Names:
        """The metrics, or the terms of coefficients."""
        return split(self.coefficient if self.of_coefficients else self.metric or ["force_mse"])

    @cached_property
    def axes(self) -> tuple[Names, Names]:
        """The factors of rows and columns; the name of a coefficient, `term`, is its metric."""
        texts = axes_of(self.rows, self.columns)
        rows, columns = (
            tuple("metric" if name == "term" else name for name in split([text] * (text != "none")))
            for text in texts
        )
        if self.coefficients and not self.coefficient:
            own = ("dof", "metric")
            wanted = (*own, *(name for name in rows if name not in own))
            rows = tuple(name for name in wanted if name not in columns)
        return rows, columns

    @property
    def levels(self) -> dict[str, Names]:
        """The levels of degree of freedom, stage and model that are shown."""
        given = {"dof": split(self.dof), "stage": split(self.stage), "model": split(self.model)}
        if not given["model"] and "model" not in (*self.axes[0], *self.axes[1]):
            given["model"] = ("identified",)
        return {name: () if "all" in levels else levels for name, levels in given.items()}

    @property
    def reference(self) -> dict[str, str]:
        """The levels of the baseline by factor."""
        pairs = (text.partition("=") for text in split(self.baseline))
        return {factor.strip(): level.strip() for factor, _, level in pairs}


@dataclass(frozen=True)
class PlotOptions:
    """Options of `plot`."""

    kind: Annotated[
        str,
        typer.Argument(
            help="Kind of figure: a name below, or the name of a module with a figure.",
            autocompletion=_completing(figures),
        ),
    ]
    run: Annotated[
        int | None,
        typer.Option(
            help="Run of a figure over time.  [default: newest]", parser=_run_number, metavar="RUN"
        ),
    ] = None
    metric: Annotated[
        str, typer.Option("--metric", "-m", help="Metric of the bars.", autocompletion=METRIC_NAMES)
    ] = "force_mse"
    rows: Rows = None
    columns: Columns = None
    dof: Dofs = None
    model: Annotated[str, typer.Option(help="nominal, identified or plant.")] = "identified"
    facet: Annotated[str | None, typer.Option(help="One figure for each level of this factor.")] = (
        None
    )
    band: Annotated[
        float | None, typer.Option(metavar="PERCENT", help="Level of the bands about a prediction.")
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
            metavar="column|page|MM",
            help="A PDF for print of this width, 86 or 178 mm or a number, instead of PNG and SVG.",
        ),
    ] = None
    where: Where = None
    sweep: Sweep = None
    pool: Pool = None
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="Folder of the files.  [default: figures in the results folder]"
        ),
    ] = None


def command(
    name: str | None = None, database: str = DEFAULT_DATABASE, **more: Any
) -> Callable[[F], F]:
    """Make a command of a function of an open logbook; the function itself is for Python.

    What it takes after the logbook are the options of the command: its arguments, or the fields of
    one dataclass. The options that open the logbook are added, and the format of what it prints if
    it returns tables. It may also return paths or text, which are printed.
    """

    def register(function: F) -> F:
        signature = inspect.signature(function)
        _, *own = signature.parameters.values()
        record: Any = own[0].annotation if is_dataclass(own[0].annotation) else None
        options = {each.name: each for each in own}
        if record is not None:
            options = dict(inspect.signature(record).parameters)
        added = {"database": (Database, database), "results_dir": (ResultsDir, None)}
        if "TextTable" in str(signature.return_annotation):
            added["form"] = Form, OutputFormat.RICH
        keyword = inspect.Parameter.KEYWORD_ONLY
        parameters = [each.replace(kind=keyword) for each in options.values()]
        parameters += [
            inspect.Parameter(each, keyword, default=default, annotation=annotation)
            for each, (annotation, default) in added.items()
            if each not in options
        ]

        def run(**values: Any) -> None:
            with frame.open_results(values["database"], values["results_dir"]) as results:
                if values.get("run") == LATEST:
                    values["run"] = newest(results)
                given = {each: values[each] for each in options}
                if record is None:
                    result = function(results, **given)
                else:
                    result = function(results, record(**given))
                    hint = results.left_out(given["where"], given["sweep"])
                    if hint and given.get("run") is None:
                        typer.echo(hint, err=True)
            show(result, values.get("form", OutputFormat.RICH))

        run.__name__, run.__doc__ = function.__name__, function.__doc__
        run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        run.__annotations__ = {each.name: each.annotation for each in parameters}
        app.command(name, **more)(run)
        return function

    return register


def run_typer(program: typer.Typer, words: Sequence[str]) -> int:
    """Run the words of a command line and return the exit code; 130 on Ctrl-C.

    Raises ConfigurationError for words that are wrong; its message is empty after the help.
    """
    name = str(program.info.name)
    try:
        code = get_command(program).main(list(words), prog_name=name, standalone_mode=False)
    except Exception as error:
        # The module of the parser's exceptions differs between versions of Typer.
        if not hasattr(error, "format_message"):
            raise
        command = name.removeprefix("seatrial ")
        place = "" if command == name else f"{command}: "
        raise ConfigurationError(place + error.format_message()) from error
    return code if isinstance(code, int) else 0


def newest(results: Any) -> int:
    """Return the number of the newest run; raises ConfigurationError if there is none."""
    runs = results.reader.runs(newest_first=True, limit=1)
    if not runs:
        raise ConfigurationError(results.why_none())
    return int(runs[0].run_id)


def show(result: Any, form: OutputFormat = OutputFormat.RICH) -> None:
    """Print what a command returns: a table, several, paths, or text; nothing for None."""
    match result:
        case None:
            pass
        case TextTable():
            show_grids([result], form)
        case [TextTable(), *_]:
            show_grids(result, form)
        case list():
            for each in result:
                typer.echo(each)
        case _:
            typer.echo(result)


def show_grids(grids: Sequence[TextTable], form: OutputFormat) -> None:
    """Print grids one after the other; on a terminal they are fitted to its width."""
    terminal = sys.stdout.isatty()
    width = shutil.get_terminal_size().columns if terminal else None
    texts = [render(grid, form, width, colour=terminal) for grid in grids]
    if form is OutputFormat.JSON and len(texts) > 1:
        typer.echo("[" + ",\n".join(texts) + "]")
    else:
        print("\n\n".join(texts))


def split(texts: Sequence[str] | None) -> tuple[str, ...]:
    """Return the distinct values of a repeated or comma-separated option, without empty ones."""
    parts = (part.strip() for text in texts or () for part in text.split(","))
    return tuple(dict.fromkeys(part for part in parts if part))


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
