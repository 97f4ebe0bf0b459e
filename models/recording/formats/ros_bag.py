"""Bags of ROS 1 and ROS 2, and MCAP: a source a topic, by the package rosbags."""

from array import array
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from seatrial.models.recording.formats.bounded import bounded
from seatrial.models.recording.formats.nested import MOST_ELEMENTS
from seatrial.models.recording.source import ReadOptions, Source, TextArray, check_size
from seatrial.models.vessel.basis import Array

EXPECTED = "a bag of ROS 1 or ROS 2, or an MCAP file"
CHECKED = 10_000  # messages between two checks of the size
TIME = "time"  # column of the times at which messages were recorded


class Topic:
    """The columns of a topic, message by message."""

    def __init__(self) -> None:
        self.rows = 0
        self.numbers: dict[str, array[float]] = {}
        self.texts: dict[str, list[str]] = {}

    def add(self, message: object, time_ns: int) -> None:
        """Add the fields of a message; what it does not have stays empty."""
        for name, value in ((TIME, time_ns / 1e9), *_leaves("", message)):
            if isinstance(value, str):
                column = self.texts.setdefault(name, [])
                column += [""] * (self.rows - len(column)) + [value]
            else:
                row = self.numbers.setdefault(name, array("d"))
                row.extend([np.nan] * (self.rows - len(row)))
                row.append(value)
        self.rows += 1

    def columns(self) -> dict[str, Array | TextArray]:
        """All columns, shape (N,) each."""
        found: dict[str, Array | TextArray] = {}
        for name, numbers in self.numbers.items():
            numbers.extend([np.nan] * (self.rows - len(numbers)))
            found[name] = np.array(numbers)
        for name, texts in self.texts.items():
            filled = [*texts, *[""] * (self.rows - len(texts))]
            found[name] = np.array(filled, dtype=np.object_)
        return found


def read(path: Path, options: ReadOptions) -> list[Source]:
    """The topics of a bag; raises RecordingError if it cannot be read."""
    topics: dict[str, Topic] = {}
    store = get_typestore(Stores.LATEST)
    with bounded(path, EXPECTED), AnyReader([path], default_typestore=store) as bag:
        for count, (connection, time_ns, raw) in enumerate(bag.messages()):
            message = bag.deserialize(raw, connection.msgtype)
            topics.setdefault(connection.topic, Topic()).add(message, time_ns)
            if count % CHECKED == 0:
                check_size(path, sum(t.rows * len(t.numbers) for t in topics.values()))
    return [
        Source(name.lstrip("/"), path, topic.columns(), {TIME: "s"})
        for name, topic in topics.items()
    ]


def _leaves(name: str, value: object) -> Iterator[tuple[str, float | str]]:
    """The numbers and texts of a message by dotted name, elements of arrays as `name[0]`."""
    if isinstance(value, str):
        yield name, value
    elif isinstance(value, bool | int | float | np.number | np.bool_):
        yield name, float(value)
    elif is_dataclass(value):
        for field in fields(value):
            if not field.name.startswith("__"):
                inner = f"{name}.{field.name}" if name else field.name
                yield from _leaves(inner, getattr(value, field.name))
    elif isinstance(value, list | tuple | np.ndarray) and len(value) <= MOST_ELEMENTS:
        for i, element in enumerate(value):
            yield from _leaves(f"{name}[{i}]", element)
