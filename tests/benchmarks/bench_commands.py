"""CPU seconds of the commands of a newcomer: on an empty cache, for other parts, and warm.

User and system time of a process and its children on one core; warm commands the least of three.
About five minutes.
"""

import resource
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.runner.programs import ROOT, completed

NONE = ("disturbance=noise", "identifier=none", "evaluation=none")
# The first trial of another part once the default trial is compiled: CPU seconds asked.
PARTS = {
    "vessel=cybership2": 5.0, "vessel=mariner": 5.0, "vessel=kvlcc2": 5.0, "vessel=otter": 5.0,
    "vessel=remus100": 9.0, "vessel=beluga_full": 9.0, "controller=lqi": 5.0,
    "excitation=prbs": 5.0,
}  # fmt: skip
TURNS = 3


class Commands:
    """Commands in a folder, with a cache folder of their own, on one core."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.seed = folder, 0
        self.variables = {
            "SEATRIAL_CACHE": str(folder / "cache"), "PYTHONPATH": str(ROOT),
            "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1",
        }  # fmt: skip

    def spent(self, module: str, *arguments: str) -> float:
        """CPU time of `python -m MODULE ARGUMENTS` [s]."""
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = completed(
            sys.executable, "-m", module, *arguments, folder=self.folder, **self.variables
        )
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        assert done.returncode == 0, done.stderr
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    def trial(self, *arguments: str) -> float:
        """CPU time of a trial that is not stored yet [s]."""
        self.seed += 1
        return self.spent("seatrial.runner", *arguments, f"seed={self.seed}")


def _row(seconds: float, asked: float, more: str = "") -> dict[str, Any]:
    over = seconds - asked
    short = {"short": f"{over:.1f} s more"} if over > 0.05 else {}
    return {
        "shown": f"{seconds:.1f} s{more}", "limit": f"{asked:g} s", "seconds": seconds
    } | short  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def bytecode() -> None:
    """Write the bytecode of packages and sources, as an installation does."""
    completed(sys.executable, "-m", "compileall", "-q", sys.prefix, ROOT)


@pytest.fixture(scope="module")
def commands(tmp_path_factory: pytest.TempPathFactory) -> Commands:
    """Commands that begin on an empty cache."""
    return Commands(tmp_path_factory.mktemp("commands"))


def test_first_times(stated: Callable[..., None], commands: Commands, tmp_path: Path) -> None:
    def work() -> dict[str, dict[str, Any]]:
        first = Commands(tmp_path).trial(*NONE)
        found = {f"{' '.join(NONE)}, empty cache": _row(first, 20.0)}
        found["the default trial, empty cache"] = _row(commands.trial(), 40.0)
        for part, asked in PARTS.items():
            cold = commands.trial(part)
            warm = min(commands.trial(part), commands.trial(part))
            more = f" beside {warm:.1f} s once compiled"
            found[f"{part}, first time: compiling"] = _row(cold - warm, asked, more)
        return found

    why = (
        "a first vessel in six degrees of freedom compiles its equation of motion for the loop, the"
        " free run and packs; one copy behind an address made the ferry's lap 14 to 18 % longer"
    )
    stated(work, item="8a", what="CPU", why=why, note="user and system time, one core")


def test_compiled(stated: Callable[..., None], commands: Commands) -> None:
    def work() -> dict[str, dict[str, Any]]:
        commands.trial("identifier=ls")
        runner, results = "seatrial.runner", "seatrial.runner.compare"
        repeated = ("identifier=ls", f"seed={commands.seed}")
        found = {}
        for name, command, asked in (
            ("a new trial, identifier=ls", lambda: commands.trial("identifier=ls"), 2.5),
            ("a stored trial asked again", lambda: commands.spent(runner, *repeated), 1.5),
            ("seatrial-results table", lambda: commands.spent(results, "table"), 1.1),
            ("seatrial --help", lambda: commands.spent(runner, "--help"), 0.8),
        ):
            found[name] = _row(min(command() for _ in range(TURNS)), asked)
        return found

    note = "least of three, all compiled; a machine with other work takes about a fifth longer"
    why = "imports (SciPy, Hydra, SQLAlchemy, Typer) are half of a trial, and more of a table"
    stated(work, item="8b", what="CPU", note=note, why=why)
