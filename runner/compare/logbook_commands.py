"""Commands on the whole logbook.

report, animate, site, audit, retry, export, prune and verify.
"""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from seatrial.runner import compare
from seatrial.runner.compare.cli import (
    MAX_ROWS,
    Database,
    EverySweep,
    Form,
    ResultsDir,
    RunNumber,
    Several,
    Sweep,
    Tag,
    Where,
    app,
    axes_of,
    show_grid,
    shown_path,
    split,
)
from seatrial.runner.compare.formats import OutputFormat
from seatrial.runner.configuration.invocation import DEFAULT_DATABASE


@app.command()
def report(
    database: Database = DEFAULT_DATABASE,
    sweep: Sweep = None,
    tag: Tag = None,
    where: Where = None,
    rows: Annotated[
        str | None, typer.Option("--rows", "-r", help="Factor of the rows.  [default: identifier]")
    ] = None,
    columns: Annotated[
        str | None,
        typer.Option("--columns", "-c", help="Factor of the columns.  [default: disturbance]"),
    ] = None,
    title: Annotated[str | None, typer.Option(help="Title of the page.")] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Output file.  [default: report/report.html in the results folder]",
        ),
    ] = None,
    results_dir: ResultsDir = None,
) -> None:
    """Write one HTML file with tables, figures, failures and provenance; it needs no network."""
    request = compare.report.ReportRequest(
        *axes_of(rows, columns), where, sweep, tag, title, database
    )
    with compare.frame.open_results(database, results_dir) as results:
        file = output or shown_path(results.reader.results_dir / "report" / "report.html")
        compare.report.write_report(results, request, file)
    typer.echo(file)


@app.command()
def site(
    to: Annotated[
        Path | None,
        typer.Option(
            "--to", metavar="FOLDER", help="Output folder.  [default: site in the results folder]"
        ),
    ] = None,
    runs: Annotated[
        int,
        typer.Option(
            "--runs", min=0, max=MAX_ROWS, help="Newest runs with details and time series."
        ),
    ] = 200,
    database: Database = DEFAULT_DATABASE,
    results_dir: ResultsDir = None,
) -> None:
    """Write pages to walk through the results: they open from disk and need no network.

    Tables, figures, runs and failures; every view has a link and the command that repeats it.
    """
    with compare.frame.open_results(database, results_dir) as results:
        folder = to or shown_path(results.reader.results_dir / "site")
        typer.echo(compare.site.write_site(results, folder, database, runs))


@app.command()
def retry(
    database: Database = DEFAULT_DATABASE,
    status: Annotated[
        Several, typer.Option(help="failed, diverged, interrupted.  [default: failed, interrupted]")
    ] = None,
    where: Where = None,
    execute: Annotated[
        bool, typer.Option("--execute", help="Run the commands one after the other.")
    ] = False,
) -> None:
    """Print the commands that repeat failed trials, or run them."""
    statuses = split(status) or ("failed", "interrupted")
    with compare.frame.open_results(database) as results:
        commands = compare.housekeeping.retry_commands(results, where, statuses)
    if not commands:
        typer.echo(f"nothing to retry: no trial is {' or '.join(statuses)}", err=True)
    elif execute:
        raise typer.Exit(compare.housekeeping.execute_all(commands))
    for line in commands:
        typer.echo(line)


@app.command()
def export(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Output folder.")],
    database: Database = DEFAULT_DATABASE,
) -> None:
    """Write every table as Parquet and as CSV."""
    with compare.frame.open_results(database) as results:
        for path in results.reader.export(folder):
            typer.echo(path)


@app.command()
def prune(
    database: Database = DEFAULT_DATABASE,
    older_than: Annotated[
        str | None,
        typer.Option(metavar="AGE", help="Only runs started longer ago than 30d, 12h or 2w."),
    ] = None,
    status: Annotated[
        Several, typer.Option(help="failed, diverged, interrupted, finished.")
    ] = None,
    where: Where = None,
    orphans: Annotated[
        bool, typer.Option("--orphans", help="Series files that belong to no run, instead of runs.")
    ] = False,
    yes: Annotated[
        bool, typer.Option("--yes", help="Delete; without it the runs are only listed.")
    ] = False,
    form: Form = OutputFormat.RICH,
    results_dir: ResultsDir = None,
) -> None:
    """Show which runs would be deleted with their files, and with --yes delete them."""
    with compare.frame.open_results(database, results_dir) as results:
        address, folder = results.reader.address, results.reader.results_dir
        if orphans:
            compare.housekeeping.require_no_choice(older_than, status, where)
            count, grid = compare.housekeeping.leftovers(results)
            delete = partial(compare.housekeeping.delete_leftovers, address, folder)
        else:
            runs, grid = compare.housekeeping.prunable(results, older_than, split(status), where)
            count = len(runs)
            delete = partial(compare.housekeeping.delete, address, folder, runs)
    show_grid(grid, form)
    if count and yes:
        typer.echo(delete(), err=True)
    elif count:
        what = "files" if orphans else "runs and their files"
        typer.echo(f"nothing is deleted yet: --yes deletes these {what}", err=True)


@app.command()
def verify(
    database: Database = DEFAULT_DATABASE,
    form: Form = OutputFormat.RICH,
    results_dir: ResultsDir = None,
) -> None:
    """Check the database, every foreign key and the checksum of every series file."""
    with compare.frame.open_results(database, results_dir) as results:
        intact, grid = compare.housekeeping.verification(results)
    show_grid(grid, form)
    if not intact:
        raise typer.Exit(1)


@app.command()
def audit(
    database: Database = DEFAULT_DATABASE,
    where: Where = None,
    sweep: EverySweep = None,
    tag: Tag = None,
    form: Form = OutputFormat.RICH,
) -> None:
    """List runs that mislead in a comparison, with the remedy: nothing is changed."""
    with compare.frame.open_results(database) as results:
        show_grid(compare.audit.audit(results, where, sweep, tag), form)


@app.command()
@app.command()
def animate(
    run: RunNumber,
    to: Annotated[
        Path | None,
        typer.Option(
            "--to",
            metavar="FILE",
            help="A file ending in .html, .gif or .mp4; MP4 needs the program ffmpeg."
            "  [default: an HTML file in the folder of the figures]",
        ),
    ] = None,
    database: Database = DEFAULT_DATABASE,
    results_dir: ResultsDir = None,
) -> None:
    """Animate the track of a run, and print the path of the file.

    The hull is to scale, with thrust and rudder; nominal and identified model are side by side.
    """
    with compare.frame.open_results(database, results_dir) as results:
        typer.echo(shown_path(compare.animation.animate(results, run, to)))
