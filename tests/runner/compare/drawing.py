"""Figures drawn without files, and what is to be seen on them."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from seatrial.runner.compare import figures
from seatrial.runner.compare.figures import PlotRequest
from seatrial.runner.compare.frame import Queries
from seatrial.runner.compare.plots.style import Drawing, drawn


def drawings(kind: str, results: Queries, **options: Any) -> list[Drawing]:
    """The figures of a kind, as they are before they are laid out."""
    with drawn():
        made: list[Drawing] = figures.drawings(results, PlotRequest(kind, **options))
    return made


def axes_of(kind: str, results: Queries, **options: Any) -> list[Axes]:
    """The axes of the only figure of a kind, laid out and drawn."""
    (drawing,) = drawings(kind, results, **options)
    with drawn():
        drawing.figure.draw_without_rendering()
    return list(drawing.figure.axes)


def line(axes: Axes, label: str) -> np.ndarray[Any, Any]:
    """Points (N, 2) of the first line with a label."""
    return np.asarray(next(one for one in axes.lines if one.get_label() == label).get_xydata())


def limits(axes: Axes) -> list[float]:
    """Where the lines of limits lie."""
    return [float(one.get_ydata()[0]) for one in axes.lines if one.get_label() == "limit"]


def notes(figure: Figure) -> str:
    """What is said below a figure."""
    return " ".join(figure._supxlabel.get_text().split())  # type: ignore[attr-defined]
