"""Recordings as Parquet: written with their metadata, and read back to the bit."""

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.notation import (
    ACCELERATION_UNIT,
    FORCE_UNIT,
    POSE_UNIT,
    POSES,
    VELOCITY_UNIT,
    accelerations_of,
    poses_of,
    velocities_of,
)
from seatrial.models.recording.recording import Recording
from seatrial.models.recording.source import check_size, foreign
from seatrial.models.vessel.basis import Array

KEY = b"seatrial"  # of the metadata of the schema
VERSION = 1
EXPECTED = "a recording written by seatrial data convert"
FORCES, INPUTS = ("tau", "tau_filtered", "tau_actual"), ("inputs", "commands")
PER_DOF = ("eta", "nu", "nu_dot", *FORCES)


def write_recording(recording: Recording, path: Path, metadata: Mapping[str, object]) -> None:
    """Write a recording with all it holds, and `metadata` that JSON can hold, as one file.

    The file appears when it is complete. Raises RecordingError if it cannot be written.
    """
    arrays, fields = [], []
    for name, unit, values in _columns(recording):
        array = pa.array(np.ascontiguousarray(values))
        arrays.append(array)
        fields.append(pa.field(name, array.type, metadata={"unit": unit}))
    known = {
        "version": VERSION,
        "dofs": recording.dofs,
        "without_lag": recording.without_lag,
        "input_names": recording.input_names,
        "load_names": recording.load_names,
        "file_names": recording.file_names,
        **metadata,
    }
    schema = pa.schema(fields, metadata={KEY: json.dumps(known, default=str).encode()})
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        parquet.write_table(pa.Table.from_arrays(arrays, schema=schema), part)
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        reason = error.strerror or str(error)
        raise RecordingError(f"{path}: cannot be written ({reason})") from error


def is_stored(path: Path) -> bool:
    """Whether a file is a recording that was written so; a file of another kind is not read."""
    return bool(stored_metadata(path))


def stored_metadata(path: Path) -> dict[str, object]:
    """What was stored beside the columns; empty if the file is no such recording."""
    if path.suffix != ".parquet" or not path.is_file():
        return {}
    with foreign(path, "a Parquet file"):
        content = (parquet.read_schema(path).metadata or {}).get(KEY)
        known = json.loads(content) if content else {}
    return known if isinstance(known, dict) else {}


def read_recording(path: Path, dofs: Sequence[str] | None = None) -> Recording:
    """Read a recording, or those of its degrees of freedom that are asked for.

    Raises RecordingError if the file cannot be read, ConfigurationError if it lacks one.
    """
    known = stored_metadata(path)
    if known.get("version") != VERSION:
        raise RecordingError(f"{path}: got version {known.get('version')}, expected {EXPECTED}")
    with foreign(path, EXPECTED), parquet.ParquetFile(path) as file:
        check_size(path, file.metadata.num_rows * file.metadata.num_columns)
        table = file.read(use_threads=False)
        columns = {name: table[name].to_numpy() for name in table.column_names}
        recording = _recording(columns, known)
    wanted = recording.dofs if dofs is None else tuple(dofs)
    if missing := [dof for dof in wanted if dof not in recording.dofs]:
        raise ConfigurationError(
            f"{path}: got {', '.join(recording.dofs)}, expected {', '.join(missing)} too"
        )
    if wanted == recording.dofs:
        return recording
    index = [recording.dofs.index(dof) for dof in wanted]
    values = {name: getattr(recording, name) for name in PER_DOF}
    cut = {name: None if array is None else array[:, index] for name, array in values.items()}
    return replace(recording, dofs=wanted, **cut)  # type: ignore[arg-type]


def _columns(recording: Recording) -> Iterator[tuple[str, str, Array]]:
    """Name, unit and values of every column."""
    yield "t", "s", recording.t
    for field, names, units in _layout(recording.dofs, recording.input_names, recording.load_names):
        values = getattr(recording, field)
        if values is not None:
            yield from zip(names, units, values.T, strict=True)
    if recording.file is not None:
        yield "file", "", recording.file  # type: ignore[misc]


def _layout(
    dofs: Sequence[str], inputs: Sequence[str], loads: Sequence[str]
) -> list[tuple[str, list[str], list[str]]]:
    """The fields of a recording that have several columns, with their names and units."""
    speeds = [VELOCITY_UNIT[dof] for dof in dofs]
    forces = [FORCE_UNIT[dof] for dof in dofs]
    return [
        ("eta", list(poses_of(dofs)), [POSE_UNIT[dof] for dof in dofs]),
        ("nu", list(velocities_of(dofs)), speeds),
        ("nu_dot", list(accelerations_of(dofs)), [ACCELERATION_UNIT[dof] for dof in dofs]),
        *((kind, [f"{kind}_{dof}" for dof in dofs], forces) for kind in FORCES),
        ("attitude", [f"attitude_{angle}" for angle in POSES[3:]], ["rad"] * 3),
        ("wind", ["wind_u", "wind_v"], ["m/s"] * 2),
        *((kind, [f"{kind}.{name}" for name in inputs], [""] * len(inputs)) for kind in INPUTS),
        ("loads", [f"loads.{name}" for name in loads], ["N"] * len(loads)),
    ]


def _recording(columns: Mapping[str, Array], known: Mapping[str, object]) -> Recording:
    """The recording of its columns and metadata; raises KeyError and the like if they are not."""
    dofs, inputs, files, loads = (
        tuple(map(str, known.get(name, ())))  # type: ignore[call-overload]
        for name in ("dofs", "input_names", "file_names", "load_names")
    )
    fields = {
        field: np.column_stack([columns[name] for name in names])
        for field, names, _ in _layout(dofs, inputs, loads)
        if names and all(name in columns for name in names)
    }
    return Recording(
        dofs,
        columns["t"],
        without_lag=bool(known["without_lag"]),
        input_names=inputs,
        load_names=loads,
        file=columns.get("file"),  # type: ignore[arg-type]
        file_names=files,
        **fields,
    )
