"""Commands that ask: runs, show, table, plot, sql."""

from typing import Annotated

import typer

from seatrial.runner.compare.cli import (
    DEFAULT_DATABASE,
    Database,
    Form,
    Where,
    app,
    axes_of,
    show_grid,
    show_grids,
    shown_path,
    split,
)
from seatrial.runner.compare.command_options import PlotOptions, TableOptions, taking
from seatrial.runner.compare.formats import Format


@app.command()
def runs(
    database: Database = DEFAULT_DATABASE,
    where: Where = None,
    status: Annotated[str | None, typer.Option(help="Only runs of this status.")] = None,
    limit: Annotated[int, typer.Option(min=1, help="How many, newest first.")] = 50,
    form: Form = Format.RICH,
) -> None:
    """List runs, newest first, failed ones too."""
    from seatrial.runner.compare.results import open_results
    from seatrial.runner.compare.runs import run_list

    with open_results(database) as results:
        show_grid(run_list(results, where, status, limit), form)


@app.command()
def show(
    run: Annotated[int, typer.Argument(help="Number of the run.")],
    database: Database = DEFAULT_DATABASE,
    traceback: Annotated[bool, typer.Option("--traceback", help="Only its traceback.")] = False,
    command: Annotated[
        bool, typer.Option("--command", help="Only the command that repeats it, on one line.")
    ] = False,
    form: Form = Format.RICH,
) -> None:
    """Show all that is known of one run."""
    from seatrial.runner.compare.results import open_results
    from seatrial.runner.compare.runs import command_of, run_details, traceback_of

    with open_results(database) as results:
        if command:
            typer.echo(command_of(results, run))
        elif traceback:
            typer.echo(traceback_of(results, run))
        else:
            show_grids(run_details(results, run), form)


@app.command()
@taking(TableOptions)
def table(options: TableOptions) -> None:
    """Compare a metric or coefficients over seeds.

    Rows and columns go by any choice (vessel, disturbance, excitation, identifier, controller,
    evaluation, seed, ...), by a dotted name of the configuration (plant.scale), or by metric,
    term, dof, stage and model.
    """
    from seatrial.runner.compare.results import open_results
    from seatrial.runner.compare.selection import request_of
    from seatrial.runner.compare.table import comparison

    request = request_of(options)
    with open_results(options.database) as results:
        show_grid(comparison(results, request), options.form)


@app.command()
@taking(PlotOptions)
def plot(options: PlotOptions) -> None:
    """Draw figures as PNG and SVG and print their paths.

    bars: a metric by rows and columns; orders: error over model order; residual, track, errors:
    one run over time; coefficients: identified against true; pareto, surface, spectrum: what an
    identifier found; wind: its speed, direction and force in one run; excitation: forces, their
    spectrum and the limits of one run; response: set-points, pose, force and wind of one run;
    controllers: those of several runs over one another; quality: velocity against position of a
    measured recording; plan: the planned path of an informative mix; topology, times: an
    objective over two parameters, and the time of predictions. What is of one run takes the newest
    that meets --where, with --facet one for each level (--facet seed).
    """
    from seatrial.runner.compare.plots import draw
    from seatrial.runner.compare.plots.request import PlotRequest
    from seatrial.runner.compare.results import open_results

    rows = options.rows or ("controller" if options.kind == "controllers" else None)
    rows, columns = axes_of(rows, options.columns)
    request = PlotRequest(
        run=options.run,
        metric=options.metric,
        rows=rows,
        columns=columns,
        dofs=split(options.dof),
        model=options.model,
        facet=options.facet,
        log=options.log,
        where=options.where,
    )
    with open_results(options.database, options.results_dir) as results:
        folder = options.output or shown_path(results.reader.results_dir / "figures")
        for path in draw(options.kind, results, request, folder):
            typer.echo(path)


@app.command()
def stats(
    run: Annotated[int, typer.Argument(help="Number of a run of a measured recording.")],
    database: Database = DEFAULT_DATABASE,
    digits: Annotated[int, typer.Option(min=1, max=17, help="Significant digits.")] = 4,
    form: Form = Format.RICH,
) -> None:
    """Describe the columns of a measured recording as its run stored them."""
    from seatrial.runner.compare.results import open_results
    from seatrial.runner.compare.runs import recording_statistics

    with open_results(database) as results:
        show_grid(recording_statistics(results, run, digits), form)


@app.command()
def sql(
    query: Annotated[str, typer.Argument(metavar="SELECT", help="One query that reads.")],
    database: Database = DEFAULT_DATABASE,
    form: Form = Format.RICH,
) -> None:
    """Answer a query in SQL; whatever would write is refused."""
    from seatrial.runner.compare.results import open_results
    from seatrial.runner.compare.runs import answer

    with open_results(database) as results:
        show_grid(answer(results, query), form)
