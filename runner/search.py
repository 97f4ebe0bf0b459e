"""The sweeper `hydra/sweeper=optuna`: a search of options in place of a grid.

Optuna proposes candidates (ask) and learns what they achieved (tell); the trials of a candidate are
those of a sweep, one for each seed, in the logbook. There is no second storage: a search that was
killed asks for the same candidates again, and takes their runs from the logbook.
"""

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, Literal

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import ChoiceSweep, Override
from omegaconf import OmegaConf

from seatrial.models.errors import ConfigurationError
from seatrial.runner import console, database
from seatrial.runner.composition import Composer
from seatrial.runner.config import Limits, build_as
from seatrial.runner.database.terminal import error_line
from seatrial.runner.hydra_errors import EXPECTED, one_line
from seatrial.runner.job import Plan, Planner, Refusal, known, listed, shown
from seatrial.runner.launching import LaunchResult
from seatrial.runner.provenance import collect
from seatrial.runner.sweep import (
    SeatrialSweeper,
    SweepJob,
    accepted,
    finished_before,
    texts,
)

if TYPE_CHECKING:
    import optuna

    from seatrial.runner import budget, search_space
    from seatrial.runner.compare import search_candidates
else:
    import lazy_loader

    budget = lazy_loader.load("seatrial.runner.budget", suppress_warning=True)
    search_candidates = lazy_loader.load(
        "seatrial.runner.compare.search_candidates", suppress_warning=True
    )
    # It imports Optuna, which may be lacking.
    search_space = lazy_loader.load("seatrial.runner.search_space", suppress_warning=True)

log = logging.getLogger(__name__)


@dataclass
class Attempt:
    """A candidate on its way: its plans, one for each seed, and the values of those that ended."""

    asked: "optuna.Trial"
    values: "search_space.Values"
    plans: list[Plan]
    results: list[list[float]] = field(default_factory=list)  # by objective, one for each seed
    state: Literal["open", "pruned", "infeasible"] = "open"


class SearchSweeper(SeatrialSweeper):
    """Ask, sail with every seed, tell; the logbook holds the trials."""

    def sweep(self, arguments: list[str]) -> None:
        """Search the space of the arguments."""
        self.start()
        if find_spec("optuna") is None:
            raise ConfigurationError(
                "hydra/sweeper=optuna is not installed: pip install 'seatrial[search]'"
            )
        overrides = self._overrides(arguments)
        options = self._options(overrides)
        self._space = search_space.space_of([o for o in overrides if not _is_search(o)])
        self._distributions = search_space.distributions(self._space.dimensions)
        self._objectives, self._search = options.objectives(), options
        own = self._config
        limits = build_as(Limits, OmegaConf.to_container(own.limits, resolve=True), "limits")
        seeds = len(self._space.seeds)
        budget.check_sweep([("search.trials", options.trials), ("seed", seeds)], limits)
        self._composer = Composer(self._loader, own)
        self._planner = Planner(collect().sources)
        study = options.study()
        self._enqueue_present(study)
        if own.dry_run is True:
            self._show_dry_run(study)
        else:
            self._run_search(study, arguments)

    def _overrides(self, arguments: Sequence[str]) -> list[Override]:
        """Return the overrides of the search; those of the command line replace an experiment's."""
        parser = OverridesParser.create(config_loader=self._loader.hydra)
        variants = self.session.variants or self.variants
        if len(variants) > 1:
            raise ConfigurationError(
                f"hydra/sweeper=optuna: got {len(variants)} variants, expected at most one"
            )
        own = [
            text
            for variant in variants
            for text in (texts(variant) if isinstance(variant, Mapping) else variant)
        ]
        last: dict[str, Override] = {}
        for override in parser.parse_overrides([*texts(self.params), *own, *arguments]):
            last[override.get_key_element()] = override
        return list(last.values())

    def _options(self, overrides: Sequence[Override]) -> "search_space.SearchOptions":
        node: Any = OmegaConf.to_container(self._config.search, resolve=True)
        for override in overrides:  # a sweep is not in the configuration: search.metric=a,b
            value: Any = override.value()
            if _is_search(override) and isinstance(value, ChoiceSweep):
                key = override.key_or_group.removeprefix(search_candidates.PREFIX)
                node[key] = [str(getattr(item, "text", item)) for item in value.list]
        if isinstance(node["metric"], str):
            node["metric"] = [node["metric"]]
        return build_as(search_space.SearchOptions, node, "search")

    def _enqueue_present(self, study: "optuna.Study") -> None:
        """Let the first candidate be the configuration as it is, if the space contains it."""
        if not self._search.default_first:
            return
        order = self._composer.order([*self._space.fixed, self._space.seeds[0]])
        values = search_space.present(
            self._space.dimensions, self._distributions, order.config, order.names
        )
        if values is not None:
            study.enqueue_trial(values)

    def _ask(self, study: "optuna.Study") -> Attempt:
        asked = study.ask(self._distributions)
        values = search_space.rounded(asked.params, self._distributions)
        attempt = Attempt(asked, values, [], [[] for _ in self._objectives])
        try:
            for job in self._space.jobs(values):
                attempt.plans.append(self._planner.plan(self._composer.order(job)))
        except EXPECTED as error:
            refusal = Refusal(shown(job), one_line(error, job))
            if asked.number == 0:
                raise ConfigurationError(str(refusal)) from error
            log.warning("refused: %s", refusal)
            attempt.state = "infeasible"
        return attempt

    def _show_dry_run(self, study: "optuna.Study") -> None:
        plans = self._ask(study).plans
        most = self._search.trials * len(self._space.seeds)
        self.session.say(["the first candidate:"])
        self.session.list_trials(listed(plans))
        self.session.say(
            f"{name}: {search_space.described(distribution)}"
            for name, distribution in self._distributions.items()
        )
        self.session.say([f"{self._search.trials} candidates, at most {most} trials"])

    def _run_search(self, study: "optuna.Study", arguments: list[str]) -> None:
        first = self._ask(study)
        plan = accepted(first.plans)[0]
        stored = [text for text in arguments if not text.startswith(search_candidates.PREFIX)]
        stored += search_candidates.as_overrides(self._objectives)
        most = self._search.trials * len(self._space.seeds)
        done: list[Attempt] = []
        with self.underway(plan, stored, most) as sweep:
            launched = self._loop(study, [first], done, sweep.logbook, sweep.job)
            sweep.planned = sum(len(one.results[0]) for one in done)
        best = self._best(done)
        lines = self._summary(done, sweep.job.sweep_id, plan.database_url)
        self._end(launched, [*lines, *self._shown(best, done)], 0 if best else 1)

    def _loop(
        self,
        study: "optuna.Study",
        attempts: list[Attempt],
        done: list[Attempt],
        logbook: "database.Logbook",
        job: SweepJob,
    ) -> LaunchResult:
        """Run batches of candidates until all are done, or the launcher has lost its workers."""
        while True:
            left = self._search.trials - len(done) - len(attempts)
            wanted = min(self._search.batch - len(attempts), left)
            attempts += [self._ask(study) for _ in range(wanted)]
            launched = self._sail(attempts, logbook, job)
            if launched.error or launched.bugs:
                return launched
            for attempt in attempts:
                self._tell(study, attempt)
            done += attempts
            attempts = []
            if len(done) >= self._search.trials:
                return launched

    def _sail(
        self, attempts: Sequence[Attempt], logbook: "database.Logbook", job: SweepJob
    ) -> LaunchResult:
        """Sail a batch seed by seed; with nothing to prune, with all seeds at once."""
        seeds = range(len(self._space.seeds))
        prunes = self._search.prunes
        steps = [[seed] for seed in seeds] if prunes else [list(seeds)]
        launched = LaunchResult()
        for step in steps:
            running = [one for one in attempts if one.state == "open"]
            plans = [one.plans[seed] for one in running for seed in step]
            _, remaining = finished_before(plans, logbook, job.sweep_id, quiet=True)
            launched = self._launch(remaining, job)
            lost = [str(one.error) for one in launched.outcomes if one.state == "lost"]
            if lost:
                launched.error = f"lost: {error_line(lost[0])}"
            if launched.error or launched.bugs:
                break
            runs = known(plans)
            for one in running:
                for seed in step:
                    self._note(one, runs.get(one.plans[seed].fingerprint), logbook)
                if prunes and one.state == "open":
                    self._report(one, step[0])
        return launched

    def _note(
        self,
        attempt: Attempt,
        run: "database.RunSummary | None",
        logbook: "database.Logbook",
    ) -> None:
        """Add the results of a run; a candidate whose run has none is infeasible."""
        metrics = logbook.metrics(run.run_id) if run and run.status == "finished" else []
        values = [one.value_in(metrics) for one in self._objectives]
        for own, value in zip(attempt.results, values, strict=True):
            own.append(value)
        if metrics and attempt.asked.number == 0 and math.isnan(values[0]):
            one = self._objectives[0]
            raise ConfigurationError(
                f"search.metric: run {run.run_id if run else ''} has no {one.metric} "
                f"({one.stage}, {one.model}, {one.dof}), expected one that every trial stores"
            )
        if not all(map(math.isfinite, values)):
            attempt.state = "infeasible"

    def _report(self, attempt: Attempt, step: int) -> None:
        (own,), (objective,) = attempt.results, self._objectives
        attempt.asked.report(objective.loss(objective.over_seeds(own)), step)
        last = step == len(self._space.seeds) - 1
        if not last and attempt.asked.should_prune():
            attempt.state = "pruned"

    def _tell(self, study: "optuna.Study", attempt: Attempt) -> None:
        """Tell the losses; an infeasible candidate is told as pruned, the worst that there is."""
        if attempt.state == "open":
            study.tell(attempt.asked, self._losses(attempt))
            return
        if attempt.state == "infeasible" and len(self._objectives) == 1:
            attempt.asked.report(math.inf, len(attempt.results[0]))
        study.tell(attempt.asked, state=search_space.PRUNED)

    def _values(self, attempt: Attempt) -> list[float]:
        pairs = zip(self._objectives, attempt.results, strict=True)
        return [objective.over_seeds(own) for objective, own in pairs]

    def _losses(self, attempt: Attempt) -> list[float]:
        pairs = zip(self._objectives, self._values(attempt), strict=True)
        return [objective.loss(value) for objective, value in pairs]

    def _best(self, done: Sequence[Attempt]) -> list[Attempt]:
        """Return the complete candidates that no other dominates, in their order."""
        found = [
            search_candidates.Candidate(i, (), tuple(self._values(one)), "complete")
            for i, one in enumerate(done)
            if one.state == "open"
        ]
        return [done[one.number] for one in search_candidates.front(found, self._objectives)]

    def _summary(self, done: Sequence[Attempt], sweep_id: int, url: str) -> list[str]:
        counts = {s: sum(one.state == s for one in done) for s in ("open", "pruned", "infeasible")}
        runs = sum(len(one.results[0]) for one in done)
        return [
            f"search, sweep {sweep_id}: {len(done)} candidates, {counts['open']} complete, "
            f"{counts['pruned']} pruned, {counts['infeasible']} infeasible; {runs} runs",
            f"figure: {console.compare('plot', url, 'search', '--sweep', str(sweep_id))}",
        ]

    def _shown(self, best: Sequence[Attempt], done: Sequence[Attempt]) -> list[str]:
        """Return the first and the best candidates, with the command lines that repeat them."""
        lines = [f"candidate 1: {self._achieved(done[0])}"] if done else []
        if not best:
            return [*lines, "no candidate is complete"]
        for one in best:
            words = console.trial_command(["-m", *self._space.command(one.values)])
            lines += [f"best: candidate {done.index(one) + 1}, {self._achieved(one)}", f"  {words}"]
        return lines

    def _achieved(self, attempt: Attempt) -> str:
        if attempt.state != "open":
            return attempt.state
        return ", ".join(
            f"{objective} = {value:.4g} {objective.unit}"
            for objective, value in zip(self._objectives, self._values(attempt), strict=True)
        )


def _is_search(override: Override) -> bool:
    return override.key_or_group.startswith(search_candidates.PREFIX)
