"""What a command tells at its end: the summary of a sweep, the outcome of a trial, a dry run."""

import shlex
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from runner.database.records import RunSummary, SweepStatus
    from runner.job import Outcome

DEFAULT_DATABASE = "sqlite:///results/results.db"
COMPARE = "python -m runner.compare"
LISTED = 20  # failed runs that a summary names; the command it prints shows all


def sweep_summary(
    status: "SweepStatus", outcomes: Sequence["Outcome"], url: str, factors: Sequence[str]
) -> list[str]:
    """The lines that end a sweep: how many, which failed and why, and where to look.

    `factors` are the options that the sweep varied.
    """
    counts = Counter(status.counts)
    busy = sum(outcome.state == "busy" for outcome in outcomes)
    undone = status.planned - sum(counts[name] for name in ("finished", "failed", "diverged"))
    parts = [f"{counts['finished']} finished"]
    if status.reused - busy > 0:
        parts[0] += f" ({status.reused - busy} already in the logbook)"
    parts += [f"{counts['failed']} failed", f"{counts['diverged']} diverged"]
    if busy:
        parts.append(f"{busy} running in another process")
    if undone - busy > 0:
        parts.append(f"{undone - busy} not done")
    lines = [f"sweep {status.sweep_id}, {_number(status.planned, 'run')}: {', '.join(parts)}"]
    lines += [f"  {failure(run)}" for run in status.failed[:LISTED]]
    if len(status.failed) > LISTED:
        lines.append(f"  and {len(status.failed) - LISTED} more")
    lines += [f"  lost: {outcome.error}" for outcome in outcomes if outcome.state == "lost"]
    lines.append(f"results: {_shown(url)}")
    lines.append(f"compare: {_comparison(status, url, factors)}")
    return lines


def _comparison(status: "SweepStatus", url: str, factors: Sequence[str]) -> str:
    """The command that shows a sweep: a table over what it varied, or a list."""
    if not factors:
        return compare("runs", url, "--where", f"sweep_id={status.sweep_id}")
    columns = ("--columns", ",".join(factors[1:])) if factors[1:] else ()
    return compare("table", url, "--rows", factors[0], *columns)


def sweep_exit_code(status: "SweepStatus", outcomes: Iterable["Outcome"]) -> int:
    """0 when every trial is finished or in other hands, else 1."""
    busy = sum(outcome.state == "busy" for outcome in outcomes)
    return 0 if status.counts.get("finished", 0) + busy >= status.planned else 1


def failure(run: "RunSummary") -> str:
    """One line about a run that did not finish."""
    choices = (
        f"vessel={run.vessel} disturbance={run.disturbance} excitation={run.excitation} "
        f"identifier={run.identifier} controller={run.controller} "
        f"evaluation={run.evaluation} seed={run.seed}"
    )
    reason = ": ".join(part for part in (run.error_type, run.error) if part) or "no reason known"
    return f"run {run.run_id} {run.status} ({choices}): {reason}"


def outcome_line(outcome: "Outcome", url: str) -> str:
    """One line about a single trial, with the command that shows more."""
    if outcome.state in ("failed", "diverged"):
        said = f"run {outcome.run_id} {outcome.state}: {outcome.error_type}: {outcome.error}"
        return f"{said}; see {compare('show', url, str(outcome.run_id), '--traceback')}"
    said = {
        "finished": f"run {outcome.run_id} finished",
        "skipped": f"already in the logbook as run {outcome.run_id} (rerun=true runs it again)",
        "busy": f"another process is running it, as run {outcome.run_id}",
    }[outcome.state]
    return f"{said}; see {compare('show', url, str(outcome.run_id))}"


def dry_run(trials: Iterable[tuple[str, str, str]]) -> list[str]:
    """A table of (state, trial, remark), and how many there are of each state."""
    rows = list(trials)
    width = max((len(name) for _, name, _ in rows), default=0)
    lines = [f"{state:<11}  {name:<{width}}  {remark}".rstrip() for state, name, remark in rows]
    counts = Counter(state for state, _, _ in rows)
    many = ", ".join(f"{count} {state}" for state, count in counts.items())
    return [*lines, f"{_number(len(rows), 'trial')}: {many}; nothing was run"]


def compare(command: str, url: str, *arguments: str) -> str:
    """A command line of the comparison program, for the database at `url`."""
    words = [command, *arguments]
    if url != DEFAULT_DATABASE:
        words += ["--database", _shown(url)]
    return f"{COMPARE} {shlex.join(words)}"


def _shown(url: str) -> str:
    from runner.database import display_url

    return display_url(url)


def _number(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"
