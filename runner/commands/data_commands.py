"""`seatrial data`: examines and converts recordings, and proposes maps of their columns."""

from collections.abc import Sequence
from copy import deepcopy
from pathlib import Path
from typing import Annotated, Any

import typer
import yaml

from seatrial.models.errors import ConfigurationError
from seatrial.models.recording.column_map import FAULTS
from seatrial.models.recording.diagnosis import doubts, examine, with_option
from seatrial.models.recording.proposal import Proposal, propose
from seatrial.models.recording.source import ReadOptions, read_sources
from seatrial.runner.commands.benchmark import get
from seatrial.runner.commands.data_convert import File, MapFile, convert
from seatrial.runner.commands.recording_report import recording_page, report
from seatrial.runner.compare.cli import run_typer
from seatrial.runner.compare.formats import OutputFormat, render
from seatrial.runner.compare.page import write_page
from seatrial.runner.configuration.recording_map import options_of, own_map, read_map, reader_of
from seatrial.runner.sweeps import in_process

app = typer.Typer(
    name="seatrial data", no_args_is_help=True, pretty_exceptions_enable=False,
    add_completion=False, help="Examine and convert recordings, and propose maps of their columns.",
)  # fmt: skip
Html = Annotated[Path | None, typer.Option("--html", metavar="OUT", help="A page with figures.")]
Out = Annotated[Path | None, typer.Option("--out", "-o", metavar="MAP.yaml", help="File to write.")]
VesselName = Annotated[str | None, typer.Option("--vessel", help="Vessel whose inputs are mapped.")]
Force = Annotated[bool, typer.Option("--force", help="Overwrite existing files.")]
app.command()(convert)
app.command()(get)


def main(words: Sequence[str]) -> int:
    """Run `seatrial data` with the words that follow it; returns the exit code."""
    return run_typer(app, words)


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
        if known is None:
            asked += doubts(sources, reader.columns).values()
        else:
            left_out = [*reader.account(known.recording.dofs)[0].left_out, *known.not_compared]
            asked += known.questions
    except FAULTS as error:
        known, asked = None, [*asked, str(error)]
    for problem in known.problems if known else ():
        for path, value in problem.change.items():
            node = with_option(node, path.removeprefix("columns.").split("."), value)
        (sure if problem.change else asked).append(f"{problem}{'' if problem.change else '?'}")
    return Proposal(node, tuple(sure), tuple(asked), (*left_out, *draft.left_out))
