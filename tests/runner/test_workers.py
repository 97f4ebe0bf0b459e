"""Sweeps in worker processes: the same results, one thread each, and a clear end if one dies."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from seatrial.runner.launching import THREADS
from tests.runner.programs import (
    METRICS,
    ROOT,
    children,
    ended,
    finished,
    program,
    rows,
    sweep,
    wait,
)

pytestmark = pytest.mark.slow


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


DIES = """
import os, signal, sys, time
from joblib.externals.loky import get_reusable_executor
from seatrial.runner.joblib_workers import broken_if_stuck

def half_a_result():
    frame = sys._getframe()
    while "result_queue" not in frame.f_locals:
        frame = frame.f_back
    queue = frame.f_locals["result_queue"]
    queue._wlock.acquire()
    os.write(queue._writer.fileno(), bytes([0, 0, 16, 0, 1, 2, 3]))
    os.kill(os.getpid(), signal.SIGKILL)

with broken_if_stuck():
    pool = get_reusable_executor(max_workers=2)
    waiting = [pool.submit(time.sleep, 0.5), pool.submit(half_a_result), pool.submit(time.sleep, 1)]
    for future in waiting:
        print(type(future.exception()).__name__)
"""


def test_a_worker_that_is_killed_while_it_sends_its_result(tmp_path: Path) -> None:
    (tmp_path / "dies.py").write_text(DIES)
    code, out, err = ended(program("dies.py", folder=tmp_path))
    assert code == 0, err
    assert "BrokenProcessPool" in out


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
        "import sys, types, numpy, scipy.linalg, seatrial.runner\n"
        "from seatrial.runner.record.rows import Results\n"
        "def run(trial):\n"
        "    pools = {pool['num_threads'] for pool in threadpool_info()}\n"
        "    assert pools == {1}, pools\n"
        "    return Results()\n"
        "fake = types.SimpleNamespace(check=lambda trial: None, run=run)\n"
        "seatrial.runner.trial = sys.modules['seatrial.runner.trial'] = fake\n"
        "sys.argv = ['seatrial']\n"
        "from seatrial.runner.__main__ import main\n"
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


# Python imports this module at its start, in workers as well.
SITE = """
import json, os
import numba, threadpoolctl
import seatrial.runner.trial
from seatrial.models import compile_lock
real = seatrial.runner.trial.run
def run(trial):
    pools = [pool["num_threads"] for pool in threadpoolctl.threadpool_info()]
    note = {"pid": os.getpid(), "pools": pools, "numba": numba.get_num_threads()}
    note["times"] = str(compile_lock._stopwatch._report)
    with open(os.path.join(os.environ["NOTES"], f"{trial.seed}.json"), "w") as file:
        json.dump(note, file)
    return real(trial)
seatrial.runner.trial.run = run
"""


def test_workers_have_one_thread_each_and_are_no_more_than_asked_for(tmp_path: Path) -> None:
    site = tmp_path / "site"
    site.mkdir()
    (site / "sitecustomize.py").write_text(SITE)
    process = sweep(
        *("seed=range(0,6)", "hydra/launcher=joblib", "hydra.launcher.n_jobs=2"),
        folder=tmp_path,
        PYTHONPATH=f"{site}{os.pathsep}{ROOT}",
        NOTES=str(tmp_path),
        **dict.fromkeys(THREADS, "4"),  # what the user has set for other programs
    )
    code, _, err = ended(process)
    assert code == 0, err
    notes = [json.loads(file.read_text()) for file in tmp_path.glob("*.json")]
    assert len(notes) == 6
    assert 1 <= len({note["pid"] for note in notes}) <= 2
    assert process.pid not in {note["pid"] for note in notes}
    for note in notes:
        assert note["pools"]
        assert {*note["pools"], note["numba"]} == {1}
    # They report to the sweep how long they compile.
    times = [Path(note["times"]) for note in notes]
    assert [path.name for path in times] == [str(note["pid"]) for note in notes]
    assert len({path.parent for path in times}) == 1
    assert not times[0].parent.exists()


COUNTED = """
import sys
from numba.core.dispatcher import Dispatcher
from seatrial.runner.__main__ import main
code = main()
kernels = {
    id(one): one for name, module in list(sys.modules.items()) if name.startswith("seatrial.models")
    for one in vars(module).values() if isinstance(one, Dispatcher)
}
for kind in ("cache_misses", "cache_hits"):
    print(kind, sum(sum(getattr(one.stats, kind).values()) for one in kernels.values()))
sys.exit(code)
"""


def test_a_second_program_compiles_nothing(tmp_path: Path) -> None:
    options = ("disturbance=noise", "identifier=plsr", "rerun=true")
    for _ in range(2):  # the first compiles what the cache does not hold yet
        code, out, err = ended(program("-c", COUNTED, *options, folder=tmp_path))
        assert code == 0, err
    counts = dict(line.split() for line in out.splitlines() if line.startswith("cache_"))
    assert int(counts["cache_misses"]) == 0
    assert int(counts["cache_hits"]) > 0
