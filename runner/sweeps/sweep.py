"""The interface between Hydra and the runner: the task of a single trial, and the sweeper.

A sweep checks every trial before it starts any, runs those that are not in the logbook with the
configured launcher, and ends with a summary from the logbook.
"""

import logging
import traceback
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import product
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from hydra.core.config_loader import ConfigLoader
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import ChoiceSweep, Override, RangeSweep
from hydra.core.plugins import Plugins
from hydra.plugins.sweeper import Sweeper
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from seatrial.models.errors import ConfigurationError, SeatrialError
from seatrial.runner import database
from seatrial.runner.configuration.config import Limits, SweepLabels, Trial, build_as, build_trial
from seatrial.runner.configuration.fingerprint import Provenance, collect
from seatrial.runner.configuration.hydra_errors import EXPECTED, one_line
from seatrial.runner.sweeps import console, launching
from seatrial.runner.sweeps.composition import (
    Composer,
    SharingLoader,
    nested_sweeps,
    order_of,
    spread,
    text_of,
)
from seatrial.runner.sweeps.job import (
    Checked,
    Outcome,
    PlannedTrial,
    Refusal,
    known,
    listed,
    perform,
    plan_of,
    prepare,
    shown,
)
from seatrial.runner.trials.precompile import precompile

if TYPE_CHECKING:  # what is slow to import
    from seatrial.runner.trials import budget
else:
    import lazy_loader

    budget = lazy_loader.load("seatrial.runner.trials.budget", suppress_warning=True)

# The jobs of a sweep: a grid of values, and variants that change several options together.


Options = Mapping[str, object]


def jobs_of(
    parser: OverridesParser,
    params: Options,
    variants: Sequence[Options | Sequence[str]],
    arguments: Sequence[str],
    limits: Limits,
) -> list[list[str]]:
    """Return the overrides of every job: the grid of params and arguments, for each variant.

    A variant is options by name, or overrides as on the command line. It replaces the params of the
    same name; the arguments replace both. Raises ConfigurationError for more jobs than the limit.
    """
    keys = {override.key_or_group for override in parser.parse_overrides(list(arguments))}
    jobs: list[list[str]] = []
    for variant in variants or [{}]:
        own = [*texts(params), *(texts(variant) if isinstance(variant, Mapping) else variant)]
        kept = [text for text in own if text.partition("=")[0].lstrip("+") not in keys]
        overrides = parser.parse_overrides([*kept, *arguments])
        # Of several overrides of one option the last counts, at the position of the first.
        last = {override.get_key_element(): override for override in overrides}.values()
        budget.check_sweep([_count(override) for override in last], limits, len(jobs))
        jobs += map(list, product(*map(values_of, last)))
    return jobs


def texts(options: Options) -> list[str]:
    """Return the overrides of options by name."""
    return [f"{key}={text_of(value)}" for key, value in options.items()]


def _count(override: Override) -> tuple[str, float]:
    """Return the option of an override and the number of its values, without listing them."""
    value: Any = override.value()
    count = float(len(value.list)) if isinstance(value, ChoiceSweep) else 1.0
    if isinstance(value, RangeSweep):
        span, step = float(value.stop or 0.0) - float(value.start or 0.0), float(value.step)
        count = max(0.0, span / step) if step else inf
    return override.key_or_group, count


def values_of(override: Override) -> list[str]:
    """Return one override for each value of a sweep override."""
    key, values = override.get_key_element(), list[str]()
    if override.is_discrete_sweep():
        values = [f"{key}={value}" for value in override.sweep_string_iterator()]
    elif next(nested_sweeps(override.value(), key), None) is None:
        values = [f"{key}={override.get_value_element_as_str()}"]
    if not values:
        raise ConfigurationError(
            f"{override.input_line}: got no values that can be listed; intervals, and sweeps "
            "inside of lists, are for a search (hydra/sweeper=optuna)"
        )
    return values


log = logging.getLogger(__name__)
COMPILING = ("basic", "submitit_slurm")  # launchers whose processes compile for themselves


class Session:
    """The task that Hydra calls for a single trial; it holds the outcome.

    Hydra reports exceptions of a task itself, and returns nothing from a sweep. So the exit code
    and the error are stored here for `runner.__main__`.
    """

    def __init__(self) -> None:
        self.variants: list[list[str]] = []  # overrides of each --variant
        self.exit_code = 0
        self.error: Exception | str | None = None
        self.started = False  # before that, an exception is about the command line
        self.outcome: Outcome | None = None  # of a single trial
        self.trials: Sequence[tuple[str, str, str]] = ()  # of a dry run: state, trial, note
        self.sweep_id: int | None = None
        self.logbook: tuple[str, Path] | None = None  # address, and the folder of its series
        self.view: console.MakeView = console.terminal_view  # of the progress of a sweep

    def say(self, lines: Iterable[str]) -> None:
        """Print the outcome."""
        print("\n".join(lines))

    def show_table(self, url: str, sweep_id: int, factors: Sequence[str]) -> None:
        """Print what came of a sweep."""
        if told := console.repeated_warnings(url, sweep_id):
            self.say(["warnings:", *told])
        if lines := console.sweep_table(url, sweep_id, factors):
            self.say(lines)

    def provenance(self) -> Provenance:
        """Return where the results come from."""
        return collect()

    def __call__(self, config: DictConfig) -> None:
        """Run the one trial of a command without -m; one with labels is a sweep of its own."""
        self.started = True
        try:
            order = order_of(config, HydraConfig.get())
            if order.config.get("dry_run") is True:
                self.trials = listed([plan_of(order, collect().sources, {})])
                self.say(console.dry_run(self.trials))
                return
            trial, provenance = prepare(order), self.provenance()
            self.logbook = url, folder = trial.database_url, trial.results_dir
            if trial.sweep == SweepLabels():
                outcome = perform(trial, order, provenance)
            else:
                with database.LogbookWriter.open(url, results_dir=folder) as logbook:
                    sweep_id = begin_sweep(logbook, trial.sweep, provenance, order.overrides, 1)
                    outcome = perform(trial, order, provenance, sweep_id)
                    logbook.end_sweep(sweep_id)
        except (SeatrialError, OmegaConfBaseException) as error:
            self.error, self.exit_code = error, 2
            return
        self.outcome, line = outcome, console.outcome_line(outcome, url)
        if outcome.state in ("failed", "diverged"):
            unusable = outcome.error_type in ("ConfigurationError", "RecordingError")
            self.error, self.exit_code = line, 2 if unusable else 1
        else:
            run = None if outcome.state == "busy" else outcome.run_id
            self.say([line, *console.result_of(run, url)])


@dataclass(frozen=True)
class SweepJob:
    """The task that a launcher calls for each trial of a sweep, here or in another process."""

    sweep_id: int
    provenance: Provenance

    def __call__(self, config: DictConfig) -> Outcome:
        """Run one trial, unless it is in the logbook; `lost` if the logbook cannot store it.

        Returns a bug as an outcome: its exception need not fit through the pipe of a worker.
        """
        name = ""
        try:
            order = order_of(config, HydraConfig.get())
            name = console.NewWarnings.trial = shown(order.overrides)
            trial = build_trial(order.config, order.names)
            address = database.engine.parse(trial.database_url)
            database.outage.expect(address)  # reached before: it holds the sweep
            return perform(trial, order, self.provenance, self.sweep_id)
        except SeatrialError as error:
            return Outcome("lost", None, type(error).__name__, f"{name}: {error}")
        except (Exception, SystemExit) as error:
            return Outcome("bug", None, type(error).__name__, traceback.format_exc())
        finally:
            console.NewWarnings.trial = ""


class SeatrialSweeper(Sweeper):
    """The grid of Hydra's basic sweeper, with the logbook."""

    def __init__(self, max_batch_size: int | None, params: Any, variants: Any) -> None:
        self.max_batch_size = max_batch_size
        self.params: Options = cast(Any, OmegaConf.to_container(params)) if params else {}
        self.variants: Sequence[Options] = (
            cast(Any, OmegaConf.to_container(variants)) if variants else []
        )

    def setup(
        self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig
    ) -> None:
        """Store the objects of Hydra; the launcher is created when there are trials to launch."""
        self._loader = SharingLoader(hydra_context.config_loader)
        self._context = HydraContext(cast(ConfigLoader, self._loader), hydra_context.callbacks)
        self._config = config
        self._choice = str(config.hydra.runtime.choices["hydra/launcher"])
        self.session = cast(Session, task_function)

    def sweep(self, arguments: list[str]) -> None:
        """Run all combinations of the arguments' values."""
        self.session.started = True
        parser = OverridesParser.create(config_loader=self._loader.hydra)
        own, variants = self._config, self.session.variants or self.variants
        limits = build_as(Limits, OmegaConf.to_container(own.limits, resolve=True), "limits")
        composer = Composer(self._loader, own)
        jobs = list(map(spread, jobs_of(parser, self.params, variants, arguments, limits)))
        jobs = composer.applicable(jobs)
        plans = planned(composer, jobs)
        fitting = [plan for plan in plans if isinstance(plan, PlannedTrial)]
        if lines := console.chosen_by_vessels(fitting):
            self.session.say(lines)
        if own.dry_run is True or any("dry_run=true" in map(str.lower, job) for job in jobs):
            self.session.trials = listed(plans)
            self.session.say(console.dry_run(self.session.trials))
            return
        ready, factors = accepted(plans), _factors(jobs)
        with self.underway(ready[0], arguments, len(ready), ready) as (logbook, job):
            outcomes, remaining = finished_before(ready, logbook, job.sweep_id)
            launched = self._launch(remaining, job)
            status = logbook.sweep_status(job.sweep_id)
        outcomes += launched.outcomes
        url = ready[0].database_url
        self.session.say(console.sweep_summary(status, outcomes, url, factors))
        done = status.counts.get("finished", 0) + sum(each.state == "busy" for each in outcomes)
        self.session.exit_code = int(done < status.planned)
        if launched.bugs:
            raise RuntimeError(launched.bugs[0].error)
        self.session.show_table(url, status.sweep_id, factors)

    @contextmanager
    def underway(
        self, plan: PlannedTrial, arguments: Sequence[str], planned: int,
        trials: Sequence[PlannedTrial] = (),
    ) -> "Iterator[tuple[database.LogbookWriter, SweepJob]]":  # fmt: skip
        """Begin a sweep in the logbook of a plan, show its progress, and end it after the block.

        `trials` are stored as planned; those of a search are not known before.

        On Ctrl-C its runs are marked as interrupted, after its workers have ended.
        """
        launching.check(self._config.hydra.launcher)
        url, provenance = plan.database_url, self.session.provenance()
        with database.LogbookWriter.open(url, results_dir=plan.results_dir) as logbook:
            rows = [trial.row for trial in trials]
            sweep_id = begin_sweep(logbook, plan.labels, provenance, arguments, planned, rows)
            self.session.sweep_id, self.session.logbook = sweep_id, (url, plan.results_dir)
            job, make = SweepJob(sweep_id, provenance), Plugins.instance().instantiate_launcher
            make = partial(make, self._context, job, self._config)
            with console.shown(url, sweep_id, self.session.view):
                try:
                    with launching.ready(make, self._choice) as self._launcher:
                        yield logbook, job
                except BaseException:  # what Ctrl-C has interrupted may fail by any exception
                    logbook.give_up_sweep(sweep_id)
                    raise
            logbook.end_sweep(sweep_id)

    def _launch(self, plans: Sequence[PlannedTrial], job: SweepJob) -> launching.LaunchResult:
        if len(plans) > 1 and self._choice not in COMPILING:
            composer = Composer(self._loader, self._config)

            def trial(plan: PlannedTrial) -> Trial:
                order = composer.order(list(plan.overrides))
                return build_trial(order.config, order.names)

            precompile((plan.kinds, partial(trial, plan)) for plan in plans)
        size = self.max_batch_size
        return launching.launch(self._launcher, self._choice, plans, job.sweep_id, size)


def begin_sweep(
    logbook: "database.LogbookWriter", labels: SweepLabels, provenance: Provenance,
    arguments: Sequence[str], planned: int, trials: Sequence[Mapping[str, object]] = (),
) -> int:  # fmt: skip
    """Store the start of a sweep with its labels, or the experiment's name; returns its id."""
    prefix = "experiment="
    names = [text.removeprefix(prefix) for text in arguments if prefix in text] or ["sweep"]
    words = labels.name or names[-1], provenance.command, arguments
    return logbook.begin_sweep(*words, planned, tags=labels.tags, note=labels.note, trials=trials)


def planned(composer: Composer, jobs: Sequence[list[str]]) -> list[PlannedTrial | Refusal]:
    """Compose, build and check the jobs; those that choose the same options one after the other."""
    sources, checked, plans = collect().sources, Checked(), dict[int, PlannedTrial | Refusal]()
    choices = [composer.choices(job) for job in jobs]
    for index in sorted(range(len(jobs)), key=choices.__getitem__):
        try:
            plans[index] = plan_of(composer.order(jobs[index]), sources, checked)
        except EXPECTED as error:
            plans[index] = Refusal(shown(jobs[index]), one_line(error, jobs[index]))
    return [plans[index] for index in range(len(jobs))]


def accepted(plans: Iterable[PlannedTrial | Refusal]) -> list[PlannedTrial]:
    """Return the plans without duplicates; raises ConfigurationError if one cannot be run."""
    plans = list(plans)
    refused = [plan for plan in plans if isinstance(plan, Refusal)]
    if refused:
        more = f" (and {len(refused) - 1} more: dry_run=true lists them)" if refused[1:] else ""
        raise ConfigurationError(f"{': '.join(refused[0])}{more}")
    ready = [plan for plan in plans if isinstance(plan, PlannedTrial)]
    if (count := len({(plan.database_url, plan.results_dir) for plan in ready})) > 1:
        raise ConfigurationError(
            f"database.url, results_dir: got {count} logbooks in one sweep, expected one"
        )
    return list({plan.fingerprint: plan for plan in ready}.values())


def finished_before(
    plans: Sequence[PlannedTrial], logbook: "database.LogbookWriter", sweep_id: int
) -> tuple[list[Outcome], list[PlannedTrial]]:
    """Return the outcomes of trials that had finished before, and the plans to be launched."""
    runs = known(plan for plan in plans if not plan.rerun)
    finished = {key: run.run_id for key, run in runs.items() if run.status == "finished"}
    present = logbook.reuse(sweep_id, list(finished.values()))
    done = [plan for plan in plans if finished.get(plan.fingerprint) in present]
    outcomes = [Outcome("skipped", finished[plan.fingerprint]) for plan in done]
    for plan, outcome in zip(done, outcomes, strict=True):
        log.info("%s: already in the logbook as run %d", shown(plan.overrides), outcome.run_id)
    return outcomes, [plan for plan in plans if finished.get(plan.fingerprint) not in present]


def _factors(jobs: Sequence[Sequence[str]]) -> list[str]:
    """Return the options that differ between the jobs, in their order, without the seed."""
    texts = dict.fromkeys(text.lstrip("+") for job in jobs for text in job)
    counts = Counter(text.partition("=")[0] for text in texts)
    return [key for key, levels in counts.items() if levels > 1 and key != "seed"]
