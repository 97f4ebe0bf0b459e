"""The page on a set of runs: the answer, a figure and its table; then the rest, provenance last."""

import shlex
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from markupsafe import Markup

from seatrial.models.errors import ConfigurationError, LogbookError, PartError, RecordingError
from seatrial.runner.compare.blocks import bullets, code, facts, folded, group, paragraph, status
from seatrial.runner.compare.cli import TableOptions
from seatrial.runner.compare.comparability import TooDifferentError
from seatrial.runner.compare.figures import drawings_of, figures
from seatrial.runner.compare.formats import html_table
from seatrial.runner.compare.frame import Queries, ordered
from seatrial.runner.compare.grid import TextTable, grid_of, one_line
from seatrial.runner.compare.headlines import Headline, answers, headlines, in_words
from seatrial.runner.compare.manoeuvre_comparison import grid_of_sheet, newest_manoeuvres
from seatrial.runner.compare.page import Section, page, picture, write_page
from seatrial.runner.compare.plots.request import PlotRequest, subtitle
from seatrial.runner.compare.plots.style import drawn
from seatrial.runner.compare.runs import run_table
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
    sweep: str | None = None  # a number, a name, a tag or `all`; by default the newest one
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
    report = _Report(results, request)
    parts = {
        "Result": report.result(),
        "Tables": report.tables(),
        "Figures": report.figures() if figures else [],
        "Warnings": report.warnings(),
        "Failures": report.failures(),
        "Configuration": report.configuration(),
        "Runs": [folded("All runs", html_table(report.listed()))],
        "Provenance": [facts(report.provenance())],
    }
    sections = [Section(title, title.lower(), blocks) for title, blocks in parts.items() if blocks]
    title = request.title or (f"Sea trials, {report.scope}" if report.scope else "Sea trials")
    return page(title, report.lead(), sections, links)


class _Report:
    """The parts of the page; `found` are its tables, of which the first is at the top."""

    def __init__(self, results: Queries, request: ReportRequest) -> None:
        self.results, self.request = results, request
        self.condition, self.scope = results.selected(request.where, request.sweep)
        self.runs = results.runs(self.condition)
        chosen: dict[str, Any] = {"where": request.where, "sweep": request.sweep}
        asked = TableOptions(request.rows, request.columns, **chosen)
        self.found, self.refused = headlines(results, self.runs, asked)
        self.shared = PlotRequest(rows=request.rows, columns=request.columns, **chosen)

    def lead(self) -> Iterator[Markup]:
        """What the runs say, above all: the best rows, and how many there are and failed."""
        yield group("answer", bullets(answers(self.found[0]) if self.found else ()))
        counts = sorted(Counter(run.status for run in self.runs).items())
        pills = Markup(" ").join(status(name, f"{number} {name}") for name, number in counts)
        plural = "s"[: len(self.runs) != 1]
        yield Markup("<p>{} run{}: {}</p>").format(len(self.runs), plural, pills)
        only = f", only {self.request.where}" if self.request.where else ""
        yield paragraph(f"From {self.results.reader.address}{only}.", "small")

    def result(self) -> list[Markup]:
        """What was compared and under which conditions; the first figure; the first table."""
        lost = sum(run.status in LOST for run in self.runs)
        failed = f"{lost} of {len(self.runs)} runs, listed under Failures" if lost else "none"
        baselines = [f"{self.request.rows} none" for one in self.found[:1] if one.baseline]
        baseline = baselines[0] if baselines else "none is named"
        named = [("baseline", baseline), ("failures", failed)]
        told = facts([*self.choices(), *named])
        if not self.found:
            return [group("beside", told)]
        first, pictures = self.found[0], list[Markup]()
        heading = definition_of(first.metric).heading
        asked = replace(self.shared, metric=first.metric)
        with drawn(), suppress(ConfigurationError, LogbookError, PartError):
            pictures = self.pictures("bars", heading, asked, "first")
        return [group("beside", told, *pictures), *self.table(first)]

    def pictures(self, name: str, caption: str, asked: PlotRequest, prefix: str) -> list[Markup]:
        """The figures of a kind; `prefix` makes their ids unique on the page."""
        made = enumerate(drawings_of(name)(self.results, asked))
        return [picture(drawing.figure, caption, f"{prefix}{k}-") for k, drawing in made]

    def choices(self) -> list[tuple[str, str]]:
        """Every choice with its levels, those with several first; many seeds are a range."""
        choices = {name: ordered(run.levels[name] for run in self.runs) for name in GROUPS}
        varied = sorted(choices, key=lambda name: len(choices[name]) == 1)
        seeds = ordered(run.levels["seed"] for run in self.runs)
        text = (
            f"{len(seeds)} seeds, {seeds[0]} to {seeds[-1]}" if len(seeds) > 5 else ", ".join(seeds)
        )
        return [*((name, ", ".join(choices[name])) for name in varied), ("seed", text)]

    def table(self, one: Headline) -> list[Markup]:
        """A table and the command that makes it."""
        words = [*results_program().split(), *one.command]
        if self.request.database != DEFAULT_DATABASE:
            words += ["--database", self.request.database]
        return [html_table(in_words(one.table)), code(shlex.join(words))]

    def tables(self) -> list[Markup]:
        """The tables beside the first one, the sheets of manoeuvres, and what is not shown."""
        blocks = [
            folded(definition_of(one.metric).heading, *self.table(one), opened=one.shown)
            for one in self.found[1:]
        ]
        for run, recorded in newest_manoeuvres(self.results, self.runs):
            # a manoeuvre that was not carried out, such as one that is too short, has no sheet
            with suppress(RecordingError):
                result = measured_sheet(recorded.track, recorded.ordered)
                grid = grid_of_sheet(result, f"Run {run.id}", recorded.predicted)
                heading = f"Manoeuvre of {subtitle(run)}"
                blocks.append(folded(heading, html_table(grid), opened=True))
        blocks += [paragraph(f"Not shown: {text}", "refused") for text in self.refused]
        return blocks if blocks or self.found else [paragraph("None of these runs has a metric.")]

    def figures(self) -> list[Markup]:
        """Every figure that the runs have data for, but the bars that are at the top."""
        first = self.found[0].metric if self.found else ""
        pictures, refused = list[Markup](), list[Markup]()
        with drawn():
            for n, (name, caption, asked) in enumerate(self.asked(first)):
                try:
                    pictures += self.pictures(name, caption, asked, f"f{n}-")
                except (TooDifferentError, LogbookError, PartError) as error:
                    refused.append(paragraph(f"Not drawn: {caption}: {error}", "wide"))
                except ConfigurationError:
                    continue  # these runs have no data for this figure
        none = paragraph("None of these runs has data for a figure.")
        return [group("figures", *(pictures + refused or [none]))]

    def asked(self, first: str) -> Iterator[tuple[str, str, PlotRequest]]:
        """The figures of a report, with captions and requests; not of the metric at the top."""
        for figure in sorted(figures().values(), key=lambda figure: figure.place):
            for rows in figure.report_rows or (figure.rows or self.request.rows,):
                asked = replace(self.shared, rows=rows)
                if figure.of_metrics:
                    for one in METRICS:
                        if one.headline and one.name != first:
                            yield figure.name, one.heading, replace(asked, metric=one.name)
                elif figure.caption:
                    yield figure.name, figure.caption, asked

    def warnings(self) -> list[Markup]:
        """The warnings with the numbers of their runs."""
        messages = []
        for text, ids in self.results.warnings(self.condition)[:MOST_LISTED]:
            runs = ", ".join(map(str, ids[:10])) + (", …" if len(ids) > 10 else "")
            messages.append(f"{text} (run{'s'[: len(ids) != 1]} {runs})")
        return [bullets(messages)] if messages else []

    def failures(self) -> list[Markup]:
        """The runs that failed, with their errors and tracebacks."""
        blocks = []
        for run_id in [run.id for run in self.runs if run.status in LOST][:MOST_LISTED]:
            run = self.results.reader.run(run_id)
            one = run.summary
            text = f" run {one.run_id}: {one.identifier}, {one.disturbance}, seed {one.seed}: "
            summary = status(one.status, one.status) + text + (one.error or "no message")
            trace = code(run.traceback or "no traceback")
            blocks.append(folded(summary, paragraph(one.error_type or ""), trace))
        return blocks or [paragraph("None.")]

    def configuration(self) -> list[Markup]:
        """The sweeps with their commands, and a table of all settings."""
        ids, blocks = {run.sweep for run in self.runs}, list[Markup]()
        for sweep in (one for one in self.results.reader.sweeps() if one.id in ids):
            end, begin = sweep.finished_at, f"{sweep.started_at:%Y-%m-%d %H:%M} UTC"
            until = f"to {end:%Y-%m-%d %H:%M}" if end else ", not finished"
            words = [f"{sweep.planned} trials planned; {begin} {until}, on {sweep.host}"]
            words += [f"tags: {', '.join(sweep.tags)}"] if sweep.tags else []
            words += [sweep.note] if sweep.note else []
            blocks.append(Markup("<h3>Sweep {}: {}</h3>").format(sweep.id, sweep.name))
            blocks += [paragraph("; ".join(words), "small"), code(sweep.command)]
        newest = {tuple(run.levels[name] for name in GROUPS): run.id for run in self.runs}
        configs = self.results.configs_of(sorted(newest.values())[-MOST_LISTED:]).values()
        rows = []
        for key in dict.fromkeys(key for config in configs for key in config if key != "seed"):
            values = dict.fromkeys(str(config[key]) for config in configs if key in config)
            rows.append([key, one_line(", ".join(values), 200)])
        settings = html_table(grid_of("", ("key", "value"), rows, labels=2))
        return [*blocks, folded("All settings", settings)]

    def listed(self) -> TextTable:
        """The newest runs, without columns that are empty or at the top of the page."""
        chosen = [run.id for run in self.runs][-MOST_LISTED:]
        summaries = self.results.reader.runs(RunTable.id.in_(chosen), newest_first=True)
        alone = [name for name in GROUPS if len({run.levels[name] for run in self.runs}) == 1]
        left_out = len(self.runs) > MOST_LISTED
        notes = [f"the newest {MOST_LISTED} of {len(self.runs)}"] if left_out else []
        without = ("superseded", "error", *alone)
        return in_words(run_table(self.results, summaries, notes=notes, without=without))

    def provenance(self) -> list[tuple[str, Markup]]:
        """Each property of provenance with its distinct values, the most frequent first."""
        counts_of = defaultdict[str, Counter[str]](Counter)
        for row in self.results.provenance(self.condition):
            dirty = " with uncommitted changes" if row.git_dirty else ""
            properties = {"git commit": f"{row.git_commit or 'unknown'}{dirty}", "host": row.host}
            for name, value in (properties | row.versions | {"command": row.command}).items():
                counts_of[name][str(value or "")] += 1
        told = []
        for name, counts in counts_of.items():
            values = [value for value, _ in counts.most_common(20) if value]
            code_of = Markup(", ").join(Markup("<code>{}</code>").format(each) for each in values)
            told += [(name, code_of)] if values else []
        return told
