"""The command `table` over logbooks of 100 to 100,000 runs. About half a minute."""

import csv
import sys
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

from tests.benchmarks.conftest import growth
from tests.benchmarks.filled import disturbance_of, fill, identifier_of, value
from tests.runner.database.samples import make_results
from tests.runner.programs import ROOT, completed

SIZES = [100, 1_000, 10_000, 100_000]
ASKED_S = 3.0  # at the largest, about
# The command, and then its peak memory.
COMMAND = """
import sys
from seatrial.runner.compare.__main__ import run
from tests.benchmarks.memory import peak_megabytes
code = run(sys.argv[1:])
print(peak_megabytes(), file=sys.stderr)
sys.exit(code)
"""
SHOWN = ("force_mse", "surge", "validation", "identified")


def test_tables(stated: Callable[..., None], tmp_path: Path) -> None:
    files = {}
    for size in SIZES:
        folder = tmp_path / str(size)
        folder.mkdir()
        files[size] = fill(folder, size)

    def work() -> dict[str, dict[str, Any]]:
        times, peaks = [], []
        for size, file in files.items():
            turns = [_table(file, size) for _ in range(3)]
            times.append(median(seconds for seconds, _ in turns))
            peaks.append(max(megabytes for _, megabytes in turns))
        shown = ", ".join(f"{n:,} runs {t:.2f} s" for n, t in zip(SIZES, times, strict=True))
        over = times[-1] - ASKED_S
        return {
            "time": {
                **growth(SIZES, times, peaks, of="runs"),
                "shown": shown,
                "limit": f"about {ASKED_S:g} s for {SIZES[-1]:,} runs",
                "short": f"{over:.1f} s more" if over > 0.2 * ASKED_S else "",
            },
            "peak memory": {"shown": ", ".join(f"{peak:.0f} MB" for peak in peaks)},
        }

    about = "a table over runs of 30 metrics each"
    why = "the start of the command is more than a second of it"
    stated(work, item="7c", what=about, note="the whole command, start-up included", why=why)


def _table(file: Path, runs: int) -> tuple[float, float]:
    """Wall time [s] and peak memory [MB] of the command; its figures are checked."""
    metric, dof, stage, model = SHOWN
    begun = time.perf_counter()
    done = completed(
        *(sys.executable, "-c", COMMAND, "table", "--database", str(file)),
        *("--rows", "identifier", "--columns", "disturbance", "--format", "csv"),
        *("--metric", metric, "--dof", dof, "--stage", stage, "--model", model),
        PYTHONPATH=str(ROOT),
    )
    seconds = time.perf_counter() - begun
    assert done.returncode == 0, done.stderr
    _check(done.stdout, runs)
    return seconds, float(done.stderr)


def _check(said: str, runs: int) -> None:
    """Every cell holds the mean of what was put in."""
    place = [(m.name, m.dof, m.stage, m.model) for m in make_results().metrics].index(SHOWN)
    cells = {(row["identifier"], row["disturbance"]): row for row in csv.DictReader(said.split())}
    held: dict[tuple[str, str], list[float]] = {cell: [] for cell in cells}
    for run in range(1, runs + 1):
        held[identifier_of(run), disturbance_of(run)].append(value(run, place))
    assert len(cells) == 27
    for cell, values in held.items():
        assert int(cells[cell]["n"]) == len(values)
        assert abs(float(cells[cell]["mean"]) - sum(values) / len(values)) < 1e-9
