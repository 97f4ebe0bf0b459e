"""Stored runs as objects: the logbook, a sweep and a run, with their numbers as pandas frames.

Every query opens the logbook and closes it again, so that nothing is locked between two cells of a
notebook. Tables, figures and lists are those of `seatrial-results`, by the same functions.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, fields
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError
from seatrial.runner import compare, database, export
from seatrial.runner.compare import commands
from seatrial.runner.compare.cli import MAX_ROWS, TableOptions
from seatrial.runner.compare.figures import PlotRequest, split
from seatrial.runner.configuration.invocation import DEFAULT_DATABASE
from seatrial.runner.interface.arguments import Names, command_options
from seatrial.runner.interface.displayed_table import Table
from seatrial.runner.interface.vessel_models import Model
from seatrial.runner.record.vocabulary import GROUPS, Config

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from seatrial.runner.compare.frame import Queries
    from seatrial.runner.record import rows
else:
    import lazy_loader

    pd = lazy_loader.load("pandas")
    rows = lazy_loader.load("seatrial.runner.record.rows", suppress_warning=True)


class Logbook:
    """The runs of a results database.

    Args:
        path: file of the database, or its address (`postgresql://...`).
        results_dir: folder of the series files; by default that of the file, or `results`.
    """

    def __init__(self, path: str | Path = DEFAULT_DATABASE, results_dir: Path | None = None):
        address = database.engine.url_of(path)
        file = database.engine.parse(address).path
        # Absolute, because the working folder may change.
        self.address = address if file is None else database.engine.file_url(file.absolute())
        self._results_dir = None if results_dir is None else results_dir.absolute()
        self._sweep: str | None = None

    @contextmanager
    def opened(self) -> Iterator["Queries"]:
        """Open the logbook for the queries of tables and figures."""
        with compare.frame.open_results(self.address, self._results_dir) as results:
            yield results

    def runs(
        self,
        status: str | None = None,
        limit: int = MAX_ROWS,
        where: str | None = None,
        sweep: int | str | None = None,
    ) -> "pd.DataFrame":
        """Return the runs, newest first, with their choices, status and duration.

        Args:
            status: only runs of this status: finished, failed, diverged, running or interrupted.
            limit: largest number of runs.
            where: which runs, as for the command `runs`, such as `"seed<10 and identifier=ls"`.
            sweep: number, name or tag of a sweep; by default all.

        Returns:
            One row a run; its index `run_id` is the number of the run.
        """
        chosen = {"where": where, "sweep": self._chosen(sweep), "status": status, "limit": limit}
        return self._listed(**chosen).frame.set_index("run_id")

    def run(self, number: int) -> "Run":
        """Return a run by its number; raises LogbookError if there is no such run."""
        run = Run(self, number)
        _ = run.status
        return run

    def to_pandas(
        self, names: Names | None = None, where: str | None = None, sweep: int | str | None = None
    ) -> "pd.DataFrame":
        """Return the metrics of the runs as a tidy frame, one row a run and number.

        A run with identifier=none has each number once: its nominal and its identified model are
        the same, and the rows of the second one stay.

        Args:
            names: only these metrics; all by default.
            where: which runs, as for the command `runs`.
            sweep: number, name or tag of a sweep; by default all.

        Returns:
            Columns run_id, the choices of the run, seed, stage, model, dof, name, value and unit.
        """
        chosen = split([names] if isinstance(names, str) else [*(names or ())])
        with self.opened() as results:
            condition, _ = results.selected(where, self._chosen(sweep))
            numbers = results.metrics(chosen or results.metric_names(), condition)
            labels = results.trials(condition)[[*GROUPS, "seed"]].astype({"seed": "int64"})
        frame = numbers.join(labels, on="run", how="inner")
        frame = frame.rename(columns={"run": "run_id", "metric": "name"})
        twice = frame.duplicated(["run_id", "stage", "dof", "name"], keep=False)
        twice &= (frame["identifier"] == "none") & (frame["model"] == "nominal")
        columns = ("run_id", *labels, "stage", "model", "dof", "name", "value", "unit")
        return frame.loc[~twice, list(columns)].reset_index(drop=True)

    def table(self, **options: Any) -> Table:
        """Compare a metric or coefficients over seeds, as `seatrial-results table` does.

        Args:
            **options: the options of the command, such as `metric="e_pos_mae"`,
                `rows="identifier"`, `columns="disturbance"`, `baseline="identifier=none"`; several
                names as a list.

        Returns:
            Shown by a notebook; its numbers are `table.frame`.
        """
        chosen = command_options("table", TableOptions, {"sweep": self._sweep, **options})
        with self.opened() as results:
            return Table(commands.table(results, chosen))

    def plot(self, kind: str, ax: "Axes | None" = None, **options: Any) -> "Figure":
        """Draw a figure, as `seatrial-results plot` does.

        Args:
            kind: name of the figure: bars, track, errors, residual, coefficients, ...
            ax: axes of yours to draw into, for a figure with one panel.
            **options: the options of the command, such as `run=17`, `metric="e_pos_mae"`,
                `dof="surge"`.

        Returns:
            The figure, or that of your axes.

        Raises:
            ConfigurationError: No run has the data, or there are several figures (`plots` returns
                them).
        """
        figures = self.plots(kind, ax, **options)
        if len(figures) > 1:
            raise ConfigurationError(f"plot {kind}: got {len(figures)} figures, expected one")
        return figures[0]

    def plots(self, kind: str, ax: "Axes | None" = None, **options: Any) -> "list[Figure]":
        """Draw all figures of a kind, such as one for each level of `facet`; see `plot`."""
        given = {"kind": kind, "sweep": self._sweep, **options}
        request = command_options("plot", PlotRequest, given)
        with self.opened() as results:
            return compare.plots.figures_of(results, request, ax)

    def model(
        self, run: int, model: Literal["nominal", "identified", "plant", "adaptive"] = "identified"
    ) -> Model:
        """Return a model of a run, to simulate it, to sail it or to write it for others.

        Raises LogbookError if the run has no such model.
        """
        with self.opened() as results:
            stored = export.stored_model.read_model(results.reader, run, model)
        choice = f"run:{run}" if model == "identified" else None
        return Model(stored.table, stored.parameters, choice, stored, self.address)

    def series(self, run: int, kind: str = "recording") -> "pd.DataFrame":
        """Return a time series of a run.

        Args:
            run: number of the run.
            kind: recording, residual, deployment_nominal, deployment_identified, ...

        Returns:
            The columns of the series in SI units and radians, by time t [s] as the index; the units
            are in `frame.attrs["units"]`.
        """
        with self.opened() as results:
            stored = results.reader.series(run, kind)
        frame = pd.DataFrame(dict(stored.columns))
        frame = frame.set_index("t") if "t" in frame else frame
        frame.attrs["units"] = dict(stored.units)
        return frame

    def sql(self, query: str, timeout_s: float = 30.0, limit: int = 10_000) -> "pd.DataFrame":
        """Return the rows of a query in SQL; one that writes is refused."""
        with self.opened() as results:
            answer = results.reader.sql(query, timeout_s, limit)
        return pd.DataFrame(list(answer.rows), columns=list(answer.columns))

    def _listed(self, **options: Any) -> Table:
        with self.opened() as results:
            return Table(commands.runs(results, **{"sweep": self._chosen(None), **options}))

    def _chosen(self, sweep: int | str | None) -> str:
        return str(sweep) if sweep is not None else self._sweep or "all"

    def __repr__(self) -> str:
        return f"Logbook({self.address!r})"

    def _repr_html_(self) -> str:
        try:
            return self._listed().text("html")
        except ConfigurationError as error:  # there is no run yet
            return f"<p>{escape(str(error))}</p>"


class Sweep(Logbook):
    """The runs of one sweep; `number` is that of the sweep."""

    def __init__(self, path: str, results_dir: Path, number: int) -> None:
        super().__init__(path, results_dir)
        self.number = number
        self._sweep = str(number)

    def __repr__(self) -> str:
        return str(self._listed(limit=MAX_ROWS))


class Run:
    """One stored run; a notebook shows its main results.

    `logbook` is where it is stored, `number` its number there.
    """

    def __init__(self, logbook: Logbook, number: int) -> None:
        self.logbook = logbook
        self.number = number

    @property
    def status(self) -> str:
        """finished, diverged, failed, running or interrupted."""
        with self.logbook.opened() as results:
            return results.reader.run(self.number).summary.status

    @property
    def config(self) -> dict[str, object]:
        """The resolved configuration, with every option."""
        with self.logbook.opened() as results:
            own: Config = results.reader.run(self.number).config
        return dict(own)

    @property
    def metrics(self) -> "pd.DataFrame":
        """All metrics: columns stage, model, dof, name, value and unit."""
        return self._facts("metrics", rows.Metric)

    @property
    def coefficients(self) -> "pd.DataFrame":
        """All coefficients: columns model, dof, term, value, unit, std_error and true_value."""
        return self._facts("coefficients", rows.Coefficient)

    @property
    def diagnostics(self) -> "pd.DataFrame":
        """What the parts of the trial said of themselves, warnings included."""
        return self._facts("diagnostics", Diagnostic)

    @property
    def model(self) -> Model:
        """The identified model."""
        return self.logbook.model(self.number)

    def series(self, kind: str = "recording") -> "pd.DataFrame":
        """Return a time series; see `Logbook.series`."""
        return self.logbook.series(self.number, kind)

    def metric(
        self, name: str, dof: str = "all", model: str = "identified", stage: str | None = None
    ) -> float:
        """Return one number.

        Args:
            name: name of the metric; `seatrial-results metrics` lists them.
            dof: surge, sway, yaw, position, heading or all.
            model: identified, nominal, plant or mean_motion.
            stage: identification, validation or deployment, if several have the metric.

        Returns:
            The value in the unit of the metric; NaN if it has none.

        Raises:
            ConfigurationError: The run has no such number, or several.
        """
        frame = self.metrics
        same = frame[frame["name"] == name]
        own = same[(same["dof"] == dof) & (same["model"] == model)]
        own = own if stage is None else own[own["stage"] == stage]
        if len(own) != 1:
            known = sorted({f"{d} of {m}" for d, m in zip(same["dof"], same["model"], strict=True)})
            raise ConfigurationError(
                f"run {self.number}: got {len(own)} numbers {name} with dof {dof} of model {model}"
                f", expected one; it has {', '.join(known) or 'no such metric'}"
            )
        value = own["value"].iloc[0]
        return float("nan") if value is None else float(value)

    def plot(self, kind: str, ax: "Axes | None" = None, **options: Any) -> "Figure":
        """Draw a figure of this run; see `Logbook.plot`."""
        return self.logbook.plot(kind, ax, **{**options, "run": self.number})

    @property
    def command(self) -> str:
        """The command of the shell that repeats the run."""
        with self.logbook.opened() as results:
            return str(commands.show(results, self.number, command=True))

    def _facts(self, what: str, record: type[Any]) -> "pd.DataFrame":
        """Return stored records as a frame, which has its columns also without a row."""
        with self.logbook.opened() as results:
            own = list(map(asdict, getattr(results.reader, what)(self.number)))
        return pd.DataFrame(own, columns=[field.name for field in fields(record)])

    def _summary(self) -> Table:
        with self.logbook.opened() as results:
            return Table(compare.runs.headline(results, self.number))

    def __repr__(self) -> str:
        return str(self._summary())

    def _repr_html_(self) -> str:
        return self._summary().text("html")
