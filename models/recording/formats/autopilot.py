"""Logs of autopilots, a source a message type: ArduPilot, MAVLink (pymavlink), PX4 (pyulog)."""

import re
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import TypeAlias

import numpy as np

from seatrial.models.recording.source import Contents, ReadOptions, Rows, Source, Values, check_size

INSTANCES = ("I", "C", "Instance")  # columns of small numbers that tell sensors apart
TIMES = {"TimeUS": "us", "TimeMS": "ms"}
SPELLINGS = {"degheading": "deg", "deglatitude": "deg", "deglongitude": "deg", "m/s/s": "m/s^2",
             "instance": "", "UNKNOWN": "", "satellites": ""}  # fmt: skip


# Messages of a type: name, columns, units, and the column that tells sensors apart.
Messages: TypeAlias = tuple[str, dict[str, Values], dict[str, str], str | None]


def read_ardupilot(path: Path, options: ReadOptions) -> Contents:
    """The message types of a log (.bin, .log, .tlog), `XKF1/0`, `XKF1/1` of several instances."""
    with path.open("rb") as file:
        head = file.read(256)
    sources: list[Source] = []
    left_out: list[str] = []
    binary = head.startswith(b"\xa3\x95")
    for name, columns, units, instance in (
        _binary(path, left_out) if binary else _one_by_one(path, b"FMT" in head, left_out)
    ):
        known: dict[str, str] = {}
        for column in columns.keys() & units.keys():
            unit = SPELLINGS.get(units[column], units[column])
            if scale := re.fullmatch(r"deg[eE](\d)", unit):
                columns[column] = np.asarray(columns[column], float) / 10.0 ** int(scale[1])
                unit = "deg"
            known |= {column: unit} if unit else {}
        numbers = columns[instance] if instance else np.zeros(1)
        several = np.unique(numbers)
        sources += [
            Source(f"{name}/{n:g}", path, {c: v[numbers == n] for c, v in columns.items()}, known)
            if len(several) > 1
            else Source(name, path, columns, known)
            for n in several
        ]
    return sources, left_out


def _binary(path: Path, left_out: list[str]) -> Iterator[Messages]:
    """Each message type at once, from where its messages stand in the file."""
    from pymavlink import DFReader

    log = DFReader.DFReader_binary(str(path))
    log.filehandle.close()  # mapped into memory
    content = np.frombuffer(log.data_map, dtype=np.uint8)
    found = {form: np.array(log.offsets[kind], int) for kind, form in log.formats.items()}
    check_size(path, sum(len(at) * len(form.columns) for form, at in found.items()))
    lost = len(content)
    for form, at in found.items():
        at = at[at + form.len <= len(content)]
        lost -= len(at) * form.len
        codes = [DFReader.FORMAT_TO_STRUCT[code] for code in form.format[: len(form.columns)]]
        kinds = [
            "(32,)<i2" if code == "a" else f"S{spec[:-1]}" if spec[-1] == "s" else f"<{spec}"
            for code, (spec, _, _) in zip(form.format, codes, strict=False)
        ]
        layout = np.dtype(list(zip(form.columns, kinds, strict=True)))
        if not len(at) or layout.itemsize != form.len - 3 or form.name.startswith("FMT"):
            continue
        rows = content[at[:, None] + np.arange(3, form.len)].view(layout)[:, 0]
        columns: dict[str, Values] = {}
        for name, (_, factor, _) in zip(form.columns, codes, strict=True):
            values = rows[name]
            if values.dtype.kind == "S":
                texts = [cell.decode(errors="replace") for cell in values]
                columns[name] = np.array(texts, dtype=np.object_)
            elif values.ndim == 2:
                columns |= {f"{name}[{i}]": v.astype(np.float64) for i, v in enumerate(values.T)}
            else:  # division is exact where the product with 1e-7 is not
                columns[name] = values.astype(np.float64) / (round(1.0 / factor) if factor else 1)
        small = {n for n in form.columns if rows[n].dtype in (np.uint8, np.int8)}
        instance = next((n for n in (form.instance_field, *INSTANCES) if n in small), None)
        units = dict(zip(form.columns, form.units or (), strict=False)) | TIMES
        yield form.name, columns, units, instance
    if lost:
        left_out.append(f"{lost} bytes that are no messages")


def _one_by_one(path: Path, text: bool, left_out: list[str]) -> Iterator[Messages]:
    """Message by message: a dataflash log as text, or what a ground station received."""
    from pymavlink import DFReader, mavutil

    log = DFReader.DFReader_text(str(path)) if text else mavutil.mavlogfile(str(path))
    rows: dict[tuple[str, int], Rows] = defaultdict(Rows)
    units: dict[tuple[str, int], dict[str, str]] = {}
    bad = 0
    while (message := log.recv_msg()) is not None:
        kind = message.get_type()
        if kind.startswith(("FMT", "BAD_DATA", "UNKNOWN")):
            bad += not text
            continue
        key = (kind, 0 if text else message.get_srcSystem())
        if key not in units and text:
            units[key] = dict(zip(message.fmt.columns, message.fmt.units or (), strict=False))
        elif key not in units:
            units[key] = {**message.fieldunits_by_name, "timestamp": "s"}
        values = [] if text else [("timestamp", message._timestamp)]
        for name in message.get_fieldnames():
            value = getattr(message, name)
            if isinstance(value, list | tuple):
                values += [(f"{name}[{i}]", part) for i, part in enumerate(value)]
            else:
                values.append((name, value.hex() if isinstance(value, bytes) else value))
        rows[key].add(values)
    (log.filehandle if text else log.f).close()
    systems = Counter(kind for kind, _ in rows)
    for (kind, system), own in rows.items():
        columns = own.columns()
        instance = next((n for n in INSTANCES if n in columns), None) if text else None
        name = kind if systems[kind] == 1 else f"{kind}/{system}"
        yield name, columns, units[kind, system] | TIMES, instance
    if bad:
        left_out.append(f"{bad} messages that are damaged or of an unknown type")


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
