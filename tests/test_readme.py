"""The tables that README.md and the guide show are what their commands print."""

import re
import shlex
import sys
from dataclasses import fields
from pathlib import Path

import pytest

from docs.refresh import BLOCK, DOCUMENTS, ROOT, output
from docs.vessels import parameters_of, table, vessels
from seatrial.models.vessel.tuning import Tuning
from tests.audit.test_recomputed import agrees
from tests.runner.programs import completed

NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


def blocks(word: str) -> list[re.Match[str]]:
    """The generated tables whose command contains a word."""
    found = [block for page in DOCUMENTS for block in BLOCK.finditer(page.read_text())]
    return [block for block in found if word in block["command"]]


def test_the_table_of_vessels_is_what_its_command_prints() -> None:
    (block,) = blocks("docs.vessels")
    shown = block[0].split("-->\n", 1)[1].rsplit("<!--", 1)[0]
    assert block["command"] == "python -m docs.vessels"
    assert shown.split() == table().split()
    names = re.findall(r"^\| `(\w+)`", shown, re.MULTILINE)
    assert names == sorted(path.stem for path in (ROOT / "conf" / "vessel").glob("*.yaml"))


def test_every_number_of_a_vessel_has_a_source() -> None:
    """Each entry of its YAML that holds a number, and no other, is named under `sources`."""
    without = ("name", "dofs", "coriolis", "attitude", "integrator", "parameters", "sources")
    without += ("regressed_on",)
    for name in vessels():
        vessel = parameters_of(name)
        names = [field.name for field in fields(vessel) if field.name not in without]
        held = {name: getattr(vessel, name) for name in names}
        given = {field for field, value in held.items() if value and value != Tuning()}
        assert set(vessel.sources) == given, name
        assert all(len(source) > 5 for source in vessel.sources.values()), name


def test_it_is_short() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) <= 120


@pytest.mark.nightly
def test_tables_are_those_of_the_demo(tmp_path: Path) -> None:
    recipe = completed("make", "--dry-run", "demo").stdout
    demo = re.search(r"-m runner (-m --variant.*?hydra/launcher=processes)", recipe, re.DOTALL)
    assert demo is not None
    words = shlex.split(demo[1].replace("\\\n", " "))
    done = completed(sys.executable, "-m", "runner", *words, f"results_dir={tmp_path}")
    assert done.returncode == 0, done.stderr
    tables = [b for b in blocks("runner.compare") if "sqlite:///" not in b["command"]]
    assert len(tables) == 2
    for block in tables:
        now = output(block["command"], "--database", f"sqlite:///{tmp_path}/results.db")
        shown = block[0].split("-->\n", 1)[1].rsplit("<!--", 1)[0]
        assert NUMBER.sub("#", now).split() == NUMBER.sub("#", shown).split()
        values = [float(x) for x in NUMBER.findall(now)]
        assert values == pytest.approx([float(x) for x in NUMBER.findall(shown)], rel=1e-3)
    agrees(tmp_path, len(tables))  # and every cell follows from the raw rows
