"""The command that puts printed figures beside ours: published."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from .app import DEFAULT_DATABASE, Database, Form, ResultsDir, app, show_grid, show_grids
from .formats import Format


@app.command()
def published(
    experiment: Annotated[
        str | None, typer.Option("--experiment", "-e", help="Only this one of conf/experiment.")
    ] = None,
    summary: Annotated[
        bool, typer.Option("--summary", help="Only how many figures have which verdict.")
    ] = False,
    page: Annotated[
        Path | None, typer.Option("--page", help="Also write all of it to this HTML file.")
    ] = None,
    printed: Annotated[
        Path | None,
        typer.Option("--printed", help="Folder of the printed figures; else tests/published."),
    ] = None,
    database: Database = DEFAULT_DATABASE,
    results_dir: ResultsDir = None,
    form: Form = Format.RICH,
) -> None:
    """Put printed figures beside ours: ratio, verdict and reason."""
    from .published import FOLDER, by_table, judged, read_folder
    from .published_tables import NOTE, published_grid, summary_grid
    from .results import open_results

    figures = read_folder(printed or FOLDER, experiment)
    with open_results(database, results_dir) as results:
        tables = [judged(results, one) for one in figures.values() if one]
        if page is not None:
            from .published_page import write_published

            write_published(results, tables, page)
    if summary:
        show_grid(summary_grid(tables), form)
    else:
        grids = [published_grid(one) for found in tables for one in by_table(found)]
        grids[-1] = replace(grids[-1], notes=[NOTE])
        show_grids(grids, form)
    if page is not None:
        typer.echo(page, err=True)
