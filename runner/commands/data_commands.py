"""`seatrial data`: examines and converts recordings, and proposes maps of their columns."""

import hashlib
import json
from collections.abc import Sequence
from contextlib import suppress
from copy import deepcopy
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import numpy as np
import pyarrow as pa
import typer
import yaml
from pyarrow import parquet

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.notation import DOFS, accelerations_of, poses_of, velocities_of
from seatrial.models.recording.column_map import FAULTS, targets_of
from seatrial.models.recording.diagnosis import doubts, examine, with_option
from seatrial.models.recording.proposal import Proposal, propose
from seatrial.models.recording.recording import Recording
from seatrial.models.recording.source import ReadOptions, read_sources
from seatrial.runner.commands.benchmark import get
from seatrial.runner.commands.recording_report import recording_page, report
from seatrial.runner.compare.cli import run_typer
from seatrial.runner.compare.grid import OutputFormat, render
from seatrial.runner.compare.page import write_page
from seatrial.runner.configuration.recording_map import (
    KEY,
    options_of,
    own_map,
    read_map,
    reader_of,
)
from seatrial.runner.sweeps import in_process

app = typer.Typer(
    name="seatrial data", no_args_is_help=True, pretty_exceptions_enable=False,
    add_completion=False, help="Examine and convert recordings, and propose maps of their columns.",
)  # fmt: skip
File = Annotated[Path, typer.Argument(help="A file, or a folder with one file per topic.")]
Target = Annotated[Path, typer.Argument(metavar="OUT.parquet", help="File to write (.parquet).")]
MapFile = Annotated[Path | None, typer.Option("--map", metavar="MAP.yaml", help="Map of columns.")]
Axes = Annotated[str | None, typer.Option(metavar="surge,sway,...", help="Default: those mapped.")]
Html = Annotated[Path | None, typer.Option("--html", metavar="OUT", help="A page with figures.")]
Out = Annotated[Path | None, typer.Option("--out", "-o", metavar="MAP.yaml", help="File to write.")]
VesselName = Annotated[str | None, typer.Option("--vessel", help="Vessel whose inputs are mapped.")]
Force = Annotated[bool, typer.Option("--force", help="Overwrite existing files.")]
app.command()(get)
main = partial(run_typer, app)  # of the words that follow `seatrial data`


@app.command()
def check(file: File, map_file: MapFile = None, html: Html = None) -> None:
    """Report units, sampling, gaps, noise, clocks, and whether pose and velocity agree.

    Without a map, that of `seatrial data map` is used.
    """
    node = read_map(map_file) if map_file else own_map(file)
    known = report(reader_of(file, node or options_of(drafted(file).map)))
    lines, tables, _ = known
    if html is not None:
        write_page(recording_page(str(file), known), html)
    for text in (*lines, "", *(f"{render(table, OutputFormat.RICH)}\n" for table in tables)):
        typer.echo(text)


@app.command("map")
def map_columns(
    file: File, vessel: VesselName = None, out: Out = None, force: Force = False
) -> Sequence[str]:
    """Propose a map from titles, units and motion, as YAML; says what is sure, asked, left out."""
    if out is not None and out.exists() and not force:
        raise ConfigurationError(f"{out}: exists already, expected a new file or --force")
    node: Any = in_process.composed([f"vessel={vessel}"]).config["vessel"] if vessel else {}
    draft = drafted(file, tuple(node.get("inputs") or ()))
    kinds = {"sure": draft.sure, "question": draft.questions, "left out": draft.left_out}
    for kind, line in ((kind, line) for kind, lines in kinds.items() for line in lines):
        typer.echo(f"{kind}: {line}", err=True)
    text = yaml.safe_dump(draft.map, sort_keys=False, default_flow_style=None, width=100)
    if out is None:
        typer.echo(text, nl=False)
        return draft.questions
    try:
        out.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigurationError(f"{out}: cannot write the map: {error.strerror}") from error
    typer.echo(f"wrote {out}")
    return draft.questions


def drafted(file: Path, wanted: Sequence[str] = ()) -> Proposal:
    """A proposed map of a recording, with the changes that the check tried and found to agree.

    `wanted` are the names of the inputs of the vessel, if one is named.
    """
    sources = read_sources(file.expanduser(), ReadOptions())
    draft = propose(sources, wanted)
    node, sure, asked = {**draft.map, "at_gap": "split"}, [*draft.sure], [*draft.questions]
    left_out = [line for source in sources.values() for line in source.left_out]
    try:
        reader = reader_of(file, options_of(deepcopy(node)))
        known = examine(reader, tuple(reader.columns.moving))
        asked += known.questions if known else doubts(sources, reader.columns).values()
        if known:
            left_out = [*reader.account(known.recording.dofs)[0].left_out, *known.not_compared]
    except FAULTS as error:
        known, asked = None, [*asked, str(error)]
    for problem in known.problems if known else ():
        for path, value in problem.change.items():
            node = with_option(node, path.removeprefix("columns.").split("."), value)
        (sure if problem.change else asked).append(f"{problem}{'' if problem.change else '?'}")
    return Proposal(node, tuple(sure), tuple(asked), (*left_out, *draft.left_out))


@app.command()
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
