"""The commands of `seatrial-results`: functions of an open logbook; see `cli.command`."""

import re
from datetime import timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer.core import TyperCommand

from seatrial.models.errors import ConfigurationError, LogbookError
from seatrial.runner import compare
from seatrial.runner import database as databases
from seatrial.runner import export as exports
from seatrial.runner.compare.cli import (
    MAX_ROWS,
    Columns,
    Database,
    EverySweep,
    Form,
    PlotOptions,
    ResultsDir,
    Rows,
    RunNumber,
    Several,
    Sweep,
    TableOptions,
    Where,
    app,
    axes_of,
    command,
    is_run,
    newest,
    show_grids,
    shown_path,
    split,
)
from seatrial.runner.compare.figures import figures
from seatrial.runner.compare.formats import OutputFormat
from seatrial.runner.compare.grid import TextTable, grid_of
from seatrial.runner.configuration.invocation import DEFAULT_DATABASE
from seatrial.runner.record.catalogue import all_declared
from seatrial.runner.record.vocabulary import LOST

if TYPE_CHECKING:
    from seatrial.runner.compare.frame import Queries

MINUTES = {"m": 1, "h": 60, "d": 24 * 60, "w": 7 * 24 * 60}


@command()
def runs(
    results: "Queries",
    where: Where = None,
    sweep: EverySweep = None,
    status: Annotated[str | None, typer.Option(help="Only runs of this status.")] = None,
    limit: Annotated[
        int, typer.Option(min=1, max=MAX_ROWS, help="Number of runs, newest first.")
    ] = 50,
) -> TextTable:
    """List runs, newest first, including failed ones and every attempt."""
    condition, _ = results.selected(where, sweep or "all")
    listed = compare.runs.runs_of(results, condition, [status] if status else [], limit)[:limit]
    if not listed:
        raise ConfigurationError(results.why_none(condition, status))
    notes = [f"the newest {limit}; --limit shows more"] if len(listed) == limit else []
    return compare.runs.run_table(results, listed, notes=notes)


@command()
def show(
    results: "Queries",
    run: RunNumber,
    traceback: Annotated[
        bool, typer.Option("--traceback", help="Print only its traceback.")
    ] = False,
    command: Annotated[
        bool, typer.Option("--command", help="Print only the command that repeats it.")
    ] = False,
) -> list[TextTable] | str:
    """Show everything stored about one run: metrics, coefficients, configuration, provenance."""
    detail = results.reader.run(run)
    if command:
        words, address = detail.overrides, results.reader.address
        return compare.runs.repeat_command(words, address, rerun=True, typed=detail.command)
    if traceback:
        return (detail.traceback or f"run {run} is {detail.summary.status}: no traceback").rstrip()
    return [compare.runs.headline(results, run), *compare.runs.run_details(results, run)]


@command(database="sqlite:///results/benchmark/results.db")
def leaderboard(
    results: "Queries",
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
) -> list[TextTable]:
    """Rank the entrants of the benchmark, task by task; `seatrial benchmark` runs them."""
    boards = compare.leaderboard.boards(results, task or (), entrant or ())
    if page is not None:
        compare.benchmark_page.write_benchmark(results, boards, page)
        typer.echo(page, err=True)
    tables = compare.leaderboard
    return [tables.summary(boards)] if summary else tables.grids(boards)


@command()
def table(results: "Queries", options: TableOptions) -> TextTable:
    """Compare a metric or coefficients over seeds.

    Rows and columns are factors: a choice (vessel, disturbance, excitation, identifier, controller,
    evaluation, seed, ...), a dotted name of the configuration (plant.scale), or metric, term, dof,
    stage or model.
    """
    return compare.table.comparison(results, options)


class PlotCommand(TyperCommand):
    """The command `plot`; its help lists the figures of the folder `plots`."""

    def format_help(self, *arguments: Any) -> None:
        """Write the help text."""
        listed = (
            f"{figure.name}: {figure.help} Needs: {figure.needs}." for figure in figures().values()
        )
        self.help = "\n\n".join([self.help or "", *listed])
        super().format_help(*arguments)


@command(cls=PlotCommand)
def plot(results: "Queries", options: PlotOptions) -> list[Path]:
    """Draw figures as PNG and SVG, or with --width as PDF, and print their paths.

    A figure of one run shows the newest run that meets --where; with --facet there is one figure
    for each level (--facet seed).
    """
    request = compare.plots.request_of(options)
    width = None if options.width is None else compare.plots.paper.width_of(options.width)
    folder = options.output or shown_path(results.reader.results_dir / "figures")
    return compare.plots.draw(options.kind, results, request, folder, width)


@command()
def animate(
    results: "Queries",
    run: RunNumber,
    to: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="A file ending in .html, .gif or .mp4; MP4 needs the program ffmpeg."
            "  [default: an HTML file in the folder of the figures]",
        ),
    ] = None,
) -> Path:
    """Animate the track of a run, and print the path of the file.

    The hull is to scale, with thrust and rudder; nominal and identified model are side by side.
    """
    return shown_path(compare.animation.animate(results, run, to))


@app.command()
def metrics(form: Form = OutputFormat.RICH) -> None:
    """List the metrics that trials store: unit, better direction, stage and formula."""
    headers = ("metric", "unit", "better", "stage", "what it is")
    rows = [
        (metric.name, metric.units, metric.better_text, ", ".join(metric.stages), metric.formula)
        for metric in all_declared()
    ]
    show_grids([grid_of("", headers, rows, labels=len(headers))], form)


@app.command()
def manoeuvres(
    subject: Annotated[
        str, typer.Argument(metavar="RUN|FILE", help="A run (a number, or latest) or a recording.")
    ],
    execution: Annotated[
        Literal["half", "order"],
        typer.Option(help="Instant of execution: helm past half, or leaving."),
    ] = "half",
    manoeuvre: Annotated[
        Literal["turn", "zigzag", "spiral", "reverse_spiral", "williamson", "stop"] | None,
        typer.Option(help="Kind of manoeuvre.  [default: by helm and heading]"),
    ] = None,
    helm: Annotated[
        str | None, typer.Option(help="Input that turns the ship.  [default: the run's, or delta]")
    ] = None,
    length: Annotated[
        float | None, typer.Option(min=1e-3, help="Length of the ship [m], if it is not stored.")
    ] = None,
    scale: Annotated[
        float, typer.Option(min=1.0, help="Length of the ship over that of the model.")
    ] = 1.0,
    map_file: Annotated[
        Path | None, typer.Option("--map", metavar="MAP.yaml", help="Map of the columns.")
    ] = None,
    series: Annotated[str, typer.Option(help="Series of the run.")] = "recording",
    database: Database = DEFAULT_DATABASE,
    results_dir: ResultsDir = None,
    form: Form = OutputFormat.RICH,
) -> None:
    """Print the sheet of a manoeuvre beside the limits of IMO resolution MSC.137(76).

    The measures are those of a turning circle, zig-zag, spiral, Williamson turn or stop.
    """
    sheets = compare.manoeuvre_comparison
    if is_run(subject) and not Path(subject).exists():
        with compare.frame.open_results(database, results_dir) as results:
            run = newest(results) if subject == "latest" else int(subject)
            grid = sheets.run_sheet(results, run, series, execution, manoeuvre, helm, length, scale)
    else:
        grid = sheets.file_sheet(Path(subject), map_file, execution, manoeuvre, helm, length, scale)
    show_grids([grid], form)


@command()
def sql(
    results: "Queries",
    query: Annotated[str, typer.Argument(metavar="SELECT", help="A query that only reads.")],
    timeout: Annotated[
        float, typer.Option(min=0.001, max=86400.0, help="Longest time of the query [s].")
    ] = 30.0,
    limit: Annotated[int, typer.Option(min=1, max=MAX_ROWS, help="Number of rows.")] = 10_000,
) -> TextTable:
    """Run a query in SQL; a query that writes is rejected.

    For PostgreSQL use a role that can only read: GRANT pg_read_all_data TO reader.
    """
    answer = results.reader.sql(query, timeout, limit)
    if answer.more:
        typer.echo(f"only the first {limit} rows; --limit shows more", err=True)
    rows = [[compare.runs.plain(value) for value in row] for row in answer.rows]
    return grid_of("", answer.columns, rows, labels=0, digits=6)


@command()
def model(
    results: "Queries",
    run: RunNumber,
    to: Annotated[
        str,
        typer.Option(
            help="Format: yaml, json, statespace, python-control, mss, pvs, gazebo, vrx, c or fmu."
        ),
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
            metavar="POINT",
            help="Operating point of a linear model: u=0.5,psi=1.57,wind_north=5 (m/s, rad, rad/s)."
            "  [default: at rest; for statespace the identified linear model, if there is one]",
        ),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace files that exist.")] = False,
) -> list[Path]:
    """Write a model of a run for another program, and print the paths of the files.

    yaml, json: a vessel for vessel=PATH (and vessel=run:RUN sails it without a file). statespace:
    matrices as .mat or .json. python-control: a Python script. mss: a MATLAB function in the manner
    of Fossen's MSS. pvs: a vehicle of his PythonVehicleSimulator. gazebo, vrx: SDF with a plugin,
    whose head names what the plugin lacks. c: a C99 file and its header. fmu: FMI 2.0 for
    co-simulation, with the C compiler of this machine.
    """
    linear = exports.model_formats.format_of(to).linear and at is None
    stored = exports.stored_model.read_model(results.reader, run, model, linear)
    return exports.model_formats.write(stored, to, output, at, force)


@command()
def report(
    results: "Queries",
    sweep: Sweep = None,
    where: Where = None,
    rows: Rows = None,
    columns: Columns = None,
    title: Annotated[str | None, typer.Option(help="Title of the page.")] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Output file.  [default: report/report.html in the results folder]",
        ),
    ] = None,
    database: Database = DEFAULT_DATABASE,
) -> Path:
    """Write one HTML file with tables, figures, failures and provenance; it needs no network."""
    request = compare.report.ReportRequest(*axes_of(rows, columns), where, sweep, title, database)
    file = output or shown_path(results.reader.results_dir / "report" / "report.html")
    compare.report.write_report(results, request, file)
    return file


@command()
def site(
    results: "Queries",
    to: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER", help="Output folder.  [default: site in the results folder]"
        ),
    ] = None,
    runs: Annotated[
        int, typer.Option(min=0, max=MAX_ROWS, help="Newest runs with details and time series.")
    ] = 200,
    database: Database = DEFAULT_DATABASE,
) -> Path:
    """Write pages to walk through the results: they open from disk and need no network.

    Tables, figures, runs and failures; every view has a link and the command that repeats it.
    """
    folder = to or shown_path(results.reader.results_dir / "site")
    return compare.site.write_site(results, folder, database, runs)


@command()
def retry(
    results: "Queries",
    status: Annotated[
        Several, typer.Option(help="failed, diverged, interrupted.  [default: failed, interrupted]")
    ] = None,
    where: Where = None,
) -> list[str]:
    """Print the commands that repeat failed trials: `retry | sh` runs them."""
    statuses = split(status) or ("failed", "interrupted")
    compare.runs.check_statuses(statuses, LOST)
    lost = compare.runs.runs_of(results, results.where(where), statuses)
    details = [results.reader.run(run.run_id) for run in reversed(lost) if not run.superseded]
    address = results.reader.address
    lines = [
        compare.runs.repeat_command(run.overrides, address, rerun=False, typed=run.command)
        for run in details
    ]
    if not lines:
        typer.echo(f"nothing to retry: no trial is {' or '.join(statuses)}", err=True)
    return lines


@command()
def export(
    results: "Queries",
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Output folder.")],
) -> list[Path]:
    """Write every table as Parquet and as CSV."""
    return results.reader.export(folder)


@command()
def prune(
    results: "Queries",
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
) -> TextTable:
    """Show which runs would be deleted with their files, and with --yes delete them."""
    statuses = split(status)
    compare.runs.check_statuses(statuses, (*LOST, "finished"))
    if status and not statuses:
        raise ConfigurationError("--status: got no status, expected one of those of the help")
    chosen = bool(older_than or statuses or where)
    if orphans == chosen:
        got = "both" if chosen else "none"
        expected = "--older-than, --status or --where, or --orphans alone"
        raise ConfigurationError(f"prune: got {got}, expected {expected}")
    if orphans:
        files = [path for path in results.reader.orphans() if path.exists()]
        count, what = len(files), "files"
        grid = grid_of(
            f"{count} files that belong to no run",
            ("file", "bytes"),
            [[str(path), path.stat().st_size] for path in files],
            labels=2,
        )
    else:
        summaries = results.reader.prunable(
            *results.names.clauses(results.where(where)),
            older_than=age(older_than) if older_than else None,
            statuses=statuses,
        )
        count, what = len(summaries), "runs and their files"
        title = f"{count} runs with {sum(run.series for run in summaries)} series"
        grid = compare.runs.run_table(results, summaries, title)
    if count and not yes:
        typer.echo(f"nothing is deleted yet: --yes deletes these {what}", err=True)
    elif count:
        ids = None if orphans else [run.run_id for run in summaries]
        typer.echo(_delete(results, ids), err=True)
    return grid


def _delete(results: "Queries", runs: list[int] | None) -> str:
    """Delete runs with their rows and files, or files of no run; return what was deleted."""
    reader = results.reader
    reader.close()  # the last to close a SQLite file completes it
    with databases.LogbookWriter.open(
        reader.address.url, results_dir=reader.results_dir, create=False
    ) as logbook:
        if runs is None:
            return f"deleted {len(logbook.remove_orphans())} files"
        pruned = logbook.prune(runs)
    running = len(runs) - pruned.runs
    text = f"deleted {pruned.runs} runs and {pruned.files} files"
    text += f"; {running} are running again and were not deleted" if running else ""
    if pruned.left:
        raise LogbookError(f"{text}; could not delete {', '.join(pruned.left)}")
    return text


def age(text: str) -> timedelta:
    """Parse a duration such as 30d; raises ConfigurationError for any other text."""
    match = re.fullmatch(r"(\d{1,6})([mhdw])", text.strip(), re.ASCII)
    if match is None:
        raise ConfigurationError(
            f"--older-than: got {text!r}, expected an age such as 30d, 12h, 2w"
        )
    return timedelta(minutes=MINUTES[match[2]] * int(match[1]))


@command()
def verify(results: "Queries", form: Form = OutputFormat.RICH) -> None:
    """Check the database, every foreign key and the checksum of every series file.

    Killed programs can leave unused files; they are not a problem.
    """
    report = results.reader.verify()
    rows = [[problem.where, problem.what] for problem in report.problems]
    rows += [[str(path), "unused: this file belongs to no run"] for path in report.leftovers]
    verdict = f"{len(report.problems)} problems" if report.problems else "no problems"
    if report.leftovers:
        verdict += f", {len(report.leftovers)} unused files (prune --orphans)"
    title = f"checked {report.runs} runs and {report.series} series files: {verdict}"
    show_grids([grid_of(title, ("where", "problem"), rows, labels=2)], form)
    if report.problems:
        raise typer.Exit(1)


@command()
def audit(results: "Queries", where: Where = None, sweep: EverySweep = None) -> TextTable:
    """List runs that mislead in a comparison, with the remedy: nothing is changed."""
    return compare.audit.audit(results, where, sweep)
