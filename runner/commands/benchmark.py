"""The command `seatrial benchmark`: runs the cells of the benchmark that are not in the logbook."""

import argparse
import shlex
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from time import perf_counter
from typing import Annotated

import typer

from seatrial.models.errors import SeatrialError
from seatrial.runner.compare.benchmark.cells import BenchmarkTrial, cells, entrants_of, lacking
from seatrial.runner.compare.benchmark.task import DATA_FOLDER, GROUP, VARIABLE, located, task_of
from seatrial.runner.configuration import search_path
from seatrial.runner.configuration.invocation import trial_program
from seatrial.runner.sweeps import in_process
from seatrial.runner.sweeps.console import terminal_view

RESULTS = Path("results/benchmark")


def main(words: Sequence[str]) -> int:
    """Run the cells; returns 0, or 1 if a trial failed or an entrant cannot take part."""
    options = _parser().parse_args(words)
    code, began = 0, perf_counter()
    for name in options.task or search_path.options(GROUP):
        task, began_task = task_of(name), perf_counter()
        for lack in lacking(task):
            files = ", ".join(f"{file.name} is {file.state}" for file in lack.files)
            print(f"{name}: {lack.case} is left out: {files}; see seatrial data get {name}")
        listed = cells(name, task, entrants_of(task, options.entrant or ()))
        for entrant, own in groupby(listed, key=lambda cell: cell.entrant):
            code = max(code, _run(f"{name}, {entrant}", list(own), options))
        print(f"{name}: {_time(began_task)}")
    print(f"benchmark: {_time(began)}")
    return code


def _time(began: float) -> str:
    """The time since an instant, as `12 min 3 s`."""
    minutes, seconds = divmod(round(perf_counter() - began), 60)
    return f"{minutes} min {seconds} s"


def get(task: Annotated[str, typer.Argument(help="A task of the benchmark.")]) -> None:
    """Say where the files of a task are, and how to get those that are missing or damaged."""
    known = task_of(task)
    files = located(known)
    for file in files:
        print(f"{file.state:8} {file.path}")
    if known.source is None:
        print(f"{task} is simulated: there is nothing to get")
        return
    source = known.source
    print(f"{source.name}\n{source.url}\nlicence: {source.licence}\n{source.get}")
    wrong = sum(file.state != "found" for file in files)
    if wrong:
        print(f"{wrong} of {len(files)} files to get; folders: ${VARIABLE}, then {DATA_FOLDER}")
        raise typer.Exit(1)


def _run(label: str, own: Sequence[BenchmarkTrial], options: argparse.Namespace) -> int:
    """Run the cells of one entrant in one task as a sweep."""
    words = [f"results_dir={options.results_dir}", f"sweep.name=benchmark_{own[0].task}"]
    words.append(f"hydra/launcher={options.launcher}")
    if options.dry_run:
        for cell in own:
            print(shlex.join([*trial_program().split(), *cell.options, *words[:2]]))
        return 0
    variants = [list(cell.options) for cell in own]
    shown = [word for variant in variants for word in ("--variant", shlex.join(variant))]
    call = in_process.Call(["-m", *words, *shown])
    call.variants, call.view = variants, terminal_view
    try:
        in_process.run_sweep(call, words)
    except SeatrialError as error:
        print(f"{label}: cannot take part: {error}")
        return 1
    print(f"{label}: {call.lines[0]}")
    return call.exit_code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="seatrial benchmark", description=main.__doc__)
    parser.add_argument("--task", action="append", help="a file of conf/benchmark; default: all")
    parser.add_argument(
        "--entrant", action="append", help="of the task, or an identifier; default: all of the task"
    )
    parser.add_argument("--results-dir", type=Path, default=RESULTS)
    parser.add_argument("--launcher", default="processes")
    parser.add_argument("--dry-run", action="store_true", help="print the commands of the trials")
    return parser
