"""The comparison table: statistics over seeds by rows and columns, with their qualifications."""

import math
from collections import Counter
from typing import Any

import pandas as pd

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare import frame as frames
from seatrial.runner.compare import statistics as stats
from seatrial.runner.compare.cli import TableOptions
from seatrial.runner.compare.comparability import differing, require_few, with_conditions
from seatrial.runner.compare.grid import Scalar, TextTable, number_text, unit_text, with_unit
from seatrial.runner.compare.grid import TableCell as GridCell
from seatrial.runner.compare.where import Condition
from seatrial.runner.configuration.invocation import meant
from seatrial.runner.record.catalogue import PER_FILE, definition_of
from seatrial.runner.record.vocabulary import NOT_STARTED, UNFINISHED

EMPTY = "–"
MIXED = "mixed"
OWN = (frames.DIVERGED, frames.WITHOUT, frames.NOT_APPLICABLE)  # reasons of finished runs
MISSING = (*sorted(UNFINISHED), *OWN)  # reasons, as they are counted
COEFFICIENT_FACTS = ("std_error", "true_value", "interval_of_estimate")
FACTS = (
    *("n", *(stats.COUNTS[why] for why in (*UNFINISHED, *OWN[1:], OWN[0]))),
    *("deterministic", "below_true_model", "unsettled", "infeasible", "best"),
)
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
ESTIMATE_NOTE = (
    "se of the estimate: an interval of this identifier is one of its estimate, not of the"
    " coefficient, because it does not include the bias"
)


def comparison(results: frames.Queries, options: TableOptions) -> TextTable:
    """Return the table of the options of the command `table`.

    A cell whose runs differ in more than the seed is split by what they differ in, or refused.
    Raises ConfigurationError for unknown names, if no run matches, or for too many cells.
    """
    return _Comparison(results, options).grid()


def _read(results: frames.Queries, options: TableOptions, condition: Condition) -> pd.DataFrame:
    """Return the numbers of the options; raises ConfigurationError if there are none of these."""
    names, wanted = options.names, options.levels
    if wanted["model"] and "model" in options.reference:
        wanted["model"] = (*wanted["model"], options.reference["model"])
    if options.of_coefficients:
        what, numbers = "coefficient", results.coefficients(condition)
        known = {*numbers["metric"].unique()}
        numbers = numbers[numbers["metric"].isin(names)] if names else numbers
    else:
        what, numbers = "metric", results.metrics(names, condition, wanted)
        if numbers.empty:  # read all levels, for the error message
            numbers = results.metrics(names, condition)
        known = {*numbers["metric"].unique()}
        known |= {*(() if known.issuperset(names) else results.metric_names())}
    if "file" in (*options.axes[0], *options.axes[1], *options.reference):
        of_files = results.of_files(names, condition)
        if of_files.empty:
            raise ConfigurationError(
                f"--rows/--columns: no run has {', '.join(names)} by file, expected "
                f"one of {', '.join(PER_FILE)} of runs with several files for testing"
            )
        numbers = frames.as_numbers(pd.concat([numbers, of_files], ignore_index=True))
    for name in names:  # one that only these runs lack gives an empty cell
        if name not in known and known:
            raise ConfigurationError(
                f"--{what}: no {what} {name!r}, {meant(name, known, 4)}"
                f"expected one of {', '.join(sorted(known))}"
            )
    for factor, levels in wanted.items():
        available = frames.ordered(numbers[factor].unique())
        numbers = numbers[numbers[factor].isin(levels)] if levels else numbers
        if levels and available and numbers.empty:
            raise ConfigurationError(
                f"--{factor}: no run has {', '.join(names) or 'a coefficient'} with"
                f" {factor} {', '.join(levels)}; expected one of {', '.join(available)}"
            )
    return numbers


class _Comparison:
    """What the options of a table select: its cells, and their texts, marks, notes and records.

    `trials` are those started or planned; `frame` has the numbers of finished runs, the baseline's
    included; those of the models that are `shown` fill the cells. `facts` describe their
    conditions. The rows are split `apart` by the factors that the runs of a cell would differ in.
    `fixed` has the level of each factor of the numbers, None where there are several; `scope` names
    the sweep.
    """

    def __init__(self, results: frames.Queries, options: TableOptions) -> None:
        self.options = options
        self.statistics = stats.checked(options.statistic or stats.DEFAULT)
        (rows, columns), reference = options.axes, options.reference
        models, pool = options.levels["model"], options.pool or []
        named = dict.fromkeys((*rows, *columns, *reference))
        own = [name for name in named if name not in frames.METRIC_FACTORS]
        for option, factors in (("--rows/--columns", own), ("--pool", pool)):
            for factor in factors:
                if factor != "all":
                    results.check(factor, option)
        condition, self.scope = results.selected(options.where, options.sweep)
        self.trials = trials = results.trials(condition, own, planned=True)
        numbers = _read(results, options, condition)
        started = trials[trials["status"] != NOT_STARTED]
        for factor, level in reference.items():
            available = frames.ordered(
                (numbers if factor in frames.METRIC_FACTORS else started)[factor].unique()
            )
            if level not in available:
                known = ", ".join(available)
                raise ConfigurationError(
                    f"--baseline: no run has {factor}={level}; expected one of {known}"
                )
        frame = frames.observations(numbers, trials, results.marks(condition))
        if options.of_coefficients:
            covering = frame["run"].isin(results.covering(condition))
            frame["interval_of_estimate"] = frame["std_error"].notna() & ~covering
        frame["is_baseline"] = bool(reference)
        for factor, level in reference.items():
            frame["is_baseline"] &= frame[factor] == level
        self.frame, self.facts = with_conditions(results, trials, frame)
        shown = self.frame[self.frame["model"].isin(models)] if models else self.frame
        cells = frames.codes(shown, list(dict.fromkeys((*rows, *columns, *frames.METRIC_FACTORS))))
        apart = [] if "all" in pool else differing(self.facts, cells, shown["condition"], pool)
        require_few(apart, "the cells of this table")
        if apart:
            self.trials = results.trials(condition, [*own, *apart], planned=True)
        new = [name for name in apart if name not in shown]
        self.frame, shown = (own.join(self.trials[new], on="run") for own in (self.frame, shown))
        self.apart, self.shown = apart, shown
        by_file = "file" in (*rows, *columns, *reference)
        of_number = frames.METRIC_FACTORS if by_file else frames.METRIC_FACTORS[:-1]
        levels = {name: frames.ordered(self.shown[name].unique()) for name in of_number}
        several = [name for name, each in levels.items() if len(each) > 1]
        extra = [name for name in several if name not in (*rows, *columns)]
        self.fixed = {name: each[0] if len(each) == 1 else None for name, each in levels.items()}
        self.axes = {"rows": (*extra, *rows, *apart), "columns": columns}

    def fill(self) -> None:
        """Group the numbers into cells; raises ConfigurationError for too many of them."""
        options, axes = self.options, self.axes
        whole = frames.complete(self.shown, self.trials, (*axes["rows"], *axes["columns"]))
        sizes = [int(frames.codes(whole, own).max()) + 1 for own in axes.values()]
        if math.prod(sizes) > options.cells:
            got = f"{sizes[0]} rows and {sizes[1]} columns"
            expected = f"expected at most {options.cells} cells (--cells)"
            raise ConfigurationError(f"--rows, --columns: got {got}, {expected}")
        self.table = table = stats.pivot(whole, axes["rows"], axes["columns"], options.names)
        self.baseline = ", ".join(f"{name}={level}" for name, level in options.reference.items())
        self.tests = {}
        if self.baseline:
            of_baseline = self.frame, self.facts, options.reference
            self.tests = stats.against_baseline(table, *of_baseline)
        # the median represents a sample if it is shown without the mean
        median = "median" in self.statistics and "mean" not in self.statistics
        self.location = "median" if median else "mean"
        shown = [name for name in (*self.statistics, self.location) if name != "n"]
        cells = table.cells.join(stats.summary(table.values, shown))
        groups = stats.grouped(table, self.facts)
        best = stats.best_cells(table, groups, self.location)
        self.cells = cells.assign(best=best, lacking=groups["lacking"])
        first = table.values.groupby("cell")["value"].transform("first")
        same = table.values["cell"][~stats.equal(table.values["value"], first)]
        self.cells["all_equal"] = (cells["n"] > 1) & ~cells.index.isin(same)

    def grid(self) -> TextTable:
        """Return the table; it has a column of units if the rows have different units."""
        self.fill()
        cells, keys = self.cells, self.table.column_keys
        unit, of_rows = _unit(cells), dict(iter(cells.groupby("row", sort=False)))
        by_row = unit == MIXED and all(_unit(own) != MIXED for own in of_rows.values())
        rows = []
        for row, own in of_rows.items():
            texts = {cell.column: self._shown(cell) for cell in own.itertuples()}
            labels = [*row, _unit(own)] if by_row else row
            rows.append([*map(GridCell, labels), *(texts.get(key, GridCell("")) for key in keys)])
        labels = [*map(self._name, self.table.rows), *(["unit"] if by_row else [])]
        headers = [*labels]
        for key in keys:
            several = unit == MIXED and not by_row
            own = _unit(cells[cells["column"].isin([key])]) if several else ""
            headers.append(with_unit("\n".join(key) or "value", own))
        notes = self._qualifications()
        return TextTable(self._title(unit), headers, rows, len(labels), notes, self._records())

    def _name(self, factor: str) -> str:
        """Return the displayed name of a factor: the name of a coefficient is its term."""
        return "term" if factor == "metric" and self.options.of_coefficients else factor

    def _shown(self, cell: Any) -> GridCell:
        """Return `2757 ± 12`, `median 2757 q25 2750`, `2757 [2740, 2775]`; counts, error, test."""
        texts = list[str]() if cell.n else [EMPTY]
        for name in self.statistics if cell.n else ():
            if name == "std" and math.isfinite(cell.std):
                spread = "0" if cell.all_equal else number_text(cell.std, 2)
                texts.append(("± " if texts else "std ") + spread)
            elif name == "ci" and math.isfinite(cell.ci_low):
                texts.append(f"[{self._number(cell.ci_low)}, {self._number(cell.ci_high)}]")
            elif name not in ("std", "ci", "n"):
                value = self._number(getattr(cell, name))
                texts.append(value if name == "mean" else f"{name} {value}")
        text = " ".join([*texts, *stats.marks_of(cell)]) + self._counts_text(cell)
        if self.options.of_coefficients and cell.experiments:
            what = " of the estimate" if cell.interval_of_estimate else ""
            error, true = number_text(cell.std_error, 2), self._number(cell.true_value)
            known = [] if math.isnan(cell.std_error) else [f"se {error}{what}"]
            known += [] if math.isnan(cell.true_value) else [f"true {true}"]
            text += "\n" + ", ".join(known) if known else ""
        if cell.Index in self.tests:
            text += "\n" + self._test_text(self.tests[cell.Index], cell)
        elif cell.is_baseline:
            text += "\nbaseline"
        place = float(getattr(cell, self.location))
        return GridCell(text, bool(cell.best), None if math.isnan(place) else place)

    def _title(self, unit: str) -> str:
        fixed, of_coefficients = self.fixed, self.options.of_coefficients
        subject = fixed["metric"] or ", ".join(self.options.names) or "coefficients"
        factors = ("dof", "model") if of_coefficients else ("dof", "stage", "model")
        about = [with_unit(subject, "" if unit == MIXED else unit), *(fixed[n] for n in factors)]
        runs = int((self.trials["status"] != NOT_STARTED).sum())
        words = {"std": "± standard deviation", "n": "(n)", "ci": "[95 % interval, t]"}
        told = " ".join(words.get(name, name) for name in self.statistics)
        told += ", se: standard error" if of_coefficients else ""
        scope = f", {self.scope}" if self.scope else ""
        return f"{', '.join(filter(None, about))}: {told}, {runs} run{'s'[: runs != 1]}{scope}"

    def _qualifications(self) -> list[str]:
        cells, apart = self.cells, ", ".join(self.apart)
        notes = [stats.BOLD_NOTE] if cells["best"].any() else []
        told = f"split by {apart}, in which runs of one cell differ (--pool {{}} averages over it)"
        notes += [told.format(apart.replace(" ", ""))] if apart else []
        if pooled := self.options.pool:
            notes.append(f"cells average over {', '.join(pooled)}, as requested")
        notes += sorted({definition_of(metric).note for metric in cells["metric"].unique()} - {""})
        marked = [mark for mark, column in stats.MARKS.items() if cells[column].any()]
        notes += [f"{mark} {MARK_NOTES[mark]}" for mark in marked]
        notes += [TEST_NOTE.format(self.baseline)] if self.tests else []
        notes += [ESTIMATE_NOTE] if cells.get("interval_of_estimate", pd.Series()).any() else []
        if diverged := int(cells[stats.COUNTS[frames.DIVERGED]].sum()):
            told = f"not included: {diverged} prediction{'s'[: diverged != 1]} that diverged (see"
            notes.append(f"{told} the metrics limited_share_... and held_free_run)")
        statuses = self.trials["status"]
        unfinished = sorted(Counter(statuses[statuses != frames.FINISHED]).items())
        if counts := ", ".join(f"{n} {status}" for status, n in unfinished):
            absent = f' --status "{NOT_STARTED}"' if NOT_STARTED in counts else ""
            notes.append(f"not included: {counts} (see: runs{absent})")
        return notes

    def _records(self) -> list[dict[str, Scalar]]:
        """Return the facts of the cells, at full precision."""
        of_coefficients, table = self.options.of_coefficients, self.table
        factors = [*map(self._name, (*table.rows, *table.columns))]
        fixed = {self._name(name): level for name, level in self.fixed.items()}
        if of_coefficients:
            del fixed["stage"]
        figures = (("ci_low", "ci_high") if name == "ci" else (name,) for name in self.statistics)
        shown = dict.fromkeys(name for own in figures for name in own)
        shown |= dict.fromkeys((*(COEFFICIENT_FACTS if of_coefficients else ()), *FACTS))
        facts = self.cells[[*shown]]
        records: list[dict[str, Scalar]] = []
        for cell, told in zip(self.cells.itertuples(), facts.to_dict("records"), strict=True):
            named = dict(zip(factors, cell.row + cell.column, strict=True))
            levels = {name: level for name, level in fixed.items() if name not in named}
            records.append({**named, **levels, "unit": " ".join(sorted(cell.units)), **told})
            if self.baseline:
                test, names = self.tests.get(cell.Index), stats.PairedTest._fields[:-1]
                tested = dict.fromkeys(names) if test is None else test._asdict()
                records[-1] |= {"baseline": self.baseline, **{n: tested[n] for n in names}}
        return records

    def _number(self, value: float) -> str:
        return number_text(value, self.options.digits)

    def _counts_text(self, cell: Any) -> str:
        """Return ` (n=18, 2 failed)`; what is missing is shown with any choice of statistics."""
        lacking = {reason: getattr(cell, stats.COUNTS[reason]) for reason in MISSING}
        counts = [f"{n} {reason}" for reason, n in lacking.items() if n]
        if cell.uneven:
            counts.append(f"{cell.uneven} seed{'s'[: cell.uneven != 1]} without all levels")
        if cell.lacking:
            counts.append(f"{cell.lacking} level{'s'[: cell.lacking != 1]} lacking")
        if cell.experiments and ("n" in self.statistics or counts):
            number = "deterministic" if cell.deterministic else f"n={cell.n}"
            counts.insert(0, number + ", all equal" * bool(cell.all_equal))
        return f" ({', '.join(counts)})" if counts else ""

    def _test_text(self, test: stats.PairedTest, cell: Any) -> str:
        """Return `× 0.5, p 0.031, r 1, won 6/6`."""
        all_pairs = test.pairs + test.lost_pairs
        won = "" if test.wins is None else f"won {test.wins}/{all_pairs}"
        if not test.pairs:
            return won if test.lost_pairs else "no counterpart"
        p_value = f"p {test.p_holm:.2g}, r {number_text(test.effect, 2)}"
        if math.isnan(test.p_holm):
            p_value = f"{test.pairs} pair{'s'[: test.pairs != 1]}"
        ratio = "× –" if math.isnan(test.ratio) else f"× {number_text(test.ratio, 3)}"
        if definition_of(cell.metric).score:
            ratio = ("+" if test.difference >= 0.0 else "") + number_text(test.difference, 3)
        of_pairs = test.pairs != cell.n
        own = f" (mean {self._number(test.own_mean)} of the pairs)" if of_pairs else ""
        return ", ".join(filter(None, (ratio, p_value, won))) + own


def _unit(cells: pd.DataFrame) -> str:
    """Return the unit of cells; MIXED if there are several, empty if there is none."""
    units = {unit_text(unit) for own in cells["units"] for unit in own}
    return units.pop() if len(units) == 1 else (MIXED if units else "")
