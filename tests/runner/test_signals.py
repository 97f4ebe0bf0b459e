"""SIGTERM and SIGHUP end a program as Ctrl-C does: one line, and the run marked interrupted."""

import importlib
import os
import signal
import sqlite3
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import pytest
from sqlalchemy import create_engine
from sqlalchemy.pool import NullPool

from seatrial.runner.database import LogbookWriter, logbook
from seatrial.runner.sweeps import stop_signals
from tests.runner.command import Command
from tests.runner.programs import children, ended, program, rows, sweep, wait

RUNNING = "SELECT id FROM run WHERE status = 'running'"
LINE = "seatrial: interrupted: finished runs are kept, the same command runs the rest"
CODES = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGHUP: 129}


class Whenever(set[int]):
    """Stands in for the seeds whose trials are interrupted: calls what interrupts them."""

    def __init__(self, interrupt: Callable[[], object]) -> None:
        self._interrupt = interrupt

    def __contains__(self, seed: object) -> bool:
        self._interrupt()
        return False


@pytest.mark.slow
@pytest.mark.parametrize("number", CODES)
def test_a_trial_that_is_stopped_is_interrupted(seatrial: Command, number: signal.Signals) -> None:
    fake = seatrial.pretend()
    handlers = {one: signal.getsignal(one) for one in (*CODES, signal.SIGALRM)}
    fake.interrupted = Whenever(lambda: signal.raise_signal(number))  # to this thread
    for mode in ((), ("-m",)):
        answer = seatrial(*mode, "seed=3")
        assert answer.code == CODES[number]
        assert answer.err.splitlines()[-1] == LINE
        assert "Traceback" not in answer.err
    with LogbookWriter.read("sqlite:///results/results.db") as stored:
        assert [run.status for run in stored.runs()] == ["interrupted"] * 2
        assert stored.verify().leftovers == []
    assert {one: signal.getsignal(one) for one in handlers} == handlers
    fake.interrupted = set()
    seatrial.succeeds("seed=3")


def _stop() -> None:
    signal.raise_signal(signal.SIGTERM)  # to this thread, at once


def swallow() -> None:
    with suppress(BaseException):
        _stop()


def import_module() -> None:
    """An import that is ended leaves half a module behind."""
    half = f"import signal, time\nsignal.raise_signal({signal.SIGTERM:d})\n"
    Path("stopping.py").write_text(f"{half}time.sleep(0.1)\nwhole = True\n")
    assert importlib.import_module("stopping").whole


def close_connection() -> None:
    """SQLAlchemy logs whatever is raised there with its traceback."""

    class Connection(sqlite3.Connection):
        def close(self) -> None:
            _stop()
            super().close()

    engine = create_engine("sqlite://", creator=lambda: Connection(":memory:"), poolclass=NullPool)
    engine.connect().close()


@pytest.mark.parametrize("moment", [swallow, import_module, close_connection])
def test_a_signal_is_neither_lost_nor_told_with_a_traceback(
    seatrial: Command, monkeypatch: pytest.MonkeyPatch, moment: Callable[[], None]
) -> None:
    monkeypatch.setattr(stop_signals, "LOST_S", 0.3)
    monkeypatch.syspath_prepend(seatrial.folder)
    monkeypatch.delitem(sys.modules, "stopping", raising=False)

    def interrupt() -> None:
        moment()
        time.sleep(10.0)

    seatrial.pretend().interrupted = Whenever(interrupt)
    answer = seatrial("seed=3")
    assert answer.code == 143, answer.err
    assert answer.err.splitlines()[-1] == LINE
    assert "Traceback" not in answer.err


def test_a_run_that_is_stopped_as_it_begins_is_interrupted(
    seatrial: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between its claim in the database and the note of it in the program."""

    def monotonic() -> float:
        if rows(seatrial.folder, RUNNING):
            _stop()
        return time.monotonic()

    seatrial.pretend().interrupted = Whenever(lambda: time.sleep(10.0))
    monkeypatch.setattr(logbook, "time", SimpleNamespace(monotonic=monotonic))
    answer = seatrial("seed=3")
    assert answer.code == 143
    assert answer.err.splitlines()[-1] == LINE
    assert rows(seatrial.folder, "SELECT status FROM run") == [("interrupted",)]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "to_all", "later_s"),
    [
        (signal.SIGTERM, False, 3.0),
        (signal.SIGINT, True, 0.0),
        pytest.param(signal.SIGHUP, True, 3.0, marks=pytest.mark.nightly),
    ],
)
def test_a_sweep_with_workers_ends_in_one_line(
    tmp_path: Path, number: signal.Signals, to_all: bool, later_s: float
) -> None:
    """A terminal sends its signals to the workers as well, also while they start."""
    many = ("seed=range(0,4)", "hydra/launcher=processes", "hydra.launcher.n_jobs=2")
    process = sweep("excitation.interval_s=6000", *many, folder=tmp_path)

    def starting() -> bool:
        return any("spawn_main" in command for _, command in children(process.pid))

    wait(lambda: starting() or process.poll() is not None)
    workers = [pid for pid, _ in children(process.pid)]
    time.sleep(later_s)
    (os.killpg if to_all else os.kill)(process.pid, number)
    code, _, err = ended(process)
    assert code == CODES[number], err
    assert "Traceback" not in err
    assert err.splitlines()[-1] == LINE
    assert set(rows(tmp_path, "SELECT status FROM run")) <= {("interrupted",)}
    assert not any(Path(f"/proc/{pid}/exe").exists() for pid in workers)


@pytest.mark.slow
def test_a_program_without_a_terminal_may_ignore_the_hangup(tmp_path: Path) -> None:
    code = (
        "import signal, sys, os; signal.signal(signal.SIGHUP, signal.SIG_IGN);"
        "os.execv(sys.executable, [sys.executable, '-m', 'runner', *sys.argv[1:]])"
    )
    short = ("identifier=none", "evaluation=none", "excitation.interval_s=600")
    process = program("-c", code, *short, folder=tmp_path)
    wait(lambda: rows(tmp_path, RUNNING) or process.poll() is not None)
    process.send_signal(signal.SIGHUP)
    assert ended(process)[0] == 0
    assert rows(tmp_path, "SELECT status FROM run") == [("finished",)]
