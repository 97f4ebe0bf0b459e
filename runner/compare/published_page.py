"""The page of printed figures beside ours: summary, a table and a figure for each experiment."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from .formats import html_table
from .page import Picture, picture, render_page, write_page
from .plots.request import PlotRequest
from .plots.style import MUTED, REFERENCE, drawn, figure, footnote, headed
from .published import Judged, by_table, runs_of
from .published_tables import published_grid, summary_grid
from .results import Results

EXPERIMENTS = Path(__file__).parents[2] / "conf" / "experiment"
COLOURS = {"beaten": "#009E73", "reproduced": "#0072B2", "not reproduced": "#D55E00"}
ROW_INCH = 0.24  # height of a line of the figure
MOST_ROWS = 60
FIGURES = {"hoyer_figure_7_20": ("topology",), "hoyer_figure_7_21": ("times",)}  # kinds of plots


@dataclass(frozen=True)
class Chapter:
    """One experiment on the page."""

    name: str
    about: str
    tables: Sequence[Markup]
    pictures: Sequence[Picture]


def write_published(results: Results, tables: Sequence[Sequence[Judged]], file: Path) -> None:
    """Write the page; LogbookError where the file cannot be written."""
    with drawn():
        chapters = [_chapter(results, judged) for judged in tables]
    page = render_page(
        "published.html",
        title="Published figures, and ours",
        database=str(results.reader.address),
        summary=html_table(summary_grid(tables)),
        chapters=chapters,
    )
    write_page(page, file)


def _chapter(results: Results, judged: Sequence[Judged]) -> Chapter:
    name, tables = judged[0].printed.experiment, by_table(judged)
    drawn_ones = [(one, ratios(one)) for one in tables]
    pictures = [
        picture(drawing, f"{one[0].printed.table}: ours over printed", f"{name}-{i}-")
        for i, (one, drawing) in enumerate(drawn_ones)
        if drawing is not None
    ]
    pictures += _figures(results, name)
    return Chapter(name, about(name), [html_table(published_grid(one)) for one in tables], pictures)


def _figures(results: Results, experiment: str) -> list[Picture]:
    """The figures of the source drawn again from the experiment's runs; none before they ran."""
    ids = runs_of(results, experiment)
    made = []
    for kind in FIGURES.get(experiment, ()) if ids else ():
        drawings = import_module(f"{__package__}.plots.{kind}").drawings
        request = PlotRequest(where=f"id in ({', '.join(map(str, ids))})")
        for i, drawing in enumerate(drawings(results, request)):
            made.append(picture(drawing.figure, kind, f"{experiment}-{kind}-{i}-"))
    return made


def about(experiment: str) -> str:
    """The comment at the head of an experiment's file; nothing where there is no such file."""
    file = EXPERIMENTS / f"{experiment}.yaml"
    if not file.exists():
        return ""
    lines = []
    for line in file.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            break
        if "@package" not in line:
            lines.append(line.removeprefix("#").strip())
    return " ".join(lines)


def ratios(judged: Sequence[Judged]) -> Figure | None:
    """Ours over the printed figure with its interval, a line each; None where there is nothing.

    Without estimates that the truth judges: beside a printed one that is wrong, 1 is not the aim.
    """
    compared = [one for one in judged if one.printed.compare != "truth"]
    shown = [one for one in compared if math.isfinite(one.ratio) and one.ratio > 0.0][:MOST_ROWS]
    if not shown:
        return None
    made = figure(7.0, 1.3 + ROW_INCH * len(shown))
    axes = made.subplots()
    axes.set_xscale("log")
    axes.axvline(1.0, color=REFERENCE, linewidth=1.0, label="printed")
    for verdict in dict.fromkeys(one.verdict for one in shown):
        _points(axes, shown, verdict)
    labels = [_label(one) for one in shown]
    axes.set_yticks(range(len(shown)), labels)
    axes.set_ylim(len(shown) - 0.5, -0.5)
    low, high = axes.get_xlim()
    axes.set_xlim(min(low, 0.5), max(high, 2.0))
    axes.set_xlabel("ours / printed")
    headed(made, [axes], judged[0].printed.table)
    footnote(made, ["bars: 95 % interval over runs, where there are several"])
    return made


def _label(one: Judged) -> str:
    printed = one.printed
    return ", ".join(text for text in (printed.row, printed.way, printed.quantity) if text)


def _points(axes: Axes, shown: Sequence[Judged], verdict: str) -> None:
    rows = [(i, one) for i, one in enumerate(shown) if one.verdict == verdict]
    colour = COLOURS.get(verdict, MUTED)
    axes.plot(
        [one.ratio for _, one in rows], [i for i, _ in rows], "o", color=colour, label=verdict
    )
    for i, one in rows:
        printed = one.printed.printed or math.nan
        ends = sorted((one.low / printed, one.high / printed))
        if ends[0] > 0.0:
            axes.plot(ends, [i, i], color=colour)
