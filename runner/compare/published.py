"""Comparison of printed figures with the results of our runs, with a verdict for each figure.

Our value is the mean over those runs of the experiment's newest sweep that meet the condition of
the printed figure.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.printed_figures import Printed
from seatrial.runner.compare.results import (
    BELOW_TRUE_MODEL,
    FINISHED,
    DiagnosticRow,
    Observation,
    Results,
    Run,
)
from seatrial.runner.compare.statistics import confidence_interval
from seatrial.runner.compare.verdicts import Verdict, too_wide, verdict_of
from seatrial.runner.compare.where import Condition, Joined, OfSweeps
from seatrial.runner.invocation import trial_program


@dataclass(frozen=True)
class Judged:
    """A printed figure with our value, its 95 % interval over n runs, and the verdict.

    A single run has no interval: `low` and `high` are NaN.
    """

    printed: Printed
    value: float
    low: float
    high: float
    n: int
    lost: int  # runs without the figure: failed, diverged or not defined
    verdict: Verdict
    reason: str

    @property
    def ratio(self) -> float:
        """Our value over the printed one or its reference; NaN without one, or if it is zero."""
        divisor = self.printed.printed or self.printed.reference
        return self.value / divisor if divisor else math.nan


def by_table(judged: Sequence[Judged]) -> list[list[Judged]]:
    """Group the figures by printed table, in the order of the file."""
    tables: dict[str, list[Judged]] = {}
    for row in judged:
        tables.setdefault(row.printed.table, []).append(row)
    return list(tables.values())


def judged(results: Results, printed: Sequence[Printed]) -> list[Judged]:
    """Compare every printed figure of one experiment with our runs."""
    sweep = newest_sweep(results, printed[0].experiment) if printed else None
    return [_judged(results, figure, sweep) for figure in printed]


def newest_sweep(results: Results, experiment: str) -> int | None:
    """Return the number of the newest sweep of an experiment; None without one."""
    sweeps = [sweep.id for sweep in results.reader.sweeps() if sweep.name == experiment]
    return max(sweeps, default=None)


def _judged(results: Results, figure: Printed, sweep: int | None) -> Judged:
    if not figure.source:
        return Judged(figure, math.nan, math.nan, math.nan, 0, 0, "not reproducible", figure.note)
    chosen = _condition(results, figure, sweep)
    runs = _runs_of_figure(results, chosen)
    if not runs:
        command = f"{trial_program()} experiment={figure.experiment}"
        reason = f"{command}; {figure.note}" if figure.note else command
        return Judged(figure, math.nan, math.nan, math.nan, 0, 0, "no runs", reason)
    finished = [run for run in runs if run.status == FINISHED]
    values, truths = _values(results, figure, finished, chosen)
    sample = np.array([figure.factor * value for value in values])
    lost = len(runs) - len(sample)
    if not len(sample):
        lacking = f"none of {len(runs)} runs has this figure"
        return Judged(figure, math.nan, math.nan, math.nan, 0, lost, "not reproduced", lacking)
    value = float(np.median(sample) if figure.statistic == "median" else np.mean(sample))
    interval = confidence_interval(sample)
    truth = figure.factor * truths[0] if truths else None
    below = _below_true_model(results, figure, finished, chosen, value)
    verdict = verdict_of(figure, value, interval, truth, below)
    wide = too_wide(figure, interval) and interval[0] <= (figure.printed or 0.0) <= interval[1]
    wide = wide and verdict == "not reproduced"
    reason = "the interval is too wide for the printed figure" if wide else ""
    reason = "; ".join(text for text in (reason, figure.note) if text)
    return Judged(figure, value, *interval, len(sample), lost, verdict, reason)


def _condition(results: Results, figure: Printed, sweep: int | None) -> Condition | None:
    """Return the condition on the runs of a printed figure; None without a sweep."""
    if sweep is None:
        return None
    of_sweep, own = OfSweeps((sweep,)), results.where(figure.where)
    return of_sweep if own is None else Joined("and", (own, of_sweep))


def _runs_of_figure(results: Results, condition: Condition | None) -> list[Run]:
    """Return the runs of a printed figure, finished or not."""
    if condition is None:
        return []
    try:
        return results.runs(condition)
    except ConfigurationError:  # no run matches: the sweep is not complete yet
        return []


def _values(
    results: Results, figure: Printed, finished: Sequence[Run], condition: Condition | None
) -> tuple[list[float], list[float]]:
    """Return the number of each finished run that has it, and the stored true values."""
    if figure.source == "diagnostic":
        return _diagnostics(results, figure, finished, condition), []
    observed = (
        results.metrics(finished, [figure.name], condition)
        if figure.source == "metric"
        else _coefficients(results, figure, finished, condition)
    )
    matching = [row for row in observed if _matches(figure, row) and _known(row.value)]
    if "/" in figure.model:
        return _ratios(matching, figure.model), []
    matching = [row for row in matching if row.model == figure.model]
    truths = [row.true_value for row in matching if row.true_value is not None]
    return [row.value for row in matching if row.value is not None], truths


def _matches(figure: Printed, row: Observation) -> bool:
    name = figure.name.split("/")[-1]
    return (row.name, row.dof) == (name, figure.dof) and figure.stage in ("", row.stage)


def _diagnostics(
    results: Results, figure: Printed, runs: Sequence[Run], condition: Condition | None
) -> list[float]:
    """Return the diagnostic of each run, over a metric of the run for the model `/nominal`."""
    name, _, metric = figure.name.partition("/")
    rows = results.diagnostics(runs, [name], condition)
    chosen = [row for run in runs for row in rows[run.id] if _labelled(figure, row)]
    if not metric:
        return [row.value for row in chosen if _known(row.value)]
    model = figure.model.removeprefix("/")
    divisors = {
        row.run.id: row.value
        for row in results.metrics(runs, [metric], condition)
        if _matches(figure, row) and row.model == model
    }
    pairs = [(row.value, divisors.get(row.run_id)) for row in chosen if _known(row.value)]
    return [value / divisor for value, divisor in pairs if divisor]


def _labelled(figure: Printed, row: DiagnosticRow) -> bool:
    labels = ("", row.label or "", str(row.i), f"{row.label} {row.i}", f"{row.i},{row.j}")
    return figure.dof in ("", row.dof) and figure.label in labels


def _below_true_model(
    results: Results,
    figure: Printed,
    finished: Sequence[Run],
    condition: Condition | None,
    value: float,
) -> bool:
    """Return whether our figure is below that of the exact plant: it fits lag or feedback.

    The stored flag of the identified model says so in most runs, or the plant's own figure, as
    the same ratio, is larger in the mean.
    """
    metric = figure.name.split("/")[-1]
    identified = figure.source == "metric" and figure.model.startswith("identified")
    if not (identified or "/" in figure.name) or not metric.startswith("force_m"):
        return False
    names = [BELOW_TRUE_MODEL, metric]
    observed = results.metrics(finished, names, condition)
    rows = [row for row in observed if row.dof == figure.dof]
    flags = [bool(row.value) for row in rows if row.name == BELOW_TRUE_MODEL]
    if identified and 2 * sum(flags) > len(flags):
        return True
    divisor = figure.model.partition("/")[2]
    own = [row for row in rows if _matches(figure, row) and _known(row.value)]
    plant = (
        _ratios(own, f"plant/{divisor}")
        if divisor
        else [row.value for row in own if row.model == "plant" and row.value is not None]
    )
    return bool(plant) and value < figure.factor * float(np.mean(plant))


def _coefficients(
    results: Results, figure: Printed, runs: Sequence[Run], condition: Condition | None
) -> list[Observation]:
    """Return the coefficients of one term; a stored model without the term has a zero."""
    observed = results.coefficients(runs, condition)
    coefficients = [
        observation
        for observation in observed
        if (observation.name, observation.dof) == (figure.name, figure.dof)
    ]
    models_with = {(observation.run.id, observation.model) for observation in coefficients}
    tables = {(observation.run.id, observation.model): observation for observation in observed}
    zeros = [
        replace(
            observation, dof=figure.dof, name=figure.name, value=0.0, std_error=None,
            true_value=None if observation.true_value is None else 0.0,
        )
        for table, observation in tables.items()
        if table not in models_with
    ]  # fmt: skip
    return coefficients + zeros


def _ratios(observations: Sequence[Observation], models: str) -> list[float]:
    """Return for each run the value of one model over that of another, `identified/nominal`."""
    numerators, denominators = (
        {
            observation.run.id: observation.value
            for observation in observations
            if observation.model == model
        }
        for model in models.split("/", 1)
    )
    return [
        value / divisor
        for id_, value in numerators.items()
        if value is not None and (divisor := denominators.get(id_))
    ]


def _known(value: float | None) -> bool:
    return value is not None and math.isfinite(value)
