"""The benchmark tables of docs/speed.md: `python -m docs.benchmarks`, after `make bench`.

The data are read from `results/bench.json`, written by pytest-benchmark; the measurements are
described in `tests/benchmarks/conftest.py`. Ratios are those of the medians, the time of the other
program over ours.
"""

import json
import sys
from pathlib import Path
from statistics import median
from typing import Any

from docs.pages.markdown import table

BENCH = Path(__file__).parents[1] / "results" / "bench.json"
UNITS = ((1.0, "s"), (1e-3, "ms"), (1e-6, "us"), (1e-9, "ns"))
Row = dict[str, Any]


def read(file: Path) -> tuple[list[Row], str]:
    """The benchmark records, sorted by item number, and a description of the machine."""
    if not file.exists():
        sys.exit(f"{file}: not found; `make bench` writes it")
    held = json.loads(file.read_text())
    rows = [one["extra_info"] | {"stats": one["stats"]} for one in held["benchmarks"]]
    rows.sort(key=lambda row: (int(row["item"].rstrip("abcdefgh")), row["item"]))
    info = held["machine_info"]
    cpu = info["cpu"]
    if not rows:
        sys.exit(f"{file}: contains no passed benchmark")
    loads = [row["load"] for row in rows]
    machine = (
        f"{cpu.get('brand_raw', info['machine'])}, {cpu.get('count', '?')} cores,"
        f" {info['system']}, Python {info['python_version']}, load {min(loads):.1f} to"
        f" {max(loads):.1f}, {held['datetime'][:10]}"
    )
    return rows, machine


def shown_seconds(value: float) -> str:
    """A time with three digits, in the largest unit in which it is at least 1."""
    size, unit = next((u for u in UNITS if value >= u[0]), UNITS[-1])
    return f"{value / size:.3g} {unit}"


def ratio_of(row: Row) -> tuple[float, float, float]:
    """Median of ours [s], median of the other program [s], and the ratio of other to ours."""
    ours = row["stats"]["median"] / row["calls"]
    peer = median(row["peer_seconds"])
    return ours, peer, peer / ours


def ratio_row(row: Row) -> list[str]:
    """The table cells of one comparison."""
    ours, peer, ratio = ratio_of(row)
    wanted = row["wanted"]
    return [
        row["what"],
        f"{row['ours']}: {shown_seconds(ours)}",
        f"{row['peer']}: {shown_seconds(peer)}",
        f"{ratio:.3g}",
        "" if wanted is None else f"{wanted:g}",
        note(row, short=wanted is not None and ratio < wanted, by=f"{ratio:.3g} of {wanted}"),
    ]


def note(row: Row, *, short: bool, by: str) -> str:
    """The shortfall of a figure with its reason, and the note of its benchmark."""
    parts = [f"short: {by}; {row['why'] or 'not explained yet'}"] if short else []
    return "; ".join([*parts, *([row["note"]] if row["note"] else [])])


def figure_rows(row: Row) -> list[list[str]]:
    """The table cells of figures other than ratios; the note is added to the first row only."""
    rest = row | {"note": ""}
    return [
        [
            f"{row['what']}: {name}" if len(row["found"]) > 1 else row["what"],
            str(one["shown"]),
            str(one.get("limit", "")),
            note(rest if i else row, short=bool(one.get("short")), by=str(one.get("short", ""))),
        ]
        for i, (name, one) in enumerate(row["found"].items())
    ]


def main() -> None:
    """Print the tables and the description of the machine."""
    rows, machine = read(Path(sys.argv[1]) if len(sys.argv) > 1 else BENCH)
    ratios = [ratio_row(row) for row in rows if row["kind"] == "ratio"]
    figures = [cells for row in rows if row["kind"] == "figures" for cells in figure_rows(row)]
    print(f"Medians, measured in turn on {machine}.\n")
    print(table(["what", "ours", "other", "times faster", "asked", "note"], ratios))
    print(table(["what", "figure", "asked", "note"], figures), end="")


if __name__ == "__main__":
    main()
