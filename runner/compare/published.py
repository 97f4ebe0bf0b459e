"""Comparison of printed figures with the results of our runs, with a verdict for each figure.

A file NAME.csv of printed figures belongs to the experiment NAME. Each line gives the place of a
figure (document, table, page, row, quantity), its printed value, and the stored number to compare
it with (where, source, stage, model, dof, name, label). Our value is the mean over those runs of
the experiment's newest sweep that meet the condition.
"""

import csv
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path
from typing import Literal

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.results import FINISHED, Observation, Results, Run
from seatrial.runner.compare.statistics import SAME, confidence_interval
from seatrial.runner.invocation import trial_program

FOLDER = Path(__file__).with_name("printed")
COLUMNS = (
    *("document", "table", "page", "row", "quantity", "printed", "unit"),
    *("way", "where", "source", "stage", "model", "dof", "name", "label", "factor"),
    *("compare", "statistic", "information", "note"),
)
SOURCES = ("metric", "coefficient", "diagnostic")
COMPARISONS = ("value", "lower", "higher", "truth", "none")
TOLERANCE = 0.05  # relative: a figure within it counts as reproduced
Verdict = Literal["reproduced", "beaten", "not reproduced", "not reproducible", "no runs", "ours"]


@dataclass(frozen=True)
class Printed:
    """One printed figure, and the stored number to compare it with.

    `way` names our method if one printed figure is compared with several methods. `compare` says
    what is better: the printed `value` itself, a `lower` or `higher` figure, or an estimate nearer
    to the stored `truth`; `none` gives no verdict. A `model` such as `identified/nominal` is the
    ratio of the two within each run. Our value times `factor` has the printed unit. `information`
    says what our method knows in addition to the source (`a known thruster lag`), or `calibrated`
    if its inputs were fitted to the printed figures, so that agreement is no evidence; it is empty
    for the same data, split and knowledge. A figure without `source` cannot be reproduced, and
    `note` gives the reason; a row without `printed` has no printed counterpart. The `label` of a
    diagnostic is its label, its number i, or both (`with JIT 100`).
    """

    experiment: str
    document: str
    table: str
    page: str
    row: str
    quantity: str
    printed: float | None
    unit: str
    way: str
    where: str
    source: str
    stage: str
    model: str
    dof: str
    name: str
    label: str
    factor: float
    compare: str
    statistic: str
    information: str
    note: str
    rounding: float = 0.0  # half a unit of the last printed decimal


@dataclass(frozen=True)
class Judged:
    """A printed figure with our value, its 95 % interval over n runs, and the verdict."""

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
        """Our value over the printed one; NaN if one is missing or the printed one is zero."""
        printed = self.printed.printed
        return self.value / printed if printed else math.nan


def by_table(judged: Sequence[Judged]) -> list[list[Judged]]:
    """Group the figures by printed table, in the order of the file."""
    tables: dict[str, list[Judged]] = {}
    for row in judged:
        tables.setdefault(row.printed.table, []).append(row)
    return list(tables.values())


def read_folder(folder: Path, experiment: str | None = None) -> dict[str, list[Printed]]:
    """Read the figures by experiment; raises ConfigurationError for an unknown name or a bad file.

    `folder` holds one CSV file for each experiment; without `experiment` all of them are read.
    """
    paths = sorted(folder.glob("*.csv"), key=lambda path: _sort_key(path.stem))
    files = {path.stem: path for path in paths if _has_columns(path)}
    if not files:
        raise ConfigurationError(f"{folder}: no files of printed figures in this folder")
    if experiment is not None:
        if experiment not in files:
            raise ConfigurationError(
                f"--experiment: got {experiment!r}, expected one of {', '.join(files)}"
            )
        files = {experiment: files[experiment]}
    return {name: read_file(path) for name, path in files.items()}


def _sort_key(name: str) -> list[tuple[str, int]]:
    """Return the sort key of a name: table_4_2 comes before table_4_10."""
    return [(text, int(digits or 0)) for text, digits in re.findall(r"(\D+)(\d*)", name)]


def _has_columns(path: Path) -> bool:
    with path.open(newline="") as file:
        return tuple(next(csv.reader(file), ())) == COLUMNS


def read_file(path: Path) -> list[Printed]:
    """Read the printed figures of one file; raises ConfigurationError with the wrong line."""
    with path.open(newline="") as file:
        lines = list(csv.DictReader(file))
    return [_printed(path.stem, line, f"{path.name}, line {i}") for i, line in enumerate(lines, 2)]


def _printed(experiment: str, line: Mapping[str, str], place: str) -> Printed:
    if None in line or None in line.values():
        raise ConfigurationError(f"{place}: expected {len(COLUMNS)} columns")
    text = {name: value.strip() for name, value in line.items()}
    text["source"], text["compare"] = text["source"] or "", text["compare"] or "value"
    for name, expected in (("source", ("", *SOURCES)), ("compare", COMPARISONS)):
        if text[name] not in expected:
            raise ConfigurationError(
                f"{place}: {name}: got {text[name]!r}, expected {', '.join(expected)}"
            )
    try:
        number = text.pop("printed")
        printed = float(number) if number else None
        rounding = 0.5 * 10.0 ** min(int(Decimal(number or "0").as_tuple().exponent), 0)
        factor = float(text.pop("factor") or 1.0)
    except ValueError as error:
        raise ConfigurationError(f"{place}: {error}") from error
    return Printed(experiment=experiment, printed=printed, factor=factor, rounding=rounding, **text)


def judged(results: Results, printed: Sequence[Printed]) -> list[Judged]:
    """Compare every printed figure of one experiment with our runs."""
    runs = runs_of(results, printed[0].experiment) if printed else []
    return [_judged(results, figure, runs) for figure in printed]


def runs_of(results: Results, experiment: str) -> list[int]:
    """Return the runs of the newest sweep of an experiment, including reused runs."""
    sweeps = [sweep.id for sweep in results.reader.sweeps() if sweep.name == experiment]
    return results.of_sweep(max(sweeps)) if sweeps else []


def _judged(results: Results, figure: Printed, ids: Sequence[int]) -> Judged:
    if not figure.source:
        return Judged(figure, math.nan, math.nan, math.nan, 0, 0, "not reproducible", figure.note)
    runs = _runs_of_figure(results, figure, ids)
    if not runs:
        command = f"{trial_program()} experiment={figure.experiment}"
        reason = f"{command}; {figure.note}" if figure.note else command
        return Judged(figure, math.nan, math.nan, math.nan, 0, 0, "no runs", reason)
    values, truths = _values(results, figure, runs)
    sample = np.array([figure.factor * value for value in values])
    lost = len(runs) - len(sample)
    if not len(sample):
        lacking = f"none of {len(runs)} runs has this figure"
        return Judged(figure, math.nan, math.nan, math.nan, 0, lost, "not reproduced", lacking)
    value = float(np.median(sample) if figure.statistic == "median" else np.mean(sample))
    low, high = confidence_interval(sample)
    if math.isnan(low):
        low = high = value
    truth = figure.factor * truths[0] if truths else None
    verdict = verdict_of(figure, value, (low, high), truth)
    return Judged(figure, value, low, high, len(sample), lost, verdict, figure.note)


def _runs_of_figure(results: Results, figure: Printed, ids: Sequence[int]) -> list[Run]:
    """Return the runs of a printed figure, finished or not."""
    if not ids:
        return []
    in_sweep = f"id in ({', '.join(map(str, ids))})"
    condition = results.where(f"({figure.where}) and {in_sweep}" if figure.where else in_sweep)
    try:
        return results.runs(condition)
    except ConfigurationError:  # no run matches: the sweep is not complete yet
        return []


def _values(
    results: Results, figure: Printed, runs: Sequence[Run]
) -> tuple[list[float], list[float]]:
    """Return the number of each finished run that has it, and the stored true values."""
    finished = [run for run in runs if run.status == FINISHED]
    if figure.source == "diagnostic":
        return _diagnostics(results, figure, finished), []
    observed = (
        results.metrics(finished, [figure.name])
        if figure.source == "metric"
        else _coefficients(results, figure, finished)
    )
    matching = [
        observation
        for observation in observed
        if observation.name == figure.name
        and observation.dof == figure.dof
        and figure.stage in ("", observation.stage)
        and _known(observation.value)
    ]
    if "/" in figure.model:
        return _ratios(matching, figure.model), []
    matching = [observation for observation in matching if observation.model == figure.model]
    truths = [
        observation.true_value for observation in matching if observation.true_value is not None
    ]
    return [observation.value for observation in matching if observation.value is not None], truths


def _diagnostics(results: Results, figure: Printed, runs: Sequence[Run]) -> list[float]:
    rows = results.diagnostics(runs, [figure.name])
    values = [
        row.value
        for run in runs
        for row in rows[run.id]
        if figure.dof in ("", row.dof)
        and figure.label in ("", row.label or "", str(row.i), f"{row.label} {row.i}")
    ]
    return [value for value in values if _known(value)]


def _coefficients(results: Results, figure: Printed, runs: Sequence[Run]) -> list[Observation]:
    """Return the coefficients of one term; a stored model without the term has a zero."""
    observed = results.coefficients(runs)
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


def verdict_of(
    figure: Printed, value: float, interval: tuple[float, float], truth: float | None
) -> Verdict:
    """Return the verdict on our value, compared with the printed one.

    `value` and its 95 % `interval` (low, high) are ours; `truth` is the true value, if it is known.
    Beaten: the complete 95 % interval is better by more than the tolerance; for an estimate, its
    worst end is nearer to the truth than the printed one. Reproduced: the printed figure is within
    the interval, or within 5 % of our value, or equals our value rounded to its decimals.
    """
    printed = figure.printed
    if printed is None or figure.compare == "none":
        return "ours"
    low, high = interval
    margin = max(TOLERANCE * abs(printed), figure.rounding * (1.0 + SAME))
    if figure.compare == "lower" and high < printed - margin:
        return "beaten"
    if figure.compare == "higher" and low > printed + margin:
        return "beaten"
    if figure.compare == "truth" and truth is not None:
        worst = max(abs(low - truth), abs(high - truth))
        if worst < abs(printed - truth) * (1.0 - TOLERANCE):
            return "beaten"
    slack = SAME * abs(printed)
    if abs(value - printed) <= margin or low - slack <= printed <= high + slack:
        return "reproduced"
    return "not reproduced"
