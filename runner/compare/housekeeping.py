"""What keeps a logbook in order: repeating what failed, deleting what is old, checking the rest."""

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Sequence
from datetime import timedelta
from pathlib import Path

from seatrial.models.errors import ConfigurationError, LogbookError
from seatrial.runner.compare.grid import Grid, Scalar, grid_of, one_line
from seatrial.runner.compare.results import Results
from seatrial.runner.compare.runs import repeat_command, runs_of
from seatrial.runner.database.engine import Address
from seatrial.runner.database.logbook import Logbook
from seatrial.runner.database.records import RunSummary
from seatrial.runner.invocation import trial_program
from seatrial.runner.vocabulary import GROUPS, LOST

MINUTES = {"m": 1, "h": 60, "d": 24 * 60, "w": 7 * 24 * 60}
PRUNED = (*LOST, "finished")


def retry_commands(results: Results, where: str | None, statuses: Sequence[str]) -> list[str]:
    """One line for a shell a trial whose last attempt has one of the statuses, oldest first."""
    _only(statuses, LOST)
    found = [run for run in runs_of(results, where, statuses) if not run.superseded]
    return [
        repeat_command(
            results.reader.run(run.run_id).overrides, results.reader.address.path, rerun=False
        )
        for run in reversed(found)
    ]


def execute_all(commands: Sequence[str], address: Address) -> int:
    """Starts the commands one after the other; 0 where all succeeded, else 1.

    They find the address of a PostgreSQL logbook in SEATRIAL_DATABASE.
    """
    environment = dict(os.environ)
    if not address.sqlite:
        environment["SEATRIAL_DATABASE"] = address.url.render_as_string(hide_password=False)
    failed = 0
    for number, line in enumerate(commands, 1):
        print(f"{number} of {len(commands)}: {line}", file=sys.stderr, flush=True)
        arguments = shlex.split(line.removeprefix(trial_program()))
        program = [sys.executable, "-m", "seatrial.runner"]
        failed += (
            subprocess.run([*program, *arguments], check=False, env=environment).returncode != 0
        )
    print(f"{len(commands) - failed} of {len(commands)} finished", file=sys.stderr)
    return 1 if failed else 0


def age(text: str) -> timedelta:
    """A duration such as 30d; raises ConfigurationError for anything else."""
    match = re.fullmatch(r"(\d{1,6})([mhdw])", text.strip())
    if match is None:
        raise ConfigurationError(
            f"--older-than: got {text!r}, expected an age such as 30d, 12h, 2w"
        )
    return timedelta(minutes=MINUTES[match[2]] * int(match[1]))


def prunable(
    results: Results, older_than: str | None, statuses: Sequence[str], where: str | None
) -> tuple[list[int], Grid]:
    """The numbers of the runs that would be deleted, and a table of them."""
    if older_than is None and not statuses and where is None:
        raise ConfigurationError(
            "prune: expected --older-than, --status or --where, or --orphans; got none"
        )
    _only(statuses, PRUNED)
    condition = results.where(where)
    clauses = [] if condition is None else [results.names.clause(condition)]
    found = results.reader.prunable(
        *clauses, older_than=age(older_than) if older_than else None, statuses=statuses
    )
    return [run.run_id for run in found], _runs_grid(found)


def _runs_grid(found: Sequence[RunSummary]) -> Grid:
    headers = ("id", "status", *GROUPS, "seed", "started_at", "series", "error")
    rows = [
        [
            *(run.run_id, run.status, *(getattr(run, name) for name in GROUPS), run.seed),
            *(f"{run.started_at:%Y-%m-%d %H:%M}", run.series, one_line(run.error or "", 60)),
        ]
        for run in found
    ]
    files = sum(run.series for run in found)
    return grid_of(f"{len(found)} runs with {files} files", headers, rows, labels=len(headers))


def delete(address: Address, results_dir: Path, run_ids: Sequence[int]) -> str:
    """Deletes runs with their rows and files; what was done, in a line."""
    with Logbook.open(address.url, results_dir=results_dir, create=False) as logbook:
        pruned = logbook.prune(run_ids)
    kept = len(run_ids) - pruned.runs
    text = f"deleted {pruned.runs} runs and {pruned.files} files"
    text += f"; {kept} are under way again and were left alone" if kept else ""
    if pruned.left:
        raise LogbookError(f"{text}; could not delete {', '.join(pruned.left)}")
    return text


def scrub(address: Address, results_dir: Path) -> str:
    """Removes the passwords that older versions stored; what was done, in a line."""
    with Logbook.open(address.url, results_dir=results_dir, create=False) as logbook:
        rows = logbook.scrub()
    if not rows:
        return "no password is stored in any row"
    return (
        f"removed passwords from {rows} rows; backups and exports made before still hold them:"
        " change the password"
    )


def require_no_choice(*choices: object) -> None:
    """Raises ConfigurationError where --orphans is given with a choice of runs."""
    if any(choices):
        raise ConfigurationError(
            "prune: expected --orphans alone, or --older-than, --status and --where"
        )


def leftovers(results: Results) -> tuple[int, Grid]:
    """How many series files no run knows, and a table of them."""
    found = results.reader.orphans()
    rows: list[list[Scalar]] = [[str(path), path.stat().st_size] for path in found if path.exists()]
    title = f"{len(found)} files that no run knows"
    return len(found), grid_of(title, ("file", "bytes"), rows, labels=2)


def delete_leftovers(address: Address, results_dir: Path) -> str:
    """Deletes the series files that no run knows; what was done, in a line."""
    with Logbook.open(address.url, results_dir=results_dir, create=False) as logbook:
        return f"deleted {len(logbook.remove_orphans())} files"


def verification(results: Results) -> tuple[bool, Grid]:
    """Whether all is whole, and a table of what is not, and of what killed programs have left.

    Its title says what was checked.
    """
    found = results.reader.verify()
    rows = [[problem.where, problem.what] for problem in found.problems]
    rows += [[str(path), "left over: no run knows this file"] for path in found.leftovers]
    verdict = f"{len(found.problems)} problems" if found.problems else "all whole"
    if found.leftovers:
        verdict += f", {len(found.leftovers)} files left over (prune --orphans)"
    title = f"checked {found.runs} runs and {found.series} series files: {verdict}"
    return not found.problems, grid_of(title, ("where", "problem"), rows, labels=2)


def _only(statuses: Sequence[str], known: Sequence[str]) -> None:
    for status in statuses:
        if status not in known:
            raise ConfigurationError(
                f"--status: got {status!r}, expected one of {', '.join(known)}"
            )
