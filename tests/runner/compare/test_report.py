"""The report page: what is in it, and how it behaves in a browser, on a desk and on a phone."""

import re
import shutil
from pathlib import Path
from typing import Any

import pytest

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import LogbookError
from seatrial.runner.compare.cli import TableOptions
from seatrial.runner.compare.frame import Queries, open_results
from seatrial.runner.compare.page import write_page
from seatrial.runner.compare.report import render_report
from seatrial.runner.database import LogbookWriter
from tests.runner.compare import stored
from tests.runner.compare.browsers import check_alone, check_phone, complaints, open_page
from tests.runner.compare.conftest import Program
from tests.runner.compare.test_command_line import database


@pytest.fixture(scope="session")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report of two sweeps' worth of runs, with failures, series and hostile texts."""
    folder = tmp_path_factory.mktemp("report")
    with stored.logbook_at(folder) as logbook:
        sweep = logbook.begin_sweep("night & day", "python -m runner -m seed=1,2", [], 12)
        begun = logbook.begin_run(stored.start("ridge"), sweep)
        error = "</code><script>document.title='stolen'</script>" + "long-word" * 40
        logbook.fail_run(begun.run_id, "failed", "ValueError", error, f"Traceback\n{error}")
        logbook.end_sweep(sweep)
        stored.fill_plain(logbook)
        stored.fill_sailed(logbook)
    file = folder / "report" / "report.html"
    with open_results(f"sqlite:///{folder}/results.db") as results:
        file.parent.mkdir()
        file.write_text(render_report(results, TableOptions(sweep="all")), encoding="utf-8")
    return file


def test_the_page_needs_no_network(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    check_alone(text)
    assert not re.search(r"url\((?!#)", text)
    assert "@import" not in text
    assert "default-src 'none'" in text


def test_failures_and_provenance_are_told_and_escaped(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert "<script>document.title" not in text
    assert "&lt;script&gt;document.title" in text
    assert "night &amp; day" in text
    assert "0123456789abcdef with uncommitted changes" in text
    assert "exceeds 3 at t = 12 s" in text
    assert text.count("<script>") == 1


def test_report_of_a_sweep_holds_its_runs_alone(program: Program, page: Path) -> None:
    folder = page.parent.parent
    code, out, _ = program("report", *database(folder), "--sweep", "1", "-o", folder / "one.html")
    assert code == 0
    text = Path(out.strip()).read_text(encoding="utf-8")
    assert "Sea trials, sweep 1" in text
    assert "Trials (1):" in text
    assert "singular matrix" not in text
    for words in (("--sweep", "7"), ("--where", "seed>99")):
        code, _, err = program("report", *database(folder), *words)
        assert (code, len(err.splitlines())) == (2, 1)


def test_a_page_that_is_not_complete_is_removed(tmp_path: Path) -> None:
    (tmp_path / "page.html").mkdir()
    with pytest.raises(LogbookError, match="cannot write the report"):
        write_page("page", tmp_path / "page.html")
    assert [file.name for file in tmp_path.iterdir()] == ["page.html"]


def test_a_damaged_series_is_told_on_the_page(page: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(page.parent.parent, tmp_path / "copy"))
    for file in (folder / "series").glob("*.parquet"):
        file.write_bytes(b"x")
    with open_results(f"sqlite:///{folder}/results.db") as results:
        request = TableOptions(sweep="all", where="vessel=milliampere and identifier=plsr")
        text = render_report(results, request)
    assert "Not drawn: Force residual of one run over time" in text


def test_the_page_opens_alone_and_its_tables_sort_by_a_click(browser: Any, page: Path) -> None:
    open_page(browser, page, 1280)
    assert complaints(browser) == []
    assert browser.title == "Sea trials"
    assert browser.execute_script("return performance.getEntriesByType('resource').length") == 0
    headings = browser.find_elements("css selector", "#result table thead button")
    calm = next(i for i, heading in enumerate(headings) if heading.text == "calm")
    for backwards in (False, True):
        headings[calm].click()
        texts = browser.execute_script(
            "return [...document.querySelector('#result table').tBodies[0].rows]"
            ".map((row) => row.cells[arguments[0]].textContent)", calm
        )  # fmt: skip
        values = [float(text.split()[0]) for text in texts if text[:1].isdigit()]
        assert values == sorted(values, reverse=backwards)
        assert len(values) > 2


def test_the_first_screen_answers(
    browser: Any, logbook: LogbookWriter, results: Queries, tmp_path: Path
) -> None:
    """Two controllers are one figure; with it and the first rows of the table the window ends."""
    for controller, scale in (("pid_ff", 1.0), ("lqi", 3.0)):
        for identifier, mean in (("none", 1.0), ("ls", 0.6), ("auto", 0.5)):
            for seed in range(3):
                begin = stored.start(identifier, seed=seed, controller=controller)
                stored.finish(logbook, begin, [stored.tracking(scale * mean + 0.01 * seed)])
    page = tmp_path / "report.html"
    page.write_text(render_report(results, TableOptions()), encoding="utf-8")
    for width, height, mobile in ((1280, 800, False), (390, 844, True)):
        open_page(browser, page, width, mobile, height)
        assert len(browser.find_elements("css selector", "#result figure")) == 1
        names = [one.text for one in browser.find_elements("css selector", "#result dt")]
        assert names[:2] == ["identifier", "controller"]
        assert {"vessel", "disturbance", "baseline", "failures"} <= {*names}
        heading = browser.find_elements("css selector", "#result thead th")
        assert [one.text for one in heading] == ["identifier", "lqi", "pid_ff"]
        rows = browser.find_elements("css selector", "#result tbody tr")
        seen = [row for row in rows if row.location["y"] + 10 < height]
        assert len(seen) >= (3 if width == 1280 else 1)
        answer = browser.find_element("css selector", ".answer").text
        assert answer.startswith("pid_ff: auto has a position MAE of 0.510 m, 2.0 times less")
    check_phone(browser, page)


def test_warnings_of_the_runs_are_on_the_page_and_in_show(
    program: Program, logbook: LogbookWriter, results: Queries, folder: Path
) -> None:
    text = "identified model: the closed loop's spectral radius is 1.0245, expected less than 1"
    for seed in range(2):
        warning = Diagnostic("warning", "all", None, label=text)
        figures = [stored.tracking(1.0), stored.deployed("spectral_radius", 1.0245)]
        stored.finish(logbook, stored.start(seed=seed), figures, diagnostics=[warning])
    page = render_report(results, TableOptions(sweep="all"))
    assert "the closed loop&#39;s spectral radius is 1.0245" in page
    assert "expected less than 1 (runs 1, 2)" in page
    assert 'href="#warnings"' in page
    assert "&#8225;" in page or "‡" in page  # and its figures are marked
    assert "spectral radius is 1.0245" in program("show", "2", *database(folder))[1]


def test_what_differs_in_too_much_is_said_where_it_would_stand(
    logbook: LogbookWriter, results: Queries
) -> None:
    for i in range(16):
        config = {name: i >> bit & 1 for bit, name in enumerate("abcd")}
        stored.finish(logbook, stored.start(config=config), [stored.force_mse(1.0 + i)])
    text = render_report(results, TableOptions(sweep="all"))
    tables, figures = text.split('id="figures"')
    why = "would average over a, b, c, d: name them in --rows or --columns"
    what = "Force residual on the held-out part"
    assert tables.count(f"Not shown: {what}: the cells of this table {why}") == 1
    assert figures.count(f"Not drawn: {what}: the groups of this figure {why}") == 1
    assert "None of these runs" not in tables
