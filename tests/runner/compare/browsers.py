"""A real browser for the tests of pages, and what they do with it."""

import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

INSTALL = "apt-get install chromium chromium-driver, and pip install selenium"
FLAGS = (
    *("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
    "--no-first-run",
)


def start_browser(logs: Mapping[str, str] | None = None) -> Any:
    """Chromium without a window, with further logs; the test skips where there is none."""
    webdriver = pytest.importorskip("selenium.webdriver", reason=f"no selenium: {INSTALL}")
    program, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if program is None or driver is None:
        pytest.skip(f"no chromium: {INSTALL}")
    options = webdriver.ChromeOptions()
    options.binary_location = program
    for flag in FLAGS:
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", **(logs or {})})
    service = webdriver.chrome.service.Service(driver)
    return webdriver.Chrome(options=options, service=service)


def open_page(
    browser: Any, page: Path, width: int, mobile: bool = False, height: int = 844
) -> None:
    """Show a page in a window of the size of a desk's or a phone's [px]."""
    metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": mobile}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    browser.get_log("browser")
    browser.get(page.as_uri())


def check_phone(browser: Any, page: Path, answer: str = "main table") -> None:
    """At 390 px nothing scrolls sideways but tables and figures, and the answer can be touched."""
    open_page(browser, page, 390, mobile=True)
    assert browser.execute_script("return document.scrollingElement.scrollWidth") == 390, page
    touched = """
        const answer = document.querySelector(arguments[0]);
        answer.scrollIntoView({ block: "start" });
        const box = answer.getBoundingClientRect();
        return answer.contains(document.elementFromPoint(box.left + 20, box.top + 20));"""
    assert browser.execute_script(touched, answer), page


def check_alone(text: str, attributes: str = "src|href|action|data") -> None:
    """A page names nothing outside in these, its ids are unique, and every reference is met."""
    loaded = re.findall(rf'(?:{attributes})\s*=\s*["\']?([^"\'> ]+)', text)
    assert all(link.startswith(("#", "data:")) for link in loaded)
    ids = re.findall(r'\sid="([^"]+)"', text)
    assert len(ids) == len(set(ids))
    references = set(re.findall(r'href="#([^"]+)"|url\(#([^)]+)\)', text))
    assert references
    assert {one or other for one, other in references} <= set(ids)


def complaints(browser: Any) -> list[Any]:
    """What the browser's console says of the page that is open."""
    log: list[Any] = browser.get_log("browser")
    return log
