"""Bags of ROS 1 and ROS 2, and MCAP: a source a topic, by the package rosbags."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from seatrial.models.errors import ConfigurationError
from seatrial.models.recording.source import (
    MOST_ELEMENTS,
    Contents,
    ReadOptions,
    Rows,
    Source,
    check_size,
)

CHECKED = 10_000  # messages between two checks of the size


def read(path: Path, options: ReadOptions) -> Contents:
    """The topics of a bag, each with the times at which its messages were recorded.

    Topics whose messages are not defined, neither in the bag nor by `options`, are left out.
    """
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


def _define(bag: AnyReader, options: ReadOptions) -> None:
    """Add the messages of common packages and of files to those that a bag defines itself.

    A file is named as in its package, `boat_msgs/msg/Ballast.msg`; outside of one it defines the
    message of its name that the bag needs. Raises ConfigurationError.
    """
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
