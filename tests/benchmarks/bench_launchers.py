"""64 trials of a second or more: with `processes` on all cores, and one after the other.

The launchers take turns, a quarter of the trials at a time, so that other work on the machine
weighs on both alike. The start of the programs and of the workers is left out: time is counted
from the start of a quarter's first trial to the end of its last. About three minutes.
"""

import os
import subprocess
import sys
from collections.abc import Callable
from datetime import timedelta
from pathlib import Path
from statistics import median
from typing import Any

from seatrial.runner.database import LogbookWriter

TRIALS, TURNS = 64, 4
WANTED = 1.6  # times, on two cores
ROOT = Path(__file__).parents[2]
TRIAL = ("identifier=none", "evaluation=none", "excitation.interval_s=1400")
LAUNCHERS = ("basic", "processes")
METRICS = "SELECT seed, stage, model, dof, name, value FROM metric JOIN run ON run.id = run_id"


def test_launchers(stated: Callable[..., None], tmp_path: Path) -> None:
    def work() -> dict[str, dict[str, Any]]:
        total, each = dict.fromkeys(LAUNCHERS, 0.0), dict[str, list[float]]()
        for turn in range(TURNS):
            found = {}
            for launcher in LAUNCHERS:
                folder = tmp_path / f"{launcher}{turn}"
                span, durations, found[launcher] = _measured(launcher, folder)
                total[launcher] += span
                each.setdefault(launcher, []).extend(durations)
            assert found["basic"] == found["processes"] != []
        ratio = total["basic"] / total["processes"]
        one = {launcher: median(durations) for launcher, durations in each.items()}
        return {
            f"processes against basic on {os.cpu_count()} cores": {
                "shown": f"{ratio:.2f} times faster: {total['processes']:.1f} s against"
                f" {total['basic']:.1f} s",
                "limit": f"at least {WANTED:g}",
                "short": f"{ratio:.2f} of {WANTED:g}" if ratio < WANTED else "",
                "ratio": ratio,
            },
            "a trial, median": {
                "shown": f"{one['basic']:.2f} s with basic, {one['processes']:.2f} s with processes"
            },
        }

    stated(
        work, item="9", what=f"{TRIALS} trials of a second or more",
        note="one thread a trial (tests/runner/test_workers.py), equal metrics from both; the start"
        " of the workers left out",
    )  # fmt: skip


def _measured(launcher: str, folder: Path) -> tuple[float, list[float], list[Any]]:
    """Wall time [s] of a quarter's sweep, the times [s] of its trials, and its metrics."""
    folder.mkdir()
    seeds = f"seed=range(0,{TRIALS // TURNS})"
    subprocess.run(
        [sys.executable, "-m", "runner", "-m", *TRIAL, seeds, f"hydra/launcher={launcher}"],
        cwd=folder, env={**os.environ, "PYTHONPATH": str(ROOT)}, check=True, capture_output=True,
    )  # fmt: skip
    with LogbookWriter.read(f"sqlite:///{folder}/results/results.db") as logbook:
        runs = logbook.runs()
        metrics = sorted(logbook.sql(METRICS).rows)
    assert [run.status for run in runs] == ["finished"] * (TRIALS // TURNS)
    ends = [run.finished_at for run in runs if run.finished_at]
    span: timedelta = max(ends) - min(run.started_at for run in runs)
    return span.total_seconds(), [run.duration_s or 0.0 for run in runs], metrics
