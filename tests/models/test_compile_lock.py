"""One process compiles a kernel; the others wait for it, but not for one that is suspended."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from seatrial.models import compiled
from seatrial.models.compile_lock import CompileTimes

ROOT = Path(__file__).parents[2]
PACKAGE = compiled.__name__.rpartition(".")[0]

# Kernels that tell when they are being compiled, and are not ready before the test allows it.
KERNELS = '''
import logging, os, sys, time
from pathlib import Path
import numba
from numba.extending import overload
from PACKAGE import compile_lock
from PACKAGE.compiled import kernel

logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stdout)
compile_lock.BEAT_S, compile_lock.STALLED_S = 0.1, float(os.environ["STALLED_S"])
place = Path(os.environ["PLACE"])

def slowly(x): ...

@overload(slowly)
def _slowly(x):
    """What the compiler runs while it compiles a kernel: it waits for the file `go`."""
    (place / f"compiling-{os.getpid()}").touch()
    while not (place / "go").exists():
        time.sleep(0.01)
    if (place / "fail").exists():
        raise numba.TypingError("no such type")
    return lambda x: x + 1.0

@kernel
def inner(x):
    return 2.0 * x

@kernel
def slow(x):
    return slowly(inner(x))

@kernel
def quick(x):
    return x * x

def report(function):
    result = function(3.0)
    misses = sum(sum(k.stats.cache_misses.values()) for k in (slow, quick, inner))
    print("result", result, "misses", misses, flush=True)
'''.replace("PACKAGE", PACKAGE)


class Process:
    """A program with these kernels, in a process of its own."""

    def __init__(self, place: Path, program: str, stalled_s: float = 60.0) -> None:
        self.place = place
        environment = os.environ | {
            "PYTHONPATH": os.pathsep.join([str(place), str(ROOT)]),
            "SEATRIAL_CACHE": str(place / "cache"),
            "PLACE": str(place),
            "STALLED_S": str(stalled_s),
        }
        self.process = subprocess.Popen(
            [sys.executable, "-c", f"from kernels import *\n{program}"], env=environment, cwd=ROOT,
            text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip

    @property
    def pid(self) -> int:
        return self.process.pid

    def finish(self) -> str:
        out, _ = self.process.communicate(timeout=60)
        return out

    def kill(self) -> None:
        with self.process:
            self.process.kill()

    def line(self) -> str:
        """The next line that it prints."""
        assert self.process.stdout is not None
        return self.process.stdout.readline()

    def wait_until_compiling(self) -> None:
        deadline = time.monotonic() + 60.0
        while not (self.place / f"compiling-{self.pid}").exists():
            assert time.monotonic() < deadline
            assert self.process.poll() is None, self.finish()
            time.sleep(0.01)


@pytest.fixture
def place(tmp_path: Path) -> Path:
    (tmp_path / "kernels.py").write_text(KERNELS)
    return tmp_path


@pytest.fixture
def holder(place: Path) -> Iterator[Process]:
    """A process that is compiling `slow`, and does not end by itself."""
    process = Process(place, "report(slow)")
    try:
        process.wait_until_compiling()
        yield process
    finally:
        process.kill()


def test_different_kernels_are_compiled_at_once(place: Path, holder: Process) -> None:
    assert "result 9.0 misses 1" in Process(place, "report(quick)").finish()
    (place / "go").touch()
    assert "result 7.0 misses 2" in holder.finish()


def test_a_waiting_process_says_for_whom_and_then_loads(place: Path, holder: Process) -> None:
    waiting = Process(place, "report(slow)")
    line = waiting.line()
    assert line.startswith(f"waiting for process {holder.pid} ")
    assert line.endswith(" to compile kernels.slow\n")
    (place / "go").touch()
    assert "result 7.0 misses 2" in holder.finish()
    assert waiting.finish() == "result 7.0 misses 0\n"  # said once, and no word of compiling


def test_compiling_is_said_once(place: Path) -> None:
    (place / "go").touch()
    program = "report(slow)\nreport(quick)\nprint(compile_lock._stopwatch.seconds())"
    out = Process(place, program).finish()
    assert out.splitlines()[0] == "compiling (first run on this machine)"
    assert out.count("compiling") == 1
    assert float(out.split()[-1]) > 0.0
    assert Process(place, program).finish().splitlines() == [
        "result 7.0 misses 0", "result 9.0 misses 0", "0.0",
    ]  # fmt: skip


@pytest.mark.slow
def test_a_suspended_process_is_named_and_not_waited_for(place: Path, holder: Process) -> None:
    os.kill(holder.pid, signal.SIGSTOP)
    (place / "go").touch()
    out = Process(place, "report(slow)\nprint(compile_lock._stopwatch.seconds())", 1.0).finish()
    assert "result 7.0" in out
    assert f"process {holder.pid} on" in out
    assert "kernels.slow, has not responded for 1 s: compiling without the lock" in out
    seconds = float(out.split()[-1])
    assert 1.0 < seconds < 10.0
    # What it compiled is of use to the next one, and so is what the suspended one adds later.
    assert Process(place, "report(slow)", 1.0).finish() == "result 7.0 misses 0\n"
    os.kill(holder.pid, signal.SIGCONT)
    assert "result 7.0 misses 2" in holder.finish()
    assert Process(place, "report(slow)", 1.0).finish() == "result 7.0 misses 0\n"


@pytest.mark.slow
def test_a_live_process_is_waited_for_beyond_the_limit(place: Path, holder: Process) -> None:
    waiting = Process(place, "report(slow)", stalled_s=0.5)
    assert waiting.line().startswith("waiting for ")
    time.sleep(1.5)
    (place / "go").touch()
    assert "result 7.0 misses 0" in waiting.finish()


def test_a_suspended_process_delays_by_one_wait_in_all(place: Path, holder: Process) -> None:
    """It may have several locks: those of a kernel and of the kernels that this one calls."""
    os.kill(holder.pid, signal.SIGSTOP)
    (place / "go").touch()
    program = (
        "import fcntl\n"
        "other = open(compile_lock.Path(quick._cache.lock._path), 'w')\n"
        "other.write(slow._cache.lock._path.read_text().replace('slow', 'quick'))\n"
        "other.flush()\n"
        "fcntl.flock(other, fcntl.LOCK_EX)\n"
        "report(slow)\n"
        "before = compile_lock._stopwatch.seconds()\n"
        "report(quick)\n"
        "print(compile_lock._stopwatch.seconds() - before)\n"
    )
    out = Process(place, program, 1.0).finish()
    assert out.count("has not responded") == 1
    assert float(out.split()[-1]) < 1.0


@pytest.mark.parametrize(
    "number",
    [
        signal.SIGTERM,
        *(
            pytest.param(other, marks=pytest.mark.slow)
            for other in (signal.SIGINT, signal.SIGKILL, signal.SIGHUP)
        ),
    ],
)
def test_a_signal_that_ends_the_holder_releases_the_lock(
    place: Path, holder: Process, number: signal.Signals
) -> None:
    waiting = Process(place, "report(slow)")
    assert waiting.line().startswith("waiting for ")
    os.kill(holder.pid, number)
    holder.finish()
    (place / "go").touch()
    out = waiting.finish()
    assert "result 7.0 misses" in out
    assert "result 7.0 misses 0" not in out
    assert "has not responded" not in out


@pytest.mark.parametrize("error", ["numba.TypingError", "KeyboardInterrupt"])
def test_an_exception_releases_the_lock(place: Path, error: str) -> None:
    """While the process that caught it lives on."""
    program = (
        f"def fail(*arguments): raise {error}('no')\n"
        "slow._compiler.compile = fail\n"
        "try:\n"
        "    slow(3.0)\n"
        f"except {error}:\n"
        "    print('caught', flush=True)\n"
        "sys.stdin.read()\n"
    )
    process = Process(place, program)
    assert "compiling" in process.line()
    assert process.line() == "caught\n"
    (place / "go").touch()
    try:
        out = Process(place, "report(slow)", 1.0).finish()
        assert process.process.poll() is None
    finally:
        process.kill()
    assert "result 7.0 misses 2" in out
    assert "waiting" not in out
    assert "has not responded" not in out


def test_a_type_that_cannot_be_compiled_releases_the_lock(place: Path) -> None:
    """numba's own error, raised within the compilation of a kernel that calls another."""
    (place / "go").touch()
    (place / "fail").touch()
    program = (
        "try:\n"
        "    slow(3.0)\n"
        "except numba.TypingError:\n"
        "    print('depths', slow._cache.lock._depth, inner._cache.lock._depth)\n"
        "print('held', len(compile_lock._held))\n"
    )
    assert Process(place, program).finish().splitlines()[1:] == ["depths 0 0", "held 0"]


def test_two_writers_do_not_mix_up_their_code(place: Path) -> None:
    """Without the lock, two signatures saved at the same time stay two."""
    program = (
        "from numba import float64, int64\n"
        "cache = quick._cache._cache_file\n"
        "index = cache._load_index\n"
        "quick(3.0)\n"
        "before = index()\n"
        "quick(3)\n"
        "cache._save_index(before)\n"  # the index of a writer that had not seen the second
        "quick(3j)\n"
        "print('entries', len(index()), 'names', len(set(index().values())))\n"
    )
    assert "entries 2 names 2" in Process(place, program).finish()
    check = (
        "print(quick(3.0), quick(3), quick(3j))\n"
        "print('misses', sum(quick.stats.cache_misses.values()))\n"
    )
    out = Process(place, check).finish()
    assert "9.0 9 (-9+0j)" in out
    assert "misses 1" in out


def test_a_cut_off_index_is_written_again(place: Path) -> None:
    (place / "go").touch()
    Process(place, "report(quick)").finish()
    (index,) = (place / "cache").rglob("kernels.quick*.nbi")
    index.write_bytes(b"")
    assert "result 9.0 misses 1" in Process(place, "report(quick)").finish()
    assert "result 9.0 misses 0" in Process(place, "report(quick)").finish()


JOINED = "compile_lock.CompileTimes(place / 'times').join()\n"


def test_other_processes_read_how_long_one_compiles(place: Path) -> None:
    (place / "times").mkdir()
    times = CompileTimes(place / "times")
    first = Process(place, f"{JOINED}report(slow)")
    try:
        first.wait_until_compiling()
        before_s, start_s = times.total_s(), time.monotonic()
        time.sleep(0.5)
        elapsed_s = time.monotonic() - start_s
        assert times.total_s() - before_s == pytest.approx(elapsed_s, abs=0.2)  # while it compiles
        second = Process(place, f"{JOINED}report(slow)")
        second.line()  # it waits for the first
        before_s, start_s = times.total_s(), time.monotonic()
        time.sleep(0.5)
        elapsed_s = time.monotonic() - start_s
        assert times.total_s() - before_s == pytest.approx(2.0 * elapsed_s, abs=0.2)
        (place / "go").touch()
        first.finish()
        second.finish()
        total_s = times.total_s()
        time.sleep(0.1)
        assert times.total_s() == total_s  # nobody compiles any more, and nothing is forgotten
        assert total_s > 1.5
    finally:
        first.kill()


def test_a_killed_process_compiles_no_longer(place: Path) -> None:
    (place / "times").mkdir()
    times = CompileTimes(place / "times")
    process = Process(place, f"{JOINED}report(slow)")
    process.wait_until_compiling()
    assert times.total_s() > 0.0
    process.kill()
    assert times.total_s() == 0.0


def test_times_without_a_folder_are_no_error(place: Path) -> None:
    """As on another machine than that of the sweep."""
    (place / "go").touch()
    assert "result 7.0" in Process(place, f"{JOINED}report(slow)").finish()
    assert CompileTimes(place / "times").total_s() == 0.0
