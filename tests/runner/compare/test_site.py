"""The site in a browser, without a network: filter, sort, overlay, failures, hostile names."""

import json
import re
import shlex
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import pytest

from seatrial.models.errors import LogbookError
from seatrial.runner.compare.frame import open_results
from seatrial.runner.compare.grid import number_text
from seatrial.runner.compare.site import script_of, write_site
from tests.benchmarks.filled import fill
from tests.runner.compare import stored
from tests.runner.compare.browsers import check_phone, complaints
from tests.runner.compare.conftest import Program

T = TypeVar("T")
HOSTILE = (
    "</script><script>document.title='stolen'</script>",
    "<img src=x onerror=\"document.title='stolen'\">",
    "\u2028\u2029',\"]});document.title='stolen';//",
    "\u202egnp.exe \x1b[31m $& ${7*7} {{7*7}}",
)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The site of the runs of `fill_plain` and `fill_sailed`, in one sweep and without one."""
    folder = tmp_path_factory.mktemp("site")
    with stored.logbook_at(folder) as logbook:
        stored.fill_plain(logbook)
        stored.fill_sailed(logbook)
    with open_results(f"{folder}/results.db") as results:
        return write_site(results, folder / "site", f"{folder}/results.db", 100)


@pytest.fixture
def offline(browser: Any) -> Any:
    """The browser without a network, with an empty log."""
    browser.execute_cdp_cmd("Network.enable", {})
    conditions = {"offline": True, "latency": 0, "downloadThroughput": 0, "uploadThroughput": 0}
    browser.execute_cdp_cmd("Network.emulateNetworkConditions", conditions)
    view = {"width": 1280, "height": 844, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", view)
    browser.get_log("browser")
    yield browser
    assert complaints(browser) == []
    browser.execute_cdp_cmd("Network.disable", {})


def until(answer: Callable[[], T], seconds: float = 20.0) -> T:
    """The first answer that is true, or the last one."""
    end = time.monotonic() + seconds
    while not (got := answer()) and time.monotonic() < end:
        time.sleep(0.05)
    return got


def settle(browser: Any) -> None:
    """Wait until the view of the address is shown."""
    shown = "return document.body.dataset.shown === location.hash"
    assert until(lambda: browser.execute_script(shown)), browser.page_source[:3000]


def show(browser: Any, page: Path, address: str = "") -> None:
    """Open a page of the site and wait for its view."""
    browser.get("about:blank")
    browser.get(f"{page.as_uri()}#{address}")
    settle(browser)


def click(browser: Any, selector: str) -> None:
    element = until(lambda: browser.find_elements("css selector", selector))[0]
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", element)
    element.click()
    settle(browser)


def rows_of(browser: Any, table: str) -> list[list[str]]:
    """The texts of a table, row by row."""
    rows = browser.find_element("css selector", table).find_elements("tag name", "tr")
    return [[c.text for c in row.find_elements("css selector", "th, td")] for row in rows]


def test_the_pages_ask_for_nothing_outside(site: Path) -> None:
    pages = sorted(site.parent.glob("*.html"))
    assert {"index.html", "runs.html", "run-18.html", "sweep-all.html"} <= {p.name for p in pages}
    for file in pages:
        text = file.read_text(encoding="utf-8")
        assert not re.search(r"\bfetch\(|XMLHttpRequest|import\(", text), file
        assert not re.search(r"innerHTML|outerHTML|document\.write|eval\(", text), file
        loaded = re.findall(r'(?:src|href)="([^"#]+)[^"]*"', text)
        assert all((site.parent / name).is_file() for name in loaded if name != "data:,"), file


def test_a_script_holds_any_text() -> None:
    for text in (*HOSTILE, "\ud800", "\x00"):
        script = script_of("x", {"text": text})
        assert script.isascii()
        assert "<" not in script
        told = script.removeprefix('(window.seatrial ??= {})["x"] = ').removesuffix(";\n")
        assert json.loads(told) == {"text": text}


@pytest.mark.slow
def test_tables_are_those_of_their_commands_and_headings_sort(
    offline: Any, site: Path, program: Program
) -> None:
    offline.get(site.as_uri())
    assert "plsr has a force MSE of 400" in offline.find_element("css selector", ".answer").text
    command = offline.find_element("css selector", "#result pre").text
    code, out, _ = program(*shlex.split(command)[3:], "--format", "json")
    assert code == 0
    (header, *rows), records = rows_of(offline, "#result table"), json.loads(out)
    last = [row["mean"] for row in records if row["disturbance"] == header[-1]]
    assert [row[-1].split()[0] for row in rows if row[-1]] == [*map(number_text, last)]
    offline.find_elements("css selector", "#result thead button")[-1].click()
    shown = [row[-1].split()[0] for row in rows_of(offline, "#result table")[1:] if row[-1]]
    assert shown == [*map(number_text, sorted(last))]


@pytest.mark.slow
def test_runs_are_filtered_and_sorted_and_the_command_selects_the_same(
    offline: Any, site: Path, program: Program
) -> None:
    show(offline, site.parent / "runs.html")
    everything = len(rows_of(offline, "#list table"))
    click(offline, "#filters summary")
    place = next(
        one.get_attribute("id")
        for one in offline.find_elements("css selector", "input[id^=filter-identifier-]")
        if one.find_element("xpath", "..").text == "ls"
    )
    click(offline, f"#{place}")
    header, *rows = rows_of(offline, "#list table")
    assert 0 < len(rows) < everything - 1
    assert {row[header.index("identifier")] for row in rows} == {"ls"}
    runs, table = offline.find_element("css selector", ".commands").text.splitlines()
    code, out, _ = program(*shlex.split(runs)[3:], "--format", "json")
    assert (code, [str(row["run_id"]) for row in json.loads(out)]) == (0, [row[0] for row in rows])
    assert program(*shlex.split(table)[3:])[0] == 0
    click(offline, "#sort-value")
    header, *rows = rows_of(offline, "#list table")
    values = [float(row[1]) for row in rows if row[1] != "–"]
    assert values == sorted(values)
    assert len(values) > 2


def test_runs_are_overlaid_and_a_run_shows_numbers_and_figures(offline: Any, site: Path) -> None:
    show(offline, site.parent / "runs.html", "runs=18,20")
    titles = [one.text for one in offline.find_elements("css selector", "figcaption")]
    for title in ("Track", "Position error", "Heading error", "Force residual"):
        assert any(text.startswith(title) for text in titles), titles
    place = titles.index("Position error over time")
    errors = offline.find_elements("css selector", "figure")[place]
    names = errors.find_element("css selector", ".legend").text.splitlines()
    assert [name[:6] for name in names] == ["run 18", "run 20"]
    offline.get((site.parent / "run-18.html").as_uri())
    drawn = [one.text for one in offline.find_elements("css selector", "figure")]
    assert any("nominal\nidentified" in text for text in drawn), drawn
    headings = [one.text for one in offline.find_elements("css selector", "h2")]
    assert headings[:3] == ["Result", "Figures", "Metrics"]
    assert headings[-2:] == ["Configuration", "Provenance"]


def test_a_failure_is_told_with_its_traceback(offline: Any, site: Path) -> None:
    offline.get((site.parent / "sweep-all.html").as_uri())
    summaries = [one.text for one in offline.find_elements("css selector", "#failures summary")]
    assert len(summaries) == 2
    assert "|r| = 9 rad/s exceeds 3 at t = 12 s" in summaries[1]
    assert "singular matrix" in summaries[0]
    offline.find_elements("css selector", "#failures summary")[0].click()
    body = offline.find_element("css selector", "#failures pre").text
    assert body == "Traceback: here\nValueError"
    told = [file.read_text() for file in (site.parent / "data").glob("run-*.js")]  # for overlays
    assert any("failed, without series" in text for text in told)


@pytest.mark.slow
def test_hostile_names_are_shown_and_do_nothing(
    offline: Any, tmp_path: Path, program: Program
) -> None:
    with stored.logbook_at(tmp_path) as logbook:
        name, command, tag, note = HOSTILE
        sweep = logbook.begin_sweep(name, command, [], 8, tags=[tag], note=note)
        for seed, name in enumerate(HOSTILE):
            config = {HOSTILE[0]: name, "plant": {"scale": name}}
            begin = stored.start(name, HOSTILE[-1 - seed], seed, vessel=name, config=config)
            odd = stored.Metric("validation", "identified", name, name, 1.0, name)
            terms = [stored.coefficient(name, 1.0, 0.1, 2.0, unit=name)]
            stored.finish(logbook, begin, [stored.force_mse(2.0), odd], terms, sweep=sweep)
            stored.fail(logbook, stored.start(name, seed=seed + 9), error=name)
    with open_results(f"{tmp_path}/results.db") as results:
        page = write_site(results, tmp_path / "site", f"{tmp_path}/results.db", 100)
    for name in ("index", "sweep-all", "run-1", "run-8"):
        offline.get((page.parent / f"{name}.html").as_uri())
        harmless(offline)
    show(offline, page.parent / "runs.html", "runs=1,3,5,7")
    harmless(offline)
    click(offline, "#filters summary")
    click(offline, "input[id^=filter-identifier-]")
    _, table = offline.find_element("css selector", ".commands").text.splitlines()
    code, out, err = program(*shlex.split(table)[3:], "--format", "json")
    assert (code, err) == (0, "")
    assert json.loads(out)


def harmless(browser: Any) -> None:
    """The texts of the page that is open did nothing."""
    assert browser.title != "stolen"
    assert browser.find_elements("css selector", "main img, main script") == []
    assert "\u202e" not in browser.find_element("tag name", "body").text


def test_no_page_scrolls_sideways_on_a_phone(offline: Any, site: Path) -> None:
    for name in ("index", "sweep-all", "run-18"):
        check_phone(offline, site.parent / f"{name}.html")
    show(offline, site.parent / "runs.html")
    check_phone(offline, site.parent / "runs.html", "#list table")


def test_only_a_folder_of_its_own_is_written(tmp_path: Path, plain: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with open_results(f"{plain}/results.db") as results:
        with pytest.raises(LogbookError, match="got a folder with files"):
            write_site(results, tmp_path, "results.db", 1)
        with pytest.raises(LogbookError, match="cannot write the site"):
            write_site(results, tmp_path / "notes.txt", "results.db", 1)
        index = write_site(results, tmp_path / "new", "results.db", 2)
        old = index.parent / "data" / "run-9999.js"
        old.touch()
        write_site(results, tmp_path / "new", "results.db", 2)
    assert not old.exists()
    assert len(list((index.parent / "data").glob("run-*.js"))) == 2
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_an_empty_logbook_has_a_page(offline: Any, tmp_path: Path) -> None:
    stored.logbook_at(tmp_path).close()
    with open_results(f"{tmp_path}/results.db") as results:
        page = write_site(results, tmp_path / "site", "results.db", 1)
    offline.get(page.as_uri())
    assert "No runs in the logbook yet" in offline.find_element("tag name", "header").text


@pytest.mark.nightly
def test_the_pages_of_ten_thousand_runs_are_light(offline: Any, tmp_path: Path) -> None:
    """They open in a second: few bytes on the disk, few elements, however many runs."""
    with open_results(f"sqlite:///{fill(tmp_path, 10_000)}") as results:
        page = write_site(results, tmp_path / "site", f"{tmp_path}/results.db", 1)
    assert (page.parent / "data" / "runs.js").stat().st_size < 1_000_000
    for name in ("index.html", "runs.html"):
        assert (page.parent / name).stat().st_size < 600_000
        offline.get((page.parent / name).as_uri())
        elements = "return document.getElementsByTagName('*').length"
        assert 100 < offline.execute_script(elements) < 8_000
        table = offline.find_element("css selector", "main table")
        assert table.location["y"] < 844
