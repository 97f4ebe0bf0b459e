"""One trial as a run of the logbook: claimed, run, and stored with its results or its error."""

import logging
import traceback
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from sys import intern
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from seatrial.models.errors import Diverged, RecordingError, SeatrialError
from seatrial.runner import database
from seatrial.runner.configuration.config import Limits, SweepLabels, Trial, build_trial
from seatrial.runner.configuration.fingerprint import Provenance, fingerprint
from seatrial.runner.configuration.plugins import attributed
from seatrial.runner.record.vocabulary import GROUPS, NO_RESULT, Ending
from seatrial.runner.trials.precompile import kinds

if TYPE_CHECKING:  # what is slow to import
    import threadpoolctl

    from seatrial.runner.trials import trial as trials
else:
    import lazy_loader

    threadpoolctl = lazy_loader.load("threadpoolctl")
    trials = lazy_loader.load("seatrial.runner.trials.trial", suppress_warning=True)

State = Literal["finished", "skipped", "busy", "diverged", "failed", "lost", "bug"]
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Order:
    """What to run: a resolved configuration, its options' names, and the overrides it came from."""

    config: Mapping[str, object]
    names: Mapping[str, str]
    overrides: Sequence[str]

    def fingerprints(self, sources: str) -> tuple[str, str]:
        """Return the fingerprints of the trial, and of its experiment, which is without the seed.

        Replicates have the latter in common. `sources` is the digest of the code.
        """
        unseeded = {key: value for key, value in self.config.items() if key != "seed"}
        beside = self.names, sources
        return fingerprint(self.config, *beside), fingerprint(unseeded, *beside)


@dataclass(frozen=True)
class Outcome:
    """The outcome of an order.

    skipped: the trial was in the logbook already; busy: another process is running it; lost: the
    logbook could not store the results, so there is no row (then `run_id` is None); bug: nothing is
    stored, and `error` is the traceback.
    """

    state: State
    run_id: int | None
    error_type: str | None = None
    error: str | None = None


def shown(overrides: Sequence[str]) -> str:
    """Name a trial by its overrides, but for those that change no result."""
    texts = [text for text in overrides if not text.startswith(NO_RESULT)]
    return " ".join(texts) or "the default trial"


def prepare(order: Order) -> Trial:
    """Build and check the trial of an order; raises SeatrialError if it cannot be run."""
    trial = build_trial(order.config, order.names)
    with attributed(trial.config):
        trials.check(trial)
    return trial


def perform(
    trial: Trial, order: Order, provenance: Provenance, sweep_id: int | None = None
) -> Outcome:
    """Run a trial and store its results, unless it is in the logbook already.

    Errors of the trial are stored in its row; errors of the logbook are raised.
    """
    key, experiment = order.fingerprints(provenance.sources)
    own: dict[str, Any] = {group: trial.names[group] for group in GROUPS}
    own |= {key: value for key, value in vars(provenance).items() if key != "sources"}
    # Where results are stored is no part of a trial; the sweep has a row of its own.
    own["config"] = {k: v for k, v in order.config.items() if k not in ("database", "sweep")}
    start = database.tables.RunRow(
        fingerprint=key,
        seed=trial.seed,
        overrides=list(order.overrides),
        code=provenance.sources[:16],
        experiment=experiment,
        **own,
    )
    with database.LogbookWriter.open(trial.database_url, results_dir=trial.results_dir) as logbook:
        begun = logbook.begin_run(start, sweep_id, rerun=trial.rerun)
        if begun.state != "new":
            return Outcome("skipped" if begun.state == "finished" else "busy", begun.run_id)
        try:
            # One thread per trial: workers share the cores, and sums are equal on every machine.
            with threadpoolctl.threadpool_limits(1), attributed(trial.config):
                results = trials.run(trial)
        except Exception as error:
            status: Ending = "diverged" if isinstance(error, Diverged) else "failed"
            kind = type(error).__name__ if status == "failed" else "Diverged"
            message = " ".join(str(error).split()) or kind
            valid = error.results if isinstance(error, trials.TrialDiverged) else None
            trace = "".join(traceback.format_exception(error))
            logbook.fail_run(begun.run_id, status, kind, message, trace, valid)
            return Outcome(status, begun.run_id, kind, message)
        logbook.finish_run(begun.run_id, results)
        return Outcome("finished", begun.run_id)


@dataclass(frozen=True, slots=True)
class PlannedTrial:
    """What a sweep needs of a checked trial; small, because a sweep may have very many."""

    fingerprint: str
    seed: int
    choices: Mapping[str, str]  # the option of each group
    overrides: list[str]
    database_url: str
    results_dir: Path
    rerun: bool
    labels: SweepLabels
    kinds: tuple[str, ...]  # of its parts, as `precompile` takes them

    @property
    def row(self) -> dict[str, object]:
        """The trial as a row of the table `planned`."""
        names = ("fingerprint", "seed", "choices", "overrides")
        return {name: getattr(self, name) for name in names}


Checked = dict[tuple[str, Limits], SeatrialError | None]  # by experiment: why it cannot be run


def plan_of(order: Order, sources: str, checked: Checked) -> PlannedTrial:
    """Build and check a trial; raises SeatrialError if it cannot be run.

    `sources` is the digest of the code that computes results. A check may read a recording. The
    replicates of an experiment are checked once, by the first seed: where a mission draws what
    cannot be sailed for another one, such as a start in a harbour, its run fails.
    """
    trial = build_trial(order.config, order.names)
    own, experiment = order.fingerprints(sources)
    key = experiment, trial.limits
    if key not in checked:
        checked[key] = None
        try:
            with attributed(trial.config):
                trials.check(trial)
        except RecordingError as problem:  # of its contents: its run fails, the others go on
            log.warning("%s: %s", shown(order.overrides), problem)
        except SeatrialError as problem:
            checked[key] = problem
    if (error := checked[key]) is not None:
        raise error.with_traceback(None)
    return PlannedTrial(
        fingerprint=own,
        seed=trial.seed,
        choices={group: intern(trial.names[group]) for group in GROUPS},
        overrides=list(order.overrides),
        database_url=trial.database_url,
        results_dir=trial.results_dir,
        rerun=trial.rerun,
        labels=trial.sweep,
        kinds=tuple(map(intern, kinds(trial))),
    )


class Refusal(NamedTuple):
    """A trial that cannot be run, and the reason."""

    asked: str
    reason: str


def states(url: str, sweep_id: int, plans: Iterable[PlannedTrial]) -> dict[str, str]:
    """Return the status of the last attempt of a sweep at each trial, by fingerprint."""
    fingerprints = {plan.fingerprint for plan in plans}
    with database.LogbookWriter.read(url) as logbook:
        # In the order of their attempts.
        runs = logbook.runs(database.tables.RunRow.sweep_id == sweep_id)
    return {run.fingerprint: run.status for run in runs if run.fingerprint in fingerprints}


def known(plans: Iterable[PlannedTrial]) -> dict[str, "database.RunSummary"]:
    """Return the stored runs of these trials, by fingerprint; empty without a logbook."""
    plans = list(plans)
    if not plans:
        return {}
    url = plans[0].database_url
    address, schema = database.engine.parse(url), database.schema
    absent = address.path is not None and not address.path.exists()
    if absent or schema.inspect(address) is schema.SchemaState.EMPTY:
        return {}
    with database.LogbookWriter.read(url) as logbook:
        return logbook.trials(plan.fingerprint for plan in plans)


def listed(plans: Sequence[PlannedTrial | Refusal]) -> list[tuple[str, str, str]]:
    """Return (state, trial, note) of each trial, for a dry run."""
    runs = known(plan for plan in plans if isinstance(plan, PlannedTrial))
    rows = []
    for plan in plans:
        if isinstance(plan, Refusal):
            rows.append(("refused", *plan))
        elif (run := runs.get(plan.fingerprint)) is None:
            rows.append(("new", shown(plan.overrides), ""))
        else:
            note = f"run {run.run_id}{f': {run.error}' if run.error else ''}"
            again = ", to be run again" if run.status == "finished" and plan.rerun else ""
            rows.append((run.status, shown(plan.overrides), note + again))
    return rows
