"""The summary of all published figures: verdicts counted by table, and the others with a reason."""

from collections import Counter
from collections.abc import Sequence

from seatrial.runner.compare.grid import Cell, Grid, Scalar
from seatrial.runner.compare.published import Judged, by_table
from seatrial.runner.compare.verdicts import APART, COUNTED, TOLERANCE

NOTE = (
    "ours: mean over runs [95 % interval, t] (number of runs; a single run has no interval);"
    " reference: a figure that is not printed, shown and not judged; beaten: the whole interval is"
    f" better than printed by more than {100.0 * TOLERANCE:.0f} %, or of an estimate its worst end"
    " is nearer to the truth; reproduced: the printed figure is in an interval that is not wider"
    f" than the figure, or within {100.0 * TOLERANCE:.0f} %; eigenvalues by their distance to 1;"
    " below the true model: better than printed, but also than the exact plant, so it fits"
    " lag or feedback"
)
APART_NOTE = "these figures compare nothing with a printed one, or cannot fail"
COMMON = {  # reasons that are the same for every figure with the verdict
    "calibrated": "gains and reference were fitted to the printed figures: see the ratios to our"
    " own nominal",
    "ours": "no printed figure of the same experiment",
}


def summary_grids(tables: Sequence[Sequence[Judged]]) -> list[Grid]:
    """Count the verdicts of each table that mean something, and list the others with reasons."""
    sources = [source for judged in tables for source in by_table(judged)]
    return [_counted(sources), _apart(sources)]


def _counted(sources: Sequence[Sequence[Judged]]) -> Grid:
    rows, records, total = [], [], Counter[str]()
    for judged in sources:
        count = Counter(comparison.verdict for comparison in judged)
        if not any(count[verdict] for verdict in COUNTED):
            continue
        total.update({verdict: count[verdict] for verdict in COUNTED})
        records.append(_place(judged) | {verdict: count[verdict] for verdict in COUNTED})
        place = [Cell(str(text)) for text in _place(judged).values()]
        rows.append([*place, *(_count(count[verdict]) for verdict in COUNTED)])
    rows.append([Cell("all"), Cell(""), Cell(""), *(_count(total[name]) for name in COUNTED)])
    headers = ["source", "table", "experiment", *COUNTED]
    return Grid("Printed figures and ours", headers, rows, 3, [NOTE], records)


def _apart(sources: Sequence[Sequence[Judged]]) -> Grid:
    """Return a line for each table and verdict that is not counted, with its reason."""
    rows, records = [], []
    for judged in sources:
        for verdict in APART:
            reasons = [row.reason for row in judged if row.verdict == verdict]
            if not reasons:
                continue
            reason = COMMON.get(verdict) or Counter(reasons).most_common(1)[0][0]
            place = _place(judged)
            records.append(place | {"verdict": verdict, "figures": len(reasons), "reason": reason})
            cells = [Cell(str(text)) for text in (*place.values(), verdict)]
            rows.append([*cells, _count(len(reasons)), Cell(reason, prose=True)])
    headers = ["source", "table", "experiment", "verdict", "figures", "reason"]
    return Grid("Figures without a comparison", headers, rows, 4, [APART_NOTE], records)


def _place(judged: Sequence[Judged]) -> dict[str, Scalar]:
    source = judged[0].printed
    return {"source": source.document, "table": source.table, "experiment": source.experiment}


def _count(number: int) -> Cell:
    return Cell(str(number) if number else "", sort=float(number))
