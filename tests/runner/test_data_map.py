"""`seatrial data map` and `data check`: what is sure, asked and left out; what the check mends."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
import yaml

from seatrial.models.errors import ConfigurationError
from seatrial.models.recording.diagnosis import examine
from seatrial.models.vessel.basis import Array
from seatrial.runner.commands import data_commands, recording_report
from seatrial.runner.configuration.recording_map import read_map, reader_of

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


def _mapped(path: str, capsys: pytest.CaptureFixture[str]) -> tuple[dict[str, object], str]:
    assert data_commands.main(["map", path]) == 0
    shown = capsys.readouterr()
    return yaml.safe_load(shown.out), shown.err


def test_units_and_signs_that_the_check_tried_are_in_the_map(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    m = _motion()
    columns = {**m, "u": m["u"] * KNOT, "v": m["v"] * KNOT}
    columns |= {"r": -m["r"] * DEG, "psi": m["psi"] * DEG}
    del columns["vn"], columns["ve"]
    node, said = _mapped(_log(tmp_path, {**columns, "note": 0.0 * m["t"]}), capsys)
    knots = {"surge": {"column": "u", "unit": "knot"}, "sway": {"column": "v", "unit": "knot"}}
    assert node["velocity"] == {**knots, "yaw": {"column": "-r", "unit": "deg/s"}}
    assert node["position"] == {"surge": "x", "sway": "y", "yaw": {"column": "psi", "unit": "deg"}}
    assert "left out: do not move: note" in said
    assert "{column: psi, unit: deg}" in said


def test_a_map_is_not_written_over_and_has_the_inputs_of_a_vessel(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    m, out = _motion(), tmp_path / "map.yaml"
    columns = {name: m[name] for name in ("t", "x", "y", "psi", "u", "v", "r")}
    path = _log(tmp_path, {**columns, "Helm": m["r"], "RPM": 60.0 * m["u"], "tau_x": m["u"]})
    words = ["map", path, "--vessel", "esso_osaka", "-o", str(out)]
    assert data_commands.main(words) == 0
    node = yaml.safe_load(out.read_text())
    assert node["inputs"] == {"delta": "Helm", "n": {"column": "RPM", "unit": "rpm"}}
    assert "force" not in node
    with pytest.raises(ConfigurationError, match="exists already, expected a new file or --force"):
        data_commands.main(words)
    assert data_commands.main([*words, "--force"]) == 0
    assert data_commands.main(["check", path, "--map", str(out)]) == 0
    shown = capsys.readouterr().out
    assert "no problem: pose and velocity are consistent" in shown
    assert "RPM" in shown.partition("Columns")[2]
    assert "the map" in shown


def test_outliers_are_a_problem(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    m = _motion()
    u = m["u"].copy()
    u[::25] += 9.0
    columns = {name: m[name] for name in ("t", "x", "y", "psi", "v", "r")}
    assert data_commands.main(["check", _log(tmp_path, {**columns, "u": u})]) == 0
    shown = capsys.readouterr().out
    assert "no problem" not in shown
    assert "problem: outliers: velocity.surge" in shown


def test_the_current_is_named_and_nothing_is_drawn_across_a_gap(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
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
    assert data_commands.main(["map", path, "-o", str(out)]) == 0
    assert data_commands.main(["check", path, "--map", str(out), "--html", str(html)]) == 0
    shown = capsys.readouterr().out
    assert "current: 0.50 m/s towards 90 deg on average" in shown
    assert "duration [s]" in shown
    assert "current: 0.50 m/s" in html.read_text()
    known = examine(reader_of(Path(path), read_map(out)), ("surge", "sway", "yaw"))
    assert known is not None
    recording = known.recording
    assert len(recording.pieces()) == 2
    velocities, errors = recording_report.figures(known).values()
    assert [len(sheet.axes) for sheet in (velocities, errors)] == [3, 6]
    pieces = [len(piece) for piece in recording.pieces()]
    for axes in (*velocities.axes, *errors.axes):
        drawn = [len(np.asarray(line.get_xdata())) for line in axes.lines]
        assert sorted(set(drawn)) == sorted(pieces)
