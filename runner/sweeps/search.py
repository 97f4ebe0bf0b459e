"""The sweeper `hydra/sweeper=optuna`: a search of options in place of a grid.

Optuna proposes candidates (ask) and learns what they achieved (tell); the trials of a candidate are
those of a sweep, one for each seed, in the logbook. The sampler is seeded, so a search that is
started again asks for the same candidates, and takes their runs from the logbook.
"""

import logging
import math
import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import astuple, dataclass, field
from importlib.util import find_spec
from statistics import median
from typing import TYPE_CHECKING, Any, Literal

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import ChoiceSweep, Glob, Override, RangeSweep
from omegaconf import OmegaConf

from seatrial.models.errors import ConfigurationError, SeatrialError
from seatrial.models.ranges import NotNegativeInt, PositiveInt, check_ranges
from seatrial.runner.configuration.config import Limits, build_as
from seatrial.runner.configuration.hydra_errors import EXPECTED
from seatrial.runner.configuration.invocation import meant, trial_program
from seatrial.runner.sweeps import console
from seatrial.runner.sweeps import sweep as sweeps
from seatrial.runner.sweeps.composition import Composer, nested_sweeps, text_of
from seatrial.runner.sweeps.job import Order, PlannedTrial, Refusal, known, listed

if TYPE_CHECKING:  # what is slow to import, and Optuna may be lacking
    import optuna

    from seatrial.runner import database
    from seatrial.runner.record import catalogue
    from seatrial.runner.trials import budget
else:
    import lazy_loader

    # lazy_loader looks through the stack for what is absent, which loads all other lazy modules.
    optuna = lazy_loader.load("optuna") if find_spec("optuna") else None
    budget = lazy_loader.load("seatrial.runner.trials.budget", suppress_warning=True)
    catalogue = lazy_loader.load("seatrial.runner.record.catalogue", suppress_warning=True)

log = logging.getLogger(__name__)
STAGES = ("deployment", "validation", "identification")  # the first one that a metric has


@dataclass(frozen=True)
class SearchOptions:
    """The options of a search, as conf/hydra/sweeper/optuna.yaml explains them."""

    metric: tuple[str, ...]
    direction: Literal["auto", "minimize", "maximize"]
    trials: PositiveInt
    batch: PositiveInt
    startup: PositiveInt
    sampler_seed: NotNegativeInt
    prune: bool

    def __post_init__(self) -> None:
        check_ranges(self)
        if not self.metric:
            raise ConfigurationError("search.metric: got none, expected at least one metric")


class Objective:
    """The median over the runs of a candidate of one metric of the identified model.

    `metric` is a name of the catalogue, or name:dof. Raises ConfigurationError for another one, and
    if neither the catalogue nor the direction says which of its values are better.
    """

    def __init__(self, metric: str, direction: str) -> None:
        self.name, _, dof = metric.partition(":")
        names = [each.name for each in catalogue.all_declared()]
        if self.name not in names:
            hint = meant(self.name, names).rstrip() or "see seatrial-results metrics"
            raise ConfigurationError(f"search.metric: got {self.name!r}, {hint}")
        declared = catalogue.declared(self.name)
        units = [] if isinstance(declared.unit, str) else [*declared.unit]
        dof = dof or (units[0] if len(units) == 1 else "")
        if not dof or (units and dof not in units):
            expected = ", ".join(f"{self.name}:{each}" for each in units or ("<dof>", "all"))
            raise ConfigurationError(f"search.metric: got {metric}, expected one of {expected}")
        better = {"minimize": "lower", "maximize": "higher"}.get(direction, declared.better)
        if better is None:
            raise ConfigurationError(
                f"search.direction: {self.name} has no better direction, "
                "expected minimize or maximize"
            )
        self.better, self.unit = better, declared.unit_of(dof)
        self.place = (min(declared.stages, key=STAGES.index), "identified", dof, self.name)

    def over_runs(self, runs: Sequence[Mapping[Any, float | None]]) -> float:
        """Return the median over the metrics of runs; NaN if one of them has no finite value."""
        values = [math.nan if (value := run.get(self.place)) is None else value for run in runs]
        return median(values) if all(map(math.isfinite, values)) else math.nan

    def loss(self, value: float) -> float:
        """Return what is to be as low as possible: the value, minus it, or the distance to it."""
        if isinstance(self.better, str):
            return -value if self.better == "higher" else value
        return abs(value - self.better)


class Space:
    """The options of a search that have several values, the seeds, and the options with one value.

    A parameter is named by its option, as `identifier` or `controller.kp[0]`. Raises
    ConfigurationError if there is none, or if one has no values.
    """

    def __init__(self, overrides: Sequence[Override]) -> None:
        self.searched: dict[str, Override] = {}
        self.distributions: dict[str, optuna.distributions.BaseDistribution] = {}
        self.seeds, self.fixed = ["seed=0"], list[str]()
        for override in overrides:
            key = override.get_key_element()
            if key == "seed":
                self.seeds = sweeps.values_of(override)
            elif values := dict(nested_sweeps(override.value(), key)):
                self.searched[key] = override
                for name, value in values.items():
                    try:
                        self.distributions[name] = _distribution(override, value)
                    except (ValueError, TypeError) as error:  # of Optuna
                        reason = " ".join(str(error).split())
                        raise ConfigurationError(f"{name}: {reason}") from error
            else:
                self.fixed += sweeps.values_of(override)
        if not self.searched:
            raise ConfigurationError(
                "hydra/sweeper=optuna: got no option to search, expected one such as "
                "'controller.kp=[interval(50,200),550,940]' or identifier=ls,plsr"
            )

    def overrides(self, parameters: Mapping[str, Any]) -> list[str]:
        """Return the overrides of a candidate without its seed, numbers with six digits."""
        values = dict(parameters)
        for name, space in self.distributions.items():
            if isinstance(space, optuna.distributions.FloatDistribution):
                values[name] = min(max(float(f"{values[name]:.6g}"), space.low), space.high)
        texts = {key: text_of(each.value(), key, values) for key, each in self.searched.items()}
        return [*self.fixed, *(f"{key}={text}" for key, text in texts.items())]

    def parameters(self, order: Order) -> dict[str, Any]:
        """Return the parameters of a configuration; raises ValueError if it is not in the space."""
        config, values = OmegaConf.create(dict(order.config)), dict[str, Any]()
        for name, space in self.distributions.items():
            key = name.lstrip("+")
            value = order.names.get(key) or OmegaConf.select(config, key)
            choice = isinstance(space, optuna.distributions.CategoricalDistribution)
            values[name] = text_of(value) if choice else value
        optuna.create_trial(value=0.0, params=values, distributions=self.distributions)
        return values


def _distribution(override: Override, values: Any) -> Any:
    """Return Optuna's distribution of a sweep; raises ValueError or TypeError for an empty one."""
    kinds: Any = optuna.distributions
    if isinstance(values, Glob):
        return kinds.CategoricalDistribution([*override.sweep_string_iterator()])
    if isinstance(values, ChoiceSweep):
        return kinds.CategoricalDistribution([*dict.fromkeys(map(text_of, values.list))])
    if isinstance(values, RangeSweep):  # its end is not one of its values
        if not (each := sorted(values.range())):
            raise ValueError("got no values, expected at least one")
        low, high, scale = each[0], each[-1], {"step": abs(values.step)}
    else:
        low, high, scale = values.start, values.end, {"log": "log" in values.tags}
    integers = isinstance(low, int) and isinstance(high, int)
    return (kinds.IntDistribution if integers else kinds.FloatDistribution)(low, high, **scale)


@dataclass
class Attempt:
    """A candidate: its plans, one for each seed, and the metrics of its runs that have ended."""

    asked: "optuna.Trial"
    plans: list[PlannedTrial]
    state: Literal["complete", "pruned", "infeasible"]
    # Values by stage, model, dof and name; none of a run that has failed.
    runs: list[dict[tuple[Any, ...], float | None]] = field(default_factory=list)
    losses: list[float] = field(default_factory=list)  # by objective, over the runs so far


class SearchSweeper(sweeps.SeatrialSweeper):
    """Ask, run with every seed, tell; the logbook holds the trials."""

    def sweep(self, arguments: list[str]) -> None:
        """Search the space of the arguments; they replace an experiment's options."""
        self.session.started = True
        if find_spec("optuna") is None:
            raise ConfigurationError(
                "hydra/sweeper=optuna is not installed: pip install 'seatrial[search]'"
            )
        own, words = self._config, sweeps.texts(self.params)
        variants = self.session.variants or self.variants
        if (count := len(variants)) > 1:
            raise ConfigurationError(f"hydra/sweeper=optuna: got {count} variants, expected one")
        for variant in variants:
            words += sweeps.texts(variant) if isinstance(variant, Mapping) else variant
        parser = OverridesParser.create(config_loader=self._loader.hydra)
        parsed = parser.parse_overrides([*words, *arguments])
        overrides = {override.get_key_element(): override for override in parsed}  # the last counts
        node: Any = OmegaConf.to_container(own.search, resolve=True)
        for key in [key for key in overrides if key.startswith("search.")]:
            value = overrides.pop(key).value()
            if isinstance(value, ChoiceSweep):  # in no configuration: search.metric=a,b
                texts = [str(getattr(item, "text", item)) for item in value.list]
                node[key.removeprefix("search.")] = texts
        if isinstance(node["metric"], str):
            node["metric"] = [node["metric"]]
        self._options = options = build_as(SearchOptions, node, "search")
        self._objectives = [Objective(name, options.direction) for name in options.metric]
        self._space = space = Space([*overrides.values()])
        trials, seeds = options.trials, len(space.seeds)
        limits = build_as(Limits, OmegaConf.to_container(own.limits, resolve=True), "limits")
        budget.check_sweep([("search.trials", trials), ("seed", seeds)], limits)
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        startup, seed = options.startup, options.sampler_seed
        self._study = optuna.create_study(  # every loss is minimised
            sampler=optuna.samplers.TPESampler(n_startup_trials=startup, seed=seed),
            pruner=optuna.pruners.MedianPruner(startup, n_warmup_steps=1),
            directions=["minimize"] * len(options.metric),
        )
        self._composer = Composer(self._loader, own)
        with suppress(ValueError, *EXPECTED):  # the configuration as it is, if it is in the space
            default = self._composer.order([*space.fixed, space.seeds[0]])
            self._study.enqueue_trial(space.parameters(default))
        first = self._ask()
        if own.dry_run is True:
            self.session.trials = listed(first.plans)
            self.session.say(["the first candidate:", *console.dry_run(self.session.trials)])
            lines = [override.input_line or "" for override in space.searched.values()]
            self.session.say([*lines, f"{trials} candidates, at most {trials * seeds} trials"])
            return
        plan = sweeps.accepted(first.plans)[0]
        with self.underway(plan, arguments, trials * seeds) as (logbook, job):
            done = self._search(first, logbook, job)
            logbook.end_sweep(job.sweep_id, sum(len(one.runs) for one in done))
        self._conclude(done, job.sweep_id, plan.database_url)

    def _ask(self) -> Attempt:
        """Return the next candidate, planned; the first one must not be refused."""
        asked = self._study.ask(self._space.distributions)
        overrides = self._space.overrides(asked.params)
        plans = sweeps.planned(self._composer, [[*overrides, seed] for seed in self._space.seeds])
        for refusal in [plan for plan in plans if isinstance(plan, Refusal)][:1]:
            if asked.number == 0:
                raise ConfigurationError(": ".join(refusal))
            log.warning("refused: %s", ": ".join(refusal))
        ready = [plan for plan in plans if isinstance(plan, PlannedTrial)]
        return Attempt(asked, ready, "infeasible" if len(ready) < len(plans) else "complete")

    def _search(
        self, first: Attempt, logbook: "database.LogbookWriter", job: sweeps.SweepJob
    ) -> list[Attempt]:
        """Run batches of candidates until all are done.

        Optuna's pruners know a single objective; then candidates are run seed by seed. Infeasible
        ones are told as pruned, with the worst loss.
        """
        options, seeds = self._options, range(len(self._space.seeds))
        single = len(options.metric) == 1
        batch, done = [first], list[Attempt]()
        while len(done) < options.trials:
            wanted = min(options.batch, options.trials - len(done))
            batch += [self._ask() for _ in range(wanted - len(batch))]
            for step in [[seed] for seed in seeds] if options.prune and single else [[*seeds]]:
                running = [one for one in batch if one.state == "complete"]
                plans = [one.plans[seed] for one in running for seed in step]
                _, remaining = sweeps.finished_before(plans, logbook, job.sweep_id)
                launched = self._launch(remaining, job)
                if launched.bugs:
                    raise RuntimeError(launched.bugs[0].error)
                if lost := [one.error for one in launched.outcomes if one.state == "lost"]:
                    raise SeatrialError(f"lost: {lost[0]}")
                ended = known(plans)
                for one in running:
                    for run in [ended.get(one.plans[seed].fingerprint) for seed in step]:
                        id_ = run.run_id if run and run.status == "finished" else None
                        metrics = logbook.metrics(id_) if id_ else []
                        one.runs.append({astuple(each)[:4]: each.value for each in metrics})
                        for *place, name in [each.place for each in self._objectives]:
                            if one is first and metrics and (*place, name) not in one.runs[-1]:
                                raise ConfigurationError(
                                    f"search.metric: run {id_} has no {name} "
                                    f"({', '.join(place)}), expected one that every trial stores"
                                )
                    one.losses = [each.loss(each.over_runs(one.runs)) for each in self._objectives]
                    if not all(map(math.isfinite, one.losses)):
                        one.state = "infeasible"
                    elif single:
                        one.asked.report(one.losses[0], step[-1])
                        if step[-1] != seeds[-1] and one.asked.should_prune():
                            one.state = "pruned"
            for one in batch:
                if one.state == "complete":
                    self._study.tell(one.asked, one.losses)
                    continue
                if one.state == "infeasible" and single:
                    one.asked.report(math.inf, len(one.runs))
                self._study.tell(one.asked, state=optuna.trial.TrialState.PRUNED)
            done += batch
            batch = []
        return done

    def _conclude(self, done: Sequence[Attempt], sweep_id: int, url: str) -> None:
        """Print the first and the best candidates, with the command lines that repeat them."""

        def achieved(one: Attempt) -> str:
            if one.state != "complete":
                return one.state
            values = [(each, each.over_runs(one.runs)) for each in self._objectives]
            return ", ".join(f"median {each.name} = {x:.4g} {each.unit}" for each, x in values)

        states, runs = Counter(one.state for one in done), sum(len(one.runs) for one in done)
        counts = ", ".join(f"{states[key]} {key}" for key in ("complete", "pruned", "infeasible"))
        options = ",".join(key.lstrip("+") for key in self._space.searched)
        names = ",".join(each.name for each in self._objectives)
        table = ("table", url, "--rows", options, "--metric", names, "--sweep", str(sweep_id))
        lines = [
            f"search, sweep {sweep_id}: {len(done)} candidates, {counts}; {runs} runs",
            f"compare: {console.compare(*table)}",
            f"candidate 1: {achieved(done[0])}",
        ]
        best = dict[tuple[float, ...], Attempt]()  # of equal candidates the first
        for trial in self._study.best_trials:
            best.setdefault(tuple(trial.values), done[trial.number])
        seeds = "seed=" + ",".join(text.partition("=")[2] for text in self._space.seeds)
        for one in best.values():
            words = shlex.join(["-m", *one.plans[0].overrides[:-1], seeds])
            lines.append(f"best: candidate {one.asked.number + 1}, {achieved(one)}")
            lines.append(f"  {trial_program()} {words}")
        self.session.say(lines if best else [*lines, "no candidate is complete"])
        self.session.exit_code = int(not best)
