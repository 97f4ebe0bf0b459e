"""The command `seatrial benchmark`: runs the cells of the benchmark that are not in the logbook."""

from functools import partial
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Annotated

import typer

from seatrial.models.errors import SeatrialError
from seatrial.runner.compare import benchmark as tasks
from seatrial.runner.compare.cli import run_typer
from seatrial.runner.configuration import search_path
from seatrial.runner.sweeps import in_process
from seatrial.runner.sweeps.console import terminal_view

app = typer.Typer(name="seatrial benchmark", pretty_exceptions_enable=False, add_completion=False)
main = partial(run_typer, app)  # of the words that follow `seatrial benchmark`
Names = Annotated[list[str] | None, typer.Option(help="By default all.")]


@app.command()
def benchmark(
    task: Names = None, entrant: Names = None, results_dir: Path = Path("results/benchmark"),
    launcher: str = "processes",
) -> None:  # fmt: skip
    """Run the cells: of a task (a file of conf/benchmark), an entrant of it or an identifier.

    The exit code is 1 if a trial failed or an entrant cannot take part.
    """
    code = 0
    for name in task or search_path.options(tasks.GROUP):
        cells = [*tasks.cells(tasks.task_of(name), entrant or ())]
        for case, lacking in {cell.case: cell.lacking for cell in cells if cell.lacking}.items():
            files = ", ".join(f"{file.name} is {file.state}" for file in lacking)
            print(f"{name}: {case} is left out: {files}; see seatrial data get {name}")
        words = [f"results_dir={results_dir}", f"sweep.name=benchmark_{name}"]
        words.append(f"hydra/launcher={launcher}")
        whole = [cell for cell in cells if not cell.lacking]
        for label, own in groupby(whole, attrgetter("entrant")):
            call = in_process.Call(["-m", *words], [cell.options for cell in own])
            call.view = terminal_view
            try:
                in_process.run_sweep(call, words)
                print(f"{name}, {label}: {call.lines[0]}")
                code = max(code, call.exit_code)
            except SeatrialError as error:
                print(f"{name}, {label}: cannot take part: {error}")
                code = 1
    raise typer.Exit(code)


def get(task: Annotated[str, typer.Argument(help="A task of the benchmark.")]) -> None:
    """Say where the files of a task are, and how to get those that are missing or damaged.

    They are looked for in the folder SEATRIAL_DATA, then in ~/.local/share/seatrial.
    """
    known = tasks.task_of(task)
    for file in (files := tasks.located(known)):
        print(f"{file.state:8} {file.folder / file.name}")
    if not files:
        print(f"{task} is simulated: there is nothing to get")
    for key, value in known.source.items():
        print(f"{key}: {value}")
    if any(file.state != "found" for file in files):
        raise typer.Exit(1)
