"""Sweeps in worker processes: the same results, one thread each, and a clear end if one dies."""

import os
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TRIALS = ["identifier=none", "evaluation=none"]

pytestmark = pytest.mark.slow


def sweep(*arguments: str, folder: Path) -> subprocess.Popen[str]:
    """A sweep as a program of its own, in a process group of its own."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    environment.pop("HYDRA_FULL_ERROR", None)
    return subprocess.Popen(
        [sys.executable, "-m", "runner", "-m", *TRIALS, *arguments],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def ended(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    out, err = process.communicate(timeout=240)
    return process.returncode, out, err


def rows(folder: Path, query: str) -> list[tuple[object, ...]]:
    file = folder / "results" / "results.db"
    if not file.exists():
        return []
    connection = sqlite3.connect(f"file:{file}?mode=ro", uri=True, timeout=30.0)
    try:
        return connection.execute(query).fetchall()
    except sqlite3.OperationalError:  # the schema is not there yet
        return []
    finally:
        connection.close()


def finished(folder: Path) -> int:
    return len(rows(folder, "SELECT id FROM run WHERE status = 'finished'"))


def wait(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + 120.0
    while not condition():
        assert time.monotonic() < deadline, "it took too long"
        time.sleep(0.05)


def children(pid: int) -> Iterator[tuple[int, str]]:
    """Child processes of a process: number and command line."""
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
                command = (folder / "cmdline").read_text().replace("\0", " ")
            except OSError:
                continue
            if parent == pid:
                yield int(folder.name), command


METRICS = (
    "SELECT run.seed, stage, model, dof, name, value FROM metric JOIN run ON run.id = run_id "
    "ORDER BY 1, 2, 3, 4, 5"
)


def test_workers_compute_the_same(tmp_path: Path) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    here.mkdir()
    there.mkdir()
    noisy = ("disturbance=noise", "seed=0,1,2,3")
    code, out, err = ended(sweep(*noisy, folder=here))
    assert code == 0, err
    code, out, err = ended(sweep(*noisy, "hydra/launcher=joblib", folder=there))
    assert code == 0, err
    assert "4 runs: 4 finished" in out
    assert "Traceback" not in err
    assert rows(here, METRICS) == rows(there, METRICS)
    assert len(rows(there, METRICS)) > 0
    keys = "SELECT seed, fingerprint FROM run ORDER BY 1"
    assert rows(here, keys) == rows(there, keys)


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="reads /proc for the workers")
def test_a_killed_worker_ends_the_sweep_with_one_line(tmp_path: Path) -> None:
    arguments = ("seed=range(0,24)", "hydra/launcher=joblib", "hydra.launcher.n_jobs=2")
    process = sweep(*arguments, folder=tmp_path)
    wait(lambda: finished(tmp_path) >= 2 or process.poll() is not None)
    workers = [pid for pid, command in children(process.pid) if "popen_loky" in command]
    os.kill(workers[0], signal.SIGKILL)
    code, out, err = ended(process)
    assert code == 1
    assert "Traceback" not in err
    assert err.splitlines()[-1].startswith("seatrial: a worker process was killed")
    assert "not done" in out
    before = finished(tmp_path)
    assert 2 <= before < 24
    code, out, err = ended(sweep(*arguments, folder=tmp_path))
    assert code == 0, err
    assert f"24 finished ({before} already in the logbook)" in out


def test_an_interrupted_sweep_is_completed_by_the_same_command(tmp_path: Path) -> None:
    process = sweep("seed=range(0,12)", folder=tmp_path)
    wait(lambda: finished(tmp_path) >= 2 or process.poll() is not None)
    os.killpg(process.pid, signal.SIGINT)
    code, _, err = ended(process)
    assert code == 130
    assert err.splitlines()[-1].startswith("seatrial: interrupted")
    assert "Traceback" not in err
    assert not rows(tmp_path, "SELECT id FROM run WHERE status = 'running'")
    code, out, err = ended(sweep("seed=range(0,12)", folder=tmp_path))
    assert code == 0, err
    assert "12 runs: 12 finished" in out
    assert finished(tmp_path) == 12


def test_kill_9_leaves_a_database_that_the_same_command_completes(tmp_path: Path) -> None:
    process = sweep("seed=range(0,12)", folder=tmp_path)
    wait(lambda: finished(tmp_path) >= 2 or process.poll() is not None)
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    before = finished(tmp_path)
    code, out, err = ended(sweep("seed=range(0,12)", folder=tmp_path))
    assert code == 0, err
    assert f"12 finished ({before} already in the logbook)" in out
    assert finished(tmp_path) == 12
    (check,) = rows(tmp_path, "PRAGMA integrity_check")[0]
    assert check == "ok"


def test_two_processes_do_not_run_the_same_trial(tmp_path: Path) -> None:
    both = [sweep("seed=range(0,6)", folder=tmp_path) for _ in range(2)]
    for process in both:
        code, _, err = ended(process)
        assert code == 0, err
    assert finished(tmp_path) == 6
    assert rows(tmp_path, "SELECT count(*) FROM run")[0] == (6,)


def test_a_trial_has_one_thread(tmp_path: Path) -> None:
    code = (
        "from threadpoolctl import threadpool_info\n"
        "import sys, types, numpy, scipy.linalg, runner\n"
        "from runner.database.records import Results\n"
        "def run(trial):\n"
        "    pools = {pool['num_threads'] for pool in threadpool_info()}\n"
        "    assert pools == {1}, pools\n"
        "    return Results()\n"
        "fake = types.SimpleNamespace(check=lambda trial: None, run=run)\n"
        "runner.trial = sys.modules['runner.trial'] = fake\n"
        "sys.argv = ['seatrial']\n"
        "from runner.__main__ import main\n"
        "sys.exit(main())\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    answer = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert answer.returncode == 0, answer.stderr
