"""The results database as the comparison reads it: runs and their numbers, nothing written.

All queries of tables and figures stand here. A trial that was repeated counts once: by its latest
finished attempt, else by its latest (the view's column `superseded` says which do not count).
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import sqlalchemy as sa
from sqlalchemy.engine import URL

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.factors import Names, flat
from seatrial.runner.compare.where import Condition, parse
from seatrial.runner.database.reader import Reader
from seatrial.runner.database.tables import Coefficient, Diagnostic, Metric, Reuse, Series
from seatrial.runner.database.tables import Run as RunTable
from seatrial.runner.database.views import run_overview
from seatrial.runner.vocabulary import GROUPS

# What tables and figures are made of: runs, and one number of a run each.
#
# A *factor* is a name that rows, columns or facets go by: a column of table `run`, a dotted key of
# the configuration, or a property of the number itself (model, dof, stage, metric).


OWN_FACTORS = ("metric", "stage", "model", "dof")  # what the number, not its run, says
BELOW_TRUE_MODEL = "below_true_model"
DESIGN_FLAWS = ("spectral_radius", "infeasible_limits")  # of a controller, where 1 or more
FINISHED = "finished"


@dataclass(frozen=True, slots=True)
class Run:
    """A stored run; `levels` are its choices, its seed and the factors asked for, as text."""

    id: int
    status: str  # running, finished, diverged, failed or interrupted
    levels: Mapping[str, str] = field(repr=False)
    sweep: int | None = None


@dataclass(frozen=True, slots=True)
class Observation:
    """One number of a run: a metric, or (stage `coefficient`) a coefficient named by its term."""

    run: Run
    stage: str
    model: str
    dof: str
    name: str
    value: float | None
    unit: str
    std_error: float | None = None
    true_value: float | None = None

    def level(self, factor: str) -> str:
        """The value of a factor, as text."""
        match factor:
            case "metric":
                return self.name
            case "stage":
                return self.stage
            case "model":
                return self.model
            case "dof":
                return self.dof
            case _:
                return self.run.levels[factor]


def ordered(levels: Iterable[str]) -> list[str]:
    """Distinct levels in reading order: numbers by size, then `none`, then text."""
    return sorted(set(levels), key=_reading_order)


def _reading_order(level: str) -> tuple[int, float, str]:
    try:
        return 0, float(level), level
    except ValueError:
        return (1 if level in ("none", "calm", "nominal") else 2), 0.0, level


RUN = RunTable.__table__
LABELS = (*GROUPS, "seed")
COEFFICIENT_STAGE = "coefficient"


@contextmanager
def open_results(database: str, results_dir: Path | None = None) -> Iterator["Results"]:
    """The logbook at a URL or plain path, for reading; LogbookError where there is none.

    `results_dir` is where its series are: by default the folder of a SQLite file, or `results`.
    """
    url = database if "://" in database else URL.create("sqlite", database=database)
    with Reader.read(url, results_dir=results_dir) as reader:
        yield Results(reader)


class Results:
    """The questions of tables and figures to one logbook."""

    def __init__(self, reader: Reader) -> None:
        self.reader = reader

    @cached_property
    def names(self) -> Names:
        """The names that conditions, rows and columns may use."""
        newest = sa.select(sa.func.max(RUN.c.id)).group_by(*(RUN.c[name] for name in GROUPS))
        rows = self.reader.select(sa.select(RUN.c.config).where(RUN.c.id.in_(newest)))
        keys = {key for row in rows for key in flat(row.config)}
        columns: dict[str, Any] = {column.name: column for column in RUN.c}
        columns["status"] = run_overview.c.status
        return Names(columns, RUN.c.config, keys, self.reader.address.sqlite)

    def where(self, text: str | None) -> Condition | None:
        """The condition that --where says, its names checked."""
        condition = parse(text) if text else None
        if condition is not None:
            self.names.clause(condition)
        return condition

    def runs(
        self,
        condition: Condition | None = None,
        factors: Sequence[str] = (),
        superseded: bool = False,
    ) -> list[Run]:
        """Runs that meet the condition, oldest first, with their levels of the factors.

        Without `superseded`, one attempt a trial. Raises ConfigurationError where none is left.
        """
        names = list(dict.fromkeys((*LABELS, *factors)))
        texts = [self.names.text(name) for name in names]
        columns = (RUN.c.id, run_overview.c.status, RUN.c.sweep_id, *texts)
        query = self._of_runs(sa.select(*columns), condition)
        if not superseded:
            query = query.where(run_overview.c.superseded == 0)
        found = [
            Run(id_, status, dict(zip(names, map(_text, levels), strict=True)), sweep)
            for id_, status, sweep, *levels in map(
                tuple, self.reader.select(query.order_by(RUN.c.id))
            )
        ]
        if not found:
            raise ConfigurationError(self.why_none(condition))
        return found

    def metrics(
        self,
        runs: Sequence[Run],
        names: Sequence[str],
        condition: Condition | None = None,
        only: Mapping[str, Sequence[str]] | None = None,
    ) -> list[Observation]:
        """The named metrics of the runs; `condition` is the one that found them.

        `only` are the levels wanted of stage, model and dof; none of one means all of them.
        """
        m = Metric.__table__.c
        query = sa.select(m.run_id, m.stage, m.model, m.dof, m.name, m.value, m.unit)
        query = query.where(m.name.in_(names), m.run_id.in_(self._ids(condition)))
        for column, levels in (only or {}).items():
            if levels:
                query = query.where(m[column].in_(levels))
        by_id = {run.id: run for run in runs}
        return [
            Observation(by_id[id_], *facts)
            for id_, *facts in map(tuple, self.reader.select(query.order_by(m.id)))
            if id_ in by_id
        ]

    def coefficients(
        self, runs: Sequence[Run], condition: Condition | None = None
    ) -> list[Observation]:
        """All coefficients of the runs, named by their terms."""
        c = Coefficient.__table__.c
        columns = (c.run_id, c.model, c.dof, c.term, c.value, c.unit, c.std_error, c.true_value)
        query = sa.select(*columns).where(c.run_id.in_(self._ids(condition))).order_by(c.id)
        by_id = {run.id: run for run in runs}
        return [
            Observation(by_id[id_], COEFFICIENT_STAGE, *facts)
            for id_, *facts in map(tuple, self.reader.select(query))
            if id_ in by_id
        ]

    def diagnostics(
        self, runs: Sequence[Run], names: Sequence[str], condition: Condition | None = None
    ) -> dict[int, list[sa.Row[Any]]]:
        """Rows (run_id, name, dof, i, j, label, value, unit) of the named diagnostics, by run."""
        d = Diagnostic.__table__.c
        query = sa.select(d.run_id, d.name, d.dof, d.i, d.j, d.label, d.value, d.unit)
        query = query.where(d.name.in_(names), d.run_id.in_(self._ids(condition)))
        found: dict[int, list[sa.Row[Any]]] = {run.id: [] for run in runs}
        for row in self.reader.select(query.order_by(d.id)):
            if row.run_id in found:
                found[row.run_id].append(row)
        return found

    def warnings(self, condition: Condition | None = None) -> list[tuple[str, list[int]]]:
        """What runs warned of, with the runs that did, the first first."""
        d = Diagnostic.__table__.c
        query = sa.select(d.label, d.run_id).where(d.name == "warning")
        query = query.where(d.run_id.in_(self._ids(condition))).order_by(d.run_id, d.id)
        found: dict[str, list[int]] = {}
        for text, run_id in map(tuple, self.reader.select(query)):
            if run_id not in found.setdefault(text, []):
                found[text].append(run_id)
        return list(found.items())

    def series_columns(self, condition: Condition | None = None) -> dict[int, dict[str, list[str]]]:
        """The series that each run has, by kind, with the names of their columns."""
        s = Series.__table__.c
        found: dict[int, dict[str, list[str]]] = {}
        query = sa.select(s.run_id, s.kind, s.columns).where(s.run_id.in_(self._ids(condition)))
        for run_id, kind, columns in map(tuple, self.reader.select(query)):
            found.setdefault(run_id, {})[kind] = list(columns)
        return found

    def metric_names(self) -> list[str]:
        """Every metric that any run has."""
        name = Metric.__table__.c.name
        return [row.name for row in self.reader.select(sa.select(name).distinct().order_by(name))]

    def configs(self, ids: Sequence[int]) -> list[Mapping[str, Any]]:
        """Configurations of the given runs, with dotted names."""
        query = sa.select(RUN.c.config).where(RUN.c.id.in_(ids)).order_by(RUN.c.id)
        return [flat(row.config) for row in self.reader.select(query)]

    def of_sweep(self, sweep: int) -> list[int]:
        """Numbers of a sweep's runs: its own, and those it found done already."""
        own = sa.select(RUN.c.id).where(RUN.c.sweep_id == sweep)
        reused = sa.select(Reuse.run_id).where(Reuse.sweep_id == sweep)
        return sorted({row[0] for query in (own, reused) for row in self.reader.select(query)})

    def provenance(self, condition: Condition | None) -> Sequence[sa.Row[Any]]:
        """Rows (git_commit, git_dirty, host, versions, command) of the runs, newest first."""
        r = RUN.c
        query = sa.select(r.git_commit, r.git_dirty, r.host, r.versions, r.command)
        return self.reader.select(query.where(r.id.in_(self._ids(condition))).order_by(r.id.desc()))

    def _of_runs(self, query: sa.Select[Any], condition: Condition | None) -> sa.Select[Any]:
        joined = RUN.join(run_overview, run_overview.c.run_id == RUN.c.id)
        query = query.select_from(joined)
        return query if condition is None else query.where(self.names.clause(condition))

    def _ids(self, condition: Condition | None) -> sa.Select[Any]:
        return self._of_runs(sa.select(RUN.c.id), condition)

    def why_none(self, *filters: object) -> str:
        """Why a list of runs is empty, in one line."""
        ((total,),) = self.reader.select(sa.select(sa.func.count()).select_from(RUN))
        if not total:
            return f"{self.reader.address}: no runs in the logbook yet"
        narrowed = any(one is not None for one in filters)
        return f"no runs {'match' if narrowed else 'to show'}; the logbook has {total}"


def _text(value: Any) -> str:
    return "none" if value is None else str(value)
