"""The options of `table` and `plot`, each as one dataclass.

This module is imported by --help and therefore imports nothing slow.
"""

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, TypeVar, get_type_hints

import typer

from seatrial.runner.compare.cli import (
    DEFAULT_DATABASE,
    Database,
    Form,
    ResultsDir,
    Several,
    Where,
)
from seatrial.runner.compare.figures import figures
from seatrial.runner.compare.formats import Format

T = TypeVar("T")


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
        typer.Option("--metric", "-m", help="Metric (see: metrics); repeated or comma-separated."),
    ] = None
    coefficient: Annotated[
        Several,
        typer.Option("--coefficient", help="Term whose coefficient is shown, such as u_dot."),
    ] = None
    coefficients: Annotated[
        bool, typer.Option("--coefficients", help="All coefficients, by DOF and term.")
    ] = False
    dof: Annotated[Several, typer.Option(help="surge, sway, yaw, position, ... or all.")] = None
    stage: Annotated[Several, typer.Option(help="validation, deployment, identification.")] = None
    model: Annotated[
        Several, typer.Option(help="nominal, identified, plant, or all.  [default: identified]")
    ] = None
    statistic: Annotated[
        Several,
        typer.Option("--statistic", "-s", help="mean, std, n, median, min, max, q05 ... q95, ci."),
    ] = None
    interval: Annotated[
        Literal["t", "bootstrap"], typer.Option(help="Kind of the 95 % interval `ci`.")
    ] = "t"
    baseline: Annotated[
        str | None,
        typer.Option(help="Reference, such as identifier=none; adds ratio, paired test and wins."),
    ] = None
    where: Where = None
    digits: Annotated[int, typer.Option(min=1, max=15, help="Significant digits.")] = 4
    database: Database = DEFAULT_DATABASE
    form: Form = Format.RICH


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
        int | None, typer.Option("--run", help="Run of a figure over time.  [default: newest]")
    ] = None
    metric: Annotated[str, typer.Option("--metric", "-m", help="Metric of the bars.")] = "force_mse"
    rows: Annotated[
        str | None,
        typer.Option("--rows", "-r", help="Factor of the colours.  [default: identifier]"),
    ] = None
    columns: Annotated[
        str | None,
        typer.Option("--columns", "-c", help="Factor of the groups.  [default: disturbance]"),
    ] = None
    dof: Annotated[Several, typer.Option(help="Only these degrees of freedom.")] = None
    model: Annotated[str, typer.Option(help="nominal, identified or plant.")] = "identified"
    facet: Annotated[
        str | None, typer.Option("--facet", help="One figure for each level of this factor.")
    ] = None
    log: Annotated[
        bool | None,
        typer.Option(
            "--log/--linear", help="Scale of the bars.  [default: by the range of the values]"
        ),
    ] = None
    where: Where = None
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="Folder of the files.  [default: figures in the results folder]"
        ),
    ] = None
    database: Database = DEFAULT_DATABASE
    results_dir: ResultsDir = None
