"""How much faster 64 trials of a second or more are with joblib than one after the other.

    python tests/benchmarks/launchers.py [trials]

The start of the programs and of the workers is left out: time is counted from the start of the
first trial to the end of the last. Nothing is asserted; the load of the machine is printed too.
"""

import os
import subprocess
import sys
import tempfile
from datetime import timedelta
from pathlib import Path
from statistics import median

from runner.database import Logbook

ROOT = Path(__file__).parents[2]
TRIAL = ("identifier=none", "evaluation=none", "excitation.interval_s=600")


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
    times = {}
    with tempfile.TemporaryDirectory() as folder:
        for launcher in ("basic", "joblib"):
            before = os.getloadavg()[0]
            times[launcher], each = measured(launcher, trials, Path(folder) / launcher)
            print(
                f"{launcher:<7} {trials} trials in {times[launcher]:6.1f} s, median trial "
                f"{each:.2f} s; load {before:.1f} before, {os.getloadavg()[0]:.1f} after, "
                f"{os.cpu_count()} cores"
            )
    print(f"ratio   {times['basic'] / times['joblib']:.2f}")


if __name__ == "__main__":
    main()
