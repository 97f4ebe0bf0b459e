"""Measured files: what is read from them, and what is refused."""

import csv
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.recording.recorded_file import RecordedFile
from tests.data import DATA
from tests.models.recording.test_file_set import reader

PLANAR = ("surge", "sway", "yaw")
ALL = ("surge", "sway", "heave", "roll", "pitch", "yaw")
BELUGA = DATA / "beluga"


def excitation(path: Path | str | None, **options: Any) -> RecordedFile:
    return reader(path=path and str(path), **options)


def write(path: Path, columns: Mapping[str, Sequence[Any]]) -> Path:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
    return path


def surge_columns(n: int = 20) -> dict[str, list[Any]]:
    k = np.arange(n)
    return {
        "Time": [f"{0.1 * i:.10g}" for i in k],
        "position_x": list(-0.1 * k),
        "surge_vel": list(0.01 * k**2),
        "force_x": list(1.0 * k),
    }


def refusal(path: Path, dofs: Sequence[str] = ("surge",), **options: Any) -> str:
    with pytest.raises(RecordingError) as caught:
        excitation(path, **options).read(dofs)
    message = str(caught.value)
    assert "\n" not in message
    assert str(path) in message
    return message


@pytest.mark.data
def test_window_of_hoyer_holds_2399_samples() -> None:
    recording = excitation(BELUGA / "surge-1.csv", start_s=410, end_s=650).read(("surge",))
    assert len(recording) == 2399
    assert recording.t[0] > 410.0
    assert recording.t[-1] < 650.0
    assert recording.period_s == pytest.approx(0.1)
    # The sign of the map is right: the position grows with the velocity.
    assert np.corrcoef(np.gradient(recording.eta[:, 0]), recording.nu[:, 0])[0, 1] > 0.98


def test_columns_and_signs(tmp_path: Path) -> None:
    recording = excitation(write(tmp_path / "a.csv", surge_columns())).read(("surge",))
    k = np.arange(20)
    np.testing.assert_allclose(recording.t, 0.1 * k, atol=1e-12)
    np.testing.assert_allclose(recording.eta[:, 0], 0.1 * k)
    np.testing.assert_allclose(recording.nu[:, 0], 0.01 * k**2)
    np.testing.assert_allclose(recording.tau[:, 0], k)
    np.testing.assert_allclose(recording.nu_dot[:, 0], 0.2 * k, atol=1e-12)  # of (t/0.1)^2 / 100
    np.testing.assert_array_equal(recording.attitude, 0.0)
    assert recording.tau_actual is None


@pytest.mark.data
def test_only_the_columns_in_use_must_exist() -> None:
    recording = excitation(BELUGA / "synthetic_only_surge.csv").read(("surge",))
    assert len(recording) == 230
    assert recording.period_s == pytest.approx(0.1)
    refused = refusal(BELUGA / "synthetic_only_surge.csv", PLANAR)
    assert "no column 'position_y', expected it among c1, Time, force_x" in refused


def test_recorded_acceleration_and_acting_force(tmp_path: Path) -> None:
    columns = surge_columns() | {"acc": [7.0] * 20, "act": [3.0] * 20}
    maps = {"acceleration": {"surge": "acc"}, "actual_force": {"surge": "-act"}}
    recording = excitation(write(tmp_path / "a.csv", columns), columns=maps).read(("surge",))
    np.testing.assert_array_equal(recording.nu_dot, 7.0)
    np.testing.assert_array_equal(recording.tau_actual, -3.0)


def test_outliers_are_counted_and_replaced_only_when_asked(tmp_path: Path) -> None:
    columns = surge_columns(100)
    columns["surge_vel"][40] = 1000.0
    path = write(tmp_path / "a.csv", columns)
    kept = excitation(path)
    assert kept.read(("surge",)).nu[40, 0] == 1000.0
    reader = excitation(path, outliers={"replace": True})
    replaced = reader.read(("surge",))
    assert reader.account(("surge",))[0].left_out == ("column surge_vel: 1 outliers are replaced",)
    assert replaced.nu[40, 0] == pytest.approx(0.01 * 40**2, abs=0.011)
    assert replaced.nu_dot[40, 0] == pytest.approx(8.0)


def test_columns_with_their_own_samples_on_one_grid(tmp_path: Path) -> None:
    """A log of messages: every line holds one sensor's sample."""
    rows = [("Time", "position_x", "surge_vel", "force_x")]
    for k in range(400):
        t = 0.037 * k
        cells = ["", "nan", ""]
        cells[k % 3] = f"{(-2.0 * t, 3.0 * t, 4.0 * t)[k % 3]:.12g}"
        rows.append((f"{t:.12g}", *cells))
    path = tmp_path / "a.csv"
    path.write_text("\n".join(",".join(row) for row in rows))
    recording = excitation(path, resample_hz=10.0).read(("surge",))
    np.testing.assert_allclose(np.diff(recording.t), 0.1)
    assert recording.t[0] == pytest.approx(0.074)  # when the last of the three begins
    np.testing.assert_allclose(recording.eta[:, 0], 2.0 * recording.t, atol=1e-9)
    np.testing.assert_allclose(recording.nu[:, 0], 3.0 * recording.t, atol=1e-9)
    np.testing.assert_allclose(recording.nu_dot[:, 0], 3.0, atol=1e-8)
    held = 0.074 + 0.111 * np.floor((recording.t - 0.074 + 1e-9) / 0.111)  # until the next command
    np.testing.assert_allclose(recording.tau[:, 0], 4.0 * held, atol=1e-9)
    assert "column position_x, line 3: got an empty cell, expected a finite number" in refusal(path)
    message = refusal(path, resample_hz=10.0, max_gap_s=0.1)
    assert "column position_x: got no sample for 0.111 s after 0 s" in message


def test_resampling_across_a_sign_flip_and_a_full_turn(tmp_path: Path) -> None:
    """A steady turn, recorded with positive w: between samples the heading stays on its line."""
    from scipy.spatial.transform import Rotation

    t = 0.4 * np.arange(60)
    quaternions = np.roll(Rotation.from_euler("z", 0.5 * t[:, None]).as_quat(), 1, axis=1)
    quaternions *= np.where(quaternions[:, :1] < 0.0, -1.0, 1.0)
    columns = {"Time": list(t), "yaw_vel": [0.5] * 60, "torque_z": [0.0] * 60}
    columns |= {
        f"orientation_{axis}": list(q) for axis, q in zip("wxyz", quaternions.T, strict=True)
    }
    path = write(tmp_path / "a.csv", columns)
    recording = excitation(path, resample_hz=10.0, heading_deg=0.0).read(("yaw",))
    np.testing.assert_allclose(recording.eta[:, 0], 0.5 * recording.t, atol=1e-3)


def test_what_cannot_be_put_on_one_grid(tmp_path: Path) -> None:
    columns = surge_columns()
    columns["force_x"] = ["1", *[""] * 19]
    path = write(tmp_path / "a.csv", columns)
    assert "column force_x: got 1 samples" in refusal(path, resample_hz=10.0)
    columns = surge_columns()
    columns["force_x"] = [*["1"] * 5, *[""] * 15]
    columns["surge_vel"] = [*[""] * 15, *["1"] * 5]
    path = write(tmp_path / "a.csv", columns)
    assert "got no 3 samples at 10 Hz that all columns cover" in refusal(path, resample_hz=10.0)
    columns = surge_columns()
    columns["Time"][4] = ""
    (signals,) = excitation(write(path, columns), resample_hz=10.0).account(("surge",))
    assert "1 rows have no time: left out" in signals.left_out


def planar_columns(n: int = 20) -> dict[str, list[Any]]:
    columns = surge_columns(n)
    for name in ("position_y", "sway_vel", "yaw_vel", "force_y", "torque_z"):
        columns[name] = [0.0] * n
    columns |= {"orientation_w": [1.0] * n}
    columns |= {f"orientation_{axis}": [0.0] * n for axis in "xyz"}
    return columns


def test_splits_of_a_file(tmp_path: Path) -> None:
    t = 0.1 * np.arange(40)
    assert np.flatnonzero(excitation("a.csv", train_fraction=0.25).split(t).test)[0] == 10
    by_trip = {"trip_starts_s": [0.0, 0.95, 1.95, 2.95], "training_trips": [1, 3]}
    split = excitation("a.csv", **by_trip).split(t)
    np.testing.assert_array_equal(split.train, np.repeat([True, False, True, False], 10))
    np.testing.assert_array_equal(split.test, ~split.train)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"path": None}, ".path: expected a recording, got none"),
        ({"start_s": 5.0, "end_s": 5.0}, ": start_s must lie before end_s = 5, got 5"),
        ({"train_fraction": 0.0}, ": train_fraction must lie between 0 and 1, got 0"),
        ({"train_fraction": 1.0}, ": train_fraction must lie between 0 and 1, got 1"),
        ({"columns": {"ground": {"speed": "v"}}}, "ground: got speed, expected speed, course"),
        ({"training_trips": [1]}, ": training_trips requires trip_starts_s"),
        ({"trip_starts_s": [0, 10], "training_trips": []}, "got [] of trips at [0.0, 10.0] s"),
        ({"trip_starts_s": [0, 9], "training_trips": [1, 2]}, "got [1, 2] of trips at [0.0, 9.0]"),
        ({"trip_starts_s": [10, 0], "training_trips": [1]}, "at [10.0, 0.0] s, expected some"),
        ({"trip_starts_s": [9, 9], "training_trips": [1]}, "at [9.0, 9.0] s, expected some"),
        ({"columns": {"velocity": {"sideways": "v"}}}, "got sideways, expected surge, sway"),
        ({"columns": {"force": {"surge": "-"}}}, "force.surge: got '-', expected a name"),
    ],
)  # fmt: skip
def test_options_out_of_range(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        excitation(**({"path": "there is none.csv"} | options))
    assert message in str(caught.value)
    assert str(caught.value).startswith("excitation")
    assert "\n" not in str(caught.value)


def test_a_degree_of_freedom_without_a_column() -> None:
    one = excitation("there is none.csv")
    object.__setattr__(one.columns, "force", {"surge": "force_x"})
    with pytest.raises(ConfigurationError, match=r"^excitation.columns.force: no column for yaw"):
        one.check(("surge", "yaw"))


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_a_damaged_file_is_refused_or_read_but_nothing_else(
    tmp_path_factory: Any, data: st.DataObject
) -> None:
    path = write(tmp_path_factory.mktemp("damaged") / "a.csv", planar_columns(12))
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(content) - 1))
        length = data.draw(st.sampled_from([0, 1, 1, 1, 3, 40]))
        piece = data.draw(
            st.sampled_from([b"", b"x", b"\n", b",", b'"', b"9", b"e", b"-", b"\xff"])
        )
        content[place : place + length] = piece
    path.write_bytes(bytes(content))
    options = data.draw(
        st.sampled_from([{}, {"resample_hz": 7.0}, {"outliers": {"replace": True, "window": 4}}])
    )
    try:
        recording = excitation(path, **options).read(PLANAR)
    except RecordingError as error:
        assert "\n" not in str(error)  # noqa: PT017 - either outcome is right
    else:
        for values in (recording.eta, recording.nu, recording.nu_dot, recording.tau):
            assert np.all(np.isfinite(values))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"Time": "0.3"},
            "column Time, line 7: got '0.3', expected time to increase by equal steps",
        ),
        (
            {"Time": "0.55"},
            "column Time, line 7: got '0.55', expected time to increase by equal steps, here 0.1 s",
        ),
        ({"Time": ""}, "column Time, line 7: got an empty cell, expected time to increase"),
        ({"force_x": "  "}, "column force_x, line 7: got an empty cell, expected a finite number"),
        ({"force_x": "NaN"}, "column force_x, line 7: got 'NaN', expected a finite number"),
        ({"force_x": "1e31"}, "column force_x, line 7: got '1e31', expected a finite number"),
        ({"force_x": "1e999"}, "column force_x, line 7: got '1e999', expected a finite number"),
        ({"force_x": "1_000"}, "column force_x, line 7: got '1_000', expected a finite number"),
        ({"force_x": "0x10"}, "column force_x, line 7: got '0x10', expected a finite number"),
        ({"surge_vel": "fast"}, "column surge_vel, line 7: got 'fast', expected a finite number"),
        ({"surge_vel": "1\n2"}, "column surge_vel, line 8: got '1 2', expected a finite number"),
    ],
)
def test_bad_cell(tmp_path: Path, change: dict[str, str], message: str) -> None:
    columns = surge_columns()
    for name, cell in change.items():
        columns[name][5] = cell
    assert message in refusal(write(tmp_path / "a.csv", columns))


HEADER = b"Time,position_x,surge_vel,force_x"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty, expected a header and samples"),
        (b"\xef\xbb\xbf", "is empty, expected a header and samples"),
        (HEADER + b"\n", "got a header and no rows"),
        (HEADER + b"\n0,0,0,0\n", "got 1 samples, expected at least 2"),
        (HEADER + b",force_x\n0,1,2,3,4\n0.1,1,2,3,4\n", "surge_vel, force_x.1, force_x.2"),
        (HEADER + b"\n0,0,0,0\n1,0,0\n", "line 3: got 3 cells, expected 4 as in the header"),
        (HEADER + b'\n0,0,0,0\n1,"0,0,0\n' + b"1,0,0,0\n" * 5, "got 2 cells, expected 4"),
        (HEADER + b'\n0,0,0,0\n1,"' + b"0,0,0\n" * 50000, "field larger than field limit"),
        (b"Time,x\n1,2\n\x00\x01\x02", "got binary data"),
        (b"Time,x\n\xff\xfe\xfa", "line 2: got 1 cells, expected 2 as in the header"),
    ],
    ids=range(10),
)
def test_bad_file(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(content)
    assert message in refusal(path)


def test_quaternion_that_is_none(tmp_path: Path) -> None:
    columns = surge_columns() | {f"orientation_{axis}": [0.5] * 20 for axis in "wxyz"}
    columns["orientation_y"][3] = 2.5
    message = refusal(write(tmp_path / "a.csv", columns))
    assert "sample 4: got a quaternion of length 2.65, expected 1" in message
