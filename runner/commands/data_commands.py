"""`seatrial data`: examines and converts recordings, and proposes maps of their columns."""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
import yaml
from rich.console import Console
from rich.table import Table as Grid
from rich.text import Text

from seatrial.models.errors import ConfigurationError
from seatrial.models.recording.diagnosis import FAULTS, doubts, examine, with_option
from seatrial.models.recording.proposal import Proposal, propose
from seatrial.models.recording.source import ReadOptions, Source, read_sources
from seatrial.runner.commands.benchmark import get
from seatrial.runner.commands.data_convert import File, MapFile, convert
from seatrial.runner.commands.recording_report import Report, report
from seatrial.runner.compare.page import write_page
from seatrial.runner.configuration.config import build_as
from seatrial.runner.configuration.recording_map import options_of, own_map, read_map, reader_of
from seatrial.runner.sweeps import in_process

if TYPE_CHECKING:  # slow to import
    from seatrial.runner.commands import recording_page
else:
    import lazy_loader

    recording_page = lazy_loader.load(
        "seatrial.runner.commands.recording_page", suppress_warning=True
    )

app = typer.Typer(
    name="seatrial data", no_args_is_help=True, pretty_exceptions_enable=False,
    add_completion=False, help="Examine and convert recordings, and propose maps of their columns.",
)  # fmt: skip
Html = Annotated[
    Path | None, typer.Option("--html", metavar="OUT", help="Also write a page with figures.")
]
Out = Annotated[
    Path | None, typer.Option("--out", "-o", metavar="MAP.yaml", help="Write the map to a file.")
]
VesselName = Annotated[
    str | None, typer.Option("--vessel", metavar="NAME", help="Vessel whose inputs are mapped.")
]
Force = Annotated[bool, typer.Option("--force", help="Overwrite existing files.")]
app.command()(convert)
app.command()(get)
LINE_WIDTH = 120  # letters of a line that goes to a file


def main(words: Sequence[str]) -> int:
    """Run `seatrial data` with the words that follow it; returns the exit code."""
    return run_typer(app, "data", words)


def run_typer(program: typer.Typer, name: str, words: Sequence[str]) -> int:
    """Run a command of `seatrial` that typer parses; returns the exit code."""
    command = typer.main.get_command(program)
    try:
        command.main(list(words), prog_name=f"seatrial {name}", standalone_mode=False)
    except typer.Exit as stop:
        return stop.exit_code
    except typer.Abort:
        return 1
    except Exception as error:
        if not hasattr(error, "format_message"):
            raise
        raise ConfigurationError(f"{name}: {error.format_message()}") from error
    return 0


@app.command()
def check(file: File, map_file: MapFile = None, html: Html = None) -> None:
    """Report units, sampling, gaps, noise, clocks, and whether pose and velocity agree.

    Without a map, that of `seatrial data map` is used.
    """
    node = read_map(map_file) if map_file else own_map(file)
    reading = {key: node[key] for key in ("format", "text", "messages") if key in node}
    sources = read_sources(file.expanduser(), build_as(ReadOptions, reading, "excitation"))
    node = node or options_of(drafted(file, sources).map)
    known = report(reader_of(file, node), sources)
    if html is not None:
        write_page(recording_page.recording_page(known), html)
    _show(known)


@app.command("map")
def map_columns(
    file: File, vessel: VesselName = None, out: Out = None, force: Force = False
) -> Sequence[str]:
    """Propose a map from titles, units and motion, as YAML; says what is sure, asked, left out."""
    if out is not None and out.exists() and not force:
        raise ConfigurationError(f"{out}: exists already, expected a new file or --force")
    wanted: tuple[str, ...] = ()
    if vessel is not None:
        node: Any = in_process.composed([f"vessel={vessel}"]).config["vessel"]
        wanted = tuple(node.get("inputs") or ())
    draft = drafted(file, read_sources(file.expanduser(), ReadOptions()), wanted)
    kinds = {"sure": draft.sure, "question": draft.questions, "left out": draft.left_out}
    for kind, lines in kinds.items():
        for line in lines:
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


def drafted(file: Path, sources: Mapping[str, Source], wanted: Sequence[str] = ()) -> Proposal:
    """A proposed map of a recording, with the changes that the check tried and found to agree.

    Args:
        file: the recording
        sources: its columns
        wanted: names of the inputs of the vessel, if one is named
    """
    draft = propose(sources, wanted)
    node, known = {**draft.map, "at_gap": "split"}, None
    try:
        reader = reader_of(file, options_of(deepcopy(node)))
        known = examine(reader, reader.columns.moving)
        asked = [*doubts(sources, reader.columns).values()]
    except FAULTS as error:
        asked = [str(error)]
    if known is not None:
        open_ = [f"{problem}?" for problem in known.problems if not problem.change]
        asked = [*known.questions, *known.not_compared, *open_]
    mended = [problem for problem in known.problems if problem.change] if known else []
    for path, value in (change for problem in mended for change in problem.change.items()):
        node = with_option(node, path.removeprefix("columns.").split("."), value)
    lines = [line for source in sources.values() for line in source.left_out]
    return Proposal(node, (*draft.sure, *map(str, mended)), (*draft.questions, *asked),
                    (*lines, *draft.left_out))  # fmt: skip


def _show(known: Report) -> None:
    console = Console(highlight=False, markup=False)
    if not console.is_terminal:
        console = Console(highlight=False, markup=False, width=LINE_WIDTH)
    for line in known.verdict:
        console.print(line, soft_wrap=True)
    for table in known.tables:
        console.print(table.title, soft_wrap=True)
        grid = Grid(box=None)
        for i, head in enumerate(table.heads):
            grid.add_column(Text(head), no_wrap=i == 0)
        for row in table.rows:
            grid.add_row(*map(Text, row))
        console.print(grid)
    for line in (*(f"left out: {line}" for line in known.left_out),
                 *(f"next: {line}" for line in known.advice)):  # fmt: skip
        console.print(line, soft_wrap=True)
