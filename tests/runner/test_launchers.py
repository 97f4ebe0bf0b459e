"""Launchers other than the basic one and joblib: real jobs, and what happens to a killed one."""

import os
import secrets
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from hydra import compose, initialize_config_dir
from hydra.core.plugins import Plugins
from hydra.errors import MissingConfigException
from hydra.plugins.launcher import Launcher as HydraLauncher

from seatrial.runner.hydra_errors import CONF, one_line
from tests.runner.command import Command
from tests.runner.programs import METRICS, belonging_to, ended, finished, rows, sweep, wait

SUBMITIT = pytest.mark.skipif(
    find_spec("submitit") is None, reason="no submitit: pip install -e '.[slurm]'"
)
NO_RAY = pytest.mark.skipif(find_spec("ray") is None, reason="no ray here: make ray")
LAUNCHERS = [
    pytest.param("submitit_local", marks=SUBMITIT),
    pytest.param("submitit_slurm", marks=SUBMITIT),
    pytest.param("ray", marks=[pytest.mark.ray, NO_RAY]),
]
# Ray's status page is not wanted, and one machine is enough.
RAY_OPTIONS = ("+hydra.launcher.ray.init.include_dashboard=false",)
RUNNING = "SELECT pid, id FROM run WHERE status = 'running'"
ATTEMPTS = "SELECT seed, attempt, status FROM run ORDER BY 1, 2"


class Lost(RuntimeError):  # noqa: N818 - it stands in for another name
    """What submitit raises for a job that leaves no result."""


Lost.__module__, Lost.__name__ = "submitit.core.utils", "UncompletedJobError"


BASIC: Any = next(
    kind for kind in Plugins.instance().discover(HydraLauncher) if kind.__name__ == "BasicLauncher"
)


class Fragile(BASIC):
    """Runs the first job of a batch and loses the others, `losses` times; then runs them all."""

    losses = 1

    def launch(self, job_overrides: Any, initial_job_idx: int) -> Any:
        if not self.losses:
            return super().launch(job_overrides, initial_job_idx)
        self.losses -= 1
        super().launch(job_overrides[:1], initial_job_idx)
        raise Lost("job 1 has not produced any output")


@dataclass(frozen=True)
class Launcher:
    """How a sweep is told to use a launcher, and what its environment holds."""

    name: str
    options: tuple[str, ...]
    variables: dict[str, str]

    def sweep(self, *arguments: str, folder: Path) -> "subprocess.Popen[str]":
        choice = f"hydra/launcher={self.name}"
        return sweep(*arguments, choice, *self.options, folder=folder, **self.variables)


@pytest.fixture(params=LAUNCHERS)
def launcher(request: pytest.FixtureRequest) -> Iterator[Launcher]:
    """A launcher with all it needs; nothing of it is running afterwards."""
    name = request.param
    if name == "submitit_slurm":
        slurm = request.getfixturevalue("slurm")
        yield Launcher(name, ("hydra.launcher.partition=short",), slurm.variables)
    elif name == "ray":
        with ray_variables() as variables:
            yield Launcher(name, RAY_OPTIONS, variables)
    else:
        yield Launcher(name, (), {})


@contextmanager
def ray_variables() -> Iterator[dict[str, str]]:
    """Ray with a folder and a token of its own, which tells nobody that it is used."""
    folder = Path(tempfile.mkdtemp(prefix="seatrial-ray-", dir="/tmp"))  # short: sockets lie in it
    token = folder / "token"
    token.touch(mode=0o600)
    token.write_text(secrets.token_hex(32))
    try:
        yield {
            "RAY_TMPDIR": str(folder),
            "RAY_AUTH_MODE": "token",
            "RAY_AUTH_TOKEN_PATH": str(token),
            "RAY_USAGE_STATS_ENABLED": "0",
            "RAY_raylet_start_wait_time_s": "120",  # 30 s are too short on a busy machine
        }
        wait(lambda: not belonging_to(f"RAY_TMPDIR={folder}"))
    finally:
        for pid in belonging_to(f"RAY_TMPDIR={folder}"):
            os.kill(pid, signal.SIGKILL)
        shutil.rmtree(folder, ignore_errors=True)


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
        f"hydra/launcher={launcher} is not installed: pip install 'seatrial[{extra}]'"
    )


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
def test_two_jobs_compute_the_same_as_here(launcher: Launcher, tmp_path: Path) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    here.mkdir()
    there.mkdir()
    noisy = ("disturbance=noise", "seed=0,1")
    code, _, err = ended(sweep(*noisy, folder=here))
    assert code == 0, err
    code, out, err = ended(launcher.sweep(*noisy, folder=there))
    assert code == 0, err
    assert "2 runs: 2 finished" in out
    assert len(rows(there, METRICS)) > 0
    assert rows(here, METRICS) == rows(there, METRICS)
    own = "SELECT count(DISTINCT pid) FROM run"
    assert rows(there, own) == [(2,)] or launcher.name == "ray"  # Ray may use a worker twice


@pytest.mark.slow
def test_a_killed_worker_loses_its_run_only_and_it_runs_again(
    launcher: Launcher, tmp_path: Path
) -> None:
    long = ("excitation.interval_s=600", "seed=range(0,4)")  # laps of a second or more
    process = launcher.sweep(*long, folder=tmp_path)
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
def test_jobs_read_the_address_and_hold_no_password(tmp_path: Path, postgres: Any) -> None:
    url = postgres.new_database().replace("sailor", "sailor:anchor")
    process = sweep(
        *("seed=0,1", "hydra/launcher=submitit_local", "database=postgresql"),
        folder=tmp_path,
        SEATRIAL_DATABASE=url,
        PGPASSWORD="",
    )
    code, out, err = ended(process)
    assert code == 0, err
    assert "2 runs: 2 finished" in out
    found = subprocess.run(
        ["grep", "-rlF", "sailor:anchor", tmp_path], capture_output=True, text=True, check=False
    )
    assert (found.returncode, found.stdout) == (1, "")
