"""The page of the benchmark: tables, free runs over every test file, failures, and licences."""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from markupsafe import Markup

from seatrial.runner.compare.benchmark.boards import Board, overall
from seatrial.runner.compare.benchmark.entries import REFERENCES, BenchmarkRun
from seatrial.runner.compare.benchmark.manoeuvre_scores import pieces
from seatrial.runner.compare.benchmark.task import Case, Located, located
from seatrial.runner.compare.formats import html_table
from seatrial.runner.compare.frame import FINISHED, Queries
from seatrial.runner.compare.grid import Scalar, TextTable, grid_of, one_line
from seatrial.runner.compare.leaderboard import leaderboard, manoeuvre_grids, summary
from seatrial.runner.compare.page import Picture, picture, render_page, write_page
from seatrial.runner.compare.plots.critical_difference import chart
from seatrial.runner.compare.plots.free_runs import Runs, colours_of, part_of, tracks, velocities
from seatrial.runner.compare.plots.style import drawn
from seatrial.runner.export.manoeuvre_tracks import length_of
from seatrial.runner.invocation import results_program, trial_program

FIRST = 3  # entrants on the figures of free runs, beside `none`


@dataclass(frozen=True)
class TaskChapter:
    """One task on the page; `lacking` are files that are not there."""

    name: str
    title: str
    tables: Sequence[Markup]
    ranks: Sequence[Picture]
    pictures: Sequence[Picture]
    lacking: Sequence[Located]


def write_benchmark(results: Queries, boards: Sequence[Board], file: Path) -> None:
    """Write the page; raises LogbookError if the file cannot be written."""
    with drawn():
        chapters = [_chapter(results, board) for board in boards]
        ranks = []
        for i, (group, every) in enumerate(overall(boards)):
            if every.ranks is not None:
                titles = "; ".join(board.task.title for board in group)
                shown = picture(chart(titles, every), f"Mean ranks over {titles}", f"all-{i}-")
                ranks.append(shown)
    own = [entry for board in boards for entry in _own(board)]
    page = render_page(
        "benchmark.html",
        title="Benchmark of identifiers on measured and simulated vessels",
        database=str(results.reader.address),
        runs=len(own),
        minutes=sum(entry.duration_s for entry in own) / 60.0,
        summary=html_table(summary(boards)),
        ranks=ranks,
        chapters=chapters,
        failures=html_table(failures(boards)),
        data=[(board, located(board.task)) for board in boards],
        program=trial_program(),
        tables=results_program(),
    )
    write_page(page, file)


def _own(board: Board) -> list[BenchmarkRun]:
    return [entry for entry in board.entries if entry.cell.entrant not in REFERENCES]


def _chapter(results: Queries, board: Board) -> TaskChapter:
    ranks = []
    if board.ranked.ranks is not None:
        caption = f"{board.task.title}: mean ranks"
        ranks = [picture(chart(board.task.title, board.ranked), caption, f"{board.name}-ranks-")]
    grids = [leaderboard(board), *manoeuvre_grids(board)]
    lacking = [file for file in located(board.task) if file.state != "found"]
    tables = [html_table(grid) for grid in grids]
    pictures = list(_free_runs(results, board))
    return TaskChapter(board.name, board.task.title, tables, ranks, pictures, lacking)


def _free_runs(results: Queries, board: Board) -> Iterator[Picture]:
    """Yield the figures of every test file, of the first entrants and `none`."""
    names = [*board.leaders(FIRST), "none"]
    colours = colours_of(names)
    for label, case in board.task.cases.items():
        chosen = [
            entry
            for name in names
            for entry in board.of(name)
            if entry.cell.case == label and entry.cell.seed == 0 and entry.status == FINISHED
        ]
        if not chosen:
            continue
        length = length_of(results.reader.run(chosen[0].run).config)
        whole = {e.cell.entrant: results.reader.series(e.run, "prediction") for e in chosen}
        for k, (title, runs) in enumerate(_by_file(label, case, whole)):
            prefix = f"{board.name}-{label}-{k}-"
            shown = velocities(title, runs, colours, board.task.outputs)
            yield picture(shown, f"{title}: free run from the first measured state", prefix)
            plane = tracks(title, runs, colours, length)
            if plane is not None:
                yield picture(plane, f"{title}: tracks of the free runs", f"{prefix}track-")


def _by_file(label: str, case: Case, runs: Runs) -> Iterator[tuple[str, Runs]]:
    """Yield the runs over each test file, where the pieces of the series are the files."""
    ends = list(pieces(next(iter(runs.values()))))
    if len(ends) != len(case.test) or len(ends) == 1:
        yield label, runs
        return
    for path, (first, last) in zip(case.test, ends, strict=True):
        part = slice(first, last)
        yield f"{label}, {Path(path).name}", {k: part_of(v, part) for k, v in runs.items()}


def failures(boards: Sequence[Board]) -> TextTable:
    """Return what failed, and what cannot predict or diverges, counted over the seeds."""
    lost: dict[tuple[str, ...], list[BenchmarkRun]] = defaultdict(list)
    for board in boards:
        for entry in _own(board):
            if entry.loss == float("inf"):
                cell, what = entry.cell, entry.error or "its free run diverges, or there is none"
                key = (cell.task, cell.entrant, cell.case, entry.status, one_line(what, 200))
                lost[key].append(entry)
    rows: list[list[Scalar]] = [[*key, len(of), min(e.run for e in of)] for key, of in lost.items()]
    headers = ("task", "entrant", "case", "status", "what", "trials", "first run")
    return grid_of("", headers, rows, labels=5)
