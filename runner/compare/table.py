"""The comparison table: statistics over seeds by rows and columns, with their qualifications."""

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import product

import numpy as np
import pandas as pd

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare import statistics as stats
from seatrial.runner.compare.cli import TableOptions, split
from seatrial.runner.compare.comparability import differing, require_few, with_conditions
from seatrial.runner.compare.frame import (
    DIVERGED,
    FINISHED,
    METRIC_FACTORS,
    NOT_APPLICABLE,
    WITHOUT,
    Queries,
    as_numbers,
    codes,
    complete,
    observations,
    ordered,
)
from seatrial.runner.compare.grid import Scalar, TextTable, number_text, unit_text, with_unit
from seatrial.runner.compare.grid import TableCell as GridCell
from seatrial.runner.compare.statistics import Key, Place, Sample
from seatrial.runner.compare.where import Condition
from seatrial.runner.record.catalogue import PER_FILE, definition_of
from seatrial.runner.record.vocabulary import NOT_STARTED, UNFINISHED

EMPTY = "–"
MIXED = "mixed"
MARK_NOTES = {
    stats.MARK: "below_true_model: the force error is below that of the true plant, so the model"
    " fits lag or feedback, not the vessel; such a value is never set in bold",
    stats.UNSETTLED: "the controller's closed loop has a spectral radius of 1 or more on its own"
    " model: the design is not asymptotically stable",
    stats.INFEASIBLE: "infeasible_limits: the weather needs more force than the limits allow",
}
TEST_NOTE = (
    "× is the ratio of means to {} with all else equal, over pairs of the same seed (of scores the"
    " difference, + or -); p is that of the two-sided Wilcoxon signed-rank test over at least five"
    " pairs, after Holm's correction over the tests of this table; r is its effect size, from 1"
    " (better in every pair) to -1; won is the number of pairs in which it is better, of all pairs,"
    " lost ones included"
)
BOLD_NOTE = "bold: the best under equal conditions and seeds, of cells that lost no run"
ESTIMATE_NOTE = (
    "se of the estimate: an interval of this identifier is one of its estimate, not of the"
    " coefficient, because it does not include the bias"
)
DIVERGED_NOTE = (
    "not included: {} prediction{} that diverged (see the metrics limited_share_... and"
    " held_free_run)"
)


@dataclass(frozen=True)
class Selection:
    """What the options of a table select.

    `trials` are those started or planned; `frame` has the numbers of finished runs, the baseline's
    included; those of the models that are `shown` fill the cells. `facts` describe their
    conditions. `rows` are all factors of the rows, `apart` those that the runs of a cell would
    differ in. `fixed` has the level of each factor of the numbers, None where there are several;
    `scope` names the sweep.
    """

    trials: pd.DataFrame
    frame: pd.DataFrame
    shown: pd.DataFrame
    facts: pd.DataFrame
    rows: Key
    apart: Key
    fixed: Mapping[str, str | None]
    scope: str


def comparison(results: Queries, options: TableOptions) -> TextTable:
    """Return the table of the options of the command `table`.

    Raises ConfigurationError for unknown names, if no run matches, or for too many cells.
    """
    return _Comparison(results, options).grid()


def select(results: Queries, options: TableOptions, apart: Key = ()) -> Selection:
    """Read what the options select, `apart` by further factors of the rows.

    A cell whose runs differ in more than the seed is split by what they differ in, or refused.
    Raises ConfigurationError for an unknown name.
    """
    (rows, columns), reference = options.axes, options.reference
    models, pool = options.levels["model"], ("all",) if apart else split(options.pool)
    own = [
        n for n in dict.fromkeys((*rows, *apart, *columns, *reference)) if n not in METRIC_FACTORS
    ]
    for option, factors in (("--rows/--columns", own), ("--pool", pool)):
        for factor in factors:
            if factor != "all":
                results.names.check(factor, option)
    condition, scope = results.selected(options.where, options.sweep)
    trials = results.trials(condition, own, planned=True)
    numbers = _read(results, options, condition)
    started = trials[trials["status"] != NOT_STARTED]
    for factor, level in reference.items():
        available = ordered((numbers if factor in METRIC_FACTORS else started)[factor].unique())
        if level not in available:
            raise ConfigurationError(
                f"--baseline: no run has {factor}={level}; expected one of {', '.join(available)}"
            )
    frame = observations(numbers, trials, results.marks(condition))
    if options.of_coefficients:
        covering = frame["run"].isin(results.covering(condition))
        frame["of_estimate"] = frame["std_error"].notna() & ~covering
    frame["is_baseline"] = bool(reference)
    for factor, level in reference.items():
        frame["is_baseline"] &= frame[factor] == level
    frame, facts = with_conditions(results, trials, frame)
    shown = frame[frame["model"].isin(models)] if models else frame
    cells = codes(shown, list(dict.fromkeys((*rows, *apart, *columns, *METRIC_FACTORS))))
    unlike = [] if "all" in pool else differing(facts, cells, shown["condition"], pool)
    require_few(unlike, "the cells of this table")
    if unlike:
        return select(results, options, tuple(unlike))
    of_number = METRIC_FACTORS if "file" in (*rows, *columns, *reference) else METRIC_FACTORS[:-1]
    levels = {name: ordered(shown[name].unique()) for name in of_number}
    several = [name for name, each in levels.items() if len(each) > 1]
    extra = [name for name in several if name not in (*rows, *columns)]
    fixed = {name: each[0] if len(each) == 1 else None for name, each in levels.items()}
    return Selection(trials, frame, shown, facts, (*extra, *rows, *apart), apart, fixed, scope)


def _read(results: Queries, options: TableOptions, condition: Condition) -> pd.DataFrame:
    """Return the numbers of the options; raises ConfigurationError if there are none of these."""
    names, wanted = options.names, options.levels
    if wanted["model"] and "model" in options.reference:
        wanted["model"] = (*wanted["model"], options.reference["model"])
    if options.of_coefficients:
        numbers = results.coefficients(condition)
        what, known = "coefficient", {*numbers["metric"].unique()}
        numbers = numbers[numbers["metric"].isin(names)] if names else numbers
    else:
        numbers = results.metrics(names, condition, wanted)
        if numbers.empty:  # read all levels, for the error message
            numbers = results.metrics(names, condition)
        what, known = "metric", {*numbers["metric"].unique()}
        if not known.issuperset(names):  # that these runs lack, or none has
            known |= {*results.metric_names()}
    if "file" in (*options.axes[0], *options.axes[1], *options.reference):
        of_files = results.of_files(names, condition)
        if of_files.empty:
            raise ConfigurationError(
                f"--rows/--columns: no run has {', '.join(names)} by file, expected "
                f"one of {', '.join(PER_FILE)} of runs with several files for testing"
            )
        numbers = as_numbers(pd.concat([numbers, of_files], ignore_index=True))
    for name in names:  # one that only these runs lack gives an empty cell
        if name not in known and known:
            near = [each for each in sorted(known) if each.startswith(name)]
            near = near or get_close_matches(name, known, 1)
            meant = f"did you mean {', '.join(near[:4])}? " if near else ""
            raise ConfigurationError(
                f"--{what}: no {what} {name!r}, {meant}expected one of {', '.join(sorted(known))}"
            )
    for factor, levels in wanted.items():
        available = ordered(numbers[factor].unique())
        numbers = numbers[numbers[factor].isin(levels)] if levels else numbers
        if levels and available and numbers.empty:
            raise ConfigurationError(
                f"--{factor}: no run has {', '.join(names) or 'a coefficient'} with"
                f" {factor} {', '.join(levels)}; expected one of {', '.join(available)}"
            )
    return numbers


class _Comparison:
    """The cells of a table, and their texts, bold, marks, notes and records."""

    def __init__(self, results: Queries, options: TableOptions) -> None:
        self.options = options
        self.statistics = stats.checked(split(options.statistic) or stats.DEFAULT)
        self.selection = chosen = select(results, options)
        axes = {"rows": chosen.rows, "columns": options.axes[1]}
        whole = complete(chosen.shown, chosen.trials, (*axes["rows"], *axes["columns"]))
        sizes = {axis: int(codes(whole, own).max()) + 1 for axis, own in axes.items()}
        if (cells := math.prod(sizes.values())) > options.cells:
            axis = max(sizes, key=lambda each: sizes[each])
            raise ConfigurationError(
                f"--{axis} {','.join(axes[axis])}: got {sizes[axis]} {axis}, {cells} cells; "
                f"expected at most {options.cells} cells (--cells)"
            )
        self.table = stats.pivot(whole, axes["rows"], axes["columns"], options.names)
        self.baseline = ", ".join(f"{name}={level}" for name, level in options.reference.items())
        self.tests = {}
        if self.baseline:
            of_baseline = chosen.frame, chosen.facts, options.reference
            self.tests = stats.against_baseline(self.table, *of_baseline)
        samples = {place: cell.sample for place, cell in self.table.cells.items()}
        self.figures = {k: stats.summary(own, self.statistics) for k, own in samples.items()}
        self.location = {place: self._location(own) for place, own in samples.items()}
        self.best = stats.best_cells(self.table, chosen.facts, self._location)

    def grid(self) -> TextTable:
        """Return the table; it has a column of units if the rows have different units."""
        keys, columns = self.table.row_keys, self.table.column_keys
        unit, of_rows = self._unit(), {row: self._unit(row=row) for row in keys}
        by_row = unit == MIXED and MIXED not in of_rows.values()
        rows = [
            [
                *map(GridCell, row),
                *([GridCell(of_rows[row])] if by_row else []),
                *(self._shown((row, column)) for column in columns),
            ]
            for row in keys
        ]
        headers = [*map(self._name, self.table.row_factors), *(["unit"] if by_row else [])]
        labels = len(headers)
        for column in columns:
            own = self._unit(column=column) if unit == MIXED and not by_row else ""
            headers.append(with_unit("\n".join(column) or "value", own))
        places = [place for place in product(keys, columns) if place in self.table.cells]
        records, notes = [self._record(*place) for place in places], self._qualifications()
        return TextTable(self._title(unit), headers, rows, labels, notes, records)

    def _name(self, factor: str) -> str:
        """Return the displayed name of a factor: the name of a coefficient is its term."""
        return "term" if factor == "metric" and self.options.of_coefficients else factor

    def _location(self, sample: Sample) -> float:
        """Return the value that represents a sample: the median if shown without the mean."""
        median = "median" in self.statistics and "mean" not in self.statistics
        return stats.summary(sample, ["median" if median else "mean"]).popitem()[1]

    def _shown(self, place: Place) -> GridCell:
        cell = self.table.cells.get(place)
        if cell is None:
            return GridCell("")
        text = self._figures_text(self.figures[place]) if cell.by_seed else EMPTY
        text += f" {' '.join(cell.marks)}" if cell.marks else ""
        text += self._counts_text(cell)
        if self.options.of_coefficients and cell.experiments:
            text += self._uncertainty_text(cell)
        if place in self.tests:
            text += "\n" + self._test_text(self.tests[place], cell)
        elif cell.is_baseline:
            text += "\nbaseline"
        value = self.location[place]
        return GridCell(text, place in self.best, None if math.isnan(value) else value)

    def _unit(self, row: Key | None = None, column: Key | None = None) -> str:
        """Return the unit of a row, a column or the whole table; MIXED if there are several."""
        units = {
            unit_text(unit)
            for (left, top), cell in self.table.cells.items()
            if row in (None, left) and column in (None, top)
            for unit in cell.units
        }
        return units.pop() if len(units) == 1 else (MIXED if units else "")

    def _title(self, unit: str) -> str:
        fixed, of_coefficients = self.selection.fixed, self.options.of_coefficients
        subject = fixed["metric"] or ", ".join(self.options.names) or "coefficients"
        factors = ("dof", "model") if of_coefficients else ("dof", "stage", "model")
        about = [with_unit(subject, "" if unit == MIXED else unit), *(fixed[n] for n in factors)]
        runs = int((self.selection.trials["status"] != NOT_STARTED).sum())
        words = {"std": "± standard deviation", "n": "(n)", "ci": "[95 % interval, t]"}
        told = " ".join(words.get(name, name) for name in self.statistics)
        told += ", se: standard error" if of_coefficients else ""
        scope = f", {self.selection.scope}" if self.selection.scope else ""
        return f"{', '.join(filter(None, about))}: {told}, {runs} run{'s'[: runs != 1]}{scope}"

    def _qualifications(self) -> list[str]:
        cells, apart = self.table.cells.values(), ", ".join(self.selection.apart)
        notes = [BOLD_NOTE] if self.best else []
        if apart:
            pool = apart.replace(" ", "")
            notes.append(
                f"split by {apart}, in which runs of one cell differ (--pool {pool} averages over"
                " it)"
            )
        if pooled := split(self.options.pool):
            notes.append(f"cells average over {', '.join(pooled)}, as requested")
        notes += sorted({definition_of(cell.metric).note for cell in cells} - {""})
        marks = {mark for cell in cells for mark in cell.marks}
        notes += [f"{mark} {note}" for mark, note in MARK_NOTES.items() if mark in marks]
        notes += [TEST_NOTE.format(self.baseline)] if self.tests else []
        notes += [ESTIMATE_NOTE] if any(cell.of_estimate for cell in cells) else []
        if diverged := sum(cell.missing.get(DIVERGED, 0) for cell in cells):
            notes.append(DIVERGED_NOTE.format(diverged, "s"[: diverged != 1]))
        statuses = self.selection.trials["status"]
        unfinished = sorted(Counter(statuses[statuses != FINISHED]).items())
        if counts := ", ".join(f"{n} {status}" for status, n in unfinished):
            notes.append(f"not included: {counts} (see: runs --status failed)")
        return notes

    def _record(self, row: Key, column: Key) -> dict[str, Scalar]:
        """Return the facts of a cell, at full precision."""
        place, of_coefficients = (row, column), self.options.of_coefficients
        cell, test = self.table.cells[place], self.tests.get(place)
        named = map(self._name, (*self.table.row_factors, *self.table.column_factors))
        record: dict[str, Scalar] = dict(zip(named, row + column, strict=True))
        for factor, level in self.selection.fixed.items():
            if factor != "stage" or not of_coefficients:
                record.setdefault(self._name(factor), level)
        record |= {"unit": " ".join(sorted(cell.units)), **self.figures[place]}
        if of_coefficients:
            record |= {"std_error": cell.std_error, "true_value": cell.true_value}
            record["interval_of_estimate"] = cell.of_estimate
        record["n"] = len(cell.by_seed)
        for reason in (*UNFINISHED, WITHOUT, NOT_APPLICABLE):
            record[reason.replace(" ", "_")] = cell.missing.get(reason, 0)
        record |= {
            "diverged_predictions": cell.missing.get(DIVERGED, 0),
            "deterministic": cell.deterministic, "below_true_model": cell.flagged,
            "unsettled": cell.unstable, "infeasible": cell.infeasible, "best": place in self.best,
        }  # fmt: skip
        if self.baseline:
            names = ("ratio", "difference", "p_value", "p_holm", "effect", "wins", "pairs")
            record |= {"baseline": self.baseline, **{n: getattr(test, n, None) for n in names}}
            record["lost_pairs"] = test.lost if test else None
        return record

    def _number(self, value: float) -> str:
        return number_text(value, self.options.digits)

    def _figures_text(self, figures: Mapping[str, float | int]) -> str:
        """Return `2757 ± 12`, `median 2757 q25 2750`, `2757 [2740, 2775]`; n is in the counts."""
        texts: list[str] = []
        for name in self.statistics:
            if name == "std":
                if math.isfinite(figures["std"]):
                    size = abs(figures.get("mean", figures.get("median", 0.0)))
                    rounding = figures["std"] < stats.RELATIVE_ROUNDING * size  # of equal values
                    spread = "0" if rounding else number_text(figures["std"], 2)
                    texts.append(("± " if texts else "std ") + spread)
            elif name == "ci":
                low, high = figures["ci_low"], figures["ci_high"]
                if math.isfinite(low):
                    texts.append(f"[{self._number(low)}, {self._number(high)}]")
            elif name != "n":
                texts.append(("" if name == "mean" else f"{name} ") + self._number(figures[name]))
        return " ".join(texts)

    def _counts_text(self, cell: stats.Cell) -> str:
        """Return ` (n=18, 2 failed)`; what is missing is shown with any choice of statistics."""
        reasons = (*sorted(UNFINISHED), DIVERGED, WITHOUT, NOT_APPLICABLE)
        counts = [f"{n} {reason}" for reason in reasons if (n := cell.missing.get(reason))]
        if cell.uneven:
            counts.append(f"{cell.uneven} seed{'s'[: cell.uneven != 1]} without all levels")
        if cell.experiments and ("n" in self.statistics or counts):
            counts.insert(0, "deterministic" if cell.deterministic else f"n={len(cell.by_seed)}")
            sample = cell.sample
            if sample.size > 1 and np.all(stats.equal(sample, float(sample[0]))):
                counts[0] += ", all equal"
        return f" ({', '.join(counts)})" if counts else ""

    def _uncertainty_text(self, cell: stats.Cell) -> str:
        """Return the standard error and the true value, if known."""
        what = " of the estimate" if cell.of_estimate else ""
        error = number_text(cell.std_error, 2)
        texts = [] if math.isnan(cell.std_error) else [f"se {error}{what}"]
        if not math.isnan(cell.true_value):
            texts.append(f"true {self._number(cell.true_value)}")
        return "\n" + ", ".join(texts) if texts else ""

    def _test_text(self, test: stats.PairedTest, cell: stats.Cell) -> str:
        """Return `× 0.5, p 0.031, r 1, won 6/6`."""
        if not test.pairs:
            return "no counterpart"
        p_value = f"p {test.p_holm:.2g}, r {number_text(test.effect, 2)}"
        if math.isnan(test.p_holm):
            p_value = f"{test.pairs} pair{'s'[: test.pairs != 1]}"
        ratio = "× –" if math.isnan(test.ratio) else f"× {number_text(test.ratio, 3)}"
        if definition_of(cell.metric).score:
            ratio = ("+" if test.difference >= 0.0 else "") + number_text(test.difference, 3)
        won = "" if test.wins is None else f", won {test.wins}/{test.pairs + test.lost}"
        of_pairs = test.pairs != len(cell.by_seed)
        own = f" (mean {self._number(test.mean)} of the pairs)" if of_pairs else ""
        return f"{ratio}, {p_value}{won}{own}"
