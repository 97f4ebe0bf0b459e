"""Figures of stored runs, one a file."""

from pathlib import Path

from seatrial.models.errors import LogbookError
from seatrial.runner.compare.figures import drawings_of
from seatrial.runner.compare.plots.request import PlotRequest
from seatrial.runner.compare.results import Results


def draw(kind: str, results: Results, request: PlotRequest, folder: Path) -> list[Path]:
    """Draws the figures of a kind into a folder; the paths of the files written.

    Raises ConfigurationError where there is no such kind, or no run has what the figure needs.
    """
    from seatrial.runner.compare.plots.style import drawn, save

    drawings = drawings_of(kind)
    with drawn():
        made = drawings(results, request)
        try:
            return [path for drawing in made for path in save(drawing, folder)]
        except OSError as error:
            raise LogbookError(f"{folder}: cannot write the figure: {error.strerror}") from error
