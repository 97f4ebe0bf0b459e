"""The scaling figures of docs/speed.md: `python -m docs.growth`, after `make bench`.

They show every curve that `growth` of `tests/benchmarks/conftest.py` wrote to `results/bench.json`:
time over problem size on logarithmic axes, with the slope of a straight line through the points,
and peak memory if it was measured. `docs/growth.svg` has one column, for a narrow screen,
`docs/growth-wide.svg` has two.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from docs.benchmarks import BENCH, read
from seatrial.runner.compare.plots import style

FOLDER = Path(__file__).parent
PANEL = (4.2, 2.5)  # [inch], without the legend
LEGEND_LINE = 0.17  # [inch]
QUANTITIES = {"seconds": "time [s]", "megabytes": "peak memory [MB]"}
LEGENDS = {"seconds": "slope", "megabytes": "MB at the largest size"}
Curve = dict[str, Any]


@dataclass(frozen=True)
class Panel:
    """The curves of one benchmark: `seconds` or `megabytes` over problem size."""

    title: str
    quantity: str
    curves: dict[str, Curve]


def panels(rows: list[dict[str, Any]]) -> list[Panel]:
    """The panels of all benchmarks that have curves, in the order of the benchmarks."""
    found = []
    for row in rows:
        curves = {name: one for name, one in row.get("found", {}).items() if one.get("sizes")}
        for quantity in QUANTITIES:
            kept = {name: one for name, one in curves.items() if one.get(quantity)}
            if kept:
                found.append(Panel(row["what"], quantity, kept))
    return found


def draw(axes: Axes, panel: Panel) -> None:
    """Draw the points of every curve and the straight line through them."""
    for i, (name, one) in enumerate(panel.curves.items()):
        sizes, values = one["sizes"], one[panel.quantity]
        colour = style.PALETTE[i % len(style.PALETTE)]
        line, label = values, f"{name}: {values[-1]:,.0f}"
        if panel.quantity == "seconds":
            apart = np.log(sizes) - np.mean(np.log(sizes))  # the line goes through the mean
            line = np.exp(np.mean(np.log(values)) + one["slope"] * apart)
            label = f"{name}: {one['slope']:.2f}"
        axes.plot(sizes, line, color=colour, linewidth=1.0)
        axes.plot(sizes, values, style.marker_of(i), color=colour, markersize=4, label=label)
    axes.set_xscale("log")
    axes.set_yscale("log")
    every = sorted({size for one in panel.curves.values() for size in one["sizes"]})
    if not all(np.log10(size).is_integer() for size in every):
        axes.set_xticks(every, [f"{size:,}" for size in every])
        axes.set_xticks([], minor=True)
    axes.set_title(panel.title, loc="left")
    axes.set_xlabel(next(iter(panel.curves.values())).get("of") or "size")
    axes.set_ylabel(QUANTITIES[panel.quantity])
    if panel.quantity == "megabytes":
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}"))
        axes.yaxis.set_minor_locator(NullLocator())
    axes.legend(
        loc="upper left", bbox_to_anchor=(-0.2, -0.24), ncols=columns_of(panel),
        title=LEGENDS[panel.quantity], borderaxespad=0.0, alignment="left", handletextpad=0.2,
        columnspacing=1.0, title_fontsize=9,
    )  # fmt: skip


def columns_of(panel: Panel) -> int:
    """Number of columns of the legend: two if they fit side by side."""
    longest = max(len(name) for name in panel.curves) + len(": 1.00") + 5
    return 2 if 2 * longest <= PANEL[0] * style.LETTERS_PER_INCH else 1


def drawing(name: str, found: list[Panel], columns: int) -> style.Drawing:
    """A drawing of all panels; the height of a row depends on its longest legend."""
    groups = [found[i : i + columns] for i in range(0, len(found), columns)]
    lines = [max(-(-len(one.curves) // columns_of(one)) + 1 for one in group) for group in groups]
    heights = [PANEL[1] + LEGEND_LINE * count for count in lines]
    made = style.figure(columns * PANEL[0], sum(heights))
    grid = made.subplots(len(groups), columns, squeeze=False, height_ratios=heights)
    for group, row in zip(groups, grid, strict=True):
        for one, axes in zip(group, row, strict=False):
            draw(axes, one)
        for axes in row[len(group) :]:
            axes.set_axis_off()
    return style.Drawing(name, made)


def main() -> None:
    """Draw docs/growth.svg and docs/growth-wide.svg."""
    file = Path(sys.argv[1]) if len(sys.argv) > 1 else BENCH
    found = panels(read(file)[0])
    if not found:
        sys.exit(f"{file}: contains no curves")
    with style.drawn():
        for name, columns in (("growth", 1), ("growth-wide", 2)):
            made = drawing(name, found, columns)
            made.figure.savefig(FOLDER / f"{name}.svg", metadata={"Date": None})


if __name__ == "__main__":
    main()
