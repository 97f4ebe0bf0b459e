"""`seatrial data`: examines and converts recordings, and proposes maps of their columns."""

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import pyarrow as pa
import typer
import yaml
from pyarrow import parquet

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.notation import (
    DOFS,
    POSE_UNIT,
    VELOCITY_UNIT,
    accelerations_of,
    poses_of,
    velocities_of,
)
from seatrial.models.recording.column_map import FAULTS, readings, targets_of
from seatrial.models.recording.consistency import quality_checks
from seatrial.models.recording.diagnosis import Examination, doubts, examine, with_option
from seatrial.models.recording.proposal import Proposal, propose
from seatrial.models.recording.recorded_file import ReadSignals, RecordedFile, clocks
from seatrial.models.recording.recording import Recording, piece_starts
from seatrial.models.recording.signals import Sampling, noise_floor, outliers, sampling
from seatrial.models.recording.source import ReadOptions, read_sources
from seatrial.runner.commands.benchmark import get
from seatrial.runner.compare.cli import run_typer
from seatrial.runner.compare.grid import OutputFormat, TextTable, grid_of, render
from seatrial.runner.compare.page import Section, bullets, html_table, page, picture, write_page
from seatrial.runner.configuration.recording_map import (
    KEY,
    options_of,
    own_map,
    read_map,
    reader_of,
)
from seatrial.runner.sweeps import in_process

if TYPE_CHECKING:  # slow to import
    from matplotlib.figure import Figure

MOST_OUTLIERS = 0.02  # share of the samples of a velocity
MOST_MISSING = 0.01  # share of the duration of a source in gaps
SAMPLING = ("source", "rows", "duration [s]", "rate [Hz]", "gaps", "longest [s]", "at [s]",
            "missing", "repeated times")  # fmt: skip
RANGES = ("signal", "unit", "least", "most", "deviation", "noise", "outliers")
COLUMNS = ("quantity", "column", "unit", "known from")
AXES = ("axis", "correlation", "scale", "excited")

Report = tuple[list[str], list[TextTable], Examination | None]  # lines, tables, what is drawn

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


def report(file: RecordedFile) -> Report:
    """Examine a recording by its map; what cannot be read is said, the rest is reported."""
    sources, columns, samplings = file.sources(), file.columns, dict[str, Sampling]()
    used = {reading.source.name: reading for reading in readings(sources, columns).values()}
    for name, t in clocks(sources, columns).items():
        with suppress(*FAULTS):
            samplings[name] = sampling(t[~np.isnan(used[name].values)] if name in used else t)
    turning = "yaw" in columns.posed  # its rate may be missing: it is then differentiated
    dofs = tuple(dof for dof in DOFS if dof in columns.moving or (dof == "yaw" and turning))
    known, signals = None, ReadSignals(np.empty(0), {}, (), ())
    lines = ["problem: it cannot be read in the axes that are to be compared"]
    try:
        known = examine(file, dofs)
        if known or dofs:
            (signals,) = file.account(known.recording.dofs if known else dofs)
    except FAULTS as error:
        lines = [f"problem: {error}"]
    sampled = [
        (name or "-", *(x if isinstance(x, int) else f"{x:.6g}" for x in samples))
        for name, samples in samplings.items()
    ]
    tables = [grid_of("Sampling", SAMPLING, sampled),
              grid_of("Columns", COLUMNS, [read[:4] for read in signals.readings], 4)]  # fmt: skip
    if known is not None:
        result, lag = known.result, round(known.result.lag_s, 3) + 0.0
        counts = {option: int(np.sum(outliers(values))) for option, values in signals.values.items()
                  if option.startswith("velocity.")}  # fmt: skip
        lines = _verdict(known, signals, counts)
        title = f"Pose and velocity, below {result.cutoff_hz:.2g} Hz; the velocities are"
        axes = [(axis.dof, axis.correlation, axis.scale, "yes" if axis.excited else "no")
                for axis in result.axes]  # fmt: skip
        tables.append(grid_of(f"{title} {lag:+.3f} s behind", AXES, axes))
        tables.append(grid_of("Ranges", RANGES, [*_ranges(signals, counts)], 2, digits=3))
    lines += [f"left out: {line}" for line in signals.left_out]
    for name, s in samplings.items():
        if s.gaps and s.missing > MOST_MISSING and (name in used or len(sources) == 1):
            missing = f"{name}: {s.gaps} gaps, {100.0 * s.missing:.0f} % missing"
            lines.append(f"next: {missing}: excitation.at_gap=split leaves gaps over max_gap_s out")
    for axis in known.result.axes if known else ():
        if not axis.excited:
            lines.append(f"next: {axis.dof} hardly moves: add manoeuvres that excite it")
    return lines, [table for table in tables if table.rows], known


def _verdict(known: Examination, signals: ReadSignals, counts: Mapping[str, int]) -> list[str]:
    """Problems and questions, or that there is none; outliers count, too; and the current."""
    lines = [f"problem: {problem}" for problem in known.problems]
    names = ", ".join(f"{name} {count}" for name, count in counts.items() if count)
    if max(counts.values(), default=0) > MOST_OUTLIERS * len(known.recording):
        lines.append(f"problem: outliers: {names}; excitation.outliers.replace=true")
    lines += [f"question: {line}" for line in known.questions]
    if not lines and any(axis.excited for axis in known.result.axes):
        few = f"; few outliers: {names}" if names else ""
        lines = [f"no problem: pose and velocity are consistent{few}"]
    if "current.north" in signals.values:
        north, east = (float(np.nanmean(signals.values[f"current.{k}"])) for k in ("north", "east"))
        towards = np.degrees(np.arctan2(east, north)) % 360.0
        speed = np.hypot(north, east)
        lines.append(f"current: {speed:.2f} m/s towards {towards:.0f} deg on average")
    return [*lines, *(f"not compared: {line}" for line in known.not_compared)]


def _ranges(signals: ReadSignals, counts: Mapping[str, int]) -> Iterator[tuple[str | float, ...]]:
    """Range, noise and outliers of every signal, in SI units and our frames."""
    period = float(np.median(np.diff(signals.t)))
    starts = piece_starts(signals.t, period)
    for option, x in signals.values.items():
        targets, noise = targets_of(option), noise_floor(x[:, None], starts, period)
        numbers = (np.nanmin(x), np.nanmax(x), np.nanstd(x), noise.deviation[0])
        unit = targets[0] if len(targets) == 1 else "-"
        yield option, unit, *map(float, numbers), counts.get(option, "-")


def recording_page(name: str, report: Report) -> str:
    """The report of a file as one HTML file."""
    from seatrial.runner.compare.plots import style  # slow to import

    lines, tables, known = report
    parts = [("Result", bullets(lines))]
    parts += [(table.title, html_table(replace(table, title=""))) for table in tables]
    if known is not None:
        with style.drawn():
            title = "Errors of both checks; velocities, of the pose (blue) and recorded (orange)"
            parts.append((title, picture(figure(known), title, "f-")))
    sections = [Section(title, f"s{i}", [block]) for i, (title, block) in enumerate(parts)]
    return page(f"Recording {name}", [], sections)


def figure(known: Examination) -> "Figure":
    """Errors of both checks of Hoyer (2021), 5.4.4, and velocities beside those of the pose.

    One row for each axis; velocities are below the cut-off. Nothing is drawn across a gap.
    """
    from seatrial.runner.compare.plots import style

    recording, dofs = known.recording, known.recording.dofs
    (pose, integral), (nu, rates) = quality_checks(recording).values()
    both = recording.lowpassed(np.stack([rates, nu], axis=-1), known.result.cutoff_hz)
    sheet, every = style.panels(len(dofs), 3, 2.2, 1.9, share_x=True)
    for i, axes in enumerate(every):
        dof, values = dofs[i // 3], (pose - integral, nu - rates, both)[i % 3][:, i // 3]
        name = velocities_of([dof])[0] if i % 3 == 2 else f"error of {dof}"
        axes.set_ylabel(f"{name} [{(VELOCITY_UNIT if i % 3 else POSE_UNIT)[dof]}]")
        for a, b in pairwise(recording.edges):
            axes.plot(recording.t[a:b] - recording.t[0], values[a:b], linewidth=1.0)
            axes.set_prop_cycle(None)
    for axes in every[-3:]:
        axes.set_xlabel("Time [s]")
    return sheet
