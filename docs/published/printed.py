"""Printed figures of published documents, our values beside them, and a verdict on each.

A file printed/NAME.csv belongs to the experiment NAME. Each line gives the place of a figure
(document, table, page, row, quantity), its printed value, and the stored number to compare it with
(where, source, stage, model, dof, name, label). Our value is the mean over those runs of the
experiment's newest sweep that meet the condition `where`.
"""

import csv
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from decimal import Decimal
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.frame import BELOW_TRUE_MODEL, FINISHED, Queries, StoredRun
from seatrial.runner.compare.statistics import confidence_interval
from seatrial.runner.compare.where import EVERY_RUN, Condition
from seatrial.runner.configuration.invocation import trial_program

HERE = Path(__file__).parent
FOLDER = HERE / "printed"
SOURCES = ("", "metric", "coefficient", "diagnostic")
COMPARISONS = ("value", "lower", "higher", "truth", "one", "none")
CALIBRATED = "calibrated"  # our inputs were fitted to printed figures: agreement is no evidence
BY_CONSTRUCTION = "by construction"  # the method cannot but give the figure
EXACT = "the exact model, of data without noise"
ROUNDING = 1e-6  # relative error of the coefficients of an exact model
RELATIVE_ROUNDING = 1e-9  # smaller differences are rounding errors
TOLERANCE = 0.05  # relative: a figure within it counts as reproduced
Verdict = Literal[
    "beaten", "reproduced", "not reproduced", "below the true model",
    "calibrated", "by construction", "not reproducible", "no runs", "ours",
]  # fmt: skip


@dataclass(frozen=True)
class Printed:
    """One printed figure, and the stored number to compare it with.

    `printed` holds what the document prints, also as a ratio of two printed figures (`0.20/0.42`);
    `reference` is a figure of ours, or one that follows from the document's words: it is shown with
    its ratio and not judged. `way` names our method if one printed figure is compared with several
    methods. `compare` says what is better: the printed `value` itself, a `lower` or `higher`
    figure, an estimate nearer to the stored `truth`, or the same distance to `one` (eigenvalues);
    `none` gives no verdict. A `model` such as `identified/nominal` is the ratio of the two within
    each run; `/nominal` divides the diagnostic `name` by that model's metric (`order_mse/
    force_mse`). Our value times `factor` has the printed unit. `information` says what our method
    knows in addition to the source (`a known thruster lag`); it is empty for the same data, split
    and knowledge. It begins with `calibrated` if our inputs were fitted to the printed figures, so
    that agreement is no evidence, and with `by construction` if the method cannot but give the
    figure. A figure without `source` cannot be reproduced, and `note` gives the reason; a row
    without `printed` has no printed counterpart. The `label` of a diagnostic is its label, its
    number i, both (`with JIT 100`), or its two numbers (`8,18`).
    """

    experiment: str
    document: str
    table: str
    page: str
    row: str
    quantity: str
    printed: float | None
    reference: float | None
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
    digits: str = ""  # the printed figure as it is written
    rounding: float = 0.0  # half a unit of the last printed decimal

    @property
    def known(self) -> tuple[str, ...]:
        """The items of `information`."""
        return tuple(item for item in self.information.split("; ") if item)


COLUMNS = tuple(field.name for field in fields(Printed))[1:-2]  # of a file


def read_folder(folder: Path = FOLDER, experiment: str | None = None) -> dict[str, list[Printed]]:
    """Read the figures of one experiment, or of all; table_4_2 comes before table_4_10.

    Raises:
        ConfigurationError: the experiment has no file, or a line of a file is wrong.
    """
    files = {path.stem: path for path in sorted(folder.glob("*.csv"), key=_sort_key)}
    if experiment is not None:
        if experiment not in files:
            raise ConfigurationError(
                f"--experiment: got {experiment!r}, expected one of {', '.join(files)}"
            )
        files = {experiment: files[experiment]}
    return {name: _read_file(path) for name, path in files.items()}


def _sort_key(path: Path) -> list[tuple[str, int]]:
    return [(text, int(digits or 0)) for text, digits in re.findall(r"(\D+)(\d*)", path.stem)]


def _read_file(path: Path) -> list[Printed]:
    figures = []
    with path.open(newline="", encoding="utf-8") as file:
        for number, line in enumerate(csv.DictReader(file), start=2):
            try:
                figures.append(_printed(path.stem, line))
            except (ValueError, ArithmeticError) as error:
                raise ConfigurationError(f"{path.name}, line {number}: {error}") from error
    return figures


def _printed(experiment: str, line: Mapping[str, str]) -> Printed:
    if tuple(line) != COLUMNS or None in line.values():
        raise ValueError(f"expected the {len(COLUMNS)} columns {','.join(COLUMNS)}")
    text = {name: value.strip() for name, value in line.items()}
    text["compare"] = text["compare"] or "value"
    for name, expected in (("source", SOURCES), ("compare", COMPARISONS)):
        if text[name] not in expected:
            raise ValueError(f"{name}: got {text[name]!r}, expected one of {expected}")
    digits, reference = text.pop("printed"), text.pop("reference")
    printed, rounding = _number_of(digits)
    return Printed(
        experiment=experiment, printed=printed, factor=float(text.pop("factor") or 1.0),
        reference=float(reference) if reference else None, rounding=rounding, digits=digits, **text,
    )  # fmt: skip


def _number_of(digits: str) -> tuple[float | None, float]:
    """Return a printed number, or a ratio of two, and half a unit of its last decimal."""
    if not digits:
        return None, 0.0
    parts = digits.split("/", 1)
    values = [float(part) for part in parts]
    units = [0.5 * 10.0 ** min(int(Decimal(part.strip()).as_tuple().exponent), 0) for part in parts]
    if len(values) == 1:
        return values[0], units[0]
    ratio = values[0] / values[1]
    return ratio, units[0] / abs(values[1]) + abs(ratio) * units[1] / abs(values[1])


# The verdict on one of our values.


def verdict_of(
    figure: Printed,
    value: float,
    interval: tuple[float, float],
    truth: float | None,
    *,
    below_true_model: bool = False,
    certain: bool = False,
    lost: int = 0,
) -> Verdict:
    """Return the verdict on our value, compared with the printed one.

    Beaten: the complete 95 % interval of single runs is better by more than the tolerance, and no
    run was lost; for an estimate, its worst end is nearer to the truth than the printed one, and
    the term was not dropped. Reproduced: the printed figure is within the interval, or within 5 %
    of our value, or equals our value rounded to its decimals, and the interval is not wider than
    the printed figure. Without an interval (NaN, a single run) the value alone is compared. What is
    `certain`, such as the exact model of data without noise, is by construction.
    """
    if figure.printed is None or figure.compare == "none":
        return "ours"
    if CALIBRATED in figure.known:
        return "calibrated"
    if not lost and _beaten(figure, value, interval, truth):
        verdict: Verdict = "below the true model" if below_true_model else "beaten"
    else:
        verdict = "reproduced" if _reproduced(figure, value, interval) else "not reproduced"
    certain = (certain or BY_CONSTRUCTION in figure.known) and verdict != "not reproduced"
    return "by construction" if certain else verdict


def _beaten(
    figure: Printed, value: float, interval: tuple[float, float], truth: float | None
) -> bool:
    """Whether our value is better than the printed one beyond doubt."""
    printed, (low, high) = figure.printed or 0.0, _ends(value, interval)
    if figure.compare == "lower":
        return high < printed - _margin(figure)
    if figure.compare == "higher":
        return low > printed + _margin(figure)
    if figure.compare == "truth" and truth is not None:
        if value == 0.0 and truth != 0.0:  # the model lacks a term that the vessel has
            return False
        worst = max(abs(low - truth), abs(high - truth))
        return worst < abs(printed - truth) * (1.0 - TOLERANCE)
    return False


def _reproduced(figure: Printed, value: float, interval: tuple[float, float]) -> bool:
    """Whether our value agrees with the printed one, and is certain enough to say so."""
    printed, (low, high) = figure.printed or 0.0, _ends(value, interval)
    slack = RELATIVE_ROUNDING * abs(printed)
    inside = low - slack <= printed <= high + slack
    return not _too_wide(figure, interval) and (inside or abs(value - printed) <= _margin(figure))


def _too_wide(figure: Printed, interval: tuple[float, float]) -> bool:
    """Whether the interval is wider than the printed figure (than its distance to 1)."""
    low, high = interval
    return high - low > max(abs(_size(figure)), 2.0 * _margin(figure))


def _size(figure: Printed) -> float:
    """What the printed figure states: its value, or for eigenvalues its distance to 1."""
    return (figure.printed or 0.0) - (1.0 if figure.compare == "one" else 0.0)


def _margin(figure: Printed) -> float:
    return max(TOLERANCE * abs(_size(figure)), figure.rounding * (1.0 + RELATIVE_ROUNDING))


def _ends(value: float, interval: tuple[float, float]) -> tuple[float, float]:
    return (value, value) if math.isnan(interval[0]) else interval


# Our value beside each printed one.


@dataclass(frozen=True)
class Judged:
    """A printed figure with the verdict, its reason, and our value with a 95 % interval.

    The mean is over n runs, `low` to `high` is the interval of one further run, since a source
    prints a single run; of one run they are NaN. `lost` counts runs without the figure (failed,
    diverged or not defined).
    """

    printed: Printed
    verdict: Verdict
    reason: str
    value: float = math.nan
    low: float = math.nan
    high: float = math.nan
    n: int = 0
    lost: int = 0

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


def file_of(experiment: str) -> Path:
    """The file of an experiment among those that need the identifiers of this folder."""
    return HERE / "experiment" / f"{experiment}.yaml"


def command_of(experiment: str) -> str:
    """What runs an experiment, as a user types it."""
    more = " --config-dir docs/published" if file_of(experiment).exists() else ""
    return f"{trial_program()}{more} experiment={experiment}"


def newest_sweep(results: Queries, experiment: str) -> int | None:
    """Return the number of the newest sweep of an experiment; None without one."""
    sweeps = [sweep.id for sweep in results.reader.sweeps() if sweep.name == experiment]
    return max(sweeps, default=None)


def judged(results: Queries, printed: Sequence[Printed]) -> list[Judged]:
    """Compare every printed figure of one experiment with our runs."""
    sweep = newest_sweep(results, printed[0].experiment) if printed else None
    return [_judged(results, figure, sweep) for figure in printed]


def _judged(results: Queries, figure: Printed, sweep: int | None) -> Judged:
    if not figure.source:
        return Judged(figure, "not reproducible", figure.note)
    condition, runs = _runs_of(results, figure, sweep)
    if not runs:
        reasons = (command_of(figure.experiment), figure.note)
        return Judged(figure, "no runs", "; ".join(filter(None, reasons)))
    stored = _Stored(results, condition, [run for run in runs if run.status == FINISHED], figure)
    values, truths = stored.values()
    sample = np.array([figure.factor * value for value in values])
    trials = results.trials(condition, planned=True)  # those that never started are lost too
    lost = len(trials) - len(sample)
    if not len(sample):
        reason = f"none of {len(trials)} runs has this figure"
        return Judged(figure, "not reproduced", reason, lost=lost)
    value = float(np.median(sample) if figure.statistic == "median" else np.mean(sample))
    low, high = interval = interval_of_a_run(sample)
    truth = figure.factor * truths[0] if truths else None
    exact = stored.exact()
    judge = partial(
        verdict_of, figure, value, interval, truth,
        below_true_model=stored.below_true_model(value), certain=exact,
    )  # fmt: skip
    verdict = judge(lost=lost)
    wide = _too_wide(figure, interval) and low <= (figure.printed or 0.0) <= high
    reasons = {
        "the interval is too wide for the printed figure": wide and verdict == "not reproduced",
        f"{lost} of {len(trials)} runs lack it": judge() != verdict,
        EXACT: verdict == "by construction" and exact,
        figure.note: True,
    }
    reason = "; ".join(text for text, holds in reasons.items() if text and holds)
    return Judged(figure, verdict, reason, value, low, high, len(sample), lost)


def interval_of_a_run(sample: NDArray[np.float64]) -> tuple[float, float]:
    """Return the 95 % prediction interval of one further run, of Student's t; NaN for one run."""
    low, high = confidence_interval(sample)
    centre, half = 0.5 * (low + high), 0.5 * (high - low) * math.sqrt(sample.size + 1)
    return centre - half, centre + half


def _runs_of(
    results: Queries, figure: Printed, sweep: int | None
) -> tuple[Condition, list[StoredRun]]:
    """Return the condition on the runs of a printed figure, and the runs, finished or not."""
    if sweep is None:
        return EVERY_RUN, []
    condition = replace(results.where(figure.where), sweeps=(sweep,))
    try:
        return condition, results.runs(condition)
    except ConfigurationError:  # no run matches: the sweep is not complete yet
        return condition, []


@dataclass(frozen=True)
class _Stored:
    """The stored numbers of the finished runs that answer a printed figure."""

    results: Queries
    condition: Condition
    runs: Sequence[StoredRun]
    figure: Printed

    def values(self) -> tuple[list[float], list[float]]:
        """Return the number of each run that has it, and the stored true values."""
        figure = self.figure
        if figure.source == "diagnostic":
            return self._diagnostics(), []
        stored = self._metrics(figure.name) if figure.source == "metric" else self._coefficients()
        matching = self._matching(stored)
        if "/" in figure.model:
            return _ratios(matching, figure.model), []
        matching = matching[matching["model"] == figure.model]
        truths = matching["true_value"].dropna().tolist() if "true_value" in matching else []
        return matching["value"].tolist(), truths

    def exact(self) -> bool:
        """Whether every run identified the exact model, which only data without noise allow."""
        if self.figure.source != "metric" or not self.figure.model.startswith("identified"):
            return False
        errors = self._metrics("coefficient_error")
        errors = errors[errors["model"] == "identified"].groupby("run")["value"].max()
        return len(errors) == len(self.runs) and bool((errors < ROUNDING).all())

    def below_true_model(self, value: float) -> bool:
        """Whether our figure is below that of the exact plant: it fits lag or feedback.

        The stored flag of the identified model says so in most runs, or the plant's own figure, as
        the same ratio, is larger in the mean.
        """
        figure, metric = self.figure, self.figure.name.split("/")[-1]
        identified = figure.source == "metric" and figure.model.startswith("identified")
        if not (identified or "/" in figure.name) or not metric.startswith("force_m"):
            return False
        rows = self._metrics(BELOW_TRUE_MODEL, metric)
        rows = rows[rows["dof"] == figure.dof]
        flags = rows.loc[rows["metric"] == BELOW_TRUE_MODEL, "value"].fillna(0.0) != 0.0
        if identified and 2 * flags.sum() > len(flags):
            return True
        divisor = figure.model.partition("/")[2]
        own = self._matching(rows)
        plant = (
            _ratios(own, f"plant/{divisor}")
            if divisor
            else own.loc[own["model"] == "plant", "value"].tolist()
        )
        return bool(plant) and value < figure.factor * float(np.mean(plant))

    def _metrics(self, *names: str) -> pd.DataFrame:
        return self._of_finished(self.results.metrics(names, self.condition))

    def _of_finished(self, numbers: pd.DataFrame) -> pd.DataFrame:
        return numbers[numbers["run"].isin([run.id for run in self.runs])]

    def _matching(self, numbers: pd.DataFrame) -> pd.DataFrame:
        """Return the numbers of the figure that have a value."""
        figure, name = self.figure, self.figure.name.split("/")[-1]
        own = (numbers["metric"] == name) & (numbers["dof"] == figure.dof)
        own &= np.isfinite(numbers["value"])
        return numbers[own & (numbers["stage"] == figure.stage) if figure.stage else own]

    def _diagnostics(self) -> list[float]:
        """Return the diagnostic of each run, over a metric of the run for the model `/nominal`."""
        figure = self.figure
        name, _, metric = figure.name.partition("/")
        rows = self._of_finished(self.results.diagnostics([name], self.condition))
        chosen = [
            row
            for row in rows.sort_values("run", kind="stable").itertuples()
            if figure.dof in ("", row.dof)
            and figure.label
            in ("", row.label or "", str(row.i), f"{row.label} {row.i}", f"{row.i},{row.j}")
            and _known(row.value)
        ]
        if not metric:
            return [row.value for row in chosen]
        own = self._matching(self._metrics(metric))
        own = own[own["model"] == figure.model.removeprefix("/")]
        divisors = dict(zip(own["run"], own["value"], strict=True))
        pairs = [(row.value, divisors.get(row.run)) for row in chosen]
        return [value / divisor for value, divisor in pairs if divisor]

    def _coefficients(self) -> pd.DataFrame:
        """Return the coefficients of one term; a stored model without the term has a zero."""
        stored = self._of_finished(self.results.coefficients(self.condition))
        name, dof = self.figure.name, self.figure.dof
        own = stored[(stored["metric"] == name) & (stored["dof"] == dof)]
        models = stored.drop_duplicates(["run", "model"], keep="last")
        known = pd.MultiIndex.from_frame(own[["run", "model"]])
        lacking = models[~pd.MultiIndex.from_frame(models[["run", "model"]]).isin(known)]
        truth = lacking["true_value"].where(lacking["true_value"].isna(), 0.0)
        zeros = lacking.assign(metric=name, dof=dof, value=0.0, true_value=truth)
        return pd.concat([own, zeros])


def _ratios(numbers: pd.DataFrame, models: str) -> list[float]:
    """Return for each run the value of one model over that of another, `identified/nominal`."""
    above, below = (
        numbers[numbers["model"] == model].groupby("run")["value"].last()
        for model in models.split("/", 1)
    )
    ratios = above / below[below != 0.0]
    return ratios.dropna().tolist()


def _known(value: float | None) -> bool:
    return value is not None and math.isfinite(value)
