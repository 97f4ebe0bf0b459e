"""Logs of messages, a source a topic or a type: ROS and MCAP, ArduPilot, MAVLink, PX4.

They are read by rosbags, pymavlink and pyulog, which are imported where they are used.
"""

import re
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.recording.source import (
    MOST_ELEMENTS,
    Contents,
    ReadOptions,
    Rows,
    Source,
    check_size,
)

INSTANCES = ("I", "C", "Instance")  # columns of small numbers that tell sensors apart
UNITS = {"degheading": "deg", "deglatitude": "deg", "deglongitude": "deg", "m/s/s": "m/s^2",
         "instance": "", "UNKNOWN": "", "satellites": ""}  # fmt: skip
TIMES = {"TimeUS": "us", "TimeMS": "ms", "timestamp": "s"}
CHECKED = 10_000  # messages between two checks of the size


def read_bag(path: Path, options: ReadOptions) -> Contents:
    """The topics of a bag, each with the times at which its messages were recorded.

    Topics whose messages are not defined, neither in the bag nor by `options`, are left out.
    """
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    topics: dict[str, Rows] = {}
    long: dict[str, int] = {}  # arrays that are left out
    left_out: list[str] = []
    with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as bag:
        _define(bag, options)
        known = []
        for connection in bag.connections:
            try:
                bag.typestore.get_msgdef(connection.msgtype)
                known.append(connection)
            except KeyError as error:
                (missing,) = error.args
                of = "its definition" if missing == connection.msgtype else f"that of {missing}"
                left_out.append(
                    f"topic {connection.topic} ({connection.msgtype}): {of} is not in the file; "
                    f"excitation.messages=[{missing.rpartition('/')[2]}.msg] gives it"
                )
        for count, (connection, time_ns, raw) in enumerate(bag.messages(known) if known else ()):
            message = bag.deserialize(raw, connection.msgtype)
            name = connection.topic.lstrip("/")
            values = _leaves("", message, long, name)
            topics.setdefault(name, Rows()).add([("time", time_ns / 1e9), *values])
            if count % CHECKED == 0:
                check_size(path, sum(t.count * len(t.cells) for t in topics.values()))
    left_out += [f"topic /{place}: arrays of {size} elements" for place, size in long.items()]
    silent = dict.fromkeys(c.topic for c in known if c.topic.lstrip("/") not in topics)
    left_out += [f"topic {name}: no messages" for name in silent]
    sources = [Source(name, path, rows.columns(), {"time": "s"}) for name, rows in topics.items()]
    return sources, left_out


def _define(bag: Any, options: ReadOptions) -> None:
    """Add the messages of common packages and of files to those that a bag defines itself.

    A file is named as in its package, `boat_msgs/msg/Ballast.msg`; outside of one it defines the
    message of its name that the bag needs. Raises ConfigurationError.
    """
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    types = dict(get_typestore(Stores.LATEST if bag.is2 else Stores.ROS1_NOETIC).fielddefs)
    wanted = {connection.msgtype for connection in bag.connections}
    for file in map(Path, options.messages):
        try:
            text = file.expanduser().read_text(encoding="utf-8")
        except (OSError, UnicodeError) as error:
            raise ConfigurationError(
                f"excitation.messages: {file}: cannot be read ({error})"
            ) from error
        names = {name for name in wanted if name.rpartition("/")[2] == file.stem}
        if file.parent.name == "msg" and file.parent.parent.name:
            names = {f"{file.parent.parent.name}/msg/{file.stem}"}
        elif not names:  # of a message within one, whose package is that of the others
            names = {f"{name.partition('/')[0]}/msg/{file.stem}" for name in wanted - set(types)}
        for name in names:
            types |= get_types_from_msg(text, name)
    bag.typestore.register({k: v for k, v in types.items() if k not in bag.typestore.fielddefs})


def _leaves(
    name: str, value: object, long: dict[str, int], topic: str
) -> Iterator[tuple[str, float | str]]:
    """The numbers and texts of a message by dotted name, elements of arrays as `name[0]`."""
    if isinstance(value, str):
        yield name, value
    elif isinstance(value, bool | int | float | np.number | np.bool_):
        yield name, float(value)
    elif is_dataclass(value):
        for field in fields(value):
            if not field.name.startswith("__"):
                inner = f"{name}.{field.name}" if name else field.name
                yield from _leaves(inner, getattr(value, field.name), long, topic)
    elif isinstance(value, list | tuple | np.ndarray):
        if len(value) > MOST_ELEMENTS:
            long[f"{topic}, {name}"] = len(value)
            return
        for i, element in enumerate(value):
            yield from _leaves(f"{name}[{i}]", element, long, topic)


def read_ardupilot(path: Path, options: ReadOptions) -> Contents:
    """The message types of a log (.bin, .tlog), `XKF1/0`, `XKF1/1` of several instances.

    What a ground station received has the time of reception, and may be of several systems.
    """
    from pymavlink import DFReader, mavutil

    with path.open("rb") as file:
        binary = file.read(2) == b"\xa3\x95"
    log = DFReader.DFReader_binary(str(path)) if binary else mavutil.mavlogfile(str(path))
    rows: dict[tuple[str, int], Rows] = defaultdict(Rows)
    units: dict[tuple[str, int], dict[str, str]] = {}
    read = bad = count = 0
    while (message := log.recv_msg()) is not None:
        kind, count = message.get_type(), count + 1
        read += message.fmt.len if binary else 0
        if kind.startswith(("FMT", "BAD_DATA", "UNKNOWN")):
            bad += not binary
            continue
        key = (kind, 0 if binary else message.get_srcSystem())
        if key not in units and binary:
            units[key] = dict(zip(message.fmt.columns, message.fmt.units or (), strict=False))
        elif key not in units:
            units[key] = message.fieldunits_by_name
        values = [] if binary else [("timestamp", message._timestamp)]
        for name in message.get_fieldnames():
            value = getattr(message, name)
            if isinstance(value, list | tuple):
                values += [(f"{name}[{i}]", part) for i, part in enumerate(value)]
            else:
                values.append((name, value.hex() if isinstance(value, bytes) else value))
        rows[key].add(values)
        if count % CHECKED == 0:
            check_size(path, sum(own.count * len(own.cells) for own in rows.values()))
    (log.filehandle if binary else log.f).close()
    systems, sources = Counter(kind for kind, _ in rows), list[Source]()
    for (kind, system), own in rows.items():
        name = kind if systems[kind] == 1 else f"{kind}/{system}"
        sources += _instances(path, name, own, units[kind, system] | TIMES, binary)
    lost = path.stat().st_size - read if binary else 0
    reasons = {f"{lost} bytes that are no messages": lost,
               f"{bad} messages that are damaged or of an unknown type": bad}  # fmt: skip
    return sources, [reason for reason, there in reasons.items() if there]


def _instances(
    path: Path, name: str, rows: Rows, units: dict[str, str], several: bool
) -> list[Source]:
    """A message type as a source, or as one of each sensor where `several` are told apart."""
    columns = rows.columns()
    known: dict[str, str] = {}
    for column in columns.keys() & units.keys():
        unit = UNITS.get(units[column], units[column])
        if scale := re.fullmatch(r"deg[eE](\d)", unit):
            columns[column] = np.asarray(columns[column], float) / 10.0 ** int(scale[1])
            unit = "deg"
        known |= {column: unit} if unit else {}
    instance = next((column for column in INSTANCES if column in columns), None)
    numbers = columns[instance] if instance and several else np.zeros(1)
    if numbers.dtype == np.object_ or len(each := np.unique(numbers)) == 1:
        return [Source(name, path, columns, known)]
    return [
        Source(f"{name}/{n:g}", path, {c: v[numbers == n] for c, v in columns.items()}, known)
        for n in each
    ]


def read_ulog(path: Path, options: ReadOptions) -> Contents:
    """The topics of a ULog, `topic`, `topic/1` of several instances, with a `timestamp` in us."""
    from pyulog.core import ULog

    with path.open("rb") as file:  # pyulog leaves a bad file open
        topics = ULog(file).data_list
    check_size(path, sum(len(column) for topic in topics for column in topic.data.values()))
    return [
        Source(
            f"{topic.name}/{topic.multi_id}" if topic.multi_id else topic.name,
            path,
            {name: np.asarray(values, dtype=np.float64) for name, values in topic.data.items()},
            {"timestamp": "us"},
        )
        for topic in topics
    ], []
