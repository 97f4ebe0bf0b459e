"""Tables of printed figures beside ours, and the summary of their verdicts."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence

from .grid import Cell, Grid, Scalar, number_text, with_unit
from .published import TOLERANCE, Judged, by_table

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
