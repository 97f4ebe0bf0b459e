"""Figures for print: PDF files of the width of a column or a page, with texts of 8 points."""

import warnings
from itertools import pairwise
from textwrap import fill
from typing import TYPE_CHECKING

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import FixedFormatter, NullFormatter

from seatrial.models.errors import ConfigurationError

if TYPE_CHECKING:
    from matplotlib.typing import RcKeyType

MM_PER_INCH = 25.4
WIDTHS_MM = {"column": 86.0, "page": 178.0}  # of journals with two columns: 84-90, 174-190
NARROWEST_MM, WIDEST_MM = 40.0, 1200.0
TEXT_POINTS = 8.0  # of all texts
HIGHEST_INCH = 100.0
LOWEST_INCH = 1.0  # height of the lowest panel, without its labels
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
    """Give all texts one size, turn names that overlap, heighten flat panels, wrap long labels."""
    for text in chart.findobj(Text):
        assert isinstance(text, Text)
        text.set_fontsize(TEXT_POINTS)
    _lay_out(chart)
    for axes in chart.axes:
        axes.xaxis.set_minor_formatter(NullFormatter())
        names = [label for label in axes.get_xticklabels() if label.get_text()]
        boxes = sorted((name.get_window_extent() for name in names), key=lambda box: float(box.x0))
        if any(left.x1 + 2.0 > right.x0 for left, right in pairwise(boxes)):
            for name in names:
                name.set(rotation=30, ha="right", rotation_mode="anchor")
    _lay_out(chart)
    place = chart.axes[0].get_subplotspec()
    height = chart.get_figheight()
    lacking = max(
        _lowest(axes) - height * axes.get_position(original=True).height for axes in chart.axes
    )
    if lacking > 0.0 and place is not None:
        chart.set_figheight(chart.get_figheight() + place.get_gridspec().nrows * lacking)
        _lay_out(chart)
    for axes in chart.axes:
        room = axes.get_window_extent()
        title: Text = axes._left_title  # type: ignore[attr-defined]
        labels = (axes.xaxis.label, room.width), (axes.yaxis.label, room.height)
        for text, space in (*labels, (title, room.width)):
            extent, line = text.get_window_extent(), text.get_text()
            length = max(extent.width, extent.height)
            if length > space and "\n" not in line:
                letters = max(1, int(len(line) * space / length))
                text.set_text(fill(line, letters, break_long_words=False))


def _lay_out(chart: Figure) -> None:
    """Place everything; heighten a figure whose labels leave no room for its panels."""
    while chart.get_figheight() < HIGHEST_INCH:
        with warnings.catch_warnings():
            warnings.filterwarnings("error", "constrained_layout not applied")
            try:
                chart.draw_without_rendering()
            except UserWarning:
                chart.set_figheight(1.3 * chart.get_figheight())
            else:
                return


def _lowest(axes: Axes) -> float:
    """The height that a panel needs [inch]; rows of names need a line each."""
    named = isinstance(axes.yaxis.get_major_formatter(), FixedFormatter)
    names = [text for text in axes.get_yticklabels() if named and text.get_text()]
    return max(LOWEST_INCH, 1.5 * TEXT_POINTS / 72.0 * len(names))
