"""Laws of a comparison: what counts, what is equal, what is best, and over which seeds."""

from collections.abc import Callable, Mapping, Sequence
from itertools import product

import pytest

from seatrial.runner.compare.cli import TableOptions
from seatrial.runner.compare.frame import Queries
from seatrial.runner.compare.grid import TextTable
from seatrial.runner.compare.table import comparison
from seatrial.runner.database import LogbookWriter
from tests.runner.compare import stored
from tests.runner.compare.test_comparison_table import record_of

SEEDS = range(6)
Values = Mapping[str, Sequence[float | None]]


@pytest.fixture
def fill(logbook: LogbookWriter) -> Callable[[Values], None]:
    """Store the tracking errors of identifiers by seed; None is a run that failed."""

    def filled(values: Values) -> None:
        for identifier, by_seed in values.items():
            for seed, value in enumerate(by_seed):
                begin = stored.start(identifier, "noise", seed)
                if value is None:
                    stored.fail(logbook, begin)
                else:
                    stored.finish(logbook, begin, [stored.tracking(value)], drawn=["noise"])

    return filled


def table(results: Queries, **options: object) -> TextTable:
    return comparison(results, TableOptions(metric=["e_pos_mae"], **options))  # type: ignore[arg-type]


def best(grid: TextTable) -> set[object]:
    return {r["identifier"] for r in grid.as_records() if r["best"]}


def test_a_survivor_is_never_best_and_its_lost_pairs_count_as_lost(
    results: Queries, fill: Callable[[Values], None]
) -> None:
    survivor = [0.1, None, None, None, None, 0.2]
    fill({"none": [1.0] * 6, "ls": [0.5] * 6, "plsr": survivor})
    grid = table(results, baseline=["identifier=none"], statistic=["median"])
    assert best(grid) == {"ls"}
    lost = record_of(grid, identifier="plsr")
    assert (lost["wins"], lost["pairs"], lost["lost_pairs"]) == (2, 2, 4)
    text = {row[0].text: row[1].text for row in grid.rows}
    assert text["plsr"].startswith("median 0.1500 (n=2, 4 failed)")  # the count beside the value
    assert text["plsr"].endswith("won 2/6")


def test_a_number_that_a_method_cannot_have_loses_nothing(
    logbook: LogbookWriter, results: Queries
) -> None:
    errors = {("ls", 0): 3.0, ("plsr", 0): 4.0, ("ls", 1): None, ("dsr", 0): None}
    for (identifier, seed), error in errors.items():
        rows = [stored.tracking(1.0 + (identifier != "dsr"))]
        rows += [] if error is None else [stored.force_mse(error)]
        stored.finish(logbook, stored.start(identifier, "noise", seed), rows)
    grid = comparison(results, TableOptions(metric=["force_mse"]))
    lacking = record_of(grid, identifier="dsr")
    assert (lacking["not_applicable"], lacking["without_value"]) == (1, 0)
    assert best(grid) == {"ls"}  # though one of its trials has no such number
    assert best(table(results)) == {"dsr"}
    both = comparison(results, TableOptions(metric=["force_mse", "e_pos_mae"])).as_records()
    assert [(r["metric"], r["identifier"]) for r in both if r["not_applicable"]] == [
        ("force_mse", "ls")
    ]


def test_cells_are_compared_over_the_seeds_of_the_baseline(
    results: Queries, fill: Callable[[Values], None]
) -> None:
    hard = [1.0, 1.0, 1.0, 1.0, 9.0, 9.0]  # the last two seeds are the hard ones
    more = [0.95] * 4 + [8.5] * 2 + [0.0] * 2
    fill({"none": hard, "ls": [0.9] * 4 + [8.0] * 2, "plsr": [0.95] * 4, "iv": more})
    grid = table(results, baseline=["identifier=none"])
    assert best(grid) == {"ls"}  # the others have smaller means, by easy seeds
    assert best(table(results)) == {"ls"}  # without a baseline: the seeds that most cells have


def test_seeds_of_half_of_the_cells_are_not_those_of_most(
    results: Queries, fill: Callable[[Values], None]
) -> None:
    fill({"none": [0.1] * 4, "ls": [0.5] * 6, "plsr": [1.0] * 6, "iv": [None] + [0.9] * 5})
    assert best(table(results, where="identifier in (none, ls)")) == {"none"}
    assert best(table(results, where="identifier in (plsr, iv)")) == set()  # iv lost one


def test_bold_is_of_the_mean_unless_the_median_stands_alone(
    results: Queries, fill: Callable[[Values], None]
) -> None:
    fill({"none": [2.0] * 3, "ls": [1.0, 1.0, 9.0]})
    assert best(table(results, statistic=["median"])) == {"ls"}
    assert best(table(results, statistic=["mean", "median"])) == {"none"}


@pytest.mark.parametrize(("size", "equal"), [(0.1, 5e-7), (1000.0, 5e-4)])
def test_a_difference_below_the_resolution_or_a_millionth_is_none(
    results: Queries, fill: Callable[[Values], None], size: float, equal: float
) -> None:
    errors = [size * (1.0 + 0.01 * seed) for seed in SEEDS]
    worse, better = ([error - equal * factor for error in errors] for factor in (1.0, 3.0))
    fill({"none": errors, "ls": worse, "plsr": better})
    grid = table(results, baseline=["identifier=none"])
    tied, won = (record_of(grid, identifier=name) for name in ("ls", "plsr"))
    assert (tied["wins"], tied["effect"], won["wins"], won["effect"]) == (0, 0.0, 6, 1.0)
    assert tied["p_value"] != tied["p_value"]  # nan: there is nothing to test
    assert best(table(results, where="identifier in (none, ls)")) == {"none", "ls"}
    assert best(table(results, where="identifier in (none, plsr)")) == {"plsr"}


def test_levels_that_are_pooled_are_no_replicates(logbook: LogbookWriter, results: Queries) -> None:
    """Nor is one that depends on no seed, which belongs to every seed."""
    levels = (("wind", 1.0, True), ("noise", 2.0, True), ("calm", 3.0, False))
    for seed, (disturbance, level, drawn) in product(SEEDS, levels):
        for identifier, factor in (("none", 1.0), ("ls", 0.5)):
            begin = stored.start(identifier, disturbance, seed)
            row = stored.tracking(factor * (level + 0.1 * seed * drawn))
            stored.finish(logbook, begin, [row], drawn=["noise"] if drawn else [])
    pooled = table(results, columns="none", pool=["disturbance"], baseline=["identifier=none"])
    own = record_of(pooled, identifier="ls")
    assert (own["n"], own["pairs"], own["wins"]) == (6, 6, 6)
    assert own["p_value"] == pytest.approx(2.0 / 2**6)  # of six signs, not of twelve
    assert own["mean"] == pytest.approx(0.5 * (2.0 + 0.25 * 2.0 / 3.0))
    assert own["difference"] == pytest.approx(-own["mean"])


def test_seeds_that_lack_a_pooled_level_are_said(logbook: LogbookWriter, results: Queries) -> None:
    for disturbance, seeds in (("wind", range(4)), ("noise", range(6))):
        for seed in seeds:
            begin = stored.start("ls", disturbance, seed)
            stored.finish(logbook, begin, [stored.tracking(1.0)], drawn=["noise"])
    whole = (("plsr", 2.0), ("robust", 3.0))
    for (identifier, error), disturbance, seed in product(whole, ("wind", "noise"), SEEDS):
        begin = stored.start(identifier, disturbance, seed)
        stored.finish(logbook, begin, [stored.tracking(error)], drawn=["noise"])
    grid = table(results, columns="none", pool=["disturbance"])
    assert "n=4, all equal, 2 seeds without all levels" in grid.rows[0][1].text
    assert best(grid) == {"plsr"}


def test_who_lacks_a_pooled_level_is_not_best(logbook: LogbookWriter, results: Queries) -> None:
    """Whether it is the hard one or the easy one; a cell says how many it lacks."""
    errors = {"none": (1.0, 3.0), "plsr": (0.8, 2.4), "ls": (0.9, None), "iv": (None, 2.0)}
    for (identifier, levels), seed in product(errors.items(), SEEDS):
        for disturbance, error in zip(("wind", "noise"), levels, strict=True):
            if error is not None:
                begin = stored.start(identifier, disturbance, seed)
                stored.finish(logbook, begin, [stored.tracking(error)], drawn=["noise"])
    for baseline in (["identifier=none"], ["identifier=ls"], None):
        grid = table(results, columns="none", pool=["disturbance"], baseline=baseline)
        assert best(grid) == {"plsr"}
        assert "1 level lacking" in {row[0].text: row[1].text for row in grid.rows}["ls"]


def test_a_seed_of_which_a_pooled_level_was_lost_is_no_pair(
    logbook: LogbookWriter, results: Queries
) -> None:
    for identifier, controller, seed in product(("none", "ls"), ("pid", "lqi"), SEEDS):
        begin = stored.start(identifier, "noise", seed, controller=controller)
        if identifier == "ls" and controller == "lqi" and seed < 2:
            stored.fail(logbook, begin)
        else:
            value = (1.0 if identifier == "none" else 0.9) + seed
            stored.finish(logbook, begin, [stored.tracking(value)], drawn=["noise"])
    grid = table(results, columns="none", pool=["controller"], baseline=["identifier=none"])
    own = record_of(grid, identifier="ls")
    assert (own["n"], own["pairs"], own["lost_pairs"], own["wins"]) == (4, 4, 2, 4)
    assert own["p_value"] != own["p_value"]  # nan: too few


def test_levels_with_a_seed_each_are_replicates(logbook: LogbookWriter, results: Queries) -> None:
    for seed in SEEDS:  # such as a design that is drawn by the seed
        begin = stored.start("ls", "noise", seed, config={"plant": {"scale": 0.1 * seed}})
        stored.finish(logbook, begin, [stored.tracking(1.0)], drawn=["noise"])
    grid = table(results, pool=["plant.scale"])
    assert grid.rows[0][1].text == "1.000 ± 0 (n=6, all equal)"


def test_p_values_of_a_table_are_corrected_for_their_number(
    results: Queries, fill: Callable[[Values], None]
) -> None:
    worse = [1.0 + 0.1 * seed for seed in SEEDS]
    fill({"none": worse, **{name: [0.5 * v for v in worse] for name in ("ls", "plsr", "iv")}})
    grid = table(results, baseline=["identifier=none"])
    own = record_of(grid, identifier="ls")
    assert own["p_value"] == pytest.approx(2.0 / 2**6)
    assert own["p_holm"] == pytest.approx(6.0 / 2**6)
    assert own["effect"] == 1.0


def test_a_metric_keeps_its_unit_when_every_value_is_missing(
    logbook: LogbookWriter, results: Queries
) -> None:
    row = stored.tracking(float("nan"))
    stored.finish(logbook, stored.start("ls", "noise"), [row])
    grid = table(results)
    assert "[m]" in grid.title
    assert grid.rows[0][1].text == "– (1 without value)"


def test_planned_trials_that_never_started_count(logbook: LogbookWriter, results: Queries) -> None:
    begins = [stored.start("ls", "noise", seed) for seed in SEEDS]
    planned = stored.planned(begins)
    sweep = logbook.begin_sweep("night", "command", [], len(planned), trials=planned)
    for begin in begins[:4]:
        stored.finish(logbook, begin, [stored.tracking(1.0)], sweep=sweep, drawn=["noise"])
    assert table(results).rows[0][1].text == "1.000 ± 0 (n=4, all equal, 2 not started)"
    (choices,) = logbook.sweep_status(sweep).spent_s
    assert logbook.sweep_status(sweep).left[choices] == 2
    part = table(results, where="seed<5 and identifier=ls")
    assert part.rows[0][1].text == "1.000 ± 0 (n=4, all equal, 1 not started)"
    logbook.prune([1])  # what is deleted is waited for by nobody
    assert table(results).rows[0][1].text == "1.000 ± 0 (n=3, all equal, 2 not started)"
    for begin in begins[4:]:  # of any sweep
        stored.finish(logbook, begin, [stored.tracking(1.0)], drawn=["noise"])
    assert table(results, sweep="night").rows[0][1].text == "1.000 ± 0 (n=5, all equal)"


def test_a_trial_that_failed_again_in_a_later_sweep_still_counts(
    logbook: LogbookWriter, results: Queries
) -> None:
    failing = stored.start("ls", "noise", 1)
    for name in ("first", "again"):
        sweep = logbook.begin_sweep(name, "command", [], 2)
        if name == "first":
            good = stored.start("ls", "noise", 0)
            stored.finish(logbook, good, [stored.tracking(1.0)], sweep=sweep, drawn=["noise"])
        stored.fail(logbook, failing, sweep=sweep)
    assert table(results, sweep="first").rows[0][1].text == "1.000 (n=1, 1 failed)"


def test_a_cell_that_lost_every_trial_lost_every_pair(
    logbook: LogbookWriter, results: Queries
) -> None:
    for seed in SEEDS:
        for name, value in (("none", 1.0 + seed), ("ls", float("nan"))):
            begin = stored.start(name, "noise", seed)
            stored.finish(logbook, begin, [stored.tracking(value)], drawn=["noise"])
    row = record_of(table(results, baseline=["identifier=none"]), identifier="ls")
    assert (row["wins"], row["pairs"], row["lost_pairs"]) == (0, 0, len(SEEDS))
