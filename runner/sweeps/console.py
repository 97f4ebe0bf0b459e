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
from dataclasses import replace
from datetime import timedelta
from statistics import fmean
from threading import Event, Thread
from typing import TYPE_CHECKING, ClassVar

from seatrial.models.errors import ConfigurationError, LogbookError
from seatrial.runner import compare as comparison
from seatrial.runner import database
from seatrial.runner.configuration.invocation import DEFAULT_DATABASE, results_program
from seatrial.runner.configuration.vessel_options import SUITED_GROUPS
from seatrial.runner.database.terminal import error_line
from seatrial.runner.record.catalogue import HEADLINES, definition_of, headlines
from seatrial.runner.record.vocabulary import COMBINED, ENDINGS, GROUPS, SAILED

if TYPE_CHECKING:
    from seatrial.runner.database.records import RunSummary, SweepStatus
    from seatrial.runner.sweeps.job import Outcome, PlannedTrial

NOT_DRAWN = "seed: nothing is random, those that differ in it alone are one experiment"
WARNINGS = 5  # that are counted at the end of a sweep
LISTED = 20  # failed runs that a summary names; the command it prints shows all


def chosen_by_vessels(plans: Iterable["PlannedTrial"]) -> list[str]:
    """Return what each of several vessels chose where its trials do not name it."""
    chosen = dict[str, dict[str, None]]()
    for plan in plans:
        named = {text.partition("=")[0].lstrip("+") for text in plan.overrides}
        if "experiment" in named:  # whose file may choose as well
            continue
        words = [f"{group}={plan.choices[group]}" for group in SUITED_GROUPS if group not in named]
        chosen.setdefault(plan.choices["vessel"], {})[" ".join(words)] = None
    lines = [f"vessel={vessel} chooses {' or '.join(texts)}" for vessel, texts in chosen.items()]
    return lines if len(chosen) > 1 and any(map("".join, chosen.values())) else []


def sweep_summary(
    status: "SweepStatus", outcomes: Sequence["Outcome"], url: str, factors: Sequence[str]
) -> list[str]:
    """Return the summary of a sweep: counts, failed runs with reasons, and what to do next.

    `factors` are the options that the sweep varied.
    """
    counts, busy = Counter(status.counts), sum(outcome.state == "busy" for outcome in outcomes)
    undone = status.planned - sum(counts[name] for name in ENDINGS) - busy
    reused = f" ({status.reused - busy} already in the logbook)" * (status.reused > busy)
    parts = [f"{counts['finished']} finished{reused}"]
    parts += [f"{counts[name]} {name}" for name in ("failed", "diverged")]
    rest = {"running in another process": busy, "not done": undone}
    parts += [f"{count} {words}" for words, count in rest.items() if count > 0]
    runs = f"{status.planned} run{'s' * (status.planned != 1)}"
    lines = [f"sweep {status.sweep_id}, {runs}: {', '.join(parts)}"]
    lines += [f"  {failure(run)}" for run in status.failed[:LISTED]]
    if len(status.failed) > LISTED:
        lines.append(f"  and {len(status.failed) - LISTED} more")
    lost = (str(outcome.error) for outcome in outcomes if outcome.state == "lost")
    lines += [f"  lost: {error_line(error)}" for error in lost]
    lines.append(f"results: {database.engine.display_url(url)}")
    columns = ("--columns", ",".join(factors[1:])) if factors[1:] else ()
    table = ("table", url, "--rows", factors[0], *columns) if factors else ("runs", url)
    # The number of the sweep stays right when other sweeps follow.
    return [*lines, f"compare: {compare(*table, '--sweep', str(status.sweep_id))}"]


def repeated_warnings(url: str, sweep_id: int) -> list[str]:
    """Return the warnings that several runs of a sweep have stored, most frequent first.

    The first is of runs that differ in the seed alone, although they drew nothing by it.
    """
    own = comparison.where.Condition(sweeps=(sweep_id,))
    with comparison.frame.open_results(url) as results:
        told, trials = results.warnings(own), results.trials(own)
    alike = trials.loc[trials["streams"] == "", "of_experiment"].value_counts()
    alike = alike[alike > 1]
    again = [f"  {alike.sum()} runs: {NOT_DRAWN} ({len(alike)} in all)"] * bool(len(alike))
    repeated = sorted((one for one in told if one[1][1:]), key=lambda one: -len(one[1]))
    lines = [f"  {len(runs)} runs: {error_line(text)}" for text, runs in repeated[:WARNINGS]]
    return again + lines + [f"  and {len(repeated) - WARNINGS} more"] * (len(repeated) > WARNINGS)


def sweep_table(url: str, sweep_id: int, factors: Sequence[str]) -> list[str]:
    """Return the comparison of a sweep by the first headline that its runs have.

    Rows are the first of the factors that it varied, columns the others. At most LISTED lines;
    empty if nothing was varied, or no run has such a metric.
    """
    if not factors:
        return []
    columns = ",".join(factors[1:]) or "none"
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
    with comparison.frame.open_results(url) as results:
        for name in (each for each in HEADLINES if each in results.metric_names()):
            options = comparison.cli.TableOptions(
                rows=factors[0], columns=columns, metric=[name], sweep=str(sweep_id)
            )
            try:
                grid = comparison.table.comparison(results, options)
            except ConfigurationError:  # none of these runs has it, or they differ in too much
                continue
            if all(cell.sort is None for row in grid.rows for cell in row[grid.labels :]):
                continue  # other runs of the logbook have it
            grid = replace(grid, notes=grid.notes[:1])
            rich = comparison.grid.OutputFormat.RICH
            return comparison.grid.render(grid, rich, width).splitlines()[:LISTED]
    return []


def failure(run: "RunSummary") -> str:
    """Return one line about a run that did not finish."""
    choices = " ".join(f"{name}={getattr(run, name)}" for name in (*GROUPS, "seed"))
    reason = ": ".join(part for part in (run.error_type, run.error) if part) or "no reason known"
    return error_line(f"run {run.run_id} {run.status} ({choices}): {reason}")


def outcome_line(outcome: "Outcome", url: str) -> str:
    """Return one line about a single trial, with the command that shows more."""
    show, run = compare("show", url, str(outcome.run_id)), f"run {outcome.run_id}"
    if outcome.error:
        reason = error_line(f"{outcome.error_type}: {outcome.error}")
        return f"{run} {outcome.state}: {reason}; see {show} --traceback"
    more = {
        "skipped": f"already in the logbook as {run} (rerun=true runs it again)",
        "busy": f"another process is running it, as {run}",
    }
    return f"{more.get(outcome.state, f'{run} finished')}; see {show}"


def result_of(run: int | None, url: str) -> list[str]:
    """Return what a trial came to: its headlines, nominal beside identified.

    A model without a value, such as one that is not deployed, has a dash; of what is below the
    resolution of its metric no digit counts. Empty without a run.
    """
    if run is None:
        return []
    with database.LogbookReader.read(url) as logbook:
        metrics = logbook.metrics(run)
    rows: list[tuple[str, ...]] = [("", *SAILED)]
    for pair in headlines(metrics):
        one = next(row for row in pair if row)
        finest, where = definition_of(one.name), "" if one.dof in COMBINED else f", {one.dof}"
        numbers = ["-"] * len(SAILED)
        for i, row in enumerate(pair):
            if row is not None and row.value is not None:
                is_fine = 0.0 < abs(row.value) < finest.resolution
                numbers[i] = f"< {finest.resolution:g}" if is_fine else f"{row.value:.4g}"
        rows.append((comparison.grid.with_unit(finest.label + where, one.unit), *numbers))
    label, *widths = (max(map(len, column)) for column in zip(*rows, strict=True))
    lines = ["  ".join((f"  {row[0]:<{label}}", *map(str.rjust, row[1:], widths))) for row in rows]
    return lines if len(rows) > 1 else []


def dry_run(trials: Iterable[tuple[str, str, str]]) -> list[str]:
    """Return a table of (state, trial, note), and the count of each state."""
    rows = [(state, error_line(name), error_line(note)) for state, name, note in trials]
    width = max((len(name) for _, name, _ in rows), default=0)
    lines = [f"{state:<11}  {name:<{width}}  {note}".rstrip() for state, name, note in rows]
    counts = Counter(state for state, _, _ in rows)
    totals = ", ".join(f"{count} {state}" for state, count in counts.items())
    return [*lines, f"{len(rows)} trial{'s' * (len(rows) != 1)}: {totals}; nothing was run"]


def compare(command: str, url: str, *arguments: str) -> str:
    """Return a command line of the comparison program, for the database at `url`."""
    place = [] if url == DEFAULT_DATABASE else ["--database", url]
    return f"{results_program()} {shlex.join([command, *arguments, *place])}"


class NewWarnings(logging.Filter):
    """Passes a warning the first time in a process: the runs of a sweep repeat each other's.

    Every run stores its own: `show` lists them, and a sweep ends with their counts. The attribute
    `trial` of a record names the trial of a sweep that it is of.
    """

    known: ClassVar[set[str]] = set()
    trial: ClassVar[str] = ""  # of a sweep, which this process runs

    def filter(self, record: logging.LogRecord) -> bool:
        """Return whether to show a record."""
        text, is_warning = record.getMessage(), record.levelno == logging.WARNING
        record.trial = f"[{self.trial}] " if is_warning and self.trial else ""
        is_new = not is_warning or text not in self.known
        self.known.add(text)
        return is_new


log = logging.getLogger(__name__)
POLL_S = 0.25  # at least; queries take at most a twentieth of the time
QUIET_S = 30.0  # between two plain lines
# What shows a line on the progress, a few times a second, and a line on each run that has failed.
View = Callable[[str, Sequence[str]], None]
MakeView = Callable[[], AbstractContextManager[View]] | None  # None: the progress is not shown


def plain_lines(standing: str, failures: Sequence[str]) -> None:
    """Log the progress."""
    for line in (*failures, standing):
        log.info("%s", line)


@contextmanager
def terminal_view() -> Iterator[View]:
    """Open a live line on a terminal, plain lines in the log elsewhere."""
    if not sys.stderr.isatty():
        yield plain_lines
        return
    from rich.console import Console

    console = Console(file=sys.stderr)
    with console.status("starting") as live:

        def show(standing: str, failures: Sequence[str]) -> None:
            for line in failures:
                console.print(line, markup=False, highlight=False)
            live.update(standing)

        yield show


@contextmanager
def shown(url: str, sweep_id: int, make_view: MakeView = terminal_view) -> Iterator[None]:
    """Show the progress of a sweep in the view that `make_view` opens while the block runs."""
    if make_view is None:
        yield
        return
    ended = Event()
    with make_view() as view:
        thread = Thread(target=_watch, args=(url, sweep_id, view, ended), daemon=True)
        try:
            thread.start()
            yield
        finally:
            ended.set()
            if thread.is_alive():  # a signal can come before it has started
                thread.join()


def _watch(url: str, sweep_id: int, view: View, stop: Event) -> None:
    reported: set[int] = set()
    began_s, before_s = time.monotonic(), -1.0  # of the trials that were done when it began
    wait_s = period_s = QUIET_S if view is plain_lines else POLL_S
    try:
        with database.LogbookReader.read(url) as logbook:
            while not stop.wait(wait_s):
                start_s = time.monotonic()
                status = logbook.sweep_status(sweep_id)
                counts = Counter(status.counts)
                spent_s = sum(map(sum, status.spent_s.values()))
                before_s = spent_s if before_s < 0.0 else before_s
                pace = (spent_s - before_s) / max(start_s - began_s, POLL_S)
                left_s = time_left(status.left, status.spent_s, pace)
                new = [run for run in status.failed if run.run_id not in reported]
                new = [run for run in new if run.status != "interrupted"]
                reported |= {run.run_id for run in new}
                done = sum(counts[name] for name in ENDINGS)
                view(
                    f"{done} of {status.planned} done, {counts['running']} running, "
                    f"{counts['failed'] + counts['diverged']} failed"
                    + ("" if left_s is None else f", about {timedelta(seconds=left_s)} left"),
                    [failure(run) for run in new],
                )
                wait_s = max(period_s, 20.0 * (time.monotonic() - start_s))
    except LogbookError as error:
        log.warning("the progress is no longer shown: %s", error)


def time_left(
    left: Mapping[str, int], spent_s: Mapping[str, Sequence[float]], pace: float
) -> int | None:
    """Return the time [s] for the trials that are left; None while nothing is known of it.

    A trial takes as long as those of the same choices did, or else as all did. `left` is the number
    of trials by choices, `spent_s` the durations of those that have ended, and `pace` how many
    seconds of trials are done in a second, by all workers.
    """
    known = {choices: fmean(each) for choices, each in spent_s.items() if each}
    if not known or not pace > 0.0:
        return None
    usual = fmean(one for each in spent_s.values() for one in each)
    return round(sum(n * known.get(choices, usual) for choices, n in left.items()) / pace)
