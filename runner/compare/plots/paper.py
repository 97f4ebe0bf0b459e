"""Figures for print: PDF files of the width of a column or a page, with texts of 8 points.

Figures are drawn for the screen, in inches that suit the number of their panels. For print they get
the width asked for: panels that would be too narrow stand below each other, all texts get one size,
and labels that would overlap or be clipped are wrapped or turned.
"""

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from itertools import pairwise
from textwrap import wrap
from typing import TYPE_CHECKING

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.ticker import FixedFormatter, NullFormatter

from seatrial.models.errors import ConfigurationError

if TYPE_CHECKING:
    from matplotlib.typing import RcKeyType

MM_PER_INCH = 25.4
POINTS_PER_INCH = 72.0
WIDTHS_MM = {"column": 86.0, "page": 178.0}  # of journals with two columns: 84-90, 174-190
NARROWEST_MM, WIDEST_MM = 40.0, 1200.0
POINTS = 8.0  # of all texts
PANEL_INCH = 2.2  # width of the narrowest panel, with its labels
HIGHEST_INCH = 100.0
LOWEST_INCH = 1.0  # height of the lowest panel, without them
RC: "dict[RcKeyType, object]" = {
    "font.size": POINTS,
    "axes.titlesize": POINTS,
    "axes.labelsize": POINTS,
    "legend.fontsize": POINTS,
    "xtick.labelsize": POINTS,
    "ytick.labelsize": POINTS,
    "axes.linewidth": 0.6,
    "lines.linewidth": 1.0,
    "pdf.fonttype": 42,  # TrueType, as publishers ask for
    "figure.constrained_layout.h_pad": 0.03,
    "figure.constrained_layout.w_pad": 0.03,
}
_width: ContextVar[float | None] = ContextVar("width of the paper [inch]", default=None)


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


@contextmanager
def of_width(width_mm: float | None) -> Iterator[None]:
    """Context in which figures have this width [mm]; None: that of the screen."""
    token = _width.set(None if width_mm is None else width_mm / MM_PER_INCH)
    try:
        yield
    finally:
        _width.reset(token)


def size_of(width: float, height: float) -> tuple[float, float]:
    """Return the size [inch] of a figure that has width x height on the screen.

    Texts do not shrink with the paper, so the height shrinks less than the width.
    """
    paper = _width.get()
    return (width, height) if paper is None else (paper, height * min(1.0, paper / width) ** 0.5)


def text_size(screen: float) -> float:
    """Return the size [points] of a text that has the size `screen` on the screen."""
    return screen if _width.get() is None else POINTS


def columns_of(columns: int) -> int:
    """Return how many panels stand side by side, of those that do on the screen."""
    paper = _width.get()
    return columns if paper is None else max(1, min(columns, int(paper / PANEL_INCH)))


def fit(chart: Figure) -> None:
    """Give all texts one size; wrap and turn labels that do not fit, and heighten flat panels."""
    for text in chart.findobj(Text):
        assert isinstance(text, Text)
        text.set_fontsize(POINTS)
    _lay_out(chart)
    for axes in chart.axes:
        _turn_ticks(axes)
    for _ in range(2):  # what surrounds the panels takes its place at the first time
        _lay_out(chart)
        lacking = max(_lacking(axes) for axes in chart.axes)
        if lacking > 0.0:
            rows = max(_rows(axes) for axes in chart.axes)
            chart.set_figheight(chart.get_figheight() + rows * lacking)
    _lay_out(chart)
    for axes in chart.axes:
        room = axes.get_window_extent()
        _wrap(axes.xaxis.label, room.width)
        _wrap(axes.yaxis.label, room.height)
        for title in (axes.title, axes._left_title):  # type: ignore[attr-defined]
            _wrap(title, room.width)
    _lay_out(chart)


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


def _wrap(text: Text, room: float) -> None:
    """Break a text of one line that is longer than its room [pixel]."""
    extent, line = text.get_window_extent(), text.get_text()
    length = max(extent.width, extent.height)
    if length > room and "\n" not in line:
        letters = max(1, int(len(line) * room / length))
        text.set_text("\n".join(wrap(line, letters, break_long_words=False)))


def _turn_ticks(axes: Axes) -> None:
    """Leave out the labels of minor ticks, or else turn the labels below an axis, if they overlap.

    Ticks of numbers are placed by matplotlib so that their labels do not overlap.
    """
    if _overlap([*axes.get_xticklabels(), *axes.get_xticklabels(minor=True)]):
        axes.xaxis.set_minor_formatter(NullFormatter())
    labels = axes.get_xticklabels()
    if _overlap(labels):
        for label in labels:
            label.set(rotation=30, ha="right", rotation_mode="anchor")


def _lacking(axes: Axes) -> float:
    """Return by how much a panel should be higher [inch]; rows of names need a line each."""
    chart = axes.get_figure(root=True)
    assert chart is not None
    names = [text for text in axes.get_yticklabels() if text.get_text()]
    named = isinstance(axes.yaxis.get_major_formatter(), FixedFormatter)
    wanted = max(LOWEST_INCH, 1.5 * POINTS / POINTS_PER_INCH * len(names) if named else 0.0)
    return wanted - float(axes.get_window_extent().height) / chart.dpi


def _rows(axes: Axes) -> int:
    place = axes.get_subplotspec()
    return 1 if place is None else place.get_gridspec().nrows


def _overlap(labels: Sequence[Text]) -> bool:
    boxes = [label.get_window_extent() for label in labels if label.get_text()]
    boxes.sort(key=lambda box: float(box.x0))
    return any(left.x1 + 2.0 > right.x0 for left, right in pairwise(boxes))
