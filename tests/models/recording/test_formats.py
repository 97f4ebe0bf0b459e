"""Formats: what a program of the field wrote is read as it was written."""

import struct
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
import scipy
from pyarrow import parquet

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.recording import source as reading
from seatrial.models.recording.source import ReadOptions, Source, TextOptions, column, read_sources
from seatrial.models.recording.times import find_time, seconds
from tests.data import DATA


def one(path: Path, format_: str | None = None, **text: Any) -> Source:
    (source,) = read_sources(path, ReadOptions(format_, TextOptions(**text))).values()
    return source


def file(folder: Path, name: str, content: str | bytes) -> Path:
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


# Text


@pytest.mark.parametrize(
    "content",
    [
        "t,u\n0,1.5\n1,-2\n2,\n",
        "t;u\r\n0;1,5\r\n1;-2,0\r\n2;\r\n",
        "t\tu\n0\t1.5\n1\t-2\n2\tnan\n",
        "# a log\n# of today\nt|u\n0|1.5\n# lost\n1|-2\n2|\n",
        "#t,u\n0,1.5\n1,-2\n2,nan\n",
        "made by hand\n\nt,u\n0,1.5\n1,-2\n2,NaN\n",
        "t,u\ns,m/s\n0,1.5\n1,-2\n2,\n",
        " t  u\n 0  1.5\n 1  -2\n 2  nan\n",
        "a log\nt\tu\n0\t1.5\t\n1\t-2\t\n2\tnan\t\n",
        "// a log\n// of today\nt\tu\n0\t1.5\n1\t-2\n2\tnan\n",
        "!t,u\n!0,1\n!v11\n0,1.5\n1,-2\n2,\n",
        '"t","u"\n"1",0,1.5\n"2",1,-2\n"3",2,NaN\n',
    ],
)
def test_layouts_of_text_are_found_out(tmp_path: Path, content: str) -> None:
    source = one(file(tmp_path, "a.csv", content))
    assert [name for name in source.columns if name not in ("c1", "c3")] == ["t", "u"]
    np.testing.assert_array_equal(source.columns["t"], [0.0, 1.0, 2.0])
    np.testing.assert_array_equal(source.columns["u"], [1.5, -2.0, np.nan])


def test_units_of_a_header_and_of_a_line_below_it(tmp_path: Path) -> None:
    header = one(file(tmp_path, "a.csv", "t [s],u_[m/s],psi (deg),n\n0,1,2,3\n1,1,2,3\n"))
    assert header.units == {"t": "s", "u": "m/s", "psi": "deg"}
    np.testing.assert_array_equal(header.numbers("psi (deg)"), header.numbers("psi"))
    below = one(file(tmp_path, "b.csv", "t,u,n\n[s],[knot],\n0,1,2\n1,1,2\n"))
    assert below.units == {"t": "s", "u": "knot"}
    twice = one(file(tmp_path, "c.csv", "u [m/s],u [knot]\n0,1\n1,2\n"))
    assert list(twice.columns) == ["u [m/s]", "u [knot]"]


def test_options_say_what_cannot_be_found_out(tmp_path: Path) -> None:
    path = file(tmp_path, "a.csv", "x;y;z\n1;2;3\n4.5;5;6\n".encode("utf-16"))
    assert list(one(path).columns) == ["x", "y", "z"]
    path = file(tmp_path, "b.csv", "a,b\nc,d\n1,2\n3,4\n")
    source = one(path, header_lines=0, skip_lines=2, names=("time", "u"))
    np.testing.assert_array_equal(source.columns["u"], [2.0, 4.0])
    path = file(tmp_path, "c.csv", "Länge,b\n1,2\n3,4\n".encode("latin-1"))
    assert list(one(path).columns) == ["Länge", "b"]
    assert one(path).left_out == ("the text is not UTF-8: read as latin-1",)
    path = file(tmp_path, "e.csv", "Länge,“b”\n1,2\n".encode("cp1252"))
    with pytest.raises(RecordingError, match=r"got .*text\.encoding=latin-1 reads"):
        one(path)
    assert list(one(path, encoding="cp1252").columns) == ["Länge", "“b”"]
    with pytest.raises(RecordingError, match="got binary data or text that is not klingo"):
        one(path, encoding="klingon")
    path = file(tmp_path, "d.txt", "1 2 3\n4 5 6\n")
    with pytest.raises(RecordingError, match=r"got 3 columns, expected 2 as in excitation\.text"):
        one(path, names=("a", "b"))


def test_text_stays_as_written_and_a_number_among_it_is_named(tmp_path: Path) -> None:
    text = "time,mode,u\n2025/04/11 11:15:45.313396019,dp,1\n2025/04/11 11:15:46,idle,x\n"
    source = one(file(tmp_path, "a.csv", text))
    assert source.columns["time"].tolist() == [
        "2025/04/11 11:15:45.313396019",
        "2025/04/11 11:15:46",
    ]
    assert source.columns["mode"].tolist() == ["dp", "idle"]
    with pytest.raises(RecordingError, match="column u, line 3: got 'x', expected a finite number"):
        source.numbers("u")


@pytest.mark.data
def test_basins_of_hsva_and_marin() -> None:
    """The heading begins at that of the run; what a zig-zag of 5 and of 10 degrees executes."""
    hsva = one(DATA / "kvlcc2/hsva/HSVA_CPMC_KVLCC2_Z_10_05.dat")
    assert list(hsva.columns)[:2] == ["c1", "c2"]
    np.testing.assert_allclose(np.diff(hsva.numbers("c1")), 0.05, atol=1e-9)
    rudder = hsva.numbers("c9")
    assert np.max(np.abs(rudder)) == pytest.approx(10.0, abs=0.5)
    marin = one(DATA / "kvlcc2/marin/MARIN_FREE_KVLCC2_zz_-10_m.dat")
    assert list(marin.columns) == [f"c{i}" for i in range(1, 12)]
    assert np.max(np.abs(marin.numbers("c10"))) == pytest.approx(10.0, abs=0.5)


@pytest.mark.data
def test_a_folder_of_topics() -> None:
    sources = read_sources(DATA / "milliampere/nlp1", ReadOptions())
    assert len(sources["navigation/pose"]) == 444
    assert len(sources["tau_actual"]) == 20422
    source, name = column(sources, "wrench_force_x")
    assert (source.name, name) == ("tau_actual", "wrench_force_x")
    with pytest.raises(RecordingError, match=r"sources have a column 'data', expected it among"):
        column(sources, "data")
    source, name = column(sources, "actuator_3/azimuth_angle:data")
    assert source.name == "actuators/actuator_3/azimuth_angle"
    with pytest.raises(RecordingError, match="no column 'navigation/speed:x', expected it"):
        column(sources, "navigation/speed:x")
    with pytest.raises(RecordingError, match="no column 'speed', expected it among actuator"):
        column(sources, "speed")


# Other formats


def test_parquet(tmp_path: Path) -> None:
    moments = pd.date_range("2025-04-11 11:15:45.3", periods=4, freq="100ms", tz="UTC")
    frame = pd.DataFrame(
        {"t [s]": [0.0, 1.0, 2.0, 3.0], "n": [1, 2, 3, 4], "on": [True, False, True, True],
         "when": moments, "mode": ["a", "b", "a", "b"], "u": [1.0, np.nan, 2.0, 3.0]}
    )  # fmt: skip
    frame.to_parquet(tmp_path / "a.parquet")
    source = one(tmp_path / "a.parquet")
    assert source.units == {"t": "s"}
    np.testing.assert_array_equal(source.numbers("n"), [1.0, 2.0, 3.0, 4.0])
    np.testing.assert_array_equal(source.numbers("on"), [1.0, 0.0, 1.0, 1.0])
    np.testing.assert_array_equal(source.numbers("u", gaps=True), frame["u"])
    assert source.columns["mode"].tolist() == ["a", "b", "a", "b"]
    read = pd.to_datetime(source.columns["when"].tolist())
    assert read.tolist() == moments.tolist()
    with pytest.raises(RecordingError, match="column u, row 2: got 'nan', expected a finite"):
        source.numbers("u")


@pytest.mark.parametrize("compressed", [False, True])
def test_matlab_5(tmp_path: Path, compressed: bool) -> None:
    """Structures and the cells of runs are sources of their own; text is no column."""
    t, path = np.linspace(0.0, 1.0, 50), tmp_path / "a.mat"
    runs = np.empty(2, dtype=object)
    runs[:] = [{"t": np.arange(10.0 + i), "x": np.arange(10.0 + i)} for i in range(2)]
    variables = {
        "t": t, "nu": np.vstack([t, 2.0 * t]), "rate": 10.0, "note": "hi", "runs": runs,
        "log": {"time": t[:20], "gps": {"pos": np.arange(60.0).reshape(20, 3)}, "name": "run 1"},
        "each": np.array([(1.0, 2.0), (3.0, 4.0)], dtype=[("a", "O"), ("b", "O")]),
    }  # fmt: skip
    scipy.io.savemat(path, variables, do_compression=compressed)
    sources = read_sources(path, ReadOptions())
    assert set(sources) == {"a", "log", "each", "runs/1", "runs/2"}
    assert next(iter(sources.values())).left_out == (
        "rate: float64 of shape (), no columns", "note, log.name: text, no columns",
    )  # fmt: skip
    for source, name, values in (
        ("a", "t", t), ("a", "nu[1]", 2.0 * t), ("log", "gps.pos[2]", np.arange(2.0, 60.0, 3.0)),
        ("runs/1", "x", np.arange(10.0)), ("runs/2", "x", np.arange(11.0)), ("each", "b", [2, 4]),
    ):  # fmt: skip
        np.testing.assert_array_equal(sources[source].columns[name], values)


def test_texts_of_matlab_are_columns(tmp_path: Path) -> None:
    """Dates are written as rows of characters, or as cells of them."""
    dates = [f"2024-05-01 12:00:0{k}" for k in range(4)]
    cells = np.array(dates, dtype=object)
    scipy.io.savemat(tmp_path / "a.mat", {"rows": dates, "cells": cells, "u": np.arange(4.0)})
    source = one(tmp_path / "a.mat")
    assert source.columns["rows"].tolist() == source.columns["cells"].tolist() == dates
    time = find_time(source)
    assert time is not None
    np.testing.assert_allclose(np.diff(seconds(source, time)), 1.0)


def test_matlab_5_with_an_object(tmp_path: Path) -> None:
    """A timeseries, whose contents only MATLAB knows."""

    def element(kind: int, content: bytes) -> bytes:
        return struct.pack("<II", kind, len(content)) + content + bytes(-len(content) % 8)

    path = tmp_path / "a.mat"
    scipy.io.savemat(path, {"t": np.arange(5.0)})
    flags, shape = element(6, struct.pack("<II", 13, 0)), struct.pack("<ii", 1, 2)
    handle = element(14, flags + element(5, shape) + element(1, b"") + element(6, shape))
    names = b"".join(element(1, word) for word in (b"ts", b"MCOS", b"timeseries"))
    log = element(14, element(6, struct.pack("<II", 17, 0)) + names + handle)
    path.write_bytes(path.read_bytes() + log)
    assert one(path).left_out == ("ts: objects of class timeseries, no columns",)


def test_matlab_7_3(tmp_path: Path) -> None:
    """MATLAB writes a user block of 512 bytes, arrays transposed, and text as numbers."""
    h5py = pytest.importorskip("h5py")
    t = np.linspace(0.0, 1.0, 50)
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as stored:
        stored["t"] = t[None, :]
        stored["nu"] = np.column_stack([t, 2.0 * t]).T
        stored["log/u"] = t[None, :20]
        stored["word"] = np.array([[114], [117], [110]], dtype=np.uint16)
        stored["word"].attrs["MATLAB_class"] = np.bytes_("char")
        stored["series"] = np.zeros((1, 6), np.uint32)
        stored["series"].attrs["MATLAB_class"] = np.bytes_("timeseries")
        stored["series"].attrs["MATLAB_object_decode"] = 3
        cell = stored.create_dataset("runs", (2, 1), dtype=h5py.ref_dtype)
        for i in range(2):
            stored[f"#refs#/{i}/t"] = stored[f"#refs#/{i}/x"] = np.arange(10.0 + i)[None]
            cell[i, 0] = stored[f"#refs#/{i}"].ref
    sources = read_sources(tmp_path / "a.mat", ReadOptions())
    assert set(sources) == {"a", "log", "runs/1", "runs/2"}
    assert set(sources["a"].columns) == {"t", "nu[0]", "nu[1]"}
    np.testing.assert_array_equal(sources["log"].columns["u"], t[:20])
    np.testing.assert_array_equal(sources["runs/2"].columns["x"], np.arange(11.0))
    left_out = next(iter(sources.values())).left_out
    assert "series: objects of class timeseries, no columns" in left_out


def ulog(values: list[tuple[int, float]]) -> bytes:
    """A log after the description of PX4: header, flags, one format, one subscription, data."""

    def message(kind: bytes, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), kind[0]) + body

    head = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 100)
    text = message(b"B", bytes(40))
    text += message(b"F", b"speed:uint64_t timestamp;float u;float[2] wind;")
    text += message(b"A", struct.pack("<BH", 0, 1) + b"speed")
    for moment, u in values:
        text += message(b"D", struct.pack("<HQfff", 1, moment, u, 2.0 * u, 3.0 * u))
    return head + text


def test_logs_of_px4(tmp_path: Path) -> None:
    pytest.importorskip("pyulog")
    path = file(tmp_path, "a.ulg", ulog([(100 + 1000 * k, 0.5 * k) for k in range(20)]))
    (source,) = read_sources(path, ReadOptions()).values()
    assert source.name == "speed"
    assert source.units == {"timestamp": "us"}
    np.testing.assert_array_equal(source.numbers("timestamp"), 100.0 + 1000.0 * np.arange(20))
    np.testing.assert_array_equal(source.numbers("u"), 0.5 * np.arange(20))
    np.testing.assert_array_equal(source.numbers("wind[1]"), 1.5 * np.arange(20))


# What is asked for


def test_a_format_by_option_and_one_that_is_not_known(tmp_path: Path) -> None:
    path = file(tmp_path, "log.001", "1 2\n3 4\n")
    assert list(one(path, "dat").columns) == ["c1", "c2"]
    with pytest.raises(ConfigurationError, match=r"excitation\.format: got 'doc', expected one"):
        one(path, "doc")
    with pytest.raises(RecordingError, match="got binary data or text that is not utf-8"):
        one(file(tmp_path, "a.xyz", b"\x00\x01\x02" * 99))


@pytest.mark.parametrize(
    ("suffix", "package", "extra"),
    [("mcap", "rosbags", "ros"), ("h5", "h5py", "mat"), ("nmea", "pynmea2", "nmea")],
)
def test_a_package_that_is_not_installed(
    tmp_path: Path, suffix: str, package: str, extra: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reading, "find_spec", lambda name: None)
    path = file(tmp_path, f"a.{suffix}", b"x")
    with pytest.raises(ConfigurationError) as caught:
        read_sources(path, ReadOptions())
    assert (
        str(caught.value) == f"{path}: {package} is not installed: pip install 'seatrial[{extra}]'"
    )


def test_a_folder_holds_several_formats(tmp_path: Path) -> None:
    file(tmp_path, "a.csv", "t,u\n0,1\n1,2\n")
    (tmp_path / "b").mkdir()
    parquet.write_table(pa.table({"t": [0.0, 1.0]}), tmp_path / "b" / "c.parquet")
    parquet.write_table(pa.table({"t": [0.0, 1.0]}), tmp_path / "a.parquet")
    file(tmp_path, "notes.md", "windy")
    assert set(read_sources(tmp_path, ReadOptions())) == {"a.csv", "a.parquet", "b/c"}
    assert set(read_sources(tmp_path, ReadOptions("parquet"))) == {"a", "b/c"}
    empty = tmp_path / "b" / "none"
    empty.mkdir()
    with pytest.raises(RecordingError, match="holds no recording"):
        read_sources(empty, ReadOptions())


# What a text says besides numbers


def test_missing_values_repeated_titles_and_headers_are_named(tmp_path: Path) -> None:
    rows = "".join(f"{i},{i},{2 * i},{i},{'N/A' if i == 3 else i}\n" for i in range(5))
    header = "t,x,x,t,v\n"
    source = one(file(tmp_path, "a.csv", header + rows + header + rows))
    assert list(source.columns) == ["t", "x.1", "x.2", "v"]
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(source.columns["v"])), [3, 5, 9])
    assert set(source.left_out) == {
        "column v: 2 of 11 cells are N/A, 1 of 11 cells are v: missing values",
        *(f"column {c}: 1 of 11 cells are {c[0]}: missing values" for c in ("t", "x.1", "x.2")),
        "column t: stands again, with equal cells",
    }
    with pytest.raises(RecordingError, match=r"no column 'x', expected it among t, x\.1, x\.2"):
        column({"a": source}, "x")


@pytest.mark.parametrize("word", ["N/A", "na", "NULL", "None", "nil", "-", "--", "#N/A", "n.a."])
def test_words_that_mean_missing(tmp_path: Path, word: str) -> None:
    source = one(file(tmp_path, "a.csv", f"t,u\n0,1\n1,{word}\n2,3\n"))
    np.testing.assert_array_equal(source.columns["u"], [1.0, np.nan, 3.0])
    assert source.left_out == (f"column u: 1 of 3 cells are {word}: missing values",)


def test_few_cells_and_rows_that_do_not_fit_are_left_out_and_named(tmp_path: Path) -> None:
    """A sensor that writes ERR, a number that is none, and a file whose last line is cut."""
    rows = [f"{k},{'ERR' if k == 4 else '1e31' if k == 5 else k}\n" for k in range(9)]
    source = one(file(tmp_path, "a.csv", "".join(["t,u\n", *rows, "9"])))
    np.testing.assert_array_equal(source.numbers("t"), np.arange(9.0))
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(source.columns["u"])), [4, 5])
    assert set(source.left_out) == {
        "1 rows with more or fewer than 2 cells",
        "column u: 1 of 9 cells are ERR, 1 of 9 cells are 1e31: missing values",
    }
    with pytest.raises(RecordingError, match="column u, line 6: got 'ERR', expected a finite"):
        source.numbers("u")
    with pytest.raises(RecordingError, match="line 3: got 1 cells, expected 2"):
        one(file(tmp_path, "b.csv", "t,u\n0,1\n1\n2\n"))


def test_exports_of_influxdb(tmp_path: Path) -> None:
    """Written by pandas, with a missing value, and by its own command, with annotations."""
    rows = [(f"2024-05-22T15:30:0{i}Z", n, "N/A" if i == 3 else i) for n in "uv" for i in range(5)]
    table = pd.DataFrame(rows, columns=["_time", "_field", "_value"])
    table.to_csv(tmp_path / "a.csv")
    source = one(tmp_path / "a.csv")
    assert list(source.columns) == ["_time", "u", "v"]
    np.testing.assert_array_equal(source.columns["v"], [0.0, 1.0, 2.0, np.nan, 4.0])
    assert "column _value: 2 of 10 cells are N/A: missing values" in source.left_out
    head = "#datatype,string,long,dateTime:RFC3339,{},string,string\n#default,_result,,,,,\n"
    titles = ",result,table,_time,_value,_field,_measurement\n"
    export = head.format("double") + titles
    export += "".join(f",,0,2024-05-22T15:30:0{i}Z,{i},{f},imu\n" for f in "uv" for i in range(4))
    export += "\n" + head.format("string") + titles + ",,1,2024-05-22T15:30:01Z,auto,mode,ap\n" * 2
    sources = read_sources(file(tmp_path, "b.csv", export), ReadOptions())
    assert {n: list(s.columns) for n, s in sources.items()} == {
        "imu": ["_time", "u", "v"], "ap": ["_time", "mode"],
    }  # fmt: skip
    np.testing.assert_array_equal(sources["imu"].numbers("v"), np.arange(4.0))


def test_titles_that_repeat_have_the_title_without_cells_before_them(tmp_path: Path) -> None:
    """As exports of messages of ROS write them."""
    text = "t,position,x,y,linear,x,y\n" + "".join(f"{k},,{k},1,,{2 * k},3\n" for k in range(3))
    titles = ["t", "position", "position.x", "position.y", "linear", "linear.x", "linear.y"]
    assert list(one(file(tmp_path, "b.csv", text)).columns) == titles


def test_degrees_and_minutes(tmp_path: Path) -> None:
    angles = one(file(tmp_path, "a.csv", "lat [lat],N/S,lon [lon]\n" + 2 * "4030.0,S,1130.0\n"))
    assert (angles.columns["lat"].tolist(), angles.units["lat"]) == ([-40.5, -40.5], "deg")
    assert angles.columns["lon"].tolist() == [11.5, 11.5]


def test_text_of_gliders(tmp_path: Path) -> None:
    """Slocum: lines of keys, then names, units and sizes; latitude as degrees and minutes."""
    text = "dbd_label: DBD_ASC(dinkum_binary_data_ascii)file\nnum_ascii_tags: 14\nfull: 1\n"
    text += "m_present_time m_lat m_heading\ntimestamp lat rad\n8 8 4\n"
    text += "1334567890.5 -4030.0 NaN\n1334567894.5 69696969 1.5\n" * 4
    source = one(file(tmp_path, "a.dba", text))
    assert source.units == {"m_present_time": "s", "m_lat": "deg", "m_heading": "rad"}
    np.testing.assert_array_equal(source.columns["m_lat"][:2], [-40.5, np.nan])


# Files of programs


def test_workbooks(tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for row in (["Today"], [], ["Date", "u [m/s]"], [pd.Timestamp("2024-05-01 12:00:00"), 0.5],
                [pd.Timestamp("2024-05-01 12:00:01"), "N/A"]):  # fmt: skip
        book.active.append(row)
    book.create_sheet("notes").append(["windy"])
    book.save(tmp_path / "a.xlsx")
    (source,) = read_sources(tmp_path / "a.xlsx", ReadOptions()).values()
    assert (source.name, source.units) == ("Sheet", {"u": "m/s"})
    assert source.columns["Date"].tolist() == ["2024-05-01 12:00:00", "2024-05-01 12:00:01"]
    np.testing.assert_array_equal(source.columns["u"], [0.5, np.nan])
    assert [line.partition(":")[0] for line in source.left_out] == ["sheet notes", "column u"]


@pytest.mark.parametrize("engine", ["h5netcdf", "scipy"])
def test_netcdf(tmp_path: Path, engine: Any) -> None:
    xr = pytest.importorskip("xarray")
    moments = pd.date_range("2024-05-22 15:30", periods=5, freq="100ms")
    xr.Dataset(
        {"u": ("time", np.arange(5.0), {"units": "m s-1"}), "z": ("level", np.arange(3.0))},
        coords={"time": moments},
    ).to_netcdf(tmp_path / "a.nc", engine=engine)
    sources = read_sources(tmp_path / "a.nc", ReadOptions())
    assert {name: set(s.columns) for name, s in sources.items()} == {
        "time": {"time", "u"}, "level": {"z"},
    }  # fmt: skip
    assert sources["time"].units == {"u": "m s**-1"}
    assert pd.to_datetime(sources["time"].columns["time"].tolist()).tolist() == moments.tolist()


def dataflash() -> bytes:
    """A log after the description of ArduPilot: formats, units, two cores of an estimator."""

    def message(kind: int, layout: str, *values: object) -> bytes:
        return b"\xa3\x95" + bytes([kind]) + struct.pack("<" + layout, *values)

    log = b""
    for kind, size, name, form, columns in (
        (128, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns"),
        (129, 44, b"FMTU", b"QBNN", b"TimeUS,FmtType,UnitIds,MultIds"),
        (130, 76, b"UNIT", b"QbZ", b"TimeUS,Id,Label"),
        (1, 22, b"XKF1", b"QBfcL", b"TimeUS,C,PN,Yaw,Lat"),
    ):
        log += message(128, "BB4s16s64s", kind, size, name, form, columns)
    for letter, unit in ((b"m", b"m"), (b"h", b"degheading"), (b"#", b"instance")):
        log += message(130, "Qb64s", 9000, ord(letter), unit)
    log += message(129, "QB16s16s", 9001, 1, b"s#mh-", b"F---G")
    for k in range(40):
        log += message(1, "QBfhi", 100_000 + 20_000 * k, k % 2, 0.5 * k, -1234, 473977420)
    return log


@pytest.mark.parametrize("name", ["a.BIN", "a.log"])
def test_logs_of_ardupilot(tmp_path: Path, name: str) -> None:
    """Told by its suffix, or by its content."""
    pytest.importorskip("pymavlink")
    path = file(tmp_path, name, dataflash() + b"\xa3\x95\x01cut")
    sources = read_sources(path, ReadOptions())
    source = sources["XKF1/1"]
    assert source.units == {"TimeUS": "us", "PN": "m", "Yaw": "deg"}
    np.testing.assert_array_equal(source.columns["PN"], np.arange(0.5, 20.0, 1.0))
    assert (source.columns["Yaw"][0], source.columns["Lat"][0]) == (-12.34, 47.397742)
    assert next(iter(sources.values())).left_out == ("6 bytes that are no messages",)


def test_logs_of_mavlink(tmp_path: Path) -> None:
    pytest.importorskip("pymavlink")
    from pymavlink.dialects.v20 import ardupilotmega as dialect

    vessel, shore = dialect.MAVLink(None, srcSystem=1), dialect.MAVLink(None, srcSystem=255)
    log = b""
    for k in range(10):
        for sender, message in (
            (vessel, dialect.MAVLink_attitude_message(100 * k, 0.0, 0.0, 0.25, 0.0, 0.0, 0.5)),
            (vessel, dialect.MAVLink_global_position_int_message(k, 473977420, *7 * [0])),
            (vessel, dialect.MAVLink_heartbeat_message(11, 3, 0, 0, 4, 3)),
            (shore, dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)),
        ):  # fmt: skip
            log += struct.pack(">Q", 1716391812000000 + 100000 * k) + message.pack(sender)
    sources = read_sources(file(tmp_path, "a.tlog", log), ReadOptions())
    assert set(sources) == {"ATTITUDE", "GLOBAL_POSITION_INT", "HEARTBEAT/1", "HEARTBEAT/255"}
    assert sources["ATTITUDE"].units["yaw"] == "rad"
    np.testing.assert_allclose(
        sources["ATTITUDE"].columns["timestamp"], 1716391812.0 + 0.1 * np.arange(10), atol=1e-6
    )
    assert sources["GLOBAL_POSITION_INT"].columns["lat"][0] == 47.397742


def sentence(body: str) -> str:
    total = 0
    for letter in body.encode():
        total ^= letter
    return f"${body}*{total:02X}"


@pytest.mark.parametrize("stamp", ["", "2024-05-22T23:59:{:02d}.500Z ", "17163918{:02d}.5,"])
def test_nmea(tmp_path: Path, stamp: str) -> None:
    """Sentences of a second across midnight: the day of RMC, and the next one."""
    pytest.importorskip("pynmea2")
    lines = []
    for k, clock in enumerate(("235958", "235959", "000000")):
        day = "230394" if clock < "2" else "220394"
        for body in (
            f"GPRMC,{clock}.00,A,4807.50,S,01130.00,W,22.4,084.4,{day},003.1,W", "HEHDT,274.5,T",
            "IIMWV,214.8,R,10.0,K,A", "IIMWV,200.0,T,5.0,N,A", "HEROT,-12.5,V",
            "GPVTG,84.4,T,,M,22.4,N,41.5,K", f"PASHR,{clock}.00,84.4,T,1.5,-0.5,0.1,,,,1,1",
        ):  # fmt: skip
            lines.append(stamp.format(k) + sentence(body))
        lines += [stamp.format(k) + "$HEHDT,1.0,T*00", "!AIVDM,1,1,,A,15Mg,0*4E"]
    sources = read_sources(file(tmp_path, "a.log", "\r\n".join(lines)), ReadOptions())
    assert list(sources) == ["RMC", "HDT", "MWV/R", "MWV/T", "VTG", "ASHRATT"]
    assert sources["VTG"].units["spd_over_grnd_kmph"] == "km/h"
    assert sources["ASHRATT"].columns["pitch"][0] == -0.5
    rmc = sources["RMC"]
    assert (rmc.columns["latitude"][0], rmc.columns["longitude"][0]) == (-48.125, -11.5)
    assert rmc.units["spd_over_grnd"] == "knot"
    assert (sources["MWV/R"].units["wind_speed"], sources["MWV/T"].units["wind_speed"]) == (
        "km/h", "knot",
    )  # fmt: skip
    assert set(rmc.left_out) == {
        "3 sentences AIVDM of unknown type", "3 sentences with a wrong checksum",
        "3 sentences ROT of status V (not valid)",
    }  # fmt: skip
    times = sources["HDT"].columns["time"]
    if stamp.startswith("20"):
        assert times[1] == "2024-05-22T23:59:01.500Z"
    else:
        np.testing.assert_array_equal(np.diff(times), [1.0, 1.0])
        first = 1716391800.5 if stamp else pd.Timestamp("1994-03-22 23:59:58").timestamp()
        assert times[0] == first
