"""A recording of a ship as one of its model, by its units, and files of other columns."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.runner.commands.data_commands import write_recording
from seatrial.runner.configuration import named_files
from tests.models.recording.test_file_set import reader

DOFS = ("surge", "sway", "yaw")
MAP: dict[str, Any] = {
    "time": "t",
    "position": {"surge": "x", "sway": "y"},
    "heading": {"column": "psi", "unit": "deg"},
    "velocity": {"surge": "u", "sway": "v", "yaw": {"column": "r", "unit": "deg/s"}},
    "inputs": {
        "delta": {"column": "rudder", "unit": "deg"},
        "n": {"column": "shaft", "unit": "rpm"},
    },
    "loads": {"propeller.thrust": {"column": "T", "unit": "kN"}},
}
NAMES = ("t", "x", "y", "psi", "u", "v", "r", "rudder", "shaft", "T")
MODEL = (1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)


def written(path: Path, factors: tuple[float, ...], names: tuple[str, ...] = NAMES) -> Path:
    """A file of a turn, with each column times a factor."""
    t = 0.1 * np.arange(60)
    columns = [t, t, 0.1 * t**2, 9.0 * t, 1.0 + t, 0.1 * t, 9.0 + 0.0 * t, 35.0 + t, 600.0 + t, t]
    rows = np.column_stack(columns) * factors
    known = [NAMES.index(name) for name in names]
    np.savetxt(path, rows[:, known], delimiter=",", header=",".join(names), comments="")
    return path


def mapped(path: Path, content: dict[str, Any]) -> Path:
    path.write_text(yaml.safe_dump(content))
    return path


def test_a_ship_is_read_as_its_model(tmp_path: Path) -> None:
    """Units are expressions: U^2 / (g L), rho and g are the same at scale 1:25 (ITTC 7.5-02-05)."""
    ship = (5.0, 25.0, 25.0, 1.0, 5.0, 5.0, 1 / 5.0, 1.0, 1 / 5.0, 25.0**3)
    scaled = {
        "time": {"column": "t", "unit": "s/25**0.5"},
        "position": {dof: {"column": x, "unit": "m/25"} for dof, x in MAP["position"].items()},
        "velocity": {
            "surge": {"column": "u", "unit": "m/s/25**0.5"},
            "sway": {"column": "v", "unit": "m/s/25**0.5"},
            "yaw": {"column": "r", "unit": "deg/s*25**0.5"},
        },
        "inputs": {**MAP["inputs"], "n": {"column": "shaft", "unit": "rpm*25**0.5"}},
        "loads": {"propeller.thrust": {"column": "T", "unit": "kN/25**3"}},
    }  # fmt: skip
    content = mapped(tmp_path / "m.yaml", MAP)
    of_ship = mapped(tmp_path / "s.yaml", {**MAP, **scaled})
    model = reader(path=str(written(tmp_path / "m.csv", MODEL)), map=str(content)).read(DOFS)
    read = reader(path=str(written(tmp_path / "s.csv", ship)), map=str(of_ship)).read(DOFS)
    for name in ("t", "eta", "nu", "nu_dot", "inputs", "loads"):
        np.testing.assert_allclose(getattr(read, name), getattr(model, name), rtol=1e-9, atol=1e-9)
    assert model.loads[10, 0] == pytest.approx(1000.0)


def test_files_that_are_tested_on_have_a_map_of_their_own(tmp_path: Path) -> None:
    """The file without thrust has no number there, the other columns are read by their own map."""
    turned = {**MAP, "inputs": {**MAP["inputs"], "delta": {"column": "-rudder", "unit": "deg"}}}
    del turned["loads"]
    maps = mapped(tmp_path / "a.yaml", MAP), mapped(tmp_path / "b.yaml", turned)
    first = written(tmp_path / "a.csv", MODEL)
    second = written(tmp_path / "b.csv", MODEL, NAMES[:-1])
    options = {"train": [str(first)], "test": [str(second)], "map": str(maps[0])}
    recording = reader(**options, test_map=str(maps[1])).read(DOFS)
    np.testing.assert_allclose(recording.inputs[60:, 0], -recording.inputs[:60, 0])
    assert recording.load_names == ("propeller.thrust",)
    assert np.all(np.isfinite(recording.loads[:60]))
    assert np.all(np.isnan(recording.loads[60:]))
    with pytest.raises(RecordingError, match="no column 'T'"):
        reader(**options).read(DOFS)
    with pytest.raises(ConfigurationError, match=r"test_map requires excitation\.test"):
        reader(path=str(first), map=str(maps[0]), test_map=str(maps[1]))


def test_loads_are_stored_with_the_recording(tmp_path: Path) -> None:
    content = mapped(tmp_path / "m.yaml", MAP)
    recording = reader(path=str(written(tmp_path / "m.csv", MODEL)), map=str(content)).read(DOFS)
    write_recording(recording, tmp_path / "m.parquet", {})
    stored = named_files.reader_of(tmp_path / "m.parquet", {}).read(DOFS)
    assert stored.load_names == recording.load_names
    np.testing.assert_array_equal(stored.loads, recording.loads)
