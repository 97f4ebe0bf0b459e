"""The launcher `processes`: the same results, one thread each, and workers that are killed."""

import json
import os
from pathlib import Path

import pytest

from seatrial.runner.database import LogbookWriter
from seatrial.runner.sweeps.launching import THREADS
from tests.runner.programs import METRICS, ROOT, ended, rows, sweep

pytestmark = pytest.mark.slow
TWO = ("hydra/launcher=processes", "hydra.launcher.n_jobs=2")
# Python imports this module at its start, in workers as well.
NOTES = """
import json, os
import numba, threadpoolctl
import seatrial.runner.trials.trial
real = seatrial.runner.trials.trial.run
def run(trial):
    pools = [pool["num_threads"] for pool in threadpoolctl.threadpool_info()]
    note = {"pid": os.getpid(), "pools": pools, "numba": numba.get_num_threads()}
    with open(os.path.join(os.environ["NOTES"], f"{trial.seed}.json"), "w") as file:
        json.dump(note, file)
    return real(trial)
seatrial.runner.trials.trial.run = run
"""


def patched(folder: Path, code: str) -> dict[str, str]:
    """The variables of a program that imports this code at its start."""
    folder.mkdir()
    (folder / "sitecustomize.py").write_text(code)
    return {"PYTHONPATH": f"{folder}{os.pathsep}{ROOT}", "NOTES": str(folder)}


def test_workers_compute_the_same_with_one_thread_each(tmp_path: Path) -> None:
    found, pids = [], []
    for name, launcher in {"here": (), "there": TWO}.items():
        folder = tmp_path / name
        folder.mkdir()
        variables = {**patched(folder / "notes", NOTES), **dict.fromkeys(THREADS, "4")}
        process = sweep("disturbance=noise", "seed=0,1,2", *launcher, folder=folder, **variables)
        code, out, err = ended(process)
        assert code == 0, err
        assert "3 runs: 3 finished" in out
        notes = [json.loads(file.read_text()) for file in folder.glob("notes/*.json")]
        assert len(notes) == 3
        for note in notes:
            assert set(note["pools"]) == {1}
            assert note["numba"] == 1 or not launcher
        pids.append({note["pid"] for note in notes} - {process.pid})
        fingerprints = rows(folder, "SELECT seed, fingerprint FROM run ORDER BY 1")
        found.append((rows(folder, METRICS), fingerprints))
    assert found[0] == found[1]
    assert len(found[0][0]) > 0
    assert pids[0] == set()
    assert len(pids[1]) in (1, 2)


# Seed 1 is killed in the midst of its result, seed 2 ended in its first run, seed 3 killed in both.
KILLED = """
import os, signal
import multiprocessing.connection
import seatrial.runner.trials.trial
run, send = seatrial.runner.trials.trial.run, multiprocessing.connection.Connection.send
def first(name):
    try:
        return open(os.path.join(os.environ["NOTES"], name), "x")
    except FileExistsError:
        return None
def killed_in_its_run(trial):
    if trial.seed == 3 or trial.seed == 2 and first("2"):
        os.kill(os.getpid(), signal.SIGTERM if trial.seed == 2 else signal.SIGKILL)
    return run(trial)
def killed_as_it_sends(connection, message):
    if "seed=1" in (getattr(message, "overrides", None) or ()) and first("1"):
        os.write(connection.fileno(), bytes([0, 0, 16, 0, 1, 2, 3]))
        os.kill(os.getpid(), signal.SIGKILL)
    send(connection, message)
seatrial.runner.trials.trial.run = killed_in_its_run
multiprocessing.connection.Connection.send = killed_as_it_sends
"""


def test_a_killed_worker_loses_its_own_run_only(tmp_path: Path) -> None:
    variables = patched(tmp_path / "site", KILLED)
    code, out, err = ended(sweep("seed=range(0,4)", *TWO, folder=tmp_path, **variables))
    assert code == 1, err
    assert "Traceback" not in err
    assert "4 runs: 3 finished, 0 failed, 0 diverged, 1 not done" in out
    with LogbookWriter.read(f"sqlite:///{tmp_path}/results/results.db") as logbook:
        assert sorted((run.seed, run.attempt, run.status) for run in logbook.runs()) == [
            *((0, 1, "finished"), (1, 1, "finished"), (2, 1, "interrupted"), (2, 2, "finished")),
            *((3, 1, "interrupted"), (3, 2, "interrupted")),
        ]


UNABLE = "import os, sys\nif '--multiprocessing-fork' in sys.orig_argv: os._exit(3)\n"


def test_workers_that_cannot_start_are_one_line(tmp_path: Path) -> None:
    variables = patched(tmp_path / "site", UNABLE)
    code, _, err = ended(sweep("seed=range(0,9)", *TWO, folder=tmp_path, **variables))
    assert code == 2
    assert err.splitlines()[-1] == (
        "seatrial: hydra/launcher=processes: a worker has ended with exit code 3"
    )
