"""The guide to recordings: its maps are those of the files."""

import re
from pathlib import Path

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.models.recording.column_map import Column, ColumnMap
from seatrial.models.recording.reader import Reading
from seatrial.models.recording.source import ReadOptions, read_sources
from seatrial.runner.commands import data_commands
from tests.data import DATA

PAGE = (Path(__file__).parents[1] / "docs" / "howto" / "recordings.md").read_text(encoding="utf-8")
MAPS = dict(re.findall(r"```yaml\n# (\w+)\.yaml\n(.*?)```", PAGE, re.S))
FILES = {
    "esso": "esso/zigzag/zigzag_31-Jul-2020_13_42_53.csv",
    "blueboat": "blueboat/fixed_00000220.csv",
    "hsva": "kvlcc2/hsva/HSVA_CPMC_KVLCC2_Z_20_05.dat",
    "marin": "kvlcc2/marin/MARIN_FREE_KVLCC2_zz_10_m.dat",
    "milliampere": "milliampere/qp1",
}


def test_every_map_has_a_file() -> None:
    assert set(MAPS) == set(FILES)
    assert all(len(text.splitlines()) <= 15 for text in MAPS.values())


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.parametrize("name", FILES)
def test_map_of_the_page_has_no_problem(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "map.yaml").write_text(MAPS[name])
    words = ["check", str(DATA / FILES[name]), "--map", str(tmp_path / "map.yaml")]
    assert data_commands.main(words) == 0
    assert "no problem: pose and velocity are consistent" in capsys.readouterr().out


def test_an_input_is_zero_at_neutral_and_one_at_full(tmp_path: Path) -> None:
    """A pulse of 1511 us is no thrust, 1900 us all of it, 1122 us all of it astern."""
    rows = "\n".join(f"{0.1 * i:.1f},0,0,0,{w}" for i, w in enumerate((1511, 1900, 1122)))
    path = tmp_path / "log.csv"
    path.write_text("t,x,y,psi,pwm\n" + rows)
    spec = Column("pwm", neutral=1511.0, full=1900.0)
    reading = Reading(columns=ColumnMap("t", inputs={"pwm_1": spec}))
    values = reading.signals(path, read_sources(path, ReadOptions()), ()).values["inputs.pwm_1"]
    np.testing.assert_allclose(values, [0.0, 1.0, -1.0])
    with pytest.raises(ConfigurationError, match="neutral and full are 1900, expected two numbers"):
        Column("pwm", neutral=1900.0, full=1900.0)
