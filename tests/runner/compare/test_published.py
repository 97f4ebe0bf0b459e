"""Printed figures beside ours: reading, choosing, judging, showing."""

import json
import math
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.models.vessel.basis import terms
from seatrial.runner.compare.published import (
    COLUMNS,
    FOLDER,
    Printed,
    judged,
    read_folder,
    verdict_of,
)
from seatrial.runner.compare.results import Results, open_results
from seatrial.runner.hydra_errors import CONF
from tests.runner.compare import stored
from tests.runner.compare.browsers import complaints, open_page
from tests.runner.compare.conftest import Program

ONE = Printed(
    experiment="mine", document="Somebody (2020)", table="Table 1", page="7", row="with model",
    quantity="MSE", printed=100.0, unit="N^2", way="", where="identifier=ls", source="metric",
    stage="validation", model="identified", dof="surge", name="force_mse", label="", factor=1.0,
    compare="lower", statistic="", information="", note="",
)  # fmt: skip


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
    ("compare", "value", "interval", "truth", "verdict"),
    [
        ("lower", 90.0, (85.0, 94.0), None, "beaten"),
        ("lower", 90.0, (85.0, 96.0), None, "not reproduced"),  # the interval reaches into 5 %
        ("lower", 96.0, (96.0, 96.0), None, "reproduced"),
        ("lower", 150.0, (99.0, 201.0), None, "reproduced"),
        ("lower", 150.0, (149.0, 151.0), None, "not reproduced"),
        ("higher", 150.0, (149.0, 151.0), None, "beaten"),
        ("higher", 50.0, (49.0, 51.0), None, "not reproduced"),
        ("value", 50.0, (49.0, 51.0), None, "not reproduced"),
        ("value", 104.0, (104.0, 104.0), None, "reproduced"),
        ("truth", 61.0, (60.0, 62.0), 60.0, "beaten"),
        ("truth", 61.0, (10.0, 112.0), 60.0, "reproduced"),  # too wide to beat, and holds 100
        ("truth", 10.0, (9.0, 11.0), 60.0, "not reproduced"),
        ("none", 10.0, (9.0, 11.0), None, "ours"),
    ],
)
def test_verdicts(
    compare: str,
    value: float,
    interval: tuple[float, float],
    truth: float | None,
    verdict: str,
) -> None:
    assert verdict_of(replace(ONE, compare=compare), value, interval, truth) == verdict


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
    "Somebody (2020),Table 1,7,with model,MSE,100,N^2,,identifier=ls,metric,validation,identified,"
    "surge,force_mse,,,lower,,,"
)


def test_the_command_prints_and_writes_the_page(
    book: Path, tmp_path: Path, program: Program
) -> None:
    calibrated = LINE.replace(",,,lower,,,", ",,,lower,,calibrated,")
    folder = written(tmp_path / "printed", LINE, calibrated, LINE.replace(",100,", ",,"))
    page = tmp_path / "page" / "index.html"
    options = ("--printed", folder, "--database", book / "results.db")
    code, out, _ = program("published", *options, "--page", page, "-f", "json")
    assert code == 0
    first, second, third = json.loads(out)
    assert (first["printed"], first["ours"], first["verdict"]) == (100.0, 52.0, "beaten")
    assert second["information"] == "calibrated"
    assert (third["printed"], third["ours"], third["verdict"]) == (None, 52.0, "ours")
    text = page.read_text()
    assert "Somebody (2020)" in text
    assert "<svg" in text
    code, out, _ = program("published", *options, "--summary", "-f", "csv")
    assert out.splitlines() == [
        "source,table,experiment,beaten,ours",
        "Somebody (2020),Table 1,mine,2,1",
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
        ([LINE + ",more"], "mine.csv, line 2: expected 20 columns"),
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


def test_every_figure_that_can_be_answered_has_its_experiment() -> None:
    for name, figures in read_folder(FOLDER).items():
        answerable = any(one.source for one in figures)
        assert (CONF / "experiment" / f"{name}.yaml").exists() == answerable, name
        for one in figures:
            assert one.source or one.note, f"{name}: {one.row}, {one.quantity} lacks a reason"


def test_every_printed_coefficient_is_one_of_a_term() -> None:
    """A term that is misspelt would not be found in the results, and be taken for zero."""
    names = {
        one.name
        for figures in read_folder(FOLDER).values()
        for one in figures
        if one.source == "coefficient"
    }
    assert {one.name for one in terms(sorted(names))} == names
