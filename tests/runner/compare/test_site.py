"""The site in a browser, without a network: filter, sort, overlay, failures, hostile names."""

import json
import random
import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from seatrial.models.errors import LogbookError
from seatrial.runner.compare.frame import open_results
from seatrial.runner.compare.grid import number_text
from seatrial.runner.compare.site import write_site
from seatrial.runner.compare.site.contents import STRETCHES, extremes
from seatrial.runner.compare.site.scripts import metric_script, script_of
from seatrial.runner.compare.site.static_folder import assets
from tests.runner.compare import stored
from tests.runner.compare.browsers import complaints
from tests.runner.compare.conftest import Program
from tests.runner.compare.site_pages import commands_of, settle, show, until

MOST_BYTES = 4_000_000
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


def cell_texts(browser: Any) -> list[list[str]]:
    """The texts of the first table, row by row."""
    rows = browser.find_element("css selector", "main table").find_elements("tag name", "tr")
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


def test_tables_are_those_of_their_commands_and_headings_sort(
    offline: Any, site: Path, program: Program
) -> None:
    show(offline, site.as_uri(), "sweep=1")
    assert "plsr has a force MSE of 400" in offline.find_element("css selector", ".answers").text
    words = shlex.split(commands_of(offline)[0])[3:]
    code, out, _ = program(*words, "--format", "json")
    assert code == 0
    (header, *rows), records = cell_texts(offline), json.loads(out)
    last = [row["mean"] for row in records if row["disturbance"] == header[-1]]
    assert [row[-1].split()[0] for row in rows if row[-1]] == [*map(number_text, last)]
    click(offline, f"main thead th:nth-child({len(header)}) button")
    shown = [row[-1].split()[0] for row in cell_texts(offline)[1:] if row[-1]]
    assert shown == [*map(number_text, sorted(last))]
    click(offline, "#filters summary")
    tick(offline, "Identifier", "ls")
    (command,) = commands_of(offline)  # of a selection, the command that makes its table
    assert "--where identifier" in command.replace("'", "").replace('"', "")
    assert program(*shlex.split(command)[3:])[0] == 0


def test_runs_overlay_with_the_numbers_of_their_commands(offline: Any, site: Path) -> None:
    show(offline, site.as_uri(), "view=overlay&runs=18,20")
    titles = [one.text for one in offline.find_elements("css selector", "figcaption")]
    for title in ("Track", "Position error", "Heading error", "Force residual", "Identified over"):
        assert any(text.startswith(title) for text in titles), titles
    table = cell_texts(offline)
    assert table[0][-1] == "True value"
    assert ["surge: u_dot [kg]", "1195\nse 8.0", "1200\nse 8.0", "1195"] in table
    lines = commands_of(offline)
    assert {shlex.split(line)[4] for line in lines} == {"track", "errors", "residual",
                                                        "coefficients"}  # fmt: skip


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
    show(offline, page.as_uri(), "sweep=all")
    click(offline, "#filters summary")
    click(offline, "input[id^=filter-identifier-]")
    code, out, err = program(*shlex.split(commands_of(offline)[0])[3:], "--format", "json")
    assert (code, err) == (0, "")
    assert json.loads(out)


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
    show(offline, page.as_uri())
    assert "No runs in the logbook yet" in offline.find_element("id", "main").text


def test_numbers_are_written_as_by_the_command(offline: Any, site: Path) -> None:
    draw = random.Random(4)
    values = [0.0, 100.25, 0.125, 12344.5, 12345.5, 999999.5, 1e6, 1e-5, 9.9996, -2.5, 1234.5]
    values += [draw.choice([-1, 1]) * 10 ** draw.uniform(-7, 9) for _ in range(300)]
    show(offline, site.as_uri(), "")
    for digits in (2, 4):
        got = offline.execute_script(
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
