"""Kills, two writers and full disks: nothing is lost or doubled, the same command finishes."""

import os
import random
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tests.abuse.stage import Program, Stage
from tests.runner.programs import wait

SHORT = ("identifier=none", "evaluation=none", "excitation.interval_s=120")
MANY = (*SHORT, "identifier=none,ls", "disturbance=calm,noise", "seed=range(0,3)")
FEW = (*SHORT, "disturbance=noise", "seed=range(0,4)")
TWO = ("hydra/launcher=processes", "hydra.launcher.n_jobs=2")
STOPS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
INTERRUPTED = "seatrial: interrupted: finished runs are kept, the same command runs the rest"

pytestmark = pytest.mark.timeout(3600)
nightly = partial(pytest.param, marks=pytest.mark.nightly)
slow = partial(pytest.param, marks=pytest.mark.slow)


@dataclass(frozen=True)
class Calm:
    """Times [s] to the start of an undisturbed sweep and of each trial, and its metrics."""

    start_s: float
    each_s: float
    metrics: list[tuple[object, ...]]


@pytest.fixture(scope="module")
def calm(tmp_path_factory: pytest.TempPathFactory) -> Calm:
    stage = Stage(tmp_path_factory.mktemp("calm"), MANY, 12)
    began = time.monotonic()
    program = stage.sweep()
    stage.await_sweep(program)
    start_s = time.monotonic() - began
    code, _, err = program.ended()
    assert code == 0, err
    each_s = (time.monotonic() - began - start_s) / 12
    return Calm(start_s, each_s, stage.complete())


# How a sweep is killed. Each returns when the sweep and all it has started are gone.


def kill_all(stage: Stage, program: Program, chance: random.Random) -> None:
    program.send_all(signal.SIGKILL)


def kill_parent(stage: Stage, program: Program, chance: random.Random) -> None:
    """What the command has started must end by itself."""
    program.process.kill()
    program.process.wait()
    wait(lambda: not program.family(), 90.0)


def kill_child(stage: Stage, program: Program, chance: random.Random) -> None:
    """The command must go on without one of the processes that it has started."""
    others = [pid for pid in program.family() if pid != program.process.pid]
    if others:
        with suppress(ProcessLookupError):
            os.kill(chance.choice(others), signal.SIGKILL)
    code, out, err = program.ended()
    assert code == 0, (out, err)


def stop_parent(stage: Stage, program: Program, chance: random.Random) -> None:
    number = chance.choice(STOPS)
    program.process.send_signal(number)
    stopped(program, number)


def stop_all(stage: Stage, program: Program, chance: random.Random) -> None:
    """As a terminal does."""
    number = chance.choice(STOPS)
    program.send_all(number)
    stopped(program, number)


def stopped(program: Program, number: signal.Signals) -> None:
    code, out, err = program.ended()
    if "results: " in out:  # it was done before the signal came
        assert code in (0, 128 + number, -number), (code, err)
    else:
        assert code == 128 + number, (number, code, err)
        assert err.splitlines()[-1] == INTERRUPTED
    wait(lambda: not program.family(), 90.0)


KILLS = 20
BLOWS = (kill_all, kill_child, stop_all, kill_parent, stop_parent)


@pytest.mark.nightly
@pytest.mark.parametrize("launcher", [TWO, ()], ids=["processes", "basic"])
@pytest.mark.parametrize("server", [False, True])
def test_kills_leave_the_results_of_an_undisturbed_sweep(
    launcher: tuple[str, ...], server: bool, calm: Calm, tmp_path: Path,
    request: pytest.FixtureRequest,
) -> None:  # fmt: skip
    chance = random.Random(20260201)
    for first in range(0, KILLS, len(BLOWS)):
        folder = tmp_path / str(first)
        folder.mkdir()
        postgres: Any = request.getfixturevalue("postgres") if server else None
        stage = Stage(folder, (*MANY, *launcher), 12, postgres and postgres.new_database())
        finished: frozenset[str] = frozenset()
        for number, blow in enumerate(BLOWS):
            program = stage.sweep()
            try:
                if number or first % 2:  # else while it starts
                    stage.await_sweep(program)
                    time.sleep(chance.uniform(0.0, 0.6 * calm.start_s + 5.0 * calm.each_s))
                else:
                    time.sleep(chance.uniform(0.0, calm.start_s))
                blow(stage, program, chance)
            finally:
                program.send_all(signal.SIGKILL)
                program.process.wait()
            finished = stage.check(finished)
        assert stage.complete() == calm.metrics


@pytest.mark.parametrize(
    ("server", "writers"), [slow(False, 2), nightly(True, 2), nightly(False, 8), nightly(True, 8)]
)
def test_writers_at_once_share_the_trials(
    server: bool, writers: int, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    postgres: Any = request.getfixturevalue("postgres") if server else None
    stage = Stage(tmp_path, FEW, 4, postgres and postgres.new_database())
    programs = [stage.sweep() for _ in range(writers)]
    while any(program.process.poll() is None for program in programs):
        stage.check()  # a reader beside them
        time.sleep(0.5)
    for program in programs:
        code, out, err = program.ended()
        assert code == 0, (out, err)
    with stage.logbook() as logbook:
        assert logbook is not None
        assert [run.attempt for run in logbook.runs()] == [1] * 4
    stage.complete()


@contextmanager
def disk(stage: Stage, size: str) -> Iterator[Callable[[str], None]]:
    """Let the results folder be a disk of this size, which the yielded function mounts anew."""

    def mount(*arguments: str) -> str:
        said = subprocess.run(["mount", *arguments], capture_output=True, text=True, check=False)
        return said.stderr or ("failed" if said.returncode else "")

    def remount(options: str) -> None:
        assert not mount("-o", f"remount,{options}", place)

    (stage.folder / "results").mkdir()
    place = str(stage.folder / "results")
    if os.geteuid() != 0:
        pytest.skip("only root may mount a tmpfs")
    if said := mount("-t", "tmpfs", "-o", f"size={size}", "tmpfs", place):
        pytest.skip(f"mount: {said}")
    try:
        yield remount
    finally:
        subprocess.run(["umount", "--lazy", place], check=True)


@pytest.mark.parametrize("size", [slow("400k"), *map(nightly, ("4k", "64k", "256k", "640k"))])
def test_a_full_disk_loses_nothing(size: str, tmp_path: Path) -> None:
    stage = Stage(tmp_path, FEW, 4)
    with disk(stage, size) as remount:
        code, _, err = stage.sweep().ended()
        assert code in (1, 2)
        assert len(err.splitlines()) < 40, err
        finished = stage.check()
        remount("size=64m")
        stage.complete()
        assert finished <= stage.check()


@pytest.mark.nightly
def test_a_disk_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    stage = Stage(tmp_path, FEW, 4)
    with disk(stage, "64m") as remount:
        remount("ro")
        code, _, err = stage.sweep().ended()
        assert (code, err.count("\n")) == (2, 1), err
        remount("rw")
        stage.complete()
        remount("ro")
        code, out, err = stage.start("-m", "runner.compare", "runs").ended()
        assert code == 0, (out, err)
        code, _, err = stage.start("-m", "runner", *SHORT, "seed=99").ended()
        assert (code, err.count("\n")) == (2, 1), err
