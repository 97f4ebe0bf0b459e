"""kill -9 at random moments of a sweep, until the same command has completed it."""

import os
import random
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from seatrial.runner.database import Logbook
from tests.runner.programs import METRICS, ROOT, ended, finished, program, rows, wait

SWEEP = (
    *("-m", "runner", "-m", "identifier=none,ls", "disturbance=calm,noise", "seed=range(0,6)"),
    *("evaluation=none", "excitation.interval_s=120"),
)
TRIALS = 24
KILLS = 10
TABLES = (
    ("--metric", "force_mse"),
    ("--coefficient", "u_dot", "--model", "identified"),
)

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]


def tables(folder: Path) -> str:
    """The comparisons of the newest sweep, as text, without its number: each start has its own."""
    said = []
    for table in TABLES:
        command = ["-m", "runner.compare", "table", "--rows", "identifier", "--columns"]
        answer = subprocess.run(
            [sys.executable, *command, "disturbance", "--format", "md", *table],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
            capture_output=True,
            text=True,
            check=False,
        )
        assert answer.returncode == 0, answer.stderr
        said.append(re.sub(r"sweep \d+ \(", "sweep (", answer.stdout))
    return "\n".join(said)


def undisturbed(folder: Path) -> tuple[float, float]:
    """Run the sweep; the answer is the time [s] to its first trial, and of a trial on average."""
    folder.mkdir()
    began = time.monotonic()
    process = program(*SWEEP, folder=folder)
    while not rows(folder, "SELECT id FROM run") and process.poll() is None:
        time.sleep(0.02)
    start = time.monotonic() - began
    code, _, err = ended(process)
    assert code == 0, err
    return start, (time.monotonic() - began - start) / TRIALS


def await_sweep(process: subprocess.Popen[str], folder: Path) -> None:
    """Wait until a sweep of this process is in the logbook."""
    own = f"SELECT id FROM sweep WHERE pid = {process.pid}"
    wait(lambda: rows(folder, own) or process.poll() is not None)


def check(folder: Path) -> None:
    """The database opens, and what it says to be finished is whole."""
    if not rows(folder, "SELECT id FROM sweep"):
        return
    assert rows(folder, "PRAGMA integrity_check") == [("ok",)]
    whole = "SELECT count(*) FROM metric WHERE run_id = run.id"
    broken = f"SELECT id FROM run WHERE (status = 'finished') <> (({whole}) > 0)"
    assert rows(folder, broken) == []
    with Logbook.read(f"sqlite:///{folder}/results/results.db") as logbook:
        verified = logbook.verify()
    assert verified.problems == []


def test_ten_kills_leave_the_table_of_an_undisturbed_sweep(tmp_path: Path) -> None:
    calm, rough = tmp_path / "calm", tmp_path / "rough"
    start, each = undisturbed(calm)
    rough.mkdir()
    chance = random.Random(20260131)
    done = []
    for kill in range(KILLS):
        process = program(*SWEEP, folder=rough)
        if kill % 5 == 0:  # while it starts
            time.sleep(chance.uniform(0.0, start))
        else:
            await_sweep(process, rough)
            time.sleep(chance.uniform(0.0, 0.6 * start + 5.0 * each))
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        check(rough)
        done.append(finished(rough))
    print("finished after each kill:", *done)
    assert done == sorted(done)  # nothing that was finished is lost
    code, out, err = ended(program(*SWEEP, folder=rough))
    assert code == 0, err
    assert f"{TRIALS} finished ({done[-1]} already in the logbook), 0 failed" in out
    with Logbook.read(f"sqlite:///{rough}/results/results.db") as logbook:
        assert (logbook.verify().problems, logbook.verify().leftovers) == ([], [])
    statuses = "SELECT status, count(*) FROM run GROUP BY 1 ORDER BY 1"
    print(*rows(rough, statuses))
    assert rows(rough, METRICS) == rows(calm, METRICS)
    assert tables(rough) == tables(calm)
