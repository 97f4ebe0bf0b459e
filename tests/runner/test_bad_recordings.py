"""Damaged, foreign, bomb-like and short files: one line, exit code 2, nothing written.

Files that are no recordings go through the command line one after the other, in a process with
limited memory.
"""

import json
import shutil
import struct
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
import scipy
from pyarrow import parquet

from tests.runner.command import Command
from tests.runner.programs import completed

MEMORY = 2 * 10**9  # bytes
ADDRESSES = 5 * 10**9  # bytes; libraries reserve more than they use
TABLE = "Time,position_x,surge_vel,force_x\n" + "".join(
    f"{0.1 * k:.10g},0,1,2\n" for k in range(50)
)
RUNNING = f"""
import contextlib, io, json, re, resource, sys
from pathlib import Path
resource.setrlimit(resource.RLIMIT_AS, ({ADDRESSES}, {ADDRESSES}))
from seatrial.runner.__main__ import main
for path in sys.argv[1:]:
    said = io.StringIO()
    sys.argv = ["seatrial", "data", "convert", path, "out.parquet", "--dofs", "surge"]
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()):
        code = main()
    Path("out.parquet").unlink(missing_ok=True)
    # not ru_maxrss, which begins at that of the process that started this one
    status = Path("/proc/self/status").read_text()
    most = 1024 * int(re.search(r"VmHWM:\\s+(\\d+)", status)[1])
    print(json.dumps([path, code, said.getvalue(), most]), flush=True)
"""


def good_files(folder: Path) -> dict[str, bytes]:
    """A file that can be read, of each format that can be written here."""
    t = np.arange(50) * 0.1
    parquet.write_table(pa.table({"Time": t, "surge_vel": t}), folder / "good")
    files = {"csv": TABLE.encode(), "parquet": (folder / "good").read_bytes()}
    scipy.io.savemat(folder / "good", {"Time": t, "surge_vel": t}, appendmat=False)
    files["mat"] = (folder / "good").read_bytes()
    if find_spec("h5py"):
        import h5py

        with h5py.File(folder / "good", "w") as stored:
            stored["Time"] = t
        files["h5.mat"] = (folder / "good").read_bytes()
    if find_spec("rosbags"):
        files |= dict(bags(folder))
    if find_spec("pyulog"):
        body = b"speed:uint64_t timestamp;float u;"
        files["ulg"] = b"ULog\x01\x12\x35\x01" + bytes(8) + struct.pack("<HB", len(body), 70) + body
    (folder / "good").unlink()
    return files


def bags(folder: Path) -> Iterator[tuple[str, bytes]]:
    """Numbers in a bag of ROS 1, a database of ROS 2 and an MCAP file with compressed chunks."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    kind = "std_msgs/msg/Float64"
    writers: dict[str, Any] = {
        "bag/bag.bag": Writer1(folder / "bag" / "bag.bag"),
        "db3/db3.db3": Writer(folder / "db3", version=9, storage_plugin=StoragePlugin.SQLITE3),
        "mcap/mcap.mcap": Writer(folder / "mcap", version=9, storage_plugin=StoragePlugin.MCAP),
    }
    writers["bag/bag.bag"].set_compression(Writer1.CompressionFormat.BZ2)
    writers["mcap/mcap.mcap"].set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    (folder / "bag").mkdir()
    for name, writer in writers.items():
        of_one = name.startswith("bag")
        store = get_typestore(Stores.ROS1_NOETIC if of_one else Stores.ROS2_HUMBLE)
        serialise = store.serialize_ros1 if of_one else store.serialize_cdr
        with writer:
            topic = writer.add_connection("/u", kind, typestore=store)
            for k in range(50):
                writer.write(topic, k, serialise(store.types[kind](data=float(k)), kind))
        yield name.partition("/")[0], (folder / name).read_bytes()
        shutil.rmtree((folder / name).parent)


def bad_files(folder: Path) -> list[Path]:
    rng = np.random.default_rng(11)
    noise, files = rng.bytes(5000), dict[str, bytes]()
    for suffix, content in good_files(folder).items():
        half = len(content) // 2
        flipped = np.frombuffer(content, dtype=np.uint8).copy()
        places = rng.integers(0, len(flipped), 1 + len(flipped) // 50)
        flipped[places] = rng.integers(0, 256, len(places))
        files |= {
            f"empty.{suffix}": b"", f"noise.{suffix}": noise, f"zeros.{suffix}": bytes(5000),
            f"short.{suffix}": content[:7], f"half.{suffix}": content[: half + 3],
            f"headed.{suffix}": content[:100] + noise, f"flipped.{suffix}": flipped.tobytes(),
            f"text.{suffix}": "Länge;Höhe\n".encode("utf-16-be") * 50,
        }  # fmt: skip
    files |= {
        "latin.csv": b"Time,L\xe4nge\n1,2\n",
        "rows.csv": b"\n" * 10**6,
        "cells.csv": b"," * 10**6 + b"\n" + b"1," * 10**6,
        "cell.csv": TABLE.encode() + b"1" * 10**7,
        "quoted.csv": TABLE.encode() + b'"' + b"a,b\n" * 10**6,
    }
    paths = [folder / name for name in files]
    for path, content in zip(paths, files.values(), strict=True):
        path.write_bytes(content)
    with (folder / "huge.csv").open("wb") as sparse:
        sparse.truncate(10**11)
    many = pa.table({"Time": pa.array(np.zeros(10**6))})
    with parquet.ParquetWriter(folder / "bomb.parquet", many.schema) as writer:
        for _ in range(100):
            writer.write_table(many)
    paths += [folder / "huge.csv", folder / "bomb.parquet"]
    return paths


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_files_that_are_no_recordings(tmp_path: Path) -> None:
    paths = bad_files(tmp_path)
    before = sorted(path.name for path in tmp_path.iterdir())
    command = (sys.executable, "-W", "error", "-c", RUNNING, *(path.name for path in paths))
    done = completed(*command, folder=tmp_path)
    results = [json.loads(line) for line in done.stdout.splitlines()]
    assert [row[0] for row in results] == [path.name for path in paths], done.stderr[-2000:]
    wrong = []
    for name, code, said, most in results:
        if name == "half.csv":  # a log of text whose last line is cut is read without it
            assert code == 0
        elif code != 2 or said.count("\n") != 1 or name not in said or most > MEMORY:
            wrong.append((name, code, said[-600:], most))
    assert wrong == []
    assert sorted(path.name for path in tmp_path.iterdir()) == before


def words(path: Path, rows: list[list[str]]) -> tuple[str, ...]:
    """The command of a trial on a recording of these rows."""
    lines = ["Time,x,u,X", *(",".join(row) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return (
        "vessel=surge_linear", "excitation=recording", f"excitation.path={path}",
        "~excitation.columns.position", "+excitation.columns.position={surge: x}",
        "~excitation.columns.velocity", "+excitation.columns.velocity={surge: u}",
        "~excitation.columns.force", "+excitation.columns.force={surge: X}",
        "excitation.columns.orientation=null", "excitation.train_fraction=0.5",
    )  # fmt: skip


def rows(count: int) -> list[list[str]]:
    return [
        [f"{0.1 * k:.1f}", f"{0.01 * k:.3f}", f"{0.1 * (-1) ** k:.1f}", str(k % 7)]
        for k in range(count)
    ]


@pytest.fixture
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("recordings") / "short.csv"


def test_numbers_are_read_as_floats_are_written(seatrial: Command, path: Path) -> None:
    recording = rows(40)
    for cell in ("1_000", "١٢", "0x10", "1e400", "1,5", "inf"):
        recording[17][3] = f'"{cell}"'
        said = seatrial.refuses(*words(path, recording), "identifier=none")
        assert f"{path}, column X, line 19: got {cell!r}, expected a finite number" in said
    for k, cell in enumerate(("1e3", "-.5", "+2.", "1E-3", " 7 ")):
        recording[17 + k][3] = cell
    seatrial.succeeds(*words(path, recording), "identifier=none", "dry_run=true")


TOO_FEW = (
    (1, ["identifier=none"], "got 1 samples, expected at least 2"),
    (3, ["identifier=none"], "got 1 samples for testing, expected at least 2"),
    (20, ["identifier=plsr"], "got 10 samples for training, expected at least 12"),
    (60, ["identifier=ls", "identifier.lowpass_hz=1.0"], "too few for a low-pass filter"),
    (4, ["identifier=ls", "identifier.lowpass_hz=null"],
     "got 2 samples for training after the low-pass filters, expected at least 4"),
    (4, ["identifier=ls"], "got 2 samples, too few for a low-pass filter"),
    (40, ["identifier=iv"], "too few for a low-pass filter"),
    (40, ["identifier=robust"], "got 20 samples for training, expected at least 40"),
    (40, ["identifier=none", "excitation.resample_hz=1e9"], "3.9e+09 samples from the 40 rec"),
)  # fmt: skip


def test_too_few_samples(seatrial: Command, path: Path, subtests: pytest.Subtests) -> None:
    for count, options, message in TOO_FEW:
        with subtests.test(message):
            said = seatrial.refuses(*words(path, rows(count)), *options)
            assert str(path) in said
            assert message in said
