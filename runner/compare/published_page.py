"""The page of printed figures beside ours: summary, a table and a figure for each experiment."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from seatrial.runner.compare.formats import html_table
from seatrial.runner.compare.grid import Cell, Grid, Scalar, number_text, with_unit
from seatrial.runner.compare.page import Picture, picture, render_page, write_page
from seatrial.runner.compare.plots.request import PlotRequest
from seatrial.runner.compare.plots.style import MUTED, REFERENCE, drawn, figure, footnote, headed
from seatrial.runner.compare.published import TOLERANCE, Judged, by_table, runs_of
from seatrial.runner.compare.results import Results
from seatrial.runner.invocation import trial_program

# Tables of printed figures beside ours, and the summary of their verdicts.


CALIBRATED = "reproduced (calibrated)"  # agreement that was put in, no evidence
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
    """`Jervan (2020), Table 4.10, p. 52 (jervan_table_4_10)`."""
    one = judged[0].printed
    page = f", p. {one.page}" if one.page else ""
    return f"{one.document}, {one.table}{page} ({one.experiment})"


def published_grid(judged: Sequence[Judged], notes: Sequence[str] = ()) -> Grid:
    """The figures of one printed table, a row each."""
    rows = [_row(one) for one in judged]
    return Grid(title_of(judged), HEADERS, rows, 3, notes, [_record(one) for one in judged])


def _row(one: Judged) -> list[Cell]:
    printed = one.printed
    return [
        Cell(printed.row),
        Cell(with_unit(printed.quantity, printed.unit)),
        Cell(printed.way),
        _printed(printed.printed),
        Cell(ours_text(one), sort=None if math.isnan(one.value) else one.value),
        Cell("–") if math.isnan(one.ratio) else Cell(number_text(one.ratio, 3), sort=one.ratio),
        Cell(verdict_text(one), bold=one.verdict == "beaten"),
        Cell(reason_text(one), prose=True),
    ]


def verdict_text(one: Judged) -> str:
    """The verdict; apart where the inputs were fitted to the printed figures."""
    calibrated = one.printed.information == "calibrated" and one.verdict == "reproduced"
    return CALIBRATED if calibrated else one.verdict


def _printed(value: float | None) -> Cell:
    """A printed figure with the digits it was printed with."""
    return Cell("–") if value is None else Cell(f"{value:.10g}", sort=value)


def ours_text(one: Judged) -> str:
    """`0.0071 [0.0069, 0.0073] (n=20)`."""
    if math.isnan(one.value):
        return "–"
    text = ("median " if one.printed.statistic == "median" else "") + number_text(one.value)
    if one.high - one.low > 1e-9 * abs(one.value):
        text += f" [{number_text(one.low)}, {number_text(one.high)}]"
    lost = f", {one.lost} without" if one.lost else ""
    return f"{text} (n={one.n}{lost})"


def reason_text(one: Judged) -> str:
    """What ours knows that the source did not, and the note."""
    information = one.printed.information
    known = f"knows more: {information}" if information not in ("", "calibrated") else information
    return "; ".join(text for text in (known, one.reason) if text)


def _record(one: Judged) -> Mapping[str, Scalar]:
    printed = one.printed
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
        "ours": one.value,
        "low": one.low,
        "high": one.high,
        "n": one.n,
        "without": one.lost,
        "ratio": one.ratio,
        "verdict": one.verdict,
        "information": printed.information,
        "reason": one.reason,
    }


def summary_grid(tables: Sequence[Sequence[Judged]]) -> Grid:
    """How many figures of each table have which verdict."""
    tables = [one for judged in tables for one in by_table(judged)]
    counts = [Counter(map(verdict_text, judged)) for judged in tables]
    shown = [verdict for verdict in VERDICTS if any(verdict in count for count in counts)]
    rows, records = [], []
    for judged, count in zip(tables, counts, strict=True):
        one = judged[0].printed
        facts: dict[str, Scalar] = {"source": one.document, "table": one.table}
        facts |= {"experiment": one.experiment}
        facts |= {verdict: count[verdict] for verdict in shown}
        records.append(facts)
        cells = [Cell(one.document), Cell(one.table), Cell(one.experiment)]
        rows.append([*cells, *(_count(count[verdict]) for verdict in shown)])
    total = sum(counts, Counter())
    rows.append([Cell("all"), Cell(""), Cell(""), *(_count(total[name]) for name in shown)])
    headers = ["source", "table", "experiment", *shown]
    return Grid("Printed figures and ours", headers, rows, 3, [NOTE], records)


def _count(number: int) -> Cell:
    return Cell(str(number) if number else "", sort=float(number))


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
        program=trial_program(),
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
