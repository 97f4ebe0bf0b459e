"""Printed figures beside ours: reading, choosing, judging, showing."""

import json
import math
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.models.findings import Finding
from seatrial.runner.compare.printed_figures import COLUMNS, FOLDER, read_folder
from seatrial.runner.compare.published import judged
from seatrial.runner.compare.results import Results, open_results
from seatrial.runner.compare.verdicts import verdict_of
from seatrial.runner.record.rows import Metric
from tests.runner.compare import stored
from tests.runner.compare.browsers import complaints, open_page
from tests.runner.compare.conftest import Program
from tests.runner.compare.test_verdicts import ONE


@pytest.fixture
def book(tmp_path: Path) -> Path:
    """A logbook whose newest sweep `mine` has ls at 50, 51, 55 and a failed run; an older: 500."""
    with stored.logbook_at(tmp_path) as logbook:
        for values in ((500.0,), (50.0, 51.0, 55.0)):
            sweep = logbook.begin_sweep("mine", "python -m runner experiment=mine", [], 1)
            for value in values:
                begin = stored.start("ls", seed=int(value))
                run = logbook.begin_run(begin, sweep_id=sweep).run_id
                found = [stored.coefficient("u_dot", 2.0 * value, None, 100.0)]
                logbook.finish_run(run, stored.Results([stored.force_mse(value)], found, [], []))
        begin = stored.start("ls", seed=99)
        run = logbook.begin_run(begin, sweep_id=sweep).run_id
        logbook.fail_run(run, "failed", "ValueError", "broken", "Traceback")
        stored.finish(logbook, stored.start("ls", seed=1), [stored.force_mse(9.0)])  # no sweep
    return tmp_path


@pytest.fixture
def results(book: Path) -> Iterator[Results]:
    with open_results(f"sqlite:///{book}/results.db") as opened:
        yield opened


def test_ours_is_the_mean_over_the_newest_sweep_with_its_interval(results: Results) -> None:
    (one,) = judged(results, [ONE])
    assert one.value == pytest.approx(52.0)
    half = 4.302652729911275 * math.sqrt(7.0) / math.sqrt(3.0)  # Student's t of 2 degrees, 97.5 %
    assert (one.low, one.high) == pytest.approx((52.0 - half, 52.0 + half))
    assert (one.n, one.lost, one.verdict) == (3, 1, "beaten")
    assert one.ratio == pytest.approx(0.52)


def test_a_median_a_factor_and_a_coefficient(results: Results) -> None:
    (median,) = judged(results, [replace(ONE, statistic="median", factor=10.0)])
    assert median.value == pytest.approx(510.0)
    mass = replace(ONE, source="coefficient", stage="", name="u_dot", compare="truth")
    (one,) = judged(results, [mass])
    assert one.value == pytest.approx(104.0)
    assert one.verdict == "reproduced"  # printed 100.0 is the truth itself: nothing beats it


def test_a_coefficient_that_is_not_stored_is_zero(results: Results) -> None:
    dropped = replace(ONE, source="coefficient", stage="", name="|u|u", printed=7.0)
    (one,) = judged(results, [replace(dropped, compare="truth")])
    assert (one.value, one.n, one.verdict) == (0.0, 3, "beaten")
    assert judged(results, [replace(dropped, model="other")])[0].n == 0


def test_two_models_of_one_run_as_a_ratio(tmp_path: Path) -> None:
    with stored.logbook_at(tmp_path) as logbook:
        sweep = logbook.begin_sweep("mine", "python -m runner experiment=mine", [], 1)
        for seed, (nominal, identified) in enumerate([(8.0, 2.0), (4.0, 2.0), (0.0, 1.0)]):
            begin = logbook.begin_run(stored.start("ls", seed=seed), sweep_id=sweep)
            found = [stored.force_mse(nominal, model="nominal"), stored.force_mse(identified)]
            logbook.finish_run(begin.run_id, stored.Results(found, [], [], []))
    with open_results(f"sqlite:///{tmp_path}/results.db") as results:
        (one,) = judged(results, [replace(ONE, model="identified/nominal", printed=0.375)])
    assert one.value == pytest.approx(0.375)  # not the ratio of the means
    assert (one.n, one.lost) == (2, 1)  # over nothing it is not defined


def test_what_cannot_be_answered_says_why(results: Results) -> None:
    lines = [
        replace(ONE, source="", note="recordings are not public"),
        replace(ONE, where="identifier=plsr"),
        replace(ONE, name="force_mae"),
        replace(ONE, printed=None),
    ]
    found = judged(results, lines)
    verdicts = [one.verdict for one in found]
    assert verdicts == ["not reproducible", "no runs", "not reproduced", "ours"]
    assert found[0].reason == "recordings are not public"
    assert found[1].reason == "python -m runner experiment=mine"
    assert found[2].reason == "none of 4 runs has this figure"
    assert judged(results, [replace(ONE, experiment="other")])[0].verdict == "no runs"


@pytest.mark.parametrize(
    ("plant", "flag", "verdict"),
    [
        (40.0, 0.0, "beaten"),
        (60.0, 0.0, "below the true model"),
        (40.0, 1.0, "below the true model"),
    ],
)
def test_a_fit_of_the_lag_beats_nothing(
    tmp_path: Path, plant: float, flag: float, verdict: str
) -> None:
    """The plant's own figure or the stored flag says so; for a ratio to the nominal model too."""
    metrics = [stored.force_mse(50.0), stored.force_mse(plant, model="plant"), stored.below(flag)]
    metrics += [stored.force_mse(500.0, model="nominal")]
    with stored_sweep(tmp_path, metrics) as results:
        ratio = replace(ONE, model="identified/nominal", printed=0.5)
        worse = replace(ONE, printed=30.0)
        verdicts = [one.verdict for one in judged(results, [ONE, ratio, worse])]
    assert verdicts == [verdict, verdict, "not reproduced"]


def test_an_order_that_was_not_selected_is_shown_and_judged(tmp_path: Path) -> None:
    """The errors of every order are stored: ours at the printed order, and over the nominal one."""
    orders = [Finding("order_mse", "surge", 900.0 / i, "N^2", i=i, label="test") for i in (1, 5, 9)]
    surface = [Finding("surface_mse", "surge", 70.0, "N^2", i=8, j=18, label="test")]
    metrics = [stored.force_mse(600.0, model="nominal"), stored.force_mse(150.0, model="plant")]
    fifth = replace(ONE, source="diagnostic", stage="", model="", name="order_mse", label="5")
    divided = replace(
        fifth, model="/nominal", stage="validation", name="order_mse/force_mse", printed=0.6
    )
    with stored_sweep(tmp_path, metrics, [*orders, *surface]) as results:
        lines = [fifth, divided, replace(divided, label="9")]
        fit, ratio, below = judged(results, lines)
        (both,) = judged(results, [replace(fifth, name="surface_mse", label="8,18")])
    assert (fit.value, ratio.value, both.value) == (180.0, 0.3, 70.0)
    assert (ratio.verdict, below.verdict) == ("beaten", "below the true model")


@contextmanager
def stored_sweep(
    folder: Path, metrics: list[Metric], findings: list[Finding] | None = None
) -> Iterator[Results]:
    """The results of one run of the sweep `mine`."""
    with stored.logbook_at(folder) as logbook:
        sweep = logbook.begin_sweep("mine", "python -m runner experiment=mine", [], 1)
        run = logbook.begin_run(stored.start("ls"), sweep_id=sweep).run_id
        logbook.finish_run(run, stored.Results(metrics, [], findings or [], []))
    with open_results(f"sqlite:///{folder}/results.db") as results:
        yield results


def test_a_single_run_has_no_interval(tmp_path: Path, program: Program) -> None:
    with stored_sweep(tmp_path, [stored.force_mse(50.0)]) as results:
        (one,) = judged(results, [ONE])
    assert math.isnan(one.low)
    assert math.isnan(one.high)
    folder = written(tmp_path / "printed", LINE)
    code, out, _ = program("published", "--printed", folder, "--database", tmp_path / "results.db")
    assert code == 0
    assert "(n=1, no interval)" in out


def test_an_interval_wider_than_the_figure_says_so(results: Results) -> None:
    (one,) = judged(results, [replace(ONE, compare="value", printed=1.0, factor=0.02)])
    assert one.verdict == "reproduced"  # [0.91, 1.17]
    (one,) = judged(results, [replace(ONE, printed=52.0, factor=1.0, where="identifier=ls")])
    assert one.verdict == "reproduced"
    (wide,) = judged(results, [replace(ONE, compare="one", printed=1.01, factor=0.0195)])
    assert wide.verdict == "not reproduced"
    assert wide.reason == "the interval is too wide for the printed figure"


def test_a_reference_is_shown_with_its_ratio_and_not_judged(results: Results) -> None:
    (one,) = judged(results, [replace(ONE, printed=None, reference=104.0)])
    assert (one.verdict, one.ratio) == ("ours", 0.5)


def test_a_ratio_of_printed_figures_keeps_their_digits(tmp_path: Path) -> None:
    folder = written(tmp_path / "printed", LINE.replace(",100,", ",0.20/0.42,"))
    ((one,),) = read_folder(folder).values()
    assert one.printed == pytest.approx(0.20 / 0.42)
    ends = [(0.20 + i) / (0.42 + j) for i in (-0.005, 0.005) for j in (-0.005, 0.005)]
    assert one.rounding == pytest.approx(max(ends) - 0.20 / 0.42, rel=0.02)
    assert one.digits == "0.20/0.42"


def test_what_rounds_to_the_printed_decimals_is_reproduced(tmp_path: Path) -> None:
    folder = written(tmp_path / "printed", LINE.replace(",100,", ",-0.00,"))
    ((one,),) = read_folder(folder).values()
    assert verdict_of(one, -0.0049, (-0.0049, -0.0049), None) == "reproduced"
    assert verdict_of(one, 0.0051, (0.0051, 0.0051), None) == "not reproduced"


def written(folder: Path, *lines: str) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "mine.csv").write_text("\n".join([",".join(COLUMNS), *lines]) + "\n")
    (folder / "else.csv").write_text("a,b\n1,2\n")  # data of another kind is not ours to read
    return folder


LINE = (
    "Somebody (2020),Table 1,7,with model,MSE,100,,N^2,,identifier=ls,metric,validation,identified,"
    "surge,force_mse,,,lower,,,"
)


def test_a_page_does_not_replace_a_logbook(book: Path, tmp_path: Path, program: Program) -> None:
    database = book / "results.db"
    before = database.read_bytes()
    folder = written(tmp_path / "printed", LINE)
    words = ("published", "--printed", folder, "--database", database)
    code, _, err = program(*words, "--page", database)
    assert code == 2
    assert err.endswith("got a SQLite database, expected the name of the report\n")
    assert database.read_bytes() == before


def test_the_command_prints_and_writes_the_page(
    book: Path, tmp_path: Path, program: Program
) -> None:
    calibrated = LINE.replace(",,,lower,,,", ",,,lower,,calibrated,")
    folder = written(tmp_path / "printed", LINE, calibrated, LINE.replace(",100,,", ",,,"))
    page = tmp_path / "page" / "index.html"
    options = ("--printed", folder, "--database", book / "results.db")
    code, out, _ = program("published", *options, "--page", page, "-f", "json")
    assert code == 0
    first, second, third = json.loads(out)
    assert (first["printed"], first["ours"], first["verdict"]) == (100.0, 52.0, "beaten")
    assert (second["verdict"], second["information"]) == ("calibrated", "calibrated")
    assert (third["printed"], third["ours"], third["verdict"]) == (None, 52.0, "ours")
    text = page.read_text()
    assert "Somebody (2020)" in text
    assert "<svg" in text
    code, out, _ = program("published", *options, "--summary", "-f", "csv")
    assert out.splitlines() == [
        "source,table,experiment,beaten,reproduced,not reproduced,below the true model",
        "Somebody (2020),Table 1,mine,1,0,0,0",
        "",
        "source,table,experiment,verdict,figures,reason",
        "Somebody (2020),Table 1,mine,calibrated,1,gains and reference were fitted to the printed"
        " figures: see the ratios to our own nominal",
        "Somebody (2020),Table 1,mine,ours,1,no printed figure of the same experiment",
    ]


@pytest.mark.parametrize(("width", "mobile"), [(390, True), (1280, False)])
def test_the_page_of_all_printed_figures_opens_in_a_browser(
    browser: Any, book: Path, tmp_path: Path, program: Program, width: int, mobile: bool
) -> None:
    """Without complaints or requests, and with nothing that makes a phone scroll sideways."""
    printed = Path(shutil.copytree(FOLDER, tmp_path / "printed"))
    written(printed, LINE)  # one experiment that has run
    page = tmp_path / "index.html"
    options = ("--printed", printed, "--database", book / "results.db", "--page", page)
    assert program("published", *options, "--summary")[0] == 0
    open_page(browser, page, width, mobile)
    assert complaints(browser) == []
    assert browser.execute_script("return performance.getEntriesByType('resource').length") == 0
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    assert browser.execute_script("return innerWidth") == width
    text = browser.execute_script("return document.body.textContent")
    assert "Somebody (2020)" in text
    assert all(name in text for name in read_folder(printed))


@pytest.mark.parametrize(
    ("lines", "complaint"),
    [
        ([LINE.replace(",100,", ",many,")], "mine.csv, line 2: got 'many', expected a number"),
        (
            [LINE, LINE.replace("metric", "guess")],
            "mine.csv, line 3: source: got 'guess', expected",
        ),
        (
            [LINE.replace("lower", "least")],
            "mine.csv, line 2: compare: got 'least', expected value",
        ),
        ([LINE + ",more"], "mine.csv, line 2: expected 21 columns"),
    ],
)
def test_a_bad_line_is_named(
    tmp_path: Path, book: Path, program: Program, lines: list[str], complaint: str
) -> None:
    folder = written(tmp_path / "printed", *lines)
    code, out, err = program("published", "--printed", folder, "--database", book / "results.db")
    assert (code, out) == (2, "")
    assert complaint in err
    assert err.count("\n") == 1


def test_tables_are_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    folder = written(tmp_path / "printed", LINE)
    for name in ("table_4_10", "table_4_2", "table_12"):
        (folder / f"{name}.csv").write_text((folder / "mine.csv").read_text())
    assert list(read_folder(folder)) == ["mine", "table_4_2", "table_4_10", "table_12"]


def test_unknown_experiments_and_empty_folders(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="got 'yours', expected one of mine"):
        read_folder(written(tmp_path / "printed", LINE), "yours")
    (tmp_path / "empty").mkdir()
    with pytest.raises(ConfigurationError, match="no files of printed figures"):
        read_folder(tmp_path / "empty")
