"""Command lines run in forks of this process, with limits of time and memory.

A fork starts in some milliseconds with everything imported, so hundreds of command lines are
cheap. Each has a folder of its own, which is its working directory.
"""

import ctypes
import os
import resource
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

PROCESSOR_S = 40.0
WALL_S = 120.0
MEMORY = 2 << 30  # bytes of address space, beyond what the process has when it begins
OUTPUT = 64 << 20  # bytes that a command may write to one file
SIDE_BY_SIDE = 2
PR_SET_PDEATHSIG = 1  # of Linux: a signal to a fork at the end of this process
Program = Literal["seatrial", "seatrial-results"]


@dataclass(frozen=True)
class Order:
    """A command line, and what is in its folder before it starts."""

    program: Program
    arguments: tuple[str, ...]
    prepare: Callable[[Path], None]
    variables: tuple[tuple[str, str], ...] = ()

    def __str__(self) -> str:
        return ascii([self.program, *self.arguments])


@dataclass(frozen=True)
class Answer:
    """What a command left behind: exit code, output, time and new files."""

    order: Order
    folder: Path
    code: int  # the negative number of a signal that ended it
    out: bytes
    err: bytes
    seconds: float
    new: tuple[str, ...]


@dataclass(frozen=True)
class _Child:
    number: int
    order: Order
    folder: Path
    before: frozenset[str]
    began: float


def preload() -> None:
    """Import what the commands need, so that the forks need not; starts no threads."""

    import seatrial.runner.__main__
    import seatrial.runner.compare.__main__
    import seatrial.runner.compare.commands
    import seatrial.runner.compare.comparison_table
    import seatrial.runner.compare.housekeeping
    import seatrial.runner.compare.logbook_commands
    import seatrial.runner.compare.plots
    import seatrial.runner.compare.report
    import seatrial.runner.compare.runs
    import seatrial.runner.trial  # noqa: F401
    from seatrial.runner.provenance import collect

    collect()


def run(orders: Sequence[tuple[int, Order]], folder: Path) -> Iterator[tuple[int, Answer]]:
    """Run numbered orders, some side by side, each in a folder of its own; in any order."""
    waiting = list(reversed(orders))
    running: dict[int, _Child] = {}
    while waiting or running:
        while waiting and len(running) < SIDE_BY_SIDE:
            number, order = waiting.pop()
            own = folder / f"{number:04d}"
            own.mkdir()
            order.prepare(own)
            before = frozenset(_files(own))
            running[_fork(order, own)] = _Child(number, order, own, before, time.monotonic())
        pid, status = os.waitpid(-1, os.WNOHANG)
        if pid in running:
            child = running.pop(pid)
            yield child.number, _answer(child, os.waitstatus_to_exitcode(status))
            continue
        for number, child in running.items():
            if time.monotonic() - child.began > WALL_S:
                os.kill(number, signal.SIGKILL)
        time.sleep(0.005)


def _files(folder: Path) -> Iterator[str]:
    for path in folder.rglob("*"):
        if not path.is_dir():
            yield str(path.relative_to(folder))


def _answer(child: _Child, code: int) -> Answer:
    out, err = (child.folder.with_suffix(end) for end in (".out", ".err"))
    new = tuple(sorted(set(_files(child.folder)) - child.before))
    seconds = time.monotonic() - child.began
    said = out.read_bytes(), err.read_bytes()
    out.unlink()
    err.unlink()
    return Answer(child.order, child.folder, code, *said, seconds, new)


def _fork(order: Order, folder: Path) -> int:
    sys.stdout.flush()
    sys.stderr.flush()
    pid = os.fork()
    if pid:
        return pid
    code = 70
    try:
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        _redirect(folder)
        os.chdir(folder)
        os.environ.update(order.variables)
        os.environ.pop("HYDRA_FULL_ERROR", None)
        _limit()
        code = _call(order)
    except BaseException:
        traceback.print_exc()
    finally:
        try:
            sys.stdout.flush()
            sys.stderr.flush()
        finally:
            os._exit(code)


def _redirect(folder: Path) -> None:
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    for descriptor, end in ((1, ".out"), (2, ".err")):
        file = os.open(folder.with_suffix(end), os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(file, descriptor)
    # As a program's own: strict on output, escaping on errors, and not those of a test runner.
    sys.stdout = open(1, "w", encoding="utf-8", closefd=False)  # noqa: SIM115
    sys.stderr = open(  # noqa: SIM115
        2, "w", encoding="utf-8", errors="backslashreplace", buffering=1, closefd=False
    )


def _limit() -> None:
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    address_space = pages * resource.getpagesize() + MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (address_space, address_space))
    seconds = int(PROCESSOR_S)
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))
    resource.setrlimit(resource.RLIMIT_FSIZE, (OUTPUT, OUTPUT))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _call(order: Order) -> int:
    module = "runner" if order.program == "seatrial" else "runner.compare"
    sys.argv = [order.program, *order.arguments]
    sys.orig_argv = ["python", "-m", module, *order.arguments]
    try:
        if order.program == "seatrial":
            from seatrial.runner.__main__ import main

            return main()
        from seatrial.runner.compare.__main__ import run as results

        return results(list(order.arguments))
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else int(end.code is not None)


# The law: what a command must leave behind, however bad its input is.

CODES = (0, 1, 2)
LINE = 1000  # characters of the longest line on standard error
SQLITE_OWN = ("-wal", "-shm", "-journal")  # files of a logbook that is in use, or damaged
LINES = 5  # lines on standard error of a command that does something: failures, warnings


def broken(answer: Answer) -> str | None:
    """What a command did wrong; None if nothing. At an end by a signal, this alone is told."""
    if answer.code == -signal.SIGXCPU or answer.seconds > WALL_S:
        return f"took longer than {PROCESSOR_S:.0f} s of a processor or {WALL_S:.0f} s"
    if answer.code < 0:
        return f"was ended by {signal.Signals(-answer.code).name}"
    err = answer.err.decode("utf-8", "replace")
    lines = err.splitlines()
    if "Traceback (most recent call last)" in err:
        return f"traceback: {lines[-1][:200]}"
    if answer.code not in CODES:
        return f"exit code {answer.code}: {err[:200]}"
    wrong = control_characters(answer.err)
    if wrong:
        return f"control character {wrong} in a message"
    if any(len(line) > LINE for line in lines):
        return f"a line of {max(map(len, lines))} characters: {err[:100]}..."
    if len(lines) > (1 if answer.code == 2 else LINES):
        return f"exit code {answer.code} with {len(lines)} lines: {err[:300]!r}"
    if answer.code == 2 and not lines:
        return "exit code 2 without a message"
    half = [name for name in answer.new if name.endswith(".tmp")]
    if answer.code == 2:
        half = [name for name in answer.new if not name.endswith(SQLITE_OWN)]
    return f"left behind: {', '.join(half)}" if half else None


def control_characters(text: bytes) -> str | None:
    """The first character that acts on a terminal, other than newline and tabulator."""
    for character in text.decode("utf-8", "replace"):
        point = ord(character)
        if (point < 32 and character not in "\n\t") or 127 <= point < 160:
            return f"U+{point:04X}"
    return None
