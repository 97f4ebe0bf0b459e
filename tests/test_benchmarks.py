"""The table of benchmarks says what was measured, and what falls short."""

import json
from pathlib import Path
from typing import Any

import pytest

from docs.benchmarks import figure_rows, ratio_row, read

RATIO = {
    "kind": "ratio", "item": "2", "what": "a surface", "ours": "blocked", "peer": "one by one",
    "wanted": 10.0, "why": "few columns", "note": "one core", "calls": 10, "load": 0.5,
    "peer_seconds": [0.5, 0.1, 0.3],
}  # fmt: skip
FIGURES = {
    "kind": "figures", "item": "10a", "what": "overhead", "why": "", "note": "", "load": 1.5,
    "found": {"a trial": {"shown": "70 ms", "limit": "at most 60 ms", "short": "10 ms"}},
}  # fmt: skip


def written(folder: Path, *rows: dict[str, Any]) -> Path:
    held = {
        "benchmarks": [{"extra_info": row, "stats": {"median": 0.2}} for row in rows],
        "machine_info": {"cpu": {"count": 2}, "machine": "x", "system": "L", "python_version": "3"},
        "datetime": "2026-01-02T03:04:05",
    }
    file = folder / "bench.json"
    file.write_text(json.dumps(held))
    return file


def test_rows_stand_in_the_order_of_their_numbers_with_the_machine(tmp_path: Path) -> None:
    rows, machine = read(written(tmp_path, FIGURES, RATIO))
    assert [row["item"] for row in rows] == ["2", "10a"]
    assert machine == "x, 2 cores, L, Python 3, load 0.5 to 1.5, 2026-01-02"


def test_a_ratio_is_that_of_the_medians_of_one_call(tmp_path: Path) -> None:
    ((row,), _) = read(written(tmp_path, RATIO))
    assert ratio_row(row) == [
        "a surface", "blocked: 20 ms", "one by one: 300 ms", "15", "10", "one core",
    ]  # fmt: skip


def test_what_falls_short_says_by_how_much_and_why(tmp_path: Path) -> None:
    ((row,), _) = read(written(tmp_path, RATIO | {"wanted": 20.0}))
    assert ratio_row(row)[-1] == "short: 15 of 20.0; few columns; one core"
    ((cells,),) = (figure_rows(FIGURES),)
    assert cells[1:] == ["70 ms", "at most 60 ms", "short: 10 ms; not explained yet"]


def test_a_file_without_benchmarks_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="contains no passed benchmark"):
        read(written(tmp_path))
