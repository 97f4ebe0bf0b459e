"""The command `seatrial benchmark`: runs the cells of the benchmark that are not in the logbook."""

import shlex
from collections import defaultdict
from datetime import timedelta
from functools import partial
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
main = partial(run_typer, app)  # of the words that follow `seatrial benchmark`
Names = Annotated[list[str] | None, typer.Option(help="By default all.")]
TRIALS = "Print the commands of the trials."


@app.command()
def benchmark(
    task: Names = None, entrant: Names = None, results_dir: Path = Path("results/benchmark"),
    launcher: str = "processes",
    dry_run: Annotated[bool, typer.Option("--dry-run", help=TRIALS)] = False,
) -> None:  # fmt: skip
    """Run the cells: of a task (a file of conf/benchmark), an entrant of it or an identifier.

    The exit code is 1 if a trial failed or an entrant cannot take part.
    """
    code, began = 0, perf_counter()
    for name in task or search_path.options(tasks.GROUP):
        known, variants = tasks.task_of(name), defaultdict[str, list[list[str]]](list)
        cells = [*tasks.cells(known, entrant or ())]
        for case, lacking in {cell.case: cell.lacking for cell in cells if cell.lacking}.items():
            files = ", ".join(f"{file.name} is {file.state}" for file in lacking)
            print(f"{name}: {case} is left out: {files}; see seatrial data get {name}")
        for cell in (cell for cell in cells if not cell.lacking):
            variants[cell.entrant].append([*cell.options])
        words = [f"results_dir={results_dir}", f"sweep.name=benchmark_{name}"]
        for label, own in variants.items():
            if dry_run:
                for variant in own:
                    print(shlex.join([*trial_program().split(), *variant, *words]))
                continue
            launched = [*words, f"hydra/launcher={launcher}"]
            call = in_process.Call(["-m", *launched], own)
            call.view = terminal_view
            try:
                in_process.run_sweep(call, launched)
                print(f"{name}, {label}: {call.lines[0]}")
                code = max(code, call.exit_code)
            except SeatrialError as error:
                print(f"{name}, {label}: cannot take part: {error}")
                code = 1
    print(f"benchmark: {timedelta(seconds=round(perf_counter() - began))}")
    raise typer.Exit(code)


def get(task: Annotated[str, typer.Argument(help="A task of the benchmark.")]) -> None:
    """Say where the files of a task are, and how to get those that are missing or damaged."""
    known = tasks.task_of(task)
    files = tasks.located(known)
    for file in files:
        print(f"{file.state:8} {file.path}")
    if not files:
        print(f"{task} is simulated: there is nothing to get")
    for key, value in known.source.items():
        print(f"{key}: {value}")
    if wrong := sum(file.state != "found" for file in files):
        places = f"${tasks.VARIABLE}, then {tasks.DATA_FOLDER}"
        print(f"{wrong} of {len(files)} files to get; folders: {places}")
        raise typer.Exit(1)
