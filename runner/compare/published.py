"""Printed figures beside ours: what was published, what our runs give, and a verdict.

A file NAME.csv of printed figures belongs to the experiment NAME. A line says where a figure
stands (document, table, page, row, quantity), what is printed, and which stored number answers it
(where, source, stage, model, dof, name, label). Ours is the mean over the runs of the experiment's
newest sweep that meet the condition.
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
TOLERANCE = 0.05  # relative: nearer to the printed figure than this is reproduced
Verdict = Literal["reproduced", "beaten", "not reproduced", "not reproducible", "no runs", "ours"]


@dataclass(frozen=True)
class Printed:
    """One printed figure, and which stored number answers it.

    `way` is how ours was made, where one printed figure has several beside it. `compare` says what
    is good: the printed `value` itself, a `lower` or `higher` figure, or an estimate nearer to the
    stored `truth`; `none` is shown without judging. A `model` such as `identified/nominal` is the
    ratio of the two within each run. Ours is multiplied by `factor` to have the printed unit.
    `information` says what ours knows that the source did not (`a known thruster lag`), or that its
    inputs were `calibrated` on the source's own figures, so that agreement is no evidence; empty is
    the same data, split and knowledge. A figure without `source` cannot be reproduced, `note` says
    why; one without `printed` is a row of ours that nothing printed stands beside. The
    `label` of a diagnostic is its label, its number i, or both (`with JIT 100`).
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
    """A printed figure with ours: value, 95 % interval over runs, how many, and the verdict."""

    printed: Printed
    value: float
    low: float
    high: float
    n: int
    lost: int  # runs without the figure: failed, diverged, or it is not defined
    verdict: Verdict
    reason: str

    @property
    def ratio(self) -> float:
        """Ours over the printed figure; NaN where either is missing or zero is printed."""
        printed = self.printed.printed
        return self.value / printed if printed else math.nan


def by_table(judged: Sequence[Judged]) -> list[list[Judged]]:
    """The figures of each printed table, in the order of the file."""
    tables: dict[str, list[Judged]] = {}
    for one in judged:
        tables.setdefault(one.printed.table, []).append(one)
    return list(tables.values())


def read_folder(folder: Path, experiment: str | None = None) -> dict[str, list[Printed]]:
    """The printed figures by experiment; ConfigurationError for an unknown one or a bad file."""
    paths = sorted(folder.glob("*.csv"), key=lambda path: _in_parts(path.stem))
    files = {path.stem: path for path in paths if _is_ours(path)}
    if not files:
        raise ConfigurationError(f"{folder}: no files of printed figures here")
    if experiment is not None:
        if experiment not in files:
            raise ConfigurationError(
                f"--experiment: got {experiment!r}, expected one of {', '.join(files)}"
            )
        files = {experiment: files[experiment]}
    return {name: read_file(path) for name, path in files.items()}


def _in_parts(name: str) -> list[tuple[str, int]]:
    """A name to sort by: table_4_2 comes before table_4_10."""
    return [(text, int(digits or 0)) for text, digits in re.findall(r"(\D+)(\d*)", name)]


def _is_ours(path: Path) -> bool:
    with path.open(newline="") as file:
        return tuple(next(csv.reader(file), ())) == COLUMNS


def read_file(path: Path) -> list[Printed]:
    """The printed figures of one file; ConfigurationError names the line that is wrong."""
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
    """Every printed figure of one experiment with ours and its verdict."""
    runs = runs_of(results, printed[0].experiment) if printed else []
    return [_judged(results, one, runs) for one in printed]


def runs_of(results: Results, experiment: str) -> list[int]:
    """Runs of the newest sweep of an experiment, those that it found finished included."""
    sweeps = [sweep.id for sweep in results.reader.sweeps() if sweep.name == experiment]
    return results.of_sweep(max(sweeps)) if sweeps else []


def _judged(results: Results, one: Printed, ids: Sequence[int]) -> Judged:
    if not one.source:
        return Judged(one, math.nan, math.nan, math.nan, 0, 0, "not reproducible", one.note)
    runs = _chosen(results, one, ids)
    if not runs:
        command = f"{trial_program()} experiment={one.experiment}"
        reason = f"{command}; {one.note}" if one.note else command
        return Judged(one, math.nan, math.nan, math.nan, 0, 0, "no runs", reason)
    values, truths = _values(results, one, runs)
    sample = np.array([one.factor * value for value in values])
    lost = len(runs) - len(sample)
    if not len(sample):
        lacking = f"none of {len(runs)} runs has this figure"
        return Judged(one, math.nan, math.nan, math.nan, 0, lost, "not reproduced", lacking)
    value = float(np.median(sample) if one.statistic == "median" else np.mean(sample))
    low, high = confidence_interval(sample)
    if math.isnan(low):
        low = high = value
    truth = one.factor * truths[0] if truths else None
    verdict = verdict_of(one, value, (low, high), truth)
    return Judged(one, value, low, high, len(sample), lost, verdict, one.note)


def _chosen(results: Results, one: Printed, ids: Sequence[int]) -> list[Run]:
    """The finished runs, and the lost ones, that answer a printed figure."""
    if not ids:
        return []
    within = f"id in ({', '.join(map(str, ids))})"
    condition = results.where(f"({one.where}) and {within}" if one.where else within)
    try:
        return results.runs(condition)
    except ConfigurationError:  # nothing matches: the sweep is not whole yet
        return []


def _values(results: Results, one: Printed, runs: Sequence[Run]) -> tuple[list[float], list[float]]:
    """The number of each finished run that has it, and the true values stored beside them."""
    finished = [run for run in runs if run.status == FINISHED]
    if one.source == "diagnostic":
        return _diagnostics(results, one, finished), []
    observed = (
        results.metrics(finished, [one.name])
        if one.source == "metric"
        else _coefficients(results, one, finished)
    )
    wanted = [
        seen
        for seen in observed
        if seen.name == one.name
        and seen.dof == one.dof
        and one.stage in ("", seen.stage)
        and _known(seen.value)
    ]
    if "/" in one.model:
        return _ratios(wanted, one.model), []
    wanted = [seen for seen in wanted if seen.model == one.model]
    truths = [seen.true_value for seen in wanted if seen.true_value is not None]
    return [seen.value for seen in wanted if seen.value is not None], truths


def _diagnostics(results: Results, one: Printed, runs: Sequence[Run]) -> list[float]:
    rows = results.diagnostics(runs, [one.name])
    found = [
        row.value
        for run in runs
        for row in rows[run.id]
        if one.dof in ("", row.dof)
        and one.label in ("", row.label or "", str(row.i), f"{row.label} {row.i}")
    ]
    return [value for value in found if _known(value)]


def _coefficients(results: Results, one: Printed, runs: Sequence[Run]) -> list[Observation]:
    """Those of one term; a table that is stored without it has a zero there."""
    observed = results.coefficients(runs)
    found = [seen for seen in observed if (seen.name, seen.dof) == (one.name, one.dof)]
    having = {(seen.run.id, seen.model) for seen in found}
    tables = {(seen.run.id, seen.model): seen for seen in observed}
    zeros = [
        replace(
            seen, dof=one.dof, name=one.name, value=0.0, std_error=None,
            true_value=None if seen.true_value is None else 0.0,
        )
        for table, seen in tables.items()
        if table not in having
    ]  # fmt: skip
    return found + zeros


def _ratios(seen: Sequence[Observation], models: str) -> list[float]:
    """Of each run the value of one model over that of another, `identified/nominal`."""
    above, below = (
        {one.run.id: one.value for one in seen if one.model == model}
        for model in models.split("/", 1)
    )
    return [
        value / divisor
        for id_, value in above.items()
        if value is not None and (divisor := below.get(id_))
    ]


def _known(value: float | None) -> bool:
    return value is not None and math.isfinite(value)


def verdict_of(
    one: Printed, value: float, interval: tuple[float, float], truth: float | None
) -> Verdict:
    """What our figure says about the printed one.

    Beaten: the whole 95 % interval is better by more than the tolerance (an estimate: its worst
    end is nearer to the truth than the printed one). Reproduced: the printed figure lies within
    the interval, or within 5 % of ours, or is ours rounded to its decimals.
    """
    printed = one.printed
    if printed is None or one.compare == "none":
        return "ours"
    low, high = interval
    margin = max(TOLERANCE * abs(printed), one.rounding * (1.0 + SAME))
    if one.compare == "lower" and high < printed - margin:
        return "beaten"
    if one.compare == "higher" and low > printed + margin:
        return "beaten"
    if one.compare == "truth" and truth is not None:
        worst = max(abs(low - truth), abs(high - truth))
        if worst < abs(printed - truth) * (1.0 - TOLERANCE):
            return "beaten"
    slack = SAME * abs(printed)
    if abs(value - printed) <= margin or low - slack <= printed <= high + slack:
        return "reproduced"
    return "not reproduced"
