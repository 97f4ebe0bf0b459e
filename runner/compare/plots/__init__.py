"""Figures of stored runs, one in each file."""

from pathlib import Path

from seatrial.models.errors import LogbookError
from seatrial.runner.compare.figures import drawings_of
from seatrial.runner.compare.plots.request import PlotRequest
from seatrial.runner.compare.plots.style import drawn, save
from seatrial.runner.compare.results import Results


def draw(
    kind: str,
    results: Results,
    request: PlotRequest,
    folder: Path,
    width_mm: float | None = None,
) -> list[Path]:
    """Draw the figures of a kind into a folder and return the paths of the files.

    They are PNG and SVG files for the screen, or with `width_mm` PDF files of this width.
    Raises ConfigurationError for an unknown kind, or if no run has the data of the figure.
    """
    drawings = drawings_of(kind)
    with drawn(width_mm):
        figures = drawings(results, request)
        try:
            return [
                path
                for drawing in figures
                for path in save(drawing, folder, print_=width_mm is not None)
            ]
        except OSError as error:
            raise LogbookError(f"{folder}: cannot write the figure: {error.strerror}") from error
