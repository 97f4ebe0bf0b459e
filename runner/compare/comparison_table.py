"""The comparison table: statistics over seeds by rows and columns, with their qualifications."""

import math
from collections import Counter
from collections.abc import Iterable, Mapping

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.grid import Scalar, TextTable, number_text, unit_text, with_unit
from seatrial.runner.compare.grid import TableCell as GridCell
from seatrial.runner.compare.pivot import (
    Key,
    Pivot,
    PivotCell,
    Place,
    against_baseline,
    best_cells,
    pivot,
)
from seatrial.runner.compare.results import Queries
from seatrial.runner.compare.selection import Selection, TableRequest, gather
from seatrial.runner.compare.statistics import (
    RELATIVE_ROUNDING,
    PairedTest,
    Sample,
    equal,
    loss,
    summary,
)
from seatrial.runner.record.catalogue import definition_of
from seatrial.runner.record.vocabulary import NOT_STARTED, UNFINISHED

EMPTY = "–"
MARK = "†"
UNSETTLED, INFEASIBLE = "‡", "§"
MIXED = "mixed"
FLAG_NOTE = (
    f"{MARK} below_true_model: the force error is below that of the true plant, so the model fits"
    " lag or feedback, not the vessel; such a value is never set in bold"
)
UNSETTLED_NOTE = (
    f"{UNSETTLED} the controller's closed loop has a spectral radius of 1 or more on its own model:"
    " the design is not asymptotically stable"
)
INFEASIBLE_NOTE = (
    f"{INFEASIBLE} infeasible_limits: the weather needs more force than the limits allow"
)
TEST_NOTE = (
    "× is the ratio of means to {} with all else equal, over pairs of the same seed (of scores the"
    " difference, + or -); p is that of the two-sided Wilcoxon signed-rank test over at least five"
    " pairs, after Holm's correction over the tests of this table; r is its effect size, from 1"
    " (better in every pair) to -1; won is the number of pairs in which it is better, of all pairs,"
    " lost ones included"
)
BOLD_NOTE = "bold: the best under equal circumstances and seeds, of cells that lost no run"
ESTIMATE_NOTE = (
    "se of the estimate: an interval of this identifier is one of its estimate, not of the"
    " coefficient, because it does not include the bias"
)
DIVERGED_NOTE = (
    "not included: {} prediction{} that diverged (see the metrics limited_share_... and"
    " held_free_run)"
)


def comparison(results: Queries, request: TableRequest) -> TextTable:
    """Return the table; raises ConfigurationError for unknown names or if no run matches.

    `request` holds the names of metrics or coefficients, the factors of rows and columns, and the
    statistics of a cell.
    """
    selection = gather(results, request)
    rows = (*selection.extra, *request.rows, *selection.split)
    table = pivot(
        selection.shown, selection.runs, rows, request.columns, selection.flagged,
        selection.likeness, selection.diverged, request.names,
    )  # fmt: skip
    _check_size(table, request)
    tests = {}
    if request.baseline:
        tests = against_baseline(table, selection.all, request.baseline, selection.likeness)
    return _Writer(request, selection, table, tests).grid()


def _check_size(table: Pivot, request: TableRequest) -> None:
    """Raise ConfigurationError for a table that is too large, before its cells are written."""
    rows, columns = len(table.row_keys), len(table.column_keys)
    if rows * columns > request.cells:
        axis = "rows" if rows > columns else "columns"
        factors = ",".join(table.row_factors if rows > columns else table.column_factors)
        raise ConfigurationError(
            f"--{axis} {factors}: got {max(rows, columns)} {axis}, {rows * columns} cells; "
            f"expected at most {request.cells} cells (--cells)"
        )


class _Writer:
    """Turns a pivot into a grid: texts, bold, marks, notes and records."""

    def __init__(
        self,
        request: TableRequest,
        selection: Selection,
        table: Pivot,
        tests: Mapping[Place, PairedTest],
    ) -> None:
        self.request, self.selection = request, selection
        self.table, self.tests = table, tests
        self.row_keys = table.row_keys
        self.figures = {
            place: summary(cell.sample, request.statistics, request.interval)
            for place, cell in table.cells.items()
        }
        self.location = {place: self._location(cell.sample) for place, cell in table.cells.items()}
        self.best = best_cells(
            table,
            lambda place, sample: self._loss(place, self._location(sample)),
            self._resolution,
            selection.likeness,
            self._is_baseline,
        )

    def grid(self) -> TextTable:
        """Return the table; it has a column of units if the rows have different units."""
        by_row = self._unit() == MIXED and all(self._unit(row=r) != MIXED for r in self.row_keys)
        rows = [
            [
                *map(GridCell, row),
                *([GridCell(self._unit(row=row))] if by_row else []),
                *(self._shown((row, column)) for column in self.table.column_keys),
            ]
            for row in self.row_keys
        ]
        labels = [*map(self._name, self.table.row_factors), *(["unit"] if by_row else [])]
        headers = [*labels, *(self._header(c, not by_row) for c in self.table.column_keys)]
        notes = self._qualifications()
        return TextTable(self._title(), headers, rows, len(labels), notes, self._records())

    def _name(self, factor: str) -> str:
        """Return the displayed name of a factor: the name of a coefficient is its term."""
        return "term" if factor == "metric" and self.request.of_coefficients else factor

    def _location(self, sample: Sample) -> float:
        """Return the value that represents a sample: the median if shown without the mean."""
        shown = self.request.statistics
        median = "median" in shown and "mean" not in shown
        return summary(sample, ["median" if median else "mean"]).popitem()[1]

    def _loss(self, place: Place, value: float) -> float:
        """Return the loss of a value; for a coefficient the distance from the true value."""
        if self.request.of_coefficients:
            return abs(value - _truth(self.table.cells[place]))
        better = definition_of(self._metric(place)).better
        return math.nan if better is None else float(loss(np.array(value), better))

    def _resolution(self, place: Place) -> float:
        """Return the difference below which two losses are equal."""
        if self.request.of_coefficients:
            return 0.0
        return definition_of(self._metric(place)).resolution

    def _metric(self, place: Place) -> str:
        """Return the metric of a cell."""
        return self.table.level(*place, "metric") or self.selection.fixed.get("metric") or ""

    def _shown(self, place: Place) -> GridCell:
        cell = self.table.cells.get(place)
        if cell is None:
            return GridCell("")
        text = _figures_text(self.figures[place], self.request) if cell.by_seed else EMPTY
        marks = [MARK] if cell.flagged else []
        marks += [mark for mark, _ in self._flaws([cell])]
        text += f" {' '.join(marks)}" if marks else ""
        text += _counts_text(cell, self.request)
        if self.request.of_coefficients and cell.observed:
            text += _uncertainty_text(cell, self.request.digits, self._of_estimate(cell))
        if place in self.tests:
            text += "\n" + _test_text(
                self.tests[place], len(cell.by_seed), self.request.digits,
                definition_of(self._metric(place)).score,
            )  # fmt: skip
        elif self._is_baseline(cell):
            text += "\nbaseline"
        value = self.location[place]
        return GridCell(text, place in self.best, None if math.isnan(value) else value)

    def _of_estimate(self, cell: PivotCell) -> bool:
        """Return whether a standard error of a cell is of the estimate, not of the coefficient."""
        return any(
            observation.std_error is not None and observation.run.id not in self.selection.covering
            for observation in cell.observed
        )

    def _flaws(self, cells: Iterable[PivotCell]) -> list[tuple[str, str]]:
        """Return marks and notes on flaws of the controllers behind the deployment metrics."""
        deployed = {
            (observation.run.id, observation.model)
            for cell in cells
            for observation in cell.observed
            if observation.stage == "deployment"
        }
        flaws = [(UNSETTLED, UNSETTLED_NOTE)] if deployed & self.selection.unsettled else []
        return flaws + (
            [(INFEASIBLE, INFEASIBLE_NOTE)] if deployed & self.selection.infeasible else []
        )

    def _is_baseline(self, cell: PivotCell) -> bool:
        """Return whether the numbers of a cell are the baseline's."""
        levels = self.request.baseline.items()
        return bool(levels and cell.observed) and all(
            o.level(name) == level for o in cell.observed for name, level in levels
        )

    def _unit(self, row: Key | None = None, column: Key | None = None) -> str:
        """Return the unit of a row, a column or the whole table; MIXED if there are several."""
        units = {
            unit_text(unit)
            for (left, top), cell in self.table.cells.items()
            if row in (None, left) and column in (None, top)
            for unit in cell.units
        }
        return units.pop() if len(units) == 1 else (MIXED if units else "")

    def _header(self, column: Key, with_its_unit: bool) -> str:
        header = "\n".join(column) or "value"
        if with_its_unit and self._unit() == MIXED:
            return with_unit(header, self._unit(column=column))
        return header

    def _title(self) -> str:
        fixed, unit = self.selection.fixed, self._unit()
        subject = fixed.get("metric") or ", ".join(self.request.names) or "coefficients"
        factors = ("dof", "model") if self.request.of_coefficients else ("dof", "stage", "model")
        about = [with_unit(subject, "" if unit == MIXED else unit)]
        about += [fixed[name] for name in factors if name in fixed]
        runs = len({run.id for run in self.selection.runs if run.status != NOT_STARTED})
        scope = f", {self.selection.scope}" if self.selection.scope else ""
        counted = f"{runs} run{'s'[: runs != 1]}{scope}"
        return f"{', '.join(about)}: {_statistics_text(self.request)}, {counted}"

    def _qualifications(self) -> list[str]:
        notes = []
        if self.best:
            notes.append(BOLD_NOTE)
        if self.selection.split:
            notes.append(
                f"split by {', '.join(self.selection.split)}, in which runs of one cell differ"
                f" (--pool {','.join(self.selection.split)} averages over it)"
            )
        if self.request.pool:
            notes.append(f"cells average over {', '.join(self.request.pool)}, as requested")
        if any(cell.flagged for cell in self.table.cells.values()):
            notes.append(FLAG_NOTE)
        shown = {
            observation.name for cell in self.table.cells.values() for observation in cell.observed
        }
        notes += sorted({definition_of(name).note for name in shown} - {""})
        notes += [note for _, note in self._flaws(self.table.cells.values())]
        if self.tests:
            notes.append(TEST_NOTE.format(_baseline_text(self.request)))
        if any(map(self._of_estimate, self.table.cells.values())):
            notes.append(ESTIMATE_NOTE)
        diverged = sum(cell.diverged for cell in self.table.cells.values())
        if diverged:
            notes.append(DIVERGED_NOTE.format(diverged, "s"[: diverged != 1]))
        unfinished = Counter(run.status for run in self.selection.runs if run.status != "finished")
        if unfinished:
            counts = ", ".join(f"{n} {status}" for status, n in sorted(unfinished.items()))
            notes.append(f"not included: {counts} (see: runs --status failed)")
        return notes

    def _records(self) -> list[dict[str, Scalar]]:
        """Return one record for each cell, at full precision."""
        return [
            self._record(row, column)
            for row in self.row_keys
            for column in self.table.column_keys
            if (row, column) in self.table.cells
        ]

    def _record(self, row: Key, column: Key) -> dict[str, Scalar]:
        place, table = (row, column), self.table
        cell = table.cells[place]
        record: dict[str, Scalar] = {}
        for factor, level in zip(
            (*table.row_factors, *table.column_factors), row + column, strict=True
        ):
            record[self._name(factor)] = level
        for factor in self.request.own_factors:
            if factor != "stage" or not self.request.of_coefficients:
                record.setdefault(self._name(factor), self.selection.fixed.get(factor))
        record["unit"] = " ".join(sorted(cell.units))
        record |= self.figures[place]
        if self.request.of_coefficients:
            record["std_error"], record["true_value"] = _std_error(cell), _truth(cell)
            record["interval_of_estimate"] = self._of_estimate(cell)
        record["n"] = len(cell.by_seed)
        for status in UNFINISHED:
            record[status.replace(" ", "_")] = cell.unfinished.get(status, 0)
        record["without_value"] = cell.without
        record["not_applicable"] = cell.not_applicable
        record["diverged_predictions"] = cell.diverged
        record["held_s"] = None if math.isnan(cell.held_s) else cell.held_s
        record["deterministic"] = cell.deterministic
        record["below_true_model"] = cell.flagged
        marks = [mark for mark, _ in self._flaws([cell])]
        record["unsettled"], record["infeasible"] = UNSETTLED in marks, INFEASIBLE in marks
        record["best"] = place in self.best
        return record | self._test_record(place)

    def _test_record(self, place: Place) -> dict[str, Scalar]:
        if not self.request.baseline:
            return {}
        test = self.tests.get(place)
        return {
            "baseline": _baseline_text(self.request),
            "ratio": test.ratio if test else None,
            "difference": test.difference if test else None,
            "p_value": test.p_value if test else None,
            "p_holm": test.p_holm if test else None,
            "effect": test.effect if test else None,
            "wins": test.wins if test else None,
            "pairs": test.pairs if test else None,
            "lost_pairs": test.lost if test else None,
        }


def _statistics_text(request: TableRequest) -> str:
    """Return the names of the statistics: `mean ± standard deviation (n)`."""
    words = {
        "std": "± standard deviation",
        "n": "(n)",
        "ci": f"[95 % interval, {request.interval}]",
    }
    text = " ".join(words.get(name, name) for name in request.statistics)
    return f"{text}, se: standard error" if request.of_coefficients else text


def _figures_text(figures: Mapping[str, float | int], request: TableRequest) -> str:
    """Return `2757 ± 12`, `median 2757 q25 2750`, `2757 [2740, 2775]`; n is in the counts."""
    digits = request.digits
    texts: list[str] = []
    for name in request.statistics:
        if name == "std":
            if math.isfinite(figures["std"]):
                size = abs(figures.get("mean", figures.get("median", 0.0)))
                rounding = figures["std"] < RELATIVE_ROUNDING * size  # of equal values
                spread = "0" if rounding else number_text(figures["std"], 2)
                texts.append(("± " if texts else "std ") + spread)
        elif name == "ci":
            low, high = figures["ci_low"], figures["ci_high"]
            if math.isfinite(low):
                texts.append(f"[{number_text(low, digits)}, {number_text(high, digits)}]")
        elif name != "n":
            label = "" if name == "mean" else f"{name} "
            texts.append(label + number_text(figures[name], digits))
    return " ".join(texts)


def _counts_text(cell: PivotCell, request: TableRequest) -> str:
    """Return ` (n=18, 2 failed)`; what is missing is shown with any choice of statistics."""
    counts = [f"{n} {status}" for status, n in sorted(cell.unfinished.items())]
    if cell.diverged:
        held = "" if math.isnan(cell.held_s) else f", held {number_text(cell.held_s, 2)} s"
        counts.append(f"{cell.diverged} diverged in prediction{held}")
    if cell.without:
        counts.append(f"{cell.without} without value")
    if cell.not_applicable:
        counts.append(f"{cell.not_applicable} not applicable")
    if cell.uneven:
        counts.append(f"{cell.uneven} seed{'s'[: cell.uneven != 1]} without all levels")
    if cell.observed and ("n" in request.statistics or counts):
        counts.insert(0, "deterministic" if cell.deterministic else f"n={len(cell.by_seed)}")
        sample = cell.sample
        if sample.size > 1 and np.all(equal(sample, float(sample[0]))):
            counts[0] += ", all equal"
    return f" ({', '.join(counts)})" if counts else ""


def _uncertainty_text(cell: PivotCell, digits: int, of_estimate: bool) -> str:
    """Return the standard error and the true value, if known."""
    error, truth = _std_error(cell), _truth(cell)
    what = " of the estimate" if of_estimate else ""
    texts = [] if math.isnan(error) else [f"se {number_text(error, 2)}{what}"]
    if not math.isnan(truth):
        texts.append(f"true {number_text(truth, digits)}")
    return "\n" + ", ".join(texts) if texts else ""


def _std_error(cell: PivotCell) -> float:
    """Return the root mean square of the standard errors in a cell."""
    errors = [
        observation.std_error for observation in cell.observed if observation.std_error is not None
    ]
    return math.sqrt(sum(e * e for e in errors) / len(errors)) if errors else math.nan


def _truth(cell: PivotCell) -> float:
    """Return the true value that all runs of a cell share, else NaN."""
    truths = {observation.true_value for observation in cell.observed}
    truth = truths.pop() if len(truths) == 1 else None
    return math.nan if truth is None else truth


def _test_text(test: PairedTest, n: int, digits: int, is_score: bool) -> str:
    if not test.pairs:
        return "no counterpart"
    p_value = f"p {test.p_holm:.2g}, r {number_text(test.effect, 2)}"
    if math.isnan(test.p_holm):
        p_value = f"{test.pairs} pair{'s'[: test.pairs != 1]}"
    ratio = "× –" if math.isnan(test.ratio) else f"× {number_text(test.ratio, 3)}"
    if is_score:
        ratio = ("+" if test.difference >= 0.0 else "") + number_text(test.difference, 3)
    won = "" if test.wins is None else f", won {test.wins}/{test.pairs + test.lost}"
    own = f" (mean {number_text(test.mean, digits)} of the pairs)" if test.pairs != n else ""
    return f"{ratio}, {p_value}{won}{own}"


def _baseline_text(request: TableRequest) -> str:
    return ", ".join(f"{name}={level}" for name, level in request.baseline.items())
