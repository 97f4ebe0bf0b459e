"""Sweeps as programs of their own, which tests may kill, and what they leave in the logbook."""

import os
import sqlite3
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
# A lap of the ferry that takes some tenths of a second.
TRIALS = ("identifier=none", "evaluation=none")

METRICS = (
    "SELECT identifier, disturbance, run.seed, stage, model, dof, name, value "
    "FROM metric JOIN run ON run.id = run_id ORDER BY 1, 2, 3, 4, 5, 6, 7"
)


def patched(folder: Path, code: str) -> dict[str, str]:
    """The variables of a program that imports this code at its start, in workers as well."""
    folder.mkdir(exist_ok=True)
    (folder / "sitecustomize.py").write_text(code)
    return {"PYTHONPATH": f"{folder}{os.pathsep}{ROOT}", "NOTES": str(folder)}


def program(*arguments: str, folder: Path, **variables: str) -> subprocess.Popen[str]:
    """`python ARGUMENTS` in a folder, in a process group of its own."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), **variables}
    environment.pop("HYDRA_FULL_ERROR", None)
    return subprocess.Popen(
        [sys.executable, *arguments], cwd=folder, env=environment, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip


def completed(
    *command: str | Path, folder: Path = ROOT, **variables: str
) -> subprocess.CompletedProcess[str]:
    """A command that has ended, with what it has said."""
    environment = os.environ | variables
    return subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


def sweep(*arguments: str, folder: Path, **variables: str) -> subprocess.Popen[str]:
    """A sweep of small trials."""
    return program("-m", "runner", "-m", *TRIALS, *arguments, folder=folder, **variables)


def ended(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    """Exit code, standard output and standard error, once the program has ended."""
    out, err = process.communicate(timeout=240)
    return process.returncode, out, err


def rows(folder: Path, query: str) -> list[tuple[object, ...]]:
    """The answer of the logbook in a folder; nothing where there is none yet."""
    file = folder / "results" / "results.db"
    if not file.exists():
        return []
    connection = sqlite3.connect(f"file:{file}?mode=ro", uri=True, timeout=30.0)
    try:
        return connection.execute(query).fetchall()
    except sqlite3.OperationalError:  # the schema is not there yet
        return []
    finally:
        connection.close()


def finished(folder: Path) -> int:
    """How many runs have finished."""
    return len(rows(folder, "SELECT id FROM run WHERE status = 'finished'"))


def wait(condition: Callable[[], object], longest_s: float = 120.0) -> None:
    """Wait until a condition holds."""
    deadline = time.monotonic() + longest_s
    while not condition():
        assert time.monotonic() < deadline, f"not in {longest_s:.0f} s"
        time.sleep(0.05)


def children(pid: int) -> Iterator[tuple[int, str]]:
    """Child processes of a process: number and command line."""
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit():
            try:
                parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
                command = (folder / "cmdline").read_text().replace("\0", " ")
            except OSError:
                continue
            if parent == pid:
                yield int(folder.name), command


def belonging_to(variable: str) -> list[int]:
    """Processes started with this environment variable, `NAME=value`, other than this one."""
    found = []
    for folder in Path("/proc").iterdir():
        if folder.name.isdigit() and int(folder.name) != os.getpid():
            try:
                variables = (folder / "environ").read_bytes()
            except OSError:  # it has ended, or is somebody else's
                continue
            if variable.encode() in variables.split(b"\0"):
                found.append(int(folder.name))
    return found
