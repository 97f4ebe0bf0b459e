"""Damaged, foreign and bomb-like files: one line, exit code 2, bounded memory, nothing written.

All files go through the command line, one after the other, in a process with limited memory.
"""

import json
import struct
import subprocess
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
import scipy
from pyarrow import parquet

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

    one, two = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
    kind = "std_msgs/msg/Float64"
    writer1 = Writer1(folder / "a.bag")
    writer1.set_compression(Writer1.CompressionFormat.BZ2)
    with writer1 as bag:
        topic = bag.add_connection("/u", kind, typestore=one)
        for k in range(50):
            bag.write(topic, k, one.serialize_ros1(one.types[kind](data=float(k)), kind))
    yield "bag", (folder / "a.bag").read_bytes()
    (folder / "a.bag").unlink()
    for plugin, suffix in ((StoragePlugin.SQLITE3, "db3"), (StoragePlugin.MCAP, "mcap")):
        writer = Writer(folder / suffix, version=9, storage_plugin=plugin)
        if suffix == "mcap":
            writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with writer:
            topic2 = writer.add_connection("/u", kind, typestore=two)
            for k in range(50):
                writer.write(topic2, k, two.serialize_cdr(two.types[kind](data=float(k)), kind))
        yield suffix, (folder / suffix / f"{suffix}.{suffix}").read_bytes()
        for path in (folder / suffix).iterdir():
            path.unlink()
        (folder / suffix).rmdir()


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
    command = [sys.executable, "-W", "error", "-c", RUNNING, *(path.name for path in paths)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
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
