"""Read-only queries of the results database: runs and their numbers.

All queries of tables and figures are here. A repeated trial counts once, by its latest finished
attempt or, without one, by its latest attempt; the column `superseded` marks the other attempts.
"""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import sqlalchemy as sa

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.factors import ColumnNames, Expression, flat
from seatrial.runner.compare.where import (
    Among,
    Comparison,
    Condition,
    Joined,
    Not,
    OfSweeps,
    meets,
    parse,
)
from seatrial.runner.database.engine import url_of
from seatrial.runner.database.reader import LogbookReader
from seatrial.runner.database.records import SweepSummary
from seatrial.runner.database.tables import (
    CoefficientRow,
    DiagnosticRow,
    MetricRow,
    PlannedRow,
    SeriesRow,
)
from seatrial.runner.database.tables import RunRow as RunTable
from seatrial.runner.database.views import run_overview
from seatrial.runner.record.vocabulary import FILE_FINDING, GROUPS, NOT_STARTED

# A *factor* groups runs into rows, columns or facets: a column of table `run`, a dotted key of the
# configuration, or a property of the number itself (metric, stage, model, dof).
OWN_FACTORS = ("metric", "stage", "model", "dof", "file")  # of the number, not of its run
POOLED = "pooled"  # the file of a number that is of all files
BELOW_TRUE_MODEL = "below_true_model"
INTERVAL_OF_ESTIMATE = "interval_of_estimate"  # a diagnostic; 0: intervals are of the coefficient
DESIGN_FLAWS = ("spectral_radius", "infeasible_limits")  # of a controller, if 1 or more
FINISHED = "finished"


@dataclass(frozen=True, slots=True)
class StoredRun:
    """A stored run; `levels` are its choices, its seed and the requested factors, as text."""

    id: int
    status: str  # running, finished, diverged, failed, interrupted or not started
    levels: Mapping[str, str] = field(repr=False)
    sweep: int | None = None
    experiment: str | None = None  # equal for runs that differ in nothing but the seed
    drawn: frozenset[str] | None = None  # random streams that its results depend on, if known
    code: str | None = None  # digest of the code that computed it


@dataclass(frozen=True, slots=True)
class Observation:
    """One number of a run: a metric, or a coefficient named by its term (stage `coefficient`)."""

    run: StoredRun
    stage: str
    model: str
    dof: str
    name: str
    value: float | None
    unit: str
    std_error: float | None = None
    true_value: float | None = None
    file: str = POOLED

    def level(self, factor: str) -> str:
        """Return the level of a factor, as text."""
        match factor:
            case "metric":
                return self.name
            case "stage":
                return self.stage
            case "model":
                return self.model
            case "dof":
                return self.dof
            case "file":
                return self.file
            case _:
                return self.run.levels[factor]


def ordered(levels: Iterable[str]) -> list[str]:
    """Return the distinct levels in order: numbers by size, then `none`, then text."""
    return sorted(set(levels), key=_reading_order)


def _reading_order(level: str) -> tuple[int, float, str]:
    try:
        return 0, float(level), level
    except ValueError:
        return (1 if level in ("none", "calm", "nominal") else 2), 0.0, level


RUN = RunTable.__table__
StoredDiagnostic = sa.Row[*tuple[object, ...]]
Query = TypeVar("Query", bound=sa.Select[*tuple[object, ...]])
LABELS = (*GROUPS, "seed")
COEFFICIENT_STAGE = "coefficient"
MOST_VARIABLES = 5_000  # in one statement


@contextmanager
def open_results(database: str, results_dir: Path | None = None) -> Iterator["Queries"]:
    """Open the logbook at a URL or file path for reading; raises LogbookError if there is none.

    `results_dir` is the folder of its series; the default is the folder of a SQLite file, else
    `results`.
    """
    with LogbookReader.read(url_of(database), results_dir=results_dir) as reader:
        yield Queries(reader)


class Queries:
    """The queries of tables and figures on one logbook."""

    def __init__(self, reader: LogbookReader) -> None:
        self.reader = reader

    @cached_property
    def names(self) -> ColumnNames:
        """The names that are valid in conditions, rows and columns."""
        newest = sa.select(sa.func.max(RUN.c.id)).group_by(*(RUN.c[name] for name in GROUPS))
        text = sa.cast(RUN.c.config, sa.Text).label("text")  # also of one that is damaged
        rows = self.reader.select(sa.select(text).where(RUN.c.id.in_(newest)))
        keys = {key for row in rows for key in _keys(row.text)}
        columns: dict[str, Expression] = {column.name: column for column in RUN.c}
        columns["status"] = run_overview.c.status
        columns["sweep"] = run_overview.c.sweep
        return ColumnNames(columns, RUN.c.config, keys, self.reader.address.sqlite)

    def where(self, text: str | None) -> Condition | None:
        """Parse the condition of --where and check its names.

        Raises ConfigurationError for a text that is no condition, and for an unknown name.
        """
        condition = parse(text) if text else None
        if condition is not None:
            self.names.clause(condition)
        return condition

    def selected(
        self, where: str | None, sweep: str | None, tag: str | None = None
    ) -> tuple[Condition | None, str]:
        """Return the condition of --where, --sweep and --tag, and the words for the sweeps.

        `sweep` is a number, a name, or `all`; with None it is every sweep with the tag, or the
        newest sweep. Raises ConfigurationError for an unknown sweep or tag. A logbook without
        sweeps, and a condition on a run or a sweep, select from all runs.
        """
        condition = self.where(where)
        sweeps = self.reader.sweeps()
        if sweep is None and tag is None:
            chosen = [] if chooses(condition) else sweeps[-1:]
        elif tag is None and sweep == "all":
            chosen = []
        else:
            chosen = _matching(sweeps, sweep, tag)
        if not chosen:
            return condition, ""
        own = OfSweeps(tuple(one.id for one in chosen))
        return own if condition is None else Joined("and", (condition, own)), _scope(chosen)

    def left_out(self, where: str | None, sweep: str | None, tag: str | None) -> str:
        """Return one line on single runs newer than the sweep that is shown by default."""
        sweeps = self.reader.sweeps()
        if not sweeps or sweep or tag or chooses(self.where(where)):
            return ""
        later = sa.select(sa.func.count()).select_from(RUN)
        later = later.where(RUN.c.sweep_id.is_(None), RUN.c.started_at > sweeps[-1].started_at)
        ((count,),) = self.reader.select(later)
        runs = "1 newer run is" if count == 1 else f"{count} newer runs are"
        return f"{runs} of no sweep and left out: --sweep all" if count else ""

    def runs(
        self,
        condition: Condition | None = None,
        factors: Sequence[str] = (),
        superseded: bool = False,
    ) -> list[StoredRun]:
        """Return the runs that meet the condition, oldest first, with their levels of the factors.

        Without `superseded` there is one attempt for each trial. Raises ConfigurationError if no
        run matches.
        """
        names = list(dict.fromkeys((*LABELS, *factors)))
        texts = [self.names.text(name) for name in names]
        columns = (
            *(
                RUN.c.id,
                run_overview.c.status,
                RUN.c.sweep_id,
                RUN.c.experiment,
                RUN.c.drawn,
                RUN.c.code,
            ),
            *texts,
        )
        query = self._of_runs(sa.select(*columns), condition)
        if not superseded:
            query = query.where(run_overview.c.superseded == 0)
        rows = [
            StoredRun(
                id_,
                status,
                dict(zip(names, map(level_text, levels), strict=True)),
                sweep,
                experiment,
                None if drawn is None else frozenset(drawn),
                code,
            )
            for id_, status, sweep, experiment, drawn, code, *levels in map(
                tuple, self.reader.select(query.order_by(RUN.c.id))
            )
        ]
        if not rows:
            raise ConfigurationError(self.why_none(condition))
        return rows

    def not_started(
        self, condition: Condition | None, factors: Sequence[str], runs: Sequence[StoredRun]
    ) -> list[StoredRun]:
        """Return the planned trials that meet the condition and have no run, with negative numbers.

        A level that is not an option of the trial is that of all `runs`, if they have one in
        common, else unknown; a trial that may not meet the condition is left out.
        """
        p = PlannedRow.__table__.c
        started = sa.select(RUN.c.fingerprint).where(RUN.c.fingerprint == p.fingerprint).exists()
        query = sa.select(p.sweep_id, p.fingerprint, p.choices, p.seed, p.overrides)
        names = dict.fromkeys((*LABELS, *factors))
        common = {name: {run.levels[name] for run in runs} for name in names}
        shared = {name: levels.pop() for name, levels in common.items() if len(levels) == 1}
        found: dict[str, StoredRun] = {}
        for sweep, fingerprint, choices, seed, overrides in map(
            tuple, self.reader.select(query.where(~started).order_by(p.sweep_id, p.fingerprint))
        ):
            pairs = (text.lstrip("+").partition("=") for text in overrides)
            own = {key: value for key, _, value in pairs} | choices | {"seed": str(seed)}
            if condition is not None and meets(condition, own.get, sweep) is not True:
                continue
            levels = {name: own.get(name, shared.get(name, "unknown")) for name in names}
            found[fingerprint] = StoredRun(-1 - len(found), NOT_STARTED, levels, sweep)
        return list(found.values())

    def metrics(
        self,
        runs: Sequence[StoredRun],
        names: Sequence[str],
        condition: Condition | None = None,
        only: Mapping[str, Sequence[str]] | None = None,
    ) -> list[Observation]:
        """Return the named metrics of the runs; `condition` is the one that selected the runs.

        `only` restricts stage, model and dof to the given levels; an empty list means all levels.
        """
        m = MetricRow.__table__.c
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

    def of_files(
        self, runs: Sequence[StoredRun], names: Sequence[str], condition: Condition | None = None
    ) -> list[Observation]:
        """Return the named errors of the runs on each file that was tested on.

        `condition` is the one that selected the runs. They are diagnostics, since a file is no part
        of the name of a metric.
        """
        wanted = [f"{FILE_FINDING}{name}" for name in names]
        by_id = {run.id: run for run in runs}
        return [
            Observation(
                by_id[id_], "validation", model.removesuffix(" model"), row.dof,
                row.name.removeprefix(FILE_FINDING), row.value, row.unit, file=file,
            )
            for id_, rows in self.diagnostics(runs, wanted, condition).items()
            for row in rows
            for file, _, model in [row.label.rpartition(", ")]
        ]  # fmt: skip

    def coefficients(
        self,
        runs: Sequence[StoredRun],
        condition: Condition | None = None,
        terms: Sequence[str] = (),
    ) -> list[Observation]:
        """Return the coefficients of the runs, named by their terms; without `terms`, all of them.

        `condition` is the one that selected the runs.
        """
        c = CoefficientRow.__table__.c
        columns = (c.run_id, c.model, c.dof, c.term, c.value, c.unit, c.std_error, c.true_value)
        query = sa.select(*columns).where(c.run_id.in_(self._ids(condition))).order_by(c.id)
        if terms:
            query = query.where(c.term.in_(terms))
        by_id = {run.id: run for run in runs}
        return [
            Observation(by_id[id_], COEFFICIENT_STAGE, *facts)
            for id_, *facts in map(tuple, self.reader.select(query))
            if id_ in by_id
        ]

    def diagnostics(
        self, runs: Sequence[StoredRun], names: Sequence[str], condition: Condition | None = None
    ) -> dict[int, list[StoredDiagnostic]]:
        """Return rows (run_id, name, dof, i, j, label, value, unit) of diagnostics, by run.

        `names` are those of the diagnostics, `condition` is the one that selected the runs.
        """
        d = DiagnosticRow.__table__.c
        query = sa.select(d.run_id, d.name, d.dof, d.i, d.j, d.label, d.value, d.unit)
        query = query.where(d.name.in_(names), d.run_id.in_(self._ids(condition)))
        by_run: dict[int, list[StoredDiagnostic]] = {run.id: [] for run in runs}
        for row in self.reader.select(query.order_by(d.id)):
            if row.run_id in by_run:
                by_run[row.run_id].append(row)
        return by_run

    def covering(
        self, runs: Sequence[StoredRun], condition: Condition | None = None
    ) -> frozenset[int]:
        """Return the runs whose standard errors are of the coefficient, not only of the estimate.

        Of runs of earlier versions, and of identifiers that do not say so, it is not known.
        """
        rows = self.diagnostics(runs, [INTERVAL_OF_ESTIMATE], condition)
        return frozenset(id_ for id_, of_run in rows.items() for row in of_run if row.value == 0.0)

    def with_standard_errors(self, condition: Condition | None = None) -> frozenset[int]:
        """Return the runs that have a standard error of a coefficient."""
        c = CoefficientRow.__table__.c
        query = sa.select(c.run_id).where(c.std_error.is_not(None)).distinct()
        rows = self.reader.select(query.where(c.run_id.in_(self._ids(condition))))
        return frozenset(row.run_id for row in rows)

    def warnings(self, condition: Condition | None = None) -> list[tuple[str, list[int]]]:
        """Return each distinct warning with the numbers of its runs, oldest first."""
        d = DiagnosticRow.__table__.c
        query = sa.select(d.label, d.run_id).where(d.name == "warning")
        query = query.where(d.run_id.in_(self._ids(condition))).order_by(d.run_id, d.id)
        runs_of: dict[str, list[int]] = {}
        for text, run_id in map(tuple, self.reader.select(query)):
            if run_id not in runs_of.setdefault(text, []):
                runs_of[text].append(run_id)
        return list(runs_of.items())

    def series_columns(self, condition: Condition | None = None) -> dict[int, dict[str, list[str]]]:
        """Return the column names of the stored series by run and kind."""
        s = SeriesRow.__table__.c
        by_run: dict[int, dict[str, list[str]]] = {}
        query = sa.select(s.run_id, s.kind, s.columns).where(s.run_id.in_(self._ids(condition)))
        for run_id, kind, columns in map(tuple, self.reader.select(query)):
            by_run.setdefault(run_id, {})[kind] = list(columns)
        return by_run

    def metric_names(self) -> list[str]:
        """Return the names of all stored metrics."""
        name = MetricRow.__table__.c.name
        return [row.name for row in self.reader.select(sa.select(name).distinct().order_by(name))]

    def terms(self) -> list[str]:
        """Return the terms of all stored coefficients."""
        term = CoefficientRow.__table__.c.term
        return [row.term for row in self.reader.select(sa.select(term).distinct().order_by(term))]

    def configs_of(self, ids: Sequence[int]) -> dict[int, Mapping[str, object]]:
        """Return the configurations of the given runs by run number, with dotted names."""
        configs: dict[int, Mapping[str, object]] = {}
        for first in range(0, len(ids), MOST_VARIABLES):
            query = sa.select(RUN.c.id, RUN.c.config)
            query = query.where(RUN.c.id.in_(ids[first : first + MOST_VARIABLES])).order_by(
                RUN.c.id
            )
            configs |= {row.id: flat(row.config) for row in self.reader.select(query)}
        return configs

    def provenance(self, condition: Condition | None) -> Sequence[sa.Row[*tuple[object, ...]]]:
        """Return rows (git_commit, git_dirty, host, versions, command), newest run first."""
        r = RUN.c
        query = sa.select(r.git_commit, r.git_dirty, r.host, r.versions, r.command)
        return self.reader.select(query.where(r.id.in_(self._ids(condition))).order_by(r.id.desc()))

    def _of_runs(self, query: Query, condition: Condition | None) -> Query:
        joined = RUN.join(run_overview, run_overview.c.run_id == RUN.c.id)
        query = query.select_from(joined)
        return query if condition is None else query.where(self.names.clause(condition))

    def _ids(self, condition: Condition | None) -> sa.Select[int]:
        return self._of_runs(sa.select(RUN.c.id), condition)

    def why_none(self, *filters: object) -> str:
        """Say in one line why a list of runs is empty."""
        ((total,),) = self.reader.select(sa.select(sa.func.count()).select_from(RUN))
        if not total:
            return f"{self.reader.address}: no runs in the logbook yet"
        narrowed = any(item is not None for item in filters)
        return f"no runs {'match' if narrowed else 'to show'}; the logbook has {total}"


def _matching(sweeps: list[SweepSummary], sweep: str | None, tag: str | None) -> list[SweepSummary]:
    """Return the sweeps with this number or name and this tag.

    None and `all` are any sweep. Raises ConfigurationError if there is none.
    """
    if tag is not None:
        tags = dict.fromkeys(name for one in sweeps[::-1] for name in one.tags or ())
        if tag not in tags:
            expected = f"one of {', '.join([*tags][:8])}" if tags else "none: no sweep has tags"
            raise ConfigurationError(f"--tag: got {tag!r}, expected {expected}")
        sweeps = [one for one in sweeps if tag in (one.tags or ())]
    if sweep in (None, "all"):
        return sweeps
    chosen = [one for one in sweeps if sweep in (str(one.id), one.name)]
    if not chosen:
        expected = ", ".join(dict.fromkeys(one.name for one in sweeps[-8:])) or "none yet"
        having = "" if tag is None else f", with tag {tag}"
        raise ConfigurationError(
            f"--sweep: got {sweep!r}, expected all, a number or one of {expected}{having}"
        )
    return chosen


def _scope(sweeps: Sequence[SweepSummary]) -> str:
    """Return `sweep 1, 2 (name)`, or `sweep 1 (name), 2 (other)` for sweeps of several names."""
    names = {sweep.name for sweep in sweeps}
    if len(names) == 1:
        return f"sweep {', '.join(str(sweep.id) for sweep in sweeps)} ({names.pop()})"
    return f"sweep {', '.join(f'{sweep.id} ({sweep.name})' for sweep in sweeps)}"


def chooses(condition: Condition | None) -> bool:
    """Return whether a condition is about certain runs or sweeps."""
    match condition:
        case Comparison(name=name) | Among(name=name):
            return name in ("id", "sweep_id", "sweep")
        case Not(condition=inner):
            return chooses(inner)
        case Joined(conditions=parts):
            return any(map(chooses, parts))
        case _:
            return False


def _keys(config: str) -> list[str]:
    """Return the dotted keys of a configuration; none if it is damaged."""
    try:
        parsed = json.loads(config)
        return list(flat(parsed)) if isinstance(parsed, dict) else []
    except (ValueError, TypeError, RecursionError):
        return []


def level_text(value: object) -> str:
    """Return a level as tables show it."""
    return "none" if value is None else str(value)
