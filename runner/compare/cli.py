"""What the commands share: their options, and how a function becomes a command.

This module and the commands are imported by --help and therefore import nothing slow: that is
loaded at its first use.
"""

import csv
import inspect
import json
import re
import shutil
import sys
from collections.abc import Callable, Iterable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, is_dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer
from typer.main import get_command

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.figures import Several, axes_of, figures, split
from seatrial.runner.compare.grid import OutputFormat, TextTable, render
from seatrial.runner.configuration.invocation import DEFAULT_DATABASE, in_words, program_version
from seatrial.runner.record.catalogue import all_declared

if TYPE_CHECKING:
    import pydantic

    from seatrial.runner.configuration import options

    frame: Any
else:  # by name: frame imports options from here
    import lazy_loader

    pydantic, frame, options = (
        lazy_loader.load(name, suppress_warning=True)
        for name in (
            "pydantic", "seatrial.runner.compare.frame", "seatrial.runner.configuration.options"
        )
    )  # fmt: skip

MOST_CELLS = 250_000  # of a table, at about 3 kB
MAX_ROWS = 1_000_000_000  # rows that --limit may ask for
LATEST = 0  # the number of the newest run, before it is known
INVALID = re.compile(r"Invalid value for '([^']*)'[^:]*: ")  # of the parser's messages
Names = tuple[str, ...]
F = TypeVar("F", bound=Callable[..., Any])
app = typer.Typer(name="seatrial-results", no_args_is_help=True, pretty_exceptions_enable=False)


def is_run(text: str) -> bool:
    """Return whether a text names a run: by its number, or as the latest."""
    return text == "latest" or bool(text.isascii() and text.isdigit() and int(text))


def _run_number(text: str) -> int:
    if not is_run(text):
        raise typer.BadParameter(f"got {text!r}, expected the number of a run, or latest")
    return LATEST if text == "latest" else int(text)


def _completing(names: Callable[[], Iterable[str]]) -> Callable[[str], list[str]]:
    """Return the completion of an option with comma-separated values."""

    def completed(incomplete: str) -> list[str]:
        given, comma, last = incomplete.rpartition(",")
        return [f"{given}{comma}{name}" for name in names() if name.startswith(last)]

    return completed


# The options of the commands by name, or by command and name where these differ.
with Path(__file__).with_name("options.csv").open(encoding="utf-8", newline="") as _file:
    OPTIONS = {row["option"]: row for row in csv.DictReader(_file)}
PARSED: dict[str, dict[str, Any]] = {
    "run": {"parser": _run_number}, "kind": {"autocompletion": _completing(figures)},
    "metric": {"autocompletion": _completing(lambda: [metric.name for metric in all_declared()])},
}  # fmt: skip


def _described(command: str, parameter: inspect.Parameter) -> inspect.Parameter:
    """Return a parameter of a function as an option of its command.

    It is an argument if it has no default and may be given by its place.
    """
    name, keyword = parameter.name, inspect.Parameter.KEYWORD_ONLY
    row = OPTIONS.get(f"{command} {name}") or OPTIONS[name]
    told: dict[str, Any] = {key: value or None for key, value in row.items()}
    flags = (told.pop("flags") or f"--{name.replace('_', '-')}").split()
    told |= {bound: json.loads(row[bound] or "null") for bound in ("min", "max")}
    told |= PARSED.get(told.pop("option").split()[-1], {})
    info: Any = typer.Option(*flags, **told)
    if parameter.default is parameter.empty and parameter.kind is not keyword:
        info = typer.Argument(**told)
    annotated: Any = Annotated
    return parameter.replace(kind=keyword, annotation=annotated[parameter.annotation, info])


@app.callback(invoke_without_command=True)
def _program(
    version: Annotated[bool, typer.Option("--version", help="Show the version.")] = False,
) -> None:
    """Compare the runs that are stored in a results database."""
    if version:
        typer.echo(f"{app.info.name} {program_version()}")
        raise typer.Exit


@dataclass(frozen=True)
class TableOptions:
    """Options of `table`, and what follows from them.

    Levels that are empty mean all of them, and so do the names of coefficients.
    """

    rows: str | None = None
    columns: str | None = None
    metric: Several = None
    coefficient: Several = None
    coefficients: bool = False
    dof: Several = None
    stage: Several = None
    model: Several = None
    statistic: Several = None
    baseline: Several = None
    where: str | None = None
    sweep: str | None = None
    pool: Several = None
    digits: int = 4
    cells: int = MOST_CELLS

    def __post_init__(self) -> None:
        if self.of_coefficients and self.metric:
            raise ConfigurationError("--metric and --coefficient: got both, expected one of them")
        for twice in {*self.axes[0]} & {*self.axes[1]}:
            wrong = f"--rows and --columns: both name {twice}, expected one of them"
            raise ConfigurationError(wrong)
        for text in self.baseline or ():
            if not all(text.partition("=")):
                expected = "a factor and its level such as identifier=none"
                raise ConfigurationError(f"--baseline: got {text!r}, expected {expected}")

    @property
    def of_coefficients(self) -> bool:
        """Whether the numbers are coefficients."""
        return bool(self.coefficient) or self.coefficients

    @property
    def names(self) -> Names:
        """The metrics, or the terms of coefficients."""
        named = self.coefficient if self.of_coefficients else self.metric or ["force_mse"]
        return tuple(named or ())

    @cached_property
    def axes(self) -> tuple[Names, Names]:
        """The factors of rows and columns; the name of a coefficient, `term`, is its metric."""
        texts = axes_of(self.rows, self.columns)
        rows, columns = (
            tuple("metric" if name == "term" else name for name in split([text] * (text != "none")))
            for text in texts
        )
        if self.coefficients and not self.coefficient:
            named = dict.fromkeys(("dof", "metric", *rows))
            rows = tuple(name for name in named if name not in columns)
        return rows, columns

    @property
    def levels(self) -> dict[str, Names]:
        """The levels of degree of freedom, stage and model that are shown."""
        given = {"dof": self.dof, "stage": self.stage, "model": self.model}
        if not self.model and "model" not in (*self.axes[0], *self.axes[1]):
            given["model"] = ["identified"]
        return {n: tuple(own) if own and "all" not in own else () for n, own in given.items()}

    @property
    def reference(self) -> dict[str, str]:
        """The levels of the baseline by factor."""
        pairs = (text.partition("=") for text in (self.baseline or ()))
        return {factor.strip(): level.strip() for factor, _, level in pairs}


def command(database: str = DEFAULT_DATABASE, **more: Any) -> Callable[[F], F]:
    """Make a command of a function of an open logbook; the function itself is for Python.

    What it takes after the logbook, `results`, are the options of the command: its parameters, or
    the fields of one dataclass. The options that open the logbook are added, and the format of what
    it prints if it returns tables. It may also return paths or text, which are printed. A function
    that does not take `results` has its own options only.
    """

    def register(function: F) -> F:
        name, signature = function.__name__, inspect.signature(function)
        opens, own = "results" in signature.parameters, dict(signature.parameters)
        own.pop("results", None)
        kinds = [each.annotation for each in own.values() if is_dataclass(each.annotation)]
        record: Any = kinds[0] if kinds else None
        own = own if record is None else dict(inspect.signature(record).parameters)
        added: dict[str, tuple[Any, Any]] = {}
        if opens:
            added = {"database": (str, database), "results_dir": (Path | None, None)}
        if "TextTable" in str(signature.return_annotation):
            added["form"] = OutputFormat, OutputFormat.RICH
        keyword, every = inspect.Parameter.KEYWORD_ONLY, dict(own)
        for each, (kind, default) in added.items():
            parameter = inspect.Parameter(each, keyword, default=default, annotation=kind)
            every.setdefault(each, parameter)
        parameters = [_described(name, each) for each in every.values()]

        def run(**values: Any) -> None:
            given = {each: values[each] for each in own}
            lists = {n: v for n, v in given.items() if isinstance(v, list | tuple)}
            given |= {n: list(split(v)) or None for n, v in lists.items()}
            place = values.get("database", database), values.get("results_dir")
            results: Any  # None of a function that does not take them
            with frame.open_results(*place) if opens else nullcontext() as results:
                if opens and given.get("run") == LATEST:
                    given["run"] = newest(results)
                called = given if record is None else {"options": record(**given)}
                result = function(**called, **({"results": results} if opens else {}))
                if record is not None and given.get("run") is None:
                    for hint in results.left_out(given["where"], given["sweep"]):
                        typer.echo(hint, err=True)
            show(result, values.get("form", OutputFormat.RICH))

        run.__name__, run.__doc__ = name, function.__doc__
        run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        run.__annotations__ = {each.name: each.annotation for each in parameters}
        app.command(**more)(run)
        return function

    return register


def run_typer(program: typer.Typer, words: Sequence[str]) -> int:
    """Run the words of a command line and return the exit code; 130 on Ctrl-C.

    Raises ConfigurationError for words that are wrong.
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
        text = INVALID.sub(r"\1: ", in_words(error.format_message()))
        if not text:  # the help was printed
            return 2
        if isinstance(error.__cause__, pydantic.ValidationError):
            problem = error.__cause__.errors()[0]  # in the words for options of a configuration
            bound = problem["msg"].replace("Input should be", "a number")
            expected = options.EXPECTED.get(problem["type"].replace("_parsing", "_type"), bound)
            if choices := problem["msg"].partition(" is not one of ")[2]:
                expected = f"one of {choices.strip('.')}".replace("'", "")
            text = f"{text.partition(':')[0]}: got {problem['input']!r}, expected {expected}"
        raise ConfigurationError(place + text) from error
    return code if isinstance(code, int) else 0


def newest(results: Any) -> int:
    """Return the number of the newest run; raises ConfigurationError if there is none."""
    runs = results.reader.runs(newest_first=True, limit=1)
    if not runs:
        raise ConfigurationError(results.why_none())
    return int(runs[0].run_id)


def show(result: Any, form: OutputFormat = OutputFormat.RICH) -> None:
    """Print what a command returns: a table, several, paths, or text; nothing for None.

    On a terminal, tables are fitted to its width.
    """
    results = result if isinstance(result, list) else [] if result is None else [result]
    if not any(isinstance(each, TextTable) for each in results):
        for each in results:
            typer.echo(each)
        return
    terminal = sys.stdout.isatty()
    width = shutil.get_terminal_size().columns if terminal else None
    texts = [render(grid, form, width, colour=terminal) for grid in results]
    if form is OutputFormat.JSON and len(texts) > 1:
        texts = ["[" + ",\n".join(texts) + "]"]
    print("\n\n".join(texts))


def shown_path(path: Path) -> Path:
    """Return the path relative to the working directory if it is below it, else unchanged."""
    here = Path.cwd()
    return path.relative_to(here) if path.is_relative_to(here) else path
