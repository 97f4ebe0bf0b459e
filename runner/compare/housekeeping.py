"""Maintenance of a logbook: repeating failed trials, deleting old runs and checking files."""

import re
import shlex
import subprocess
import sys
from collections.abc import Sequence
from datetime import timedelta
from pathlib import Path

from seatrial.models.errors import ConfigurationError, LogbookError
from seatrial.runner.compare.frame import Queries
from seatrial.runner.compare.grid import Scalar, TextTable, grid_of, one_line
from seatrial.runner.compare.runs import repeat_command, runs_of
from seatrial.runner.database.engine import Address
from seatrial.runner.database.logbook import LogbookWriter
from seatrial.runner.database.records import RunSummary
from seatrial.runner.invocation import trial_program
from seatrial.runner.vocabulary import GROUPS, LOST

MINUTES = {"m": 1, "h": 60, "d": 24 * 60, "w": 7 * 24 * 60}
PRUNED = (*LOST, "finished")


def retry_commands(results: Queries, where: str | None, statuses: Sequence[str]) -> list[str]:
    """Return the commands that repeat trials whose last attempt has a status, oldest first.

    `where` is the text of --where; `statuses` are some of failed, diverged and interrupted. Raises
    ConfigurationError for any other status.
    """
    _check_statuses(statuses, LOST)
    candidates = [
        run for run in runs_of(results, results.where(where), statuses) if not run.superseded
    ]
    return [
        repeat_command(
            results.reader.run(run.run_id).overrides, results.reader.address, rerun=False
        )
        for run in reversed(candidates)
    ]


def execute_all(commands: Sequence[str]) -> int:
    """Run the commands one after the other; return 0 if all succeeded, else 1."""
    failed = 0
    for number, line in enumerate(commands, 1):
        print(f"{number} of {len(commands)}: {line}", file=sys.stderr, flush=True)
        arguments = shlex.split(line.removeprefix(trial_program()))
        program = [sys.executable, "-m", "seatrial.runner"]
        failed += subprocess.run([*program, *arguments], check=False).returncode != 0
    print(f"{len(commands) - failed} of {len(commands)} finished", file=sys.stderr)
    return 1 if failed else 0


def age(text: str) -> timedelta:
    """Parse a duration such as 30d; raises ConfigurationError for any other text."""
    match = re.fullmatch(r"(\d{1,6})([mhdw])", text.strip(), re.ASCII)
    if match is None:
        raise ConfigurationError(
            f"--older-than: got {text!r}, expected an age such as 30d, 12h, 2w"
        )
    return timedelta(minutes=MINUTES[match[2]] * int(match[1]))


def prunable(
    results: Queries, older_than: str | None, statuses: Sequence[str], where: str | None
) -> tuple[list[int], TextTable]:
    """Return the numbers of the runs that would be deleted, and a table of them.

    `older_than` is an age such as 30d, `where` the text of --where; empty `statuses` mean any
    status. Raises ConfigurationError if nothing is chosen, and for a wrong age, status or
    condition.
    """
    if older_than is None and not statuses and where is None:
        raise ConfigurationError(
            "prune: expected --older-than, --status or --where, or --orphans; got none"
        )
    _check_statuses(statuses, PRUNED)
    clauses = results.names.clauses(results.where(where))
    summaries = results.reader.prunable(
        *clauses, older_than=age(older_than) if older_than else None, statuses=statuses
    )
    return [run.run_id for run in summaries], _runs_grid(summaries)


def _runs_grid(summaries: Sequence[RunSummary]) -> TextTable:
    headers = ("id", "status", *GROUPS, "seed", "started_at", "series", "error")
    rows = [
        [
            *(run.run_id, run.status, *(getattr(run, name) for name in GROUPS), run.seed),
            *(f"{run.started_at:%Y-%m-%d %H:%M}", run.series, one_line(run.error or "", 60)),
        ]
        for run in summaries
    ]
    files = sum(run.series for run in summaries)
    return grid_of(f"{len(summaries)} runs with {files} files", headers, rows, labels=len(headers))


def delete(address: Address, results_dir: Path, run_ids: Sequence[int]) -> str:
    """Delete runs with their rows and files; return a summary on one line.

    `results_dir` is the folder of the series. Raises LogbookError if a file cannot be deleted.
    """
    with LogbookWriter.open(address.url, results_dir=results_dir, create=False) as logbook:
        pruned = logbook.prune(run_ids)
    running = len(run_ids) - pruned.runs
    text = f"deleted {pruned.runs} runs and {pruned.files} files"
    text += f"; {running} are running again and were not deleted" if running else ""
    if pruned.left:
        raise LogbookError(f"{text}; could not delete {', '.join(pruned.left)}")
    return text


def require_no_choice(*choices: object) -> None:
    """Raise ConfigurationError if --orphans is combined with a selection of runs."""
    if any(choices):
        raise ConfigurationError(
            "prune: expected --orphans alone, or --older-than, --status and --where"
        )


def leftovers(results: Queries) -> tuple[int, TextTable]:
    """Return the number of series files that belong to no run, and a table of them."""
    paths = results.reader.orphans()
    rows: list[list[Scalar]] = [[str(path), path.stat().st_size] for path in paths if path.exists()]
    title = f"{len(paths)} files that belong to no run"
    return len(paths), grid_of(title, ("file", "bytes"), rows, labels=2)


def delete_leftovers(address: Address, results_dir: Path) -> str:
    """Delete the series files that belong to no run; return a summary on one line."""
    with LogbookWriter.open(address.url, results_dir=results_dir, create=False) as logbook:
        return f"deleted {len(logbook.remove_orphans())} files"


def verification(results: Queries) -> tuple[bool, TextTable]:
    """Return whether the logbook has no problem, and a table of problems and unused files.

    Killed programs can leave unused files; they are not a problem. The title of the table says
    what was checked.
    """
    report = results.reader.verify()
    rows = [[problem.where, problem.what] for problem in report.problems]
    rows += [[str(path), "unused: this file belongs to no run"] for path in report.leftovers]
    verdict = f"{len(report.problems)} problems" if report.problems else "no problems"
    if report.leftovers:
        verdict += f", {len(report.leftovers)} unused files (prune --orphans)"
    title = f"checked {report.runs} runs and {report.series} series files: {verdict}"
    return not report.problems, grid_of(title, ("where", "problem"), rows, labels=2)


def _check_statuses(statuses: Sequence[str], known: Sequence[str]) -> None:
    for status in statuses:
        if status not in known:
            raise ConfigurationError(
                f"--status: got {status!r}, expected one of {', '.join(known)}"
            )
