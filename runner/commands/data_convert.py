"""`seatrial data convert`: a mapped recording as Parquet, with the map that reads it."""

import hashlib
import json
import os
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pyarrow as pa
import typer
from pyarrow import parquet

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.notation import DOFS, accelerations_of, poses_of, velocities_of
from seatrial.models.recording.column_map import targets_of
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel.basis import Array
from seatrial.runner.configuration.recording_map import KEY, read_map, reader_of

File = Annotated[Path, typer.Argument(help="A file, or a folder with one file per topic.")]
Target = Annotated[Path, typer.Argument(metavar="OUT.parquet", help="File to write (.parquet).")]
MapFile = Annotated[
    Path | None, typer.Option("--map", metavar="MAP.yaml", help="Map of the columns.")
]
Axes = Annotated[
    str | None, typer.Option("--dofs", metavar="surge,sway,...", help="Default: those mapped.")
]


def convert(file: File, target: Target, map_file: MapFile = None, dofs: Axes = None) -> None:
    """Write a recording as Parquet: in SI units, on one clock, with the map beside it.

    `excitation.path=OUT.parquet` reads it back exactly, without a map.
    """
    if target.suffix != ".parquet":
        raise ConfigurationError(f"{target}: got suffix {target.suffix!r}, expected .parquet")
    if target.exists():
        raise ConfigurationError(f"{target}: exists already, expected a new file")
    node = read_map(map_file) if map_file else {}
    reader = reader_of(file, node)
    axes = [name.strip() for name in dofs.split(",")] if dofs is not None else []
    if unknown := [name for name in axes if name not in DOFS]:
        raise ConfigurationError(f"--dofs: got {unknown[0]}, expected some of {', '.join(DOFS)}")
    for dof in DOFS if dofs is None else ():
        with suppress(ConfigurationError):
            reader.check((dof,))
            axes.append(dof)
    if not axes:
        raise ConfigurationError("data convert: got a map of no degree of freedom, expected --map")
    recording, path = reader.read(axes), file.expanduser()
    files = (each for each in sorted((path, *path.rglob("*"))) if each.is_file())
    digests = {str(each): hashlib.sha256(each.read_bytes()).hexdigest() for each in files}
    write_recording(recording, target, {"read_by": node, "sha256": digests})
    typer.echo(
        f"wrote {target}: {len(recording)} samples of {recording.period_s:g} s in "
        f"{len(recording.pieces())} pieces, {', '.join(axes)}"
    )


def write_recording(recording: Recording, path: Path, metadata: dict[str, object]) -> None:
    """Write what was measured as columns with units, and the map that reads them as `metadata`.

    The file appears when it is complete. Raises RecordingError if it cannot be written.
    """
    dofs, attitude = recording.dofs, DOFS[3:]
    columns: dict[str, tuple[Array, str]] = {"t": (recording.t, "s")}
    read_by: dict[str, Any] = {"time": "t", "at_gap": "split"}
    inputs, loads = recording.input_names, recording.load_names
    forces = recording.tau if np.any(recording.tau) or not inputs else None
    for kind, values, keys, names in (
        ("position", recording.eta, dofs, poses_of(dofs)),
        ("position", recording.attitude, attitude, poses_of(attitude)),
        ("velocity", recording.nu, dofs, velocities_of(dofs)),
        ("acceleration", recording.nu_dot, dofs, accelerations_of(dofs)),
        ("force", forces, dofs, [f"tau_{dof}" for dof in dofs]),
        ("actual_force", recording.tau_actual, dofs, [f"acting_{dof}" for dof in dofs]),
        ("air", recording.wind, DOFS[:2], ["air_u", "air_v"]),
        ("inputs", recording.inputs, inputs, [f"inputs.{name}" for name in inputs]),
        ("commands", recording.commands, inputs, [f"commands.{name}" for name in inputs]),
        ("loads", recording.loads, loads, [f"loads.{name}" for name in loads]),
    ):
        for key, name, column in zip(keys, names, () if values is None else values.T, strict=False):
            targets = targets_of(f"{kind}.{key}")
            unit = targets[0] if len(targets) == 1 else ""
            columns[name] = column, unit
            read_by.setdefault(kind, {})[key] = name if unit else {"column": name, "unit": ""}
    arrays = [pa.array(np.ascontiguousarray(values)) for values, _ in columns.values()]
    fields = [pa.field(n, pa.float64(), metadata={"unit": u}) for n, (_, u) in columns.items()]
    known = {KEY: json.dumps({**metadata, "map": read_by}, default=str)}
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        schema = pa.schema(fields, metadata=known)
        parquet.write_table(pa.Table.from_arrays(arrays, schema=schema), part)
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        reason = error.strerror or str(error)
        raise RecordingError(f"{path}: cannot be written ({reason})") from error
