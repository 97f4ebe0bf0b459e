"""Logs of messages, a source a topic or a type: ROS and MCAP, ArduPilot, MAVLink, PX4.

They are read by rosbags, pymavlink and pyulog, which are imported where they are used.
"""

import re
from array import array
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from seatrial.models.errors import ConfigurationError
from seatrial.models.recording.source import (
    MOST_ELEMENTS,
    Contents,
    ReadOptions,
    Source,
    Values,
    check_size,
)

INSTANCES = ("I", "C", "Instance")  # columns of small numbers that tell sensors apart
UNITS = {"degheading": "deg", "deglatitude": "deg", "deglongitude": "deg", "m/s/s": "m/s^2",
         "instance": "", "UNKNOWN": "", "satellites": ""}  # fmt: skip
TIMES = {"TimeUS": "us", "TimeMS": "ms", "timestamp": "s"}
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

    def add(self, kind: str, values: Iterable[tuple[str, object]], sender: str = "") -> None:
        """Add a message: its numbers, texts, arrays and messages within it by name."""
        key = kind, sender
        count, columns = self.counts[key], self.cells[key]
        for name, value in values:
            for leaf, cell in self._leaves(kind, name, value):
                text = isinstance(cell, str)
                cells = columns.setdefault(leaf, [] if text else array("d"))
                _fill(cells, count)
                cells.append(cell)
        self.counts[key] += 1
        if count % CHECKED == 0:
            check_size(self.path, sum(n * len(self.cells[k]) for k, n in self.counts.items()))

    def _leaves(self, kind: str, name: str, value: Any) -> Iterator[tuple[str, float | str]]:
        """The numbers and texts of a value by dotted name, elements of arrays as `name[0]`."""
        if isinstance(value, str):
            yield name, value
        elif isinstance(value, bytes | bytearray):
            yield name, value.hex()
        elif isinstance(value, bool | int | float | np.number | np.bool_):
            yield name, float(value)
        elif is_dataclass(value):
            for field in fields(value):
                if not field.name.startswith("__"):
                    inner = f"{name}.{field.name}" if name else field.name
                    yield from self._leaves(kind, inner, getattr(value, field.name))
        elif isinstance(value, list | tuple | array | np.ndarray):
            if len(value) > MOST_ELEMENTS:
                self.long[f"{kind}, {name}"] = len(value)
                return
            for i, element in enumerate(value):
                yield from self._leaves(kind, f"{name}[{i}]", element)

    def tables(self) -> Iterator[tuple[Key, str, dict[str, Values]]]:
        """The columns of each kind and sender, and their name, (N,)."""
        kinds = Counter(kind for kind, _ in self.cells)
        for key, columns in self.cells.items():
            result: dict[str, Values] = {}
            for name, cells in columns.items():
                _fill(cells, self.counts[key])
                result[name] = np.array(cells, dtype=object if isinstance(cells, list) else float)
            yield key, key[0] if kinds[key[0]] == 1 else "/".join(key), result


def _fill(cells: Any, count: int) -> None:
    cells.extend(["" if isinstance(cells, list) else np.nan] * (count - len(cells)))


def read_bag(path: Path, options: ReadOptions) -> Contents:
    """The topics of a bag, each with the times at which its messages were recorded.

    Topics whose messages are not defined, neither in the bag nor by `options`, are left out.
    """
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    messages, left_out, known = Messages(path), list[str](), []
    with AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as bag:
        _define(bag, options)
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
            messages.add(connection.topic.lstrip("/"), [("time", time_ns / 1e9), ("", message)])
    left_out += [f"topic /{name}: arrays of {n} elements" for name, n in messages.long.items()]
    sources = [Source(name, path, cells, {"time": "s"}) for _, name, cells in messages.tables()]
    silent = dict.fromkeys(c.topic for c in known if not messages.counts[c.topic.lstrip("/"), ""])
    return sources, [*left_out, *(f"topic {name}: no messages" for name in silent)]


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


def read_ardupilot(path: Path, options: ReadOptions) -> Contents:
    """The message types of a log (.bin, .log, .tlog), `XKF1/0`, `XKF1/1` of several instances.

    What a ground station received has the time of reception, and may be of several systems.
    """
    from pymavlink import DFReader, mavutil

    logs = {b"\xa3\x95": DFReader.DFReader_binary, b"FM": DFReader.DFReader_text}
    with path.open("rb") as file:
        flash = logs.get(file.read(2))
    log, binary = (flash or mavutil.mavlogfile)(str(path)), flash is not None
    messages, units, read, bad = Messages(path), dict[str, dict[str, str]](), 0, 0
    while (message := log.recv_msg()) is not None:
        kind, names = message.get_type(), message.get_fieldnames()
        read += message.fmt.len if binary else 0
        if kind.startswith(("FMT", "BAD_DATA", "UNKNOWN")):
            bad += not binary
            continue
        if kind not in units:
            units[kind] = (dict(zip(message.fmt.columns, message.fmt.units or (), strict=False))
                           if binary else message.fieldunits_by_name)  # fmt: skip
        values = [(name, getattr(message, name)) for name in names]
        if binary:
            messages.add(kind, values)
        else:
            values.insert(0, ("timestamp", message._timestamp))
            messages.add(kind, values, str(message.get_srcSystem()))
    (log.filehandle if binary else log.f).close()
    sources = list[Source]()
    for (kind, _), name, columns in messages.tables():
        sources += _instances(path, name, columns, units[kind] | TIMES, binary)
    lost = path.stat().st_size - read if flash is DFReader.DFReader_binary else 0
    reasons = {f"{lost} bytes that are no messages": lost,
               f"{bad} messages that are damaged or of an unknown type": bad,
               **{f"{name}: arrays of {n} elements": n
                  for name, n in messages.long.items()}}  # fmt: skip
    return sources, [reason for reason, there in reasons.items() if there]


def _instances(
    path: Path, name: str, columns: dict[str, Values], units: dict[str, str], several: bool
) -> list[Source]:
    """A message type as a source, or as one of each sensor where `several` are told apart."""
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
    return [
        Source(
            f"{topic.name}/{topic.multi_id}" if topic.multi_id else topic.name,
            path,
            {name: np.asarray(values, dtype=np.float64) for name, values in topic.data.items()},
            {"timestamp": "us"},
        )
        for topic in topics
    ], []
