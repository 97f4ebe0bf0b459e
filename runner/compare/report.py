"""A self-contained HTML page on a set of runs: tables, figures, failures, provenance."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from markupsafe import Markup

from seatrial.models.errors import ConfigurationError, LogbookError, PartError, RecordingError
from seatrial.runner.compare.comparability import TooDifferentError
from seatrial.runner.compare.figures import Figure, drawings_of, figures
from seatrial.runner.compare.formats import html_table
from seatrial.runner.compare.frame import Queries, StoredRun, ordered
from seatrial.runner.compare.grid import Scalar, TextTable, grid_of, one_line
from seatrial.runner.compare.headlines import Headline, answers, headlines, in_words
from seatrial.runner.compare.manoeuvre_comparison import grid_of_sheet, newest_manoeuvres
from seatrial.runner.compare.page import Picture, picture, render_page, write_page
from seatrial.runner.compare.plots.request import PlotRequest, subtitle
from seatrial.runner.compare.plots.style import drawn
from seatrial.runner.compare.runs import RUN_COLUMNS, run_rows
from seatrial.runner.compare.table import TableRequest
from seatrial.runner.compare.where import Condition
from seatrial.runner.database.tables import RunRow as RunTable
from seatrial.runner.export.manoeuvre_tracks import measured_sheet
from seatrial.runner.record.catalogue import METRICS, definition_of
from seatrial.runner.record.vocabulary import COMBINED, DOF_ORDER, GROUPS

MOST_LISTED = 500  # runs and failures on the page; the database has them all


@dataclass(frozen=True)
class ReportRequest:
    """The runs, rows and columns of a report."""

    rows: str = "identifier"
    columns: str = "disturbance"
    where: str | None = None
    sweep: str | None = None  # a number, a name or `all`; by default the newest one
    tag: str | None = None  # only sweeps with it
    title: str | None = None


@dataclass(frozen=True)
class Section:
    """A table of the page, folded unless `shown`."""

    caption: str
    table: Markup
    shown: bool


def write_report(results: Queries, request: ReportRequest, file: Path) -> None:
    """Write the page; raises LogbookError if the file cannot be written.

    `request` selects the runs, rows and columns. Raises ConfigurationError if no run matches.
    """
    write_page(render_report(results, request), file)


def render_report(results: Queries, request: ReportRequest) -> str:
    """Return the page as text; raises ConfigurationError if no run matches."""
    condition, scope = results.selected(request.where, request.sweep, request.tag)
    runs = results.runs(condition)
    ids = {run.sweep for run in runs}
    sweeps = [sweep for sweep in results.reader.sweeps() if sweep.id in ids]
    lost = [run.id for run in runs if run.status not in ("finished", "running")]
    asked = TableRequest(
        names=[], rows=(request.rows,), columns=(request.columns,),
        where=request.where, sweep=request.sweep, tag=request.tag,
    )  # fmt: skip
    found, refused = headlines(results, runs, asked)
    tables = [*_tables(found), *_sheets(results, runs)]
    pictures, trouble = _pictures(results, request)
    return render_page(
        "report.html",
        title=request.title or (f"Sea trials, {scope}" if scope else "Sea trials"),
        database=str(results.reader.address),
        where=request.where,
        statuses=Counter(run.status for run in runs),
        runs=len(runs),
        varied=_varied(runs),
        sweeps=sweeps,
        settings=_settings(results, runs),
        answers=[*answers(found[0])] if found else [],
        tables=tables,
        pictures=pictures,
        refused=refused,
        trouble=trouble,
        warnings=_warnings(results, condition),
        failures=[results.reader.run(run_id) for run_id in lost[:MOST_LISTED]],
        provenance=_provenance(results, condition),
        listed=html_table(_listed(results, runs)),
    )


def _varied(runs: Sequence[StoredRun]) -> list[tuple[str, str]]:
    """Return every choice with its levels; many seeds become a range."""
    choices = []
    for name in (*GROUPS, "seed"):
        levels = ordered(run.levels[name] for run in runs)
        text = ", ".join(levels)
        if name == "seed" and len(levels) > 5:
            text = f"{len(levels)} seeds, {levels[0]} to {levels[-1]}"
        choices.append((name, text))
    return choices


def _settings(results: Queries, runs: Sequence[StoredRun]) -> Markup:
    """Return a table of all configuration values of the runs."""
    newest = {tuple(run.levels[name] for name in GROUPS): run.id for run in runs}
    configs = results.configs_of(sorted(newest.values())[-MOST_LISTED:]).values()
    keys = dict.fromkeys(key for config in configs for key in config if key != "seed")
    rows = []
    for key in keys:
        values = dict.fromkeys(str(config[key]) for config in configs if key in config)
        rows.append([key, one_line(", ".join(values), 200)])
    return html_table(grid_of("", ("key", "value"), rows, labels=2))


def _tables(found: Sequence[Headline]) -> list[Section]:
    return [
        Section(definition_of(one.metric).heading, html_table(in_words(one.table)), one.shown)
        for one in found
    ]


def _sheets(results: Queries, runs: Sequence[StoredRun]) -> list[Section]:
    """Return the sheets of the newest manoeuvres."""
    sections = []
    for run, recorded in newest_manoeuvres(results, runs):
        try:
            result = measured_sheet(recorded.track, recorded.manoeuvre)
            grid = grid_of_sheet(result, f"Run {run.id}", recorded.predicted)
        except RecordingError:
            continue  # a manoeuvre that was not carried out, such as one that is too short
        sections.append(Section(f"Manoeuvre of {subtitle(run)}", html_table(grid), shown=True))
    return sections


def _pictures(results: Queries, request: ReportRequest) -> tuple[list[Picture], list[str]]:
    """Return every figure that the runs have data for, and messages on failed figures."""
    pictures: list[Picture] = []
    messages: list[str] = []
    shared = PlotRequest(
        columns=request.columns, where=request.where, sweep=request.sweep, tag=request.tag
    )
    kinds = sorted(
        (entry for entry in figures().values() if entry.caption), key=lambda entry: entry.place
    )
    with drawn():
        for figure in kinds:
            drawings_for = drawings_of(figure.name)
            for caption, variant in _variants(figure, shared, request.rows):
                try:
                    drawings = drawings_for(results, variant)
                except (TooDifferentError, LogbookError, PartError) as error:
                    messages.append(f"{caption}: {error}")
                    continue
                except ConfigurationError:
                    continue  # these runs have no data for this figure
                one_dof = len(variant.dofs) == 1 and variant.dofs[0] not in COMBINED
                title = f"{caption}, {variant.dofs[0]}" if one_dof else caption
                for drawing in drawings:
                    pictures.append(picture(drawing.figure, title, f"f{len(pictures)}-"))
    return pictures, list(dict.fromkeys(messages))  # one for all degrees of freedom


def _variants(figure: Figure, shared: PlotRequest, rows: str) -> Iterator[tuple[str, PlotRequest]]:
    """Split a wide figure into requests of narrower ones, with their captions."""
    for own in figure.report_rows or (figure.rows or rows,):
        request = replace(shared, rows=own)
        by_dof = [replace(request, dofs=(dof,)) for dof in DOF_ORDER]
        match figure.each:
            case "metric and dof":
                for metric in (entry for entry in METRICS if entry.headline):
                    parts = (replace(part, metric=metric.name) for part in by_dof)
                    yield from ((metric.heading, part) for part in parts)
            case "dof":
                yield from ((figure.caption, part) for part in by_dof)
            case "column":
                yield figure.caption, replace(request, facet=request.columns)
            case _:
                yield figure.caption, request


def _warnings(results: Queries, condition: Condition) -> list[str]:
    """Return the warnings with the numbers of their runs."""
    messages = []
    for text, ids in results.warnings(condition)[:MOST_LISTED]:
        runs = ", ".join(map(str, ids[:10])) + (", …" if len(ids) > 10 else "")
        messages.append(f"{text} (run{'s'[: len(ids) != 1]} {runs})")
    return messages


def _provenance(results: Queries, condition: Condition) -> list[tuple[str, list[str]]]:
    """Return each property of provenance with its distinct values."""
    counts_of: dict[str, Counter[str]] = {}
    for row in results.provenance(condition):
        dirty = " with uncommitted changes" if row.git_dirty else ""
        facts = {"git commit": f"{row.git_commit or 'unknown'}{dirty}", "host": row.host}
        facts |= {str(name): str(version) for name, version in row.versions.items()}
        facts |= {"command": row.command} if row.command else {}
        for name, value in facts.items():
            counts_of.setdefault(name, Counter())[value] += 1
    return [
        (name, [value for value, _ in counts.most_common(20)]) for name, counts in counts_of.items()
    ]


def _listed(results: Queries, runs: Sequence[StoredRun]) -> TextTable:
    chosen = [run.id for run in runs][-MOST_LISTED:]
    summaries = results.reader.runs(RunTable.id.in_(chosen), newest_first=True)
    names = [name for name in RUN_COLUMNS if name not in ("superseded", "error")]
    rows = run_rows(results, summaries, names)
    filled = [i for i, name in enumerate(names) if _is_told(name, [row[i] for row in rows])]
    names = [names[i] for i in filled]
    rows = [[_minute(row[i], names[k]) for k, i in enumerate(filled)] for row in rows]
    notes = [f"the newest {MOST_LISTED} of {len(runs)}"] if len(runs) > MOST_LISTED else []
    return in_words(grid_of("", names, rows, labels=1, notes=notes))


def _is_told(name: str, values: Sequence[Scalar]) -> bool:
    """Return whether a column has values, and not one choice alone, which the page's head has."""
    alone = name in GROUPS and len(values) > 1 and len(set(values)) == 1
    return not alone and any(value not in (None, "") for value in values)


def _minute(value: Scalar, name: str) -> Scalar:
    """Return the start of a run to the minute, and any other value as it is."""
    return str(value)[:16].replace("T", " ") if name == "started_at" else value
