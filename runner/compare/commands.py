"""The commands of `seatrial-results`: functions of an open logbook; see `cli.command`."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import typer
from typer.core import TyperCommand

from seatrial.models.errors import ConfigurationError, LogbookError
from seatrial.models.notation import Manoeuvre
from seatrial.runner import compare
from seatrial.runner import database as databases
from seatrial.runner import export as exports
from seatrial.runner.compare import cli
from seatrial.runner.compare.cli import TableOptions, command
from seatrial.runner.compare.figures import PlotRequest, Several, figures
from seatrial.runner.compare.grid import OutputFormat, TextTable, grid_of
from seatrial.runner.configuration.invocation import DEFAULT_DATABASE
from seatrial.runner.record.catalogue import all_declared
from seatrial.runner.record.vocabulary import LOST, NOT_STARTED

if TYPE_CHECKING:
    from seatrial.runner.compare.frame import Queries


@command()
def runs(
    results: "Queries", where: str | None = None, sweep: str | None = None,
    status: str | None = None, limit: int = 50,
) -> TextTable:  # fmt: skip
    """List runs, newest first, including failed ones and every attempt.

    --status "not started" lists the trials that were planned and never began.
    """
    condition, _ = results.selected(where, sweep or "all")
    if status == NOT_STARTED:
        return compare.runs.not_started(results, condition)
    listed = compare.runs.runs_of(results, condition, [status] if status else [], limit)[:limit]
    if not listed:
        raise ConfigurationError(results.why_none(condition, status))
    notes = [f"the newest {limit}; --limit shows more"] if len(listed) == limit else []
    return compare.runs.run_table(results, listed, notes=notes)


@command()
def show(
    results: "Queries", run: int, traceback: bool = False, command: bool = False
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
    results: "Queries", task: Several = None, entrant: Several = None, summary: bool = False,
    page: Path | None = None,
) -> list[TextTable]:  # fmt: skip
    """Rank the entrants of the benchmark, task by task; `seatrial benchmark` runs them."""
    boards = compare.leaderboard.boards(results, task or (), entrant or ())
    if page is not None:
        compare.benchmark_page.write_benchmark(results, boards, page)
        typer.echo(page, err=True)
    tables = compare.leaderboard
    return [tables.summary(boards)] if summary else [*map(tables.leaderboard, boards)]


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
def plot(results: "Queries", options: PlotRequest) -> list[Path]:
    """Draw figures as PNG and SVG, or with --width as PDF, and print their paths.

    A figure of one run shows the newest run that meets --where; with --facet there is one figure
    for each level (--facet seed).
    """
    folder = options.output or cli.shown_path(results.reader.results_dir / "figures")
    return compare.plots.draw(results, options, folder)


@command()
def animate(results: "Queries", run: int, to: Path | None = None) -> Path:
    """Animate the track of a run, and print the path of the file.

    The hull is to scale, with thrust and rudder; nominal and identified model are side by side.
    """
    return cli.shown_path(compare.animation.animate(results, run, to))


@command()
def metrics() -> TextTable:
    """List the metrics that trials store: unit, better direction, stage and formula."""
    headers = ("metric", "unit", "better", "stage", "what it is")
    rows = [
        (metric.name, metric.units, metric.better_text, ", ".join(metric.stages), metric.formula)
        for metric in all_declared()
    ]
    return grid_of("", headers, rows, labels=len(headers))


@command()
def manoeuvres(
    subject: str, manoeuvre: Manoeuvre | None = None, helm: str | None = None,
    length: float | None = None, scale: float = 1.0, map_file: Path | None = None,
    database: str = DEFAULT_DATABASE, results_dir: Path | None = None,
) -> TextTable:  # fmt: skip
    """Print the sheet of a manoeuvre beside the limits of IMO resolution MSC.137(76).

    The measures are those of a turning circle, zig-zag, spiral, Williamson turn or stop.
    """
    sheets = compare.manoeuvre_comparison
    if not cli.is_run(subject) or Path(subject).exists():
        recorded = exports.manoeuvre_tracks.file_track(Path(subject), map_file, helm, length)
        return sheets.sheet_of(recorded, subject, manoeuvre, scale)
    with compare.frame.open_results(database, results_dir) as results:
        run = cli.newest(results) if subject == "latest" else int(subject)
        return sheets.run_sheet(results, run, manoeuvre, helm, length, scale)


@command()
def sql(results: "Queries", query: str, timeout: float = 30.0, limit: int = 10_000) -> TextTable:
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
    results: "Queries", run: int, *, to: str, output: Path | None = None,
    model: Literal["identified", "nominal", "plant", "adaptive"] = "identified",
    at: str | None = None, force: bool = False,
) -> list[Path]:  # fmt: skip
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
    results: "Queries", sweep: str | None = None, where: str | None = None, rows: str | None = None,
    columns: str | None = None, title: str | None = None, output: Path | None = None,
    database: str = DEFAULT_DATABASE,
) -> Path:  # fmt: skip
    """Write one HTML file with tables, figures, failures and provenance; it needs no network."""
    options = TableOptions(rows, columns, where=where, sweep=sweep)
    file = output or cli.shown_path(results.reader.results_dir / "report" / "report.html")
    compare.page.write_page(compare.report.render_report(results, options, database, title), file)
    return file


@command()
def site(
    results: "Queries", to: Path | None = None, runs: int = 200, database: str = DEFAULT_DATABASE
) -> Path:
    """Write pages to walk through the results: they open from disk and need no network.

    Tables, figures, runs and failures; every view has a link and the command that repeats it.
    """
    folder = to or cli.shown_path(results.reader.results_dir / "site")
    return compare.site.write_site(results, folder, database, runs)


@command()
def retry(results: "Queries", status: Several = None, where: str | None = None) -> list[str]:
    """Print the commands that repeat failed trials: `retry | sh` runs them."""
    statuses = status or ["failed", "interrupted"]
    lost = compare.runs.runs_of(results, results.where(where), statuses, known=LOST)
    details = [results.reader.run(run.run_id) for run in reversed(lost) if not run.superseded]
    if not details:
        typer.echo(f"nothing to retry: no trial is {' or '.join(statuses)}", err=True)
    repeat = partial(compare.runs.repeat_command, address=results.reader.address, rerun=False)
    return [repeat(run.overrides, typed=run.command) for run in details]


@command()
def export(results: "Queries", folder: Path) -> list[Path]:
    """Write every table as Parquet and as CSV."""
    return results.reader.export(folder)


@command()
def prune(
    results: "Queries", status: Several = None, where: str | None = None, yes: bool = False
) -> TextTable:
    """Show which runs would be deleted with their files, and with --yes delete them."""
    if not (status or where):
        raise ConfigurationError("prune: got no choice of runs, expected --status or --where")
    known, condition = [*LOST, "finished"], results.where(where)
    summaries = compare.runs.runs_of(results, condition, status or known, known=known)[::-1]
    title = f"{len(summaries)} runs with {sum(run.series for run in summaries)} series"
    grid = compare.runs.run_table(results, summaries, title)
    if not yes:
        typer.echo("nothing is deleted yet: --yes deletes these runs and their files", err=True)
        return grid
    reader = results.reader
    reader.close()  # the last to close a SQLite file completes it
    with databases.LogbookWriter.open(
        reader.address.url, results_dir=reader.results_dir, create=False
    ) as logbook:
        deleted, files, left = logbook.prune([run.run_id for run in summaries])
    text = f"deleted {deleted} runs and {files} files"
    if running := len(summaries) - deleted:
        text += f"; {running} are running again and were not deleted"
    if left:
        raise LogbookError(f"{text}; could not delete {', '.join(left)}")
    typer.echo(text, err=True)
    return grid


@command()
def verify(results: "Queries", form: OutputFormat = OutputFormat.RICH) -> None:
    """Check the database, every foreign key and the checksum of every series file.

    Killed programs can leave unused files; they are not a problem, and may be deleted.
    """
    report = results.reader.verify()
    rows = [[*problem] for problem in report.problems]
    rows += [[str(path), "unused: this file belongs to no run"] for path in report.leftovers]
    counts = (
        f"{len(report.problems) or 'no'} problems, {len(report.leftovers) or 'no'} unused files"
    )
    title = f"checked {report.runs} runs and {report.series} series files: {counts}"
    cli.show(grid_of(title, ("where", "problem"), rows, labels=2), form)
    if report.problems:
        raise typer.Exit(1)


@command()
def audit(results: "Queries", where: str | None = None, sweep: str | None = None) -> TextTable:
    """List runs that mislead in a comparison, with the remedy: nothing is changed."""
    return compare.audit.audit(results, where, sweep)
