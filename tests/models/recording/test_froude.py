"""A recording of a ship as one of its model, by Froude's law, and files of other columns."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.recording.units import froude_factor
from seatrial.runner.commands.data_convert import write_recording
from seatrial.runner.configuration import recording_map
from tests.models.recording.test_file_set import reader

DOFS = ("surge", "sway", "yaw")
MAP = {
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


@pytest.mark.parametrize(
    ("unit", "power"),
    [
        ("m", -1.0), ("s", -0.5), ("m/s", -0.5), ("rad", 0.0), ("deg/s", 0.5), ("rpm", 0.5),
        ("m/s^2", 0.0), ("rad/s^2", 1.0), ("kg", -3.0), ("N", -3.0), ("Nm", -4.0), ("kn", -0.5),
    ],
)  # fmt: skip
def test_equal_froude_numbers(unit: str, power: float) -> None:
    """U^2 / (g L) is the same at both scales, as are rho and g: ITTC 7.5-02-05-04, section 2."""
    assert froude_factor(unit, 45.7) == pytest.approx(45.7**power, rel=1e-12)


def test_a_ship_is_read_as_its_model(tmp_path: Path) -> None:
    scale = 25.0
    slow = 5.0
    ship = (slow, scale, scale, 1.0, slow, slow, 1 / slow, 1.0, 1 / slow, scale**3)
    content = mapped(tmp_path / "m.yaml", MAP)
    of_ship = mapped(tmp_path / "s.yaml", {**MAP, "froude_scale": scale})
    model = reader(path=str(written(tmp_path / "m.csv", MODEL)), map=str(content)).read(DOFS)
    read = reader(path=str(written(tmp_path / "s.csv", ship)), map=str(of_ship)).read(DOFS)
    for name in ("t", "eta", "nu", "nu_dot", "inputs", "loads"):
        np.testing.assert_allclose(getattr(read, name), getattr(model, name), rtol=1e-9, atol=1e-9)
    assert model.loads[10, 0] == pytest.approx(1000.0)


def test_a_shaft_speed_without_a_unit_cannot_be_scaled(tmp_path: Path) -> None:
    inputs = {**MAP["inputs"], "n": "shaft"}  # type: ignore[dict-item]
    own = mapped(tmp_path / "s.yaml", {**MAP, "inputs": inputs, "froude_scale": 25.0})
    file = written(tmp_path / "s.csv", MODEL)
    with pytest.raises(ConfigurationError, match=r"columns\.inputs\.n: got no unit"):
        reader(path=str(file), map=str(own)).read(DOFS)


def test_files_that_are_tested_on_have_a_map_of_their_own(tmp_path: Path) -> None:
    """The file without thrust has no number there, the other columns are read by their own map."""
    turned = {**MAP, "inputs": {**MAP["inputs"], "delta": {"column": "-rudder", "unit": "deg"}}}  # type: ignore[dict-item]
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
    with pytest.raises(ConfigurationError, match=r"test_map is of files of excitation\.test"):
        reader(path=str(first), map=str(maps[0]), test_map=str(maps[1]))


def test_loads_are_stored_with_the_recording(tmp_path: Path) -> None:
    content = mapped(tmp_path / "m.yaml", MAP)
    recording = reader(path=str(written(tmp_path / "m.csv", MODEL)), map=str(content)).read(DOFS)
    write_recording(recording, tmp_path / "m.parquet", {})
    stored = recording_map.reader_of(tmp_path / "m.parquet", {}).read(DOFS)
    assert stored.load_names == recording.load_names
    np.testing.assert_array_equal(stored.loads, recording.loads)
