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
from seatrial.models.recording import sources as reading
from seatrial.models.recording.source import TextOptions
from seatrial.models.recording.sources import ReadOptions, Source, column, read_sources
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
    ],
)
def test_layouts_of_text_are_found_out(tmp_path: Path, content: str) -> None:
    source = one(file(tmp_path, "a.csv", content))
    assert list(source.columns) == ["t", "u"]
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
    with pytest.raises(RecordingError, match=r"line 1: got .*text\.encoding=latin-1 reads"):
        one(path)
    assert list(one(path, encoding="cp1252").columns) == ["Länge", "“b”"]
    path = file(tmp_path, "d.txt", "1 2 3\n4 5 6\n")
    with pytest.raises(RecordingError, match=r"got 3 columns, expected 2 as in excitation\.text"):
        one(path, names=("a", "b"))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"separator": "::"}, "separator: got '::', expected one character"),
        ({"decimal": ";"}, "decimal: got ';', expected '.', ',' or null"),
        ({"decimal": ",", "separator": ","}, "expected a different separator"),
        ({"encoding": "klingon"}, "encoding: got 'klingon', expected one that is known"),
        ({"names": ("a", "a")}, "names: got a, a, expected each once"),
    ],
)
def test_options_of_text_that_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        TextOptions(**options)


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
def test_units_of_the_esso_osaka() -> None:
    source = one(DATA / "esso/random/random_03-Aug-2020_11_04_37.csv")
    assert source.units["psi_hat"] == "rad"
    assert source.units["n_prop"] == "rps"
    assert source.units["wind_velo_true"] == "m/s"
    np.testing.assert_allclose(np.diff(source.numbers("t")), 0.1, atol=1e-6)


@pytest.mark.data
def test_a_folder_of_topics() -> None:
    sources = read_sources(DATA / "milliampere/nlp1", ReadOptions())
    assert len(sources["navigation/pose"]) == 444
    assert len(sources["tau_actual"]) == 20422
    source, name = column(sources, "wrench_force_x")
    assert (source.name, name) == ("tau_actual", "wrench_force_x")
    with pytest.raises(RecordingError, match=r"sources have a column 'data': .*; expected one of"):
        column(sources, "data")
    source, name = column(sources, "actuator_3/azimuth_angle:data")
    assert source.name == "actuators/actuator_3/azimuth_angle"
    with pytest.raises(RecordingError, match="no source 'navigation/speed', expected it among act"):
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
    t = np.linspace(0.0, 1.0, 50)
    log = {"time": t[:20], "gps": {"pos": np.arange(60.0).reshape(20, 3)}, "name": "run 1"}
    path = tmp_path / "a.mat"
    variables = {"t": t, "nu": np.vstack([t, 2.0 * t]), "log": log, "rate": 10.0}
    scipy.io.savemat(path, variables, do_compression=compressed)
    sources = read_sources(path, ReadOptions())
    assert set(sources) == {"a", "log"}
    np.testing.assert_array_equal(sources["a"].columns["t"], t)
    np.testing.assert_array_equal(sources["a"].columns["nu[1]"], 2.0 * t)
    np.testing.assert_array_equal(sources["log"].columns["gps.pos[2]"], np.arange(2.0, 60.0, 3.0))


def test_matlab_7_3(tmp_path: Path) -> None:
    """MATLAB writes a user block of 512 bytes, arrays transposed, and text as numbers."""
    h5py = pytest.importorskip("h5py")
    t = np.linspace(0.0, 1.0, 50)
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as stored:
        stored["t"] = t[None, :]
        stored["nu"] = np.column_stack([t, 2.0 * t]).T
        stored["log/u"] = t[None, :20]
        stored["word"] = np.array([[114, 117, 110]], dtype=np.uint16)
        stored["word"].attrs["MATLAB_class"] = np.bytes_("char")
    sources = read_sources(tmp_path / "a.mat", ReadOptions())
    assert set(sources) == {"a", "log"}
    assert set(sources["a"].columns) == {"t", "nu[0]", "nu[1]"}
    np.testing.assert_array_equal(sources["log"].columns["u"], t[:20])


@pytest.mark.data
def test_matlab_files_of_slicot() -> None:
    """The robot arm of DaISy: 1024 samples of input and output."""
    (source,) = read_sources(DATA / "slicot/robot_arm_dat.mat", ReadOptions()).values()
    assert len(source) == 1024


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


@pytest.mark.parametrize(
    ("suffix", "package", "extra"), [("mcap", "rosbags", "ros"), ("ulg", "pyulog", "ulog")]
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
    with pytest.raises(RecordingError, match="is a folder without recordings"):
        read_sources(empty, ReadOptions())
