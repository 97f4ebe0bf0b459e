"""Common style of the figures: palette, sizes, titles, legends, notes, units; screen and print.

Figures are made without pyplot: no window, no global state, and no effect of backend settings. A
figure with one panel may be drawn into axes of the caller's (`drawn(axes)`); title, legend and
notes then belong to these axes, and the rest of their figure is not changed. For print there are
PDF files of the width of a column or a page, with texts of 8 points.
"""

import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from io import BytesIO
from textwrap import wrap
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError, LogbookError
from seatrial.runner.compare.statistics import Sample

if TYPE_CHECKING:
    from matplotlib.typing import RcKeyType

# Okabe and Ito (2008), ordered for contrast of neighbours, without yellow, which is too pale; then
# dark colours of Tol (2021) for figures of many series.
PALETTE = (
    *("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#000000"),
    *("#882255", "#999933", "#332288", "#88CCEE", "#117733", "#AA4499", "#777777"),
)
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", "p", ">", "h", "d", "*", "H")
MODEL_COLOURS = {
    **{"nominal": "#D55E00", "identified": "#0072B2", "plant": "#009E73"},
    "recording": "#0072B2",  # shown alone, without a deployment
}
REFERENCE = "#000000"
WIND = "#56B4E9"
MUTED = "#595959"
SHADE = "#E8E8E8"
LAND = "#D9D9D9"
TITLE_SIZE = 11
TITLE_LETTERS_PER_INCH = 9.5
LETTERS_PER_INCH = 14  # of the legend's font, a low estimate
TEXT_SHARE = 0.17  # height of a line of text beside a panel, of the lowest panel
RC: "Mapping[RcKeyType, object]" = {
    "font.family": "DejaVu Sans",  # part of matplotlib: the same on every machine
    "font.size": 10, "axes.titlesize": TITLE_SIZE, "axes.titleweight": "bold",
    "legend.fontsize": 9, "legend.frameon": False, "xtick.labelsize": 9, "ytick.labelsize": 9,
    "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True,
    "axes.axisbelow": True, "grid.color": "#DDDDDD", "grid.linewidth": 0.6,
    "lines.linewidth": 1.4, "figure.dpi": 150, "savefig.dpi": 150,
    "figure.constrained_layout.h_pad": 0.07, "figure.constrained_layout.w_pad": 0.07,
    "svg.hashsalt": "seatrial", "svg.fonttype": "path",
    "path.simplify_threshold": 0.5,  # [px] long lines make no large files
}  # fmt: skip
PREFIXES = (("M", 1e6, 1e6), ("k", 1e3, 1e4))  # letter, factor, smallest value that takes it
PREFIXED = ("N", "Nm", "W", "J")
MM_PER_INCH = 25.4
WIDTHS_MM = {"column": 86.0, "page": 178.0}  # of journals with two columns: 84-90, 174-190
NARROWEST_MM, WIDEST_MM = 40.0, 1200.0
TEXT_POINTS = 8.0  # of all texts
HIGHEST_INCH = 100.0
LOWEST_INCH = 1.0  # height of the lowest panel, without its labels
LETTER_INCH = 0.065  # of a text
PANEL_INCH = 2.2  # width of the narrowest panel, with its labels
PRINT_RC: "Mapping[RcKeyType, object]" = {
    "font.size": TEXT_POINTS, "axes.titlesize": TEXT_POINTS, "legend.fontsize": TEXT_POINTS,
    "xtick.labelsize": TEXT_POINTS, "ytick.labelsize": TEXT_POINTS, "axes.linewidth": 0.6,
    "lines.linewidth": 1.0, "pdf.fonttype": 42,  # TrueType, as publishers ask for
    "figure.constrained_layout.h_pad": 0.03, "figure.constrained_layout.w_pad": 0.03,
}  # fmt: skip
SHOWN_LIMIT = 2.5  # a limit above this multiple of the peak is not drawn


class Canvas(NamedTuple):
    """What is drawn on: axes of the caller's, or paper of a width [mm], else the screen."""

    axes: Axes | None = None
    width_mm: float | None = None


SCREEN = Canvas()
_CANVAS = ContextVar("canvas", default=SCREEN)


class Chart(Figure):
    """A figure that a notebook shows without pyplot, and that is saved as the commands save it."""

    def savefig(self, *arguments: Any, **options: Any) -> None:
        """Write the figure as `matplotlib.figure.Figure.savefig` does, in the style above."""
        with drawn(*_CANVAS.get()):
            super().savefig(*arguments, **options)

    def _repr_png_(self) -> bytes:
        image = BytesIO()
        self.savefig(image, format="png", dpi=100, metadata={"Software": None})
        return image.getvalue()


class Drawing(NamedTuple):
    """A figure and the name of its files."""

    name: str
    figure: Figure


@contextmanager
def drawn(axes: Axes | None = None, width_mm: float | None = None) -> Iterator[None]:
    """Context for drawing and saving: the settings above on matplotlib's defaults.

    `axes` are those of the caller, for a figure with one panel. With `width_mm` figures are for
    print, of this width. Raises LogbookError for a stored name that reads as a formula and is none.
    """
    token = _CANVAS.set(Canvas(axes, width_mm))
    try:
        with mpl.rc_context():
            mpl.rcdefaults()
            mpl.rcParams.update({**RC, **({} if width_mm is None else PRINT_RC)})
            yield
    except ValueError as error:
        if "ParseFatalException" not in str(error):
            raise
        raise LogbookError(f"plot: a stored name cannot be drawn: {str(error).strip()}") from error
    finally:
        _CANVAS.reset(token)


def panels(
    rows: int, columns: int, width: float, height: float, share_x: bool = False,
    count: int | None = None,
) -> tuple[Figure, list[Axes]]:  # fmt: skip
    """Return a figure of rows x columns axes, each width x height [inch], and its axes by row.

    There are all or the first `count`. With `share_x` all have the same range of x. In print the
    width is that of the paper; texts do not shrink with it, so the height hardly does, and panels
    that are too narrow stand below each other. One panel is drawn into the axes of the caller, if
    there are any; several raise ConfigurationError there.
    """
    canvas, abreast = _CANVAS.get(), columns
    if canvas.axes is not None:
        if rows * columns == 1:
            return cast(Figure, canvas.axes.figure), [canvas.axes]
        raise ConfigurationError("plot: ax: got axes for a figure of several panels, expected None")
    if canvas.width_mm is not None:
        inches = canvas.width_mm / MM_PER_INCH
        abreast = max(1, min(columns, int(inches / PANEL_INCH)))
        height *= min(1.0, inches / (abreast * width)) ** 0.25
        width = inches / abreast
    bands = -(-columns // abreast)
    size = abreast * width, rows * bands * height
    chart = Chart(figsize=size, layout="constrained")
    grid = chart.subplots(rows * bands, abreast, squeeze=False, sharex="all" if share_x else "none")
    places = [(row, column) for row in range(rows) for column in range(columns)][:count]
    axes = [grid[column // abreast * rows + row, column % abreast] for row, column in places]
    for spare in {*grid.flat} - {*axes}:
        spare.remove()
    for panel in axes[(rows - 1) * columns :]:  # the lowest of each column
        panel.tick_params(labelbottom=True)
    return chart, axes


def titled(chart: Figure, axes: Sequence[Axes], title: str, notes: Sequence[str] = ()) -> Figure:
    """Return a figure with its title and one legend, each label once, above, and notes below."""
    canvas, handles = _CANVAS.get(), dict[str, Artist]()
    for panel in axes:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            handles.setdefault(label, handle)
    if canvas.axes is not None:
        canvas.axes.set_title(title, loc="left")
        if handles:
            canvas.axes.legend([*handles.values()], [*handles])
        canvas.axes.set_xlabel("\n".join([canvas.axes.get_xlabel(), *notes]))
        return chart
    size = TITLE_SIZE if canvas.width_mm is None else TEXT_POINTS
    letters = TITLE_LETTERS_PER_INCH * TITLE_SIZE / size
    width = chart.get_figwidth()
    title = "\n".join(wrap(title, int(width * letters)))
    if handles:
        longest = max(len(label) for label in handles) + 6
        chart.legend(  # has the title, since constrained layout lets a separate one overlap
            [*handles.values()], [*handles], loc="outside upper left", alignment="left",
            ncols=max(1, min(len(handles), int(width * LETTERS_PER_INCH / longest))), title=title,
            title_fontproperties={"weight": "bold", "size": TITLE_SIZE}, borderpad=0.0,
        )  # fmt: skip
    else:
        chart.suptitle(title, x=0.01, ha="left", fontsize=TITLE_SIZE, fontweight="bold")
    lines = [line for note in notes for line in wrap(note, int(width * LETTERS_PER_INCH * 1.05))]
    if lines:
        chart.supxlabel("\n".join(lines), x=0.01, ha="left", fontsize=8, color=MUTED)
    return chart


def drawing_of(
    name: str, chart: Figure, axes: Sequence[Axes], title: str, notes: Sequence[str] = ()
) -> Drawing:
    """Return a figure with its title, its legend and its notes; `name` is that of its files."""
    return Drawing(name, titled(chart, axes, title, notes))


def width_of(text: str) -> float:
    """Return the width [mm] of `column`, `page` or a number; raises ConfigurationError else."""
    with suppress(ValueError):
        if NARROWEST_MM <= (width := float(WIDTHS_MM.get(text, text))) <= WIDEST_MM:
            return width
    expected = f"expected column, page or {NARROWEST_MM:g} to {WIDEST_MM:g} mm"
    raise ConfigurationError(f"--width: got {text!r}, {expected}")


def fit(chart: Figure) -> None:
    """Give all texts one size, and heighten a figure until its labels leave room for its panels."""
    for text in chart.findobj(Text):
        text.set(fontsize=TEXT_POINTS)
    while (height := chart.get_figheight()) <= HIGHEST_INCH:
        with warnings.catch_warnings(), suppress(UserWarning):
            warnings.filterwarnings("error", "constrained_layout not applied")
            chart.draw_without_rendering()
            if all(
                height * axes.get_position(original=True).height
                >= max(LOWEST_INCH, LETTER_INCH * len(axes.get_ylabel()))
                for axes in chart.axes
            ):
                return
        chart.set_figheight(1.2 * height)


class Curve(NamedTuple):
    """A line over time: `t` [s] and `values`, shape (n,), with a text at the right of the panel."""

    t: Sample
    values: Sample
    colour: str
    label: str = ""
    text: str = ""


def over_time(
    axes: Axes, label: str, curves: Sequence[Curve], room: tuple[float, float] = (-np.inf, np.inf),
    **look: Any,
) -> None:  # fmt: skip
    """Draw curves over time in a panel with their texts at its right, in their colours.

    `label` is that of the axis, whose limits stay within `room` and are then final.
    """
    for curve in curves:
        axes.plot(curve.t, curve.values, color=curve.colour, label=curve.label or None, **look)
    axes.set_ylabel(label)
    axes.margins(x=0)
    axes.set_ylim(*np.clip(axes.get_ylim(), *room).tolist())
    place, alone = axes.get_subplotspec(), len(axes.get_shared_x_axes().get_siblings(axes)) == 1
    if alone or place is None or place.is_last_row():
        axes.set_xlabel("Time [s]")
    for line, curve in enumerate(curve for curve in curves if curve.text):
        height, look = 0.9 - TEXT_SHARE * line, {"fontsize": 8.5, "va": "center"}
        axes.text(1.005, height, curve.text, transform=axes.transAxes, color=curve.colour, **look)


def intervals(chosen: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the intervals of consecutive chosen samples: their first one and that after them."""
    return np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]]))).reshape(-1, 2)


def shaded(axes: Axes, columns: Mapping[str, Sample]) -> None:
    """Shade the training samples of a series: columns `t` [s] and, if any, `train` (0 or 1)."""
    t = columns["t"]
    for first, end in intervals(np.asarray(columns.get("train", t[:0])) > 0):
        axes.axvspan(t[first], t[end - 1], color=SHADE, linewidth=0, zorder=0)


def colour_of(i: int) -> str:
    """Return the colour of group i."""
    return PALETTE[i % len(PALETTE)]


def marker_of(i: int) -> str:
    """Return the marker of group i; with its colour there are 196 distinct pairs."""
    return MARKERS[(i + i // len(PALETTE)) % len(MARKERS)]


def prefixed(unit: str, largest: float) -> tuple[str, float]:
    """Return the unit that suits a largest value, and its size: `kN`, 1000.0 from 10 kN on."""
    if unit in PREFIXED:
        for letter, size, least in PREFIXES:
            if largest >= least:
                return letter + unit, size
    return unit, 1.0


def largest_of(signals: Sequence[Sample]) -> float:
    """Return the largest absolute value of signals, without NaN; 0 if there is none."""
    finite = (np.abs(signal[np.isfinite(signal)]) for signal in signals)
    return max((float(np.max(values, initial=0.0)) for values in finite), default=0.0)


def draw_limits(axes: Axes, limits: tuple[float, float] | None, peak: float) -> None:
    """Draw the limits of a signal, if they are not far above its peak; all in the axis's unit."""
    if limits is not None and max(map(abs, limits)) <= SHOWN_LIMIT * peak:
        for side in limits:
            axes.axhline(side, color=REFERENCE, linestyle="-.", linewidth=0.9, label="limit")
