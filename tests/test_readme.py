"""What README.md shows is what its commands print."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from docs.refresh import BLOCK, README, output

ROOT = README.parent
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


def test_linked_files_exist() -> None:
    links = re.findall(r"\]\(([^)#:]+)\)", README.read_text())
    assert links
    for link in links:
        assert (ROOT / link).exists(), link


@pytest.mark.slow
def test_tables_are_those_of_the_demo(tmp_path: Path) -> None:
    makefile = (ROOT / "Makefile").read_text()
    demo = re.search(r"-m runner (-m identifier\S+ disturbance\S+)", makefile)
    assert demo is not None
    subprocess.run(
        [sys.executable, "-m", "runner", *demo[1].split(), f"results_dir={tmp_path}"],
        cwd=ROOT, check=True, capture_output=True,
    )  # fmt: skip
    blocks = list(BLOCK.finditer(README.read_text()))
    assert blocks
    for block in blocks:
        now = output(block["command"], "--database", f"sqlite:///{tmp_path}/results.db")
        shown = block[0].split("-->\n", 1)[1].rsplit("<!--", 1)[0]
        assert NUMBER.sub("#", now).split() == NUMBER.sub("#", shown).split()
        values = [float(x) for x in NUMBER.findall(now)]
        assert values == pytest.approx([float(x) for x in NUMBER.findall(shown)], rel=1e-3)
