"""How much faster 64 trials of a second or more are with joblib than one after the other.

    python tests/benchmarks/launchers.py [trials]

The launchers take turns, a quarter of the trials at a time, so that other work on the machine
weighs on both alike; its load is printed too. The start of the programs and of the workers is left
out: time is counted from the start of a quarter's first trial to the end of its last. Nothing is
asserted.
"""

import os
import subprocess
import sys
import tempfile
from datetime import timedelta
from pathlib import Path
from statistics import median

from runner.database import Logbook

TURNS = 4
ROOT = Path(__file__).parents[2]
TRIAL = ("identifier=none", "evaluation=none", "excitation.interval_s=1400")


def measured(launcher: str, trials: int, folder: Path) -> tuple[float, float]:
    """Wall time of a sweep, and the median time of its trials, both in seconds."""
    folder.mkdir()
    subprocess.run(
        [
            *(sys.executable, "-m", "runner", "-m", *TRIAL),
            *(f"seed=range(0,{trials})", f"hydra/launcher={launcher}"),
        ],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        check=True,
        capture_output=True,
    )
    with Logbook.read(f"sqlite:///{folder}/results/results.db") as logbook:
        runs = logbook.runs()
    assert [run.status for run in runs] == ["finished"] * trials
    ends = [run.finished_at for run in runs if run.finished_at]
    span: timedelta = max(ends) - min(run.started_at for run in runs)
    return span.total_seconds(), median(run.duration_s or 0.0 for run in runs)


def main() -> None:
    """Measure both, in turn, and print the ratio."""
    trials = int(sys.argv[1]) if len(sys.argv) > 1 else 64
    total = {"basic": 0.0, "joblib": 0.0}
    with tempfile.TemporaryDirectory() as folder:
        for turn in range(TURNS):
            for launcher in total:
                place = Path(folder) / f"{launcher}{turn}"
                span, each = measured(launcher, trials // TURNS, place)
                total[launcher] += span
                print(
                    f"{launcher:<7} {trials // TURNS} trials in {span:6.1f} s, median trial "
                    f"{each:.2f} s; load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores",
                    flush=True,
                )
    print(*(f"{launcher} {span:.1f} s," for launcher, span in total.items()), end=" ")
    print(f"ratio {total['basic'] / total['joblib']:.2f}")


if __name__ == "__main__":
    main()
