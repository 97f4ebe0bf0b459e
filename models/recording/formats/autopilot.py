"""Logs of autopilots, a source a message type: ArduPilot, MAVLink (pymavlink), PX4 (pyulog)."""

import re
from collections import Counter, defaultdict
from pathlib import Path

import numpy as np

from seatrial.models.recording.source import Contents, ReadOptions, Rows, Source, check_size

INSTANCES = ("I", "C", "Instance")  # columns of small numbers that tell sensors apart
UNITS = {"degheading": "deg", "deglatitude": "deg", "deglongitude": "deg", "m/s/s": "m/s^2",
         "instance": "", "UNKNOWN": "", "satellites": ""}  # fmt: skip
TIMES = {"TimeUS": "us", "TimeMS": "ms", "timestamp": "s"}
CHECKED = 100_000  # messages between two checks of the size


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
