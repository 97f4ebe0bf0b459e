"""Tables against figures worked out by hand from the logbook that `conftest.plain` describes."""

import csv
import io
import json
import math
from collections.abc import Mapping
from typing import Any

import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.cli import TableOptions
from seatrial.runner.compare.frame import Queries
from seatrial.runner.compare.grid import OutputFormat, TextTable, render
from seatrial.runner.compare.table import comparison
from seatrial.runner.database import LogbookWriter
from seatrial.runner.record import catalogue
from seatrial.runner.record.catalogue import Definition
from seatrial.runner.record.rows import Metric
from tests.runner.compare import stored


def table(results: Queries, **options: object) -> TextTable:
    asked: Any = {"dof": ["surge"], **options}
    return comparison(results, TableOptions(**asked))


def cells(grid: TextTable) -> dict[tuple[str, ...], str]:
    """Text of every cell by its labels and header; a star for bold."""
    return {
        (*(label.text for label in row[: grid.labels]), header): cell.text + "*" * cell.bold
        for row in grid.rows
        for header, cell in zip(grid.headers[grid.labels :], row[grid.labels :], strict=True)
    }


def record_of(grid: TextTable, **levels: str) -> Mapping[str, object]:
    """The record of the one cell with these levels."""
    (found,) = [record for record in grid.as_records() if levels.items() <= record.items()]
    return found


def test_cells_are_those_worked_out_by_hand(results: Queries) -> None:
    """Mean, deviation and count; what was lost; what is below the true model is never best."""
    grid = table(results)
    assert cells(grid) == {
        ("none", "calm"): "102.0 ± 2.0 (n=3)",
        ("ls", "calm"): "52.00 ± 2.6 (n=3)*",  # deviations -2, -1, 3: sqrt(14 / 2)
        ("plsr", "calm"): "41.00 ± 1.0 † (n=3)",
        ("none", "noise"): "210.0 ± 10 (n=3)",  # alone without a lost run: compared with none
        ("ls", "noise"): "90.00 (n=1, 1 diverged, 1 failed)",
        ("plsr", "noise"): "80.00 (n=1, 1 without value)",
    }
    for said in ("1 diverged, 1 failed", "fits lag or feedback"):
        assert any(said in note for note in grid.notes)


def test_too_many_cells_are_refused_before_they_are_written(results: Queries) -> None:
    said = r"--rows, --columns: got 3 rows and 2 columns, expected at most 5 cells"
    with pytest.raises(ConfigurationError, match=said):
        table(results, cells=5)
    assert len(cells(table(results, cells=6))) == 6


def test_best_is_sought_among_rivals_under_equal_conditions(results: Queries) -> None:
    turned = cells(table(results, rows="disturbance", columns="identifier"))
    assert [key for key, text in turned.items() if text.endswith("*")] == [("calm", "ls")]
    apart = cells(table(results, rows="vessel,disturbance", columns="none", pool=["identifier"]))
    assert not any(text.endswith("*") for text in apart.values())


def test_a_row_of_failures_alone_is_still_a_row(results: Queries) -> None:
    grid = table(results, where="disturbance=noise and identifier=ls and seed>0")
    assert cells(grid) == {("ls", "noise"): "– (1 diverged, 1 failed)"}


def test_baseline_gives_ratio_wins_and_the_paired_test(results: Queries) -> None:
    grid = table(results, baseline=["identifier=none"])
    shown = cells(grid)
    assert shown["none", "calm"].endswith("\nbaseline")
    assert shown["ls", "calm"].endswith("\n× 0.510, 3 pairs, won 3/3*")  # 52 / 102
    assert "won 1/2" in shown["plsr", "noise"]  # the number that is missing is a lost pair
    record = record_of(grid, identifier="ls", disturbance="calm")
    assert record["ratio"] == pytest.approx(52.0 / 102.0)
    assert (record["wins"], record["pairs"]) == (3, 3)
    assert math.isnan(float(record["p_value"] or 0.0))  # three pairs are too few


def test_a_model_of_the_same_runs_can_be_the_baseline(results: Queries) -> None:
    grid = table(
        results, metric=["e_pos_mae"], dof=None, model=["identified"], columns="model",
        baseline=["model=nominal"], where="disturbance=calm",
    )  # fmt: skip
    shown = cells(grid)
    # none: 1.00, 1.02, 1.04 against 1.0: one tie and two losses
    assert shown["none", "identified"].startswith("1.020 ± 0.020 (n=3)")
    assert "won 0/3" in shown["none", "identified"]
    assert "× 0.520" in shown["ls", "identified"]
    assert ("ls", "nominal") not in shown


def test_statistics_and_intervals(results: Queries) -> None:
    grid = table(results, statistic=["median", "q25", "max", "ci"])
    record = grid.as_records()[0]
    assert (record["identifier"], record["median"], record["q25"]) == ("none", 102.0, 101.0)
    half = 4.302653 * 2.0 / math.sqrt(3.0)  # t(0.975, 2 degrees of freedom)
    assert record["ci_low"] == pytest.approx(102.0 - half, rel=1e-6)
    assert "median 102.0 q25 101.0 max 104.0 [97.03, 107.0]" in cells(grid)["none", "calm"]


def test_rows_and_columns_by_any_name(results: Queries) -> None:
    axes = {"rows": "vessel, identifier.force", "columns": "seed", "where": "identifier=ls"}
    grid = table(results, **axes, pool=["disturbance"])
    shown = cells(grid)
    assert list(grid.headers) == ["vessel", "identifier.force", "0", "1", "2"]
    assert shown["milliampere", "filtered", "0"].startswith("70.00 (n=1)")  # the mean of 50 and 90
    assert any("average over disturbance, as requested" in note for note in grid.notes)
    split = table(results, **axes)
    assert cells(split)["milliampere", "filtered", "calm", "0"].startswith("50.00 (n=1)")
    assert any("split by disturbance" in note for note in split.notes)
    pooled = table(results, columns="none", pool=["disturbance"])
    assert cells(pooled)["none", "value"].startswith("156.0")


def test_several_metrics_and_dofs_get_their_own_rows_and_units(results: Queries) -> None:
    grid = table(results, metric=["e_pos_mae", "force_mse"], dof=["all"], where="disturbance=calm")
    shown = cells(grid)
    assert grid.headers[:5] == ["metric", "stage", "dof", "identifier", "unit"]
    assert shown["force_mse", "validation", "yaw", "ls", "(Nm)²", "calm"].startswith("104.0")
    assert shown["e_pos_mae", "deployment", "position", "plsr", "m", "calm"].endswith("*")
    assert grid.rows[0][0].text == "e_pos_mae"  # in the order they were asked for


def test_coefficients_with_standard_errors_and_true_values(results: Queries) -> None:
    grid = table(results, coefficient=["u_dot", "u"], where="disturbance=calm")
    shown = cells(grid)
    # none is nearest to 1050 with 1102; ls with 1052 nearer still
    assert (
        shown["u_dot", "ls", "kg", "calm"] == "1052 ± 2.6 (n=3)\nse 3.0 of the estimate, true 1050*"
    )
    assert shown["u", "ls", "kg/s", "calm"] == "60.00 ± 0 (n=3, all equal)\nse 4.0 of the estimate"
    assert grid.headers[0] == "term"
    record = grid.as_records()[0]
    assert (record["term"], record["std_error"], record["true_value"]) == ("u_dot", 3.0, 1050.0)
    everything = table(results, coefficients=True, dof=None, where="disturbance=calm")
    assert list(everything.headers[:3]) == ["dof", "term", "identifier"]


def test_a_standard_error_is_of_the_estimate_unless_its_identifier_says_otherwise(
    logbook: LogbookWriter, results: Queries
) -> None:
    for identifier, seed, error, diagnostics in (
        ("iv", 0, 3.0, [stored.interval(False)]),
        ("iv", 1, 6.0, [stored.interval(False)]),
        ("ridge", 0, 3.0, [stored.interval(True)]),
        ("older", 0, 3.0, []),
        ("none", 0, None, []),
    ):
        found = [stored.coefficient("u_dot", 1000.0, error, 1050.0)]
        stored.finish(logbook, stored.start(identifier, seed=seed), (), found, diagnostics)
    grid = table(results, coefficient=["u_dot"])
    alone = table(results, coefficient=["u_dot"], where="identifier in (iv, none)")
    ends = {key[0]: text.partition("\n")[2] for key, text in cells(grid).items()}
    assert {name: text.rstrip("*") for name, text in ends.items()} == {
        "iv": "se 4.7, true 1050",  # root mean square of 3 and 6
        "ridge": "se 3.0 of the estimate, true 1050",
        "older": "se 3.0 of the estimate, true 1050",
        "none": "true 1050",
    }
    flags = {row["identifier"]: row["interval_of_estimate"] for row in grid.as_records()}
    assert flags == {"iv": False, "ridge": True, "older": True, "none": False}
    assert any("not of the coefficient" in note for note in grid.notes)
    assert not any("not of the coefficient" in note for note in alone.notes)


def test_rounding_errors_are_neither_spread_nor_victory(
    logbook: LogbookWriter, results: Queries
) -> None:
    for identifier, values in {"ls": (0.3, 0.1 + 0.2), "plsr": (0.3, 0.3)}.items():
        for seed, value in enumerate(values):
            begin = stored.start(identifier, seed=seed)
            stored.finish(logbook, begin, [stored.force_mse(value)])
    assert {*cells(table(results)).values()} == {"0.3000 ± 0 (n=2, all equal)*"}


def test_a_repeated_run_counts_once_by_its_latest_finish(
    logbook: LogbookWriter, results: Queries
) -> None:
    begin, mended = stored.start("ls"), stored.start("plsr")
    stored.finish(logbook, begin, [stored.force_mse(10.0)])
    stored.finish(logbook, begin, [stored.force_mse(20.0)], rerun=True)
    begun = logbook.begin_run(begin, rerun=True)
    logbook.fail_run(begun.run_id, "failed", "ValueError", "later failure", None)
    stored.fail(logbook, mended)
    stored.finish(logbook, mended, [stored.force_mse(30.0)])
    shown = cells(table(results))
    assert shown == {("ls", "calm"): "20.00 (n=1)*", ("plsr", "calm"): "30.00 (n=1)"}


REFUSED: tuple[tuple[dict[str, object], str], ...] = (
    ({"rows": "identifir"}, "'identifir' is not known; did you mean identifier"),
    ({"columns": "config"}, "'config' is not known"),
    ({"rows": "seed; drop table run"}, "is not known"),
    ({"metric": ["force_mae"]}, "no metric 'force_mae', did you mean force_mse? expected one of "),
    ({"coefficient": ["w"]}, "no coefficient 'w', expected one of u, u_dot"),
    ({"dof": ["heave"]}, "dof heave; expected one of surge, yaw"),
    ({"stage": ["deployment"]}, "stage deployment; expected one of validation"),
    ({"model": ["plant"]}, "model plant; expected one of identified"),
    ({"baseline": ["identifier"]}, "expected a factor and its level"),
    ({"baseline": ["identifier=ridge"]}, "no run has identifier=ridge; expected one of none,"),
    ({"where": "seed>50"}, "no runs match; the logbook has 17"),
    ({"rows": "seed", "columns": "seed"}, "both name seed"),
    ({"metric": ["force_mse"], "coefficient": ["u"]}, "got both"),
)


def test_what_is_not_known_is_refused_in_one_line(
    results: Queries, subtests: pytest.Subtests
) -> None:
    for options, expected in REFUSED:
        with subtests.test(expected):
            with pytest.raises(ConfigurationError) as refused:
                table(results, **options)
            assert expected in str(refused.value)
            assert "\n" not in str(refused.value)


def test_machine_formats_hold_every_fact_at_full_precision(results: Queries) -> None:
    grid = table(results, statistic=["mean", "std", "n"])
    from_json = json.loads(render(grid, OutputFormat.JSON))
    from_csv = list(csv.DictReader(io.StringIO(render(grid, OutputFormat.CSV))))
    assert len(from_json) == len(from_csv) == 6
    assert from_json[2]["std"] == float(from_csv[2]["std"]) == pytest.approx(math.sqrt(7.0))
    failed = next(r for r in from_json if r["failed"])
    assert (failed["identifier"], failed["diverged"], failed["std"]) == ("ls", 1, None)
    assert from_csv[2]["unit"] == "N^2"


def test_a_design_that_does_not_settle_marks_its_figures(
    logbook: LogbookWriter, results: Queries
) -> None:
    """By run and model: the nominal design of `ls` is sound, its identified one is not."""
    radius = {"none": (0.9, 0.9), "ls": (0.9, 1.025), "plsr": (0.9, 0.95)}
    for identifier, (nominal, identified) in radius.items():
        found = [stored.tracking(1.0), stored.tracking(2.0, "nominal"), stored.force_mse(5.0)]
        found.append(stored.deployed("spectral_radius", nominal, "nominal"))
        found.append(stored.deployed("spectral_radius", identified))
        tight = float(identifier == "plsr")
        found.append(stored.deployed("infeasible_limits", tight, dof="sway"))
        stored.finish(logbook, stored.start(identifier), found)
    options = {"metric": ["e_pos_mae"], "dof": ["position"], "columns": "model"}
    grid = table(results, model=["all"], **options)
    shown = {row[0].text: [cell.text for cell in row[1:]] for row in grid.rows}
    assert shown["none"] == ["2.000 (n=1)", "1.000 (n=1)"]
    assert shown["ls"] == ["2.000 (n=1)", "1.000 ‡ (n=1)"]
    assert shown["plsr"] == ["2.000 (n=1)", "1.000 § (n=1)"]
    assert any("spectral radius of 1 or more" in note for note in grid.notes)
    assert any("infeasible_limits" in note for note in grid.notes)
    flags = {(r["identifier"], r["model"]): r["unsettled"] for r in grid.as_records()}
    assert [key for key, flag in flags.items() if flag] == [("ls", "identified")]
    assert not any("‡" in cell.text for row in table(results).rows for cell in row)
    assert r"\ddag{}" in render(grid, OutputFormat.LATEX)


def test_bold_and_wins_are_what_the_catalogue_says_is_better(
    logbook: LogbookWriter, results: Queries, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Metrics of parts from elsewhere: near 95 is good, high is good, and one nothing declares."""
    monkeypatch.setattr(catalogue, "_declared", dict(catalogue._declared))
    catalogue.register(Definition("coverage", ("validation",), "%", 95.0, "Coverage", "", note="N"))
    catalogue.register(Definition("vaf", ("validation",), "%", "higher", "VAF", ""))
    names = ("coverage", "vaf", "speed")
    values = {
        "none": ((80.0, 99.0), (60.0, 62.0), (1.0, 2.0)),
        "ls": ((94.0, 95.0), (90.0, 92.0), (3.0, 4.0)),
        "plsr": ((99.0, 99.5), (70.0, 61.0), (5.0, 6.0)),
    }
    for identifier, of_names in values.items():
        for seed, of_seed in enumerate(zip(*of_names, strict=True)):
            rows = [
                Metric("validation", "identified", "surge", name, value, "knots")
                for name, value in zip(names, of_seed, strict=True)
            ]
            stored.finish(logbook, stored.start(identifier, seed=seed), rows)
    for name, best, won in (
        ("coverage", ["ls"], "won 1/2"), ("vaf", ["ls"], "won 1/2"), ("speed", [], None),
    ):  # fmt: skip
        grid = table(results, metric=[name], columns="none")
        assert [key[0] for key, text in cells(grid).items() if text.endswith("*")] == best
        assert "[knots]" in grid.title  # the stored unit
        assert ("N" in grid.notes) == (name == "coverage")
        shown = cells(table(results, metric=[name], columns="none", baseline=["identifier=none"]))
        (text,) = (text for key, text in shown.items() if key[0] == "plsr")
        assert (won in text) if won else ("won" not in text and "× 3.67" in text)
