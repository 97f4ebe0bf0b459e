"""The page that compares printed figures with our results, by experiment."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from seatrial.runner.compare.figures import drawings_of
from seatrial.runner.compare.formats import html_table
from seatrial.runner.compare.grid import Cell, Grid, Scalar, number_text, with_unit
from seatrial.runner.compare.page import Picture, picture, render_page, write_page
from seatrial.runner.compare.plots.request import PlotRequest
from seatrial.runner.compare.plots.style import MUTED, REFERENCE, drawn, figure, footnote, headed
from seatrial.runner.compare.printed_figures import BY_CONSTRUCTION, CALIBRATED
from seatrial.runner.compare.published import Judged, by_table, newest_sweep
from seatrial.runner.compare.published_summary import summary_grids
from seatrial.runner.compare.results import Results
from seatrial.runner.invocation import trial_program

HEADERS = (
    *("row", "quantity", "way", "printed", "reference", "ours", "ratio", "verdict", "reason"),
)


def title_of(judged: Sequence[Judged]) -> str:
    """Return `Jervan (2020), Table 4.10, p. 52 (jervan_table_4_10)`."""
    figure = judged[0].printed
    page = f", p. {figure.page}" if figure.page else ""
    return f"{figure.document}, {figure.table}{page} ({figure.experiment})"


def published_grid(judged: Sequence[Judged]) -> Grid:
    """Return the grid of one printed table; figures that cannot be reproduced share one row."""
    lost = [comparison for comparison in judged if comparison.verdict == "not reproducible"]
    rows = [_row(comparison) for comparison in judged if comparison.verdict != "not reproducible"]
    rows += [_lost(lost)] if lost else []
    return Grid(
        title_of(judged), HEADERS, rows, 3, (), [_record(comparison) for comparison in judged]
    )


def _lost(lost: Sequence[Judged]) -> list[Cell]:
    """Return one line for the figures of a table that cannot be reproduced."""
    number = "1 figure" if len(lost) == 1 else f"{len(lost)} figures"
    blank = [Cell("–")] * 4
    reasons = "; ".join(dict.fromkeys(comparison.reason for comparison in lost))
    named = lost[0].printed if len(lost) == 1 else None
    head = [Cell(named.row), Cell(named.quantity)] if named else [Cell(number), Cell("")]
    return [*head, Cell(""), *blank, Cell("not reproducible"), Cell(reasons, prose=True)]


def _row(comparison: Judged) -> list[Cell]:
    printed = comparison.printed
    return [
        Cell(printed.row),
        Cell(with_unit(printed.quantity, printed.unit)),
        Cell(printed.way),
        Cell(printed.digits or _plain(printed.printed), sort=printed.printed),
        Cell(_plain(printed.reference), sort=printed.reference),
        Cell(
            ours_text(comparison), sort=None if math.isnan(comparison.value) else comparison.value
        ),
        Cell("–")
        if math.isnan(comparison.ratio)
        else Cell(number_text(comparison.ratio, 3), sort=comparison.ratio),
        Cell(comparison.verdict, bold=comparison.verdict == "beaten"),
        Cell(reason_text(comparison), prose=True),
    ]


def _plain(value: float | None) -> str:
    return "–" if value is None else f"{value:.10g}"


def ours_text(comparison: Judged) -> str:
    """Return our value as `0.0071 [0.0069, 0.0073] (n=20)`."""
    if math.isnan(comparison.value):
        return "–"
    text = ("median " if comparison.printed.statistic == "median" else "") + number_text(
        comparison.value
    )
    n = f"n={comparison.n}"
    if math.isnan(comparison.low):
        n += ", no interval"
    elif comparison.high - comparison.low > 1e-9 * abs(comparison.value):
        text += f" [{number_text(comparison.low)}, {number_text(comparison.high)}]"
    return f"{text} ({n}{f', {comparison.lost} without' if comparison.lost else ''})"


def reason_text(comparison: Judged) -> str:
    """Return the additional information that our method uses, and the note."""
    known = [item for item in comparison.printed.known if item not in (CALIBRATED, BY_CONSTRUCTION)]
    items = [f"additional information: {'; '.join(known)}"] if known else []
    return "; ".join([*items, *([comparison.reason] if comparison.reason else [])])


def _record(comparison: Judged) -> Mapping[str, Scalar]:
    printed = comparison.printed
    return {
        "experiment": printed.experiment,
        "document": printed.document,
        "table": printed.table,
        "page": printed.page,
        "row": printed.row,
        "quantity": printed.quantity,
        "way": printed.way,
        "unit": printed.unit,
        "printed": printed.printed,
        "reference": printed.reference,
        "ours": comparison.value,
        "low": comparison.low,
        "high": comparison.high,
        "n": comparison.n,
        "without": comparison.lost,
        "ratio": comparison.ratio,
        "verdict": comparison.verdict,
        "information": printed.information,
        "reason": comparison.reason,
    }


EXPERIMENTS = Path(__file__).parents[2] / "conf" / "experiment"
COLOURS = {
    "beaten": "#009E73",
    "reproduced": "#0072B2",
    "not reproduced": "#D55E00",
    "below the true model": "#CC79A7",
}
ROW_INCH = 0.24  # height of a line of the figure [inch]
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
    """Write the page; raises LogbookError if the file cannot be written.

    `tables` are the judged figures of each experiment.
    """
    with drawn():
        chapters = [_chapter(results, judged) for judged in tables]
    page = render_page(
        "published.html",
        title="Published figures, and ours",
        database=str(results.reader.address),
        summary=Markup("").join(html_table(grid) for grid in summary_grids(tables)),
        chapters=chapters,
        program=trial_program(),
    )
    write_page(page, file)


def _chapter(results: Results, judged: Sequence[Judged]) -> Chapter:
    name, tables = judged[0].printed.experiment, by_table(judged)
    charts = [(rows, ratios(rows)) for rows in tables]
    pictures = [
        picture(drawing, f"{rows[0].printed.table}: ours over printed", f"{name}-{i}-")
        for i, (rows, drawing) in enumerate(charts)
        if drawing is not None
    ]
    pictures += _figures(results, name)
    return Chapter(
        name, about(name), [html_table(published_grid(rows)) for rows in tables], pictures
    )


def _figures(results: Results, experiment: str) -> list[Picture]:
    """Draw the figures of the source from the experiment's runs; empty without runs."""
    sweep = newest_sweep(results, experiment)
    pictures = []
    for kind in FIGURES.get(experiment, ()) if sweep is not None else ():
        drawings = drawings_of(kind)
        request = PlotRequest(sweep=str(sweep))
        for i, drawing in enumerate(drawings(results, request)):
            pictures.append(picture(drawing.figure, kind, f"{experiment}-{kind}-{i}-"))
    return pictures


def about(experiment: str) -> str:
    """Return the comment at the head of an experiment's file; empty without a file."""
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
    """Plot our values over the printed ones with their intervals; None without a ratio.

    Estimates that are compared with the truth are omitted: if the printed estimate is wrong, a
    ratio of 1 is not the aim. So are eigenvalues, which are judged by their distance to 1.
    """
    compared = [row for row in judged if row.printed.compare not in ("truth", "one")]
    shown = [
        comparison
        for comparison in compared
        if math.isfinite(comparison.ratio) and comparison.ratio > 0.0
    ][:MOST_ROWS]
    if not shown:
        return None
    chart = figure(7.0, 1.3 + ROW_INCH * len(shown))
    axes = chart.subplots()
    axes.set_xscale("log")
    axes.axvline(1.0, color=REFERENCE, linewidth=1.0, label="printed")
    for verdict in dict.fromkeys(comparison.verdict for comparison in shown):
        _points(axes, shown, verdict)
    labels = [_label(comparison) for comparison in shown]
    axes.set_yticks(range(len(shown)), labels)
    axes.set_ylim(len(shown) - 0.5, -0.5)
    low, high = axes.get_xlim()
    axes.set_xlim(min(low, 0.5), max(high, 2.0))
    axes.set_xlabel("ours / printed")
    headed(chart, [axes], judged[0].printed.table)
    footnote(chart, ["bars: 95 % interval over several runs"])
    return chart


def _label(comparison: Judged) -> str:
    printed = comparison.printed
    return ", ".join(text for text in (printed.row, printed.way, printed.quantity) if text)


def _points(axes: Axes, shown: Sequence[Judged], verdict: str) -> None:
    rows = [(i, comparison) for i, comparison in enumerate(shown) if comparison.verdict == verdict]
    colour = COLOURS.get(verdict, MUTED)
    axes.plot(
        [comparison.ratio for _, comparison in rows],
        [i for i, _ in rows],
        "o",
        color=colour,
        label=verdict,
    )
    for i, comparison in rows:
        printed = comparison.printed.printed or math.nan
        ends = sorted((comparison.low / printed, comparison.high / printed))  # NaN: one run
        if ends[0] > 0.0:
            axes.plot(ends, [i, i], color=colour)
