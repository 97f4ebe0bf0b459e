"""What every log must be read by, whoever wrote it: times, units, missing values, course, gaps."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from seatrial.models.errors import RecordingError
from seatrial.models.recording.column_map import Column, ColumnMap, factor, unit_in_title
from seatrial.models.recording.recorded_file import ReadSignals, RecordedFile
from seatrial.models.recording.signals import sampling
from seatrial.models.recording.source import ReadOptions, Source, read_sources
from seatrial.models.recording.times import disagreement, find_time, seconds

T = np.arange(0.0, 120.0, 0.2)
PSI = 0.3 + 0.4 * np.sin(0.1 * T)
U, V = 2.0 + 0.2 * np.sin(0.3 * T), 0.1 * np.cos(0.2 * T)
R = np.gradient(PSI, T)
X = np.cumsum(U * np.cos(PSI) - V * np.sin(PSI)) * 0.2
Y = np.cumsum(U * np.sin(PSI) + V * np.cos(PSI)) * 0.2
PLANAR = ("surge", "sway", "yaw")
STAMPS = pd.Timestamp("2024-05-07 10:00:00") + pd.to_timedelta(T, unit="s")


def written(folder: Path, table: dict[str, Any]) -> dict[str, Source]:
    pd.DataFrame(table).to_csv(folder / "log.csv", index=False)
    return read_sources(folder / "log.csv", ReadOptions())


def read(folder: Path, reading: RecordedFile, *dofs: str, **table: Any) -> ReadSignals:
    return reading.signals(folder / "log.csv", written(folder, table), dofs or PLANAR)


def source_of(folder: Path, table: dict[str, Any]) -> Source:
    (source,) = written(folder, table).values()
    return source


@pytest.mark.parametrize(
    ("title", "values"),
    [
        ("TimeUS", (T * 1e6 + 2.6e8).round().astype(int)),
        ("time_boot_ms", (T * 1e3).round().astype(int)),
        ("utime", (T * 1e6 + 1.7e15).round().astype(int)),
        ("%time", ((T * 1e9).round() + 1.7e18).astype(np.int64)),
        ("Timestamp", (T * 1e3 + 1.7e12).round().astype(int)),
        ("UTC", 45000.0 + T / 86400.0),
        ("UTC", STAMPS.strftime("%H:%M:%S.%f")),
        ("Date", STAMPS.strftime("%d.%m.%Y %H:%M:%S.%f")),
        ("Date", STAMPS.strftime("%d.%m.%y %H:%M:%S.%f")),
        ("Date", (STAMPS + pd.Timedelta(days=10)).strftime("%d/%m/%yT%H:%M:%S.%f")),
        ("Date", (STAMPS + pd.Timedelta(days=10)).strftime("%m/%d/%Y %I:%M:%S.%f %p")),
        ("Date", (STAMPS + pd.Timedelta(days=10)).strftime("%d/%m/%Y, %H:%M:%S.%f")),
        ("datetime", STAMPS.strftime("%Y-%m-%dT%H:%M:%S.%fZ")),
        ("_time", STAMPS.strftime("%Y/%m/%d %H:%M:%S.%f")),
        ("elapsed_time_s", T),
        ("Seconds of day", (T + 86340.0) % 86400.0),
        ("time_boot_ms", ((T * 1e3).round() + 2**32 - 6e4).astype(np.int64) % 2**32),
        ("iTOW", (T * 1e3 + 2.1e8).round().astype(int)),
        ("UTC", STAMPS.strftime("%H%M%S.%f").astype(float)),
        ("Time", STAMPS.strftime("%Y-%m-%d %H:%M:%S.%f CEST")),
        ("Horodatage", STAMPS.strftime("%Y-%m-%d %H:%M:%S.%f")),
    ],
)
def test_times_as_loggers_write_them(title: str, values: object, tmp_path: Path) -> None:
    source = source_of(tmp_path, {"x": X, title: values})
    column = find_time(source)
    assert column.name == title
    t = seconds(source, column)
    np.testing.assert_allclose(t - t[0], T, atol=2e-5)


def test_a_time_of_day_passes_midnight_and_a_date_may_stand_beside_it(tmp_path: Path) -> None:
    stamps = pd.Timestamp("2024-12-31 23:59:30") + pd.to_timedelta(T, unit="s")
    table = {"Date": stamps.strftime("%d/%m/%Y"), "Time": stamps.strftime("%H:%M:%S.%f"), "x": X}
    for names in (["Time", "x"], ["Date", "Time", "x"]):
        source = source_of(tmp_path, {name: table[name] for name in names})
        column = find_time(source)
        t = seconds(source, column)
        np.testing.assert_allclose(t - t[0], T, atol=1e-5)
    assert find_time(source) == Column("Time", date="Date")
    back = source_of(tmp_path, {"Time": ["10:00:01", "10:00:00", "10:00:02"], "x": [0, 1, 2]})
    assert np.ptp(seconds(back, Column("Time"))) == 2.0  # a clock that is set back is no midnight


def test_a_time_in_several_columns(tmp_path: Path) -> None:
    stamps = STAMPS.round("ms")
    parts = {name: getattr(stamps, name.lower()) for name in ("Year", "Month", "Day", "Hour")}
    parts |= {"Min": stamps.minute, "Sec": stamps.second + stamps.microsecond / 1e6, "x": X}
    clock = {"time": stamps.strftime("%H:%M:%S"), "ms": stamps.microsecond // 1000, "x": X}
    for table in (parts, clock):
        source = source_of(tmp_path, table)
        column = find_time(source)
        assert column is not None
        t = seconds(source, column)
        np.testing.assert_allclose(t - t[0], T, atol=1e-5)


def test_a_date_that_may_be_of_two_days_is_asked_with_the_line_that_tells(tmp_path: Path) -> None:
    source = source_of(tmp_path, {"when": STAMPS.strftime("%d/%m/%Y %H:%M:%S"), "x": X})
    with pytest.raises(RecordingError, match="format: '%d/%m/%Y %H:%M:%S'"):
        seconds(source, Column("when"))
    t = seconds(source, Column("when", format="%m/%d/%Y %H:%M:%S"))
    assert pd.Timestamp(t[0], unit="s") == pd.Timestamp("2024-07-05 10:00:00")


def test_the_order_of_day_and_month_is_the_one_that_fits(tmp_path: Path) -> None:
    for day, fits in (("12/25", True), ("25/12", True), ("12/05", False), ("05/12", False)):
        source = source_of(tmp_path, {"when": [f"{day}/2024 10:00:0{k}" for k in range(3)]})
        if fits:
            (first, *_) = seconds(source, Column("when"))
            assert pd.Timestamp(first, unit="s") == pd.Timestamp("2024-12-25 10:00")
        else:
            with pytest.raises(RecordingError, match="is the day or the month first"):
                seconds(source, Column("when"))


def test_gaps_are_told_by_number_place_and_share() -> None:
    found = sampling(np.concatenate([np.arange(10.0), np.arange(14.0, 20.0)]))
    assert (found.rate_hz, found.gaps, found.longest_gap_s, found.longest_gap_at_s) == (1, 1, 5, 9)
    assert found.missing == pytest.approx(4.0 / 19.0)


def test_clocks_that_disagree_are_named(tmp_path: Path) -> None:
    """Nanoseconds without their leading zeros, as a printed `%d.%d` has them."""
    whole = 1744372269 + np.floor(T + 0.05).astype(int)
    rest = np.round((T + 0.05) % 1.0 * 1e9).astype(int)
    printed = [f"{pd.Timestamp(w, unit='s')}.{r}" for w, r in zip(whole, rest, strict=True)]
    table = {"time": printed, "header_stamp_secs": whole, "header_stamp_nsecs": rest, "x": X}
    source = source_of(tmp_path, table)
    said = disagreement(source, Column("time"))
    assert f"{np.sum(rest < 1e8)} of 600 rows" in said
    assert "columns.time: {column: header_stamp_secs, nanoseconds: header_stamp_nsecs}" in said
    for pace in (0.5, 5.0):  # named like a clock, but it counts something else
        other = source_of(tmp_path, {"time": T, "index": pace * T, "x": X})
        assert disagreement(other, Column("time")) is None


def test_of_clocks_that_run_alike_the_one_that_does_not_repeat_counts(tmp_path: Path) -> None:
    stamps = 1.7e12 + 90.0 * np.arange(1000)
    rows = {"Date": pd.to_datetime(stamps // 1000, unit="s").astype(str), "timeStamp": stamps}
    log = source_of(tmp_path, {**rows, "u": np.arange(1000.0)})
    assert find_time(log) == Column("timeStamp", unit="ms")


@pytest.mark.parametrize(
    ("title", "target", "unit"),
    [
        ("heading_deg", "rad", "deg"), ("HeadingDeg", "rad", "deg"), ("u (kn)", "m/s", "knot"),
        ("yaw rate [deg/s]", "rad/s", "deg/s"), ("force_x_kN", "N", "kN"), ("u_ms", "m/s", "m/s"),
        ("shaft_rpm", "revolution/s", "rpm"), ("RPM", "revolution/s", "rpm"), ("x", "m", None),
        ("tau_n", "N*m", None), ("position_s", "m", None),
        ("Shaft speed [rpm]", "revolution/s", "rpm"), ("depth_ft", "m", "ft"),
    ],
)  # fmt: skip
def test_units_in_titles(title: str, target: str, unit: str | None) -> None:
    assert unit_in_title(title, (target,)) == unit


def test_units_as_instruments_write_them_have_their_size() -> None:
    for unit, target, size in (
        ("kt", "m/s", 1852.0 / 3600.0), ("°/min", "rad/s", np.pi / 10800.0), ("%", "", 0.01),
        ("rpm", "1/s", 1.0 / 60.0), ("ft", "m", 0.3048), ("kNm", "N*m", 1000.0),
    ):  # fmt: skip
        assert factor(unit, target) == pytest.approx(size, rel=1e-9)


def test_units_by_the_map_then_the_title_then_what_stands_beside(tmp_path: Path) -> None:
    """Each reading says where its unit is known from, and an explicit one is never overridden."""
    columns = ColumnMap(
        "t", position={"surge": "x", "sway": "y", "yaw": "psi"},
        velocity={"surge": Column("u_kn", unit="m/s"), "sway": "v_kn", "yaw": "r"},
    )  # fmt: skip
    table = {"t": T, "x": X, "y": Y, "psi": PSI + 40.0, "u_kn": U, "v_kn": V * 3600 / 1852, "r": R}
    signals = read(tmp_path, RecordedFile(path="log.csv", columns=columns), **table)
    known = {reading.option: (reading.unit, reading.known_from) for reading in signals.readings}
    assert known["velocity.surge"] == ("m/s", "the map")
    assert known["velocity.sway"] == ("knot", "the title")
    assert known["position.yaw"] == ("rad", "no unit is stated: SI")
    np.testing.assert_allclose(signals.values["velocity.sway"], V, atol=1e-9)
    np.testing.assert_allclose(np.diff(signals.values["position.yaw"]), np.diff(PSI), atol=1e-9)
    beside = ColumnMap(
        "t", position={"yaw": "heading_deg", "roll": "roll"}, velocity={"surge": "u"}
    )
    table = {"t": T, "heading_deg": np.degrees(PSI), "roll": 3.0 * np.sin(T), "u": U}
    signals = read(tmp_path, RecordedFile(path="log.csv", columns=beside), "surge", "yaw", **table)
    assert np.max(np.abs(signals.values["position.roll"])) < 0.06


def test_nothing_vanishes_in_silence(tmp_path: Path) -> None:
    """Sentinels, repeated stamps, times that go back, missing values and gaps are counted."""
    t, u = T.copy(), U.copy()
    t[100], t[200], u[300:303] = t[99], t[195], -999.0
    psi = np.where(np.arange(len(T)) == 350, 511.0, PSI)
    t[400:] += 30.0
    columns = ColumnMap("t", position={"surge": "x", "sway": "y", "yaw": "psi"},
                        velocity={"surge": "u", "sway": "v", "yaw": "r"})  # fmt: skip
    table = {"t": t, "x": X, "y": Y, "psi": psi, "u": u, "v": V, "r": R}
    reading = RecordedFile(path="log.csv", columns=columns, resample_hz=5.0, at_gap="split")
    signals = read(tmp_path, reading, **table)
    said = "\n".join(signals.left_out)
    assert "column u: 3 cells are -999: missing values" in said
    assert "column psi: 1 cells are 511: missing values" in said
    assert "columns x, y, psi, u, v, r: 2 samples are not later than the one before" in said
    assert "1 times repeat" in said
    assert "in gaps: left out, 2 pieces remain" in said
    assert np.min(signals.values["velocity.surge"]) > 1.0


def test_course_and_speed_over_ground_with_a_heading_are_a_body_velocity(tmp_path: Path) -> None:
    """A current of 0.5 m/s to the east: the log and the speed over ground differ by it."""
    ahead = 2.0 + 0.2 * np.sin(0.3 * T)
    north, east = ahead * np.cos(PSI), ahead * np.sin(PSI) + 0.5
    columns = ColumnMap(
        "t", position={"yaw": Column("hdg", unit="deg")},
        geodetic={"latitude": "lat", "longitude": "lon"},
        ground={"speed": Column("sog", unit="knot"), "course": Column("cog", unit="deg")},
        water={"speed": "stw_kn"},
    )  # fmt: skip
    knots, file = 3600.0 / 1852.0, RecordedFile(path="log.csv", columns=columns)
    signals = read(
        tmp_path, file, t=T, hdg=np.degrees(PSI) % 360.0, lat=59.0 + X / 111e3,
        lon=24.0 + Y / 57e3, sog=np.hypot(north, east) * knots,
        cog=np.degrees(np.arctan2(east, north)) % 360.0, stw_kn=ahead * knots,
    )  # fmt: skip
    u, v = (signals.values[f"velocity.{dof}"] for dof in ("surge", "sway"))
    np.testing.assert_allclose(u, ahead + 0.5 * np.sin(PSI), atol=1e-9)
    np.testing.assert_allclose(v, 0.5 * np.cos(PSI), atol=1e-9)
    np.testing.assert_allclose(signals.values["current.east"], 0.5, atol=1e-9)
    np.testing.assert_allclose(signals.values["current.north"], 0.0, atol=1e-9)
