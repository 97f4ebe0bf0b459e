"""The report page: what is in it, and how it behaves in a browser, on a desk and on a phone."""

import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import LogbookError
from seatrial.runner.compare import page as page_module
from seatrial.runner.compare.page import write_page
from seatrial.runner.compare.report import TABLES, ReportRequest, render_report
from seatrial.runner.compare.results import open_results
from seatrial.runner.record.catalogue import all_declared, definition_of
from tests.runner.compare import stored
from tests.runner.compare.browsers import complaints, open_page
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
        file.write_text(render_report(results, ReportRequest(sweep="all")), encoding="utf-8")
    return file


def test_the_page_needs_no_network(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    links = re.findall(r'(?:src|href|action|data)\s*=\s*["\']?([^"\'> ]+)', text)
    assert links
    assert all(link.startswith(("#", "data:")) for link in links)
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


def test_ids_are_unique_and_every_reference_is_met(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    ids = re.findall(r'\sid="([^"]+)"', text)
    assert len(ids) == len(set(ids))
    references = set(re.findall(r'href="#([^"]+)"|url\(#([^)]+)\)', text))
    assert {one or other for one, other in references} <= set(ids)


def test_report_of_a_sweep_holds_its_runs_alone(program: Program, page: Path) -> None:
    folder = page.parent.parent
    code, out, _ = program("report", *database(folder), "--sweep", "1", "-o", folder / "one.html")
    assert code == 0
    text = Path(out.strip()).read_text(encoding="utf-8")
    assert "Sea trials, sweep 1" in text
    assert "1 run:" in text
    assert "singular matrix" not in text
    code, _, err = program("report", *database(folder), "--sweep", "7")
    assert (code, len(err.splitlines())) == (2, 1)
    code, _, err = program("report", *database(folder), "--where", "seed>99")
    assert (code, len(err.splitlines())) == (2, 1)


def test_a_report_that_cannot_be_written_is_one_line(program: Program, plain: Path) -> None:
    code, _, err = program("report", *database(plain), "-o", plain / "results.db" / "x.html")
    assert (code, len(err.splitlines())) == (2, 1)


def test_a_page_that_is_not_complete_is_removed(tmp_path: Path) -> None:
    (tmp_path / "page.html").mkdir()
    with pytest.raises(LogbookError, match="cannot write the report"):
        write_page("page", tmp_path / "page.html")
    assert [file.name for file in tmp_path.iterdir()] == ["page.html"]


def test_a_damaged_series_is_told_on_the_page(page: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(page.parent.parent, tmp_path / "copy"))
    for file in (folder / "series").glob("*-residual-*.parquet"):
        file.write_bytes(b"x")
    with open_results(f"sqlite:///{folder}/results.db") as results:
        request = ReportRequest(sweep="all", where="vessel=milliampere and identifier=plsr")
        text = render_report(results, request)
    assert "Not drawn: Force residual of a typical run" in text


def _column(browser: Any, table: int, column: int) -> list[str]:
    script = (
        "return [...document.querySelectorAll('#tables table')[arguments[0]].tBodies[0].rows]"
        ".map((row) => row.cells[arguments[1]].textContent)"
    )
    texts: list[str] = browser.execute_script(script, table, column)
    return texts


def test_the_page_opens_without_complaints_or_requests(browser: Any, page: Path) -> None:
    open_page(browser, page, 1280)
    assert complaints(browser) == []
    assert browser.title == "Sea trials"
    entries = browser.execute_script("return performance.getEntriesByType('resource').length")
    assert entries == 0


def test_tables_sort_by_a_click_and_back(browser: Any, page: Path) -> None:
    open_page(browser, page, 1280)
    identifiers = _column(browser, 0, 1)
    headings = browser.find_elements("css selector", "#tables table:first-of-type thead button")
    calm = next(i for i, heading in enumerate(headings) if heading.text == "calm")
    headings[calm].click()
    values = [float(text.split()[0]) for text in _column(browser, 0, calm) if text[:1].isdigit()]
    assert values == sorted(values)
    assert _column(browser, 0, 1) != identifiers
    headings[calm].click()
    values = [float(text.split()[0]) for text in _column(browser, 0, calm) if text[:1].isdigit()]
    assert values == sorted(values, reverse=True)
    headings[1].click()
    assert _column(browser, 0, 1) == sorted(identifiers)


@pytest.mark.parametrize(("width", "mobile"), [(390, True), (320, True), (1280, False)])
def test_nothing_but_wide_tables_and_figures_scrolls_sideways(
    browser: Any, page: Path, width: int, mobile: bool
) -> None:
    open_page(browser, page, width, mobile)
    browser.execute_script("document.querySelectorAll('details').forEach((d) => { d.open = true })")
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    assert browser.execute_script("return document.body.scrollWidth") <= width
    assert browser.execute_script("return innerWidth") == width  # no zooming out to fit


def test_figures_are_visible_and_legible_on_a_phone(browser: Any, page: Path) -> None:
    open_page(browser, page, 390, mobile=True)
    sizes = browser.execute_script(
        "return [...document.querySelectorAll('figure svg')].map((svg) => {"
        " const box = svg.getBoundingClientRect();"
        " return [box.width, box.height, box.width / svg.viewBox.baseVal.width] })"
    )
    assert len(sizes) >= 12
    for width, height, scale in sizes:
        assert width > 300
        assert height > 150
        assert scale * 10.0 >= 9.0  # the 10 pt letters of the figures [CSS px]
    size = browser.execute_script("return getComputedStyle(document.body).fontSize")
    assert size == "16px"


def test_warnings_of_the_runs_are_on_the_page_and_in_show(program: Program, tmp_path: Path) -> None:
    text = "identified model: the closed loop's spectral radius is 1.0245, expected less than 1"
    with stored.logbook_at(tmp_path) as logbook:
        for seed in range(2):
            warning = Diagnostic("warning", "all", None, label=text)
            figures = [stored.tracking(1.0), stored.deployed("spectral_radius", 1.0245)]
            stored.finish(logbook, stored.start(seed=seed), figures, diagnostics=[warning])
    with open_results(f"sqlite:///{tmp_path}/results.db") as opened:
        page = render_report(opened, ReportRequest(sweep="all"))
    assert "the closed loop&#39;s spectral radius is 1.0245" in page
    assert "expected less than 1 (runs 1, 2)" in page
    assert 'href="#warnings"' in page
    assert "&#8225;" in page or "‡" in page  # and its figures are marked
    _, out, _ = program("show", "2", "--database", f"sqlite:///{tmp_path}/results.db")
    assert "spectral radius is 1.0245" in out


def test_what_differs_in_too_much_is_said_where_it_would_stand(tmp_path: Path) -> None:
    with stored.logbook_at(tmp_path) as logbook:
        for i in range(16):
            config = {name: i >> bit & 1 for bit, name in enumerate("abcd")}
            stored.finish(logbook, stored.start(config=config), [stored.force_mse(1.0 + i)])
    with open_results(f"sqlite:///{tmp_path}/results.db") as opened:
        text = render_report(opened, ReportRequest(sweep="all"))
    tables, figures = text.split('id="figures"')
    why = "would average over a, b, c, d: name them in --rows or --columns"
    what = "Force residual on the held-out part"
    assert tables.count(f"Not shown: {what}: the cells of this table {why}") == 1
    assert figures.count(f"Not drawn: {what}: the groups of this figure {why}") == 1
    assert "None of these runs" not in tables


def test_every_table_has_a_heading() -> None:
    headings = {name: definition_of(name).heading for name in TABLES}
    assert headings["velocity_rmse_one_step"] == "Velocity RMSE, one step (hides bias)"
    assert headings["force_mse"] == "Force residual on the held-out part"
    assert all(headings.values())


def test_without_warnings_there_is_no_section_of_them(page: Path) -> None:
    assert 'id="warnings"' not in page.read_text(encoding="utf-8")


@pytest.mark.slow
def test_tables_on_a_phone_show_values_beside_their_names(browser: Any, page: Path) -> None:
    """The first column stays where it is; what is cut off at the right is announced."""
    open_page(browser, page, 390, mobile=True)
    browser.execute_script("document.querySelectorAll('details').forEach((d) => { d.open = true })")
    boxes = browser.execute_script(
        "return [...document.querySelectorAll('#tables .scroll')].map((box) => {"
        " const row = box.querySelector('tbody tr'), value = row.querySelector('td');"
        " const first = value.getBoundingClientRect(), cut = box.scrollWidth > box.clientWidth + 2;"
        " const said = box.classList.contains('more');"
        " box.scrollLeft = 60;"
        " const name = row.cells[0].getBoundingClientRect();"
        " const left = name.left - box.getBoundingClientRect().left;"
        " return [first.left, first.right, cut, said, left] })"
    )
    assert len(boxes) == 3
    for left, right, cut, said, moved in boxes:
        assert left < 200
        assert right <= 390
        assert cut == said
        assert abs(moved) < 1.0
    assert any(cut for _, _, cut, _, _ in boxes)


@pytest.mark.slow
def test_the_cue_goes_when_the_last_column_is_seen(browser: Any, page: Path) -> None:
    open_page(browser, page, 390, mobile=True)
    cue = browser.execute_async_script(
        "const done = arguments[0], box = document.querySelector('#tables .scroll');"
        "const before = box.classList.contains('more'); box.scrollLeft = 1e4;"
        "setTimeout(() => done([before, box.classList.contains('more')]), 200)"
    )
    assert cue == [True, False]


@pytest.mark.slow
def test_nothing_is_cut_on_a_desk(browser: Any, page: Path) -> None:
    open_page(browser, page, 1280)
    browser.execute_script("document.querySelectorAll('details').forEach((d) => { d.open = true })")
    wide = browser.execute_script(
        "return [...document.querySelectorAll('.scroll')].filter((box) =>"
        " box.scrollWidth > box.clientWidth + 1).length"
    )
    assert wide == 0


def test_names_on_the_page_are_words(page: Path) -> None:
    """But for settings and commands, which are typed as they are."""
    text = page.read_text(encoding="utf-8")
    tables = text.split('id="tables"')[1].split('id="figures"')[0]
    listed = text.split('id="runs"')[1]
    shown = [re.sub(r"<[^>]+>", " ", part) for part in (tables, listed)]
    keys = {definition.name for definition in all_declared() if "_" in definition.name}
    for part in shown:
        assert not keys & set(re.findall(r"\w+", part))
        assert not {"dof", "run_id", "started_at", "duration_s"} & set(re.findall(r"\w+", part))


def test_a_thinned_line_has_the_extremes_of_the_line() -> None:
    t = np.arange(50_000.0)
    y = np.random.default_rng(3).normal(size=len(t))
    y[12_345], y[44_444] = 40.0, -40.0
    figure = Figure()
    (line,) = figure.subplots().plot(t, y)
    page_module.thin(figure)
    x, thinned = line.get_data()
    assert len(x) <= 2 * page_module.THINNED_COLUMNS + 2
    assert (x[0], x[-1]) == (t[0], t[-1])
    assert np.all(np.diff(x) > 0.0)
    np.testing.assert_array_equal(thinned, y[np.asarray(x, dtype=int)])
    assert (np.max(thinned), np.min(thinned)) == (40.0, -40.0)
    width = t[-1] / page_module.THINNED_COLUMNS
    for k in range(0, page_module.THINNED_COLUMNS, 97):  # the envelope of any column of pixels
        inside = (t >= k * width) & (t < (k + 1) * width)
        shown = (x >= k * width) & (x < (k + 1) * width)
        assert np.max(thinned[shown]) == pytest.approx(np.max(y[inside]), abs=1e-12)
