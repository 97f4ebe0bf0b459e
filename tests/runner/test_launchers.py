"""Launchers other than the basic one: real jobs, and what happens to a lost one."""

import os
import secrets
import shutil
import signal
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from hydra import compose, initialize_config_dir
from hydra.core.plugins import Plugins
from hydra.errors import MissingConfigException
from hydra.plugins.launcher import Launcher as HydraLauncher

from seatrial.runner.configuration.hydra_errors import CONF, one_line
from tests.runner.command import Command
from tests.runner.programs import METRICS, belonging_to, ended, rows, sweep, wait

SUBMITIT = pytest.mark.skipif(
    find_spec("submitit") is None, reason="no submitit: pip install -e '.[slurm]'"
)
NO_RAY = pytest.mark.skipif(find_spec("ray") is None, reason="no ray here: make ray")
LAUNCHERS = [
    pytest.param("submitit_slurm", marks=[SUBMITIT, pytest.mark.slow]),
    pytest.param("ray", marks=[pytest.mark.ray, NO_RAY, pytest.mark.nightly]),
]
RUNNING = "SELECT pid, seed FROM run WHERE status = 'running'"
BASIC: Any = next(
    kind for kind in Plugins.instance().discover(HydraLauncher) if kind.__name__ == "BasicLauncher"
)


class Lost(RuntimeError):  # noqa: N818 - it stands in for another name
    """What submitit raises for a job that leaves no result."""


Lost.__module__, Lost.__name__ = "submitit.core.utils", "UncompletedJobError"


class Fragile(BASIC):
    """Runs the first job of a batch and loses the others, `losses` times; then runs them all."""

    def __init__(self, losses: int) -> None:
        super().__init__()
        self.losses = losses

    def launch(self, job_overrides: Any, initial_job_idx: int) -> Any:
        if not self.losses:
            return super().launch(job_overrides, initial_job_idx)
        self.losses -= 1
        super().launch(job_overrides[:1], initial_job_idx)
        raise Lost("job 1 has not produced any output")


class Absent(BASIC):
    def launch(self, job_overrides: Any, initial_job_idx: int) -> Any:
        raise RuntimeError("no\nscheduler")


def use(monkeypatch: pytest.MonkeyPatch, launcher: Any) -> None:
    def instantiate(self: Plugins, context: Any, function: Any, config: Any) -> Any:
        launcher.setup(hydra_context=context, task_function=function, config=config)
        return launcher

    monkeypatch.setattr(Plugins, "instantiate_launcher", instantiate)


@pytest.mark.parametrize(
    ("losses", "code", "ran", "said"),
    [
        (1, 0, [0, 1, 2, 3], "4 runs: 4 finished, 0 failed"),
        (9, 1, [0, 1, 3], "4 runs: 3 finished, 0 failed, 0 diverged, 1 not done"),
    ],
)
def test_what_a_launcher_loses_is_launched_once_more(
    seatrial: Command, monkeypatch: pytest.MonkeyPatch, losses: int, code: int, ran: list[int],
    said: str,
) -> None:  # fmt: skip
    fake = seatrial.pretend()
    use(monkeypatch, Fragile(losses))
    answer = seatrial("-m", "seed=0,1,2,3", "hydra.sweeper.max_batch_size=3")
    assert (answer.code, fake.ran) == (code, ran)
    assert said in answer.out


def test_a_launcher_that_cannot_start_is_one_line(
    seatrial: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    seatrial.pretend()
    use(monkeypatch, Absent())
    answer = seatrial("-m", "seed=0,1")
    assert (answer.code, answer.err) == (2, "seatrial: hydra/launcher=basic: no scheduler\n")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["hydra/launcher=joblib"], "is gone: use hydra/launcher=processes"),
        (["hydra/launcher=submitit_local"], "is gone: use hydra/launcher=processes"),
        (["hydra/launcher=processes", "hydra.launcher.n_jobs=0"], "got 0, expected a number of"),
        (["hydra/launcher=processes", "hydra.launcher.n_jobs=two"], "got two, expected a number"),
    ],
)
def test_a_launcher_is_refused_in_one_line(seatrial: Command, words: list[str], said: str) -> None:
    seatrial.pretend()
    assert said in seatrial.refuses("-m", "seed=0,1", *words)


@pytest.mark.parametrize(("launcher", "extra"), [("submitit_slurm", "slurm"), ("ray", "ray")])
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


@contextmanager
def ray_variables() -> Iterator[dict[str, str]]:
    """Ray with a folder and a token of its own, which tells nobody that it is used."""
    folder = Path(tempfile.mkdtemp(prefix="seatrial-ray-", dir="/tmp"))  # short: sockets lie in it
    token = folder / "token"
    token.touch(mode=0o600)
    token.write_text(secrets.token_hex(32))
    try:
        yield {
            **{"RAY_TMPDIR": str(folder), "RAY_USAGE_STATS_ENABLED": "0"},
            **{"RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN_PATH": str(token)},
            "RAY_raylet_start_wait_time_s": "120",  # 30 s are too short on a busy machine
        }
        wait(lambda: not belonging_to(f"RAY_TMPDIR={folder}"))
    finally:
        for pid in belonging_to(f"RAY_TMPDIR={folder}"):
            os.kill(pid, signal.SIGKILL)
        shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture(params=LAUNCHERS)
def launcher(request: pytest.FixtureRequest) -> Iterator[tuple[tuple[str, ...], dict[str, str]]]:
    """Options and variables of a launcher; nothing of it is running afterwards."""
    choice = f"hydra/launcher={request.param}"
    if request.param == "submitit_slurm":
        slurm = request.getfixturevalue("slurm")
        yield (choice, "hydra.launcher.partition=short"), slurm.variables
    else:  # Ray's status page is not wanted, and one machine is enough
        with ray_variables() as variables:
            yield (choice, "+hydra.launcher.ray.init.include_dashboard=false"), variables


def test_a_killed_job_loses_its_run_only_and_it_runs_again(
    launcher: tuple[tuple[str, ...], dict[str, str]], tmp_path: Path
) -> None:
    """The results are those of the basic launcher."""
    options, variables = launcher
    here, there = tmp_path / "here", tmp_path / "there"
    here.mkdir()
    there.mkdir()
    long = ("excitation.interval_s=600", "disturbance=noise", "seed=0,1")
    process = sweep(*long, *options, folder=there, **variables)
    wait(lambda: rows(there, RUNNING) or process.poll() is not None)
    pid, seed = rows(there, RUNNING)[0]
    assert isinstance(pid, int)
    os.kill(pid, signal.SIGKILL)
    code, out, err = ended(process)
    assert code == 0, err
    assert "Traceback" not in err
    assert "2 runs: 2 finished" in out
    assert sorted(rows(there, "SELECT seed, status FROM run"), key=repr) == sorted(
        [(seed, "interrupted"), (0, "finished"), (1, "finished")], key=repr
    )
    code, _, err = ended(sweep(*long, folder=here))
    assert code == 0, err
    assert rows(here, METRICS) == rows(there, METRICS) != []
