"""Candidates of a search: what was to be made better, and what each candidate achieved.

A search is a sweep whose overrides name its objectives (`search.metric=...`). The trials of a
candidate differ in the seed only, so they have one `experiment`.
"""

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Literal, Protocol

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.results import FINISHED, Results, Run
from seatrial.runner.compare.statistics import summary
from seatrial.runner.compare.where import OfSweeps
from seatrial.runner.database.records import SweepSummary
from seatrial.runner.record.catalogue import Better, all_declared, declared
from seatrial.runner.vocabulary import STATUSES

PREFIX = "search."
STAGES = ("deployment", "validation", "identification")  # the first one that a metric has
DIRECTIONS: Mapping[str, Better] = {"minimize": "lower", "maximize": "higher"}
State = Literal["complete", "pruned", "infeasible"]


class Fact(Protocol):
    """A stored metric."""

    @property
    def name(self) -> str:
        """Of the catalogue."""

    @property
    def stage(self) -> str:
        """In which it was stored."""

    @property
    def model(self) -> str:
        """That it judges."""

    @property
    def dof(self) -> str:
        """Degree of freedom, or position, heading, all."""

    @property
    def value(self) -> float | None:
        """None if it is not defined."""


@dataclass(frozen=True)
class Objective:
    """A statistic over seeds of one metric; `better` is lower, higher or a target."""

    metric: str
    dof: str
    stage: str
    model: str
    statistic: str
    better: Better
    unit: str

    def __str__(self) -> str:
        return f"{self.statistic} {self.metric}"

    def value_in(self, facts: Iterable[Fact]) -> float:
        """Return the value that a run has stored; NaN if it has none."""
        own = (self.metric, self.stage, self.model, self.dof)
        values = [f.value for f in facts if (f.name, f.stage, f.model, f.dof) == own]
        return math.nan if not values or values[0] is None else values[0]

    def over_seeds(self, values: Sequence[float]) -> float:
        """Return the statistic of one value a seed; NaN if one of them is not defined."""
        sample = np.array(values, dtype=np.float64)
        if not np.all(np.isfinite(sample)):
            return math.nan
        return float(summary(sample, [self.statistic])[self.statistic])

    def loss(self, value: float) -> float:
        """Return what is to be as low as possible: the value, minus it, or the distance to it."""
        if isinstance(self.better, int | float):
            return abs(value - self.better)
        return -value if self.better == "higher" else value


def objective_of(
    metric: str, dof: str | None, stage: str | None, model: str, statistic: str, direction: str
) -> Objective:
    """Return the objective of a search; raises ConfigurationError for what no trial stores.

    `metric` is a name of the catalogue, or name:dof.
    """
    name, _, own = metric.partition(":")
    known = [each.name for each in all_declared()]
    if name not in known:
        close = get_close_matches(name, known, n=1)
        hint = f"did you mean {close[0]}?" if close else "see seatrial-results metrics"
        raise ConfigurationError(f"search.metric: got {name!r}, {hint}")
    definition = declared(name)
    stages = [each for each in STAGES if each in definition.stages]
    if stage is not None and stage not in stages:
        raise ConfigurationError(
            f"search.stage: got {stage}, expected one of {', '.join(stages)} for {name}"
        )
    units = definition.unit if isinstance(definition.unit, Mapping) else None
    dof = own or dof or (next(iter(units)) if units and len(units) == 1 else None)
    if dof is None or (units is not None and dof not in units):
        expected = ", ".join(units) if units else "a degree of freedom, or all"
        raise ConfigurationError(f"search.dof: got {dof} for {name}, expected {expected}")
    better = DIRECTIONS.get(direction, definition.better)
    if better is None:
        raise ConfigurationError(
            f"search.direction: {name} has no better direction, expected minimize or maximize"
        )
    return Objective(
        name, dof, stage or stages[0], model, statistic, better, definition.unit_of(dof)
    )


def as_overrides(objectives: Sequence[Objective]) -> list[str]:
    """Return the overrides that name the objectives of a search, for its row in the logbook."""
    first = objectives[0]
    metrics = ",".join(f"{one.metric}:{one.dof}" for one in objectives)
    return [
        f"{PREFIX}metric={metrics}",
        f"{PREFIX}stage={','.join(one.stage for one in objectives)}",
        f"{PREFIX}better={','.join(str(one.better) for one in objectives)}",
        f"{PREFIX}model={first.model}",
        f"{PREFIX}statistic={first.statistic}",
    ]


def objectives_in(overrides: Sequence[str]) -> list[Objective]:
    """Return the objectives of a sweep from its overrides; empty if it was no search."""
    pairs = (text.removeprefix(PREFIX).partition("=") for text in overrides if PREFIX in text[:7])
    options = {key: value for key, _, value in pairs}
    if not {"metric", "stage", "better", "model", "statistic"} <= options.keys():
        return []
    lists = [options[name].split(",") for name in ("metric", "stage", "better")]
    found = []
    for metric, stage, better in zip(*lists, strict=True):
        name, _, dof = metric.partition(":")
        goal: Better = better if better in ("lower", "higher") else float(better)
        unit = declared(name).unit_of(dof)
        found.append(
            Objective(name, dof, stage, options["model"], options["statistic"], goal, unit)
        )
    return found


@dataclass(frozen=True)
class Candidate:
    """One candidate with its runs; a value for each objective, NaN if it is infeasible.

    A pruned candidate was stopped after its first seeds; an infeasible one failed or diverged.
    """

    number: int  # from 1, in the order of the search
    runs: tuple[int, ...]
    values: tuple[float, ...]
    state: State


def candidates(
    results: Results, sweep: SweepSummary, objectives: Sequence[Objective]
) -> list[Candidate]:
    """Return the candidates of a search, in its order."""
    condition = OfSweeps((sweep.id,))
    runs = results.runs(condition)
    names = [one.metric for one in objectives]
    facts: dict[int, list[Fact]] = defaultdict(list)
    for observation in results.metrics(runs, names, condition):
        facts[observation.run.id].append(observation)
    groups: dict[str, list[Run]] = defaultdict(list)
    for run in runs:
        if run.status in STATUSES and run.status != "running":
            groups[run.experiment or ""].append(run)
    most = max((len(group) for group in groups.values()), default=0)
    return [
        _candidate(number, group, objectives, facts, most)
        for number, group in enumerate(groups.values(), 1)
    ]


def _candidate(
    number: int,
    runs: Sequence[Run],
    objectives: Sequence[Objective],
    facts: Mapping[int, Sequence[Fact]],
    most: int,
) -> Candidate:
    values = tuple(
        one.over_seeds([one.value_in(facts.get(run.id, ())) for run in runs]) for one in objectives
    )
    feasible = all(run.status == FINISHED for run in runs) and all(map(math.isfinite, values))
    state: State = "pruned" if len(runs) < most else "complete"
    return Candidate(
        number,
        tuple(run.id for run in runs),
        values if feasible else tuple(math.nan for _ in values),
        state if feasible else "infeasible",
    )


def front(chosen: Sequence[Candidate], objectives: Sequence[Objective]) -> list[Candidate]:
    """Return the complete candidates that no other one dominates; of one objective, the best."""
    complete = [one for one in chosen if one.state == "complete"]
    losses = {
        one.number: [o.loss(v) for o, v in zip(objectives, one.values, strict=True)]
        for one in complete
    }
    kept: list[Candidate] = []
    for one in complete:
        own = losses[one.number]
        if not any(_dominates(losses[other.number], own) for other in complete) and not any(
            losses[other.number] == own for other in kept
        ):
            kept.append(one)
    return kept


def _dominates(first: Sequence[float], second: Sequence[float]) -> bool:
    return all(a <= b for a, b in zip(first, second, strict=True)) and first != second


def search_sweep(results: Results, sweep: str | None) -> SweepSummary:
    """Return the search of --sweep, or the newest one; raises ConfigurationError if none is."""
    searches = [one for one in results.reader.sweeps() if objectives_in(one.overrides)]
    if sweep is not None:
        searches = [one for one in searches if sweep in (str(one.id), one.name)]
    if not searches:
        which = f"sweep {sweep} is none" if sweep else "there is none"
        raise ConfigurationError(f"plot search: {which}, expected a sweep of hydra/sweeper=optuna")
    return searches[-1]
