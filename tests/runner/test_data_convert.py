"""Recordings as Parquet: through the command line, and back to the bit."""

import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from pyarrow import parquet

from seatrial.models.errors import RecordingError
from seatrial.models.recording.recording import Recording
from seatrial.models.recording.source import ReadOptions, read_sources
from seatrial.models.vessel.kinematics import wrap
from seatrial.runner.__main__ import main
from seatrial.runner.commands.data_convert import write_recording
from seatrial.runner.configuration.recording_map import read_map, reader_of
from tests.data import DATA

PLANAR = ("surge", "sway", "yaw")


def assert_same(one: Recording, other: Recording) -> None:
    """Equal to the bit in every field."""
    for field in fields(Recording):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if isinstance(a, np.ndarray):
            assert a.dtype == b.dtype, field.name
            assert a.shape == b.shape, field.name
            assert a.tobytes() == np.ascontiguousarray(b).tobytes(), field.name
        else:
            assert a == b, field.name


def everything(n: int = 30) -> Recording:
    """A recording in two pieces with all that is measured, of numbers that text would not keep."""
    rng = np.random.default_rng(8)

    def columns(k: int) -> np.ndarray:
        return rng.normal(size=(n, k)) * 10.0 ** rng.integers(-300, 20, (n, k))

    attitude = np.cumsum(rng.uniform(-0.5, 0.5, (n, 3)), axis=0)
    attitude[0] = wrap(attitude[0])  # as every recording that was read begins
    eta = np.column_stack([columns(2), attitude[:, 2]])
    t = np.arange(n) * 0.1 + 1e-9 + np.repeat([0.0, 7.0], n // 2)
    return Recording(
        PLANAR, t, eta, columns(3), columns(3), columns(3), attitude, None, columns(3), columns(2),
        False, columns(2), columns(2), ("delta", "output[0]"), columns(1), ("propeller.thrust",),
    )  # fmt: skip


def test_every_field_comes_back_to_the_bit(tmp_path: Path) -> None:
    recording, path = everything(), tmp_path / "a.parquet"
    write_recording(recording, path, {})
    assert_same(recording, reader_of(path, {}).read(PLANAR))
    bare = replace(
        recording, tau=np.zeros_like(recording.tau), tau_actual=None, wind=None, commands=None,
        loads=None, load_names=(),
    )  # fmt: skip
    write_recording(bare, tmp_path / "b.parquet", {})
    assert_same(bare, reader_of(tmp_path / "b.parquet", {}).read(PLANAR))
    part = reader_of(path, {}).read(("surge", "yaw"))
    np.testing.assert_array_equal(part.nu, recording.nu[:, [0, 2]])
    (source,) = read_sources(path, ReadOptions()).values()  # and by any other program, with units
    assert source.units["u_dot"] == "m/s^2"
    np.testing.assert_array_equal(source.numbers("u"), recording.nu[:, 0])


def test_nothing_is_left_where_a_file_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="cannot be written"):
        write_recording(everything(), tmp_path / "none" / "a.parquet", {})
    assert not list(tmp_path.iterdir())


def run(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    monkeypatch.setattr("sys.argv", ["seatrial", *words])
    return main()


@pytest.mark.data
def test_a_converted_recording_is_the_mapped_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """BlueBoat: degrees, milliseconds, its own axes, thrust left and right."""
    monkeypatch.chdir(tmp_path)
    boat = DATA / "blueboat" / "fixed_00000218.csv"
    Path("map.yaml").write_text(
        "time: {column: original_timestamp, unit: ms}\n"
        "position: {surge: x_ned, sway: y_ned, yaw: {column: yaw, unit: deg}}\n"
        "velocity: {surge: surge, sway: sway, yaw: yaw_rate}\n"
        "force: {surge: left_force, sway: right_force, yaw: thr_left}\n"
    )
    words = ("data", "convert", str(boat), "out.parquet", "--map", "map.yaml")
    assert run(monkeypatch, *words) == 0, capfd.readouterr().err
    assert "surge, sway, yaw" in capfd.readouterr().out
    mapped = reader_of(boat, read_map(Path("map.yaml"))).read(PLANAR)
    assert_same(mapped, reader_of(Path("out.parquet"), {}).read(PLANAR))
    assert run(monkeypatch, "data", "check", "out.parquet") == 0
    assert "no problem" in capfd.readouterr().out
    schema = parquet.read_schema("out.parquet")
    known = json.loads(schema.metadata[b"seatrial"])
    assert list(known["sha256"]) == [str(boat)]
    assert known["read_by"]["columns"]["time"] == {"column": "original_timestamp", "unit": "ms"}
    units = {field.name: field.metadata[b"unit"] for field in schema}
    assert (units["t"], units["psi"], units["tau_yaw"]) == (b"s", b"rad", b"Nm")
    for wrong, message in (
        (words, "out.parquet: exists already, expected a new file"),
        ((*words[:3], "b.csv"), "b.csv: got suffix '.csv', expected .parquet"),
        (("data", "convert", "none.csv", "b.parquet"), "none.csv: there is no such file"),
        ((*words[:3], "b.parquet", "--dofs", "up"), "--dofs: got up, expected some of surge"),
    ):
        assert run(monkeypatch, *wrong) == 2
        said = capfd.readouterr().err
        assert message in said
        assert said.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["map.yaml", "out.parquet"]
