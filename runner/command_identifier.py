"""An identifier that is a command: another program, in any language, finds the coefficients."""

import os
import shlex
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from seatrial.models.errors import ConfigurationError, PartError
from seatrial.models.identification.problem import Identified, Identifier, Problem
from seatrial.models.ranges import Positive, check_ranges
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag
from seatrial.runner.exchange_files import Format, identified, read_answer, write_problem

PRIVATE = ("SEATRIAL_DATABASE",)  # variables that the program has no need to know
# A pipe that is closed without a word is that of a process that was killed.
WATCH = "import os, sys; sys.stdin.read() or os.killpg(int(sys.argv[1]), 9)"
TAIL = 2000  # bytes of its messages that are read
SHOWN = 200  # characters of its last message


@dataclass(frozen=True)
class CommandIdentifier(Identifier):
    """Runs a command in the working folder, with the folder of the problem as its last argument.

    `limit_s` [s] is the longest time that it may take.
    """

    command: tuple[str, ...] | None = None
    limit_s: Positive = 600.0
    recording: Format = "parquet"
    files: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        check_ranges(self)

    def check(self, nominal: Vessel, thruster: SecondOrderLag | None, measured: bool) -> None:
        """Raise ConfigurationError for a command that is not installed, and for missing files."""
        if not self.command:
            raise ConfigurationError(
                "identifier.command: got none, expected a list such as [python, fit.py]"
            )
        if shutil.which(self.command[0]) is None:
            raise ConfigurationError(
                f"identifier.command: got {self.command[0]!r}, expected a program that is installed"
            )
        for name in self.files:
            if not Path(name).is_file():
                raise ConfigurationError(f"identifier.files: got {name!r}, expected a file")

    def identify(self, problem: Problem, rng: np.random.Generator) -> Identified:
        """The nominal model with the coefficients of the program; raises PartError."""
        with TemporaryDirectory(prefix="seatrial-", ignore_cleanup_errors=True) as name:
            folder = Path(name)
            write_problem(folder, problem, int(rng.integers(2**31)), self.recording)
            try:
                self._run(folder)
                return identified(read_answer(folder, problem.nominal), problem.nominal)
            except PartError as error:
                raise PartError(f"{shlex.join(self.command or ())}: {error}") from error

    def _run(self, folder: Path) -> None:
        """Run the command until it ends, or the limit; nothing that it started remains."""
        messages = folder / "messages.txt"
        environment = {name: text for name, text in os.environ.items() if name not in PRIVATE}
        with messages.open("wb") as output:
            try:
                process = subprocess.Popen(
                    [*(self.command or ()), str(folder)],
                    stdin=subprocess.DEVNULL, stdout=output, stderr=output,
                    env=environment, start_new_session=True,
                )  # fmt: skip
            except OSError as error:
                raise PartError(f"cannot be started: {error.strerror}") from error
            try:
                with _ended_with_this_process(process.pid):
                    code = process.wait(self.limit_s)
            except subprocess.TimeoutExpired:
                raise PartError(
                    f"took longer than identifier.limit_s = {self.limit_s:g} s"
                ) from None
            finally:
                _end(process)
        if code:
            ended = f"exit code {code}" if code > 0 else f"ended by signal {-code}"
            raise PartError(f"{ended}: {_last_line(messages)}")


@contextmanager
def _ended_with_this_process(group: int) -> Iterator[None]:
    """Let another process end a group of processes if this one is killed, as a worker may be."""
    watch = subprocess.Popen(
        [sys.executable, "-I", "-S", "-c", WATCH, str(group)],
        stdin=subprocess.PIPE, start_new_session=True,
    )  # fmt: skip
    try:
        yield
    finally:
        watch.communicate(b"ended")


def _end(process: "subprocess.Popen[bytes]") -> None:
    """End all processes of the command's group, and wait for the command."""
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _last_line(messages: Path) -> str:
    """Return the last line that the program has printed."""
    with messages.open("rb") as file:
        file.seek(max(0, messages.stat().st_size - TAIL))
        lines = file.read().decode(errors="replace").split("\n")
    said = [" ".join(line.split()) for line in lines if line.strip()]
    return said[-1][:SHOWN] if said else "no message"
