"""Printed figures and ours as tables, their summary, and the page with all of them."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from docs.published.figures import FIGURES
from docs.published.printed import (
    BY_CONSTRUCTION,
    CALIBRATED,
    TOLERANCE,
    Judged,
    Verdict,
    by_table,
    command_of,
    file_of,
    newest_sweep,
)
from seatrial.runner.compare.frame import Queries
from seatrial.runner.compare.grid import Scalar, TableCell, TextTable, number_text, with_unit
from seatrial.runner.compare.page import (
    Section,
    code,
    html_table,
    page,
    paragraph,
    picture,
    write_page,
)
from seatrial.runner.compare.plots.style import MUTED, REFERENCE, drawn, panels, titled
from seatrial.runner.configuration.search_path import CONF

HEADERS = (
    *("row", "quantity", "way", "printed", "reference", "ours", "ratio", "verdict", "reason"),
)
COLOUR_OF = {
    "beaten": "#009E73",
    "reproduced": "#0072B2",
    "not reproduced": "#D55E00",
    "below the true model": "#CC79A7",
}
COUNTED: tuple[Verdict, ...] = ("beaten", "reproduced", "not reproduced", "below the true model")
APART: tuple[Verdict, ...] = (
    *("calibrated", "by construction", "not reproducible", "no runs", "ours"),
)  # these compare nothing with a printed figure, or cannot fail
MORE = "with more information"  # of our method than the source has: known lag, measured wind
MARK = "+"  # of beaten; bold is the best cell of a comparison, and no cell here
NOTE = (
    "ours: mean over runs [95 % interval of one further run] (number of runs; of one run there is"
    " none);"
    f" reference: a figure that is not printed, shown and not judged; {MARK} beaten: the whole"
    f" interval is better than printed by more than {100.0 * TOLERANCE:.0f} %, or of an estimate"
    " its worst end is nearer to the truth; reproduced: the printed figure is in an interval that"
    f" is not wider than the figure, or within {100.0 * TOLERANCE:.0f} %; eigenvalues by their"
    " distance to 1;"
    " below the true model: better than printed, but also than the exact plant, so it fits"
    " lag or feedback"
)
ONCE = (
    "a printed figure counts once, by the first of our methods that it is compared with and judged"
)
APART_NOTE = "these figures compare nothing with a printed one, or cannot fail"
COMMON = {  # reasons that are the same for every figure with the verdict
    "calibrated": "gains and reference were fitted to the printed figures: see the ratios to our"
    " own nominal",
    "ours": "no printed figure of the same experiment",
}
ROW_INCH = 0.24  # height of a line of the figure [inch]
MOST_ROWS = 60


# Tables.


def published_grid(judged: Sequence[Judged]) -> TextTable:
    """Return the grid of one printed table; figures that cannot be reproduced share one row."""
    first = judged[0].printed
    page = f", p. {first.page}" if first.page else ""
    title = f"{first.document}, {first.table}{page} ({first.experiment})"
    lost = [one for one in judged if one.verdict == "not reproducible"]
    rows = [_row(one) for one in judged if one.verdict != "not reproducible"]
    if lost:
        head = [TableCell(f"{len(lost)} figures"), TableCell("")]
        if len(lost) == 1:
            head = [TableCell(lost[0].printed.row), TableCell(lost[0].printed.quantity)]
        reasons = TableCell("; ".join(dict.fromkeys(one.reason for one in lost)), prose=True)
        rows.append(
            [*head, TableCell(""), *[TableCell("–")] * 4, TableCell("not reproducible"), reasons]
        )
    return TextTable(title, HEADERS, rows, 3, (), [_record(one) for one in judged])


def _row(one: Judged) -> list[TableCell]:
    printed = one.printed
    known = _more(one)
    reasons = [f"additional information: {'; '.join(known)}"] if known else []
    reasons += [one.reason] if one.reason else []
    return [
        TableCell(printed.row),
        TableCell(with_unit(printed.quantity, printed.unit)),
        TableCell(printed.way),
        TableCell(printed.digits or _plain(printed.printed), sort=printed.printed),
        TableCell(_plain(printed.reference), sort=printed.reference),
        TableCell(_ours(one), sort=None if math.isnan(one.value) else one.value),
        TableCell("–")
        if math.isnan(one.ratio)
        else TableCell(number_text(one.ratio, 3), sort=one.ratio),
        TableCell(f"{MARK} {one.verdict}" if one.verdict == "beaten" else one.verdict),
        TableCell("; ".join(reasons), prose=True),
    ]


def _plain(value: float | None) -> str:
    return "–" if value is None else f"{value:.10g}"


def _ours(one: Judged) -> str:
    """Return our value as `0.0071 [0.0069, 0.0073] (n=20)`."""
    if math.isnan(one.value):
        return "–"
    text = "median " if one.printed.statistic == "median" else ""
    text += number_text(one.value)
    n = f"n={one.n}"
    if math.isnan(one.low):
        n += ", no interval"
    elif one.high - one.low > 1e-9 * abs(one.value):
        text += f" [{number_text(one.low)}, {number_text(one.high)}]"
    return f"{text} ({n}{f', {one.lost} without' if one.lost else ''})"


def _record(one: Judged) -> Mapping[str, Scalar]:
    names = (*("experiment", "document", "table", "page", "row", "quantity", "way", "unit"),)
    return {
        **{name: getattr(one.printed, name) for name in (*names, "printed", "reference")},
        "ours": one.value,
        "low": one.low,
        "high": one.high,
        "n": one.n,
        "without": one.lost,
        "ratio": one.ratio,
        "verdict": one.verdict,
        "information": one.printed.information,
        "reason": one.reason,
    }


def summary_grids(tables: Sequence[Sequence[Judged]]) -> list[TextTable]:
    """Count the verdicts of each table that mean something, and list the others with reasons."""
    sources = [source for judged in tables for source in by_table(judged)]
    return [_counted(sources), _apart(sources)]


def _counted(sources: Sequence[Sequence[Judged]]) -> TextTable:
    rows, records, total = [], [], Counter[str]()
    names, seen = (*COUNTED, MORE), set[object]()
    for judged in sources:
        counts = Counter(_column(one) for one in judged if _first_time(one, seen))
        count = {name: counts[name] for name in names}
        if any(count.values()):
            total.update(count)
            records.append(_place(judged) | count)
            rows.append([*_place_cells(judged), *map(_count, count.values())])
    rows.append(
        [TableCell("all"), TableCell(""), TableCell(""), *(_count(total[name]) for name in names)]
    )
    headers = ["source", "table", "experiment", *names]
    notes = [sentence(sources), ONCE, NOTE]
    return TextTable("Printed figures and ours", headers, rows, 3, notes, records)


def _column(one: Judged) -> str:
    return MORE if one.verdict in COUNTED and _more(one) else one.verdict


def _more(one: Judged) -> list[str]:
    """What our method knows beside what the source's does."""
    return [item for item in one.printed.known if item not in (CALIBRATED, BY_CONSTRUCTION)]


def _first_time(one: Judged, seen: set[object]) -> bool:
    """Whether a printed figure is met for the first time among those that are judged."""
    printed = one.printed
    figure = printed.document, printed.row, printed.quantity, printed.digits
    if figure in seen or one.verdict not in COUNTED:
        return False
    seen.add(figure)
    return True


def sentence(sources: Sequence[Sequence[Judged]]) -> str:
    """Say how many printed figures were compared, with what outcome, and what is left out."""
    seen, judged = set[object](), [one for source in sources for one in source]
    counts = Counter(_column(one) for one in judged if _first_time(one, seen))
    apart = Counter(one.verdict for one in judged if one.verdict in APART)
    told = ", ".join(f"{counts[name]} {name}" for name in (*COUNTED, MORE) if counts[name])
    left = ", ".join(f"{number} {name}" for name, number in apart.items() if name != "ours")
    compared = f"{len(seen)} printed figures are compared: {told}" if seen else "no runs to compare"
    return f"{compared}; left out of this: {left or 'none'}"


def _apart(sources: Sequence[Sequence[Judged]]) -> TextTable:
    """Return a line for each table and verdict that is not counted, with its reason."""
    rows, records = [], []
    for judged in sources:
        for verdict in APART:
            reasons = [one.reason for one in judged if one.verdict == verdict]
            if not reasons:
                continue
            reason = COMMON.get(verdict) or Counter(reasons).most_common(1)[0][0]
            found = {"verdict": verdict, "figures": len(reasons), "reason": reason}
            records.append(_place(judged) | found)
            cells = [TableCell(verdict), _count(len(reasons)), TableCell(reason, prose=True)]
            rows.append([*_place_cells(judged), *cells])
    headers = ["source", "table", "experiment", "verdict", "figures", "reason"]
    return TextTable("Figures without a comparison", headers, rows, 4, [APART_NOTE], records)


def _place(judged: Sequence[Judged]) -> dict[str, Scalar]:
    source = judged[0].printed
    return {"source": source.document, "table": source.table, "experiment": source.experiment}


def _place_cells(judged: Sequence[Judged]) -> list[TableCell]:
    return [TableCell(str(text)) for text in _place(judged).values()]


def _count(number: int) -> TableCell:
    return TableCell(str(number) if number else "", sort=float(number))


# The page.


def write_published(results: Queries, tables: Sequence[Sequence[Judged]], file: Path) -> None:
    """Write the page of the judged figures of each experiment.

    Raises:
        LogbookError: the file cannot be written.
    """
    with drawn():
        chapters = [_chapter(results, judged) for judged in tables]
    summary = Section("Summary", "summary", [*map(html_table, summary_grids(tables))])
    lead = [paragraph(f"From {results.reader.address}.", "small")]
    write_page(page("Published figures, and ours", lead, [summary, *chapters]), file)


def _chapter(results: Queries, judged: Sequence[Judged]) -> Section:
    """One experiment: what it is, its command, tables and figures."""
    name, tables = judged[0].printed.experiment, by_table(judged)
    text = about(name)
    blocks = [paragraph(text), code(command_of(name))] if text else []
    blocks += [html_table(published_grid(rows)) for rows in tables]
    blocks += [
        picture(chart, f"{rows[0].printed.table}: ours over printed", f"{name}-{i}-")
        for i, rows in enumerate(tables)
        if (chart := _ratios(rows)) is not None
    ]
    sweep = newest_sweep(results, name)
    if name in FIGURES and sweep is not None:
        caption, draw = FIGURES[name]
        blocks.append(picture(draw(results, sweep), caption, f"{name}-figure-"))
    return Section(name, name, blocks)


def about(experiment: str) -> str:
    """Return the comment at the head of an experiment's file; empty without a file."""
    files = (file_of(experiment), CONF / "experiment" / f"{experiment}.yaml")
    lines = []
    for file in filter(Path.exists, files):
        for line in file.read_text(encoding="utf-8").splitlines()[1:]:  # of `# @package`
            if not line.startswith("#"):
                break
            lines.append(line.removeprefix("#").strip())
    return " ".join(lines)


def _ratios(judged: Sequence[Judged]) -> Figure | None:
    """Plot our values over the printed ones with their intervals; None without a ratio.

    Estimates that are compared with the truth are omitted: if the printed estimate is wrong, a
    ratio of 1 is not the aim. So are eigenvalues, which are judged by their distance to 1.
    """
    compared = [one for one in judged if one.printed.compare not in ("truth", "one")]
    shown = [one for one in compared if math.isfinite(one.ratio) and one.ratio > 0.0][:MOST_ROWS]
    if not shown:
        return None
    chart, (axes,) = panels(1, 1, 7.0, 1.3 + ROW_INCH * len(shown))
    axes.set_xscale("log")
    axes.axvline(1.0, color=REFERENCE, linewidth=1.0, label="printed")
    for verdict in dict.fromkeys(one.verdict for one in shown):
        rows = [(i, one) for i, one in enumerate(shown) if one.verdict == verdict]
        colour = COLOUR_OF.get(verdict, MUTED)
        x, y = [one.ratio for _, one in rows], [i for i, _ in rows]
        axes.plot(x, y, "o", color=colour, label=verdict)
        for i, one in rows:
            printed = one.printed.printed or math.nan
            ends = sorted((one.low / printed, one.high / printed))  # NaN: one run
            if ends[0] > 0.0:
                axes.plot(ends, [i, i], color=colour)
    words = [(one.printed.row, one.printed.way, one.printed.quantity) for one in shown]
    axes.set_yticks(range(len(shown)), [", ".join(filter(None, word)) for word in words])
    axes.set_ylim(len(shown) - 0.5, -0.5)
    low, high = axes.get_xlim()
    axes.set_xlim(min(low, 0.5), max(high, 2.0))
    axes.set_xlabel("ours / printed")
    note = "bars: 95 % interval over several runs"
    return titled(chart, [axes], judged[0].printed.table, [note])
