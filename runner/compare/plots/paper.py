"""Figures for print: PDF files of the width of a column or a page, with texts of 8 points."""

import warnings
from contextlib import suppress
from operator import ge
from typing import TYPE_CHECKING

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import FixedFormatter

from seatrial.models.errors import ConfigurationError

if TYPE_CHECKING:
    from matplotlib.typing import RcKeyType

MM_PER_INCH = 25.4
WIDTHS_MM = {"column": 86.0, "page": 178.0}  # of journals with two columns: 84-90, 174-190
NARROWEST_MM, WIDEST_MM = 40.0, 1200.0
TEXT_POINTS = 8.0  # of all texts
HIGHEST_INCH = 100.0
LOWEST_INCH = 1.0  # height of the lowest panel, without its labels
LETTER_INCH = 0.065  # of a text
PANEL_INCH = 2.2  # width of the narrowest panel, with its labels
RC: "dict[RcKeyType, object]" = {
    **{"font.size": TEXT_POINTS, "axes.titlesize": TEXT_POINTS, "axes.labelsize": TEXT_POINTS},
    **{
        "legend.fontsize": TEXT_POINTS,
        "xtick.labelsize": TEXT_POINTS,
        "ytick.labelsize": TEXT_POINTS,
    },
    "axes.linewidth": 0.6,
    "lines.linewidth": 1.0,
    "pdf.fonttype": 42,  # TrueType, as publishers ask for
    "figure.constrained_layout.h_pad": 0.03,
    "figure.constrained_layout.w_pad": 0.03,
}


def width_of(text: str) -> float:
    """Return the width [mm] of `column`, `page` or a number; raises ConfigurationError else."""
    try:
        width = WIDTHS_MM.get(text) or float(text)
    except ValueError:
        width = 0.0
    if not NARROWEST_MM <= width <= WIDEST_MM:
        raise ConfigurationError(
            f"--width: got {text!r}, expected column, page or {NARROWEST_MM:g} to {WIDEST_MM:g} mm"
        )
    return width


def fit(chart: Figure) -> None:
    """Give all texts one size, and heighten a figure until its labels leave room for its panels."""
    for text in chart.findobj(Text):
        assert isinstance(text, Text)
        text.set_fontsize(TEXT_POINTS)
    while chart.get_figheight() <= HIGHEST_INCH:
        with warnings.catch_warnings():
            warnings.filterwarnings("error", "constrained_layout not applied")
            with suppress(UserWarning):
                chart.draw_without_rendering()
                height = chart.get_figheight()
                heights = [height * axes.get_position(original=True).height for axes in chart.axes]
                if all(map(ge, heights, map(_lowest, chart.axes))):
                    return
        chart.set_figheight(1.2 * chart.get_figheight())


def _lowest(axes: Axes) -> float:
    """The height that a panel needs [inch]; rows of names need a line each."""
    named = isinstance(axes.yaxis.get_major_formatter(), FixedFormatter)
    names = [text for text in axes.get_yticklabels() if named and text.get_text()]
    label = len(axes.get_ylabel()) * LETTER_INCH
    return max(LOWEST_INCH, label, 1.5 * TEXT_POINTS / 72.0 * len(names))
