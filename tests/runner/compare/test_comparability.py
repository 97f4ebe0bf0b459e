"""Like is compared with like: what a cell pools, what a replicate is, what a baseline matches."""

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
import pytest
from scipy import stats

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.frame import Queries
from seatrial.runner.database import LogbookWriter
from seatrial.runner.database.tables import RunRow
from seatrial.runner.record.rows import Metric
from seatrial.runner.record.vocabulary import Stream
from tests.runner.compare import stored
from tests.runner.compare.test_comparison_laws import SEEDS
from tests.runner.compare.test_comparison_table import cells, record_of, table


def options(basis: str, lowpass_hz: float) -> dict[str, Any]:
    return {"identifier": {"basis": basis, "lowpass_hz": lowpass_hz}}


def store(
    logbook: LogbookWriter, begin: RunRow, value: float, drawn: Sequence[Any] = ("noise",),
    **more: Any,
) -> None:  # fmt: skip
    stored.finish(logbook, begin, [stored.force_mse(value)], drawn=drawn, **more)


@pytest.fixture
def bases(logbook: LogbookWriter) -> dict[tuple[str, str, float], Any]:
    """Force errors of ls with two bases and two filters, of ridge with one of each."""
    rng = np.random.default_rng(4)
    values = {}
    kinds = [("ls", b, hz) for b in ("full", "physical") for hz in (0.5, 2.0)]
    for identifier, basis, hz in [*kinds, ("ridge", "physical", 0.5), ("ridge", "lean", 0.5)]:
        sizes = {"full": 900.0, "physical": 100.0, "lean": 300.0}[basis] * rng.uniform(0.5, 1.5, 6)
        values[identifier, basis, hz] = sizes
        for seed in SEEDS:
            begin = stored.start(identifier, "noise", seed, config=options(basis, hz))
            store(logbook, begin, sizes[seed])
    return values


def test_a_baseline_matches_everything_that_it_does_not_fix(
    results: Queries, bases: dict[tuple[str, str, float], Any]
) -> None:
    rows = "identifier,identifier.basis,identifier.lowpass_hz"
    grid = table(results, rows=rows, baseline=["identifier=ls"])
    ridge = bases["ridge", "physical", 0.5]
    own = bases["ls", "physical", 0.5]
    row = record_of(grid, **{"identifier": "ridge", "identifier.basis": "physical"})
    assert row["ratio"] == pytest.approx(ridge.mean() / own.mean())
    assert (row["pairs"], row["wins"]) == (6, int(np.sum(ridge < own)))
    assert row["p_value"] == pytest.approx(stats.wilcoxon(ridge, own).pvalue)
    shown = cells(grid)
    assert shown["ridge", "lean", "0.5", "noise"].endswith("\nno counterpart")
    assert shown["ls", "full", "2.0", "noise"].endswith("\nbaseline")
    one = table(
        results, baseline=["identifier=ls", "identifier.basis=full", "identifier.lowpass_hz=0.5"]
    )
    row = record_of(one, **{"identifier": "ridge", "identifier.basis": "physical"})
    assert row["ratio"] == pytest.approx(ridge.mean() / bases["ls", "full", 0.5].mean())


def test_a_model_as_baseline_is_of_the_same_controller(
    logbook: LogbookWriter, results: Queries
) -> None:
    """The nominal model is that of every identifier, but not of every controller."""
    for controller, factor, seed in product(("pid", "lqi"), (1.0, 4.0), SEEDS):
        nominal = {"pid": 2.0, "lqi": 8.0}[controller] + seed
        identifier = {1.0: "none", 4.0: "ls"}[factor]
        metrics = [stored.tracking(nominal / factor), stored.tracking(nominal, "nominal")]
        begin = stored.start(identifier, "noise", seed, controller=controller)
        stored.finish(logbook, begin, metrics, drawn=["noise"])
    rows, dofs = "identifier,controller", ["position"]
    grid = table(results, rows=rows, metric=["e_pos_mae"], dof=dofs, baseline=["model=nominal"])
    for controller in ("pid", "lqi"):
        own = record_of(grid, identifier="ls", controller=controller, model="identified")
        assert (own["ratio"], own["pairs"]) == (pytest.approx(0.25), 6)


def test_a_ratio_and_the_mean_beside_it_are_of_the_same_pairs(
    logbook: LogbookWriter, results: Queries
) -> None:
    for seed in SEEDS:
        store(logbook, stored.start("plsr", "noise", seed), 10.0 + seed)
        if seed < 2:
            store(logbook, stored.start("none", "noise", seed), 20.0)
    text = cells(table(results, baseline=["identifier=none"]))["plsr", "noise"]
    assert text.startswith("12.50 ± 1.9 (n=6)")
    assert text.endswith("× 0.525, 2 pairs, won 2/2 (mean 10.50 of the pairs)*")


def test_runs_that_do_not_depend_on_the_seed_are_one_experiment(
    logbook: LogbookWriter, results: Queries
) -> None:
    for seed in SEEDS:
        store(logbook, stored.start("none", seed=seed), 2919.0, drawn=())
        store(logbook, stored.start("ls", seed=seed), 398.0, drawn=())
    grid = table(results, baseline=["identifier=none"])
    assert cells(grid)["none", "calm"] == "2919 (deterministic)\nbaseline"
    assert cells(grid)["ls", "calm"] == "398.0 (deterministic)\n× 0.136, 1 pair, won 1/1*"
    row = record_of(grid, identifier="ls")
    assert (row["n"], row["pairs"], row["deterministic"]) == (1, 1, True)


def test_a_random_identifier_has_replicates_and_its_nominal_model_has_none(
    logbook: LogbookWriter, results: Queries
) -> None:
    for seed in SEEDS:
        rows = [stored.force_mse(10.0 + seed), stored.force_mse(20.0, model="nominal")]
        stored.finish(logbook, stored.start("nsga2", seed=seed), rows, drawn=["identifier"])
        store(logbook, stored.start("ls", seed=seed), 15.0, drawn=())
    stored.finish(logbook, stored.start("nsga2", seed=7), rows, drawn=[])  # drew nothing: no seed
    shown = cells(table(results, model=["all"], columns="model"))
    assert shown["nsga2", "identified"].startswith("12.50 ± 1.9 (n=6)")
    assert shown["nsga2", "nominal"] == "20.00 (deterministic)"
    stored.fail(logbook, stored.start("nsga2", seed=6))
    row = record_of(table(results, baseline=["identifier=ls"]), identifier="nsga2")
    # each against the one experiment of ls, and the other way round
    assert (row["pairs"], row["wins"], row["lost_pairs"]) == (6, 5, 1)
    row = record_of(table(results, baseline=["identifier=nsga2"]), identifier="ls")
    assert (row["pairs"], row["wins"], row["lost_pairs"]) == (6, 0, 0)


def test_every_other_stream_is_drawn_for_the_nominal_model_too(
    logbook: LogbookWriter, results: Queries
) -> None:
    streams: dict[str, Stream] = {"ls": "excitation", "ridge": "noise", "iv": "disturbance"}
    for identifier, stream in streams.items():
        for seed in SEEDS:
            begin = stored.start(identifier, seed=seed)
            rows = [stored.force_mse(10.0 + seed, model="nominal")]
            stored.finish(logbook, begin, rows, drawn=["identifier", stream])
    shown = cells(table(results, model=["nominal"], columns="none"))
    assert {text.rstrip("*") for text in shown.values()} == {"12.50 ± 1.9 (n=6)"}


def test_of_equal_experiments_the_newest_counts(logbook: LogbookWriter, results: Queries) -> None:
    for seed, value in ((1, 10.0), (0, 20.0)):  # nothing depends on the seed
        store(logbook, stored.start("ls", seed=seed), value, drawn=())
    assert cells(table(results)) == {("ls", "calm"): "20.00 (deterministic)"}


def test_a_trial_under_another_evaluation_counts_once_until_it_is_deployed(
    logbook: LogbookWriter, results: Queries
) -> None:
    for seed in SEEDS:
        for evaluation in ("replay", "waypoints"):
            begin = stored.start("ls", "noise", seed, evaluation=evaluation)
            rows = [stored.force_mse(10.0 + seed), stored.tracking(float(len(evaluation)))]
            stored.finish(logbook, begin, rows, drawn=["noise"])
    assert cells(table(results)) == {("ls", "noise"): "12.50 ± 1.9 (n=6)"}
    deployed = cells(table(results, metric=["e_pos_mae"], dof=None))
    assert deployed["ls", "replay", "noise"].startswith("6.000 ± 0 (n=6, all equal)")
    assert deployed["ls", "waypoints", "noise"].startswith("9.000 ± 0 (n=6, all equal)")


def test_a_plant_that_changes_later_is_the_same_until_it_is_deployed(
    logbook: LogbookWriter, results: Queries
) -> None:
    """Another plant is another one from the beginning."""
    for scale, at_s in ((0.5, 100.0), (0.5, 200.0), (0.8, 100.0)):
        config = {"plant": {"scale": scale, "change": {"at_s": at_s}}}
        rows = [stored.force_mse(10.0 * scale), stored.tracking(at_s)]
        stored.finish(logbook, stored.start("ls", config=config), rows)
    assert list(cells(table(results))) == [("ls", "0.5", "calm"), ("ls", "0.8", "calm")]
    assert len(cells(table(results, metric=["e_pos_mae"], dof=None))) == 3


def test_a_table_is_of_the_newest_sweep(logbook: LogbookWriter, results: Queries) -> None:
    for name, vessel in (("first", "milliampere"), ("second", "supply_vessel")):
        sweep = logbook.begin_sweep(name, "command", [], 2)
        for seed in (0, 1):
            begin = stored.start("ls", "noise", seed, vessel=vessel)
            store(logbook, begin, 1.0 + len(vessel) + seed, sweep=sweep)
        logbook.end_sweep(sweep)
    newest = table(results)
    assert cells(newest) == {("ls", "noise"): "14.50 ± 0.71 (n=2)"}
    assert "2 runs, sweep 2 (second)" in newest.title
    assert cells(table(results, sweep="first")) == {("ls", "noise"): "12.50 ± 0.71 (n=2)"}
    every = table(results, sweep="all")
    assert list(every.headers) == ["identifier", "vessel", "noise"]
    assert any("split by vessel" in note for note in every.notes)
    pooled = table(results, sweep="all", pool=["vessel"])
    assert cells(pooled) == {("ls", "noise"): "13.50 ± 0.71 (n=2)"}


def test_versions_of_the_code_are_not_pooled(logbook: LogbookWriter, results: Queries) -> None:
    for code in ("0" * 16, "1" * 16):
        store(logbook, stored.start("ls", "noise", code=code), 1.0 + len(code))
    grid = table(results, sweep="all")
    assert grid.headers[1] == "code"
    assert len(grid.rows) == 2


def test_what_differs_in_too_much_is_refused_with_its_names(
    logbook: LogbookWriter, results: Queries
) -> None:
    for i, name in enumerate(("a", "b", "c", "d")):
        store(logbook, stored.start("ls", config={name: 1.0, "e": i}), 1.0)
    store(logbook, stored.start("ls", config={"f": 1, "g": 2}), 1.0)
    for levels in product("01", repeat=4):
        store(logbook, stored.start("plsr", config=dict(zip("abcd", levels, strict=True))), 1.0)
    with pytest.raises(ConfigurationError, match=r"would average over a, b, c, d.*--pool a,b,c,d"):
        table(results, where="identifier=plsr")
    assert len(table(results, where="identifier=plsr", pool=["a", "b", "c", "d"]).rows) == 1
    assert len(table(results, where="identifier=plsr", pool=["all"]).rows) == 1
    with pytest.raises(ConfigurationError, match=r"--pool: 'vesel' is not known; did you mean v"):
        table(results, pool=["vesel"])


def test_bold_is_sought_among_cells_of_one_vessel(logbook: LogbookWriter, results: Queries) -> None:
    for identifier, vessel, value in (("ls", "a", 1.0), ("plsr", "b", 3.0), ("none", "b", 2.0)):
        store(logbook, stored.start(identifier, vessel=vessel), value)
    assert [k[0] for k, text in cells(table(results)).items() if text.endswith("*")] == ["none"]


def test_a_diverged_prediction_is_counted(logbook: LogbookWriter, results: Queries) -> None:
    for seed, (value, limited) in enumerate([(0.1, 0.0), (None, 0.4), (None, 0.4)]):
        rows = [
            Metric("validation", "identified", "surge", "velocity_rmse_free_run", value, "m/s"),
            Metric("validation", "identified", "all", "limited_share_free_run", limited, ""),
        ]
        stored.finish(logbook, stored.start("ls", "noise", seed), rows, drawn=["noise"])
    grid = table(results, metric=["velocity_rmse_free_run"])
    assert cells(grid) == {("ls", "noise"): "0.1000 (n=1, 2 diverged in prediction)"}
    assert any("not included: 2 predictions that diverged" in note for note in grid.notes)
    row = record_of(grid, identifier="ls")
    assert (row["diverged_predictions"], row["without_value"]) == (2, 0)


def test_scores_are_compared_by_differences(logbook: LogbookWriter, results: Queries) -> None:
    """A FIT of -20 against 40 % is no ratio."""
    for identifier, values in {"none": (40.0, 50.0), "ls": (-20.0, 60.0)}.items():
        for seed, value in enumerate(values):
            fit = Metric("validation", "identified", "surge", "velocity_fit_free_run", value, "%")
            stored.finish(logbook, stored.start(identifier, "noise", seed), [fit], drawn=["noise"])
    grid = table(results, metric=["velocity_fit_free_run"], baseline=["identifier=none"])
    assert cells(grid)["ls", "noise"].endswith("\n-25.0, 2 pairs, won 1/2")
    assert record_of(grid, identifier="ls")["difference"] == -25.0
