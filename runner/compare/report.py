"""The page on a set of runs: the answer, a figure and its table; then the rest, provenance last."""

import re
import shlex
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace

from markupsafe import Markup

from seatrial.models.errors import ConfigurationError, LogbookError, PartError, RecordingError
from seatrial.runner.compare import page as pages
from seatrial.runner.compare.cli import TableOptions
from seatrial.runner.compare.comparability import TooDifferentError
from seatrial.runner.compare.figures import PlotRequest, axes_of, drawings, figures
from seatrial.runner.compare.frame import NOT_APPLICABLE, Queries, ordered
from seatrial.runner.compare.grid import TextTable, grid_of, number_text, one_line, unit_text
from seatrial.runner.compare.manoeuvre_comparison import newest_manoeuvres, sheet_of
from seatrial.runner.compare.page import Section, code, folded, group, html_table, paragraph
from seatrial.runner.compare.plots.selection import subtitle
from seatrial.runner.compare.plots.style import drawn
from seatrial.runner.compare.runs import run_table
from seatrial.runner.compare.statistics import COUNTS, EQUAL
from seatrial.runner.compare.table import comparison
from seatrial.runner.configuration.invocation import DEFAULT_DATABASE, results_program
from seatrial.runner.database.tables import RunRow as RunTable
from seatrial.runner.record.catalogue import METRICS, all_declared, definition_of
from seatrial.runner.record.vocabulary import GROUPS, LOST

HEIGHT = 2.7  # of the first figure: the table below it is on the first screen [inch]
MOST_LISTED, MOST_TOLD = 500, 4  # runs and failures on the page; lines above the first table
# The metrics that have a table, and whether the table is unfolded at first.
TABLES = {
    "e_pos_mae": True, "e_psi_mae": True, "contacts": True, "smallest_clearance": True,
    "time_to_berth": True, "final_position_error": True, "velocity_rmse_free_run": True,
    "force_mse": True, "force_mse_filtered": False, "velocity_rmse_one_step": False,
    "coefficient_error": False, "error_mae": False, "steady_state_error": False,
    "tau_mean_abs": False, "power_mean": False, "iaew": False,
}  # fmt: skip
REASONS = {why: column for why, column in COUNTS.items() if why != NOT_APPLICABLE}
WORDS = {
    **{"dof": "axis", "run_id": "run", "started_at": "started", "duration_s": "duration [s]"},
    **{"std_error": "standard error", "true_value": "true value", "n_rows": "rows"},
    "below_true_model": "below the true model",
}


def render_report(
    results: Queries, options: TableOptions, database: str = DEFAULT_DATABASE,
    title: str | None = None, links: Mapping[str, str] | None = None, figures: bool = True,
) -> str:  # fmt: skip
    """Return the page as text; raises ConfigurationError if no run matches.

    `options` select runs, rows and columns; `database` is as the user wrote it, for the commands on
    the page. The site's pages have links to the others, and without `figures` the first one alone.
    """
    report = _Report(results, options, database)
    parts = {
        "Result": report.result(), "Tables": report.tables(),
        "Figures": report.figures() if figures else [], "Warnings": report.warnings(),
        "Failures": report.failures(), "Configuration": report.configuration(),
        "Runs": [folded("All runs", html_table(report.listed()))],
        "Provenance": [pages.facts(report.provenance())],
    }  # fmt: skip
    sections = [Section(title, title.lower(), own) for title, own in parts.items() if own]
    title = title or (f"Sea trials, {report.scope}" if report.scope else "Sea trials")
    return pages.page(title, report.lead(), sections, links)


class _Report:
    """The parts of the page; `found` are its tables by metric, of which the first is at the top.

    The baseline is the level `none` of the rows, if any; `refused` says what differs in too much.
    """

    def __init__(self, results: Queries, options: TableOptions, database: str) -> None:
        self.results, self.options = results, options
        self.condition, self.scope = results.selected(options.where, options.sweep)
        self.runs = results.runs(self.condition)
        rows, columns = axes_of(options.rows, options.columns)
        varied = [name for name in GROUPS if len({run.levels[name] for run in self.runs}) > 1]
        if options.columns is None and columns not in varied:
            columns = next((name for name in varied if name not in rows.split(",")), columns)
        self.rows, self.columns = rows, columns
        self.shared = PlotRequest("bars", rows=rows, columns=columns)
        self.shared = replace(self.shared, where=options.where, sweep=options.sweep)
        levels = {run.levels.get(rows) for run in self.runs}
        self.baseline = [f"{rows}=none"] if "none" in levels and len(levels) > 1 else []
        words = {"--rows": rows, "--columns": columns, "--baseline": ",".join(self.baseline)}
        words |= {"--where": options.where or "", "--sweep": options.sweep or ""}
        self.words = [word for pair in words.items() if pair[1] for word in pair]
        self.words += words_of(database)
        self.found, self.refused = dict[str, TextTable](), list[str]()
        stored = results.metric_names()
        for metric in (name for name in TABLES if name in stored):
            asked = replace(options, columns=columns, metric=[metric], baseline=self.baseline)
            try:
                table = comparison(results, asked)
            except ConfigurationError as error:
                self.refused.append(f"{definition_of(metric).heading}: {error}")
                continue
            if any(cell.sort is not None for row in table.rows for cell in row):
                self.found[metric] = table
        self.first = next(iter(self.found), "")

    def lead(self) -> Iterator[Markup]:
        """What the runs say, above all: the best rows, and how many there are and failed."""
        told = [*self.answers()]
        rest = folded(f"{len(told[MOST_TOLD:])} more", pages.bullets(told[MOST_TOLD:]))
        yield group("answer", pages.bullets(told[:MOST_TOLD]), *[rest][: len(told) > MOST_TOLD])
        statuses = self.results.trials(self.condition, planned=True)["status"]
        counts = sorted(Counter(statuses).items())
        pills = Markup(" ").join(pages.status(name, f"{number} {name}") for name, number in counts)
        only = f", only {self.options.where}" if self.options.where else ""
        yield Markup("<p>Trials ({}{}): {}</p>").format(sum(n for _, n in counts), only, pills)

    def answers(self) -> Iterator[str]:
        """Say which row is best under each condition, by how much, and which lost trials."""
        if not self.first:
            return
        table, label, lost = self.found[self.first], definition_of(self.first).label, list[str]()
        other = {*table.headers, self.columns} - {self.rows, "unit", "metric"}
        for record in table.as_records():
            value, ratio, pairs = (record.get(name) for name in ("mean", "ratio", "pairs"))
            place = ", ".join(str(record[n]) for n in record if n in other) or "all runs"
            if why := [f"{record[of]} {w}" for w, of in REASONS.items() if record.get(of)]:
                lost.append(f"{place}: {record[self.rows]} is not compared: {', '.join(why)}.")
            if record["best"] and isinstance(value, float):
                size = f"{number_text(value, 3)} {unit_text(str(record['unit']))}".rstrip()
                text = f"{record[self.rows]} has a {label[0].lower()}{label[1:]} of {size}"
                if isinstance(ratio, float) and isinstance(pairs, int) and pairs:
                    less = 0.0 < ratio < 1.0 - EQUAL
                    told = f"{number_text(1.0 / ratio, 2)} times" if less else "no"
                    won = f"{record['wins']} of {pairs + int(record['lost_pairs'] or 0)}"
                    text += f", {told} less than none, better in {won} pairs"
                yield f"{place}: {text}."
        yield from lost

    def result(self) -> list[Markup]:
        """What was compared and under which conditions; the first figure; the first table."""
        lost = sum(run.status in LOST for run in self.runs)
        failed = f"{lost} of {len(self.runs)} runs, listed under Failures" if lost else "none"
        baseline = f"{self.rows} none" if self.found and self.baseline else "none is named"
        named = [("baseline", baseline), ("failures", failed)]
        told, made = pages.facts([*self.choices(), *named]), list[Markup]()
        if not self.first:
            return [group("beside", told)]
        heading, asked = definition_of(self.first).heading, replace(self.shared, metric=self.first)
        with drawn(), suppress(ConfigurationError, LogbookError, PartError):
            made = self.pictures(heading, asked, "first", figheight=HEIGHT)
        first = group("beside", told, *made[:1])  # other conditions have figures of their own
        return [first, *self.table(self.first), group("figures", *made[1:])]

    def pictures(
        self, caption: str, asked: PlotRequest, prefix: str, **size: float
    ) -> list[Markup]:
        """The figures of a request; `prefix` makes their ids unique on the page."""
        made = enumerate(drawings(self.results, asked))
        return [pages.picture(each.figure, caption, f"{prefix}{k}-", **size) for k, each in made]

    def choices(self) -> list[tuple[str, str]]:
        """Every choice with its levels, those with several first; many seeds are a range."""
        trials = self.results.trials(self.condition, planned=True)
        choices = {name: ordered(trials[name]) for name in GROUPS}
        varied = sorted(choices, key=lambda name: len(choices[name]) == 1)
        seeds = ordered(trials["seed"])
        many = f"{len(seeds)} seeds, {seeds[0]} to {seeds[-1]}"
        text = many if len(seeds) > 5 else ", ".join(seeds)
        return [*((name, ", ".join(choices[name])) for name in varied), ("seed", text)]

    def table(self, metric: str) -> list[Markup]:
        """The table of a metric with the command that makes it."""
        command = [*results_program().split(), "table", "--metric", metric, *self.words]
        return [html_table(in_words(self.found[metric])), code(shlex.join(command))]

    def tables(self) -> list[Markup]:
        """The tables beside the first one, the sheets of manoeuvres, and what is not shown."""
        blocks = [
            folded(definition_of(metric).heading, *self.table(metric), opened=TABLES[metric])
            for metric in [*self.found][1:]
        ]
        for run, recorded in newest_manoeuvres(self.results, self.runs):
            # a manoeuvre that was not carried out, such as one that is too short, has no sheet
            with suppress(RecordingError):
                sheet = html_table(sheet_of(recorded, f"Run {run.id}"))
                blocks.append(folded(f"Manoeuvre of {subtitle(run)}", sheet, opened=True))
        blocks += [paragraph(f"Not shown: {text}", "refused") for text in self.refused]
        return blocks if blocks or self.found else [paragraph("None of these runs has a metric.")]

    def figures(self) -> list[Markup]:
        """Every figure that the runs have data for, but the bars that are at the top."""
        pictures, refused = list[Markup](), list[Markup]()
        with drawn():
            for n, (caption, asked) in enumerate(self.asked()):
                try:
                    pictures += self.pictures(caption, asked, f"f{n}-")
                except (TooDifferentError, LogbookError, PartError) as error:
                    refused.append(paragraph(f"Not drawn: {caption}: {error}", "wide"))
                except ConfigurationError:
                    continue  # these runs have no data for this figure
        none = paragraph("None of these runs has data for a figure.")
        return [group("figures", *(pictures + refused or [none]))]

    def asked(self) -> Iterator[tuple[str, PlotRequest]]:
        """The figures of a report, with captions and requests; not of the metric at the top."""
        shown = [figure for figure in figures().values() if figure.place]
        for figure in sorted(shown, key=lambda figure: figure.place):
            for rows in figure.report_rows or (figure.rows or self.rows,):
                asked = replace(self.shared, kind=figure.name, rows=rows)
                if "metric" not in figure.options:
                    yield figure.help, asked
                    continue
                for one in METRICS:
                    if one.headline and one.name != self.first:
                        yield one.heading, replace(asked, metric=one.name)

    def warnings(self) -> list[Markup]:
        """The warnings with the numbers of their runs."""
        messages = []
        for text, ids in self.results.warnings(self.condition)[:MOST_LISTED]:
            runs = ", ".join(map(str, ids[:10])) + (", …" if len(ids) > 10 else "")
            messages.append(f"{text} (run{'s'[: len(ids) != 1]} {runs})")
        return [pages.bullets(messages)] if messages else []

    def failures(self) -> list[Markup]:
        """The runs that failed, with their errors and tracebacks."""
        blocks = []
        for run_id in [run.id for run in self.runs if run.status in LOST][:MOST_LISTED]:
            run = self.results.reader.run(run_id)
            one = run.summary
            text = f" run {one.run_id}: {one.identifier}, {one.disturbance}, seed {one.seed}: "
            summary = pages.status(one.status, one.status) + text + (one.error or "no message")
            trace = code(run.traceback or "no traceback")
            blocks.append(folded(summary, paragraph(one.error_type or ""), trace))
        return blocks or [paragraph("None.")]

    def configuration(self) -> list[Markup]:
        """The sweeps with their commands, and a table of all settings."""
        ids, blocks = {run.sweep for run in self.runs}, list[Markup]()
        for sweep in (one for one in self.results.reader.sweeps() if one.id in ids):
            begin = f"{sweep.started_at:%Y-%m-%d %H:%M} UTC, on {sweep.host}"
            words = [f"{sweep.planned} trials planned", begin]
            words += [f"tags: {', '.join(sweep.tags)}"] if sweep.tags else []
            words += [sweep.note or ""]
            blocks.append(Markup("<h3>Sweep {}: {}</h3>").format(sweep.id, sweep.name))
            blocks += [paragraph("; ".join(filter(None, words)), "small"), code(sweep.command)]
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
        notes = [f"the newest {MOST_LISTED} of {n}"] if (n := len(self.runs)) > MOST_LISTED else []
        without = ("superseded", "error", *alone)
        return in_words(run_table(self.results, summaries, notes=notes, without=without))

    def provenance(self) -> list[tuple[str, Markup]]:
        """Each property of provenance with its distinct values, the most frequent first."""
        counts_of = defaultdict[str, Counter[str]](Counter)
        for row in self.results.provenance(self.condition):
            dirty = " with uncommitted changes" if row.git_dirty else ""
            properties = {"git commit": f"{row.git_commit or 'unknown'}{dirty}", "host": row.host}
            for name, value in (properties | row.versions | {"command": row.command}).items():
                counts_of[name].update([str(value)] if value else [])
        told = [("logbook", Markup("<code>{}</code>").format(self.results.reader.address))]
        for name, counts in counts_of.items():
            values = (Markup("<code>{}</code>").format(text) for text, _ in counts.most_common(20))
            told += [(name, Markup(", ").join(values))] if counts else []
        return told


def words_of(database: str) -> list[str]:
    """Return the words that name a logbook in a command; none for the one by default."""
    return [] if database == DEFAULT_DATABASE else ["--database", database]


def in_words(grid: TextTable) -> TextTable:
    """Return a table with the labels of metrics, and words for columns, instead of their keys."""
    labels = {definition.name: definition.label for definition in all_declared()}
    title, *notes = (
        re.sub(r"\b[a-z]\w*_\w+\b", lambda name: labels.get(name[0], name[0]), text)
        for text in (grid.title, *grid.notes)
    )
    headers = [WORDS.get(header, header) for header in grid.headers]
    return replace(grid, title=title, headers=headers, notes=notes)
