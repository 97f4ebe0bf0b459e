"""Figures of stored runs, one in each file."""

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from seatrial.models.errors import ConfigurationError, LogbookError
from seatrial.runner.compare.figures import PlotRequest, drawings
from seatrial.runner.compare.frame import Queries
from seatrial.runner.compare.plots.style import drawn, save, width_of


def figures_of(results: Queries, request: PlotRequest, axes: Axes | None = None) -> list[Figure]:
    """Draw the figures of a request and return them; one of one panel may be drawn into `axes`.

    Raises ConfigurationError for an unknown kind or a wrong option, if no run has the data of the
    figure, or if the axes cannot hold it.
    """
    request.check()
    with drawn(axes):
        figures = [drawing.figure for drawing in drawings(results, request)]
    if axes is not None and len(figures) > 1:
        raise ConfigurationError(f"plot {request.kind}: got axes for one of {len(figures)} figures")
    return figures


def draw(results: Queries, request: PlotRequest, folder: Path) -> list[Path]:
    """Draw the figures of a request into a folder and return the paths of the files.

    They are PNG and SVG files for the screen, or PDF files of its width. Raises ConfigurationError
    for an unknown kind or a wrong option, or if no run has the data of the figure.
    """
    request.check()
    width_mm = None if request.width is None else width_of(request.width)
    with drawn(width_mm=width_mm):
        figures = drawings(results, request)
        try:
            return [path for one in figures for path in save(one, folder, width_mm is not None)]
        except OSError as error:
            raise LogbookError(f"{folder}: cannot write the figure: {error.strerror}") from error
