"""Bags of ROS 1, ROS 2 and MCAP, written by rosbags."""

import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from seatrial.models.errors import RecordingError
from seatrial.models.recording.source import ReadOptions, read_sources

pytest.importorskip("rosbags")

from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Bag2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

POSE, SPEED = "geometry_msgs/msg/PoseStamped", "std_msgs/msg/Float64"
STAMPS_NS = 1744372269 * 10**9 + 99_999_999 * np.arange(20)  # nanoseconds with leading zeros


def bag(path: Path, storage: StoragePlugin | None) -> None:
    """Two topics as ROS 1 (no storage), ROS 2 or MCAP."""
    store = get_typestore(Stores.ROS1_NOETIC if storage is None else Stores.ROS2_HUMBLE)
    packages = ("geometry_msgs", "std_msgs", "builtin_interfaces")
    kinds = {kind.rpartition("/")[2]: made for package in packages
             for kind, made in store.types.items() if kind.startswith(package)}  # fmt: skip
    number = {} if storage is not None else {"seq": 0}
    serialise = store.serialize_ros1 if storage is None else store.serialize_cdr
    writer = (BagWriter(path) if storage is None
              else Bag2Writer(path, version=9, storage_plugin=storage))  # fmt: skip
    with writer as written:
        pose = written.add_connection("/navigation/pose", POSE, typestore=store)
        speed = written.add_connection("/speed", SPEED, typestore=store)
        for k, moment in enumerate(map(int, STAMPS_NS)):
            stamp = kinds["Time"](sec=moment // 10**9, nanosec=moment % 10**9)
            message = store.types[POSE](
                header=kinds["Header"](stamp=stamp, frame_id="piren", **number),
                pose=kinds["Pose"](
                    position=kinds["Point"](x=0.5 * k, y=-1.0, z=0.0),
                    orientation=kinds["Quaternion"](x=0.0, y=0.0, z=0.6, w=0.8),
                ),
            )
            written.write(pose, moment, serialise(message, POSE))
            written.write(speed, moment, serialise(store.types[SPEED](data=2.0 * k), SPEED))


@pytest.mark.parametrize(
    ("name", "storage", "inner"),
    [
        ("one.bag", None, ""),
        ("two", StoragePlugin.SQLITE3, ""),
        ("two", StoragePlugin.SQLITE3, "two.db3"),
        ("three", StoragePlugin.MCAP, ""),
        ("three", StoragePlugin.MCAP, "three.mcap"),
    ],
)
def test_bags_hold_what_was_put_in(
    tmp_path: Path, name: str, storage: StoragePlugin | None, inner: str
) -> None:
    bag(tmp_path / name, storage)
    sources = read_sources(tmp_path / name / inner, ReadOptions())
    assert set(sources) == {"navigation/pose", "speed"}
    pose = sources["navigation/pose"]
    np.testing.assert_array_equal(pose.columns["pose.position.x"], 0.5 * np.arange(20))
    np.testing.assert_array_equal(pose.columns["pose.orientation.w"], 0.8)
    np.testing.assert_array_equal(sources["speed"].columns["data"], 2.0 * np.arange(20))
    seconds, rest = (pose.numbers(f"header.stamp.{part}") for part in ("sec", "nanosec"))
    np.testing.assert_array_equal(seconds * 10**9 + rest, STAMPS_NS.astype(float))
    np.testing.assert_allclose(pose.numbers("time"), STAMPS_NS / 1e9, rtol=0.0, atol=1e-6)
    assert pose.columns["header.frame_id"].tolist() == ["piren"] * 20


def test_topics_of_unknown_type_are_left_out_or_defined_by_a_file(tmp_path: Path) -> None:
    """A message of a package of one's own, in a bag of ROS 2 that holds no definitions."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    definition = "float64 level\nfloat64[100] scan\n"
    store.register(get_types_from_msg(definition, "boat_msgs/msg/Ballast"))
    ballast, speed = store.types["boat_msgs/msg/Ballast"], store.types["std_msgs/msg/Float64"]
    with Bag2Writer(tmp_path / "a", version=8, storage_plugin=StoragePlugin.SQLITE3) as bag:
        for topic, kind in (("ballast", ballast), ("speed", speed)):
            name = kind.__msgtype__
            connection = bag.add_connection(f"/{topic}", name, typestore=store)
            for k in range(5):
                values = {"data": float(k)} if kind is speed else {
                    "level": float(k), "scan": np.zeros(100)
                }  # fmt: skip
                bag.write(connection, k * 10**9, store.serialize_cdr(kind(**values), name))
    with closing(sqlite3.connect(tmp_path / "a" / "a.db3")) as stored:
        stored.execute("DELETE FROM message_definitions")  # as older programs leave them out
        stored.commit()
    (source,) = read_sources(tmp_path / "a", ReadOptions()).values()
    assert source.name == "speed"
    assert source.left_out == (
        "topic /ballast (boat_msgs/msg/Ballast): the definition of boat_msgs/msg/Ballast is not in "
        "the file; excitation.messages=[Ballast.msg] gives it",
    )
    for file in (tmp_path / "Ballast.msg", tmp_path / "boat_msgs" / "msg" / "Ballast.msg"):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(definition, encoding="utf-8")
        sources = read_sources(tmp_path / "a", ReadOptions(messages=(str(file),)))
        np.testing.assert_array_equal(sources["ballast"].columns["level"], np.arange(5.0))
        first = next(iter(sources.values()))
        assert first.left_out == ("ballast, scan: arrays of 100 elements",)
    with pytest.raises(RecordingError, match=r"No such file or directory: 'none\.msg'"):
        read_sources(tmp_path / "a", ReadOptions(messages=("none.msg",)))
