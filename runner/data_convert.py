"""`seatrial data convert`: a mapped recording as Parquet, with its metadata."""

import hashlib
from contextlib import suppress
from pathlib import Path
from typing import Annotated

import typer
import yaml

from seatrial.models.errors import ConfigurationError
from seatrial.models.notation import DOFS
from seatrial.models.recording.recorded_file import RecordedFile
from seatrial.models.recording.stored import write_recording
from seatrial.runner.config import build_as
from seatrial.runner.recording_map import DEFAULT, with_map

File = Annotated[Path, typer.Argument(help="A file, or a folder with a file a topic.")]
Target = Annotated[Path, typer.Argument(metavar="OUT.parquet", help="The file to be written.")]
MapFile = Annotated[
    Path | None, typer.Option("--map", metavar="MAP.yaml", help="Which column is what.")
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
    own = {"path": str(file), "map": None if map_file is None else str(map_file)}
    node = with_map({**yaml.safe_load(DEFAULT.read_text(encoding="utf-8")), **own})
    reader = build_as(RecordedFile, node, "excitation")
    axes = _axes(reader, dofs)
    reader.check(axes)
    recording = reader.read(axes)
    metadata = {"map": node, "source": str(file), "sha256": _digests(file.expanduser())}
    write_recording(recording, target, metadata)
    typer.echo(
        f"wrote {target}: {len(recording)} samples of {recording.period_s:g} s in "
        f"{len(recording.pieces())} pieces, {', '.join(axes)}"
    )


def _axes(reader: RecordedFile, asked: str | None) -> tuple[str, ...]:
    """The degrees of freedom that are asked for, or all that have columns."""
    names = tuple(name.strip() for name in asked.split(",")) if asked is not None else ()
    if unknown := [name for name in names if name not in DOFS]:
        raise ConfigurationError(f"--dofs: got {unknown[0]}, expected some of {', '.join(DOFS)}")
    for dof in DOFS if asked is None else ():
        with suppress(ConfigurationError):
            reader.check((dof,))
            names = (*names, dof)
    if not names:
        raise ConfigurationError("data convert: got a map of no degree of freedom, expected --map")
    return names


def _digests(path: Path) -> dict[str, str]:
    """SHA-256 of the file, or of the files of the folder, by name."""
    digests = {}
    for name in filter(Path.is_file, sorted(path.rglob("*")) if path.is_dir() else [path]):
        with name.open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
        digests[name.relative_to(path.parent).as_posix()] = digest
    return digests
