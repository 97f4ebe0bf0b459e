"""Trials and sweeps from Python, and what is stored of them as objects and pandas frames.

Every query opens the logbook and closes it again, so that nothing is locked between two cells of a
notebook. Tables, figures and lists are those of `seatrial-results`, by the same functions.
"""

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from seatrial.models.errors import ConfigurationError, SeatrialError
from seatrial.runner import compare, database, export
from seatrial.runner.compare import commands
from seatrial.runner.compare.cli import MAX_ROWS, TableOptions
from seatrial.runner.compare.figures import PlotRequest
from seatrial.runner.compare.grid import TextTable
from seatrial.runner.configuration.invocation import DEFAULT_DATABASE, meant
from seatrial.runner.interface.shell import Displayed, command_options, overrides_of, place_of
from seatrial.runner.record.vocabulary import GROUPS

if TYPE_CHECKING:  # slow to import
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from seatrial.runner.compare.frame import Queries
    from seatrial.runner.interface import models
    from seatrial.runner.sweeps import in_process
else:
    import lazy_loader

    pd = lazy_loader.load("pandas")
    models, in_process = (
        lazy_loader.load(f"seatrial.runner.{name}", suppress_warning=True)
        for name in ("interface.models", "sweeps.in_process")
    )


class Table(Displayed):
    """A table of the comparison, with its `notes`."""

    def __init__(self, grid: TextTable) -> None:
        self._grid, self.notes = grid, tuple(grid.notes)

    @property
    def frame(self) -> "pd.DataFrame":
        """The numbers at full precision, one row a record, as `--format json` writes them."""
        return pd.DataFrame(list(self._grid.as_records()))

    def _shown(self) -> TextTable:
        return self._grid


class Logbook(Displayed):
    """The runs of a results database, or those of one sweep in it, of which `number` is the number.

    `path` is its file or address (`postgresql://...`), `results_dir` the folder of the series; by
    default that of the file, or `results`. Raises LogbookError if it cannot be read.
    """

    def __init__(
        self, path: str | Path = DEFAULT_DATABASE, results_dir: str | Path | None = None,
        number: int | None = None,
    ) -> None:  # fmt: skip
        self.address, self.number = address_of(path), number
        self._results_dir = None if results_dir is None else Path(results_dir).absolute()
        with self.opened():
            pass

    def opened(self) -> "AbstractContextManager[Queries]":
        """Open the logbook for the queries of tables and figures."""
        return compare.frame.open_results(self.address, self._results_dir)

    def runs(self, where: str | None = None, sweep: int | str | None = None) -> "pd.DataFrame":
        """Return the runs, newest first, with their choices, status and duration, by `run_id`.

        Such as `where="seed<10 and identifier=ls"`; `sweep` is the number, name or tag of a sweep.
        """
        with self.opened() as results:
            listed = Table(commands.runs(results, where, self._chosen(sweep), limit=MAX_ROWS))
        return listed.frame.set_index("run_id")

    def run(self, number: int) -> "Run":
        """Return a run by its number; raises LogbookError if there is no such run."""
        return Run(self, number)

    def to_pandas(
        self, names: str | Sequence[str] | None = None, where: str | None = None,
        sweep: int | str | None = None,
    ) -> "pd.DataFrame":  # fmt: skip
        """Return the metrics of the runs as a tidy frame, one row a run and number.

        Its columns are run_id, the choices of the run, seed, stage, model, dof, name, value and
        unit. `names` are those of a metric or of several; `where` and `sweep` as for `runs`. A run
        with identifier=none has each number once, as that of its identified model.
        """
        with self.opened() as results:
            condition, _ = results.selected(where, self._chosen(sweep))
            known = results.metric_names()
            chosen = [names] if isinstance(names, str) else names or known
            for name in {*chosen} - {*known}:
                hint = meant(name, known, 3) or f"expected some of {', '.join(known)}"
                raise ConfigurationError(f"names: no metric {name!r}, {hint.rstrip()}")
            numbers = results.metrics(chosen, condition)
            choices = results.trials(condition)[[*GROUPS, "seed"]].astype({"seed": "int64"})
        frame = numbers.join(choices, on="run", how="inner")
        frame = frame.rename(columns={"run": "run_id", "metric": "name"})
        twice = frame.duplicated(["run_id", "stage", "dof", "name"], keep=False)
        twice &= (frame["identifier"] == "none") & (frame["model"] == "nominal")
        columns = ["run_id", *choices, "stage", "model", "dof", "name", "value", "unit"]
        return frame.loc[~twice, columns].reset_index(drop=True)

    def table(self, **options: Any) -> Table:
        """Compare a metric or coefficients over seeds, as `seatrial-results table` does.

        The options are those of the command, such as `metric="e_pos_mae"`, `rows="identifier"`,
        `baseline="identifier=none"`; several names are a list.
        """
        chosen = command_options("table", TableOptions, {"sweep": self.number, **options})
        with self.opened() as results:
            return Table(commands.table(results, chosen))

    def plot(self, kind: str, ax: "Axes | None" = None, **options: Any) -> "Figure":
        """Draw a figure, as `seatrial-results plot` does, with its options, or into axes of yours.

        Such as `plot("track", run=17)` or `plot("bars", metric="e_pos_mae", dof="surge")`. Raises
        ConfigurationError if no run has the data, or if there are several figures.
        """
        given = {"kind": kind, "sweep": self.number, **options}
        with self.opened() as results:
            request = command_options("plot", PlotRequest, given)
            figures = compare.plots.figures_of(results, request, ax)
        if len(figures) > 1:
            raise ConfigurationError(f"plot {kind}: got {len(figures)} figures, expected one")
        return figures[0]

    def model(self, run: int, model: str = "identified") -> "models.Model":
        """Return a model of a run: nominal, identified, plant or adaptive."""
        with self.opened() as results:
            stored = export.stored_model.read_model(results.reader, run, model)
        name = f"run:{run}" if model == "identified" else None
        return models.Model(stored.table, stored.parameters, name, stored, self.address)

    def _chosen(self, sweep: int | str | None) -> str:
        return str(sweep or self.number or "all")

    def _shown(self) -> TextTable:
        with self.opened() as results:
            return commands.runs(results, sweep=self._chosen(None))


class Run(Displayed):
    """One stored run, by its `number` in a `logbook`; a notebook shows its main results.

    `status` is finished, diverged, failed, running or interrupted, `config` the resolved
    configuration with every option, and `command` the command of the shell that repeats the run.
    """

    def __init__(self, logbook: Logbook, number: int) -> None:
        self.logbook, self.number = logbook, number
        with logbook.opened() as results:
            detail = results.reader.run(number)
            self.command = str(commands.show(results, number, command=True))
        self.status, self.config = detail.summary.status, detail.config

    @property
    def metrics(self) -> "pd.DataFrame":
        """All metrics, with their values and units."""
        return self._facts("metrics", "stage model dof name value unit")

    @property
    def coefficients(self) -> "pd.DataFrame":
        """All coefficients of all models, with their units, standard errors and true values."""
        return self._facts("coefficients", "model dof term value std_error true_value unit")

    @property
    def diagnostics(self) -> "pd.DataFrame":
        """What the parts of the trial said of themselves, warnings included."""
        return self._facts("diagnostics", "name dof value unit i j label")

    @property
    def model(self) -> "models.Model":
        """The identified model."""
        return self.logbook.model(self.number)

    def series(self, kind: str = "recording") -> "pd.DataFrame":
        """Return a time series: recording, residual, deployment_nominal, deployment_identified, ...

        In SI units and radians, by time t [s]; the units are in `frame.attrs["units"]`.
        """
        with self.logbook.opened() as results:
            stored = results.reader.series(self.number, kind)
        frame = pd.DataFrame(dict(stored.columns))
        frame = frame.set_index("t") if "t" in frame else frame
        frame.attrs["units"] = dict(stored.units)
        return frame

    def metric(
        self, name: str, dof: str = "all", model: str = "identified", stage: str | None = None
    ) -> float:
        """Return one number, in the unit of its metric; NaN if it has no value.

        `dof` is surge, sway, yaw, position, heading or all, `model` identified, nominal, plant or
        mean_motion, and `stage` identification, validation or deployment, if several have the
        metric. Raises ConfigurationError if the run has no such number, or several.
        """
        with self.logbook.opened() as results:
            rows = results.reader.metrics(self.number)
        same = [row for row in rows if row.name == name]
        own = [r for r in same if (r.dof, r.model, stage or r.stage) == (dof, model, r.stage)]
        if len(own) != 1:
            known = ", ".join(sorted({f"{row.dof} of {row.model}" for row in same}))
            got = f"got {len(own)} numbers {name} with dof {dof} of model {model}, expected one"
            known = known or f"no such metric. {meant(name, {row.name for row in rows}, 3)}".strip()
            raise ConfigurationError(f"run {self.number}: {got}, has {known}")
        return float("nan") if own[0].value is None else own[0].value

    def plot(self, kind: str, ax: "Axes | None" = None, **options: Any) -> "Figure":
        """Draw a figure of this run; see `Logbook.plot`."""
        return self.logbook.plot(kind, ax, **{**options, "run": self.number})

    def _facts(self, what: str, columns: str) -> "pd.DataFrame":
        """Return stored records as a frame, which has its columns also without a row."""
        with self.logbook.opened() as results:
            stored = getattr(results.reader, what)(self.number)
        return pd.DataFrame(stored, columns=columns.split())

    def _shown(self) -> TextTable:
        with self.logbook.opened() as results:
            return compare.runs.headline(results, self.number)


class RunFailed(SeatrialError):  # noqa: N818 - named like the status of the run
    """A trial failed or diverged; `run` is what is stored of it."""

    def __init__(self, message: str, run: Run) -> None:
        super().__init__(message)
        self.run = run


def open(path: str | Path = DEFAULT_DATABASE, results_dir: str | Path | None = None) -> Logbook:
    """Open a results database for reading; the arguments are those of `Logbook`."""
    return Logbook(path, results_dir)


def run(*overrides: str, database: str | Path | None = None, **options: object) -> Run:
    """Run one trial, as the command `seatrial` does; one that is stored already is not run again.

    The overrides are options as on the command line, such as `"plant.scale=0.8"`; a double
    underscore stands for a dot of other options: `vessel="tug"`, `identifier__basis="physical"`,
    `seed=1`, `rerun=True`. `database` is the file or address of the logbook, by default
    `results/results.db` in the working folder.

    A group (`vessel`, `disturbance`, `excitation`, `identifier`, `controller`, `evaluation`) takes
    the name of an option, a path, an object such as a `Vessel`, a `Model` or an `Identifier`, or a
    mapping: an object, or a mapping with `_target_`, replaces what the group has, any other mapping
    sets options of it.

    Raises RunFailed, which has the run, if the trial failed or diverged, else SeatrialError with
    the line that the command prints.
    """
    for wrong in (each for each in overrides if not isinstance(each, str)):
        raise ConfigurationError(f"overrides: got {wrong!r}, expected text such as 'seed=1'")
    call = in_process.run_trial([*_texts(options, database), *place_of(database), *overrides])
    if not (call.outcome and call.logbook and call.outcome.run_id):
        raise SeatrialError(str(call.outcome and call.outcome.error))
    stored = Run(Logbook(*call.logbook), call.outcome.run_id)
    if isinstance(call.error, str):
        raise RunFailed(call.error, stored)
    return stored


def sweep(
    trials: Sequence[str | Mapping[str, object]], *, launcher: str = "basic",
    name: str | None = None, database: str | Path | None = None, progress: bool = True,
    **options: Any,
) -> Logbook:  # fmt: skip
    """Run many trials, as the command `seatrial -m` does; those that are stored are not run again.

    Texts have several values: `["identifier=ls,plsr", "seed=range(0,5)"]` are ten trials. A mapping
    is a set of options that change together, like `--variant`. The other options are those of all
    trials, as for `run`; a Python range has several values. `launcher` is basic (one after the
    other), processes (all cores), submitit_slurm, ..., `name` that of the sweep, for tables and
    lists; `progress` is shown on a terminal, and logged elsewhere.

    Returns the runs of the sweep, those that failed or diverged among them. Raises SeatrialError
    if a trial cannot be run (then none was started), or the workers were lost.
    """
    trials = [trials] if isinstance(trials, str) or not isinstance(trials, Sequence) else trials
    for wrong in (each for each in trials if not isinstance(each, str | Mapping)):
        raise ConfigurationError(f"trials: got {wrong!r}, expected overrides or options by name")
    texts = [trial for trial in trials if isinstance(trial, str)]
    variants = [_texts(trial, database) for trial in trials if not isinstance(trial, str)]
    fixed = _texts(options if name is None else {"sweep.name": name, **options}, database)
    words = [*texts, *fixed, *place_of(database), f"hydra/launcher={launcher}"]
    call = in_process.Call(["-m", *words], variants)
    call.view = call.view if progress else None
    in_process.run_sweep(call, words)
    assert call.sweep_id
    assert call.logbook
    return Logbook(*call.logbook, call.sweep_id)


def address_of(path: str | Path) -> str:
    """Return the address of a logbook, with an absolute path: the working folder may change."""
    address = database.engine.url_of(path)
    file = database.engine.parse(address).path
    return address if file is None else database.engine.file_url(file.absolute())


def _texts(options: Mapping[str, object], place: str | Path | None) -> list[str]:
    """Return the overrides of options; the model of a run is a vessel in its own logbook only."""
    address = getattr(options.get("vessel"), "address", None)
    if address not in (None, address_of(place or DEFAULT_DATABASE)):
        expected = "expected one of the same logbook; vessel.save('yaml') writes it to a file"
        raise ConfigurationError(f"vessel: got a model of {address}, {expected}")
    return overrides_of(options)
