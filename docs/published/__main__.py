"""Compare printed figures with stored results: `python -m docs.published`, `make published`.

Exit codes: 0 for success, 2 for bad input.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from docs.published.page import NOTE, published_grid, summary_grids, write_published
from docs.published.printed import by_table, judged, read_folder
from seatrial.models.errors import SeatrialError
from seatrial.runner.compare.cli import show
from seatrial.runner.compare.frame import open_results
from seatrial.runner.compare.grid import OutputFormat
from seatrial.runner.configuration.invocation import DEFAULT_DATABASE


def main(words: Sequence[str] | None = None) -> int:
    """Print ratio, verdict and reason of every figure; return the exit code."""
    parser = argparse.ArgumentParser(
        "python -m docs.published", description="Compare printed figures with stored results."
    )
    parser.add_argument("--experiment", help="only this experiment")
    parser.add_argument(
        "--summary", action="store_true", help="only the number of figures with each verdict"
    )
    parser.add_argument("--page", type=Path, help="also write the tables and figures to this file")
    parser.add_argument("--database", default=DEFAULT_DATABASE, help="URL or file of the logbook")
    parser.add_argument(
        "--format", default=OutputFormat.RICH, choices=list(OutputFormat), type=OutputFormat
    )
    options = parser.parse_args(words)
    try:
        figures = read_folder(experiment=options.experiment)
        with open_results(options.database) as results:
            tables = [judged(results, printed) for printed in figures.values()]
            if options.page is not None:
                write_published(results, tables, options.page)
    except SeatrialError as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return 2
    if options.summary:
        grids = summary_grids(tables)
    else:
        grids = [published_grid(rows) for table in tables for rows in by_table(table)]
        grids[-1] = replace(grids[-1], notes=[NOTE])
    show(grids, options.format)
    if options.page is not None:
        print(options.page, file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
