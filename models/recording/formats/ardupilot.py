"""Logs of ArduPilot (.bin, .log) and of MAVLink (.tlog): a source a message type, by pymavlink."""

import re
from collections import defaultdict
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
SPELLINGS = {"degheading": "deg", "deglatitude": "deg", "deglongitude": "deg", "m/s/s": "m/s^2",
             "instance": "", "UNKNOWN": "", "satellites": ""}  # fmt: skip


def read(path: Path, options: ReadOptions) -> list[Source]:
    """The message types of a log, `XKF1/0`, `XKF1/1` for several instances; raises RecordingError."""
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
    vars(sources[0])["left_out"] = tuple(left_out)
    return sources


def _binary(path: Path) -> tuple[list[Source], list[str]]:
    """Each message type at once, from where its messages stand in the file."""
    log = DFReader.DFReader_binary(str(path))
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
        kinds = [("32<i2" if code == "a" else re.sub(r"(\d+)s", r"S\1", f"<{spec}").replace(
                 "<S", "S").replace("<b", "i1").replace("<B", "u1").replace("<e", "<f2").replace(
                 "<q", "<i8").replace("<Q", "<u8")) for code, (spec, _, _) in
                 zip(form.format, codes, strict=False)]  # fmt: skip
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
        units = {"TimeUS": "us"} if "TimeUS" in columns else {}
        units |= {n: u for n, u in zip(form.columns, form.units or (), strict=False) if u}
        field = next((n for n in (form.instance_field, *INSTANCES) if n in form.columns
                      and rows[n].dtype.kind in "ui" and rows[n].dtype.itemsize == 1), None)  # fmt: skip
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
            given = (zip(message.fmt.columns, message.fmt.units or ()) if text
                     else message.fieldunits_by_name.items())  # fmt: skip
            units[key] = {n: u for n, u in given if u} | {"TimeUS" if text else "timestamp": "us" if text else "s"}
        for name in message.get_fieldnames():
            value = getattr(message, name)
            parts = enumerate(value) if isinstance(value, list | tuple) else ()
            values += [(f"{name}[{i}]", part) for i, part in parts] or [
                (name, value.hex() if isinstance(value, bytes) else value)
            ]
        rows[key].add(values)
    systems = {kind: [k for k in rows if k[0] == kind] for kind, _ in rows}
    sources: list[Source] = []
    for (kind, system), own in rows.items():
        name = kind if len(systems[kind]) == 1 else f"{kind}/{system}"
        columns, instance = own.columns(), None
        for column, unit in units[kind, system].items():
            if (scale := re.fullmatch(r"deg[eE](\d)", unit)) and column in columns:
                columns[column] = np.asarray(columns[column], dtype=np.float64) / 10.0 ** int(scale[1])
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
    units = {n: SPELLINGS.get(u, u) for n, u in units.items() if SPELLINGS.get(u, u) and n in columns}
    numbers = [] if instance is None else list(dict.fromkeys(instance))
    if instance is None or len(numbers) < 2:
        return [Source(name, path, columns, units)]
    return [
        Source(f"{name}/{number:g}", path, {n: v[instance == number] for n, v in columns.items()}, units)
        for number in sorted(numbers)
    ]
