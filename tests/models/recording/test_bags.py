"""Bags of ROS 1, ROS 2 and MCAP, made of the topics of a run of milliAmpere."""

import csv
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from seatrial.models.errors import ConfigurationError
from seatrial.models.recording.source import ReadOptions, read_sources

pytest.importorskip("rosbags")

from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Bag2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tests.data import DATA

POSE, WRENCH = "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/WrenchStamped"


RUN = DATA / "milliampere" / "nlp1"


def topic_rows(name: str, most: int = 300) -> list[dict[str, str]]:
    with (RUN / f"{name}.csv").open(newline="") as opened:
        return [row for row, _ in zip(csv.DictReader(opened), range(most), strict=False)]


def bag_of_milliampere(path: Path, storage: StoragePlugin | None) -> None:
    """Two topics of the run nlp1, as ROS 1 (no storage), ROS 2 or MCAP."""
    store = get_typestore(Stores.ROS1_NOETIC if storage is None else Stores.ROS2_HUMBLE)
    types = store.types
    vector, header = types["geometry_msgs/msg/Vector3"], types["std_msgs/msg/Header"]
    stamp = types["builtin_interfaces/msg/Time"]

    def head(row: dict[str, str]) -> Any:
        seconds, nanoseconds = int(row["header_stamp_secs"]), int(row["header_stamp_nsecs"])
        number = {} if storage is not None else {"seq": 0}
        return header(stamp=stamp(sec=seconds, nanosec=nanoseconds), frame_id="piren", **number)

    def three(row: dict[str, str], prefix: str, kind: Any = vector) -> Any:
        return kind(**{axis: float(row[f"{prefix}_{axis}"]) for axis in "xyz"})

    with (
        BagWriter(path)
        if storage is None
        else Bag2Writer(path, version=9, storage_plugin=storage) as bag
    ):
        for topic, kind in (("navigation/pose", POSE), ("tau_actual", WRENCH)):
            connection = bag.add_connection(f"/{topic}", kind, typestore=store)
            for row in topic_rows(topic):
                if kind == POSE:
                    point = three(row, "pose_position", types["geometry_msgs/msg/Point"])
                    turn = types["geometry_msgs/msg/Quaternion"](
                        **{axis: float(row[f"pose_orientation_{axis}"]) for axis in "xyzw"}
                    )
                    pose = types["geometry_msgs/msg/Pose"](position=point, orientation=turn)
                    message = types[POSE](header=head(row), pose=pose)
                else:
                    wrench = types["geometry_msgs/msg/Wrench"](
                        force=three(row, "wrench_force"), torque=three(row, "wrench_torque")
                    )
                    message = types[WRENCH](header=head(row), wrench=wrench)
                serialise = store.serialize_ros1 if storage is None else store.serialize_cdr
                moment = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
                bag.write(connection, moment, serialise(message, kind))


@pytest.mark.data
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
    bag_of_milliampere(tmp_path / name, storage)
    sources = read_sources(tmp_path / name / inner, ReadOptions())
    assert set(sources) == {"navigation/pose", "tau_actual"}
    for topic, pairs in {
        "navigation/pose": {
            "pose.position.x": "pose_position_x",
            "pose.orientation.w": "pose_orientation_w",
            "header.stamp.sec": "header_stamp_secs",
            "header.stamp.nanosec": "header_stamp_nsecs",
        },
        "tau_actual": {"wrench.torque.z": "wrench_torque_z"},
    }.items():
        rows, source = topic_rows(topic), sources[topic]
        for column_, written in pairs.items():
            np.testing.assert_array_equal(
                source.columns[column_], [float(row[written]) for row in rows]
            )
        stamp = source.numbers("header.stamp.sec") + 1e-9 * source.numbers("header.stamp.nanosec")
        np.testing.assert_allclose(source.numbers("time"), stamp, rtol=0.0, atol=1e-6)
        assert source.columns["header.frame_id"].tolist() == ["piren"] * len(rows)


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
        "topic /ballast (boat_msgs/msg/Ballast): its definition is not in the file; "
        "excitation.messages=[Ballast.msg] gives it",
    )
    for file in (tmp_path / "Ballast.msg", tmp_path / "boat_msgs" / "msg" / "Ballast.msg"):
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(definition, encoding="utf-8")
        sources = read_sources(tmp_path / "a", ReadOptions(messages=(str(file),)))
        np.testing.assert_array_equal(sources["ballast"].columns["level"], np.arange(5.0))
        first = next(iter(sources.values()))
        assert first.left_out == ("topic /ballast, scan: arrays of 100 elements",)
    with pytest.raises(ConfigurationError, match=r"messages: none\.msg: cannot be read"):
        read_sources(tmp_path / "a", ReadOptions(messages=("none.msg",)))
