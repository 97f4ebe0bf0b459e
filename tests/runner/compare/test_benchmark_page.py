"""The page of the benchmark: what is on it, and how it behaves on a desk and on a phone."""

import re
from pathlib import Path
from typing import Any

import pytest

from seatrial.runner import benchmark
from tests.runner.compare.browsers import complaints, open_page
from tests.runner.compare.conftest import Program

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
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert benchmark.main([*WORDS, "--launcher", "basic"]) == 0
    return folder / "index.html"


WORDS = ("--task", "ferry", "--task", "surge")


@pytest.fixture(autouse=True)
def written(page: Path, program: Program, monkeypatch: pytest.MonkeyPatch) -> None:
    """The page as the command writes it."""
    monkeypatch.chdir(page.parent)
    if not page.exists():
        code, out, err = program("leaderboard", *WORDS, "--page", page)
        assert code == 0, err
        assert "A ferry along way-points" in out


def test_the_page_holds_everything_and_loads_nothing(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert "&lt;b&gt;Surge&lt;/b&gt; &amp; a multisine" in text
    assert "javascript:" not in text
    for part in ("mean ranks", "tracks of the free runs", "none stated", "a.csv is missing"):
        assert part in text
    figures = text.count("free run from the first measured state</figcaption>")
    assert figures == 3  # one of each case
    loaded = re.findall(r'(?:src|action|data)\s*=\s*["\']?([^"\'> ]+)', text)
    assert all(link.startswith(("#", "data:")) for link in loaded)
    ids = re.findall(r'\sid="([^"]+)"', text)
    assert len(ids) == len(set(ids))
    references = set(re.findall(r'href="#([^"]+)"|url\(#([^)]+)\)', text))
    assert {one or other for one, other in references} <= set(ids)


@pytest.mark.parametrize(("width", "mobile"), [(390, True), (1280, False)])
def test_it_is_legible_on_a_phone_and_a_desk(
    browser: Any, page: Path, width: int, mobile: bool
) -> None:
    open_page(browser, page, width, mobile)
    assert complaints(browser) == []
    assert browser.execute_script("return document.documentElement.scrollWidth") <= width
    entries = browser.execute_script("return performance.getEntriesByType('resource').length")
    assert entries == 0
    sizes = browser.execute_script(
        "return [...document.querySelectorAll('figure svg')].map((svg) => {"
        " const box = svg.getBoundingClientRect();"
        " return [box.width, box.width / svg.viewBox.baseVal.width] })"
    )
    assert len(sizes) >= 6
    for wide, scale in sizes:
        assert wide > 300
        assert scale * 10.0 >= 9.0  # the 10 pt letters of the figures [CSS px]


def test_the_figure_of_the_ranks_is_drawn_by_name(page: Path, program: Program) -> None:
    folder = page.parent
    database = f"sqlite:///{folder}/results/benchmark/results.db"
    code, out, err = program(
        "plot", "critical_difference", "--database", database, "--output", folder / "figures"
    )
    assert code == 0, err
    names = {Path(line).name for line in out.split()}
    assert {"critical_difference.svg", "critical_difference-ferry.svg"} <= names
