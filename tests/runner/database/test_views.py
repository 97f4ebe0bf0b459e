"""The views answer in one line of plain SQL, on both dialects."""

from dataclasses import replace

import pytest

from seatrial.runner.database import LogbookWriter
from seatrial.runner.database.views import HEADLINES, METRIC_NAMES, run_overview
from seatrial.runner.record.rows import Coefficient, Metric, Results
from tests.runner.compare.stored import planned
from tests.runner.database.samples import make_results, make_start


@pytest.fixture
def filled(logbook: LogbookWriter) -> LogbookWriter:
    """ls and plsr, three seeds each; one run failed, one found below the true model."""
    for trial in range(6):
        start = make_start(trial, identifier="ls" if trial < 3 else "plsr", seed=trial % 3)
        run = logbook.begin_run(start).run_id
        if trial == 5:
            logbook.fail_run(run, "failed", "ValueError", "no data", None)
            continue
        flag = Metric("validation", "identified", "surge", "below_true_model", trial == 4, "1")
        position = Metric("deployment", "identified", "position", "e_pos_mae", 0.5, "m")
        results = make_results(1.0 + trial)
        logbook.finish_run(run, replace(results, metrics=[*results.metrics, flag, position]))
    return logbook


def test_the_overview_has_a_row_for_every_run(filled: LogbookWriter) -> None:
    answer = filled.sql("SELECT * FROM run_overview ORDER BY run_id")
    assert set(answer.columns) == set(run_overview.c.keys())
    rows = [dict(zip(answer.columns, row, strict=True)) for row in answer.rows]
    assert [row["status"] for row in rows] == ["finished"] * 5 + ["failed"]
    assert [row["below_true_model"] for row in rows] == [0, 0, 0, 0, 1, None]
    assert [row["e_pos_mae_identified"] for row in rows] == [0.5] * 5 + [None]
    assert [row["force_mse_surge_identified"] for row in rows] == [1, 2, 3, 4, 5, None]
    assert rows[0]["e_pos_mae_nominal"] is None
    assert {row["superseded"] for row in rows} == {0}


def test_metrics_stand_side_by_side(filled: LogbookWriter) -> None:
    answer = filled.sql(
        "SELECT identifier, count(*), avg(force_mse), avg(iaew) FROM metric_wide"
        " WHERE stage = 'validation' AND model = 'identified' AND dof = 'surge'"
        " GROUP BY identifier ORDER BY identifier"
    )
    assert answer.rows == [("ls", 3, 2.0, 8.0), ("plsr", 2, 4.5, 18.0)]
    names = filled.sql("SELECT * FROM metric_wide WHERE run_id = 1").columns
    assert set(METRIC_NAMES) <= set(names)


def test_coefficient_errors_keep_terms_whose_truth_is_zero(logbook: LogbookWriter) -> None:
    run = logbook.begin_run(make_start()).run_id
    rows = [
        Coefficient("identified", "surge", "u", 9.0, 0.1, -10.0, "kg/s"),
        Coefficient("identified", "surge", "v", 9.0, None, 0.0, "kg/s"),
        Coefficient("identified", "surge", "r", 9.0, None, None, "kg/s"),
        Coefficient("identified", "surge", "u_dot", float("nan"), None, 4.0, "kg"),
    ]
    logbook.fail_run(run, "diverged", "Diverged", "no", None, Results(coefficients=rows))
    answer = logbook.sql(
        "SELECT status, term, error, relative_error FROM coefficient_error ORDER BY term"
    )
    assert answer.rows == [
        ("diverged", "u", 19.0, 1.9),
        ("diverged", "u_dot", None, None),
        ("diverged", "v", 9.0, None),
    ]


def test_the_comparison_keeps_conditions_apart_and_counts_what_is_lost(
    logbook: LogbookWriter,
) -> None:
    """Another option or code is another experiment; only seeds are averaged, attempts once."""

    def store(trial: int, experiment: str, value: float | None, **changes: object) -> None:
        start = make_start(trial, experiment=experiment, **changes)
        run = logbook.begin_run(start, rerun=True).run_id
        row = Metric("deployment", "identified", "position", "e_pos_mae", value, "m")
        logbook.finish_run(run, Results(metrics=[row]))

    store(1, "pid", 9.0)  # an earlier attempt
    for seed, value in ((1, 0.25), (2, 0.75), (3, None)):
        store(seed, "pid", value)
    start = make_start(4, experiment="pid")
    logbook.fail_run(logbook.begin_run(start).run_id, "failed", "ValueError", "no", None)
    store(5, "other gain", 2.0)
    store(6, "lqi", 4.0, controller="lqi")
    answer = logbook.sql(
        "SELECT controller, experiment, mean, smallest, largest, n, without_value"
        " FROM comparison WHERE name = 'e_pos_mae' ORDER BY mean"
    )
    assert answer.rows == [
        ("pid", "pid", 0.5, 0.25, 0.75, 2, 2),
        ("pid", "other gain", 2.0, 2.0, 2.0, 1, 0),
        ("lqi", "lqi", 4.0, 4.0, 4.0, 1, 0),
    ]


def test_the_comparison_counts_trials_that_never_started(logbook: LogbookWriter) -> None:
    """A planned trial is of the experiment of those planned with it, but for the seed."""
    begins = [
        make_start(10 * k + seed, experiment=experiment, identifier=name, seed=seed, vessel=vessel,
                   overrides=[f"identifier={name}", "identifier.seed=0", f"seed={seed}"])
        for k, (experiment, name, vessel) in enumerate((
            ("least squares", "ls", "milliampere"), ("partial", "plsr", "milliampere"),
            ("instruments", "iv", "milliampere"), ("other vessel", "ls", "tug"),
        ))
        for seed in range(6)
    ]  # fmt: skip
    rows = planned(begins)
    first = logbook.begin_sweep("first", "command", [], 2, trials=rows[1:3])
    sweep = logbook.begin_sweep("all", "command", [], len(rows), trials=rows)
    metric = Metric("deployment", "identified", "position", "e_pos_mae", 1.0, "m")
    for begin in begins[:2]:  # seeds 0 and 1 of ls; one that both sweeps have planned counts once
        logbook.finish_run(logbook.begin_run(begin, first).run_id, Results(metrics=[metric]))
    for begin in begins[6:9]:  # three of plsr have failed, none of iv and of the tug has a run
        run = logbook.begin_run(begin, sweep).run_id
        logbook.fail_run(run, "failed", "ValueError", "no", None)
    answer = logbook.sql(
        "SELECT vessel, identifier, experiment, name, mean, n, without_value FROM comparison"
        " ORDER BY vessel, identifier"
    )
    assert answer.rows == [
        ("milliampere", "iv", begins[12].fingerprint, "e_pos_mae", None, 0, 6),
        ("milliampere", "ls", "least squares", "e_pos_mae", 1.0, 2, 4),
        ("milliampere", "plsr", "partial", "e_pos_mae", None, 0, 6),
        ("tug", "ls", begins[18].fingerprint, None, None, 0, 6),
    ]


def test_headline_names_are_those_of_metrics() -> None:
    assert {headline[4] for headline in HEADLINES} <= set(METRIC_NAMES)
