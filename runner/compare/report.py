"""The page on a set of runs: the answer, a figure and its table; then the rest, provenance last."""

import shlex
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
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
from seatrial.runner.compare.page import (
    Section,
    bullets,
    code,
    facts,
    folded,
    group,
    page,
    paragraph,
    picture,
    status,
    write_page,
)
from seatrial.runner.compare.plots.request import PlotRequest, subtitle
from seatrial.runner.compare.plots.style import drawn
from seatrial.runner.compare.runs import RUN_COLUMNS, run_rows
from seatrial.runner.compare.table import TableRequest
from seatrial.runner.compare.where import Condition
from seatrial.runner.configuration.invocation import DEFAULT_DATABASE, results_program
from seatrial.runner.database.tables import RunRow as RunTable
from seatrial.runner.export.manoeuvre_tracks import measured_sheet
from seatrial.runner.record.catalogue import METRICS, definition_of
from seatrial.runner.record.vocabulary import GROUPS, LOST

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
    database: str = DEFAULT_DATABASE  # as the user wrote it, for the commands on the page


def write_report(results: Queries, request: ReportRequest, file: Path) -> None:
    """Write the page; raises LogbookError if the file cannot be written.

    `request` selects the runs, rows and columns. Raises ConfigurationError if no run matches.
    """
    write_page(render_report(results, request), file)


def render_report(
    results: Queries,
    request: ReportRequest,
    links: Mapping[str, str] | None = None,
    figures: bool = True,
) -> str:
    """Return the page as text; raises ConfigurationError if no run matches.

    The site's pages have links to the others, and without `figures` the first one alone.
    """
    condition, scope = results.selected(request.where, request.sweep, request.tag)
    runs = results.runs(condition)
    asked = TableRequest(
        names=[], rows=(request.rows,), columns=(request.columns,),
        where=request.where, sweep=request.sweep, tag=request.tag,
    )  # fmt: skip
    found, refused = headlines(results, runs, asked)
    sections = [Section("Result", "result", _result(results, request, runs, found))]
    if tables := _tables(results, request, runs, found, refused):
        sections.append(Section("Tables", "tables", tables))
    if figures:
        metric = found[0].metric if found else ""
        pictures, messages = _pictures(results, request, metric)
        pictures += [paragraph(f"Not drawn: {text}", "wide") for text in messages]
        none = paragraph("None of these runs has data for a figure.")
        blocks = [group("figures", *(pictures or [none]))]
        sections.append(Section("Figures", "figures", blocks))
    if warnings := _warnings(results, condition):
        sections.append(Section("Warnings", "warnings", [bullets(warnings)]))
    sections += [
        Section("Failures", "failures", _failures(results, runs)),
        Section("Configuration", "configuration", _configuration(results, runs)),
        Section("Runs", "runs", [folded("All runs", html_table(_listed(results, runs)))]),
        Section("Provenance", "provenance", [facts(_provenance(results, condition))]),
    ]
    title = request.title or (f"Sea trials, {scope}" if scope else "Sea trials")
    return page(title, _lead(results, request, runs, found), sections, links)


def _lead(
    results: Queries, request: ReportRequest, runs: Sequence[StoredRun], found: Sequence[Headline]
) -> Iterator[Markup]:
    """What the runs say, above all: the best rows, and how many runs there are and failed."""
    yield group("answer", bullets(answers(found[0]) if found else ()))
    counts = sorted(Counter(run.status for run in runs).items())
    pills = Markup(" ").join(status(name, f"{number} {name}") for name, number in counts)
    yield Markup("<p>{} run{}: {}</p>").format(len(runs), "s"[: len(runs) != 1], pills)
    only = f", only {request.where}" if request.where else ""
    yield paragraph(f"From {results.reader.address}{only}.", "small")


def _result(
    results: Queries, request: ReportRequest, runs: Sequence[StoredRun], found: Sequence[Headline]
) -> list[Markup]:
    """What was compared and under which conditions; the first figure; the first table."""
    lost = [run for run in runs if run.status in LOST]
    failed = f"{len(lost)} of {len(runs)} runs, listed under Failures" if lost else "none"
    baseline = f"{request.rows} none" if found and found[0].baseline else "none is named"
    told = facts([*_varied(runs), ("baseline", baseline), ("failures", failed)])
    blocks = [group("beside", told, *_first(results, request, found))]
    return [*blocks, *(block for one in found[:1] for block in _table(one, request))]


def _first(results: Queries, request: ReportRequest, found: Sequence[Headline]) -> Iterator[Markup]:
    """Draw the first table; nothing if its runs cannot be drawn."""
    for one in found[:1]:
        asked = replace(_shared(request), metric=one.metric, rows=request.rows)
        with drawn(), suppress(TooDifferentError, ConfigurationError, LogbookError, PartError):
            for k, drawing in enumerate(drawings_of("bars")(results, asked)):
                yield picture(drawing.figure, definition_of(one.metric).heading, f"first{k}-")


def _table(one: Headline, request: ReportRequest) -> list[Markup]:
    """A table and the command that makes it."""
    words = [*results_program().split(), *one.command]
    if request.database != DEFAULT_DATABASE:
        words += ["--database", request.database]
    return [html_table(in_words(one.table)), code(shlex.join(words))]


def _tables(
    results: Queries, request: ReportRequest, runs: Sequence[StoredRun],
    found: Sequence[Headline], refused: Sequence[str],
) -> list[Markup]:  # fmt: skip
    """The tables beside the first one, and why others are not shown."""
    blocks = [
        folded(definition_of(one.metric).heading, *_table(one, request), opened=one.shown)
        for one in found[1:]
    ]
    blocks += _sheets(results, runs)
    blocks += [paragraph(f"Not shown: {text}", "refused") for text in refused]
    return blocks if blocks or found else [paragraph("None of these runs has a metric.")]


def _sheets(results: Queries, runs: Sequence[StoredRun]) -> Iterator[Markup]:
    """Yield the sheets of the newest manoeuvres."""
    for run, recorded in newest_manoeuvres(results, runs):
        try:
            result = measured_sheet(recorded.track, recorded.manoeuvre)
            grid = grid_of_sheet(result, f"Run {run.id}", recorded.predicted)
        except RecordingError:
            continue  # a manoeuvre that was not carried out, such as one that is too short
        yield folded(f"Manoeuvre of {subtitle(run)}", html_table(grid), opened=True)


def _failures(results: Queries, runs: Sequence[StoredRun]) -> list[Markup]:
    """The runs that failed, with their errors and tracebacks."""
    blocks = []
    for run_id in [run.id for run in runs if run.status in LOST][:MOST_LISTED]:
        run = results.reader.run(run_id)
        one = run.summary
        text = f" run {one.run_id}: {one.identifier}, {one.disturbance}, seed {one.seed}: "
        summary = status(one.status, one.status) + text + (one.error or "no message")
        trace = code(run.traceback or "no traceback")
        blocks.append(folded(summary, paragraph(one.error_type or ""), trace))
    return blocks or [paragraph("None.")]


def _configuration(results: Queries, runs: Sequence[StoredRun]) -> list[Markup]:
    """The sweeps with their commands, and all settings."""
    ids, blocks = {run.sweep for run in runs}, []
    for sweep in (one for one in results.reader.sweeps() if one.id in ids):
        end = f"to {sweep.finished_at:%Y-%m-%d %H:%M}" if sweep.finished_at else ", not finished"
        words = [f"{sweep.planned} trials planned; {sweep.started_at:%Y-%m-%d %H:%M} UTC {end}"]
        words[0] += f", on {sweep.host}"
        words += [f"tags: {', '.join(sweep.tags)}"] if sweep.tags else []
        words += [sweep.note] if sweep.note else []
        blocks.append(Markup("<h3>Sweep {}: {}</h3>").format(sweep.id, sweep.name))
        blocks += [paragraph("; ".join(words), "small"), code(sweep.command)]
    return [*blocks, folded("All settings", _settings(results, runs))]


def _varied(runs: Sequence[StoredRun]) -> list[tuple[str, str]]:
    """Return every choice with its levels, those with several first; many seeds are a range."""
    choices = []
    for name in (*GROUPS, "seed"):
        levels = ordered(run.levels[name] for run in runs)
        text = ", ".join(levels)
        if name == "seed" and len(levels) > 5:
            text = f"{len(levels)} seeds, {levels[0]} to {levels[-1]}"
        choices.append((len(levels) == 1 or name == "seed", name, text))
    return [(name, text) for _, name, text in sorted(choices, key=lambda choice: choice[0])]


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


def _shared(request: ReportRequest) -> PlotRequest:
    """The columns and the runs of the page's figures."""
    return PlotRequest(
        columns=request.columns, where=request.where, sweep=request.sweep, tag=request.tag
    )


def _pictures(
    results: Queries, request: ReportRequest, first: str
) -> tuple[list[Markup], list[str]]:
    """Return every figure that the runs have data for, and messages on failed figures.

    The bars of the metric `first` stand at the head of the page.
    """
    pictures: list[Markup] = []
    messages: list[str] = []
    with drawn():
        for figure in sorted(figures().values(), key=lambda figure: figure.place):
            for caption, asked in _asked(figure, request, first) if figure.caption else ():
                try:
                    drawings = drawings_of(figure.name)(results, asked)
                except (TooDifferentError, LogbookError, PartError) as error:
                    messages.append(f"{caption}: {error}")
                    continue
                except ConfigurationError:
                    continue  # these runs have no data for this figure
                for drawing in drawings:
                    pictures.append(picture(drawing.figure, caption, f"f{len(pictures)}-"))
    return pictures, messages


def _asked(figure: Figure, request: ReportRequest, first: str) -> Iterator[tuple[str, PlotRequest]]:
    """Yield the requests of a figure with their captions."""
    for rows in figure.report_rows or (figure.rows or request.rows,):
        asked = replace(_shared(request), rows=rows)
        if figure.of_metrics:
            named = [entry for entry in METRICS if entry.headline and entry.name != first]
            yield from ((one.heading, replace(asked, metric=one.name)) for one in named)
        else:
            yield figure.caption, asked


def _warnings(results: Queries, condition: Condition) -> list[str]:
    """Return the warnings with the numbers of their runs."""
    messages = []
    for text, ids in results.warnings(condition)[:MOST_LISTED]:
        runs = ", ".join(map(str, ids[:10])) + (", …" if len(ids) > 10 else "")
        messages.append(f"{text} (run{'s'[: len(ids) != 1]} {runs})")
    return messages


def _provenance(results: Queries, condition: Condition) -> list[tuple[str, Markup]]:
    """Return each property of provenance with its distinct values."""
    counts_of: dict[str, Counter[str]] = {}
    for row in results.provenance(condition):
        dirty = " with uncommitted changes" if row.git_dirty else ""
        properties = {"git commit": f"{row.git_commit or 'unknown'}{dirty}", "host": row.host}
        properties |= {str(name): str(version) for name, version in row.versions.items()}
        properties |= {"command": row.command} if row.command else {}
        for name, value in properties.items():
            counts_of.setdefault(name, Counter())[value] += 1
    return [
        (
            name,
            Markup(", ").join(
                Markup("<code>{}</code>").format(v) for v, _ in counts.most_common(20)
            ),
        )
        for name, counts in counts_of.items()
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
