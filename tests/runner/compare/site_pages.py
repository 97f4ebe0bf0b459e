"""What the tests of the site do with its pages in a browser."""

import math
import time
from collections.abc import Callable
from typing import Any, TypeVar

T = TypeVar("T")
CELLS = """
const done = arguments[0];
comparisonOf(page, page.state()).then(({ table }) => done(table.refused ? null :
  [...table.cells.values()].map((cell) => {
    const codes = [...cell.row, ...cell.column], counts = Object.fromEntries(cell.unfinished);
    return {
      levels: Object.fromEntries(table.factors.map((name, i) =>
        [name, page.runs.factors.get(name).levels[codes[i]]])),
      mean: cell.mean, std: cell.std, ci_low: cell.interval[0], ci_high: cell.interval[1],
      n: cell.observed.length, failed: counts.failed ?? 0, diverged: counts.diverged ?? 0,
      without_value: cell.without, diverged_predictions: cell.diverged, held_s: cell.held,
      deterministic: cell.deterministic, unsettled: cell.unsettled, infeasible: cell.infeasible,
      std_error: cell.error, true_value: cell.truth, interval_of_estimate: cell.ofEstimate,
      best: cell.best, ratio: cell.test?.ratio, p_value: cell.test?.p, wins: cell.test?.wins,
      difference: cell.test?.difference, pairs: cell.test?.pairs,
    };
  })));
"""


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
    shown = "return document.getElementById('main')?.dataset.shown === location.hash"
    assert until(lambda: browser.execute_script(shown)), browser.page_source[:3000]


def commands_of(browser: Any) -> list[str]:
    """The lines of the commands that the page shows."""
    boxes = browser.find_elements("css selector", ".command code")
    return [line for box in boxes for line in box.text.splitlines()]


def cells_of(browser: Any) -> list[dict[str, Any]] | None:
    """The cells of the table that the page shows; None if it refuses."""
    cells: list[dict[str, Any]] | None = browser.execute_async_script(CELLS)
    return cells


def close(one: float | None, other: float | None) -> bool:
    """Whether two numbers are equal to the rounding errors of a sum; None is no number."""
    if one is None or other is None or math.isnan(one) or math.isnan(other):
        return (one is None or math.isnan(one)) and (other is None or math.isnan(other))
    return math.isclose(one, other, rel_tol=1e-6, abs_tol=1e-12)
