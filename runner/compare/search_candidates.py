"""The objectives of a search, and what each of its candidates achieved.

A search is a sweep whose overrides name its objectives (`search.objective=...`). The trials of a
candidate differ in the seed only, so they have one `experiment`.
"""

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import astuple, dataclass
from difflib import get_close_matches
from typing import Any, Literal

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.results import FINISHED, Queries
from seatrial.runner.compare.where import OfSweeps
from seatrial.runner.database.records import SweepSummary
from seatrial.runner.record.catalogue import all_declared, declared
from seatrial.runner.vocabulary import ENDINGS

STORED = "search.objective="  # begins the override of an objective, in the row of a sweep
STAGES = ("deployment", "validation", "identification")  # the first one that a metric has
DIRECTIONS = {"minimize": "lower", "maximize": "higher"}


@dataclass(frozen=True)
class Objective:
    """A statistic over seeds of one metric; `better` is lower, higher or the target's number."""

    metric: str
    dof: str
    stage: str
    model: str
    statistic: str
    better: str

    def __str__(self) -> str:
        return f"{self.statistic} {self.metric}"

    @property
    def override(self) -> str:
        """The override by which a sweep stores its objective."""
        return STORED + ":".join(astuple(self))

    @property
    def unit(self) -> str:
        """The unit of the metric."""
        return declared(self.metric).unit_of(self.dof)

    def values(self, metrics: Iterable[Any]) -> list[float]:
        """Return the value among the stored metrics of a run; empty if it has none."""
        place = (self.metric, self.stage, self.model, self.dof)
        own = [m.value for m in metrics if (m.name, m.stage, m.model, m.dof) == place]
        return [math.nan if value is None else float(value) for value in own]

    def over_runs(self, runs: Sequence[Iterable[Any]]) -> float:
        """Return the statistic over the metrics of runs; NaN if one of them has no finite value."""
        values = [next(iter(self.values(metrics)), math.nan) for metrics in runs]
        finite = values and np.all(np.isfinite(values))
        return float(getattr(np, self.statistic)(values)) if finite else math.nan

    def loss(self, value: float) -> float:
        """Return what is to be as low as possible: the value, minus it, or the distance to it."""
        if self.better in ("lower", "higher"):
            return -value if self.better == "higher" else value
        return abs(value - float(self.better))


def objective_of(
    metric: str, stage: str | None, model: str, statistic: str, direction: str
) -> Objective:
    """Return the objective of a search; raises ConfigurationError for what no trial stores.

    `metric` is a name of the catalogue, or name:dof.
    """
    name, _, dof = metric.partition(":")
    known = {each.name: each for each in all_declared()}
    if name not in known:
        close = get_close_matches(name, known, n=1)
        hint = f"did you mean {close[0]}?" if close else "see seatrial-results metrics"
        raise ConfigurationError(f"search.metric: got {name!r}, {hint}")
    definition = known[name]
    stages = [each for each in STAGES if each in definition.stages]
    if stage not in (None, *stages):
        expected = " or ".join(stages)
        raise ConfigurationError(f"search.stage: got {stage} for {name}, expected {expected}")
    units = [*definition.unit] if isinstance(definition.unit, Mapping) else []
    dof = dof or (units[0] if len(units) == 1 else "")
    if not dof or (units and dof not in units):
        expected = ", ".join(f"{name}:{each}" for each in units or ("<dof>", "all"))
        raise ConfigurationError(f"search.metric: got {metric}, expected one of {expected}")
    better = DIRECTIONS.get(direction, definition.better)
    if better is None:
        raise ConfigurationError(
            f"search.direction: {name} has no better direction, expected minimize or maximize"
        )
    return Objective(name, dof, stage or stages[0], model, statistic, str(better))


@dataclass(frozen=True)
class Candidate:
    """One candidate with its runs; a value for each objective, NaN if it is infeasible.

    A pruned candidate was stopped after its first seeds; an infeasible one failed or diverged.
    """

    number: int  # from 1, in the order of the search
    runs: tuple[int, ...]
    values: tuple[float, ...]
    state: Literal["complete", "pruned", "infeasible"]


def search_of(results: Queries, name: str | None) -> tuple[SweepSummary, list[Objective]]:
    """Return a search and its objectives: the sweep of this number or name, or the newest search.

    Raises ConfigurationError if there is none.
    """
    for sweep in reversed(results.reader.sweeps()):
        stored = [text.removeprefix(STORED) for text in sweep.overrides if STORED in text]
        if stored and name in (None, str(sweep.id), sweep.name):
            return sweep, [Objective(*text.split(":")) for text in stored]
    which = f"sweep {name} is none" if name else "there is none"
    raise ConfigurationError(f"plot search: {which}, expected a sweep of hydra/sweeper=optuna")


def candidates(
    results: Queries, sweep: SweepSummary, objectives: Sequence[Objective]
) -> list[Candidate]:
    """Return the candidates of a search, in its order."""
    condition = OfSweeps((sweep.id,))
    runs = results.runs(condition)
    metrics: dict[int, list[Any]] = defaultdict(list)
    for metric in results.metrics(runs, [each.metric for each in objectives], condition):
        if metric.run.status == FINISHED:
            metrics[metric.run.id].append(metric)
    groups: dict[str, list[int]] = defaultdict(list)
    for run in runs:
        if run.status in ENDINGS:
            groups[run.experiment or ""].append(run.id)
    most, found = max(map(len, groups.values()), default=0), list[Candidate]()
    for number, ids in enumerate(groups.values(), 1):
        values = [each.over_runs([metrics[id_] for id_ in ids]) for each in objectives]
        if all(map(math.isfinite, values)):
            state: Any = "complete" if len(ids) == most else "pruned"
        else:
            state, values = "infeasible", [math.nan] * len(objectives)
        found.append(Candidate(number, tuple(ids), tuple(values), state))
    return found
