"""The metrics that a logbook holds, by stage, model and degree of freedom."""

from collections import defaultdict

import sqlalchemy as sa

from seatrial.runner.compare.results import Results
from seatrial.runner.compare.site.run_columns import Json
from seatrial.runner.compare.site.scripts import metric_script
from seatrial.runner.database.tables import Metric
from seatrial.runner.record.catalogue import definition_of

AGAIN = 10_000  # rows before the last one that are read again: writers commit in any order


class StoredMeasures:
    """What was found so far, so that a growing logbook is read once and not at every change."""

    def __init__(self) -> None:
        self._last = 0
        self._units: dict[str, dict[tuple[str, str, str], str]] = defaultdict(dict)

    def told(self, results: Results) -> list[Json]:
        """Return every metric by name, with its declaration and the parts that are stored."""
        m = Metric.__table__.c
        ((last,),) = results.reader.select(sa.select(sa.func.max(m.id)))
        if (last or 0) < self._last:  # runs were deleted
            self._last, self._units = 0, defaultdict(dict)
        query = sa.select(m.name, m.stage, m.model, m.dof, sa.func.max(m.unit))
        query = query.where(m.id > self._last - AGAIN)
        for name, *part, unit in map(
            tuple, results.reader.select(query.group_by(m.name, m.stage, m.model, m.dof))
        ):
            stage, model, dof = part
            self._units[name][stage, model, dof] = unit
        self._last = last or 0
        return [self._measure(name) for name in sorted(self._units)]

    def _measure(self, name: str) -> Json:
        definition = definition_of(name)
        return {
            "name": name,
            "script": metric_script(name),
            "label": definition.label,
            "formula": definition.formula,
            "note": definition.note,
            "better": definition.better,
            "score": definition.score,
            "parts": [[*part, unit] for part, unit in self._units[name].items()],
        }
