"""Figures of stored runs, one in each file."""

from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from seatrial.models.errors import ConfigurationError, LogbookError
from seatrial.runner.compare import cli
from seatrial.runner.compare.figures import OPTIONS, drawings_of, figure_of
from seatrial.runner.compare.frame import Queries
from seatrial.runner.compare.plots.request import PlotRequest
from seatrial.runner.compare.plots.style import drawn, save


def request_of(options: cli.PlotOptions) -> PlotRequest:
    """Return the request of the options.

    Raises ConfigurationError for an unknown figure, and for an option that it does not take.
    """
    figure, untouched = figure_of(options.kind), cli.PlotOptions(options.kind)
    for name in OPTIONS:
        given = getattr(options, name) != getattr(untouched, name)
        if given and name not in figure.options:
            taken = ", ".join(f"--{option}" for option in figure.options) or "those of runs alone"
            raise ConfigurationError(
                f"plot {options.kind}: --{name}: not an option of this figure, expected {taken}"
            )
    rows, columns = cli.axes_of(options.rows or figure.rows or None, options.columns)
    same = ("run", "metric", "model", "facet", "band", "log", "where", "sweep")
    chosen: dict[str, Any] = {name: getattr(options, name) for name in same}
    chosen |= {"dofs": cli.split(options.dof), "pool": cli.split(options.pool)}
    return PlotRequest(rows=rows, columns=columns, **chosen)


def figures_of(
    kind: str, results: Queries, request: PlotRequest, axes: Axes | None = None
) -> list[Figure]:
    """Draw the figures of a kind and return them; one with one panel may be drawn into `axes`.

    Raises ConfigurationError for an unknown kind, if no run has the data of the figure, or if the
    axes cannot hold it.
    """
    drawings = drawings_of(kind)
    with drawn(axes):
        figures = [drawing.figure for drawing in drawings(results, request)]
    if axes is not None and len(figures) > 1:
        raise ConfigurationError(f"plot {kind}: got axes for one of {len(figures)} figures")
    return figures


def draw(
    kind: str, results: Queries, request: PlotRequest, folder: Path, width_mm: float | None = None
) -> list[Path]:
    """Draw the figures of a kind into a folder and return the paths of the files.

    They are PNG and SVG files for the screen, or with `width_mm` PDF files of this width.
    Raises ConfigurationError for an unknown kind, or if no run has the data of the figure.
    """
    drawings = drawings_of(kind)
    with drawn(width_mm=width_mm):
        figures = drawings(results, request)
        try:
            return [path for one in figures for path in save(one, folder, width_mm is not None)]
        except OSError as error:
            raise LogbookError(f"{folder}: cannot write the figure: {error.strerror}") from error
