"""The site in a browser, without a network: filter, sort, overlay, links, failures, commands."""

import json
import re
import shlex
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import pytest

from seatrial.models.errors import LogbookError
from seatrial.runner.compare.results import open_results
from seatrial.runner.compare.site import contents, write_site
from seatrial.runner.compare.site.measures import StoredMeasures
from seatrial.runner.compare.site.scripts import metric_script, script_of
from seatrial.runner.compare.site.static_folder import assets
from seatrial.runner.database import LogbookWriter
from tests.runner.compare import stored
from tests.runner.compare.browsers import complaints
from tests.runner.compare.conftest import Program
from tests.runner.compare.site_pages import cells_of, close, commands_of, settle, show, until
from tests.runner.postgres import Postgres

MOST_BYTES = 4_000_000
HOSTILE = (
    "</script><script>document.title='stolen'</script>",
    "<img src=x onerror=\"document.title='stolen'\">",
    "\u2028\u2029',\"]});document.title='stolen';//",
    "\u202egnp.exe \x1b[31m $& ${7*7} {{7*7}}",
)
# Whether each figure of the page has lines or marks: pixels with a colour.
COLOURED = """return [...document.querySelectorAll('.plot canvas')].map((canvas) => {
  const copy = new OffscreenCanvas(canvas.width, canvas.height);
  const context = copy.getContext('2d', { willReadFrequently: true });
  context.drawImage(canvas, 0, 0);
  const data = context.getImageData(0, 0, canvas.width, canvas.height).data;
  let count = 0;
  for (let i = 0; i < data.length; i += 4) {
    const channels = [data[i], data[i + 1], data[i + 2]];
    if (data[i + 3] > 100 && Math.max(...channels) - Math.min(...channels) > 80) count += 1;
  }
  return count > 20;
})"""


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


def click(browser: Any, selector: str) -> None:
    element = until(lambda: browser.find_elements("css selector", selector))[0]
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", element)
    element.click()
    settle(browser)


def tick(browser: Any, factor: str, level: str) -> None:
    """Tick a level of a filter."""
    legend = f"//fieldset[legend='{factor}']"
    browser.find_element("xpath", f"{legend}//label[normalize-space()='{level}']/input").click()
    settle(browser)


def choose(browser: Any, name: str, value: str) -> None:
    """Choose an option as a user does with the keyboard: select and change."""
    from selenium.webdriver.support.select import Select

    Select(browser.find_element("id", name)).select_by_value(value)
    settle(browser)


def cell_texts(browser: Any) -> list[list[str]]:
    """The texts of the first table, row by row."""
    rows = browser.find_elements("css selector", "main table tr")
    return [[c.text for c in row.find_elements("css selector", "th, td")] for row in rows]


def test_the_page_asks_for_nothing_outside() -> None:
    files = assets()
    assert sum(map(len, files.values())) < MOST_BYTES
    assert b"Permission is hereby granted" in files["uPlot.LICENSE"]
    index = files["index.html"].decode()
    loaded = re.findall(r'(?:src|href)="([^"#]+)"', index)
    assert {name.removeprefix("assets/") for name in loaded if name != "data:,"} == {
        name for name in files if name.endswith((".js", ".css"))
    }
    for name, content in files.items():
        if not name.startswith("uPlot"):
            text = content.decode()
            assert not re.search(r"https?://|\bfetch\(|XMLHttpRequest|import\(", text), name
            assert not re.search(r"innerHTML|outerHTML|document\.write|eval\(", text), name


def test_a_script_holds_any_text() -> None:
    for text in (*HOSTILE, "\ud800", "\x00"):
        script = script_of("data/x.js", {"text": text})
        assert script.isascii()
        assert "<" not in script
        told = script.removeprefix('seatrial.receive("data/x.js", ').removesuffix(");\n")
        assert json.loads(told) == {"text": text}
    assert re.fullmatch(r"data/metric-[0-9a-f]{16}\.js", metric_script("../../\ud800/x"))


@pytest.mark.slow
def test_filter_sort_and_the_same_figures_by_the_command(
    offline: Any, site: Path, program: Program
) -> None:
    show(offline, site.as_uri(), "sweep=all&metric=force_mse&dof=surge&where.evaluation=replay")
    assert [row[0] for row in cell_texts(offline)[1:]] == ["none", "dsr", "iv", "ls", "nsga2",
                                                            "plsr", "surface"]  # fmt: skip
    click(offline, "#filters summary")
    for name in ("none", "ls", "plsr"):
        tick(offline, "Identifier", name)
    assert {row[0] for row in cell_texts(offline)[1:]} == {"none", "ls", "plsr"}
    assert "where.identifier=plsr" in offline.current_url
    click(offline, "thead th:nth-child(2) button")
    click(offline, "thead th:nth-child(2) button")
    assert [row[0] for row in cell_texts(offline)[1:]] == ["none", "ls", "plsr"]  # 102, 52, 41
    click(offline, "thead th:nth-child(2) button")
    assert [row[0] for row in cell_texts(offline)[1:]] == ["plsr", "ls", "none"]
    assert "102.0\n± 2.0\n[97.03, 107.0]\nn=3" in cell_texts(offline)[3][1]  # t of 2: 4.303
    (line,) = (line for line in commands_of(offline) if " table " in line)
    address = offline.current_url
    click(offline, "tbody tr:last-child td:nth-child(2) a")  # none in calm water: its runs
    assert {(row[3], row[4]) for row in cell_texts(offline)[1:]} == {("calm", "none")}
    offline.get(address)
    settle(offline)
    code, out, err = program(*shlex.split(line)[3:], "--format", "json")
    assert (code, err) == (0, "")
    names = ("identifier", "disturbance")
    cells = cells_of(offline) or []
    shown = {tuple(cell["levels"][name] for name in names): cell for cell in cells}
    told = {tuple(row[name] for name in names): row for row in json.loads(out)}
    assert set(told) == set(shown)
    for key, row in told.items():
        assert row["n"] == shown[key]["n"]
        for name in ("mean", "ci_low", "ci_high"):
            assert close(row[name], shown[key][name])


def test_coefficients_by_two_factors_are_those_of_the_command(
    offline: Any, site: Path, program: Program
) -> None:
    show(offline, site.as_uri(), "sweep=all&columns=none&where.vessel=milliampere")
    choose(offline, "metric", "coefficient:u_dot")
    texts = cell_texts(offline)
    assert texts[0][0].startswith("Identifier")
    (cell,) = [row[-1] for row in texts[1:] if row[0].startswith("plsr")][:1]
    assert cell == "1041\n± 1.0\n[1039, 1043]\nse 3.0 of the estimate, true 1050\nn=3"
    assert until(lambda: offline.execute_script(COLOURED) == [True])
    for line in commands_of(offline):
        code, _, err = program(*shlex.split(line)[3:])
        assert (code, err) == (0, "")


@pytest.mark.slow
def test_a_link_restores_the_view_in_another_window(offline: Any, site: Path) -> None:
    show(offline, site.as_uri(), "sweep=all")
    choose(offline, "metric", "force_mse")
    choose(offline, "dof", "surge")
    choose(offline, "columns", "none")
    choose(offline, "rows", "disturbance")
    before, address = cell_texts(offline), offline.current_url
    assert before[0] == ["Disturbance, Identifier", "Value"]  # split: runs of a cell differ
    first = offline.current_window_handle
    offline.switch_to.new_window("tab")
    try:
        offline.get(address)
        settle(offline)
        assert cell_texts(offline) == before
    finally:
        offline.close()
        offline.switch_to.window(first)


def test_runs_overlay_tracks_errors_residuals_coefficients(
    offline: Any, site: Path, program: Program
) -> None:
    show(offline, site.as_uri(), "view=runs&sweep=1&where.identifier=ls&where.identifier=plsr")
    ticks = [
        box.get_attribute("id") for box in offline.find_elements("css selector", "tbody input")
    ]
    assert len(ticks) == 4
    click(offline, f"#{ticks[0]}")
    click(offline, f"#{ticks[1]}")
    click(offline, "main a[href*='view=overlay']")
    titles = [one.text for one in offline.find_elements("css selector", "figcaption")]
    for title in ("Track", "Position error", "Heading error", "Force residual", "Identified over"):
        assert any(text.startswith(title) for text in titles), titles
    assert until(lambda: offline.execute_script(COLOURED) == [True] * len(titles))
    choose(offline, "deployed", "nominal")
    captions = offline.find_elements("css selector", "figcaption")
    assert "Force residual of the nominal model, surge" in [one.text for one in captions]
    assert until(lambda: offline.execute_script(COLOURED) == [True] * len(titles))
    table = cell_texts(offline)
    assert table[0][-1] == "True value"
    assert ["surge: u_dot [kg]", "1200\nse 8.0", "1200\nse 8.0", "1195"] in table
    lines = commands_of(offline)
    assert {shlex.split(line)[4] for line in lines} == {"track", "errors", "residual",
                                                        "coefficients"}  # fmt: skip
    folder = site.parent.parent / "figures"
    code, out, err = program(*shlex.split(lines[0])[3:], "--output", folder)
    assert (code, err) == (0, "")
    assert f"track-run-{ticks[0].removeprefix('tick-')}" in out


def test_a_pareto_front_is_drawn(offline: Any, site: Path) -> None:
    show(offline, site.as_uri(), "view=runs&sweep=all&where.identifier=nsga2")
    click(offline, "tbody input")
    click(offline, "main a[href*='view=overlay']")
    assert "Pareto set" in offline.find_element("css selector", "figcaption").text


def test_a_failure_is_told_with_its_traceback(offline: Any, site: Path, program: Program) -> None:
    show(offline, site.as_uri(), "sweep=all")
    click(offline, "nav a[href*=failures]")
    summaries = [one.text for one in offline.find_elements("css selector", ".failure > summary")]
    assert len(summaries) == 2
    assert "|r| = 9 rad/s exceeds 3 at t = 12 s" in summaries[0]
    assert "singular matrix" in summaries[1]
    click(offline, ".failure:last-of-type > summary")
    body = offline.find_element("css selector", ".failure:last-of-type pre").text
    assert body == "Traceback: here\nValueError"
    code, out, _ = program(*shlex.split(commands_of(offline)[-1])[3:])
    assert (code, out.strip()) == (0, body)
    click(offline, ".failure:last-of-type a[href*='view=run&']")
    assert "singular matrix" in offline.find_element("id", "main").text


@pytest.mark.slow
def test_the_keyboard_and_names_reach_every_control(offline: Any, site: Path) -> None:
    for address in ("sweep=all", "view=runs&sweep=all", "view=overlay&runs=18"):
        show(offline, site.as_uri(), address)
        unnamed = offline.execute_script(
            """return [...document.querySelectorAll('button, select, input, a[href], summary')]
              .filter((one) => !(one.labels?.[0]?.textContent || one.textContent ||
                one.getAttribute('aria-label')).trim() || one.tabIndex < 0)
              .map((one) => one.outerHTML)"""
        )
        assert unnamed == []
        missing = (
            "return [...document.querySelectorAll('.plot')].filter((p) => !p.ariaLabel).length"
        )
        assert offline.execute_script(missing) == 0


@pytest.mark.slow
@pytest.mark.parametrize("width", [390, 1280])
def test_nothing_is_cut_and_the_first_column_stays(offline: Any, site: Path, width: int) -> None:
    metrics = {"width": width, "height": 844, "deviceScaleFactor": 1, "mobile": width < 500}
    offline.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    for address in ("sweep=all", "view=runs&sweep=all", "view=overlay&runs=18,20", "view=failures"):
        show(offline, site.as_uri(), address)
        assert offline.execute_script("return document.documentElement.scrollWidth") <= width
    show(offline, site.as_uri(), "view=runs&sweep=all")
    places = offline.execute_script(
        """const box = document.querySelector('.scroll');
        box.scrollLeft = box.scrollWidth;
        const cell = box.querySelector('tbody th').getBoundingClientRect();
        return [box.getBoundingClientRect().left, cell.left]"""
    )
    assert places[1] == pytest.approx(places[0], abs=2.0)


@pytest.mark.slow
def test_hostile_names_are_shown_and_do_nothing(
    offline: Any, tmp_path: Path, program: Program
) -> None:
    with stored.logbook_at(tmp_path) as logbook:
        sweep = logbook.begin_sweep(
            HOSTILE[0], HOSTILE[1], [], 8, tags=[HOSTILE[2]], note=HOSTILE[3]
        )
        for seed, name in enumerate(HOSTILE):
            config = {HOSTILE[0]: name, "plant": {"scale": name}}
            begin = stored.start(name, HOSTILE[-1 - seed], seed, vessel=name, config=config)
            metrics = [
                stored.force_mse(2.0),
                stored.Metric("validation", "identified", name, name, 1.0, name),
            ]
            terms = [stored.coefficient(name, 1.0, 0.1, 2.0, unit=name)]
            stored.finish(logbook, begin, metrics, terms, sweep=sweep)
            stored.fail(logbook, stored.start(name, seed=seed + 9), error=name)
    with open_results(f"{tmp_path}/results.db") as results:
        page = write_site(results, tmp_path / "site", f"{tmp_path}/results.db", 100)
    for address in ("", "sweep=all", "sweep=all&view=runs", "sweep=all&view=failures",
                    "view=run&run=1", "view=overlay&runs=1,3,5,7"):  # fmt: skip
        show(offline, page.as_uri(), address)
        assert offline.title == "Sea trials"
        assert offline.find_elements("css selector", "main img, main script") == []
        assert "\u202e" not in offline.find_element("tag name", "body").text
    show(offline, page.as_uri(), "sweep=all&rows=identifier&columns=vessel")
    assert HOSTILE[0] in [row[0] for row in cell_texts(offline)]
    click(offline, "#filters summary")
    click(offline, "input[id^=filter-identifier-]")
    code, out, err = program(*shlex.split(commands_of(offline)[0])[3:], "--format", "json")
    assert (code, err) == (0, "")
    assert len(json.loads(out)) == len(cells_of(offline) or ())


@pytest.mark.slow
def test_postgresql_tells_the_same(postgres: Postgres, tmp_path: Path) -> None:
    told = []
    lite, other = tmp_path / "lite", tmp_path / "other"
    lite.mkdir()
    for url, folder in (f"sqlite:///{lite}/results.db", lite), (postgres.new_database(), other):
        with LogbookWriter.open(url, results_dir=folder) as logbook:
            stored.fill_plain(logbook)
            stored.fill_sailed(logbook)
        with open_results(url, folder) as results:
            text = script_of("data/summary.js", contents.summary(results, url, StoredMeasures(), 9))
            summary = json.loads(text.partition(", ")[2].removesuffix(");\n"))
            del summary["database"]
            for factor in summary["runs"]["factors"]:  # each writes lists in its own way
                factor["levels"] = [level.replace(", ", ",") for level in factor["levels"]]
            for measure in summary["measures"]:
                measure["parts"].sort()
            del summary["runs"]["started"], summary["runs"]["duration"]
            run = contents.one_run(results, 18)
            numbers = contents.metric(results, "force_mse"), contents.failures(results)
            told.append((summary, numbers, run["series"], run["metrics"], run["coefficients"]))
    assert told[0] == told[1]
    assert told[0][0]["runs"]["ids"] == list(range(1, 27))


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


@pytest.mark.slow
def test_any_web_server_shows_it(browser: Any, site: Path) -> None:
    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, format: str, *arguments: object) -> None: ...

    with ThreadingHTTPServer(
        ("127.0.0.1", 0), partial(Quiet, directory=str(site.parent))
    ) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        browser.get_log("browser")
        show(browser, f"http://127.0.0.1:{server.server_address[1]}/index.html", "sweep=all")
        assert len(cell_texts(browser)) > 2
        assert complaints(browser) == []
        server.shutdown()


def test_an_empty_logbook_has_a_page(offline: Any, tmp_path: Path) -> None:
    stored.logbook_at(tmp_path).close()
    with open_results(f"{tmp_path}/results.db") as results:
        page = write_site(results, tmp_path / "site", "results.db", 1)
    show(offline, page.as_uri())
    assert "No runs in the logbook yet" in offline.find_element("id", "main").text
