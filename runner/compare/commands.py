"""Commands that read the logbook: runs, show, table, plot, metrics, stats, sql."""

from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from seatrial.runner import compare
from seatrial.runner.compare.cli import (
    DEFAULT_DATABASE,
    MOST,
    Database,
    EverySweep,
    Form,
    PlotOptions,
    TableOptions,
    Tag,
    Where,
    app,
    axes_of,
    show_grid,
    show_grids,
    shown_path,
    split,
    taking,
)
from seatrial.runner.compare.figures import figure_of, figures
from seatrial.runner.compare.formats import Format
from seatrial.runner.compare.grid import grid_of
from seatrial.runner.record.catalogue import all_declared


@app.command()
def runs(
    database: Database = DEFAULT_DATABASE,
    where: Where = None,
    sweep: EverySweep = None,
    tag: Tag = None,
    status: Annotated[str | None, typer.Option(help="Only runs of this status.")] = None,
    limit: Annotated[int, typer.Option(min=1, max=MOST, help="Number of runs, newest first.")] = 50,
    form: Form = Format.RICH,
) -> None:
    """List runs, newest first, including failed ones."""
    with compare.results.open_results(database) as results:
        show_grid(compare.runs.run_list(results, where, status, limit, sweep, tag), form)


@app.command()
def show(
    run: Annotated[int, typer.Argument(help="Number of the run.")],
    database: Database = DEFAULT_DATABASE,
    traceback: Annotated[
        bool, typer.Option("--traceback", help="Print only its traceback.")
    ] = False,
    command: Annotated[
        bool, typer.Option("--command", help="Print only the command that repeats it.")
    ] = False,
    form: Form = Format.RICH,
) -> None:
    """Show everything stored about one run."""
    with compare.results.open_results(database) as results:
        if command:
            typer.echo(compare.runs.command_of(results, run))
        elif traceback:
            typer.echo(compare.runs.traceback_of(results, run))
        else:
            show_grids(compare.runs.run_details(results, run), form)


@app.command()
@taking(TableOptions)
def table(options: TableOptions) -> None:
    """Compare a metric or coefficients over seeds.

    Rows and columns are factors: a choice (vessel, disturbance, excitation, identifier, controller,
    evaluation, seed, ...), a dotted name of the configuration (plant.scale), or metric, term, dof,
    stage or model.
    """
    request = compare.selection.request_of(options)
    with compare.results.open_results(options.database) as results:
        show_grid(compare.comparison_table.comparison(results, request), options.form)


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
    """Draw figures as PNG and SVG and print their paths.

    A figure of one run shows the newest run that meets --where; with --facet there is one figure
    for each level (--facet seed).
    """
    rows, columns = axes_of(options.rows or figure_of(options.kind).rows or None, options.columns)
    request = compare.plots.request.PlotRequest(
        run=options.run,
        metric=options.metric,
        rows=rows,
        columns=columns,
        dofs=split(options.dof),
        model=options.model,
        facet=options.facet,
        log=options.log,
        where=options.where,
        sweep=options.sweep,
        tag=options.tag,
        pool=split(options.pool),
    )
    with compare.results.open_results(options.database, options.results_dir) as results:
        folder = options.output or shown_path(results.reader.results_dir / "figures")
        for path in compare.plots.draw(options.kind, results, request, folder):
            typer.echo(path)


@app.command()
def metrics(form: Form = Format.RICH) -> None:
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
    form: Form = Format.RICH,
) -> None:
    """Show the stored statistics of the columns of a measured recording."""
    with compare.results.open_results(database) as results:
        show_grid(compare.runs.recording_statistics(results, run, digits), form)


@app.command()
def sql(
    query: Annotated[str, typer.Argument(metavar="SELECT", help="A query that only reads.")],
    database: Database = DEFAULT_DATABASE,
    timeout: Annotated[
        float, typer.Option(min=0.001, max=86400.0, help="Longest time of the query [s].")
    ] = 30.0,
    limit: Annotated[int, typer.Option(min=1, max=MOST, help="Number of rows.")] = 10_000,
    form: Form = Format.RICH,
) -> None:
    """Run a query in SQL; a query that writes is rejected.

    For PostgreSQL use a role that can only read: GRANT pg_read_all_data TO reader.
    """
    with compare.results.open_results(database) as results:
        grid, more = compare.runs.answer(results, query, timeout, limit)
    show_grid(grid, form)
    if more:
        typer.echo(f"only the first {limit} rows; --limit shows more", err=True)
