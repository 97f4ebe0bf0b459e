"""Commands that read the logbook: runs, show, table, plot, metrics, stats, manoeuvres, ..."""

from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from typer.core import TyperCommand

from seatrial.runner import compare, export
from seatrial.runner.compare.cli import (
    MAX_ROWS,
    Database,
    EverySweep,
    Form,
    PlotOptions,
    ResultsDir,
    RunNumber,
    TableOptions,
    Tag,
    Where,
    app,
    show_grid,
    show_grids,
    shown_path,
    taking,
)
from seatrial.runner.compare.figures import figures
from seatrial.runner.compare.formats import OutputFormat
from seatrial.runner.compare.grid import grid_of
from seatrial.runner.configuration.invocation import DEFAULT_DATABASE
from seatrial.runner.record.catalogue import all_declared


@app.command()
def runs(
    database: Database = DEFAULT_DATABASE,
    where: Where = None,
    sweep: EverySweep = None,
    tag: Tag = None,
    status: Annotated[str | None, typer.Option(help="Only runs of this status.")] = None,
    limit: Annotated[
        int, typer.Option(min=1, max=MAX_ROWS, help="Number of runs, newest first.")
    ] = 50,
    form: Form = OutputFormat.RICH,
) -> None:
    """List runs, newest first, including failed ones."""
    with compare.frame.open_results(database) as results:
        show_grid(compare.runs.run_list(results, where, status, limit, sweep, tag), form)


@app.command()
def show(
    run: RunNumber,
    database: Database = DEFAULT_DATABASE,
    traceback: Annotated[
        bool, typer.Option("--traceback", help="Print only its traceback.")
    ] = False,
    command: Annotated[
        bool, typer.Option("--command", help="Print only the command that repeats it.")
    ] = False,
    form: Form = OutputFormat.RICH,
) -> None:
    """Show everything stored about one run."""
    with compare.frame.open_results(database) as results:
        if command:
            typer.echo(compare.runs.command_of(results, run))
        elif traceback:
            typer.echo(compare.runs.traceback_of(results, run))
        else:
            show_grids(compare.runs.run_details(results, run), form)


@app.command(name="leaderboard")
def benchmark_ranks(
    task: Annotated[list[str] | None, typer.Option(help="A task; by default all.")] = None,
    entrant: Annotated[
        list[str] | None, typer.Option(help="An entrant, beside those of the task.")
    ] = None,
    summary: Annotated[
        bool, typer.Option("--summary", help="Only one line for each task.")
    ] = False,
    page: Annotated[
        Path | None, typer.Option(help="Also write tables and free runs to this HTML file.")
    ] = None,
    database: Database = "sqlite:///results/benchmark/results.db",
    results_dir: ResultsDir = None,
    form: Form = OutputFormat.RICH,
) -> None:
    """Rank the entrants of the benchmark, task by task; `seatrial benchmark` runs them."""
    board = compare.leaderboard
    with compare.frame.open_results(database, results_dir) as results:
        boards = board.boards(results, task or (), entrant or ())
        if page is not None:
            compare.benchmark_page.write_benchmark(results, boards, page)
    show_grids([board.summary(boards)] if summary else board.grids(boards), form)
    if page is not None:
        typer.echo(page, err=True)


@app.command()
@taking(TableOptions)
def table(options: TableOptions) -> None:
    """Compare a metric or coefficients over seeds.

    Rows and columns are factors: a choice (vessel, disturbance, excitation, identifier, controller,
    evaluation, seed, ...), a dotted name of the configuration (plant.scale), or metric, term, dof,
    stage or model.
    """
    request = compare.table.request_of(options)
    with compare.frame.open_results(options.database) as results:
        show_grid(compare.table.comparison(results, request), options.form)
        _say(results.left_out(options.where, options.sweep, options.tag))


def _say(hint: str) -> None:
    """Print a hint, if there is one, apart from the output."""
    if hint:
        typer.echo(hint, err=True)


class PlotCommand(TyperCommand):
    """The command `plot`; its help lists the figures of the folder `plots`."""

    def format_help(self, *arguments: Any) -> None:
        """Write the help text."""
        listed = (
            f"{figure.name}: {figure.help} Needs: {figure.needs}." for figure in figures().values()
        )
        self.help = "\n\n".join([self.help or "", *listed])
        super().format_help(*arguments)


@app.command(cls=PlotCommand)
@taking(PlotOptions)
def plot(options: PlotOptions) -> None:
    """Draw figures as PNG and SVG, or with --width as PDF, and print their paths.

    A figure of one run shows the newest run that meets --where; with --facet there is one figure
    for each level (--facet seed).
    """
    request = compare.plots.request_of(options)
    width = None if options.width is None else compare.plots.paper.width_of(options.width)
    with compare.frame.open_results(options.database, options.results_dir) as results:
        folder = options.output or shown_path(results.reader.results_dir / "figures")
        for path in compare.plots.draw(options.kind, results, request, folder, width):
            typer.echo(path)
        if options.run is None:
            _say(results.left_out(options.where, options.sweep, options.tag))


@app.command()
def metrics(form: Form = OutputFormat.RICH) -> None:
    """List the metrics that trials store: unit, better direction, stage and formula."""
    headers = ("metric", "unit", "better", "stage", "what it is")
    rows = [
        (metric.name, metric.units, metric.better_text, ", ".join(metric.stages), metric.formula)
        for metric in all_declared()
    ]
    show_grid(grid_of("", headers, rows, labels=len(headers)), form)


@app.command()
def stats(
    run: Annotated[int, typer.Argument(help="Number of a run of a measured recording.")],
    database: Database = DEFAULT_DATABASE,
    digits: Annotated[int, typer.Option(min=1, max=17, help="Significant digits.")] = 4,
    form: Form = OutputFormat.RICH,
) -> None:
    """Show the stored statistics of the columns of a measured recording."""
    with compare.frame.open_results(database) as results:
        show_grid(compare.runs.recording_statistics(results, run, digits), form)


@app.command()
def manoeuvres(
    subject: Annotated[str, typer.Argument(metavar="RUN|FILE", help="A run, or a recording.")],
    execution: Annotated[
        Literal["half", "order", "full"],
        typer.Option(help="Instant of execution: helm past half, or leaving."),
    ] = "half",
    manoeuvre: Annotated[
        Literal["turn", "zigzag", "spiral", "reverse_spiral", "williamson", "stop"] | None,
        typer.Option(help="Which manoeuvre it is.  [default: by helm and heading]"),
    ] = None,
    helm: Annotated[
        str | None, typer.Option(help="Input that is put over.  [default: the run's, or delta]")
    ] = None,
    length: Annotated[
        float | None, typer.Option(min=1e-3, help="Length of the ship [m], if it is not stored.")
    ] = None,
    scale: Annotated[
        float, typer.Option(min=1.0, help="Length of the ship over that of the model.")
    ] = 1.0,
    map_file: Annotated[
        Path | None,
        typer.Option("--map", metavar="MAP.yaml", help="Which column of a file is what."),
    ] = None,
    series: Annotated[str, typer.Option(help="Series of the run.")] = "recording",
    database: Database = DEFAULT_DATABASE,
    results_dir: ResultsDir = None,
    form: Form = OutputFormat.RICH,
) -> None:
    """Print the sheet of a manoeuvre beside the limits of IMO resolution MSC.137(76).

    The measures are those of a turning circle, zig-zag, spiral, Williamson turn or stop.
    """
    request = compare.manoeuvre_comparison.SheetRequest(
        subject, execution, manoeuvre, helm, length, scale, map_file, series
    )
    show_grid(compare.manoeuvre_comparison.sheet_grid(request, database, results_dir), form)


@app.command()
def sql(
    query: Annotated[str, typer.Argument(metavar="SELECT", help="A query that only reads.")],
    database: Database = DEFAULT_DATABASE,
    timeout: Annotated[
        float, typer.Option(min=0.001, max=86400.0, help="Longest time of the query [s].")
    ] = 30.0,
    limit: Annotated[int, typer.Option(min=1, max=MAX_ROWS, help="Number of rows.")] = 10_000,
    form: Form = OutputFormat.RICH,
) -> None:
    """Run a query in SQL; a query that writes is rejected.

    For PostgreSQL use a role that can only read: GRANT pg_read_all_data TO reader.
    """
    with compare.frame.open_results(database) as results:
        grid, more = compare.runs.answer(results, query, timeout, limit)
    show_grid(grid, form)
    if more:
        typer.echo(f"only the first {limit} rows; --limit shows more", err=True)


@app.command()
def model(
    run: RunNumber,
    to: Annotated[
        str,
        typer.Option("--to", help="Format: yaml, json, statespace, python-control, mss, c or fmu."),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="Path of the file.  [default: named by the vessel and the run]"
        ),
    ] = None,
    model: Annotated[
        Literal["identified", "nominal", "plant", "adaptive"], typer.Option(help="Which model.")
    ] = "identified",
    at: Annotated[
        str | None,
        typer.Option(
            "--at",
            metavar="POINT",
            help="Operating point of a linear model: u=0.5,psi=1.57,wind_north=5 (m/s, rad, rad/s)."
            "  [default: at rest; for statespace the identified linear model, if there is one]",
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace files that exist.")] = False,
    database: Database = DEFAULT_DATABASE,
    results_dir: ResultsDir = None,
) -> None:
    """Write a model of a run for another program, and print the paths of the files.

    yaml, json: a vessel for vessel=PATH (and vessel=run:RUN sails it without a file). statespace:
    matrices as .mat or .json. python-control: a Python script. mss: a MATLAB function in the manner
    of Fossen's MSS. c: a C99 file and its header. fmu: FMI 2.0 for co-simulation, with the C
    compiler of this machine.
    """
    linear = export.model_formats.format_of(to).linear and at is None
    with compare.frame.open_results(database, results_dir) as results:
        stored = export.stored_model.read_model(results.reader, run, model, linear)
    for path in export.model_formats.write(stored, to, output, at, force):
        typer.echo(path)
