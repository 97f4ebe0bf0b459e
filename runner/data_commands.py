"""`seatrial data`: examines and converts recordings, and proposes maps of their columns."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
import yaml
from rich.console import Console
from rich.table import Table as Grid

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.models.recording.proposal import propose
from seatrial.models.recording.source import Source
from seatrial.models.recording.sources import ReadOptions, read_sources
from seatrial.runner.benchmark import get
from seatrial.runner.compare.page import write_page
from seatrial.runner.config import build_as
from seatrial.runner.data_convert import convert
from seatrial.runner.recording_map import options_of, read_map, reader_of
from seatrial.runner.recording_page import page, sheets
from seatrial.runner.recording_report import BRIDGED, Report, report

app = typer.Typer(
    name="seatrial data", no_args_is_help=True, pretty_exceptions_enable=False,
    add_completion=False, help="Examine and convert recordings, and propose maps of their columns.",
)  # fmt: skip
File = Annotated[Path, typer.Argument(help="A file, or a folder with a file a topic.")]
MapFile = Annotated[
    Path | None, typer.Option("--map", metavar="MAP.yaml", help="Which column is what.")
]
Html = Annotated[
    Path | None, typer.Option("--html", metavar="OUT", help="Also write a page with figures.")
]
Out = Annotated[
    Path | None, typer.Option("--out", "-o", metavar="MAP.yaml", help="Write the map to a file.")
]
app.command()(convert)
app.command()(get)
LINE_WIDTH = 120  # letters of a line that goes to a file
MOST_CURES = 3  # rounds in which what the correlations tell is put into a proposed map
FLIPPED = {
    "frames.velocity=earth": ("velocity", "earth"),
    "frames.position=ENU": ("position", "ENU"),
    "frames.body=FLU": ("body", "FLU"),
}


def main(words: Sequence[str]) -> int:
    """Run `seatrial data` with the words that follow it; returns the exit code."""
    command = typer.main.get_command(app)
    try:
        command.main(list(words), prog_name="seatrial data", standalone_mode=False)
    except typer.Exit as stop:
        return stop.exit_code
    except typer.Abort:
        return 1
    except Exception as error:
        if not hasattr(error, "format_message"):
            raise
        raise ConfigurationError(f"data: {error.format_message()}") from error
    return 0


@app.command()
def check(file: File, map_file: MapFile = None, html: Html = None) -> None:
    """Report sampling, gaps, noise, clocks, and whether pose and velocity belong together.

    Without a map, that of `seatrial data map` is used.
    """
    sources = read_sources(file.expanduser(), _options(map_file))
    node = read_map(map_file) if map_file else _nested(proposed(file, sources))
    reader = reader_of(file, node)
    known = report(reader, sources, reader.columns)
    if html is not None:
        write_page(page(known), html)
    _show(known)


@app.command("map")
def map_columns(file: File, out: Out = None) -> None:
    """Propose a map from names, units of the header, ranges and correlations, as YAML."""
    sources = read_sources(file.expanduser(), ReadOptions())
    node = proposed(file, sources)
    text = yaml.safe_dump(node, sort_keys=False, default_flow_style=None, width=100)
    if out is None:
        typer.echo(text, nl=False)
        return
    try:
        out.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigurationError(f"{out}: cannot write the map: {error.strerror}") from error
    typer.echo(f"wrote {out}")


def proposed(file: Path, sources: Mapping[str, Source]) -> dict[str, object]:
    """A map from names and units, with what the correlations tell put into it."""
    node = propose(sources).map
    if len(sources) > 1 or _has_gaps(file, node):
        node |= _grid(file, node, sources)
    for _ in range(MOST_CURES):
        try:
            reader = reader_of(file, _nested(node))
            known = reader.examine(tuple(reader.columns.velocity))
        except (ConfigurationError, RecordingError):
            return node
        before = repr(node)
        for problem in known.problems if known else ():
            _cure(node, problem.kind, problem.axes, problem.cure, problem.value)
        if repr(node) == before:
            break
    return node


def _has_gaps(file: Path, node: dict[str, object]) -> bool:
    """Whether the file is refused as it is, since it is not sampled uniformly or has gaps."""
    reader = reader_of(file, _nested(node))
    try:
        reader.read(tuple(reader.columns.velocity))
    except RecordingError:
        return True
    except ConfigurationError:
        return False
    return False


def _grid(file: Path, node: dict[str, object], sources: Mapping[str, Source]) -> dict[str, object]:
    """The rate of the source of the velocities; its ordinary steps are no gaps."""
    reader = reader_of(file, _nested(node))
    known = report(reader, sources, replace(reader.columns, velocity={}))
    column = next(iter(reader.columns.velocity.values()), None)
    name = str(getattr(column, "column", column)).rpartition(":")[0]
    sampling = known.samplings.get(name) or next(iter(known.samplings.values()))
    grid: dict[str, object] = {"resample_hz": float(f"{sampling.rate_hz:.2g}"), "at_gap": "split"}
    bridged = float(f"{BRIDGED / sampling.rate_hz:.2g}") if sampling.rate_hz > 0.0 else 0.0
    return grid | {"max_gap_s": bridged} if bridged > reader.max_gap_s else grid


def _cure(
    node: dict[str, object], kind: str, axes: Sequence[str], cure: str, value: float | None
) -> None:
    """Put the cure of a problem into a proposed map."""
    velocity = node.get("velocity")
    if not isinstance(velocity, dict):
        return
    for text, (name, frame) in FLIPPED.items():
        if text in cure.partition(" (")[0]:
            frames = node.setdefault("frames", {})
            if isinstance(frames, dict):
                frames[name] = frame
    if kind == "sign":
        for dof in axes:
            velocity[dof] = _with(velocity[dof], sign=True)
    if kind == "swap" and len(axes) == 2:
        first, second = axes
        velocity[first], velocity[second] = velocity[second], velocity[first]
    if kind == "scale" and "unit: " in cure:
        unit = cure.rpartition("unit: ")[2].rstrip("}")
        group = node.get("position" if ".position." in cure else "velocity")
        for dof in axes:
            if isinstance(group, dict) and dof in group:
                group[dof] = _with(group[dof], unit=unit)
    if kind == "resampled" and value:
        node["resample_hz"] = value


def _with(spec: object, unit: str | None = None, sign: bool = False) -> object:
    """A written column with a unit or the other sign."""
    column = dict(spec) if isinstance(spec, dict) else {"column": str(spec)}
    if sign:
        name = str(column["column"])
        column["column"] = name[1:] if name.startswith("-") else f"-{name}"
    if unit:
        column["unit"] = unit
    return column if len(column) > 1 else column["column"]


def _nested(node: dict[str, object]) -> dict[str, object]:
    """A proposed map as options of a recording."""
    return options_of(dict(node))


def _options(map_file: Path | None) -> ReadOptions:
    if map_file is None:
        return ReadOptions()
    node = read_map(map_file)
    reading = {key: node[key] for key in ("format", "text") if key in node}
    return build_as(ReadOptions, reading, "excitation")


def _show(known: Report) -> None:
    console = Console(highlight=False)
    if not console.is_terminal:
        console = Console(highlight=False, width=LINE_WIDTH)
    problems = () if known.examination is None else known.examination.problems
    for problem in problems:
        console.print(f"problem: {problem}", markup=False, soft_wrap=True)
    if known.examination is not None and not problems:
        console.print("no problem: pose and velocity belong together")
    for sheet in sheets(known):
        grid = Grid(*sheet.heads, title=sheet.title, title_justify="left", box=None)
        grid.columns[0].no_wrap = True
        for row in sheet.rows:
            grid.add_row(*row)
        console.print(grid)
    for line in known.advice:
        console.print(f"next: {line}", markup=False, soft_wrap=True)
