"""The metrics and coefficients that a logbook holds, by stage, model and degree of freedom."""

from collections import defaultdict
from collections.abc import Mapping

import sqlalchemy as sa

from seatrial.runner.compare.frame import COEFFICIENT_STAGE, Queries
from seatrial.runner.compare.site.run_columns import Json
from seatrial.runner.compare.site.scripts import coefficient_script, metric_script
from seatrial.runner.database.tables import CoefficientRow, MetricRow
from seatrial.runner.record.catalogue import definition_of

AGAIN = 10_000  # rows before the last one that are read again: writers commit in any order
Units = Mapping[tuple[str, str, str], str]  # by stage, model and degree of freedom


class StoredMeasures:
    """What was found so far, so that a growing logbook is read once and not at every change."""

    def __init__(self) -> None:
        m, c = MetricRow.__table__.c, CoefficientRow.__table__.c
        self._metrics = _StoredUnits(m.id, m.name, m.stage, m.model, m.dof, m.unit)
        self._terms = _StoredUnits(c.id, c.term, c.model, c.dof, c.unit)

    def told(self, results: Queries) -> list[Json]:
        """Return metrics, then coefficients, with what they are and the parts that are stored."""
        metrics, terms = self._metrics.read(results), self._terms.read(results)
        return [
            *(_metric(name, metrics[name]) for name in sorted(metrics)),
            *(_coefficient(term, terms[term]) for term in sorted(terms)),
        ]


class _StoredUnits:
    """The units of the numbers in a table, by name, stage, model and degree of freedom.

    `columns` are those of the name, the stage (if there is one), model, degree of freedom and unit.
    """

    def __init__(self, row: sa.ColumnElement[int], *columns: sa.ColumnElement[str]) -> None:
        *self._place, self._unit = columns
        self._row = row
        self._last = 0
        self._units: dict[str, dict[tuple[str, str, str], str]] = defaultdict(dict)

    def read(self, results: Queries) -> Mapping[str, Units]:
        """Return the units that are stored by now."""
        ((last,),) = results.reader.select(sa.select(sa.func.max(self._row)))
        if (last or 0) < self._last:  # runs were deleted
            self._last, self._units = 0, defaultdict(dict)
        query = sa.select(*self._place, sa.func.max(self._unit))
        query = query.where(self._row > self._last - AGAIN).group_by(*self._place)
        for name, *stage, model, dof, unit in map(tuple, results.reader.select(query)):
            (of_stage,) = stage or (COEFFICIENT_STAGE,)
            self._units[name][of_stage, model, dof] = unit
        self._last = last or 0
        return self._units


def _metric(name: str, units: Units) -> Json:
    definition = definition_of(name)
    return {
        "name": name,
        "script": metric_script(name),
        "label": definition.label,
        "parts": _parts(units),
    }


def _coefficient(term: str, units: Units) -> Json:
    return {
        "name": f"coefficient:{term}",
        "term": term,
        "script": coefficient_script(term),
        "label": term,
        "parts": _parts(units),
    }


def _parts(units: Units) -> list[list[str]]:
    return [[*part, unit] for part, unit in units.items()]
