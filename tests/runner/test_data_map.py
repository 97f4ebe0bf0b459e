"""`seatrial data`: maps and what is asked, what the check mends, Parquet files to the bit."""

import json
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from pyarrow import parquet

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.recording.diagnosis import examine
from seatrial.models.recording.recording import Recording
from seatrial.models.recording.source import ReadOptions, read_sources
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.kinematics import wrap
from seatrial.runner.commands import data_commands
from seatrial.runner.commands.data_commands import write_recording
from seatrial.runner.configuration.recording_map import read_map, reader_of
from tests.data import DATA
from tests.runner.command import Command
from tests.runner.conftest import Data

PLANAR = ("surge", "sway", "yaw")
KNOT, DEG = 3600.0 / 1852.0, 180.0 / np.pi


def _motion() -> dict[str, Array]:
    """A vessel that turns to both sides at changing speed, at 5 Hz for five minutes."""
    t = np.arange(0.0, 300.0, 0.2)
    r = 0.06 * np.sin(0.05 * t) + 0.03 * np.sin(0.11 * t)
    psi = np.concatenate([[0.0], np.cumsum(0.1 * (r[1:] + r[:-1]))]) + 0.3
    u, v = 2.0 + 0.4 * np.sin(0.07 * t), -0.5 * r
    vn, ve = u * np.cos(psi) - v * np.sin(psi), u * np.sin(psi) + v * np.cos(psi)
    x, y = (np.concatenate([[0.0], np.cumsum(0.1 * (d[1:] + d[:-1]))]) for d in (vn, ve))
    return {"t": t, "x": x, "y": y, "psi": psi, "u": u, "v": v, "r": r, "vn": vn, "ve": ve}


def _log(folder: Path, columns: Mapping[str, Array]) -> str:
    table = np.column_stack(list(columns.values()))
    path = folder / "log.csv"
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="", fmt="%.9g")
    return str(path)


def test_units_and_signs_that_the_check_tried_are_in_the_map(tmp_path: Path, data: Data) -> None:
    m = _motion()
    columns = {**m, "u": m["u"] * KNOT, "v": m["v"] * KNOT}
    columns |= {"r": -m["r"] * DEG, "psi": m["psi"] * DEG}
    del columns["vn"], columns["ve"]
    shown = data("map", _log(tmp_path, {**columns, "note": 0.0 * m["t"]}))
    node = yaml.safe_load(shown.out)
    knots = {"surge": {"column": "u", "unit": "knot"}, "sway": {"column": "v", "unit": "knot"}}
    assert node["velocity"] == {**knots, "yaw": {"column": "-r", "unit": "deg/s"}}
    assert node["position"] == {"surge": "x", "sway": "y", "yaw": {"column": "psi", "unit": "deg"}}
    assert "left out: column note: do not move" in shown.err
    assert "{column: psi, unit: deg}" in shown.err


def test_a_map_is_not_written_over_and_has_the_inputs_of_a_vessel(
    tmp_path: Path, data: Data
) -> None:
    m, out = _motion(), tmp_path / "map.yaml"
    columns = {name: m[name] for name in ("t", "x", "y", "psi", "u", "v", "r")}
    path = _log(tmp_path, {**columns, "Helm": m["r"], "RPM": 60.0 * m["u"], "tau_x": m["u"]})
    words = ["map", path, "--vessel", "esso_osaka", "-o", str(out)]
    data(*words)
    node = yaml.safe_load(out.read_text())
    assert node["inputs"] == {"delta": "Helm", "n": {"column": "RPM", "unit": "rpm"}}
    assert "force" not in node
    with pytest.raises(ConfigurationError, match="exists already, expected a new file or --force"):
        data_commands.main(words)
    data(*words, "--force")
    shown = data("check", path, "--map", out).out
    assert "no problem: pose and velocity are consistent" in shown
    assert "RPM" in shown.partition("Columns")[2]
    assert "the map" in shown


@pytest.mark.parametrize("recorded", [(), ("u", "v")])
def test_positions_east_first_are_found(
    tmp_path: Path, data: Data, recorded: tuple[str, ...]
) -> None:
    """By the velocities, or else by the way, which a boat makes ahead."""
    m = _motion()
    columns = {"t": m["t"], "x": m["y"], "y": m["x"], **{k: m[k] for k in ("psi", *recorded)}}
    assert yaml.safe_load(data("map", _log(tmp_path, columns)).out)["frames"] == {"position": "ENU"}


def test_outliers_are_a_problem(tmp_path: Path, data: Data) -> None:
    m = _motion()
    u = m["u"].copy()
    u[::25] += 9.0
    columns = {name: m[name] for name in ("t", "x", "y", "psi", "v", "r")}
    shown = data("check", _log(tmp_path, {**columns, "u": u})).out
    assert "no problem" not in shown
    assert "problem: outliers: velocity.surge" in shown


def test_the_current_is_named_and_nothing_is_drawn_across_a_gap(tmp_path: Path, data: Data) -> None:
    """Half a metre per second to the east, and 40 s without rows."""
    m = _motion()
    east, ve = m["y"] + 0.5 * m["t"], m["ve"] + 0.5
    latitude = 59.0 + m["x"] / 111_195.0
    columns = {
        "t": m["t"], "lat": latitude,
        "lon": 24.0 + east / 111_195.0 / np.cos(np.radians(59.0)), "heading": m["psi"],
        "SOG": np.hypot(m["vn"], ve), "COG": np.arctan2(ve, m["vn"]), "STW": m["u"], "r": m["r"],
    }  # fmt: skip
    there = (m["t"] < 100.0) | (m["t"] > 140.0)
    path = _log(tmp_path, {name: values[there] for name, values in columns.items()})
    html, out = tmp_path / "page.html", tmp_path / "map.yaml"
    data("map", path, "-o", out)
    shown = data("check", path, "--map", out, "--html", html).out
    assert "current: 0.50 m/s towards 90 deg on average" in shown
    assert "duration [s]" in shown
    assert "current: 0.50 m/s" in html.read_text()
    known = examine(reader_of(Path(path), read_map(out)), ("surge", "sway", "yaw"))
    assert known is not None
    recording = known.recording
    assert len(recording.pieces()) == 2
    sheet = data_commands.figure(known)
    assert len(sheet.axes) == 9
    pieces = [len(piece) for piece in recording.pieces()]
    for axes in sheet.axes:
        drawn = [len(np.asarray(line.get_xdata())) for line in axes.lines]
        assert sorted(set(drawn)) == sorted(pieces)


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
        (), columns(2), columns(2), ("delta", "output[0]"), columns(1), ("propeller.thrust",),
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


@pytest.mark.data
def test_a_converted_recording_is_the_mapped_one(seatrial: Command) -> None:
    """BlueBoat: degrees, milliseconds, its own axes, thrust left and right."""
    boat = DATA / "blueboat" / "fixed_00000218.csv"
    Path("map.yaml").write_text(
        "time: {column: original_timestamp, unit: ms}\n"
        "position: {surge: x_ned, sway: y_ned, yaw: {column: yaw, unit: deg}}\n"
        "velocity: {surge: surge, sway: sway, yaw: yaw_rate}\n"
        "force: {surge: left_force, sway: right_force, yaw: thr_left}\n"
    )
    words = ("data", "convert", str(boat), "out.parquet", "--map", "map.yaml")
    assert "surge, sway, yaw" in seatrial.succeeds(*words).out
    mapped = reader_of(boat, read_map(Path("map.yaml"))).read(PLANAR)
    assert_same(mapped, reader_of(Path("out.parquet"), {}).read(PLANAR))
    assert "no problem" in seatrial.succeeds("data", "check", "out.parquet").out
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
        assert message in seatrial.refuses(*wrong)
