"""Logs of messages, a source a topic or a type: ROS and MCAP, ArduPilot, MAVLink, PX4.

They are read by rosbags, pymavlink and pyulog, which are imported where they are used.
"""

from array import array
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.recording.formats.columns import table_source
from seatrial.models.recording.source import MOST_ELEMENTS, Contents, ReadOptions, check_size

TIMES = {"TimeUS": "us", "TimeMS": "ms", "timestamp": "s"}  # of ArduPilot and MAVLink
CHECKED = 10_000  # messages of a kind between two checks of the size
Key = tuple[str, str]  # what a message is, and who sent it


class Messages:
    """Columns by kind and sender that grow message by message; what one lacks stays missing.

    A column holds numbers or texts, by its first value.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.counts = Counter[Key]()
        self.cells = defaultdict[Key, dict[str, Any]](dict)  # arrays of float, or lists of str
        self.long: dict[str, int] = {}  # arrays that are left out

    def add(self, kind: str, sender: str, values: Mapping[str, object]) -> None:
        """Add a message: its numbers, texts, arrays and messages within it by name."""
        key = kind, sender
        count, columns = self.counts[key], self.cells[key]
        for name, value in values.items():
            for leaf, cell in self._leaves(kind, name, value):
                cells = columns.setdefault(leaf, [] if isinstance(cell, str) else array("d"))
                _fill(cells, count)
                cells.append(cell)
        self.counts[key] += 1
        if count % CHECKED == 0:
            check_size(self.path, sum(n * len(self.cells[k]) for k, n in self.counts.items()))

    def _leaves(self, kind: str, name: str, value: Any) -> Iterator[tuple[str, float | str]]:
        """The numbers and texts of a value by dotted name, elements of arrays as `name[0]`."""
        if isinstance(value, str):
            yield name, value
        elif isinstance(value, bool | int | float | np.number | np.bool_):
            yield name, float(value)
        elif is_dataclass(value):
            for field in fields(value):
                if not field.name.startswith("__"):
                    inner = f"{name}.{field.name}" if name else field.name
                    yield from self._leaves(kind, inner, getattr(value, field.name))
        elif hasattr(value, "__len__") and len(value) > MOST_ELEMENTS:
            self.long[f"{kind}, {name}"] = len(value)
        elif hasattr(value, "__len__"):
            for i, element in enumerate(value):
                yield from self._leaves(kind, f"{name}[{i}]", element)

    def contents(self, units: Mapping[Key, Mapping[str, str]], left_out: Sequence[str]) -> Contents:
        """The columns of each kind and sender as a source, and what was left out."""
        kinds, sources = Counter(kind for kind, _ in self.cells), []
        for key, columns in self.cells.items():
            name = key[0] if kinds[key[0]] == 1 else "/".join(key)
            for cells in columns.values():
                _fill(cells, self.counts[key])
            triples = ((title, cells if isinstance(cells, list) else np.array(cells),
                        units[key].get(title, "")) for title, cells in columns.items())  # fmt: skip
            sources.append(table_source(name, self.path, triples))
        long = (f"{name}: arrays of {size} elements" for name, size in self.long.items())
        return sources, [*left_out, *long]


def _fill(cells: Any, count: int) -> None:
    cells.extend(["" if isinstance(cells, list) else np.nan] * (count - len(cells)))


def read_bag(path: Path, options: ReadOptions) -> Contents:
    """The topics of a bag, each with the times at which its messages were recorded.

    Topics whose messages are not defined, neither in the bag nor by `options`, are left out. A file
    of a definition is named as in its package, `boat_msgs/msg/Ballast.msg`; outside of one it
    defines the message of its name in the packages that are not known.
    """
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    messages, left_out, known, common = Messages(path), [], [], get_typestore(Stores.LATEST)
    with AnyReader([path], default_typestore=common) as bag:
        types = common.fielddefs | bag.typestore.fielddefs
        strange = {c.msgtype.partition("/")[0] for c in bag.connections if c.msgtype not in types}
        for file in map(Path, options.messages):
            try:
                text = file.expanduser().read_text(encoding="utf-8")
            except (OSError, UnicodeError) as error:
                raise ConfigurationError(
                    f"excitation.messages: {file}: cannot be read ({error})"
                ) from error
            named = file.parent.parent.name if file.parent.name == "msg" else ""
            for package in [named] if named else strange:
                types |= get_types_from_msg(text, f"{package}/msg/{file.stem}")
        bag.typestore.register({k: v for k, v in types.items() if k not in bag.typestore.fielddefs})
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
        for connection, time_ns, raw in bag.messages(known) if known else ():
            message = bag.deserialize(raw, connection.msgtype)
            messages.add(connection.topic.lstrip("/"), "", {"time": time_ns / 1e9, "": message})
    silent = dict.fromkeys(c.topic for c in known if not messages.counts[c.topic.lstrip("/"), ""])
    left_out += [f"topic {name}: no messages" for name in silent]
    return messages.contents(defaultdict(lambda: {"time": "s"}), left_out)


def read_ardupilot(path: Path, options: ReadOptions) -> Contents:
    """The message types of a log (.bin, .log, .tlog), `XKF1/0`, `XKF1/1` of several instances.

    What a ground station received has the time of reception, and may be of several systems.
    """
    from pymavlink import DFReader, mavutil

    logs = {b"\xa3\x95": DFReader.DFReader_binary, b"FM": DFReader.DFReader_text}
    with path.open("rb") as file:
        flash = logs.get(file.read(2))
    log = (flash or mavutil.mavlogfile)(str(path))
    messages, units, read, bad = Messages(path), dict[Key, dict[str, str]](), 0, 0
    for message in iter(log.recv_msg, None):
        kind = message.get_type()
        read += message.fmt.len if flash else 0
        if kind.startswith(("FMT", "BAD_DATA", "UNKNOWN")):
            bad += not flash
            continue
        values = {name: getattr(message, name) for name in message.get_fieldnames()}
        if flash:
            sender = values.get(message.fmt.instance_field, "")
        else:
            sender, values = message.get_srcSystem(), {"timestamp": message._timestamp, **values}
        key = kind, str(sender)
        if key not in units:
            units[key] = (dict(zip(message.fmt.columns, message.fmt.units or (), strict=False))
                           if flash else message.fieldunits_by_name) | TIMES  # fmt: skip
        messages.add(*key, values)
    (log.filehandle if flash else log.f).close()
    lost = path.stat().st_size - read if flash is DFReader.DFReader_binary else 0
    reasons = {f"{lost} bytes that are no messages": lost,
               f"{bad} messages that are damaged or of an unknown type": bad}  # fmt: skip
    return messages.contents(units, [reason for reason, there in reasons.items() if there])


def read_ulog(path: Path, options: ReadOptions) -> Contents:
    """The topics of a ULog, `topic`, `topic/1` of several instances, with a `timestamp` in us."""
    from pyulog.core import ULog

    with path.open("rb") as file:  # pyulog leaves a bad file open
        topics = ULog(file).data_list
    sources = []
    for topic in topics:
        name = f"{topic.name}/{topic.multi_id}" if topic.multi_id else topic.name
        columns = ((t, cells, "us" if t == "timestamp" else "") for t, cells in topic.data.items())
        sources.append(table_source(name, path, columns))
    return sources, []
