"""The frame of observations: the runs of a logbook and their numbers, as pandas reads them.

All queries of tables and figures are here. SQL selects and names; what comes back is

- the *trials* (`Queries.trials`): one row a trial, indexed by its run, with status, `of_sweep`,
  `of_experiment`, `of_code`, the drawn `streams`, and a column of text for every choice, the seed,
  and every factor that was asked for. A repeated trial counts once, by its latest finished attempt
  or, without one, by its latest attempt; `superseded` in the database marks the other attempts;
- their *numbers* (`metrics`, `coefficients`, `of_files`): run, stage, model, dof, metric (of a
  coefficient its term), file, value, unit, and of coefficients std_error and true_value;
- the *frame* (`observations`): the numbers of finished runs beside the columns of their trials,
  with the `reason` why a row has no value, and the marks of the run that the number is of.
  `complete` adds a row for every number that a trial lacks.

Columns of text are categorical, so that a row of 100,000 runs takes a byte and not a string.
"""

import json
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import numpy as np
import pandas as pd
import sqlalchemy as sa
from numpy.typing import NDArray

from seatrial.models.diagnostics import INTERVAL_OF_ESTIMATE
from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.where import (
    EVERY_RUN,
    ColumnNames,
    Condition,
    Expression,
    Value,
    bare_value,
    holds,
    names_in,
    parse,
)
from seatrial.runner.database.engine import url_of
from seatrial.runner.database.reader import LogbookReader
from seatrial.runner.database.tables import (
    CoefficientRow,
    DiagnosticRow,
    MetricRow,
    PlannedRow,
    SeriesRow,
)
from seatrial.runner.database.tables import RunRow as RunTable
from seatrial.runner.database.views import run_overview
from seatrial.runner.record.catalogue import HORIZONS
from seatrial.runner.record.vocabulary import GROUPS, NOT_STARTED, OF_FILE, STATUSES

# A *factor* groups runs into rows, columns or facets: a column of table `run`, a dotted key of the
# configuration, or a property of the number itself (metric, stage, model, dof).
METRIC_FACTORS = ("metric", "stage", "model", "dof", "file")  # of the number, not of its run
POOLED = "pooled"  # the file of a number that is of all files
BELOW_TRUE_MODEL = "below_true_model"
DESIGN_FLAWS = ("spectral_radius", "infeasible_limits")  # of a controller, if 1 or more
LIMITED = tuple(f"limited_share_{horizon}" for horizon in HORIZONS)  # above 0: it diverged
HELD_FREE_RUN = "held_free_run"
FINISHED = "finished"
# Why a number of a finished run is missing; that of another run is missing by its status.
DIVERGED, WITHOUT = "diverged in prediction", "without value"
NOT_APPLICABLE = "not applicable"
REASONS = pd.CategoricalDtype(["", *STATUSES, NOT_STARTED, DIVERGED, WITHOUT, NOT_APPLICABLE])


@dataclass(frozen=True, slots=True)
class StoredRun:
    """A stored run; `levels` are its choices, its seed and the requested factors, as text."""

    id: int
    status: str  # running, finished, diverged, failed, interrupted or not started
    levels: Mapping[str, str] = field(repr=False)
    sweep: int | None = None


def ordered(levels: Iterable[str]) -> list[str]:
    """Return the distinct levels in order: numbers by size, then `none`, then text."""
    return sorted(set(levels), key=_reading_order)


def _reading_order(level: str) -> tuple[int, float, str]:
    try:
        return 0, float(level), level
    except ValueError:
        return (1 if level in ("none", "calm", "nominal") else 2), 0.0, level


RUN = RunTable.__table__
Query = TypeVar("Query", bound=sa.Select[*tuple[object, ...]])
LABELS = (*GROUPS, "seed")
NO_LEVELS = ("of_sweep", "of_experiment", "streams", "of_code")  # columns of trials, no factors
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
        return ColumnNames(columns, RUN.c.config, keys, self.reader.address.path is not None)

    def where(self, text: str | None) -> Condition:
        """Return the condition of --where.

        Raises ConfigurationError for a text that is no condition, and for an unknown name.
        """
        condition = Condition(text or None)
        self.names.clauses(condition)
        return condition

    def selected(self, where: str | None, sweep: str | None) -> tuple[Condition, str]:
        """Return the condition of --where and --sweep, and the words for the sweeps.

        `sweep` is a number, a name, a tag or `all`; with None it is the newest sweep. Raises
        ConfigurationError for an unknown one. A logbook without sweeps, and a condition on a run or
        a sweep, select from all runs.
        """
        condition = self.where(where)
        sweeps = self.reader.sweeps()
        if sweep is None:
            chosen = [] if chooses(condition) else sweeps[-1:]
        elif sweep == "all":
            chosen = []
        else:
            chosen = [one for one in sweeps if sweep in (str(one.id), one.name, *(one.tags or ()))]
            if not chosen:
                labels = (name for one in sweeps[-8:] for name in (one.name, *(one.tags or ())))
                expected = ", ".join(dict.fromkeys(labels)) or "none yet"
                raise ConfigurationError(
                    f"--sweep: got {sweep!r}, expected all, a number or one of {expected}"
                )
        condition = Condition(condition.text, tuple(one.id for one in chosen))
        names = {one.name for one in chosen}
        if len(names) < 2:  # sweep 1, 2 (name), or sweep 1 (name), 2 (other)
            numbers = ", ".join(str(one.id) for one in chosen)
            return condition, "".join(f"sweep {numbers} ({name})" for name in names)
        return condition, f"sweep {', '.join(f'{one.id} ({one.name})' for one in chosen)}"

    def left_out(self, where: str | None, sweep: str | None) -> str:
        """Return one line on single runs newer than the sweep that is shown by default."""
        sweeps = self.reader.sweeps()
        if not sweeps or sweep or chooses(self.where(where)):
            return ""
        later = sa.select(sa.func.count()).select_from(RUN)
        later = later.where(RUN.c.sweep_id.is_(None), RUN.c.started_at > sweeps[-1].started_at)
        ((count,),) = self.reader.select(later)
        runs = "1 newer run is" if count == 1 else f"{count} newer runs are"
        return f"{runs} of no sweep and left out: --sweep all" if count else ""

    def trials(
        self,
        condition: Condition = EVERY_RUN,
        factors: Sequence[str] = (),
        superseded: bool = False,
        planned: bool = False,
    ) -> pd.DataFrame:
        """Return the trials that meet the condition, oldest first; see the head of this module.

        Without `superseded` there is one attempt for each trial; `planned` adds those that never
        started, with negative numbers. Raises ConfigurationError if no run matches.
        """
        names = list(dict.fromkeys((*LABELS, *factors)))
        own = (RUN.c.id, run_overview.c.status, RUN.c.sweep_id, RUN.c.experiment, RUN.c.drawn)
        query = self._of_runs(sa.select(*own, RUN.c.code, *map(self.names.text, names)), condition)
        if not superseded:
            query = query.where(run_overview.c.superseded == 0)
        rows = self.reader.select(query.order_by(RUN.c.id))
        if not rows:
            raise ConfigurationError(self.why_none(condition))
        columns = ("run", "status", *NO_LEVELS)
        data = dict(zip((*columns, *names), map(list, zip(*rows, strict=True)), strict=True))
        data["streams"] = [None if each is None else " ".join(each) for each in data["streams"]]
        data |= {name: list(map(level_text, data[name])) for name in names}
        if planned:
            for row in self._not_started(condition, {name: data[name] for name in names}):
                for name, values in data.items():
                    values.append(row.get(name))
        trials = pd.DataFrame(data).set_index("run")
        return trials.astype({name: "category" for name in trials if name != "of_sweep"})

    def runs(
        self,
        condition: Condition = EVERY_RUN,
        factors: Sequence[str] = (),
        superseded: bool = False,
    ) -> list[StoredRun]:
        """Return the trials as objects, for figures of single runs."""
        return stored_runs(self.trials(condition, factors, superseded))

    def _not_started(
        self, condition: Condition, levels: Mapping[str, Sequence[str]]
    ) -> list[dict[str, object]]:
        """Return the planned trials that meet the condition and have no run.

        A level that is not an option of the trial is that of all runs, whose `levels` are given, if
        they have one in common, else unknown; a trial that may not meet the condition is left out.
        """
        p = PlannedRow.__table__.c
        started = sa.select(RUN.c.fingerprint).where(RUN.c.fingerprint == p.fingerprint).exists()
        query = sa.select(p.sweep_id, p.fingerprint, p.choices, p.seed, p.overrides)
        query = query.where(~started).order_by(p.sweep_id, p.fingerprint)
        if condition.sweeps:
            query = query.where(p.sweep_id.in_(condition.sweeps))
        known: dict[str, dict[str, object]] = {}  # by fingerprint
        for sweep, fingerprint, choices, seed, overrides in map(tuple, self.reader.select(query)):
            pairs = (text.lstrip("+").partition("=") for text in overrides)
            own = {key: value for key, _, value in pairs} | choices | {"seed": str(seed)}
            known[fingerprint] = own | {"of_sweep": sweep, "status": NOT_STARTED}
        if not known or condition.run is not None:
            return []
        options = pd.DataFrame(list(known.values()))
        met = _met(condition.text, options)
        common = {name: each[0] for name, each in levels.items() if len(set(each)) == 1}
        missing = {name: common.get(name, "unknown") for name in levels}
        return [
            missing | option | {"run": -1 - number}
            for number, option in enumerate(
                v for v, own in zip(known.values(), met, strict=True) if own
            )
        ]

    def metrics(
        self,
        names: Sequence[str],
        condition: Condition = EVERY_RUN,
        only: Mapping[str, Sequence[str]] | None = None,
        *where: sa.ColumnElement[bool],
    ) -> pd.DataFrame:
        """Return the named metrics of the runs that meet the condition.

        `only` restricts stage, model and dof to the given levels; an empty list means all levels.
        `where` are further clauses on the table of metrics.
        """
        m = MetricRow.__table__.c
        query = sa.select(m.run_id, m.stage, m.model, m.dof, m.name, m.value, m.unit)
        query = query.where(m.name.in_(names), m.run_id.in_(self._ids(condition)), *where)
        for column, levels in (only or {}).items():
            if levels:
                query = query.where(m[column].in_(levels))
        return _numbers(self.reader.select(query.order_by(m.id)), NUMBER)

    def of_files(self, names: Sequence[str], condition: Condition = EVERY_RUN) -> pd.DataFrame:
        """Return the named errors of the runs on each file that was tested on.

        They are diagnostics, since a file is no part of the name of a metric.
        """
        d = DiagnosticRow.__table__.c
        query = sa.select(d.run_id, d.label, d.dof, d.name, d.value, d.unit).order_by(d.id)
        query = query.where(d.name.in_([f"{OF_FILE}{name}" for name in names]))
        rows = []
        for run, label, dof, name, value, unit in map(
            tuple, self.reader.select(query.where(d.run_id.in_(self._ids(condition))))
        ):
            file, _, model = label.rpartition(", ")
            metric = name.removeprefix(OF_FILE)
            of_model = model.removesuffix(" model")
            rows.append((run, "validation", of_model, dof, metric, value, unit, file))
        return _numbers(rows, (*NUMBER, "file"))

    def coefficients(
        self, condition: Condition = EVERY_RUN, terms: Sequence[str] = ()
    ) -> pd.DataFrame:
        """Return the coefficients of the runs that meet the condition; all without `terms`."""
        c = CoefficientRow.__table__.c
        columns = (c.run_id, c.model, c.dof, c.term, c.value, c.unit, c.std_error, c.true_value)
        query = sa.select(*columns).where(c.run_id.in_(self._ids(condition))).order_by(c.id)
        if terms:
            query = query.where(c.term.in_(terms))
        columns_of = ("run", *NUMBER[2:], "std_error", "true_value")
        return _numbers(self.reader.select(query), columns_of)

    def marks(self, condition: Condition = EVERY_RUN) -> pd.DataFrame:
        """Return the metrics that qualify other numbers, where they do.

        Those of LIMITED and BELOW_TRUE_MODEL if they are positive, those of DESIGN_FLAWS from 1,
        and the times HELD_FREE_RUN [s].
        """
        value, name = MetricRow.value, MetricRow.name
        told = sa.or_(name == HELD_FREE_RUN, value >= 1.0, name.not_in(DESIGN_FLAWS) & (value > 0))
        names = (BELOW_TRUE_MODEL, *LIMITED, *DESIGN_FLAWS, HELD_FREE_RUN)
        return self.metrics(names, condition, None, told)

    def diagnostics(self, names: Sequence[str], condition: Condition = EVERY_RUN) -> pd.DataFrame:
        """Return the named diagnostics: run, name, dof, i, j, label, value (NaN), unit."""
        d = DiagnosticRow.__table__.c
        columns = (d.run_id.label("run"), d.name, d.dof, d.i, d.j, d.label, d.value, d.unit)
        query = sa.select(*columns).where(d.name.in_(names), d.run_id.in_(self._ids(condition)))
        rows = self.reader.select(query.order_by(d.id))
        frame = pd.DataFrame(list(map(tuple, rows)), columns=[column.name for column in columns])
        kinds = {"run": "int64", "i": "Int64", "j": "Int64", "value": "float64"}
        return frame.astype(kinds)

    def covering(self, condition: Condition = EVERY_RUN) -> frozenset[int]:
        """Return the runs whose standard errors are of the coefficient, not only of the estimate.

        Of runs of earlier versions, and of identifiers that do not say so, it is not known.
        """
        rows = self.diagnostics([INTERVAL_OF_ESTIMATE], condition)
        return frozenset(rows.loc[rows["value"] == 0.0, "run"])

    def warnings(self, condition: Condition = EVERY_RUN) -> list[tuple[str, list[int]]]:
        """Return each distinct warning with the numbers of its runs, oldest first."""
        rows = self.diagnostics(["warning"], condition).sort_values("run", kind="stable")
        runs_of = rows.groupby("label", sort=False)["run"].unique()
        return [(str(text), runs.tolist()) for text, runs in runs_of.items()]

    def series_columns(self, condition: Condition = EVERY_RUN) -> dict[int, dict[str, list[str]]]:
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

    def provenance(self, condition: Condition) -> Sequence[sa.Row[*tuple[object, ...]]]:
        """Return rows (git_commit, git_dirty, host, versions, command), newest run first."""
        r = RUN.c
        query = sa.select(r.git_commit, r.git_dirty, r.host, r.versions, r.command)
        return self.reader.select(query.where(r.id.in_(self._ids(condition))).order_by(r.id.desc()))

    def _of_runs(self, query: Query, condition: Condition) -> Query:
        joined = RUN.join(run_overview, run_overview.c.run_id == RUN.c.id)
        return query.select_from(joined).where(*self.names.clauses(condition))

    def _ids(self, condition: Condition) -> sa.Select[int]:
        return self._of_runs(sa.select(RUN.c.id), condition)

    def why_none(self, *filters: object) -> str:
        """Say in one line why a list of runs is empty."""
        ((total,),) = self.reader.select(sa.select(sa.func.count()).select_from(RUN))
        if not total:
            return f"{self.reader.address}: no runs in the logbook yet"
        narrowed = any(item not in (None, EVERY_RUN) for item in filters)
        return f"no runs {'match' if narrowed else 'to show'}; the logbook has {total}"


NUMBER = ("run", "stage", "model", "dof", "metric", "value", "unit")


def _numbers(rows: Sequence[Sequence[object]], columns: Sequence[str]) -> pd.DataFrame:
    """Return rows of these columns as numbers; those of all files are POOLED."""
    data = dict(zip(columns, map(list, zip(*rows, strict=True)), strict=True)) if rows else {}
    frame = pd.DataFrame({name: data.get(name, []) for name in columns})
    frame["file"] = frame.get("file", POOLED)
    frame["stage"] = frame.get("stage", COEFFICIENT_STAGE)
    floats = [name for name in ("value", "std_error", "true_value") if name in frame]
    texts = [name for name in frame if name not in ("run", *floats)]
    kinds = dict.fromkeys(floats, "float64") | dict.fromkeys(texts, "category") | {"run": "int64"}
    return frame.astype(kinds)


def stored_runs(trials: pd.DataFrame) -> list[StoredRun]:
    """Return trials as objects."""
    names = [name for name in trials if name not in NO_LEVELS]
    levels = trials[names].to_dict("records")
    sweeps = (
        None if sweep is None or sweep != sweep else int(sweep) for sweep in trials["of_sweep"]
    )
    return [
        StoredRun(int(run), status, own, sweep)
        for run, status, own, sweep in zip(
            trials.index, trials["status"], levels, sweeps, strict=True
        )
    ]


def observations(numbers: pd.DataFrame, trials: pd.DataFrame, marks: pd.DataFrame) -> pd.DataFrame:
    """Return the numbers of finished trials with the columns of their trials.

    Args:
        numbers: `metrics`, `of_files` or `coefficients`, or several of them.
        trials: the trials; numbers of other runs are left out.
        marks: those of the same runs.

    Returns:
        The frame, with `reason` (empty for a finite value), the time `held_s` [s] of a free run
        that diverged, and the marks `below_true_model`, `unstable` and `infeasible`.
    """
    finished = trials[trials["status"] == FINISHED]
    frame = numbers[numbers["run"].isin(finished.index)].join(finished, on="run")
    deployed = frame["stage"] == "deployment"
    for column, name in zip(("unstable", "infeasible"), DESIGN_FLAWS, strict=True):
        frame[column] = deployed & _marked(frame, marks[marks["metric"] == name], ["run", "model"])
    below = _marked(frame, marks[marks["metric"] == BELOW_TRUE_MODEL], ["run", "dof"])
    force = frame["metric"].map(lambda name: name.startswith("force_")).astype(bool)
    validated = (frame["stage"] == "validation") & (frame["model"] == "identified")
    frame[BELOW_TRUE_MODEL] = below & force & validated
    held = diverged_predictions(marks)
    frame["horizon"] = frame["metric"].map(horizon_of)
    place = ["run", "model", "horizon"]
    diverged = _marked(frame, held, place)
    reason = np.where(np.isfinite(frame["value"]), "", np.where(diverged, DIVERGED, WITHOUT))
    frame["reason"] = pd.Categorical(reason, dtype=REASONS)
    frame["held_s"] = math.nan
    if diverged.any():
        times = held.set_index(place)["held_s"]
        frame["held_s"] = times.reindex(pd.MultiIndex.from_frame(frame[place])).to_numpy()
    return frame.drop(columns="horizon")


def complete(frame: pd.DataFrame, trials: pd.DataFrame, factors: Sequence[str]) -> pd.DataFrame:
    """Add a row for every number that a trial lacks: why it has none is its status, or its method.

    A number of some finished trial is one that every trial with its levels of the `factors` may
    have; trials whose levels no number has may have all of them.
    """
    columns = list(METRIC_FACTORS)
    kinds = frame[columns].drop_duplicates()
    blank = pd.DataFrame([dict.fromkeys(columns, "")])
    parts = [frame]
    for kind in (kinds if len(kinds) else blank).itertuples(index=False):
        own = (frame[columns] == list(kind)).all(axis=1)
        lacking = trials[~trials.index.isin(frame.loc[own, "run"])].reset_index(names="run")
        for name, level in zip(columns, kind, strict=True):
            known = frame[name].cat.categories
            known = known if level in known else known.insert(0, level)
            lacking[name] = pd.Categorical([level] * len(lacking), categories=known)
        status = lacking["status"].astype(str)
        reason = np.where(status == FINISHED, NOT_APPLICABLE, status)
        lacking["reason"] = pd.Categorical(reason, dtype=REASONS)
        parts.append(lacking.assign(condition=-1))
    whole = pd.concat(parts, ignore_index=True)
    for name in frame.select_dtypes("bool"):
        whole[name] = whole[name].fillna(False).astype(bool)
    of_run = [name for name in factors if name not in METRIC_FACTORS]
    stored = ~whole["reason"].isin([*STATUSES, NOT_STARTED, NOT_APPLICABLE])
    cell, part = codes(whole, factors), codes(whole, of_run)
    return whole[stored.groupby(cell).transform("any") | ~stored.groupby(part).transform("any")]


def codes(frame: pd.DataFrame, columns: Sequence[str]) -> pd.Series:
    """Number the rows by their levels of some columns, in the order of appearance.

    A missing level is one of its own.
    """
    if not len(columns):
        return pd.Series(0, frame.index)
    groups = frame.groupby(list(columns), observed=True, dropna=False, sort=False)
    return pd.Series(pd.factorize(groups.ngroup())[0], frame.index)


def horizon_of(metric: str) -> str:
    """Return the horizon of the prediction that a metric is about; empty if of none."""
    return next((name for name in HORIZONS if metric.endswith(f"_{name}")), "")


def diverged_predictions(marks: pd.DataFrame) -> pd.DataFrame:
    """Return run, model and horizon of predictions that diverged, and the time `held_s` [s]."""
    places = marks.assign(horizon=marks["metric"].map(horizon_of).astype(str))
    columns = ["run", "model", "horizon"]
    diverged = places.loc[places["metric"].isin(LIMITED), columns].drop_duplicates()
    held = places.loc[places["metric"] == HELD_FREE_RUN, [*columns, "value"]]
    return diverged.merge(held.rename(columns={"value": "held_s"}), how="left", on=columns)


def _marked(frame: pd.DataFrame, marks: pd.DataFrame, columns: Sequence[str]) -> NDArray[np.bool_]:
    """Return where a frame has the levels of a mark in some columns, shape (n,)."""
    if marks.empty:
        return np.zeros(len(frame), dtype=np.bool_)
    places, marked = (pd.MultiIndex.from_frame(each[list(columns)]) for each in (frame, marks))
    return np.asarray(places.isin(marked))


def _met(text: str | None, options: pd.DataFrame) -> Sequence[bool]:
    """Return which trials meet a text of --where, by their options; one that may not does not."""

    def compare(name: str, operator: str, value: Value) -> pd.Series:
        own = options.get(name, pd.Series(None, options.index, dtype=object))
        known = own.map(
            lambda level: holds(bare_value(str(level)), operator, value), na_action="ignore"
        )
        return known.astype("boolean")

    if text is None:
        return [True] * len(options)
    return [*parse(text, compare).fillna(False)]


def chooses(condition: Condition) -> bool:
    """Return whether a condition is about certain runs or sweeps."""
    return bool(names_in(condition.text) & {"id", "sweep_id", "sweep"})


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


def flat(config: Mapping[str, object], prefix: str = "") -> dict[str, object]:
    """Return a nested configuration as one level with dotted names.

    `prefix` stands before every name.
    """
    values: dict[str, object] = {}
    for key, value in config.items():
        if isinstance(value, Mapping):
            values |= flat(value, f"{prefix}{key}.")
        else:
            values[f"{prefix}{key}"] = value
    return values
