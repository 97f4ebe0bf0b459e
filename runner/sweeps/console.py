"""Console output of trials and sweeps: progress while they run, and a summary at the end.

Progress is read from the logbook, because the runs may be in other processes. It is shown as a live
line on a terminal and as plain lines elsewhere.
"""

import logging
import shlex
import shutil
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from statistics import fmean
from threading import Event, Thread
from typing import TYPE_CHECKING, ClassVar, Protocol

from seatrial.models.errors import ConfigurationError, LogbookError
from seatrial.runner import compare as comparison
from seatrial.runner import database
from seatrial.runner.configuration.invocation import DEFAULT_DATABASE, results_program
from seatrial.runner.configuration.vessel_options import SUITED_GROUPS
from seatrial.runner.database.terminal import error_line
from seatrial.runner.record.catalogue import definition_of
from seatrial.runner.record.vocabulary import COMBINED, ENDINGS, GROUPS, SAILED

if TYPE_CHECKING:
    from rich.progress import Progress

    from seatrial.runner.compare import cli, formats
    from seatrial.runner.database.records import RunSummary, SweepStatus
    from seatrial.runner.sweeps.job import Outcome, PlannedTrial
else:  # slow to import, and used at the end of a sweep
    import lazy_loader

    cli, formats = (
        lazy_loader.load(f"seatrial.runner.compare.{name}", suppress_warning=True)
        for name in ("cli", "formats")
    )


# The metrics that are printed after a trial, at most so many lines, and of which models.
SHOWN = ("e_pos_mae", "e_psi_mae", "velocity_rmse_restarts")
LONGEST_LIST = 5
WARNINGS = 5  # that are counted at the end of a sweep
LISTED = 20  # failed runs that a summary names; the command it prints shows all


def chosen_by_vessels(plans: Iterable["PlannedTrial"]) -> list[str]:
    """Return what each of several vessels chose where its trials do not name it."""
    chosen = dict[str, dict[str, None]]()
    for plan in plans:
        choices = dict(zip(GROUPS, plan.choices, strict=True))
        named = {text.partition("=")[0].lstrip("+") for text in plan.overrides}
        if "experiment" in named:  # whose file may choose as well
            continue
        words = [f"{group}={choices[group]}" for group in SUITED_GROUPS if group not in named]
        chosen.setdefault(choices["vessel"], {})[" ".join(words)] = None
    lines = [f"vessel={vessel} chooses {' or '.join(texts)}" for vessel, texts in chosen.items()]
    return lines if len(chosen) > 1 and any(map("".join, chosen.values())) else []


def sweep_summary(
    status: "SweepStatus", outcomes: Sequence["Outcome"], url: str, factors: Sequence[str]
) -> list[str]:
    """Return the summary of a sweep: counts, failed runs with reasons, and what to do next.

    `factors` are the options that the sweep varied.
    """
    counts = Counter(status.counts)
    busy = sum(outcome.state == "busy" for outcome in outcomes)
    undone = status.planned - sum(counts[name] for name in ENDINGS)
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
    lines += [
        f"  lost: {error_line(str(outcome.error))}"
        for outcome in outcomes
        if outcome.state == "lost"
    ]
    lines.append(f"results: {database.engine.display_url(url)}")
    sweep = ("--sweep", str(status.sweep_id))  # stays right when other sweeps follow
    columns = ("--columns", ",".join(factors[1:])) if factors[1:] else ()
    table = ("table", url, "--rows", factors[0], *columns) if factors else ("runs", url)
    lines.append(f"compare: {compare(*table, *sweep)}")
    return lines


def repeated_warnings(url: str, sweep_id: int) -> list[str]:
    """Return the warnings that several runs of a sweep have stored, most frequent first."""
    with comparison.frame.open_results(url) as results:
        told = results.warnings(comparison.where.Condition(sweeps=(sweep_id,)))
    repeated = sorted((one for one in told if one[1][1:]), key=lambda one: -len(one[1]))
    lines = [f"  {len(runs)} runs: {error_line(text)}" for text, runs in repeated[:WARNINGS]]
    return lines + [f"  and {len(repeated) - WARNINGS} more"] * (len(repeated) > WARNINGS)


def sweep_table(url: str, sweep_id: int, factors: Sequence[str]) -> list[str]:
    """Return the comparison of a sweep by the first metric of `SHOWN` that its runs have.

    Rows are the first of the factors that it varied, columns the others. At most LISTED lines;
    empty if nothing was varied, or no run has such a metric.
    """
    if not factors:
        return []
    columns = ",".join(factors[1:]) or "none"
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
    with comparison.frame.open_results(url) as results:
        for name in (each for each in SHOWN if each in results.metric_names()):
            options = cli.TableOptions(
                rows=factors[0], columns=columns, metric=[name], sweep=str(sweep_id)
            )
            try:
                grid = comparison.table.comparison(results, options)
            except ConfigurationError:  # none of these runs has it, or they differ in too much
                continue
            if all(cell.sort is None for row in grid.rows for cell in row[grid.labels :]):
                continue  # other runs of the logbook have it
            text = formats.render(
                replace(grid, notes=grid.notes[:1]), formats.OutputFormat.RICH, width
            )
            return text.splitlines()[:LISTED]
    return []


def sweep_exit_code(status: "SweepStatus", outcomes: Iterable["Outcome"]) -> int:
    """Return 0 if every trial is finished or running in another process, else 1."""
    busy = sum(outcome.state == "busy" for outcome in outcomes)
    return 0 if status.counts.get("finished", 0) + busy >= status.planned else 1


def failure(run: "RunSummary") -> str:
    """Return one line about a run that did not finish."""
    choices = " ".join(f"{name}={getattr(run, name)}" for name in (*GROUPS, "seed"))
    reason = ": ".join(part for part in (run.error_type, run.error) if part) or "no reason known"
    return error_line(f"run {run.run_id} {run.status} ({choices}): {reason}")


def outcome_line(outcome: "Outcome", url: str) -> str:
    """Return one line about a single trial, with the command that shows more."""
    if outcome.state in ("failed", "diverged"):
        reason = error_line(f"{outcome.error_type}: {outcome.error}")
        message = f"run {outcome.run_id} {outcome.state}: {reason}"
        return f"{message}; see {compare('show', url, str(outcome.run_id), '--traceback')}"
    message = {
        "finished": f"run {outcome.run_id} finished",
        "skipped": f"already in the logbook as run {outcome.run_id} (rerun=true runs it again)",
        "busy": f"another process is running it, as run {outcome.run_id}",
    }[outcome.state]
    return f"{message}; see {compare('show', url, str(outcome.run_id))}"


def result_of(run: int | None, url: str) -> list[str]:
    """Return what a trial came to: the metrics of `SHOWN` that it has, nominal beside identified.

    A model without a value, such as one that is not deployed, has a dash; of what is below the
    resolution of its metric no digit counts. Empty without a run.
    """
    if run is None:
        return []
    with database.LogbookReader.read(url) as logbook:
        metrics = logbook.metrics(run)
    values = {(row.name, row.dof, row.model): row for row in metrics if row.name in SHOWN}
    pairs = dict.fromkeys((name, dof) for name, dof, model in values if model == "identified")
    rows: list[tuple[str, ...]] = [("", *SAILED)]
    for name, dof in sorted(pairs, key=lambda pair: SHOWN.index(pair[0]))[:LONGEST_LIST]:
        definition = definition_of(name)
        unit = values[name, dof, "identified"].unit
        where = "" if dof in COMBINED else f", {dof}"
        found = [values.get((name, dof, model)) for model in SAILED]
        numbers = [
            "-" if row is None or row.value is None
            else f"< {definition.resolution:g}" if abs(row.value) < definition.resolution
            else f"{row.value:.4g}"
            for row in found
        ]  # fmt: skip
        rows.append((f"{definition.label}{where} [{unit}]", *numbers))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [
        f"  {label:<{widths[0]}}  {one:>{widths[1]}}  {other:>{widths[2]}}"
        for label, one, other in rows
    ]
    return lines if len(rows) > 1 else []


def dry_run(trials: Iterable[tuple[str, str, str]]) -> list[str]:
    """Return a table of (state, trial, note), and the count of each state."""
    rows = [(state, error_line(name), error_line(note)) for state, name, note in trials]
    width = max((len(name) for _, name, _ in rows), default=0)
    lines = [f"{state:<11}  {name:<{width}}  {note}".rstrip() for state, name, note in rows]
    counts = Counter(state for state, _, _ in rows)
    totals = ", ".join(f"{count} {state}" for state, count in counts.items())
    return [*lines, f"{_number(len(rows), 'trial')}: {totals}; nothing was run"]


def compare(command: str, url: str, *arguments: str) -> str:
    """Return a command line of the comparison program, for the database at `url`."""
    words = [command, *arguments]
    if url != DEFAULT_DATABASE:
        words += ["--database", url]
    return f"{results_program()} {shlex.join(words)}"


def _number(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


class NewWarnings(logging.Filter):
    """Passes a warning the first time in a process: the runs of a sweep repeat each other's.

    Every run stores its own: `show` lists them, and a sweep ends with their counts. The attribute
    `trial` of a record names the trial of a sweep that it is of.
    """

    _known: ClassVar[set[str]] = set()
    trial: ClassVar[str] = ""  # of a sweep, which this process runs

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether to show a record."""
        text, is_warning = record.getMessage(), record.levelno == logging.WARNING
        record.trial = f"[{self.trial}] " if is_warning and self.trial else ""
        is_new = not is_warning or text not in self._known
        self._known.add(text)
        return is_new

    @classmethod
    def forget(cls) -> None:
        """Show all warnings again, at the start of a program."""
        cls._known.clear()


log = logging.getLogger(__name__)
POLL_S = 0.25  # at least; queries take at most a twentieth of the time
QUIET_S = 5.0  # between two plain lines


@dataclass(frozen=True)
class Standing:
    """The progress of a sweep; `left_s` [s] is None while it cannot be estimated."""

    done: int
    planned: int
    running: int
    failed: int  # failed and diverged
    left_s: float | None

    def __str__(self) -> str:
        left = "" if self.left_s is None else f", about {duration(self.left_s)} left"
        return (
            f"{self.done} of {self.planned} done, {self.running} running, "
            f"{self.failed} failed{left}"
        )


class View(Protocol):
    """A display of the progress."""

    def show(self, standing: Standing) -> None:
        """Show the progress; called a few times a second."""

    def failure(self, line: str) -> None:
        """Show that a run failed; called once per run."""


@contextmanager
def terminal_view() -> Iterator[View]:
    """Open a live line on a terminal, plain lines in the log elsewhere."""
    if not sys.stderr.isatty():
        yield PlainLines()
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn

    columns = (SpinnerColumn(), BarColumn(bar_width=24), TextColumn("{task.description}"))
    console = Console(file=sys.stderr)
    with Progress(*columns, console=console, transient=True) as progress:
        yield LiveLine(progress)


MakeView = Callable[[], AbstractContextManager[View]] | None  # None: the progress is not shown


@contextmanager
def shown(url: str, sweep_id: int, make_view: MakeView = terminal_view) -> Iterator[None]:
    """Show the progress of a sweep in the view that `make_view` opens while the block runs."""
    if make_view is None:
        yield
        return
    with make_view() as view, in_background(partial(_watch, url, sweep_id, view)):
        yield


@contextmanager
def in_background(work: Callable[[Event], None]) -> Iterator[None]:
    """Run `work` in a thread while the block runs; it gets the event that the block has ended."""
    ended = Event()
    thread = Thread(target=work, args=(ended,), daemon=True)
    try:
        thread.start()
        yield
    finally:
        ended.set()
        if thread.is_alive():  # a signal can come before it has started
            thread.join()


def duration(seconds: float) -> str:
    """Format a duration in seconds, minutes or hours."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02d} min"


def _watch(url: str, sweep_id: int, view: View, stop: Event) -> None:
    reported: set[int] = set()
    began_s, before_s = time.monotonic(), -1.0  # of the trials that were done when it began
    try:
        with database.LogbookReader.read(url) as logbook:
            wait = 0.0
            while not stop.wait(wait):
                start_s = time.monotonic()
                status = logbook.sweep_status(sweep_id)
                counts = Counter(status.counts)
                done = sum(counts[name] for name in ENDINGS)
                failed, planned = counts["failed"] + counts["diverged"], status.planned
                spent_s = sum(map(sum, status.spent_s.values()))
                before_s = spent_s if before_s < 0.0 else before_s
                pace = (spent_s - before_s) / max(start_s - began_s, POLL_S)
                left_s = time_left(status.left, status.spent_s, pace)
                view.show(Standing(done, planned, counts["running"], failed, left_s))
                for run in status.failed:
                    if run.run_id not in reported and run.status != "interrupted":
                        reported.add(run.run_id)
                        view.failure(failure(run))
                wait = max(POLL_S, 20.0 * (time.monotonic() - start_s))
    except LogbookError as error:
        log.warning("the progress is no longer shown: %s", error)


def time_left(
    left: Mapping[str, int], spent_s: Mapping[str, Sequence[float]], pace: float
) -> float | None:
    """Return the time [s] for the trials that are left; None while nothing is known of it.

    A trial takes as long as those of the same choices did, or else as all did.

    Args:
        left: number of trials by their choices.
        spent_s: durations of the trials that have ended, by their choices.
        pace: how many seconds of trials are done in a second, by all workers.
    """
    known = {choices: fmean(each) for choices, each in spent_s.items() if each}
    if not known or not pace > 0.0:
        return None
    usual = fmean(one for each in spent_s.values() for one in each)
    return sum(n * known.get(choices, usual) for choices, n in left.items()) / pace


class LiveLine:
    """A line at the bottom of the terminal that is redrawn."""

    def __init__(self, progress: "Progress") -> None:
        self._progress = progress
        self._task = progress.add_task("starting", total=None)

    def show(self, standing: Standing) -> None:
        """Redraw the line."""
        total, done = standing.planned, standing.done
        self._progress.update(self._task, total=total, completed=done, description=str(standing))

    def failure(self, line: str) -> None:
        """Print above the line."""
        self._progress.console.print(line, markup=False, highlight=False)


@dataclass
class PlainLines:
    """A line in the log when the progress has changed, at most every QUIET_S."""

    _last: float = field(default=-QUIET_S)
    _reported: tuple[int, int] = (0, 0)

    def show(self, standing: Standing) -> None:
        """Log the progress if it has changed and the last line is QUIET_S old."""
        now = time.monotonic()
        counts = (standing.done, standing.failed)
        if counts != self._reported and now - self._last >= QUIET_S:
            log.info("%s", standing)
            self._last, self._reported = now, counts

    def failure(self, line: str) -> None:
        """Log it."""
        log.info("%s", line)
