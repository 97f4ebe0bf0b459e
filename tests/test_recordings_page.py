"""The guide to recordings: its maps are those of the files, and its commands run."""

import os
import re
from pathlib import Path

import pytest

from tests.runner.programs import ended, program

PAGE = (Path(__file__).parents[1] / "docs" / "recordings.md").read_text(encoding="utf-8")
MAPS = dict(re.findall(r"```yaml\n# (\w+)\.yaml\n(.*?)```", PAGE, re.S))
COMMANDS = re.search(r"```console\n(.*?)```", PAGE, re.S)
FILES = {
    "esso": "esso/zigzag/zigzag_31-Jul-2020_13_42_53.csv",
    "blueboat": "blueboat/fixed_00000220.csv",
    "hsva": "kvlcc2/hsva/HSVA_CPMC_KVLCC2_Z_20_05.dat",
    "milliampere": "milliampere/qp1",
}
DATA = Path(os.environ.get("SEATRIAL_DATA", ""))
needs_data = pytest.mark.skipif(
    "SEATRIAL_DATA" not in os.environ, reason="SEATRIAL_DATA is not set: no outside data"
)


def test_every_map_has_a_file() -> None:
    assert set(MAPS) == set(FILES)
    assert all(len(text.splitlines()) <= 15 for text in MAPS.values())


@needs_data
@pytest.mark.parametrize("name", FILES)
def test_map_of_the_page_has_no_problem(name: str, tmp_path: Path) -> None:
    (tmp_path / "map.yaml").write_text(MAPS[name])
    code, out, error = ended(
        program("-m", "runner", "data", "check", str(DATA / FILES[name]), "--map", "map.yaml",
                folder=tmp_path)
    )  # fmt: skip
    assert code == 0, error
    assert "no problem: pose and velocity belong together" in out


@needs_data
@pytest.mark.slow
def test_commands_of_the_page_run(tmp_path: Path) -> None:
    """On a zig-zag of the Esso Osaka, in the order of the page."""
    assert COMMANDS
    lines = [line[2:].split() for line in COMMANDS[1].splitlines() if line.startswith("$ ")]
    assert len(lines) == 3
    for words in lines:
        own = [word.replace("FILE", str(DATA / FILES["esso"])) for word in words[1:]]
        code, _, error = ended(program("-m", "runner", *own, folder=tmp_path))
        assert code == 0, (words, error)
