"""The guide as it is read: built strictly and without a network, opened in a browser."""

import json
import os
import re
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
import yaml

from docs import gallery
from seatrial.runner.compare.figures import figures
from tests.runner.compare.browsers import start_browser

ROOT = Path(__file__).parents[2]
NOWHERE = "http://127.0.0.1:9"  # nothing listens there
ASSET = re.compile(r'<(?:link|script|img|iframe|source)[^>]+?(?:href|src|srcset)="([^"]+)"')
ADDRESS = re.compile(r"url\(\s*['\"]?(?:https?:)?//|@import")
WIDTHS = (390, 1280)
pytestmark = pytest.mark.nightly


def without_network() -> list[str]:
    """What runs a command in a name space without any network, where this machine allows that."""
    unshare = shutil.which("unshare")
    words = [unshare, "--net", "--map-root-user"] if unshare else []
    allowed = words and subprocess.run([*words, "true"], capture_output=True, check=False)
    return [] if not allowed or allowed.returncode else [str(word) for word in words]


def mkdocs(*arguments: str | Path, folder: Path = ROOT) -> subprocess.CompletedProcess[str]:
    """Run MkDocs on the guide, or on that of a folder."""
    proxies = {f"{name}_proxy": NOWHERE for name in ("http", "https", "all")}
    return subprocess.run(
        [*without_network(), sys.executable, "-m", "mkdocs", *map(str, arguments)],
        cwd=folder,
        env={**os.environ, **proxies, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture(scope="module")
def drawn() -> list[Path]:
    """The figures of the gallery; trials that are stored are not run again."""
    gallery.main([])
    return gallery.drawn()


@pytest.fixture(scope="module")
def site(drawn: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the pages."""
    folder = tmp_path_factory.mktemp("site")
    answer = mkdocs("build", "--strict", "--site-dir", folder)
    assert answer.returncode == 0, answer.stderr
    assert "WARNING" not in answer.stderr
    return folder


@pytest.fixture(scope="module")
def address(site: Path) -> Iterator[str]:
    """The address at which the pages are served."""

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, format: str, *args: Any) -> None:
            """Say nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(site)))
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    thread.join()
    server.server_close()


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


@pytest.mark.parametrize("width", WIDTHS)
def test_no_page_is_wider_than_its_window_or_lacks_a_file(
    site: Path, address: str, browser: Any, width: int
) -> None:
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 500}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    requests(browser)
    for page in pages(site):
        browser.get(f"{address}/{page}")
        shown = browser.execute_script(
            "const page = document.documentElement;"
            "return [page.scrollWidth - page.clientWidth,"
            " document.body.scrollWidth - page.clientWidth,"
            " Array.from(document.images).filter(i => i.complete && !i.naturalWidth).length]"
        )
        assert shown == [0, 0, 0], page
        asked, failed = requests(browser)
        assert failed == [], page
        assert all(one.startswith((address, "data:", "blob:")) for one in asked), page


@pytest.mark.parametrize("opened", ["from a server", "from disk"])
def test_the_search_finds_a_metric(site: Path, address: str, browser: Any, opened: str) -> None:
    from selenium.webdriver.support.ui import WebDriverWait

    root = site.as_uri() if opened == "from disk" else address
    requests(browser)
    browser.get(f"{root}/howto/sweeps.html?q=steady_state_error")
    found = "return Array.from(document.querySelectorAll('.md-search-result__link'), a => a.href)"
    links = WebDriverWait(browser, 60).until(lambda one: one.execute_script(found))
    assert any(link.startswith(f"{root}/reference/metrics.html") for link in links)
    asked, failed = requests(browser)
    assert failed == []
    assert all(one.startswith((root, "data:", "blob:", "about:")) for one in asked)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[there](other.md#part)", ""),
        ("[there](absent.md)", "absent.md"),
        ("[there](other.md#absent)", "does not contain an anchor '#absent'"),
        ("![there](absent.svg)", "absent.svg"),
        ("[there](#absent)", "there is no such anchor"),
    ],
)
def test_a_broken_link_fails(tmp_path: Path, text: str, message: str) -> None:
    """With the strictness of mkdocs.yml, on two pages."""
    settings = yaml.safe_load((ROOT / "mkdocs.yml").read_text())
    kept = {name: settings[name] for name in ("site_name", "theme", "validation")}
    (tmp_path / "mkdocs.yml").write_text(yaml.safe_dump(kept))
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs" / "index.md").write_text(f"# Here\n\n{text}\n")
    (tmp_path / "docs" / "other.md").write_text("# Other\n\n## Part\n")
    answer = mkdocs("build", "--strict", folder=tmp_path)
    assert (answer.returncode == 0) is (message == ""), answer.stderr
    assert message in answer.stderr
