"""The page of the benchmark: what is on it, and that it loads nothing."""

from pathlib import Path
from typing import Any

import pytest

from seatrial.runner.commands import benchmark
from seatrial.runner.compare.__main__ import run
from tests.runner.compare.browsers import check_alone, check_phone

pytestmark = pytest.mark.slow
TASK = """
title: A ferry along way-points
trial: [vessel=milliampere, excitation=waypoints, excitation.interval_s=60, evaluation=none]
cases:
  calm: {options: [disturbance=calm], seeds: 1}
  noise: {options: [disturbance=noise]}
outputs: [surge, sway, yaw]
seeds: 2
entrants:
  none: [identifier=none]
  ls: [identifier=ls]
  steep: [identifier=ls, identifier.inertia_factor=null, 'identifier.basis=[u]']
"""
OTHER = """
title: "<b>Surge</b> & a multisine"
source: {name: nobody, url: "javascript:alert(1)", licence: none stated, get: ask}
trial: [vessel=surge_linear, excitation=multisine, plant.scale=0.8, evaluation=none]
cases:
  calm: {options: [disturbance=calm]}
  absent: {train: [a.csv], test: [b.csv]}
outputs: [surge]
entrants:
  none: [identifier=none]
  ls: [identifier=ls]
files: {a.csv: "00", b.csv: "00"}
"""


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page of two small tasks, one of which lacks files."""
    folder = tmp_path_factory.mktemp("benchmark")
    tasks = folder / "conf" / "benchmark"
    tasks.mkdir(parents=True)
    (tasks / "ferry.yaml").write_text(TASK)
    (tasks / "surge.yaml").write_text(OTHER)
    words = ["--task", "ferry", "--task", "surge"]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert benchmark.main([*words, "--launcher", "basic"]) == 0
        assert run(["leaderboard", *words, "--page", "index.html"]) == 0
    return folder / "index.html"


def test_the_page_holds_everything_and_loads_nothing(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert "&lt;b&gt;Surge&lt;/b&gt; &amp; a multisine" in text
    assert "javascript:" not in text
    for part in ("mean ranks", "none stated", "a.csv is missing"):
        assert part in text
    figures = text.count("free run from the first measured state</figcaption>")
    assert figures == 3  # one of each case
    check_alone(text, "src|action|data")


def test_the_page_fits_a_phone(browser: Any, page: Path) -> None:
    check_phone(browser, page)
