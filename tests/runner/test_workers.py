"""The launcher `processes`: the same results, one thread each, killed workers, no compilation."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from seatrial.models import compiled
from seatrial.runner.configuration.config import Trial
from seatrial.runner.database import LogbookWriter
from seatrial.runner.sweeps.launching import THREADS
from seatrial.runner.trials import precompile, trial
from seatrial.runner.trials.closed_loop import Streams, prepare
from tests.runner.programs import METRICS, ended, patched, rows, sweep
from tests.trials import asked_for

TWO = ("hydra/launcher=processes", "hydra.launcher.n_jobs=2")
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


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
def test_workers_that_cannot_start_are_one_line(tmp_path: Path) -> None:
    variables = patched(tmp_path / "site", UNABLE)
    code, _, err = ended(sweep("seed=range(0,9)", *TWO, folder=tmp_path, **variables))
    assert code == 2
    assert err.splitlines()[-1] == (
        "seatrial: hydra/launcher=processes: a worker has ended with exit code 3"
    )


# A sweep compiles before its workers start, each combination of kinds of parts once.
DEFAULT = ("disturbance=noise", "identifier=ls", "evaluation=four_corner")
UPDATE = "+update={window_s: 9, every_s: 1, trigger: feedback, threshold: 0.5, lowpass_hz: null}"


@cache
def kinds(*overrides: str) -> tuple[str, ...]:
    return precompile.kinds(asked_for(*DEFAULT, *overrides))


@pytest.mark.parametrize(
    ("change", "same"),
    [
        (("seed=3", "sample_time_s=0.2", "excitation.interval_s=200"), (0, 1, 2, 3)),
        *((("identifier=ridge",), (0, 1, 2)), (("disturbance=[noise,wind]",), (1, 2, 3))),
        *((("excitation=prbs_waypoints",), (0, 2, 3)), (("evaluation=operation",), (0, 1, 3))),
        *((("controller=lqi",), (0, 1, 2)), (("vessel=otter",), ()), ((UPDATE,), ())),
    ],
)
def test_kinds_of_parts_decide_what_is_compiled(change: tuple[str, ...], same: tuple[int]) -> None:
    before, after = kinds(), kinds(*change)
    assert tuple(i for i in range(4) if before[i] == after[i]) == same


def test_other_programs_are_not_run_before_the_workers() -> None:
    assert not kinds("identifier=command", "identifier.command=[fit]")


@pytest.fixture
def runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[Trial]:
    """The trials that are run, and fail; what is compiled is in a folder of its own."""
    runs: list[Trial] = []

    def run(trial: Trial) -> None:
        runs.append(trial)
        raise RuntimeError("as a trial may fail on few samples")

    monkeypatch.setattr(precompile.trials, "run", run)
    monkeypatch.setattr(compiled, "cache_folder", lambda: tmp_path)
    return runs


def test_one_trial_of_each_kind_runs_once_on_a_machine(runs: list[Trial]) -> None:
    rows = (("seed=0",), ("seed=1",), ("identifier=ridge",), ("identifier=ridge", "seed=2"))
    planned = [(kinds(*row), lambda row=row: asked_for(*DEFAULT, *row)) for row in rows]
    precompile.precompile(planned)
    assert [trial.names["identifier"] for trial in runs] == ["ls", "ridge"]
    assert {trial.samples for trial in runs} == {precompile.SAMPLES}
    precompile.precompile([*planned, ((), lambda: pytest.fail("a part from elsewhere"))])
    assert len(runs) == 2


def test_few_samples_train_test_and_deploy() -> None:
    few = replace(asked_for(*DEFAULT), samples=50)
    excited = trial.excite(few, Streams(0))
    assert excited.training.sum() == excited.testing.sum() == 50
    assert len(excited.recording) > 1000
    model, mission = few.vessel.nominal(), few.evaluation
    assert len(prepare(few, Streams(0), model, mission, deployed=True).weather.pose_noise) == 50


SITE = """
import os
from seatrial.models import compiled
real = compiled._Cache.save_overload
def save_overload(self, sig, cres):
    with open(os.environ["NOTES"] + "/notes", "a") as file:
        print(os.getpid(), self._file(sig, cres.codegen), file=file)
    real(self, sig, cres)
compiled._Cache.save_overload = save_overload
"""


@pytest.mark.nightly
def test_workers_on_an_empty_cache_compile_nothing(tmp_path: Path) -> None:
    process = sweep(
        *("identifier=none,ls", "evaluation=none", "seed=0,1", "disturbance=noise"),
        *("hydra/launcher=processes", "hydra.launcher.n_jobs=4"), folder=tmp_path,
        SEATRIAL_CACHE=str(tmp_path / "cache"), **patched(tmp_path, SITE),
    )  # fmt: skip
    out, err = process.communicate(timeout=1200)
    assert process.returncode == 0, err
    assert "4 finished" in out
    assert err.count("compiling simulation.loop._sail (first time on this machine)") == 1
    compilations = [line.split() for line in (tmp_path / "notes").read_text().splitlines()]
    assert len(compilations) > 5
    assert {pid for pid, _ in compilations} == {str(process.pid)}
    assert len({file for _, file in compilations}) == len(compilations)
