"""`seatrial data convert`: a mapped recording as Parquet, with the map that reads it."""

import hashlib
import json
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
import pyarrow as pa
import typer
from pyarrow import parquet

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.notation import DOFS, accelerations_of, poses_of, velocities_of
from seatrial.models.recording.column_map import targets_of
from seatrial.models.recording.recording import Recording
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
    for dof in DOFS if dofs is None else ():
        with suppress(ConfigurationError):
            reader.check((dof,))
            axes.append(dof)
    if not axes:
        raise ConfigurationError("data convert: got a map of no degree of freedom, expected --map")
    recording, path = reader.read(axes), file.expanduser()
    files = filter(Path.is_file, sorted((path, *path.rglob("*"))))
    digests = {str(each): hashlib.sha256(each.read_bytes()).hexdigest() for each in files}
    write_recording(recording, target, {"read_by": node, "sha256": digests})
    size = f"{len(recording)} samples of {recording.period_s:g} s"
    typer.echo(f"wrote {target}: {size} in {len(recording.pieces())} pieces, {', '.join(axes)}")


def write_recording(recording: Recording, path: Path, metadata: dict[str, object]) -> None:
    """Write what was measured as columns with units, and the map that reads them as `metadata`.

    The file appears when it is complete. Raises RecordingError if it cannot be written.
    """
    r, dofs, angles, air = recording, recording.dofs, DOFS[3:], DOFS[:2]
    fields, arrays = {"t": pa.field("t", pa.float64(), metadata={"unit": "s"})}, {"t": r.t}
    read_by: dict[str, Any] = {"time": "t", "at_gap": "split"}
    forces = r.tau if np.any(r.tau) or not r.input_names else None
    for kind, values, keys, names in (
        ("position", r.eta, dofs, poses_of(dofs)),
        ("position", r.attitude, angles, poses_of(angles)),
        ("velocity", r.nu, dofs, velocities_of(dofs)),
        ("acceleration", r.nu_dot, dofs, accelerations_of(dofs)),
        ("force", forces, dofs, [f"tau_{dof}" for dof in dofs]),
        ("actual_force", r.tau_actual, dofs, [f"acting_{dof}" for dof in dofs]),
        ("air", r.wind, air, [f"air_{letter}" for letter in velocities_of(air)]),
        *((kind, values, names, [f"{kind}.{name}" for name in names]) for kind, values, names in (
            ("inputs", r.inputs, r.input_names), ("commands", r.commands, r.input_names),
            ("loads", r.loads, r.load_names))),
    ):  # fmt: skip
        for key, name, column in zip(keys, names, () if values is None else values.T, strict=False):
            unit, *others = targets_of(f"{kind}.{key}")
            unit = "" if others else unit
            fields[name] = pa.field(name, pa.float64(), metadata={"unit": unit})
            arrays[name] = np.ascontiguousarray(column)
            read_by.setdefault(kind, {})[key] = name if unit else {"column": name, "unit": ""}
    known = {KEY: json.dumps({**metadata, "map": read_by}, default=str)}
    schema = pa.schema([*fields.values()], metadata=known)
    table = pa.Table.from_arrays([*map(pa.array, arrays.values())], schema=schema)
    try:
        with TemporaryDirectory(dir=path.parent) as folder:
            parquet.write_table(table, part := Path(folder) / path.name)
            part.replace(path)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written ({error.strerror or error})") from error
