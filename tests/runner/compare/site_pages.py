"""What the tests of the site do with its pages in a browser."""

import time
from collections.abc import Callable
from typing import Any, TypeVar

T = TypeVar("T")


def until(answer: Callable[[], T], seconds: float = 20.0) -> T:
    """The first answer that is true, or the last one."""
    end = time.monotonic() + seconds
    while not (got := answer()) and time.monotonic() < end:
        time.sleep(0.05)
    return got


def show(browser: Any, url: str, address: str = "") -> None:
    """Open a page of the site and wait for its view."""
    browser.get("about:blank")
    browser.get(f"{url}#{address}")
    settle(browser)


def settle(browser: Any) -> None:
    """Wait until the view of the address is shown."""
    shown = "return document.body.dataset.shown === location.hash"
    assert until(lambda: browser.execute_script(shown)), browser.page_source[:3000]
