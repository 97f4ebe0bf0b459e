"""Run trials and sweeps from Python, and open their results."""

import sys
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from seatrial.models.errors import ConfigurationError, SeatrialError
from seatrial.runner.configuration.invocation import DEFAULT_DATABASE
from seatrial.runner.interface.arguments import overrides_of, place_of
from seatrial.runner.interface.stored_runs import Logbook, Run, Sweep
from seatrial.runner.interface.vessel_models import Model
from seatrial.runner.record.vocabulary import GROUPS

if TYPE_CHECKING:
    from seatrial.runner.sweeps import in_process
else:
    import lazy_loader

    in_process = lazy_loader.load("seatrial.runner.sweeps.in_process", suppress_warning=True)

# A name, a path, a list of disturbances, a part as an object, or a mapping.
Choice = object
LINE = 80  # characters that the line of a notebook has at least


class RunFailed(SeatrialError):  # noqa: N818 - named like the status of the run
    """A trial failed or diverged; `run` is what is stored of it."""

    def __init__(self, message: str, run: Run) -> None:
        super().__init__(message)
        self.run = run


def run(
    *overrides: str,
    vessel: Choice = None,
    disturbance: Choice = None,
    excitation: Choice = None,
    identifier: Choice = None,
    controller: Choice = None,
    evaluation: Choice = None,
    database: str | Path | None = None,
    **options: object,
) -> Run:
    """Run one trial, as the command `seatrial` does; one that is stored already is not run again.

    Args:
        *overrides: options as on the command line, such as `"plant.scale=0.8"`.
        vessel: an option of the group, a path, `run:17`, a `Vessel` or a `Model`. An object of the
            group or a mapping with `_target_` replaces what the group has; any other mapping sets
            options of it.
        disturbance: likewise, or a list.
        excitation: likewise.
        identifier: likewise, such as an `Identifier`.
        controller: likewise.
        evaluation: likewise.
        database: file or address of the logbook; by default `results/results.db` in the working
            folder.
        **options: any other option; a double underscore stands for a dot:
            `identifier__basis="physical"`, `seed=1`, `rerun=True`.

    Returns:
        The finished run, with its metrics, coefficients, model and series.

    Raises:
        RunFailed: The trial failed or diverged; the exception has the run.
        SeatrialError: The trial cannot be run; the message is the line that the command prints.
    """
    groups = (vessel, disturbance, excitation, identifier, controller, evaluation)
    _check(database, {"vessel": vessel, **options})
    chosen = {name: part for name, part in zip(GROUPS, groups, strict=True) if part is not None}
    words = [*overrides_of({**chosen, **options}), *place_of(database), *overrides]
    call = in_process.run_trial(words)
    assert call.outcome is not None
    assert call.logbook is not None
    number = call.outcome.run_id
    if number is None:
        raise SeatrialError(str(call.outcome.error))
    stored = Run(Logbook(*call.logbook), number)
    if isinstance(call.error, str):
        raise RunFailed(call.error, stored)
    return stored


def sweep(
    trials: Sequence[str | Mapping[str, object]],
    *,
    launcher: str = "basic",
    name: str | None = None,
    database: str | Path | None = None,
    progress: bool = True,
    **options: Any,
) -> Sweep:
    """Run many trials, as the command `seatrial -m` does; those that are stored are not run again.

    Args:
        trials: options with several values: `["identifier=ls,plsr", "seed=range(0,5)"]` are ten
            trials. A mapping is a set of options that change together, like `--variant`.
        launcher: basic (one after the other), processes (all cores), submitit_slurm, ...
        name: name of the sweep, for tables and lists.
        database: file or address of the logbook; by default `results/results.db` in the working
            folder.
        progress: whether to show the progress on a terminal or in a notebook.
        **options: options of all trials, as for `run`; a Python range has several values:
            `seed=range(5)`.

    Returns:
        The runs: `runs()`, `to_pandas()`, `table()`, `plot()` are those of this sweep. Runs that
        failed or diverged are in it, with their status.

    Raises:
        SeatrialError: A trial cannot be run (then none was started), or the workers were lost.
    """
    texts = [trial for trial in trials if isinstance(trial, str)]
    mappings = [trial for trial in trials if not isinstance(trial, str)]
    for trial in (options, *mappings):
        _check(database, trial)
    variants = [overrides_of(trial) for trial in mappings]
    fixed = {"sweep.name": name, **options} if name is not None else options
    words = [*texts, *overrides_of(fixed), *place_of(database), f"hydra/launcher={launcher}"]
    call = in_process.Call(["-m", *words], variants)
    in_notebook = progress and _in_notebook()
    if in_notebook or not progress:
        call.view = (lambda: nullcontext(_notebook_line)) if in_notebook else None
    in_process.run_sweep(call, words)
    if in_notebook:
        _notebook_line(call.lines[0])
    assert call.sweep_id is not None
    assert call.logbook is not None
    return Sweep(*call.logbook, call.sweep_id)


def open(path: str | Path = DEFAULT_DATABASE, results_dir: str | Path | None = None) -> Logbook:
    """Open a results database for reading.

    Args:
        path: file of the database, or its address (`postgresql://...`); by default
            `results/results.db`.
        results_dir: folder of the series files; by default that of the file, or `results`.

    Returns:
        The runs, with their tables, figures and models.

    Raises:
        LogbookError: There is no such database, or this version cannot read it.
    """
    logbook = Logbook(path, None if results_dir is None else Path(results_dir))
    with logbook.opened():
        return logbook


def _check(database: str | Path | None, options: Mapping[str, object]) -> None:
    """Refuse a model of a run of another logbook: `vessel=run:17` is one of this logbook."""
    vessel = options.get("vessel")
    if isinstance(vessel, Model) and vessel.address is not None:
        own = Logbook(DEFAULT_DATABASE if database is None else database).address
        if vessel.address != own or vessel.choice is None:
            raise ConfigurationError(
                f"vessel: got {vessel.name} of {vessel.address}, expected one of the "
                "same logbook; vessel.save('yaml') writes it to a file"
            )


def _in_notebook() -> bool:
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return type(shell).__name__ == "ZMQInteractiveShell"


def _notebook_line(standing: str, failures: Sequence[str] = ()) -> None:
    """Write the progress of a sweep over its last line, and lines about failed runs above it."""
    for line in failures:
        print(f"\r{line:<{LINE}}")
    print(f"\r{standing:<{LINE}}", end="", flush=True)
