"""The page that compares printed figures with our results, by experiment."""

import math
from collections import Counter
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
from seatrial.runner.compare.published import TOLERANCE, Judged, by_table, runs_of
from seatrial.runner.compare.results import Results
from seatrial.runner.invocation import trial_program

CALIBRATED = "reproduced (calibrated)"  # inputs were fitted to the printed figures: no evidence
VERDICTS = (
    *("beaten", "reproduced", CALIBRATED, "not reproduced"),
    *("not reproducible", "no runs", "ours"),
)
HEADERS = ("row", "quantity", "way", "printed", "ours", "ratio", "verdict", "reason")
NOTE = (
    "ours: mean over runs [95 % interval, t] (number of runs); beaten: the whole interval is better"
    f" than printed by more than {100.0 * TOLERANCE:.0f} %, or of an estimate its worst end is"
    " nearer to the truth; reproduced: the printed figure is in the interval or within"
    f" {100.0 * TOLERANCE:.0f} %"
)


def title_of(judged: Sequence[Judged]) -> str:
    """Return `Jervan (2020), Table 4.10, p. 52 (jervan_table_4_10)`."""
    figure = judged[0].printed
    page = f", p. {figure.page}" if figure.page else ""
    return f"{figure.document}, {figure.table}{page} ({figure.experiment})"


def published_grid(judged: Sequence[Judged], notes: Sequence[str] = ()) -> Grid:
    """Return the grid of one printed table, one row for each figure.

    `judged` are the figures of the table, `notes` stand under it.
    """
    rows = [_row(comparison) for comparison in judged]
    return Grid(
        title_of(judged), HEADERS, rows, 3, notes, [_record(comparison) for comparison in judged]
    )


def _row(comparison: Judged) -> list[Cell]:
    printed = comparison.printed
    return [
        Cell(printed.row),
        Cell(with_unit(printed.quantity, printed.unit)),
        Cell(printed.way),
        _printed(printed.printed),
        Cell(
            ours_text(comparison), sort=None if math.isnan(comparison.value) else comparison.value
        ),
        Cell("–")
        if math.isnan(comparison.ratio)
        else Cell(number_text(comparison.ratio, 3), sort=comparison.ratio),
        Cell(verdict_text(comparison), bold=comparison.verdict == "beaten"),
        Cell(reason_text(comparison), prose=True),
    ]


def verdict_text(comparison: Judged) -> str:
    """Return the verdict, marked if the inputs were fitted to the printed figures."""
    calibrated = (
        comparison.printed.information == "calibrated" and comparison.verdict == "reproduced"
    )
    return CALIBRATED if calibrated else comparison.verdict


def _printed(value: float | None) -> Cell:
    """Return the cell of a printed figure, with the printed digits."""
    return Cell("–") if value is None else Cell(f"{value:.10g}", sort=value)


def ours_text(comparison: Judged) -> str:
    """Return our value as `0.0071 [0.0069, 0.0073] (n=20)`."""
    if math.isnan(comparison.value):
        return "–"
    text = ("median " if comparison.printed.statistic == "median" else "") + number_text(
        comparison.value
    )
    if comparison.high - comparison.low > 1e-9 * abs(comparison.value):
        text += f" [{number_text(comparison.low)}, {number_text(comparison.high)}]"
    lost = f", {comparison.lost} without" if comparison.lost else ""
    return f"{text} (n={comparison.n}{lost})"


def reason_text(comparison: Judged) -> str:
    """Return the additional information that our method uses, and the note."""
    information = comparison.printed.information
    information_text = (
        f"additional information: {information}"
        if information not in ("", "calibrated")
        else information
    )
    return "; ".join(text for text in (information_text, comparison.reason) if text)


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


def summary_grid(tables: Sequence[Sequence[Judged]]) -> Grid:
    """Count the verdicts of each table."""
    tables = [source for judged in tables for source in by_table(judged)]
    counts = [Counter(map(verdict_text, judged)) for judged in tables]
    shown = [verdict for verdict in VERDICTS if any(verdict in count for count in counts)]
    rows, records = [], []
    for judged, count in zip(tables, counts, strict=True):
        source = judged[0].printed
        record: dict[str, Scalar] = {"source": source.document, "table": source.table}
        record |= {"experiment": source.experiment}
        record |= {verdict: count[verdict] for verdict in shown}
        records.append(record)
        cells = [Cell(source.document), Cell(source.table), Cell(source.experiment)]
        rows.append([*cells, *(_count(count[verdict]) for verdict in shown)])
    total = sum(counts, Counter())
    rows.append([Cell("all"), Cell(""), Cell(""), *(_count(total[name]) for name in shown)])
    headers = ["source", "table", "experiment", *shown]
    return Grid("Printed figures and ours", headers, rows, 3, [NOTE], records)


def _count(number: int) -> Cell:
    return Cell(str(number) if number else "", sort=float(number))


EXPERIMENTS = Path(__file__).parents[2] / "conf" / "experiment"
COLOURS = {"beaten": "#009E73", "reproduced": "#0072B2", "not reproduced": "#D55E00"}
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
        summary=html_table(summary_grid(tables)),
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
    ids = runs_of(results, experiment)
    pictures = []
    for kind in FIGURES.get(experiment, ()) if ids else ():
        drawings = drawings_of(kind)
        request = PlotRequest(where=f"id in ({', '.join(map(str, ids))})")
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
    ratio of 1 is not the aim.
    """
    compared = [comparison for comparison in judged if comparison.printed.compare != "truth"]
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
        ends = sorted((comparison.low / printed, comparison.high / printed))
        if ends[0] > 0.0:
            axes.plot(ends, [i, i], color=colour)
