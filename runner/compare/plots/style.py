"""How every figure looks: palette, fonts, axes with units, and files that are the same each time.

Figures are made without pyplot: no window, no global state, any backend setting is ignored.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from textwrap import wrap
from typing import Any

import matplotlib as mpl
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from seatrial.runner.compare.grid import with_unit
from seatrial.runner.record.catalogue import definition_of
from seatrial.runner.vocabulary import COMBINED

# Okabe and Ito (2008), in an order that keeps neighbours apart; their yellow is too pale for lines.
PALETTE = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#000000")
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
MODEL_COLOURS = {
    **{"nominal": "#D55E00", "identified": "#0072B2", "plant": "#009E73"},
    "recording": "#0072B2",  # stands alone, where there is no deployment
}
REFERENCE = "#000000"
WIND = "#56B4E9"
MUTED = "#595959"
TITLE_LETTERS_PER_INCH = 9.5
LETTERS_PER_INCH = 14  # of the legend's font, with room to spare
SHADE = "#E8E8E8"
RC: dict[Any, Any] = {
    "font.family": "DejaVu Sans",  # comes with matplotlib: the same on every machine
    "font.size": 10,
    "axes.titlesize": 11,
    "axes.titleweight": "bold",
    "axes.labelsize": 10,
    "legend.fontsize": 9,
    "legend.frameon": False,
    "xtick.labelsize": 9,
    "ytick.labelsize": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.4,
    "figure.dpi": 150,
    "savefig.dpi": 150,
    "figure.constrained_layout.h_pad": 0.07,
    "figure.constrained_layout.w_pad": 0.07,
    "svg.hashsalt": "seatrial",
    "svg.fonttype": "path",
    "path.simplify": True,
}


@dataclass(frozen=True)
class Drawing:
    """A figure and the name of its files."""

    name: str
    figure: Figure


def marker_of(i: int) -> str:
    """The marker of group i: with the colour of PALETTE, 49 pairs that differ."""
    return MARKERS[(i + i // len(PALETTE)) % len(MARKERS)]


@contextmanager
def drawn() -> Iterator[None]:
    """Draw and save inside this: the settings above, and matplotlib's defaults for the rest."""
    with mpl.rc_context():
        mpl.rcdefaults()
        for name, value in RC.items():
            mpl.rcParams[name] = value
        yield


def figure(width: float, height: float) -> Figure:
    """An empty figure of the given size [inch] whose parts make room for each other."""
    return Figure(figsize=(width, height), layout="constrained")


def panels(
    rows: int, columns: int, width: float, height: float, share_x: bool = False
) -> tuple[Figure, list[Axes]]:
    """A figure of rows x columns axes, width x height [inch] each, listed row by row."""
    made = figure(columns * width, rows * height)
    axes = made.subplots(rows, columns, squeeze=False, sharex="all" if share_x else "none")
    return made, [one for row in axes for one in row]


def metric_label(name: str, dof: str, unit: str | None) -> str:
    """`Force MSE, surge [N²]`."""
    label = definition_of(name).label
    named = label if dof in COMBINED else f"{label}, {dof}"
    return with_unit(named, unit)


def headed(made: Figure, axes: Sequence[Axes], title: str) -> None:
    """The title and one legend for the whole figure, above it, each label once."""
    found: dict[str, Artist] = {}
    for one in axes:
        for handle, label in zip(*one.get_legend_handles_labels(), strict=True):
            found.setdefault(label, handle)
    title = "\n".join(wrap(title, int(made.get_figwidth() * TITLE_LETTERS_PER_INCH)))
    if not found:
        made.suptitle(title, x=0.01, ha="left", fontsize=11, fontweight="bold")
        return
    longest = max(len(label) for label in found) + 6
    made.legend(  # the title is the legend's: constrained layout lets two things above collide
        handles=list(found.values()),
        labels=list(found),
        loc="outside upper left",
        ncols=max(1, min(len(found), int(made.get_figwidth() * LETTERS_PER_INCH / longest))),
        title=title,
        title_fontproperties={"weight": "bold", "size": 11},
        alignment="left",
        borderpad=0.0,
    )


def footnote(made: Figure, notes: Sequence[str]) -> None:
    """Small text under the figure, each note wrapped to its width."""
    width = int(made.get_figwidth() * LETTERS_PER_INCH * 1.05)
    lines = [line for note in notes for line in wrap(note, width)]
    if lines:
        made.supxlabel("\n".join(lines), x=0.01, ha="left", fontsize=8, color=MUTED)


def save(drawing: Drawing, folder: Path) -> list[Path]:
    """Writes NAME.png and NAME.svg; the same figure gives the same SVG to the last byte."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for suffix, metadata in (("png", {"Software": None}), ("svg", {"Date": None})):
        path = folder / f"{drawing.name}.{suffix}"
        drawing.figure.savefig(path, metadata=metadata)
        paths.append(path)
    return paths
