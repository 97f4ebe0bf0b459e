"""The command `seatrial benchmark`: runs the cells of the benchmark that are not in the logbook."""

import shlex
from collections.abc import Sequence
from datetime import timedelta
from itertools import groupby
from pathlib import Path
from time import perf_counter
from typing import Annotated

import typer

from seatrial.models.errors import SeatrialError
from seatrial.runner.compare.benchmark import task as tasks
from seatrial.runner.compare.cli import run_typer
from seatrial.runner.configuration import search_path
from seatrial.runner.configuration.invocation import trial_program
from seatrial.runner.sweeps import in_process
from seatrial.runner.sweeps.console import terminal_view

app = typer.Typer(name="seatrial benchmark", pretty_exceptions_enable=False, add_completion=False)


def main(words: Sequence[str]) -> int:
    """Run `seatrial benchmark` with the words that follow it; returns the exit code."""
    return run_typer(app, words)


@app.command()
def benchmark(
    task: Annotated[
        list[str] | None, typer.Option(help="A file of conf/benchmark; by default all.")
    ] = None,
    entrant: Annotated[
        list[str] | None,
        typer.Option(help="Of the task, or an identifier; by default all of the task."),
    ] = None,
    results_dir: Annotated[Path, typer.Option(help="Folder of the results.")] = Path(
        "results/benchmark"
    ),
    launcher: Annotated[str, typer.Option(help="Of the sweeps.")] = "processes",
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print the commands of the trials.")
    ] = False,
) -> None:
    """Run the cells; the exit code is 1 if a trial failed or an entrant cannot take part."""
    code, began = 0, perf_counter()
    for name in task or search_path.options(tasks.GROUP):
        known, began_task = tasks.task_of(name), perf_counter()
        for case, wrong in tasks.lacking(known, tasks.located(known)).items():
            files = ", ".join(f"{file.name} is {file.state}" for file in wrong)
            print(f"{name}: {case} is left out: {files}; see seatrial data get {name}")
        words = [f"results_dir={results_dir}", f"sweep.name=benchmark_{name}"]
        listed = tasks.cells(known, entrant or ())
        for label, own in groupby(listed, key=lambda cell: cell.entrant):
            variants = [list(cell.options) for cell in own]
            if dry_run:
                for variant in variants:
                    print(shlex.join([*trial_program().split(), *variant, *words]))
            else:
                launched = [*words, f"hydra/launcher={launcher}"]
                code = max(code, _sweep(f"{name}, {label}", launched, variants))
        print(f"{name}: {timedelta(seconds=round(perf_counter() - began_task))}")
    print(f"benchmark: {timedelta(seconds=round(perf_counter() - began))}")
    raise typer.Exit(code)


def get(task: Annotated[str, typer.Argument(help="A task of the benchmark.")]) -> None:
    """Say where the files of a task are, and how to get those that are missing or damaged."""
    known = tasks.task_of(task)
    files = tasks.located(known)
    for file in files:
        print(f"{file.state:8} {file.path}")
    if known.source is None:
        print(f"{task} is simulated: there is nothing to get")
        return
    source = known.source
    print(f"{source.name}\n{source.url}\nlicence: {source.licence}\n{source.get}")
    wrong = sum(file.state != "found" for file in files)
    if wrong:
        places = f"${tasks.VARIABLE}, then {tasks.DATA_FOLDER}"
        print(f"{wrong} of {len(files)} files to get; folders: {places}")
        raise typer.Exit(1)


def _sweep(label: str, words: Sequence[str], variants: list[list[str]]) -> int:
    """Run the cells of one entrant in one task as a sweep; returns the exit code."""
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
