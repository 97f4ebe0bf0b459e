"""The views of the logbook, for comparisons in one line of SQL.

The views are plain SQL, so the `sqlite3` and `psql` shells can read them. They hold no data, so
they are not part of the schema: a logbook with other views gets the current ones when it is next
opened for writing (`view_version` holds the digest of its views).
"""

from datetime import datetime
from functools import cache
from hashlib import sha256
from typing import get_args, get_type_hints

from sqlalchemy import Connection, Float, Integer, String, column, table

from seatrial.runner.database.claims import stale
from seatrial.runner.database.records import RunSummary
from seatrial.runner.database.tables import Utc
from seatrial.runner.record.catalogue import METRICS
from seatrial.runner.record.vocabulary import COMBINED, GROUPS, SAILED

# The columns of metric_wide; all other metrics are in the table metric only.
METRIC_NAMES = tuple(metric.name for metric in METRICS if metric.wide)


# Of a column in run_overview: its name, and stage, model, dof and name of the metric.
HEADLINES = tuple(
    (f"{metric.name}_{dof}{model}", metric.stages[0], model, metric.headline, metric.name)
    for metric in METRICS
    if metric.headline
    for dof in ["" if metric.headline in COMBINED else f"{metric.headline}_"]
    for model in SAILED
)
NAMES = ("run_overview", "metric_wide", "coefficient_error", "comparison", "view_version")
# A finished attempt supersedes one that did not finish; of equal attempts, the later one is valid.
_SUPERSEDED = """CASE WHEN EXISTS (
      SELECT 1 FROM run AS other
      WHERE other.fingerprint = run.fingerprint
        AND (CASE WHEN other.status = 'finished' THEN 1 ELSE 0 END, other.attempt)
          > (CASE WHEN run.status = 'finished' THEN 1 ELSE 0 END, run.attempt)
    ) THEN 1 ELSE 0 END"""
_OVERVIEW = """
CREATE VIEW run_overview AS
  SELECT run.id AS run_id, run.sweep_id, sweep.name AS sweep, run.attempt, {trial},
    run.started_at, run.finished_at, run.duration_s,
    (SELECT count(*) FROM metric WHERE metric.run_id = run.id) AS metrics,
    (SELECT count(*) FROM coefficient WHERE coefficient.run_id = run.id) AS coefficients,
    (SELECT count(*) FROM series WHERE series.run_id = run.id) AS series,
    {headlines},
    (SELECT max(value) FROM metric
      WHERE metric.run_id = run.id AND name = 'below_true_model') AS below_true_model,
    run.error_type, run.error, run.fingerprint
  FROM run LEFT JOIN sweep ON sweep.id = run.sweep_id"""
_HEADLINE = """(SELECT value FROM metric WHERE metric.run_id = run.id AND stage = '{1}'
      AND model = '{2}' AND dof = '{3}' AND name = '{4}') AS {0}"""
_WIDE = """
CREATE VIEW metric_wide AS
  WITH trial AS MATERIALIZED (
    SELECT run.id AS run_id, run.sweep_id, {trial} FROM run
  )
  SELECT trial.*, wide.stage, wide.model, wide.dof, {names}
  FROM (
    SELECT run_id, stage, model, dof,
      {columns}
    FROM metric GROUP BY run_id, stage, model, dof
  ) AS wide JOIN trial ON trial.run_id = wide.run_id"""
_ERROR = """
CREATE VIEW coefficient_error AS
  SELECT run.id AS run_id, run.sweep_id, {trial},
    coefficient.model, coefficient.dof, coefficient.term, coefficient.value,
    coefficient.std_error, coefficient.true_value,
    coefficient.value - coefficient.true_value AS error,
    abs(coefficient.value - coefficient.true_value) / nullif(abs(coefficient.true_value), 0)
      AS relative_error,
    coefficient.unit
  FROM coefficient JOIN run ON run.id = coefficient.run_id
  WHERE coefficient.true_value IS NOT NULL"""
# One row a metric and experiment, which is all that a trial computes from but its seed: options,
# files and code. A trial counts once, by its valid attempt, or as one that was planned and never
# started. Such a trial is of the experiment of those that its sweep planned with the same options
# but for the seed; where none of them has a run, it bears the least of their fingerprints. An
# experiment without a finished trial has a row for each metric of its vessel.
_COMPARISON = """
CREATE VIEW comparison AS
  WITH beside AS (
    SELECT planned.*, run.id, max(run.experiment) OVER same AS experiment,
      min(planned.fingerprint) OVER same AS least
    FROM planned LEFT JOIN run ON run.fingerprint = planned.fingerprint
    WINDOW same AS (PARTITION BY planned.sweep_id, CAST(planned.choices AS TEXT),
      replace(CAST(planned.overrides AS TEXT), '"seed=' || planned.seed || '"', ''))
  ), trial AS (
    SELECT id, status, {groups}, coalesce(experiment, fingerprint) AS experiment
    FROM run WHERE {superseded} = 0
    UNION ALL
    SELECT NULL, 'not started', {planned_groups}, coalesce(max(experiment), min(least))
    FROM beside WHERE id IS NULL GROUP BY fingerprint
  ), counted AS (
    SELECT *, count(*) OVER same AS trials,
      max(CASE WHEN status = 'finished' THEN 1 ELSE 0 END) OVER same AS finished
    FROM trial WINDOW same AS (PARTITION BY experiment)
  )
  SELECT {groups}, experiment, stage, model, dof, name,
    avg(value) AS mean, min(value) AS smallest, max(value) AS largest,
    unit, count(value) AS n, trials - count(value) AS without_value
  FROM counted JOIN metric ON metric.run_id = counted.id AND status = 'finished'
  GROUP BY {groups}, experiment, trials, stage, model, dof, name, unit
  UNION ALL
  SELECT {groups}, experiment, stage, model, dof, name, NULL, NULL, NULL, unit, 0, trials
  FROM (SELECT DISTINCT {groups}, experiment, trials FROM counted WHERE finished = 0) AS lost
    LEFT JOIN (SELECT DISTINCT vessel, stage, model, dof, name, unit
      FROM metric JOIN run ON run.id = metric.run_id) AS kind USING (vessel)"""
_TYPES = {bool: Integer, datetime: Utc, float: Float, int: Integer, str: String}
run_overview = table(
    "run_overview",
    *(
        column(name, _TYPES[(get_args(hint) or (hint,))[0]])
        for name, hint in get_type_hints(RunSummary).items()
    ),
    *(column(name, Float) for name, *_ in HEADLINES),
)


@cache
def statements(dialect: str) -> tuple[str, ...]:
    """Return the CREATE VIEW statements for `sqlite` or `postgresql`."""
    lost = f"run.status = 'running' AND {stale(dialect).name}"
    status = f"CASE WHEN {lost} THEN 'interrupted' ELSE run.status END AS status"
    choices = (f"run.{name}" for name in (*GROUPS, "seed"))
    parts = {
        "trial": ",\n    ".join([status, f"{_SUPERSEDED} AS superseded", *choices]),
        "superseded": _SUPERSEDED,
        "groups": ", ".join(GROUPS),
        "planned_groups": ", ".join(f"min(choices ->> '{name}') AS {name}" for name in GROUPS),
    }
    headlines = ",\n    ".join(_HEADLINE.format(*headline) for headline in HEADLINES)
    columns = ",\n      ".join(
        f"max(CASE WHEN name = '{name}' THEN value END) AS {name}" for name in METRIC_NAMES
    )
    names = ", ".join(f"wide.{name}" for name in METRIC_NAMES)
    return (
        _OVERVIEW.format(headlines=headlines, **parts),
        _WIDE.format(columns=columns, names=names, **parts),
        _ERROR.format(**parts),
        _COMPARISON.format(**parts),
    )


def digest(dialect: str) -> str:
    """Return the digest that `view_version` holds for the current views."""
    return sha256("\n".join(statements(dialect)).encode()).hexdigest()[:16]


def renew(connection: Connection) -> None:
    """Replace the views by the current ones."""
    for name in NAMES:
        connection.exec_driver_sql(f"DROP VIEW IF EXISTS {name}")
    dialect = connection.dialect.name
    version = f"CREATE VIEW view_version AS SELECT '{digest(dialect)}' AS digest"
    for statement in (*statements(dialect), version):
        connection.exec_driver_sql(statement)
