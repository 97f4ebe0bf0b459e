"""Figures of stored runs, one kind a file; each offers `drawings(results, request)`."""

from importlib import import_module
from pathlib import Path
from typing import get_args

from seatrial.models.errors import LogbookError
from seatrial.runner.compare.kinds import PlotKind
from seatrial.runner.compare.plots.request import PlotRequest
from seatrial.runner.compare.results import Results

KINDS = get_args(PlotKind)


def draw(kind: str, results: Results, request: PlotRequest, folder: Path) -> list[Path]:
    """Draws the figures of a kind into a folder; the paths of the files written.

    Raises ConfigurationError where no run has what the figure needs.
    """
    from seatrial.runner.compare.plots.style import drawn, save

    drawings = import_module(f"{__name__}.{kind}").drawings
    with drawn():
        made = drawings(results, request)
        try:
            return [path for drawing in made for path in save(drawing, folder)]
        except OSError as error:
            raise LogbookError(f"{folder}: cannot write the figure: {error.strerror}") from error
