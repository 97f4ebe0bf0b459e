"""Figures of stored runs, one in each file."""

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from seatrial.models.errors import ConfigurationError, LogbookError
from seatrial.runner.compare.figures import PlotRequest, drawings
from seatrial.runner.compare.frame import Queries
from seatrial.runner.compare.plots.style import drawn, fit, width_of


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

    They are PNG and SVG files for the screen, or PDF files of its width; equal figures give equal
    SVG and PDF. Raises ConfigurationError for an unknown kind or a wrong option, or if no run has
    the data of the figure.
    """
    request.check()
    width_mm = None if request.width is None else width_of(request.width)
    forms: dict[str, dict[str, None]] = {"png": {"Software": None}, "svg": {"Date": None}}
    forms = forms if width_mm is None else {"pdf": {"CreationDate": None}}
    paths = list[Path]()
    with drawn(width_mm=width_mm):
        for drawing in drawings(results, request):
            if width_mm is not None:
                fit(drawing.figure)
            try:
                folder.mkdir(parents=True, exist_ok=True)
                for suffix, metadata in forms.items():
                    paths.append(folder / f"{drawing.name}.{suffix}")
                    drawing.figure.savefig(paths[-1], metadata=metadata)
            except OSError as error:
                told = f"{folder}: cannot write the figure: {error.strerror}"
                raise LogbookError(told) from error
    return paths
