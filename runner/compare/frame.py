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

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import sqlalchemy as sa
from numpy.typing import NDArray

from seatrial.models.diagnostics import INTERVAL_OF_ESTIMATE
from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare import where as language
from seatrial.runner.compare.where import EVERY_RUN, Condition
from seatrial.runner.configuration.invocation import meant
from seatrial.runner.database import tables
from seatrial.runner.database.engine import url_of
from seatrial.runner.database.reader import LogbookReader
from seatrial.runner.database.views import run_overview
from seatrial.runner.record.catalogue import HORIZONS
from seatrial.runner.record.vocabulary import GROUPS, NOT_STARTED, OF_FILE, STATUSES

# A *factor* groups runs into rows, columns or facets: a column of table `run`, a dotted key of the
# configuration, or a property of the number itself (metric, stage, model, dof).
METRIC_FACTORS = ("metric", "stage", "model", "dof", "file")  # of the number, not of its run
POOLED = "pooled"  # the file of a number that is of all files
BELOW_TRUE_MODEL = "below_true_model"
DESIGN_FLAWS = ("spectral_radius", "infeasible_limits")  # of a controller, if 1 or more
LIMITED = {horizon: f"limited_share_{horizon}" for horizon in HORIZONS}  # above 0: it diverged
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

    def place(level: str) -> tuple[int, float, str]:
        try:
            return 0, float(level), level
        except ValueError:
            return (1 if level in ("none", "calm", "nominal") else 2), 0.0, level

    return sorted(set(levels), key=place)


RUN = tables.RunRow.__table__
Clause = sa.ColumnElement[bool]
NO_FACTORS = ("config", "overrides", "versions", "traceback")
COLUMNS = {column.name: column for column in RUN.c if column.name not in NO_FACTORS}
COLUMNS |= {"status": run_overview.c.status, "sweep": run_overview.c.sweep}
OVERVIEW = RUN.join(run_overview, run_overview.c.run_id == RUN.c.id)
LABELS = (*GROUPS, "seed")
NO_LEVELS = ("of_sweep", "of_experiment", "streams", "of_code")  # columns of trials, no factors
METRIC = ("stage", "model", "dof", "name", "value", "unit")
TEXTS = ("stage", "model", "dof", "name", "term", "unit")
COEFFICIENT_STAGE = "coefficient"


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
    def keys(self) -> frozenset[str]:
        """The dotted keys of the configuration of at least one run."""
        newest = sa.select(sa.func.max(RUN.c.id)).group_by(*(RUN.c[name] for name in GROUPS))
        rows = self.reader.select(sa.select(RUN.c.config).where(RUN.c.id.in_(newest)))
        return frozenset(k for row in rows for k in flat(row.config) if language.NAME.fullmatch(k))

    def check(self, name: str, option: str) -> None:
        """Raise ConfigurationError for an unknown factor; the message lists similar names.

        `option` is the command-line option that the message begins with.
        """
        if name not in COLUMNS and name not in self.keys:
            expected = meant(name, sorted({*COLUMNS, *self.keys}), 3) or (
                f"expected one of {', '.join(COLUMNS)} or a dotted name of the configuration"
            )
            raise ConfigurationError(f"{option}: {name!r} is not known; {expected.rstrip()}")

    def where(self, text: str | None) -> Condition:
        """Return the condition of --where.

        Raises ConfigurationError for a text that is no condition, and for an unknown name.
        """
        if not text:
            return EVERY_RUN
        named = language.compared(text)
        for name, values in named.items():
            self.check(name, "--where")
            for value in values:
                if expected := language.expected_of(COLUMNS.get(name), value):
                    told = f"{name} is compared with {expected}, got {value!r}"
                    raise ConfigurationError(f"--where: {told}")
        query = sa.select(RUN.c.id, *map(level_of, named)).select_from(OVERVIEW)
        levels = _table(self.reader.select(query), ["", *named]).infer_objects()
        return Condition(text, runs=tuple(levels.loc[language.met(text, levels), ""]))

    def selected(self, where: str | None, sweep: str | None) -> tuple[Condition, str]:
        """Return the condition of --where and --sweep, and the words for the sweeps.

        `sweep` is a number, a name, a tag or `all`; with None it is the newest sweep. Raises
        ConfigurationError for an unknown one. A logbook without sweeps, and a condition on a run or
        a sweep, select from all runs.
        """
        condition, sweeps = self.where(where), self.reader.sweeps()
        names = {one.id: (one.name, *(one.tags or ())) for one in sweeps}
        chosen = [one for one in sweeps if sweep in (str(one.id), *names[one.id])]
        if sweep == "all" or (sweep is None and chooses(condition)):
            chosen = []
        elif sweep is None:
            chosen = sweeps[-1:]
        elif not chosen:
            known = dict.fromkeys(name for own in [*names.values()][-8:] for name in own)
            raise ConfigurationError(
                f"--sweep: got {sweep!r}, expected all, a number or one of"
                f" {', '.join(known) or 'none yet'}"
            )
        condition = replace(condition, sweeps=tuple(one.id for one in chosen))
        words = ", ".join(f"{one.id} ({one.name})" for one in chosen)
        return condition, f"sweep {words}" if chosen else ""

    def left_out(self, where: str | None, sweep: str | None) -> Iterator[str]:
        """Yield one line if single runs are newer than the sweep that is shown by default."""
        sweeps = self.reader.sweeps()
        if sweeps and not sweep and not chooses(self.where(where)):
            later = sa.select(sa.func.count()).select_from(RUN)
            later = later.where(RUN.c.sweep_id.is_(None), RUN.c.started_at > sweeps[-1].started_at)
            ((count,),) = self.reader.select(later)
            if count:
                runs = "run is" if count == 1 else "runs are"
                yield f"{count} newer {runs} of no sweep and left out: --sweep all"

    def trials(
        self, condition: Condition = EVERY_RUN, factors: Sequence[str] = (),
        superseded: bool = False, planned: bool = False,
    ) -> pd.DataFrame:  # fmt: skip
        """Return the trials that meet the condition, oldest first; see the head of this module.

        Without `superseded` there is one attempt for each trial; `planned` adds those that never
        started, with negative numbers. Raises ConfigurationError if no run matches.
        """
        names = list(dict.fromkeys((*LABELS, *factors)))
        own = (RUN.c.id, run_overview.c.status, RUN.c.sweep_id, RUN.c.experiment, RUN.c.drawn)
        query = sa.select(*own, RUN.c.code, *map(level_of, names)).select_from(OVERVIEW)
        query = query.where(*self.clauses(condition))
        if not superseded:
            query = query.where(run_overview.c.superseded == 0)
        rows = self.reader.select(query.order_by(RUN.c.id))
        if not rows:
            raise ConfigurationError(self.why_none(condition))
        columns = ["run", "status", *NO_LEVELS, *names]
        trials = _table(rows, columns).astype({"run": "int64"}).set_index("run")
        trials["streams"] = trials["streams"].map(" ".join, na_action="ignore")
        trials[names] = trials[names].map(language.as_text, na_action="ignore").fillna("none")
        if planned:
            trials = pd.concat([trials, self._not_started(condition, trials[names])])
        return trials.astype({name: "category" for name in trials if name != "of_sweep"})

    def runs(
        self, condition: Condition = EVERY_RUN, factors: Sequence[str] = ()
    ) -> list[StoredRun]:
        """Return the trials as objects, for figures of single runs."""
        return stored_runs(self.trials(condition, factors))

    def _not_started(self, condition: Condition, levels: pd.DataFrame) -> pd.DataFrame:
        """Return the planned trials that meet the condition and have no run.

        A level that is not an option of the trial is that of all runs, whose `levels` are given, if
        they have one in common, else unknown; a trial whose level in the condition is not known is
        left out.
        """
        p = tables.PlannedRow.__table__.c
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
        if not known or (condition.runs is not None and condition.text is None):
            return levels[:0]
        planned = pd.DataFrame([*known.values()], dtype=object)
        if condition.text is not None:
            told = planned.reindex(columns=[*language.compared(condition.text)])
            planned = planned[language.met(condition.text, told) & told.notna().all(axis=1)]
        common = {n: own.iloc[0] if own.nunique() == 1 else "unknown" for n, own in levels.items()}
        planned = planned.reindex(columns=["of_sweep", "status", *levels]).fillna(common)
        return planned.set_index(pd.Index(-1 - np.arange(len(planned)), name="run"))

    def _rows(
        self, table: type[tables.Base], columns: Sequence[str], condition: Condition, *where: Clause
    ) -> pd.DataFrame:
        """Return columns of the rows of a table that belong to the runs of a condition."""
        c = table.__table__.c
        query = sa.select(c.run_id, *(c[name] for name in columns)).order_by(c.id)
        query = query.where(c.run_id.in_(self._ids(condition)), *where)
        texts = TEXTS if table in (tables.MetricRow, tables.CoefficientRow) else ()
        return _table(self.reader.select(query), ["run", *columns], texts)

    def metrics(
        self, names: Sequence[str], condition: Condition = EVERY_RUN,
        only: Mapping[str, Sequence[str]] | None = None,
    ) -> pd.DataFrame:  # fmt: skip
        """Return the named metrics of the runs that meet the condition.

        `only` restricts stage, model and dof to the given levels; an empty list means all levels.
        """
        m = tables.MetricRow.__table__.c
        levels = [m[column].in_(own) for column, own in (only or {}).items() if own]
        return as_numbers(
            self._rows(tables.MetricRow, METRIC, condition, m.name.in_(names), *levels)
        )

    def of_files(self, names: Sequence[str], condition: Condition = EVERY_RUN) -> pd.DataFrame:
        """Return the named errors of the runs on each file that was tested on.

        They are diagnostics, since a file is no part of the name of a metric.
        """
        rows = self.diagnostics([f"{OF_FILE}{name}" for name in names], condition)
        rows["name"] = rows["name"].str.removeprefix(OF_FILE)
        parts = rows["label"].str.extract(r"(.*), (.*?)(?: model)?$")
        rows = rows.assign(file=parts[0], model=parts[1])
        return as_numbers(rows.drop(columns=["i", "j", "label"]).assign(stage="validation"))

    def coefficients(self, condition: Condition = EVERY_RUN) -> pd.DataFrame:
        """Return the coefficients of the runs that meet the condition."""
        columns = ("model", "dof", "term", "value", "unit", "std_error", "true_value")
        return as_numbers(self._rows(tables.CoefficientRow, columns, condition))

    def marks(self, condition: Condition = EVERY_RUN) -> pd.DataFrame:
        """Return the metrics that qualify other numbers, where they do.

        Those of LIMITED and BELOW_TRUE_MODEL if they are positive, those of DESIGN_FLAWS from 1.
        """
        value, name = tables.MetricRow.value, tables.MetricRow.name
        told = sa.or_(value >= 1.0, name.not_in(DESIGN_FLAWS) & (value > 0))
        names = name.in_((BELOW_TRUE_MODEL, *LIMITED.values(), *DESIGN_FLAWS))
        return as_numbers(self._rows(tables.MetricRow, METRIC, condition, names, told))

    def diagnostics(self, names: Sequence[str], condition: Condition = EVERY_RUN) -> pd.DataFrame:
        """Return the named diagnostics: run, name, dof, i, j, label, value (NaN), unit."""
        columns = ("name", "dof", "i", "j", "label", "value", "unit")
        rows = self._rows(
            tables.DiagnosticRow, columns, condition, tables.DiagnosticRow.name.in_(names)
        )
        return rows.astype({"run": "int64", "i": "Int64", "j": "Int64", "value": "float64"})

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
        by_run: dict[int, dict[str, list[str]]] = defaultdict(dict)
        for row in self._rows(tables.SeriesRow, ("kind", "columns"), condition).itertuples():
            by_run[row.run][row.kind] = [*row.columns]
        return by_run

    def metric_names(self) -> list[str]:
        """Return the names of all stored metrics."""
        name = tables.MetricRow.__table__.c.name
        return [row.name for row in self.reader.select(sa.select(name).distinct().order_by(name))]

    def configs_of(self, ids: Sequence[int]) -> dict[int, Mapping[str, object]]:
        """Return the configurations of the given runs by run number, with dotted names."""
        query = sa.select(RUN.c.id, RUN.c.config).where(_one_of(ids)).order_by(RUN.c.id)
        return {row.id: flat(row.config) for row in self.reader.select(query)}

    def provenance(self, condition: Condition) -> Sequence[sa.Row[*tuple[object, ...]]]:
        """Return rows (git_commit, git_dirty, host, versions, command), newest run first."""
        r = RUN.c
        query = sa.select(r.git_commit, r.git_dirty, r.host, r.versions, r.command)
        return self.reader.select(query.where(r.id.in_(self._ids(condition))).order_by(r.id.desc()))

    def clauses(self, condition: Condition, own_attempts: bool = False) -> list[Clause]:
        """Return the SQL of a condition: all clauses must hold.

        Of sweeps it holds for every attempt at their trials, since the valid one may be of another
        sweep; or only for the attempts that are their own, or that they reused.
        """
        clauses: list[Clause] = []
        if condition.sweeps:
            planned, reuse = tables.PlannedRow.__table__.c, tables.Reuse
            reused = sa.select(reuse.run_id).where(reuse.sweep_id.in_(condition.sweeps))
            own = RUN.c.sweep_id.in_(condition.sweeps) | RUN.c.id.in_(reused)
            plan = sa.select(planned.fingerprint).where(planned.sweep_id.in_(condition.sweeps))
            trials = plan.union(sa.select(RUN.c.fingerprint).where(own))
            clauses.append(own if own_attempts else RUN.c.fingerprint.in_(trials))
        if condition.runs is not None:
            clauses.append(_one_of(condition.runs))
        return clauses

    def _ids(self, condition: Condition) -> sa.Select[int]:
        return sa.select(RUN.c.id).where(*self.clauses(condition))

    def why_none(self, *filters: object) -> str:
        """Say in one line why a list of runs is empty."""
        ((total,),) = self.reader.select(sa.select(sa.func.count()).select_from(RUN))
        if not total:
            return f"{self.reader.address}: no runs in the logbook yet"
        narrowed = any(item not in (None, EVERY_RUN) for item in filters)
        return f"no runs {'match' if narrowed else 'to show'}; the logbook has {total}"


def _table(
    rows: Sequence[sa.Row[Any]], columns: Sequence[str], texts: Sequence[str] = ()
) -> pd.DataFrame:
    """Return rows as objects, `texts` as categories: 300,000 tuples of text take 50 MB."""
    kinds = {name: "category" if name in texts else object for name in columns}
    cells = {
        name: pd.Series([r[k] for r in rows], dtype=kinds[name]) for k, name in enumerate(columns)
    }
    return pd.DataFrame(cells)


def _one_of(runs: Iterable[int]) -> Clause:
    """Return the SQL of being one of these runs, however many they are: no variables."""
    listed: list[int] = [*map(int, runs)]
    return RUN.c.id.in_(
        sa.bindparam("run", listed, expanding=True, literal_execute=True, unique=True)
    )


def level_of(name: str) -> sa.ColumnElement[Any]:
    """Return the level of a factor; `where.as_text` gives it as it is shown."""
    if name in COLUMNS:
        return COLUMNS[name]
    level: sa.ColumnElement[Any] = RUN.c.config
    for key in name.split("."):
        level = level.op("->", return_type=sa.JSON())(sa.literal(key, sa.Text()))
    return level


def as_numbers(rows: pd.DataFrame) -> pd.DataFrame:
    """Return rows as numbers, their texts as categories; those of all files are POOLED."""
    frame = rows.rename(columns={"name": "metric", "term": "metric"})
    frame["file"] = frame.get("file", POOLED)
    frame["stage"] = frame.get("stage", COEFFICIENT_STAGE)
    kinds = dict.fromkeys(("value", "std_error", "true_value"), "float64") | {"run": "int64"}
    return frame.astype({name: kinds.get(name, "category") for name in frame})


def stored_runs(trials: pd.DataFrame) -> list[StoredRun]:
    """Return trials as objects."""
    levels = trials[[name for name in trials if name not in NO_LEVELS]].to_dict("records")
    sweeps = (None if pd.isna(sweep) else int(sweep) for sweep in trials["of_sweep"])
    each = zip(trials.index, trials["status"], levels, sweeps, strict=True)
    return [StoredRun(int(run), status, own, sweep) for run, status, own, sweep in each]


def observations(numbers: pd.DataFrame, trials: pd.DataFrame, marks: pd.DataFrame) -> pd.DataFrame:
    """Return the numbers of finished trials with the columns of their trials.

    `numbers` are `metrics`, `of_files` or `coefficients`, or several of them, and `marks` those of
    the same runs. The frame has `reason` (empty for a finite value) and the marks
    `below_true_model`, `unsettled` and `infeasible`.
    """
    finished = trials[trials["status"] == FINISHED]
    frame = numbers[numbers["run"].isin(finished.index)].join(finished, on="run")

    def marked(name: str, by: str) -> NDArray[np.bool_]:
        """Where the same run has a mark, of the same model or dof."""
        told = marks.loc[marks["metric"] == name, ["run", by]]
        if told.empty:
            return np.zeros(len(frame), dtype=np.bool_)
        own = pd.MultiIndex.from_frame(frame[["run", by]])
        return np.asarray(own.isin(pd.MultiIndex.from_frame(told)))

    deployed, metric = frame["stage"] == "deployment", frame["metric"].str
    for column, name in zip(("unsettled", "infeasible"), DESIGN_FLAWS, strict=True):
        frame[column] = deployed & marked(name, "model")
    validated = (frame["stage"] == "validation") & (frame["model"] == "identified")
    own = validated & metric.startswith("force_").astype(bool)
    frame[BELOW_TRUE_MODEL] = own & marked(BELOW_TRUE_MODEL, "dof")
    diverged = np.zeros(len(frame), dtype=np.bool_)
    for horizon, name in LIMITED.items():
        diverged |= metric.endswith(f"_{horizon}").to_numpy(dtype=bool) & marked(name, "model")
    reason = np.where(np.isfinite(frame["value"]), "", np.where(diverged, DIVERGED, WITHOUT))
    return frame.assign(reason=pd.Categorical(reason, dtype=REASONS))


def complete(frame: pd.DataFrame, trials: pd.DataFrame, factors: Sequence[str]) -> pd.DataFrame:
    """Add a row for every number that a trial lacks: why it has none is its status, or its method.

    A number of some finished trial is one that every trial with its levels of the `factors` may
    have; trials whose levels no number has may have all of them.
    """
    columns = list(METRIC_FACTORS)
    kind = codes(frame, columns)
    kinds = frame.loc[~kind.duplicated(), columns]
    kinds = kinds if len(kinds) else pd.DataFrame([dict.fromkeys(columns, "")])
    held = np.zeros((len(trials), len(kinds)), dtype=np.bool_)
    held[trials.index.get_indexer(frame["run"]), kind] = len(frame) > 0
    run, number = np.nonzero(~held)
    lacking = trials.reset_index(names="run").iloc[run].reset_index(drop=True)
    lacking[columns] = kinds.iloc[number].reset_index(drop=True)
    status = lacking["status"].astype(str)
    reason = pd.Categorical(np.where(status == FINISHED, NOT_APPLICABLE, status), dtype=REASONS)
    whole = pd.concat([frame, lacking.assign(reason=reason, condition=-1)], ignore_index=True)
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


def chooses(condition: Condition) -> bool:
    """Return whether a condition is about certain runs or sweeps."""
    return bool(
        condition.text and {"id", "sweep_id", "sweep"} & language.compared(condition.text).keys()
    )


def flat(config: Mapping[str, object], prefix: str = "") -> dict[str, object]:
    """Return a nested configuration as one level with dotted names.

    `prefix` stands before every name.
    """
    values: dict[str, object] = {}
    for key, value in config.items():
        name = f"{prefix}{key}"
        values |= flat(value, f"{name}.") if isinstance(value, Mapping) else {name: value}
    return values
