"""The page of the benchmark: tables, free runs over every test file, failures, and licences."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
from markupsafe import Markup

from seatrial.runner.compare import page as pages
from seatrial.runner.compare.benchmark import REFERENCES, located
from seatrial.runner.compare.frame import FINISHED, Queries
from seatrial.runner.compare.grid import Scalar, TextTable, grid_of, one_line
from seatrial.runner.compare.leaderboard import Board, leaderboard, overall, summary
from seatrial.runner.compare.page import Section, code, group, html_table, paragraph, picture
from seatrial.runner.compare.plots.critical_difference import chart
from seatrial.runner.compare.plots.prediction import free_runs
from seatrial.runner.compare.plots.style import drawn
from seatrial.runner.configuration.invocation import results_program, trial_program
from seatrial.runner.record.rows import Series

FIRST = 3  # entrants on the figures of free runs, beside `none`
ABOUT = (
    "Each entrant identifies a model from the training files of a task. The model then predicts the"
    " test files from their first measured state, without further measurements (free run)."
    " FIT = 100 (1 - RMS error / standard deviation of the measured output) %: 100 % is perfect,"
    " 0 % is as good as the mean of the measured motion."
)
LOST = "Trials that failed, and models that cannot predict or diverge: they rank behind all others."
ENTRANT = (
    "An entrant is an option of the group identifier: a YAML file in the folder conf/identifier of"
    " your working folder that names a class, or a program in any language that reads a recording"
    " and writes coefficients. With conf/identifier/mine.yaml, the first of these commands runs the"
    " cells of mine that are not in the logbook, in all tasks; the second makes this page again."
    " An entrant with options of its own, or a task, is a file of conf/benchmark like the others."
)


def write_benchmark(results: Queries, boards: Sequence[Board], file: Path) -> None:
    """Write the page; raises LogbookError if the file cannot be written."""
    own, trials = pd.concat([board.entries for board in boards]), trial_program()
    own = own[~own["entrant"].isin(REFERENCES)]
    lead = f"From {results.reader.address}: {len(own)} trials."
    first = [paragraph(ABOUT), html_table(summary(boards))]
    chapters, sources = list[Section](), list[Markup]()
    with drawn():
        for i, (members, ranks) in enumerate(overall(boards)):
            titles = "; ".join(board.task.title for board in members)
            if len(ranks):
                figure = chart(titles, ranks)
                first.append(picture(figure, f"Mean ranks over {titles}", f"all-{i}-"))
        for board in boards:
            task = board.task
            blocks = [code(f"{trials} benchmark --task {task.name}")]
            for each in located(task):
                if each.state != "found":
                    told = f"{each.name} is {each.state}: its cases are left out; {trials} data get"
                    blocks.append(paragraph(f"{told} {task.name}", "small"))
            none = paragraph("No trial has been run.", "small")
            blocks.append(none if board.entries.empty else html_table(leaderboard(board)))
            if len(board.ranked):
                figure = chart(task.title, board.ranked)
                blocks.append(picture(figure, f"{task.title}: mean ranks", f"{task.name}-ranks-"))
            blocks.append(group("figures", *_free_runs(results, board)))
            chapters.append(Section(task.title, task.name, blocks))
            if not task.source:  # simulated: there is nothing to get
                continue
            sources.append(Markup("<h3>{}</h3>").format(task.title))
            facts, url = dict[str, str | Markup](task.source), task.source.get("url", "")
            facts["url"] = pages.link(url, url) if url.startswith("https://") else "–"
            sources[-1] += pages.facts([*facts.items()])
    commands = [
        f"{trials} benchmark --entrant mine",
        f"{results_program()} leaderboard --entrant mine --page results/benchmark/index.html",
    ]
    sections = [
        Section("Summary", "summary", first),
        *chapters,
        Section("Failures", "failures", [paragraph(LOST), html_table(failures(own))]),
        Section("Data and licences", "data", sources),
        Section("Add an entrant", "entrants", [paragraph(ENTRANT), code("\n".join(commands))]),
    ]
    title = "Benchmark of identifiers on measured and simulated vessels"
    pages.write_page(pages.page(title, [paragraph(lead, "small")], sections), file)


def _free_runs(results: Queries, board: Board) -> Iterator[Markup]:
    """Yield the figures of every test file, of the first entrants and `none`."""
    names = [*[name for name in board.contest if name != "none"][:FIRST], "none"]
    for label, case in board.task.cases.items():
        entries = board.entries[board.entries["status"] == FINISHED]
        entries = entries[(entries["case"] == label) & (entries["seed"] == 0)]
        runs = dict(zip(entries["entrant"], entries["run"], strict=True))
        read = results.reader.series
        whole = {name: read(runs[name], "prediction") for name in names if name in runs}
        if not whole:
            continue
        first = next(iter(whole.values())).columns
        ends = [*pairwise([*np.flatnonzero(first["start"]), len(first["t"])])]
        titles = [f"{label}, {Path(path).name}" for path in case.test]
        if len(titles) != len(ends) or len(ends) == 1:  # the pieces are not the files
            ends, titles = [(0, len(first["t"]))], [label]
        for k, (title, (a, b)) in enumerate(zip(titles, ends, strict=True)):
            parts = dict[str, Series]()
            for name, one in whole.items():
                columns = {key: values[a:b] for key, values in one.columns.items()}
                parts[name] = Series(one.kind, columns, one.units)
            shown, told = free_runs(title, parts, board.task.outputs), f"{title}: free run"
            prefix = f"{board.task.name}-{label}-{k}-"
            yield picture(shown, f"{told} from the first measured state", prefix)


def failures(own: pd.DataFrame) -> TextTable:
    """Return what failed, and what cannot predict or diverges, counted over the seeds."""
    lost = own[own["loss"] == float("inf")]
    what = lost["error"].fillna("its free run diverges, or there is none")
    lost = lost.assign(what=[one_line(text, 200) for text in what])
    headers = ["task", "entrant", "case", "status", "what"]
    groups = lost.groupby(headers, sort=False)["run"]
    rows: list[list[Scalar]] = [[*key, len(runs), min(runs)] for key, runs in groups]
    return grid_of("", [*headers, "trials", "first run"], rows, labels=5)
