"""Launchers other than the basic one and joblib: real jobs, and what happens to a killed one."""

import os
import signal
import subprocess
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from hydra import compose, initialize_config_dir
from hydra._internal.core_plugins.basic_launcher import BasicLauncher
from hydra.core.plugins import Plugins
from hydra.errors import MissingConfigException

from runner.complaints import CONF, one_line
from tests.runner.command import Command
from tests.runner.programs import METRICS, ended, finished, rows, sweep, wait

SUBMITIT = pytest.mark.skipif(
    find_spec("submitit") is None, reason="no submitit: pip install -e '.[slurm]'"
)
RAY = pytest.mark.skipif(find_spec("ray") is None, reason="no ray: pip install -e '.[ray]'")
LAUNCHERS = [
    pytest.param("submitit_local", marks=SUBMITIT),
    pytest.param("ray", marks=RAY),
]
RUNNING = "SELECT pid, id FROM run WHERE status = 'running'"
ATTEMPTS = "SELECT seed, attempt, status FROM run ORDER BY 1, 2"


class Lost(RuntimeError):  # noqa: N818 - it stands in for another name
    """What submitit raises for a job that leaves no result."""


Lost.__module__, Lost.__name__ = "submitit.core.utils", "UncompletedJobError"


class Fragile(BasicLauncher):
    """Runs the first job of a batch and loses the others, `losses` times; then runs them all."""

    losses = 1

    def launch(self, job_overrides: Any, initial_job_idx: int) -> Any:
        if not self.losses:
            return super().launch(job_overrides, initial_job_idx)
        self.losses -= 1
        super().launch(job_overrides[:1], initial_job_idx)
        raise Lost("job 1 has not produced any output")


def make_fragile(monkeypatch: pytest.MonkeyPatch, launcher: Fragile) -> None:
    def instantiate(self: Plugins, **context: Any) -> Fragile:
        launcher.setup(**context)
        return launcher

    monkeypatch.setattr(Plugins, "instantiate_launcher", instantiate)


def test_what_a_launcher_loses_is_launched_once_more(
    seatrial: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake = seatrial.pretend()
    make_fragile(monkeypatch, Fragile())
    answer = seatrial("-m", "seed=0,1,2")
    assert answer.code == 0
    assert fake.ran == [0, 1, 2]
    assert "3 runs: 3 finished, 0 failed" in answer.out


def test_what_is_lost_again_is_left_at_that(
    seatrial: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake = seatrial.pretend()
    launcher = Fragile()
    launcher.losses = 9
    make_fragile(monkeypatch, launcher)
    answer = seatrial("-m", "seed=0,1,2,3", "hydra.sweeper.max_batch_size=3")
    assert answer.code == 1
    assert fake.ran == [0, 1, 3]
    assert "4 runs: 3 finished, 0 failed, 0 diverged, 1 not done" in answer.out


def test_a_launcher_that_cannot_start_is_one_line(
    seatrial: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Absent(Fragile):
        def launch(self, job_overrides: Any, initial_job_idx: int) -> Any:
            raise RuntimeError("no\nscheduler")

    seatrial.pretend()
    make_fragile(monkeypatch, Absent())
    answer = seatrial("-m", "seed=0,1")
    assert (answer.code, answer.err) == (2, "seatrial: hydra/launcher=basic: no scheduler\n")


@pytest.mark.parametrize(
    ("launcher", "extra"),
    [("submitit_local", "slurm"), ("submitit_slurm", "slurm"), ("ray", "ray")],
)
def test_an_absent_launcher_names_its_extra(launcher: str, extra: str) -> None:
    error = MissingConfigException(f"Could not find 'hydra/launcher/{launcher}'", "hydra/launcher")
    assert one_line(error) == (
        f"hydra/launcher={launcher} is not installed: pip install -e '.[{extra}]'"
    )


@SUBMITIT
def test_a_password_is_not_written_to_the_files_of_jobs(seatrial: Command) -> None:
    seatrial.pretend()
    url = "database.url=postgresql://sailor:anchor@127.0.0.1:9/none"
    said = seatrial.refuses("-m", "seed=0,1", "hydra/launcher=submitit_local", url)
    assert "SEATRIAL_DATABASE" in said
    assert "anchor" not in said


@SUBMITIT
def test_slurm_composes_and_says_where_there_is_none(
    seatrial: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    options = ["hydra/launcher=submitit_slurm", "hydra.launcher.partition=short"]
    with initialize_config_dir(str(CONF), version_base="1.3"):
        launcher = compose("trial", options, return_hydra_config=True).hydra.launcher
    assert launcher._target_.endswith("SlurmLauncher")
    assert (launcher.partition, launcher.tasks_per_node) == ("short", 1)
    seatrial.pretend()
    monkeypatch.setenv("PATH", "")
    answer = seatrial("-m", "seed=0,1", *options)
    assert answer.code == 2
    assert answer.err.startswith('seatrial: hydra/launcher=submitit_slurm: Could not detect "srun"')


@pytest.mark.slow
@pytest.mark.parametrize("launcher", LAUNCHERS)
def test_two_jobs_compute_the_same_as_here(launcher: str, tmp_path: Path) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    here.mkdir()
    there.mkdir()
    noisy = ("disturbance=noise", "seed=0,1")
    code, _, err = ended(sweep(*noisy, folder=here))
    assert code == 0, err
    code, out, err = ended(sweep(*noisy, f"hydra/launcher={launcher}", folder=there))
    assert code == 0, err
    assert "2 runs: 2 finished" in out
    assert len(rows(there, METRICS)) > 0
    assert rows(here, METRICS) == rows(there, METRICS)
    own = "SELECT count(DISTINCT pid) FROM run"
    assert rows(there, own) == [(2,)] or launcher == "ray"  # Ray may use a worker twice


@pytest.mark.slow
@pytest.mark.parametrize("launcher", LAUNCHERS)
def test_a_killed_worker_loses_its_run_only_and_it_runs_again(
    launcher: str, tmp_path: Path
) -> None:
    long = ("excitation.interval_s=600", "seed=range(0,4)")  # laps of a second or more
    process = sweep(*long, f"hydra/launcher={launcher}", folder=tmp_path)
    wait(lambda: rows(tmp_path, RUNNING) or process.poll() is not None)
    pid, run_id = rows(tmp_path, RUNNING)[0]
    assert isinstance(pid, int)
    os.kill(pid, signal.SIGKILL)
    code, out, err = ended(process)
    assert code == 0, err
    assert "Traceback" not in err
    assert "4 runs: 4 finished" in out
    assert finished(tmp_path) == 4
    assert rows(tmp_path, f"SELECT status FROM run WHERE id = {run_id}") == [("interrupted",)]
    assert rows(tmp_path, "SELECT count(*) FROM run") == [(5,)]
    assert rows(tmp_path, "SELECT max(attempt) FROM run") == [(2,)]


@SUBMITIT
@pytest.mark.slow
def test_jobs_hold_no_password(tmp_path: Path, postgres: Any) -> None:
    url = postgres.new_database()
    process = sweep(
        *("seed=0,1", "hydra/launcher=submitit_local", "database=postgresql"),
        folder=tmp_path,
        SEATRIAL_DATABASE=url,
    )
    code, out, err = ended(process)
    assert code == 0, err
    assert "2 runs: 2 finished" in out
    found = subprocess.run(
        ["grep", "-rlF", "sailor:anchor", tmp_path], capture_output=True, text=True, check=False
    )
    assert (found.returncode, found.stdout) == (1, "")
