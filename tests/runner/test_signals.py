"""SIGTERM and SIGHUP end a program as Ctrl-C does: one line, and the run marked interrupted."""

import importlib
import os
import secrets
import signal
import sqlite3
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from itertools import product
from pathlib import Path
from threading import Thread
from types import SimpleNamespace

import pytest
from sqlalchemy import create_engine
from sqlalchemy.pool import NullPool

from seatrial.runner import stop_signals
from seatrial.runner.database import Logbook, liveness, logbook
from seatrial.runner.database.engine import parse
from tests.runner.command import Command
from tests.runner.programs import belonging_to, children, ended, program, rows, sweep, wait

RUNNING = "SELECT id FROM run WHERE status = 'running'"
LONG = ("excitation.interval_s=6000", "identifier=none", "evaluation=none")
LAUNCHERS = {  # their processes, and options
    "joblib": ("popen_loky_posix", ("hydra.launcher.n_jobs=2",)),
    "submitit_local": ("submitit.local._local", ()),
}
CODES = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGHUP: 129}


@pytest.mark.parametrize("number", CODES)
def test_a_trial_that_is_stopped_is_interrupted(
    seatrial: Command, monkeypatch: pytest.MonkeyPatch, number: signal.Signals
) -> None:
    fake = seatrial.pretend()
    handlers = {one: signal.getsignal(one) for one in CODES}

    class Fatal(set[int]):
        def __contains__(self, seed: object) -> bool:
            if seed == 3:
                os.kill(os.getpid(), number)
            return False

    fake.interrupted = Fatal()
    for mode in ((), ("-m",)):
        answer = seatrial(*mode, "seed=3")
        assert answer.code == CODES[number]
        assert answer.err.splitlines()[-1].startswith("seatrial: interrupted: finished runs are")
        assert "Traceback" not in answer.err
    with Logbook.read("sqlite:///results/results.db") as logbook:
        assert [run.status for run in logbook.runs()] == ["interrupted"] * 2
        assert logbook.verify().leftovers == []
    assert {one: signal.getsignal(one) for one in CODES} == handlers
    fake.interrupted = set()
    assert seatrial("seed=3").code == 0


class Dying:
    """An object whose finaliser is interrupted: Python drops what is raised there."""

    def __init__(self, number: int) -> None:
        self._number = number

    def __del__(self) -> None:
        _stop(self._number)


def _stop(number: int) -> None:
    os.kill(os.getpid(), number)
    time.sleep(0.01)


def finalise(number: int) -> None:
    dying = [Dying(number)]
    dying.clear()


def swallow(number: int) -> None:
    with suppress(BaseException):
        _stop(number)


def import_module(number: int) -> None:
    """An import that is ended leaves half a module behind."""
    Path("stopping.py").write_text(f"import os, time\nos.kill({os.getpid()}, {number})\n{REST}")
    assert importlib.import_module("stopping").whole


REST = "time.sleep(0.1)\nwhole = True\n"


def close_connection(number: int) -> None:
    """SQLAlchemy logs whatever is raised there with its traceback."""

    class Connection(sqlite3.Connection):
        def close(self) -> None:
            _stop(number)
            super().close()

    engine = create_engine("sqlite://", creator=lambda: Connection(":memory:"), poolclass=NullPool)
    engine.connect().close()


@pytest.mark.parametrize("number", CODES)
@pytest.mark.parametrize("moment", [finalise, swallow, import_module, close_connection])
def test_a_signal_is_neither_lost_nor_told_with_a_traceback(
    seatrial: Command,
    monkeypatch: pytest.MonkeyPatch,
    moment: Callable[[int], None],
    number: signal.Signals,
) -> None:
    monkeypatch.setattr(stop_signals, "LOST_S", 0.3)
    monkeypatch.syspath_prepend(seatrial.folder)
    monkeypatch.delitem(sys.modules, "stopping", raising=False)
    fake = seatrial.pretend()

    class Fatal(set[int]):
        def __contains__(self, seed: object) -> bool:
            moment(number)
            time.sleep(10.0)
            return False

    fake.interrupted = Fatal()
    answer = seatrial("seed=3")
    assert answer.code == CODES[number], answer.err
    assert answer.err.splitlines()[-1].startswith("seatrial: interrupted: finished runs are")
    assert "Traceback" not in answer.err


def test_a_run_that_is_stopped_as_it_begins_is_interrupted(
    seatrial: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between its claim in the database and the note of it in the program."""

    class Long(set[int]):
        def __contains__(self, seed: object) -> bool:
            time.sleep(10.0)
            return False

    def monotonic() -> float:
        if rows(seatrial.folder, RUNNING):
            _stop(signal.SIGINT)
        return time.monotonic()

    seatrial.pretend().interrupted = Long()
    monkeypatch.setattr(logbook, "time", SimpleNamespace(monotonic=monotonic))
    answer = seatrial("seed=3")
    assert answer.code == 130
    assert answer.err.splitlines()[-1].startswith("seatrial: interrupted: finished runs are")
    assert rows(seatrial.folder, "SELECT status FROM run") == [("interrupted",)]


def test_a_heartbeat_that_has_not_started_is_stopped() -> None:
    heartbeat = liveness.Heartbeat(create_engine("sqlite://"), parse("sqlite:///results.db"))
    heartbeat._thread = Thread()
    heartbeat.stop()


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("launcher", ["basic", "joblib"])
def test_a_program_that_is_stopped_ends_in_one_line(
    tmp_path: Path, number: signal.Signals, launcher: str
) -> None:
    many = ("seed=0,1", f"hydra/launcher={launcher}", "hydra.sweep.dir=.")
    process = sweep(*LONG, *many, folder=tmp_path)
    wait(lambda: rows(tmp_path, RUNNING) or process.poll() is not None)
    process.send_signal(number)
    code, _, err = ended(process)
    assert code == CODES[number], err
    lines = [line for line in err.splitlines() if "seatrial: " in line]
    assert lines == [
        "seatrial: interrupted: finished runs are kept, the same command runs the rest"
    ]
    assert "Traceback" not in err
    assert rows(tmp_path, RUNNING) == []
    assert rows(tmp_path, "SELECT DISTINCT status FROM run") == [("interrupted",)]


SHIELDED = """
import time
from seatrial.runner.stop_signals import shielded_children
try:
    with shielded_children():
        print("ready", flush=True)
        time.sleep(20.0)
except KeyboardInterrupt:
    print("interrupted")
"""


def test_a_program_that_was_suspended_still_stops(tmp_path: Path) -> None:
    process = program("-c", SHIELDED, folder=tmp_path)
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    process.send_signal(signal.SIGSTOP)
    time.sleep(0.3)
    process.send_signal(signal.SIGCONT)
    process.send_signal(signal.SIGINT)
    began = time.monotonic()
    assert ended(process) == (0, "interrupted\n", "")
    assert time.monotonic() - began < 10.0


@pytest.mark.slow
def test_a_program_without_a_terminal_may_ignore_the_hangup(tmp_path: Path) -> None:
    code = (
        "import signal, sys, os; signal.signal(signal.SIGHUP, signal.SIG_IGN);"
        "os.execv(sys.executable, [sys.executable, '-m', 'runner', *sys.argv[1:]])"
    )
    process = program("-c", code, *LONG[1:], "excitation.interval_s=600", folder=tmp_path)
    wait(lambda: rows(tmp_path, RUNNING) or process.poll() is not None)
    process.send_signal(signal.SIGHUP)
    assert ended(process)[0] == 0
    assert rows(tmp_path, "SELECT status FROM run") == [("finished",)]


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
@pytest.mark.parametrize(
    ("launcher", "later_s"),
    [*product(("joblib",), (0.0, 1.0, 2.0)), *product(("submitit_local",), (0.0, 6.0))],
)
def test_a_signal_of_the_terminal_to_all_workers_is_one_line(
    tmp_path: Path, number: signal.Signals, launcher: str, later_s: float
) -> None:
    """Workers that are still importing print no traceback, nor do those who wait for them."""
    workers, options = LAUNCHERS[launcher]
    many = ("seed=range(0,4)", f"hydra/launcher={launcher}", *options)
    process = sweep(*LONG, *many, "hydra.sweep.dir=.", folder=tmp_path)
    wait(
        lambda: (
            any(workers in command for _, command in children(process.pid))
            or process.poll() is not None
        )
    )
    time.sleep(later_s)
    os.killpg(process.pid, number)
    code, _, err = ended(process)
    assert code == CODES[number], err
    assert "Traceback" not in err
    assert err.splitlines()[-1].startswith("seatrial: interrupted: finished runs are kept")
    assert rows(tmp_path, RUNNING) == []


@pytest.mark.slow
def test_workers_end_after_the_sweep_was_killed(tmp_path: Path) -> None:
    """Also those that have had no trial: four workers, two trials."""
    variable = f"SEATRIAL_KILLED={secrets.token_hex(8)}"
    many = ("seed=0,1", "hydra/launcher=joblib", "hydra.launcher.n_jobs=4")
    name, _, value = variable.partition("=")
    with sweep(*LONG, *many, folder=tmp_path, **{name: value}) as process:
        wait(lambda: len(rows(tmp_path, RUNNING)) == 2 or process.poll() is not None)
        assert sum("popen_loky" in command for _, command in children(process.pid)) == 4
        process.kill()
        assert process.wait() == -signal.SIGKILL
        wait(lambda: not belonging_to(variable))
