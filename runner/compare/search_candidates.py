"""Candidates of a search: what was to be made better, and what each candidate achieved.

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
from seatrial.runner.compare.results import FINISHED, Queries, StoredRun
from seatrial.runner.compare.where import OfSweeps
from seatrial.runner.database.records import SweepSummary
from seatrial.runner.record.catalogue import all_declared, declared
from seatrial.runner.vocabulary import STATUSES

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
        """Return the override by which a sweep stores its objective."""
        return STORED + ":".join(astuple(self))

    @property
    def unit(self) -> str:
        """Return the unit of the metric."""
        return declared(self.metric).unit_of(self.dof)

    def value_in(self, metrics: Iterable[Any]) -> float:
        """Return the value among the stored metrics of a run; NaN if it has none."""
        own = (self.metric, self.stage, self.model, self.dof)
        values = [m.value for m in metrics if (m.name, m.stage, m.model, m.dof) == own]
        return math.nan if not values or values[0] is None else float(values[0])

    def over_seeds(self, values: Sequence[float]) -> float:
        """Return the statistic of one value a seed; NaN if one of them is not finite."""
        if not values or not np.all(np.isfinite(values)):
            return math.nan
        return float(getattr(np, self.statistic)(values))

    def loss(self, value: float) -> float:
        """Return what is to be as low as possible: the value, minus it, or the distance to it."""
        if self.better in ("lower", "higher"):
            return -value if self.better == "higher" else value
        return abs(value - float(self.better))


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
    stored: dict[int, list[Any]] = defaultdict(list)
    for metric in results.metrics(runs, [one.metric for one in objectives], condition):
        stored[metric.run.id].append(metric)
    groups: dict[str, list[StoredRun]] = defaultdict(list)
    for run in runs:
        if run.status in STATUSES and run.status != "running":
            groups[run.experiment or ""].append(run)
    most = max(map(len, groups.values()), default=0)
    found = []
    for number, group in enumerate(groups.values(), 1):
        values = [o.over_seeds([o.value_in(stored[run.id]) for run in group]) for o in objectives]
        ended = all(run.status == FINISHED for run in group)
        feasible = ended and all(map(math.isfinite, values))
        found.append(
            Candidate(
                number,
                tuple(run.id for run in group),
                tuple(values) if feasible else (math.nan,) * len(objectives),
                ("complete" if len(group) == most else "pruned") if feasible else "infeasible",
            )
        )
    return found


def front(losses: Sequence[Sequence[float]]) -> list[int]:
    """Return the rows of losses (candidates x objectives) that no other row dominates.

    A row with NaN is none of them; of equal rows it is the first.
    """
    table = np.array(losses, dtype=np.float64)
    return [
        i
        for i, row in enumerate(table)
        if not np.any(np.isnan(row))
        and not np.any(np.all(table <= row, axis=1) & np.any(table < row, axis=1))
        and not np.any(np.all(table[:i] == row, axis=1))
    ]
