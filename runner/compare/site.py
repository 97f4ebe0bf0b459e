"""The site: a folder of pages that opens from disk and from any web server.

`index.html` is the page of the newest sweep. Every sweep has one, so have all runs together, and
the newest runs, with their numbers and figures. `runs.html` filters, sorts and overlays runs. A
page that is opened from disk may not fetch files, but it may load scripts: they hold its data.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import sqlalchemy as sa
from markupsafe import Markup

from seatrial.models.errors import ConfigurationError, LogbookError
from seatrial.runner.compare.benchmark import half_width
from seatrial.runner.compare.cli import TableOptions
from seatrial.runner.compare.frame import RUN, Queries, StoredRun, ordered
from seatrial.runner.compare.grid import number_text, with_unit
from seatrial.runner.compare.page import Section, bullets, code, html_table, link, page, paragraph
from seatrial.runner.compare.plots.selection import PREFIX, subtitle
from seatrial.runner.compare.plots.tracking_errors import ERRORS
from seatrial.runner.compare.report import TABLES, in_words, render_report, words_of
from seatrial.runner.compare.runs import headline, run_details
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.compare.where import Condition
from seatrial.runner.configuration.invocation import results_program
from seatrial.runner.database.terminal import visible
from seatrial.runner.record.catalogue import definition_of
from seatrial.runner.record.rows import Series
from seatrial.runner.record.vocabulary import DOFS, GROUPS, IDENTIFIED_STD, SAILED

INDEX, RUNS = "index.html", "runs.html"
MARK = '<meta name="generator" content="seatrial-results">'
MOST_SWEEPS, MOST_FILTERS = 50, 30  # newest sweeps with a page; keys of the configuration
STRETCHES = 300  # of which a line keeps the lowest and the highest sample
DIGITS = 5  # significant
ORDER = {"prediction": 1, "residual": 2, "recording": 3}  # of the figures; those of a mission first
PROGRAMS = ("elements.js", "plot.js")
PLOTS = Markup('<div class="figures" id="plots"></div>')
Json = dict[str, Any]


def write_site(results: Queries, folder: Path, database: str, opened: int) -> Path:
    """Write the site and return its first page.

    `folder` is new, empty, or holds a site; `database` is the address as the user wrote it; the
    newest `opened` runs have a page. Raises LogbookError if it cannot be written.
    """
    try:
        index = folder / INDEX
        own = index.is_file() and MARK in index.read_text(encoding="utf-8", errors="replace")
        if not own and folder.exists() and any(folder.iterdir()):
            raise LogbookError(f"{folder}: got a folder with files, expected a new or empty one")
        for old in (*folder.glob("*.html"), *folder.glob("data/*.js")):
            old.unlink()
        for name, text in _files(results, database, opened):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(visible(text), encoding="utf-8")
    except (OSError, ValueError) as error:  # a name that is not in UTF-8 is a ValueError
        raise LogbookError(f"{folder}: cannot write the site: {error}") from error
    return folder / INDEX


def _files(results: Queries, database: str, opened: int) -> Iterator[tuple[str, str]]:
    """Yield the name and the text of every file."""
    ((number,),) = results.reader.select(sa.select(sa.func.count()).select_from(RUN))
    if not number:
        yield INDEX, page("Sea trials", [paragraph("No runs in the logbook yet.")], [])
        return
    runs = results.runs()
    links = {INDEX: "Newest sweep", "sweep-all.html": "All runs together", RUNS: "List of runs"}
    every = results.reader.sweeps()
    named = {f"sweep-{sweep.id}.html": f"Sweep {sweep.id}: {sweep.name}" for sweep in every}
    sweeps, made = [str(sweep.id) for sweep in every][-MOST_SWEEPS:], list[str]()
    for sweep in (*reversed(sweeps), "all"):
        options = TableOptions(sweep=sweep)
        with suppress(ConfigurationError):  # a sweep without a run
            text = render_report(results, options, database, links=links, figures=False)
            names = [f"sweep-{sweep}.html"] if made else [INDEX, f"sweep-{sweep}.html"]
            yield from ((name, text) for name in names)
            made += names
    whole = runs[::-1][:opened]
    blocks = [Markup('<div id="plots"></div><div id="list"></div>')]
    listed = [link(file, named[file]) for file in made if file in named]
    sections = [Section("Runs", "runs", blocks), Section("Sweeps", "sweeps", [bullets(listed)])]
    scripts, programs = ["data/runs.js"], [*PROGRAMS, "runs.js"]
    yield RUNS, page("Sea trials: the runs", [], sections, links, scripts, programs)
    yield "data/runs.js", script_of("runs", _runs(results, runs, whole, database))
    for run in whole:
        drawn, trouble = figures_of(results, run.id)
        trouble += [] if drawn or trouble else [f"{subtitle(run)}: {run.status}, without series"]
        content = {"label": subtitle(run), "figures": drawn, "trouble": trouble}
        yield f"data/run-{run.id}.js", script_of(f"run-{run.id}", content)
        yield f"run-{run.id}.html", _run_page(results, run, trouble, links, database)


def script_of(name: str, content: object) -> str:
    """Return a script in ASCII that holds `content` under a name.

    No text of the database can end the script or a string in it: `<` and all that is not ASCII are
    escaped. `content` may hold no NaN.
    """
    text = json.dumps(content, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return f"(window.seatrial ??= {{}})[{json.dumps(name)}] = {text};\n"


def _run_page(
    results: Queries, run: StoredRun, trouble: Sequence[str], links: Mapping[str, str],
    database: str,
) -> str:  # fmt: skip
    """The page of a run: its main numbers, its figures, all of it, and where it comes from."""
    first = headline(results, run.id)
    titles = {f"run {run.id}": "Provenance", first.title: "Result"}
    sections = list[Section]()
    for table in (first, *run_details(results, run.id)):
        title = titles.get(table.title, table.title.capitalize())
        shown = html_table(replace(in_words(table), title=""))
        sections.append(Section(title, title.lower(), [shown]))
    sections.sort(key=lambda section: section.title in ("Configuration", "Provenance"))
    refused = [paragraph(text, "refused") for text in trouble]
    sections.insert(1, Section("Figures", "figures", [*refused, PLOTS]))
    show = [*results_program().split(), "show", str(run.id), *words_of(database)]
    overlay = {f"{RUNS}#runs={run.id}": "Overlay with other runs"}
    title, lead = f"R{subtitle(run)[1:]}", [code(" ".join(show))]
    return page(title, lead, sections, {**links, **overlay}, [f"data/run-{run.id}.js"], PROGRAMS)


def _runs(
    results: Queries, runs: Sequence[StoredRun], whole: Sequence[StoredRun], database: str
) -> Json:
    """Return what the list needs: the runs in columns, their sweeps and metrics."""
    columns = sa.select(RUN.c.id, RUN.c.started_at, RUN.c.duration_s)
    rows = {row.id: row for row in results.reader.select(columns)}
    places, sweeps = {run.id: i for i, run in enumerate(runs)}, list[Json]()
    for sweep in results.reader.sweeps():
        chosen = sa.select(RUN.c.id).where(*results.clauses(Condition(sweeps=(sweep.id,))))
        members = sorted(places[i] for (i,) in results.reader.select(chosen) if i in places)
        sweeps.append({"id": sweep.id, "name": sweep.name, "runs": members})
    return {
        "program": results_program(),
        "database": words_of(database),
        "ids": [run.id for run in runs],
        "written": [run.id for run in whole],
        "factors": _factors(results),
        "measures": _measures(results, runs),
        "sweeps": sweeps,
        "started": [f"{rows[run.id].started_at:%Y-%m-%d %H:%M}" for run in runs],
        "duration": [_text(rows[run.id].duration_s) for run in runs],
    }


def _text(value: float | None) -> str | None:
    return None if value is None or not np.isfinite(value) else number_text(value)


def _factors(results: Queries) -> list[Json]:
    """Return choices, seed, status, code and varied keys of several levels; `codes` of the runs."""
    rows = results.reader.select(sa.select(RUN.c.overrides))
    words = dict.fromkeys(
        text.partition("=")[0].lstrip("+~") for row in rows for text in row.overrides
    )
    own = [*GROUPS, "seed", "status"]
    keys = [key for key in words if key in results.keys and key not in own][:MOST_FILTERS]
    trials, factors = results.trials(factors=keys), list[Json]()
    for name in (*own, *keys, "of_code"):
        texts = trials[name].astype(object).fillna("none").astype(str)
        if len(levels := ordered(texts)) > 1:
            factors.append({
                "name": name.removeprefix("of_"), "levels": levels, "shown": name in own,
                "codes": pd.Categorical(texts, levels).codes.tolist(),
            })  # fmt: skip
    return factors


def _measures(results: Queries, runs: Sequence[StoredRun]) -> list[Json]:
    """Return the metrics of the first tables, of the identified models, as texts."""
    ids, stored = [run.id for run in runs], set(results.metric_names())
    names = [name for name, shown in TABLES.items() if shown and name in stored]
    numbers = results.metrics(names, only={"model": ["identified"]})
    found = list[Json]()
    for (name, dof), rows in numbers.groupby(["metric", "dof"], observed=True, sort=False):
        values = rows.drop_duplicates("run", keep="last").set_index("run")["value"].reindex(ids)
        label = with_unit(f"{definition_of(name).label}, {dof}", rows["unit"].iloc[0])
        found.append({"metric": name, "label": label, "values": [*map(_text, values)]})
    return sorted(found, key=lambda measure: names.index(str(measure["metric"])))


def figures_of(results: Queries, run_id: int) -> tuple[Json, list[str]]:
    """Return the lines of a run's figures by key, and the series that cannot be read.

    The lines of a key are one figure: track, errors, velocities with their band if there is one,
    force residuals, track of the recording.
    """
    figures, trouble = dict[str, dict[str, Any]](), list[str]()
    files = results.reader.series_files(run_id)
    for file in sorted(files, key=lambda file: ORDER.get(file.kind, 0)):
        try:
            series = results.reader.series(run_id, file.kind)
        except LogbookError as error:
            trouble.append(str(error))
            continue
        for key, title, (x, y), line in _lines(series):
            figure = {"title": title, "x": x, "y": y, "equal": key.endswith("track"), "lines": []}
            lines = figures.setdefault(key, figure)["lines"]
            lines += [] if line["name"] in [each["name"] for each in lines] else [line]
    return figures, trouble


def _lines(series: Series) -> Iterator[tuple[str, str, tuple[str, str], Json]]:
    """Yield key, title, labels of the axes and the line of what a series has for the page."""
    columns = {name: np.asarray(v, dtype=np.float64) for name, v in series.columns.items()}
    t, model = columns.get("t", np.zeros(0)), series.kind.removeprefix(PREFIX)
    deployed, plane = model != series.kind, ("East [m]", "North [m]")
    if {"x", "y"} <= columns.keys() and (deployed or series.kind == "recording"):
        key, title = "track", "Track" if deployed else "Track of the recording"
        line = _plane(model if deployed else "measured", columns["y"], columns["x"])
        yield key if deployed else "recorded_track", title, plane, line
    if deployed and {"x_d", "y_d"} <= columns.keys():
        wanted = _plane("reference", columns["y_d"], columns["x_d"])
        yield "track", "Track", plane, wanted | {"dash": True}
    for name, (label, unit, size) in ERRORS.items() if deployed else ():
        if name in columns:
            axes = "Time [s]", f"{label} [{unit}]"
            yield name, f"{label} over time", axes, _over_time(model, t, columns[name] / size)
    for dof in DOFS if series.kind in ("prediction", "residual") else ():
        names, title = {f"residual_{m}_{dof}": m for m in SAILED}, f"Force residual, {dof}"
        if series.kind == "prediction":
            names = {dof: "measured"} | {f"{dof}_{model}": model for model in SAILED}
            banded = np.isfinite(columns.get(f"{dof}_{IDENTIFIED_STD}", np.zeros(0))).any()
            title = f"Free run, {dof}, {'with the' if banded else 'without a'} 90 % band"
        for name, of_model in names.items():
            if name in columns:
                band = columns.get(f"{dof}_{IDENTIFIED_STD}") if of_model == "identified" else None
                labels = "Time [s]", with_unit(dof, series.units.get(name))
                curve = _over_time(of_model, t, columns[name], band)
                yield f"{series.kind}-{dof}", title, labels, curve


def _plane(name: str, east: Sample, north: Sample) -> Json:
    """A line of the track, thinned."""
    rows = np.unique(np.linspace(0, len(east) - 1, 2 * STRETCHES).astype(int))
    return {"name": name, "x": _rounded(east[rows]), "y": _rounded(north[rows])}


def _over_time(name: str, t: Sample, values: Sample, deviation: Sample | None = None) -> Json:
    """A line over time, thinned, with the band of a normal distribution about it."""
    x, y = _thinned(t, values)
    line: Json = {"name": name, "x": x, "y": y}
    if deviation is not None and np.any(np.isfinite(values) & np.isfinite(deviation)):
        half = half_width(deviation)
        line["band"] = [[*_thinned(t, edge)] for edge in (values - half, values + half)]
    return line


def _thinned(t: Sample, values: Sample) -> tuple[list[float], list[float]]:
    """Return the finite samples of a line, of a long one the extremes of equal stretches."""
    finite = np.isfinite(values)
    t, values = t[finite], values[finite]
    if (n := len(t)) > 2 * STRETCHES:
        stretches = pd.Series(values).groupby(np.arange(n) * STRETCHES // n)
        kept = sorted({0, n - 1, *stretches.idxmin(), *stretches.idxmax()})
        t, values = t[kept], values[kept]
    return _rounded(t), _rounded(values)


def _rounded(values: Sample) -> list[float]:
    return [float(f"{value:.{DIGITS}g}") for value in values.tolist()]
