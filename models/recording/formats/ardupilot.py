"""Logs of ArduPilot (.bin, .log) and of MAVLink (.tlog): a source a message type, by pymavlink."""

import re
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink import DFReader, mavutil

from seatrial.models.errors import RecordingError
from seatrial.models.recording.source import (
    ReadOptions,
    Rows,
    Source,
    TextArray,
    check_file,
    check_size,
    foreign,
)
from seatrial.models.vessel.basis import Array

INSTANCES = ("I", "C", "Instance")  # columns of small numbers that tell sensors apart
TIMES = {"TimeUS": "us", "TimeMS": "ms"}
SPELLINGS = {"degheading": "deg", "deglatitude": "deg", "deglongitude": "deg", "m/s/s": "m/s^2",
             "instance": "", "UNKNOWN": "", "satellites": ""}  # fmt: skip


def read(path: Path, options: ReadOptions) -> list[Source]:
    """The message types of a log, `XKF1/0`, `XKF1/1` of several instances.

    Raises RecordingError if it cannot be read.
    """
    check_file(path)
    with path.open("rb") as file:
        head = file.read(256)
    expected = "a log of ArduPilot (.bin, .log, .tlog)"
    with foreign(path, expected):
        if head.startswith(b"\xa3\x95"):
            sources, left_out = _binary(path)
        else:
            sources, left_out = _messages(path, b"FMT" in head)
    if not sources:
        raise RecordingError(f"{path}: got no messages with data, expected {expected}")
    return [replace(sources[0], left_out=tuple(left_out)), *sources[1:]]


def _binary(path: Path) -> tuple[list[Source], list[str]]:
    """Each message type at once, from where its messages stand in the file."""
    log = DFReader.DFReader_binary(str(path))
    log.filehandle.close()  # mapped into memory
    content = np.frombuffer(log.data_map, dtype=np.uint8)
    sources: list[Source] = []
    found = {kind: np.array(log.offsets[kind]) for kind in log.formats if len(log.offsets[kind])}
    check_size(path, sum(len(at) * len(log.formats[kind].columns) for kind, at in found.items()))
    read = 0
    for kind, at in found.items():
        form = log.formats[kind]
        at = at[at + form.len <= len(content)]
        read += len(at) * form.len
        codes = [DFReader.FORMAT_TO_STRUCT[code] for code in form.format[: len(form.columns)]]
        kinds = [
            "(32,)<i2" if code == "a" else f"S{spec[:-1]}" if spec[-1] == "s" else f"<{spec}"
            for code, (spec, _, _) in zip(form.format, codes, strict=False)
        ]
        layout = np.dtype(list(zip(form.columns, kinds, strict=True)))
        if not len(at) or layout.itemsize != form.len - 3 or form.name.startswith("FMT"):
            continue
        rows = content[at[:, None] + np.arange(3, form.len)].view(layout)[:, 0]
        columns: dict[str, Array | TextArray] = {}
        for name, (_, factor, _) in zip(form.columns, codes, strict=True):
            values = rows[name]
            if values.dtype.kind == "S":
                texts = [cell.decode(errors="replace") for cell in values]
                columns[name] = np.array(texts, dtype=np.object_)
            elif values.ndim == 2:
                columns |= {f"{name}[{i}]": v.astype(np.float64) for i, v in enumerate(values.T)}
            else:  # division is exact where the product with 1e-7 is not
                columns[name] = values.astype(np.float64) / (round(1.0 / factor) if factor else 1)
        units = dict(zip(form.columns, form.units or (), strict=False)) | TIMES
        bytes_ = {n for n in form.columns if rows[n].dtype in (np.uint8, np.int8)}
        field = next((n for n in (form.instance_field, *INSTANCES) if n in bytes_), None)
        sources += _split(path, form.name, columns, units, columns[field] if field else None)
    lost = len(content) - read
    return sources, [f"{lost} bytes that are no messages"] if lost else []


def _messages(path: Path, text: bool) -> tuple[list[Source], list[str]]:
    """Message by message: a dataflash log as text, or what a ground station received."""
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
        values: list[tuple[str, Any]] = [] if text else [("timestamp", message._timestamp)]
        if key not in units:
            units[key] = TIMES | (
                dict(zip(message.fmt.columns, message.fmt.units or (), strict=False))
                if text
                else {**message.fieldunits_by_name, "timestamp": "s"}
            )
        for name in message.get_fieldnames():
            value = getattr(message, name)
            parts = enumerate(value) if isinstance(value, list | tuple) else ()
            values += [(f"{name}[{i}]", part) for i, part in parts] or [
                (name, value.hex() if isinstance(value, bytes) else value)
            ]
        rows[key].add(values)
    (log.filehandle if text else log.f).close()
    systems = {kind: [k for k in rows if k[0] == kind] for kind, _ in rows}
    sources: list[Source] = []
    for (kind, system), own in rows.items():
        name = kind if len(systems[kind]) == 1 else f"{kind}/{system}"
        columns, instance = own.columns(), None
        for column, unit in units[kind, system].items():
            if (scale := re.fullmatch(r"deg[eE](\d)", unit)) and column in columns:
                columns[column] = np.asarray(columns[column], dtype=float) / 10.0 ** int(scale[1])
                units[kind, system][column] = "deg"
        if text:
            instance = next((columns[n] for n in INSTANCES if n in columns), None)
        sources += _split(path, name, columns, units[kind, system], instance)
    return sources, [f"{bad} messages that are damaged or of an unknown type"] if bad else []


def _split(
    path: Path, name: str, columns: dict[str, Array | TextArray], units: dict[str, str],
    instance: Array | TextArray | None,
) -> list[Source]:  # fmt: skip
    """The source of a message type, or one an instance where there are several."""
    spelled = {n: SPELLINGS.get(unit, unit) for n, unit in units.items() if n in columns}
    units = {n: unit for n, unit in spelled.items() if unit}
    numbers = [] if instance is None else list(dict.fromkeys(instance))
    if instance is None or len(numbers) < 2:
        return [Source(name, path, columns, units)]
    return [
        Source(f"{name}/{n:g}", path, {c: v[instance == n] for c, v in columns.items()}, units)
        for n in sorted(numbers)
    ]
