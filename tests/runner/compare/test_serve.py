"""The site served live: on this host alone, read-only, with the runs of a sweep as they come."""

import http.client
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from seatrial.runner.compare.results import open_results
from seatrial.runner.compare.site.measures import StoredMeasures
from seatrial.runner.database import Logbook
from tests.runner import programs
from tests.runner.compare import stored
from tests.runner.compare.browsers import complaints
from tests.runner.compare.conftest import Program
from tests.runner.compare.site_pages import settle, show, until

LATEST_S = 60.0  # by then a run is shown on the busiest machine; what it took is printed
SHOWN = """return [...document.querySelectorAll('main tbody tr')].map((row) =>
  `${row.querySelector('a').textContent} ${row.querySelector('.status').textContent}`)"""


@contextmanager
def served(database: Path) -> Iterator[int]:
    """A server of this logbook; gives its port."""
    environment = {**os.environ, "PYTHONPATH": str(programs.ROOT)}
    command = [sys.executable, "-u", "-m", "runner.compare", "serve", "--port", "0"]
    process = subprocess.Popen(
        [*command, "--database", str(database)],
        cwd=programs.ROOT, env=environment, stdout=subprocess.PIPE, text=True,
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),  # ignored behind a shell
    )  # fmt: skip
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line.startswith("http://127.0.0.1:"), line
        yield int(line.strip().rstrip("/").rpartition(":")[2])
    finally:
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 130
        process.stdout.close()


def ask(
    port: int, path: str, method: str = "GET", host: str | None = None
) -> tuple[int, dict[str, str], str]:
    """Status, headers and text of an answer."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
    try:
        connection.request(method, path, headers={"Host": host or f"127.0.0.1:{port}"})
        answer = connection.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read().decode()
    finally:
        connection.close()


@pytest.mark.slow
def test_it_answers_this_host_alone_and_only_reads(plain: Path) -> None:
    database = plain / "results.db"
    before = database.read_bytes()
    with served(database) as port:
        status, headers, page = ask(port, "/")
        assert (status, headers["Content-Type"]) == (200, "text/html; charset=utf-8")
        assert "<h1>Sea trials</h1>" in page
        for name in ("summary", "progress", "failures", "run-1"):
            status, headers, text = ask(port, f"/data/{name}.js?1")
            assert status == 200, name
            assert text.startswith(f'seatrial.receive("data/{name}.js", ')
            # another site's page must not load it as a script
            assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
            assert "Access-Control-Allow-Origin" not in headers
        for path in ("/results.db", "/../results.db", "/assets/../contents.py", "/data/../x",
                     "/assets/%2e%2e/contents.py", "/data/run-99.js", "/data/metric-x.js",
                     "/data/run-99999999999999999999.js", "/assets/", "//etc/passwd"):  # fmt: skip
            assert ask(port, path)[0] == 404, path
        for host in ("evil.example", f"evil.example:{port}", f"127.0.0.1:{port + 1}", "0.0.0.0"):
            assert ask(port, "/data/summary.js", host=host)[0] == 403, host
        for method in ("POST", "PUT", "DELETE", "OPTIONS"):
            assert ask(port, "/", method)[0] == 501
    assert database.read_bytes() == before


def test_a_taken_port_and_a_missing_logbook_are_one_line(
    program: Program, plain: Path, tmp_path: Path
) -> None:
    import socket

    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        code, _, err = program("serve", "--port", port, "--database", plain / "results.db")
    assert (code, err.count("\n")) == (2, 1)
    assert "expected a free port" in err
    code, _, err = program("serve", "--database", tmp_path / "none.db")
    assert (code, err.count("\n")) == (2, 1)


@pytest.mark.slow
def test_new_runs_and_progress_appear_while_a_sweep_runs(browser: Any, tmp_path: Path) -> None:
    results = tmp_path / "results"
    results.mkdir()
    with stored.logbook_at(results) as logbook:
        stored.finish(logbook, stored.start(), [stored.force_mse(1.0)])
    with served(results / "results.db") as port:
        view = {"width": 1280, "height": 844, "deviceScaleFactor": 1, "mobile": False}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", view)
        browser.get_log("browser")
        show(browser, f"http://127.0.0.1:{port}/", "view=runs&sweep=all&metric=force_mse")
        assert browser.execute_script(SHOWN) == ["1 finished"]
        sweep = programs.sweep("seed=0,1,2,3", folder=tmp_path)
        first_seen: dict[str, float] = {}
        on_page: dict[str, float] = {}
        end = time.monotonic() + 240.0
        while time.monotonic() < end and len([run for run in on_page if "finished" in run]) < 5:
            query = "SELECT id || ' ' || status FROM run"
            for (run,) in programs.rows(tmp_path, query):
                first_seen.setdefault(str(run), time.monotonic())
            for run in browser.execute_script(SHOWN):
                on_page.setdefault(run, time.monotonic())
            time.sleep(0.1)
        code, _, err = programs.ended(sweep)
        assert code == 0, err
        delays = [at - first_seen[run] for run, at in on_page.items() if run in first_seen]
        print(f"shown after {min(delays):.1f} to {max(delays):.1f} s")
        finished = [run for run in on_page if run.endswith("finished")]
        assert len(finished) == 5
        assert max(delays) < LATEST_S
        over = "Sweep 1 (sweep): 4 of 4 done, 0 running, 0 failed"
        assert until(lambda: browser.find_element("id", "progress").text == over)
        browser.find_element("css selector", "main tbody a").click()  # its series came as well
        settle(browser)
        assert "Run 5" in browser.find_element("id", "main").text
        assert [c for c in complaints(browser) if "favicon" not in json.dumps(c)] == []


def _says(page: Any, text: str) -> bool:
    return bool(until(lambda: page.find_element("id", "progress").text == text))


@pytest.mark.slow
def test_progress_of_every_running_sweep_counts_what_failed(
    browser: Any, logbook: Logbook, tmp_path: Path
) -> None:
    sweep = logbook.begin_sweep("both", "python -m runner", ["identifier=ls,none"], planned=3)
    stored.finish(logbook, stored.start("none"), [stored.force_mse(1.0)], sweep=sweep)
    running = logbook.begin_run(stored.start("ls"), sweep).run_id
    with served(tmp_path / "results.db") as port:
        show(browser, f"http://127.0.0.1:{port}/", "view=runs&sweep=all&metric=force_mse")
        assert _says(browser, "Sweep 1 (both): 1 of 3 done, 1 running, 0 failed")
        logbook.fail_run(running, "failed", "ValueError", "broken", "Traceback: here\nValueError")
        assert _says(browser, "Sweep 1 (both): 2 of 3 done, 0 running, 1 failed")
        newer = logbook.begin_sweep("other", "python -m runner", ["identifier=plsr"], planned=2)
        logbook.begin_run(stored.start("plsr"), newer)
        last = "Sweep 2 (other): 0 of 2 done, 1 running, 0 failed"
        assert _says(browser, f"Sweep 1 (both): 2 of 3 done, 0 running, 1 failed\n{last}")
        logbook.end_sweep(sweep)
        assert _says(browser, last)


@pytest.mark.slow
def test_what_is_being_read_stays_when_runs_come(
    browser: Any, logbook: Logbook, tmp_path: Path
) -> None:
    stored.fail(logbook, stored.start("none"))
    stored.fail(logbook, stored.start("ls"))
    with served(tmp_path / "results.db") as port:
        show(browser, f"http://127.0.0.1:{port}/", "view=failures&sweep=all")
        browser.find_element("css selector", "#failure-2 > summary").click()
        sweep = browser.find_element("id", "sweep")
        browser.execute_script("arguments[0].focus(); arguments[0].dataset.mine = 'yes'", sweep)
        stored.fail(logbook, stored.start("plsr"))
        told = "return document.querySelector('h2').textContent"
        assert until(lambda: browser.execute_script(told) == "3 failures")
        opened = "return [...document.querySelectorAll('details.failure[open]')].map((d) => d.id)"
        assert browser.execute_script(opened) == ["failure-2"]
        assert browser.execute_script("return document.activeElement.id") == "sweep"


def test_metrics_are_found_as_they_are_stored_and_forgotten_when_deleted(
    logbook: Logbook, tmp_path: Path, program: Program
) -> None:
    measures = StoredMeasures()

    def told() -> dict[object, object]:
        with open_results(f"{tmp_path}/results.db") as results:
            return {one["name"]: one["parts"] for one in measures.told(results)}

    assert told() == {}
    stored.finish(logbook, stored.start("none"), [stored.force_mse(1.0)])
    surge = ["validation", "identified", "surge", "N^2"]
    assert told() == {"force_mse": [surge]}
    stored.finish(logbook, stored.start("ls"), [stored.force_mse(1.0, "yaw"), stored.tracking(1.0)])
    yaw = ["validation", "identified", "yaw", "(Nm)^2"]
    position = ["deployment", "identified", "position", "m"]
    assert told() == {"force_mse": [surge, yaw], "e_pos_mae": [position]}
    code, _, _ = program("prune", "--where", "identifier=ls", "--yes", "--database",
                         f"{tmp_path}/results.db")  # fmt: skip
    assert code == 0
    assert told() == {"force_mse": [surge]}
