"""The figures of the site are those of `table`: the page's own rules against the command."""

import itertools
import json
import math
import random
import shlex
from pathlib import Path
from typing import Any
from urllib.parse import urlencode

import numpy as np
import pytest
import scipy.stats

from seatrial.runner.compare.results import open_results
from seatrial.runner.compare.site import write_site
from seatrial.runner.compare.site.contents import STRETCHES, extremes
from seatrial.runner.compare.statistics import paired_test
from seatrial.runner.database import LogbookWriter
from seatrial.runner.record.rows import Coefficient, Metric
from tests.runner.compare import stored
from tests.runner.compare.conftest import Program
from tests.runner.compare.site_pages import cells_of, close, commands_of, show

MEASURES = (
    ("force_mse", "validation", "surge", "identified"),
    ("force_mse", "validation", "surge", "nominal"),
    ("velocity_rmse_free_run", "validation", "surge", "identified"),
    ("e_pos_mae", "deployment", "position", "identified"),
    ("velocity_fit_free_run", "validation", "surge", "identified"),
    ("coefficient:u_dot", "coefficient", "surge", "identified"),
    ("coefficient:|u|u", "coefficient", "surge", "identified"),
)
FACTORS = (
    *("identifier", "disturbance", "evaluation", "plant.scale", "lap", "lowpass_hz", "seed"),
    *("remark", "identifier.force", "plant.change", "status"),
)
SAME = ("mean", "std", "ci_low", "ci_high", "held_s", "ratio", "p_value", "difference")
OF_COEFFICIENTS = ("std_error", "true_value")
EQUAL = (
    *("n", "failed", "diverged", "without_value", "diverged_predictions", "deterministic"),
    *("unsettled", "infeasible", "best", "wins", "pairs"),
)


def fill_random(logbook: LogbookWriter, number: int, draw: random.Random) -> None:
    """Runs that differ in everything that a table may or may not average over."""
    sweep = None
    for i in range(number):
        if i % (number // 3) == 0:
            tags = ["night"] if i else ["day", "sea"]
            sweep = logbook.begin_sweep(f"part {i}", "seatrial -m", [], number // 3, tags=tags)
        config: dict[str, Any] = {"plant": {"scale": draw.choice([0.5] * 6 + [0.7, 1e-5])}}
        config["lap"] = draw.random() < 0.9
        config["lowpass_hz"] = draw.choice([None] * 8 + [0.5, "auto"])
        if draw.random() < 0.15:
            config["plant"]["change"] = draw.choice(["x", [1, 2.5]])
        if draw.random() < 0.15:
            config["remark"] = "a \"b\" 'c', d"
        begin = stored.start(
            draw.choice(["none", "ls", "plsr"]), draw.choice(["calm", "noise"]), draw.randrange(8),
            config=config, evaluation=draw.choice(["replay", "replay", "none"]),
            code=draw.choice([None, "one", "one"]),
        )  # fmt: skip
        begun = logbook.begin_run(begin, sweep, rerun=draw.random() < 0.3)
        if begun.state != "new":
            continue
        if draw.random() < 0.1:
            status: Any = draw.choice(["failed", "diverged"])
            logbook.fail_run(begun.run_id, status, "ValueError", "broken", "Traceback")
            continue
        streams: Any = draw.choice([None, ("noise",), ("noise",), (), ("identifier",)])
        diagnostics = [stored.interval(of_estimate=draw.random() < 0.5)] * (draw.random() < 0.7)
        logbook.finish_run(
            begun.run_id,
            stored.Results(_metrics(draw), _coefficients(draw), diagnostics, [], drawn=streams),
        )


def _metrics(draw: random.Random) -> list[Metric]:
    diverged = draw.random() < 0.2
    free_run = math.nan if diverged else draw.choice([0.5, draw.lognormvariate(0.0, 1.0)])
    metrics = [
        stored.force_mse(draw.choice([100.0, draw.lognormvariate(4.0, 1.0)])),
        stored.force_mse(draw.lognormvariate(5.0, 1.0), model="nominal"),
        stored.force_mse(draw.lognormvariate(6.0, 1.0), "yaw"),
        stored.below(float(draw.random() < 0.1)),
        Metric("validation", "identified", "surge", "velocity_rmse_free_run", free_run, "m/s"),
        Metric("validation", "identified", "surge", "velocity_fit_free_run", 9.0 * free_run, "%"),
        Metric("validation", "identified", "all", "limited_share_free_run", 0.5 * diverged, ""),
        Metric("validation", "identified", "all", "held_free_run", 12.0 * draw.random(), "s"),
    ]
    if draw.random() < 0.8:
        metrics += [stored.tracking(draw.lognormvariate(0.0, 0.5))]
        metrics += [stored.deployed("spectral_radius", draw.choice([0.9, 0.9, 1.1]))]
        metrics += [stored.deployed("infeasible_limits", draw.choice([0.0, 0.0, 1.0]))]
    return metrics


def _coefficients(draw: random.Random) -> list[Coefficient]:
    error, truth = draw.choice([None, 3.0, 8.0]), draw.choice([1050.0] * 9 + [None, 525.0])
    terms = [stored.coefficient("u_dot", draw.choice([1000.0, draw.gauss(1000, 90)]), error, truth)]
    if draw.random() < 0.8:
        terms.append(stored.coefficient("|u|u", draw.gauss(50, 9), error, 55.0, unit="kg/m"))
    return terms


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A logbook of 600 random runs, and its site."""
    folder = tmp_path_factory.mktemp("rules")
    with stored.logbook_at(folder) as logbook:
        fill_random(logbook, 600, random.Random(1))
    database = folder / "results.db"
    with open_results(str(database)) as results:
        return database, write_site(results, folder / "site", str(database), 0)


def hashes(number: int, draw: random.Random) -> list[str]:
    """Addresses of random tables."""
    chosen = []
    for _ in range(number):
        metric, stage, dof, model = draw.choice(MEASURES)
        rows, columns = draw.sample(FACTORS, 2)
        words = [("metric", metric), ("stage", stage), ("dof", dof), ("model", model)]
        words += [("rows", rows), ("columns", draw.choice([columns, "none"]))]
        words += [("sweep", draw.choice(["all", "all", "1", "2"]))]
        fixed = (
            *(("identifier", "ls"), ("lap", "true"), ("plant.scale", "0.5"), ("code", "one")),
            *(("evaluation", "replay"), ("lowpass_hz", "none"), ("disturbance", "noise")),
        )
        for name, level in fixed:
            if name != rows and draw.random() < 0.6:
                words.append((f"where.{name}", level))
        if draw.random() < 0.3:
            words += [("where.remark", "a \"b\" 'c', d"), ("where.remark", "none")]
        if draw.random() < 0.2:
            words += [("where.plant.change", "[1,2.5]"), ("where.plant.change", "none")]
        if draw.random() < 0.5:
            words.append(("baseline", draw.choice(["identifier=none", "plant.scale=0.7"])))
        if draw.random() < 0.2:
            words += [("tag", "night"), ("sweep", "all")]
        chosen.append(urlencode(words))
    return chosen


@pytest.mark.slow
def test_any_table_of_the_page_is_that_of_its_command(
    browser: Any, written: tuple[Path, Path], program: Program
) -> None:
    compared, refused, tested, terms = 0, 0, 0, 0
    for address in hashes(60, random.Random(2)):
        show(browser, written[1].as_uri(), address)
        command = commands_of(browser)
        if not command:
            said = browser.find_element("id", "main").text
            assert "No run meets the filters" in said, (address, said)
            continue
        words = shlex.split(command[0])[3:]
        code, out, err = program(*words, "--format", "json")
        cells = cells_of(browser)
        if code == 2:
            assert "would average over" in err or "no run" in err, err
            if "would average over" in err:
                assert cells is None, address
                refused += 1
            continue
        assert cells is not None, (address, command[0])
        rows = json.loads(out)
        names = list(cells[0]["levels"]) if cells else []
        told = {tuple(str(row[name]) for name in names): row for row in rows}
        shown = {tuple(cell["levels"].values()): cell for cell in cells}
        assert set(told) == set(shown), (address, command[0])
        for key, row in told.items():
            for name in (*SAME, *OF_COEFFICIENTS):
                assert close(row.get(name), shown[key].get(name)), (name, key, row, shown[key])
            for name in EQUAL:
                assert row.get(name) == shown[key].get(name), (name, key, row, shown[key])
            if "interval_of_estimate" in row:
                assert row["interval_of_estimate"] == shown[key]["interval_of_estimate"]
                terms += row["n"]
        compared += len(rows)
        tested += sum(1 for row in rows if row.get("pairs"))
    assert compared > 200
    assert refused > 3
    assert tested > 20
    assert terms > 50


def test_the_signed_rank_test_is_that_of_scipy(browser: Any, written: tuple[Path, Path]) -> None:
    draw = np.random.default_rng(3)
    show(browser, written[1].as_uri(), "")
    for n, step in itertools.product((5, 8, 13, 14, 30, 50, 51, 80), (0.0, 0.5)):
        pairs = draw.normal(0.3, 1.0, (n, 2))
        if step:
            pairs = np.round(pairs / step) * step
        expected = paired_test(pairs[:, 0], pairs[:, 1])
        got = browser.execute_script(
            "return statistics.pairedTest(arguments[0], 'lower')", pairs.tolist()
        )
        assert got["wins"] == expected.wins
        assert close(got["p"], expected.p_value), (n, step, got["p"], expected.p_value)


def test_the_quantile_of_t_is_that_of_scipy(browser: Any, written: tuple[Path, Path]) -> None:
    show(browser, written[1].as_uri(), "")
    for freedom in (1, 5, 200, 201, 1000, 9999):
        got = browser.execute_script(
            "return statistics.quantile(page.runs.summary.t, arguments[0])", freedom
        )
        assert got == pytest.approx(scipy.stats.t.ppf(0.975, freedom), rel=1e-10)


def test_numbers_are_written_as_by_the_command(browser: Any, written: tuple[Path, Path]) -> None:
    from seatrial.runner.compare.grid import number_text

    draw = random.Random(4)
    values = [0.0, 100.25, 0.125, 12344.5, 12345.5, 999999.5, 1e6, 1e-5, 9.9996, -2.5, 1234.5]
    values += [draw.choice([-1, 1]) * 10 ** draw.uniform(-7, 9) for _ in range(300)]
    show(browser, written[1].as_uri(), "")
    for digits in (2, 4):
        got = browser.execute_script(
            f"return arguments[0].map((v) => numberText(v, {digits}))", values
        )
        assert got == [number_text(value, digits) for value in values]


def test_thinning_keeps_every_extreme() -> None:
    draw = np.random.default_rng(5)
    t = np.arange(0.0, 5000.0)
    values = draw.normal(size=t.size).cumsum()
    values[1234], values[4321], values[77] = 1e3, -1e3, np.nan
    kept_t, kept = extremes(t, values)
    assert kept.size <= 2 * STRETCHES
    assert (kept.max(), kept.min()) == (1e3, -1e3)
    assert np.all(np.diff(kept_t) > 0.0)
    assert np.array_equal(values[kept_t.astype(int)], kept)
