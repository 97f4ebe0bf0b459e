"""The guide as it is read: built strictly and without a network, opened in a browser."""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from docs import gallery
from seatrial.runner.compare.figures import figures
from tests.runner.compare.browsers import start_browser

ROOT = Path(__file__).parents[2]
NOWHERE = "http://127.0.0.1:9"  # nothing listens there
ASSET = re.compile(r'<(?:link|script|img|iframe|source)[^>]+?(?:href|src|srcset)="([^"]+)"')
ADDRESS = re.compile(r"url\(\s*['\"]?(?:https?:)?//|@import")
pytestmark = pytest.mark.nightly


def without_network() -> list[str]:
    """What runs a command in a name space without any network, where this machine allows that."""
    unshare = shutil.which("unshare")
    words = [unshare, "--net", "--map-root-user"] if unshare else []
    allowed = words and subprocess.run([*words, "true"], capture_output=True, check=False)
    return [] if not allowed or allowed.returncode else [str(word) for word in words]


@pytest.fixture(scope="module")
def drawn() -> list[Path]:
    """The figures of the gallery; trials that are stored are not run again."""
    gallery.main([])
    return gallery.drawn()


@pytest.fixture(scope="module")
def site(drawn: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the pages."""
    folder = tmp_path_factory.mktemp("site")
    proxies = {f"{name}_proxy": NOWHERE for name in ("http", "https", "all")}
    answer = subprocess.run(
        [*without_network(), sys.executable, "-m", "mkdocs", "build", "--strict", "-d", folder],
        cwd=ROOT, env={**os.environ, **proxies, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert answer.returncode == 0, answer.stderr
    assert "WARNING" not in answer.stderr
    return folder


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Chromium that notes its requests."""
    started = start_browser({"performance": "ALL"})
    yield started
    started.quit()


def requests(browser: Any) -> tuple[set[str], list[str]]:
    """The addresses asked for since the last call, and those that could not be had."""
    asked, failed, names = set(), [], {}
    for entry in browser.get_log("performance"):
        event = json.loads(entry["message"])["message"]
        told = event["params"]
        if event["method"] == "Network.requestWillBeSent":
            names[told["requestId"]] = told["request"]["url"]
            asked.add(told["request"]["url"])
        elif event["method"] == "Network.loadingFailed" and not told.get("canceled"):
            failed.append(names.get(told["requestId"], "?"))
        elif event["method"] == "Network.responseReceived" and told["response"]["status"] >= 400:
            failed.append(told["response"]["url"])
    return asked, failed


def pages(site: Path) -> list[str]:
    return sorted(path.relative_to(site).as_posix() for path in site.rglob("*.html"))


def test_every_page_is_built_and_takes_nothing_from_elsewhere(site: Path) -> None:
    written = {path.relative_to(ROOT / "docs") for path in (ROOT / "docs").rglob("*.md")}
    assert {path.with_suffix(".html").as_posix() for path in written} <= set(pages(site))
    for page in site.rglob("*.html"):
        text = page.read_text()
        assert "<!-- insert:" not in text, page
        foreign = [one for one in ASSET.findall(text) if re.match(r"(?:https?:)?//", one)]
        assert foreign == [], page
    for sheet in site.rglob("*.css"):
        assert not ADDRESS.search(re.sub(r"/\*.*?\*/", "", sheet.read_text())), sheet
    assert not list(site.rglob("*.py"))


def test_the_gallery_shows_every_figure(site: Path, drawn: list[Path]) -> None:
    possible = {name for name in figures() if gallery.available(name)}
    assert {path.name.partition("--")[0] for path in drawn} >= possible
    assert len(possible) >= len(figures()) - 2  # without recordings and benchmark
    text = (site / "gallery.html").read_text()
    for path in drawn:
        assert f'src="gallery/{path.name}"' in text
        assert (site / "gallery" / path.name).stat().st_size < 500_000


def test_every_page_opens_from_disk_and_the_search_finds_a_metric(site: Path, browser: Any) -> None:
    from selenium.webdriver.support.ui import WebDriverWait

    root = site.as_uri()
    requests(browser)
    for page in set(pages(site)) - {"404.html"}:  # whose addresses are those of a server
        browser.get(f"{root}/{page}")
        lost = "return [...document.images].filter(i => i.complete && !i.naturalWidth).length"
        assert browser.execute_script(lost) == 0, page
    browser.get(f"{root}/howto/sweeps.html?q=steady_state_error")
    found = "return Array.from(document.querySelectorAll('.md-search-result__link'), a => a.href)"
    links = WebDriverWait(browser, 60).until(lambda one: one.execute_script(found))
    assert any(link.startswith(f"{root}/reference/metrics.html") for link in links)
    asked, failed = requests(browser)
    assert failed == []
    assert all(one.startswith((root, "data:", "blob:", "about:")) for one in asked)
