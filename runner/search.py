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
from seatrial.runner.job import PlannedTrial, Planner, Refusal, known, listed, shown
from seatrial.runner.launching import LaunchResult
from seatrial.runner.provenance import collect
from seatrial.runner.sweep import SeatrialSweeper, SweepJob, accepted, finished_before, texts

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
PREFIX = "search."


@dataclass
class Attempt:
    """A candidate: its plans, one for each seed, and what the runs that ended have achieved."""

    asked: "optuna.Trial"
    overrides: list[str]
    plans: list[PlannedTrial]
    results: list[list[float]] = field(default_factory=list)  # one row a seed, by objective
    state: Literal["complete", "pruned", "infeasible"] = "complete"


class SearchSweeper(SeatrialSweeper):
    """Ask, run with every seed, tell; the logbook holds the trials."""

    def sweep(self, arguments: list[str]) -> None:
        """Search the space of the arguments."""
        self.start()
        if find_spec("optuna") is None:
            raise ConfigurationError(
                "hydra/sweeper=optuna is not installed: pip install 'seatrial[search]'"
            )
        own, overrides = self._config, self._overrides(arguments)
        self._options = self._options_of(overrides)
        self._objectives = self._options.objectives()
        self._space = search_space.space_of([o for o in overrides if not _is_search(o)])
        limits = build_as(Limits, OmegaConf.to_container(own.limits, resolve=True), "limits")
        trials, seeds = self._options.trials, len(self._space.seeds)
        budget.check_sweep([("search.trials", trials), ("seed", seeds)], limits)
        self._composer, self._planner = Composer(self._loader, own), Planner(collect().sources)
        self._study = self._options.study()
        if self._options.default_first:
            order = self._composer.order([*self._space.fixed, self._space.seeds[0]])
            if (values := self._space.present(order)) is not None:
                self._study.enqueue_trial(values)
        first = self._ask()
        if own.dry_run is True:
            self.session.say(["the first candidate:"])
            self.session.list_trials(listed(first.plans))
            self.session.say([override.input_line or "" for override in self._space.searched])
            self.session.say([f"{trials} candidates, at most {trials * seeds} trials"])
            return
        plan = accepted(first.plans)[0]
        stored = [text for text in arguments if not text.startswith(PREFIX)]
        stored += [one.override for one in self._objectives]
        done: list[Attempt] = []
        with self.underway(plan, stored, trials * seeds) as sweep:
            launched = self._loop(first, done, sweep.logbook, sweep.job)
            sweep.planned = sum(len(one.results) for one in done)
        self._conclude(launched, done, sweep.job.sweep_id, plan.database_url)

    def _overrides(self, arguments: Sequence[str]) -> list[Override]:
        """Return the overrides of the search; those of the command line replace an experiment's."""
        parser = OverridesParser.create(config_loader=self._loader.hydra)
        variants = self.session.variants or self.variants
        if len(variants) > 1:
            raise ConfigurationError(
                f"hydra/sweeper=optuna: got {len(variants)} variants, expected at most one"
            )
        words = texts(self.params)
        for variant in variants:
            words += texts(variant) if isinstance(variant, Mapping) else variant
        parsed = parser.parse_overrides([*words, *arguments])
        return list({override.get_key_element(): override for override in parsed}.values())

    def _options_of(self, overrides: Sequence[Override]) -> "search_space.SearchOptions":
        node: Any = OmegaConf.to_container(self._config.search, resolve=True)
        for override in overrides:  # a sweep is not in the configuration: search.metric=a,b
            value: Any = override.value()
            if _is_search(override) and isinstance(value, ChoiceSweep):
                key = override.key_or_group.removeprefix(PREFIX)
                node[key] = [str(getattr(item, "text", item)) for item in value.list]
        if isinstance(node["metric"], str):
            node["metric"] = [node["metric"]]
        return build_as(search_space.SearchOptions, node, "search")

    def _ask(self) -> Attempt:
        """Return the next candidate, planned; the first one must not be refused."""
        asked = self._study.ask(dict(self._space.distributions))
        attempt = Attempt(asked, self._space.overrides(self._space.rounded(asked.params)), [])
        for seed in self._space.seeds:
            job = [*attempt.overrides, seed]
            try:
                attempt.plans.append(self._planner.plan(self._composer.order(job)))
            except EXPECTED as error:
                refusal = Refusal(shown(job), one_line(error, job))
                if asked.number == 0:
                    raise ConfigurationError(str(refusal)) from error
                log.warning("refused: %s", refusal)
                attempt.state = "infeasible"
                break
        return attempt

    def _loop(
        self, first: Attempt, done: list[Attempt], logbook: "database.LogbookWriter", job: SweepJob
    ) -> LaunchResult:
        """Run batches of candidates until all are done, or the launcher has lost its workers.

        A single objective is run seed by seed, so that a candidate can be pruned.
        """
        options, seeds = self._options, range(len(self._space.seeds))
        steps = [[seed] for seed in seeds] if options.prunes else [list(seeds)]
        batch, launched = [first], LaunchResult()
        while len(done) < options.trials:
            wanted = min(options.batch, options.trials - len(done)) - len(batch)
            batch += [self._ask() for _ in range(wanted)]
            for step in steps:
                running = [one for one in batch if one.state == "complete"]
                plans = [one.plans[seed] for one in running for seed in step]
                _, remaining = finished_before(plans, logbook, job.sweep_id, quiet=True)
                launched = self._launch(remaining, job)
                lost = [str(one.error) for one in launched.outcomes if one.state == "lost"]
                if lost:
                    launched.error = f"lost: {error_line(lost[0])}"
                if launched.error or launched.bugs:
                    return launched
                runs = known(plans)
                for one in running:
                    for seed in step:
                        self._note(one, runs.get(one.plans[seed].fingerprint), logbook)
                    if options.prunes and one.state == "complete":
                        one.asked.report(self._losses(one)[0], step[0])
                        if step[0] != seeds[-1] and one.asked.should_prune():
                            one.state = "pruned"
            for one in batch:  # an infeasible one is told as pruned with the worst loss there is
                if one.state == "complete":
                    self._study.tell(one.asked, self._losses(one))
                    continue
                if one.state == "infeasible" and len(self._objectives) == 1:
                    one.asked.report(math.inf, len(one.results))
                self._study.tell(one.asked, state=search_space.PRUNED)
            done += batch
            batch = []
        return launched

    def _note(
        self, attempt: Attempt, run: "database.RunSummary | None", logbook: "database.LogbookWriter"
    ) -> None:
        """Add the results of a run; a candidate whose run has none is infeasible."""
        metrics = logbook.metrics(run.run_id) if run and run.status == "finished" else []
        values = [one.value_in(metrics) for one in self._objectives]
        attempt.results.append(values)
        if run and metrics and attempt.asked.number == 0 and math.isnan(values[0]):
            one = self._objectives[0]
            raise ConfigurationError(
                f"search.metric: run {run.run_id} has no {one.metric} "
                f"({one.stage}, {one.model}, {one.dof}), expected one that every trial stores"
            )
        if not all(map(math.isfinite, values)):
            attempt.state = "infeasible"

    def _values(self, attempt: Attempt) -> list[float]:
        pairs = zip(self._objectives, zip(*attempt.results, strict=True), strict=True)
        return [objective.over_seeds(own) for objective, own in pairs]

    def _losses(self, attempt: Attempt) -> list[float]:
        pairs = zip(self._objectives, self._values(attempt), strict=True)
        return [objective.loss(value) for objective, value in pairs]

    def _conclude(
        self, launched: LaunchResult, done: Sequence[Attempt], sweep_id: int, url: str
    ) -> None:
        """Print the first and the best candidates, with the command lines that repeat them."""
        counts = ", ".join(
            f"{sum(one.state == state for one in done)} {state}"
            for state in ("complete", "pruned", "infeasible")
        )
        lines = [
            f"search, sweep {sweep_id}: {len(done)} candidates, {counts}; "
            f"{sum(len(one.results) for one in done)} runs",
            f"figure: {console.compare('plot', url, 'search', '--sweep', str(sweep_id))}",
        ]
        complete = [one for one in done if one.state == "complete"]
        best = [complete[i] for i in search_candidates.front([*map(self._losses, complete)])]
        seeds = "seed=" + ",".join(text.partition("=")[2] for text in self._space.seeds)
        lines += [f"candidate 1: {self._achieved(one)}" for one in done[:1]]
        for one in best:
            command = console.trial_command(["-m", *one.overrides, seeds])
            lines += [f"best: candidate {done.index(one) + 1}, {self._achieved(one)}"]
            lines += [f"  {command}"]
        self._end(launched, lines if best else [*lines, "no candidate is complete"], int(not best))

    def _achieved(self, attempt: Attempt) -> str:
        if attempt.state != "complete":
            return attempt.state
        return ", ".join(
            f"{objective} = {value:.4g} {objective.unit}"
            for objective, value in zip(self._objectives, self._values(attempt), strict=True)
        )


def _is_search(override: Override) -> bool:
    return override.key_or_group.startswith(PREFIX)
