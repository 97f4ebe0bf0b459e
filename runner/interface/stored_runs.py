"""Stored runs as objects: the logbook, a sweep and a run, with their numbers as pandas frames.

Every query opens the logbook and closes it again, so that nothing is locked between two cells of a
notebook. Tables and figures are those of `seatrial-results`.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, fields
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack, overload

from seatrial.models.diagnostics import Diagnostic
from seatrial.models.errors import ConfigurationError
from seatrial.runner import compare, database, export
from seatrial.runner.compare.cli import MAX_ROWS, PlotOptions, TableOptions
from seatrial.runner.compare.grid import TextTable, grid_of
from seatrial.runner.configuration.invocation import DEFAULT_DATABASE
from seatrial.runner.interface.arguments import (
    PLOT_LISTS,
    TABLE_LISTS,
    Kind,
    Names,
    PlotArguments,
    Selected,
    TableArguments,
    listed,
)
from seatrial.runner.interface.displayed_table import Table
from seatrial.runner.interface.vessel_models import Model
from seatrial.runner.record.catalogue import METRICS
from seatrial.runner.record.vocabulary import GROUPS, Config

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from seatrial.runner.compare.frame import Queries
    from seatrial.runner.database import RunDetail
    from seatrial.runner.record import rows
else:
    import lazy_loader

    pd = lazy_loader.load("pandas")
    rows = lazy_loader.load("seatrial.runner.record.rows", suppress_warning=True)


class Logbook:
    """The runs of a results database.

    Parameters
    ----------
    path
        File of the database, or its address (`postgresql://...`).
    results_dir
        Folder of the series files; by default that of the file, or `results`.
    """

    def __init__(self, path: str | Path = DEFAULT_DATABASE, results_dir: Path | None = None):
        address = database.engine.url_of(path)
        file = database.engine.parse(address).path
        # Absolute, because the working folder may change.
        self.address = address if file is None else database.engine.file_url(file.absolute())
        self._results_dir = None if results_dir is None else results_dir.absolute()
        self._default_sweep: str | None = None

    @contextmanager
    def opened(self) -> Iterator["Queries"]:
        """Open the logbook for the queries of tables and figures."""
        with compare.frame.open_results(self.address, self._results_dir) as results:
            yield results

    def runs(
        self, status: str | None = None, limit: int = MAX_ROWS, **selected: Unpack[Selected]
    ) -> "pd.DataFrame":
        """Return the runs, newest first, with their choices, status and duration.

        Parameters
        ----------
        status
            Only runs of this status: finished, failed, diverged, running or interrupted.
        limit
            Largest number of runs.
        **selected
            `where`, `sweep` and `tag`, as for the command `runs`.

        Returns
        -------
        pandas.DataFrame
            One row a run; its index `run_id` is the number of the run.
        """
        return self._run_list(status, limit, selected).frame.set_index("run_id")

    def run(self, number: int) -> "Run":
        """Return a run by its number; raises LogbookError if there is no such run."""
        run = Run(self, number)
        _ = run.status
        return run

    def metrics(self, names: Names | None = None, **selected: Unpack[Selected]) -> "pd.DataFrame":
        """Return the metrics of the runs, one row a number.

        Parameters
        ----------
        names
            Only these metrics; all by default.
        **selected
            `where`, `sweep` and `tag`; by default all runs.

        Returns
        -------
        pandas.DataFrame
            Columns run_id, the choices of the run, seed, stage, model, dof, name, value and unit.
        """
        with self.opened() as results:
            condition, _ = results.selected(*self._selection(selected, "all"))
            wanted = listed(names) or results.metric_names()
            numbers = results.metrics(wanted, condition)
            labels = results.trials(condition)[[*GROUPS, "seed"]].astype({"seed": "int64"})
        frame = numbers.join(labels, on="run", how="inner")
        frame = frame.rename(columns={"run": "run_id", "metric": "name"})
        columns = ("run_id", *labels, "stage", "model", "dof", "name", "value", "unit")
        return frame[list(columns)].reset_index(drop=True)

    def table(self, **options: Unpack[TableArguments]) -> Table:
        """Compare a metric or coefficients over seeds, as `seatrial-results table` does.

        Parameters
        ----------
        **options
            The options of the command, such as `metric="e_pos_mae"`, `rows="identifier"`,
            `columns="disturbance"`, `baseline="identifier=none"`.

        Returns
        -------
        Table
            Shown by a notebook; its numbers are `table.frame`.
        """
        chosen = self._options(options, TABLE_LISTS)
        request = compare.table.request_of(TableOptions(**chosen))
        with self.opened() as results:
            return Table(compare.table.comparison(results, request))

    @overload
    def plot(self, kind: str, ax: None = None, **options: Unpack[PlotArguments]) -> "Figure": ...
    @overload
    def plot(self, kind: str, ax: "Axes", **options: Unpack[PlotArguments]) -> "Axes": ...
    def plot(
        self, kind: str, ax: "Axes | None" = None, **options: Unpack[PlotArguments]
    ) -> "Figure | Axes":
        """Draw a figure, as `seatrial-results plot` does.

        Parameters
        ----------
        kind
            Name of the figure: bars, track, errors, residual, coefficients, ...
        ax
            Axes of yours to draw into, for a figure with one panel.
        **options
            The options of the command, such as `run=17`, `metric="e_pos_mae"`, `dof="surge"`.

        Returns
        -------
        matplotlib.figure.Figure or matplotlib.axes.Axes
            The figure, or your axes.

        Raises
        ------
        ConfigurationError
            No run has the data, or there are several figures (`plots` returns them).
        """
        figures = self._figures(kind, ax, options)
        if len(figures) > 1:
            raise ConfigurationError(f"plot {kind}: got {len(figures)} figures, expected one")
        return figures[0] if ax is None else ax

    def plots(self, kind: str, **options: Unpack[PlotArguments]) -> "list[Figure]":
        """Draw all figures of a kind, such as one for each level of `facet`; see `plot`."""
        return self._figures(kind, None, options)

    def model(self, run: int, model: Kind = "identified") -> Model:
        """Return a model of a run, to simulate it, to sail it or to write it for others.

        Raises LogbookError if the run has no such model.
        """
        with self.opened() as results:
            stored = export.stored_model.read_model(results.reader, run, model)
        return Model.of_run(stored, self.address)

    def series(self, run: int, kind: str = "recording") -> "pd.DataFrame":
        """Return a time series of a run.

        Parameters
        ----------
        run
            Number of the run.
        kind
            recording, residual, deployment_nominal, deployment_identified, ...

        Returns
        -------
        pandas.DataFrame
            The columns of the series in SI units and radians, by time t [s] as the index; the
            units are in `frame.attrs["units"]`.
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

    def _run_list(self, status: str | None, limit: int, selected: Selected) -> Table:
        where, sweep, tag = self._selection(selected, None)
        with self.opened() as results:
            return Table(compare.runs.run_list(results, where, status, limit, sweep, tag))

    def _figures(self, kind: str, ax: "Axes | None", options: PlotArguments) -> "list[Figure]":
        chosen = self._options(options, PLOT_LISTS)
        request = compare.plots.request_of(PlotOptions(kind, **chosen))
        with self.opened() as results:
            return compare.plots.figures_of(kind, results, request, ax)

    def _selection(
        self, selected: Selected, every: str | None
    ) -> tuple[str | None, str | None, str | None]:
        tag = selected.get("tag")
        sweep = selected.get("sweep", self._default_sweep or (every if tag is None else None))
        return selected.get("where"), None if sweep is None else str(sweep), tag

    def _options(self, options: Config, lists: Sequence[str]) -> dict[str, Any]:
        """Return options as the command line gives them: factors as text, names as lists."""
        chosen: dict[str, Any] = {"sweep": self._default_sweep, **options}
        for name, value in chosen.items():
            if name in lists:
                chosen[name] = list(listed(value))
            elif name in ("rows", "columns") and value is not None:
                chosen[name] = ",".join(listed(value))
            elif name == "sweep" and value is not None:
                chosen[name] = str(value)
        return chosen

    def __repr__(self) -> str:
        return f"Logbook({self.address!r})"

    def _repr_html_(self) -> str:
        try:
            return self._run_list(None, 50, {}).text("html")
        except ConfigurationError as error:  # there is no run yet
            return f"<p>{escape(str(error))}</p>"


class Sweep(Logbook):
    """The runs of one sweep; `number` is that of the sweep."""

    def __init__(self, path: str, results_dir: Path, number: int) -> None:
        super().__init__(path, results_dir)
        self.number = number
        self._default_sweep = str(number)

    def __repr__(self) -> str:
        return str(self._run_list(None, MAX_ROWS, {}))


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
        return self._detail().summary.status

    @property
    def config(self) -> dict[str, object]:
        """The resolved configuration, with every option."""
        return dict(self._detail().config)

    @property
    def metrics(self) -> "pd.DataFrame":
        """All metrics: columns stage, model, dof, name, value and unit."""
        with self.logbook.opened() as results:
            return _rows(rows.Metric, results.reader.metrics(self.number))

    @property
    def coefficients(self) -> "pd.DataFrame":
        """All coefficients: columns model, dof, term, value, unit, std_error and true_value."""
        with self.logbook.opened() as results:
            return _rows(rows.Coefficient, results.reader.coefficients(self.number))

    @property
    def diagnostics(self) -> "pd.DataFrame":
        """What the parts of the trial said of themselves, warnings included."""
        with self.logbook.opened() as results:
            return _rows(Diagnostic, results.reader.diagnostics(self.number))

    @property
    def model(self) -> Model:
        """The identified model."""
        return self.logbook.model(self.number)

    @property
    def series_kinds(self) -> tuple[str, ...]:
        """The kinds of time series that the run has stored."""
        with self.logbook.opened() as results:
            return tuple(file.kind for file in results.reader.series_files(self.number))

    def series(self, kind: str = "recording") -> "pd.DataFrame":
        """Return a time series; see `Logbook.series`."""
        return self.logbook.series(self.number, kind)

    def metric(
        self, name: str, dof: str = "all", model: str = "identified", stage: str | None = None
    ) -> float:
        """Return one number.

        Parameters
        ----------
        name
            Name of the metric; `seatrial-results metrics` lists them.
        dof
            surge, sway, yaw, position, heading or all.
        model
            identified, nominal, plant or mean_motion.
        stage
            identification, validation or deployment, if several have the metric.

        Returns
        -------
        float
            The value in the unit of the metric; NaN if it has none.

        Raises
        ------
        ConfigurationError
            The run has no such number, or several.
        """
        frame = self.metrics
        same = frame[frame["name"] == name]
        rows = same[(same["dof"] == dof) & (same["model"] == model)]
        rows = rows if stage is None else rows[rows["stage"] == stage]
        if len(rows) != 1:
            known = sorted({f"{d} of {m}" for d, m in zip(same["dof"], same["model"], strict=True)})
            raise ConfigurationError(
                f"run {self.number}: got {len(rows)} numbers {name} with dof {dof} of model {model}"
                f", expected one; it has {', '.join(known) or 'no such metric'}"
            )
        value = rows["value"].iloc[0]
        return float("nan") if value is None else float(value)

    @overload
    def plot(self, kind: str, ax: None = None, **options: Unpack[PlotArguments]) -> "Figure": ...
    @overload
    def plot(self, kind: str, ax: "Axes", **options: Unpack[PlotArguments]) -> "Axes": ...
    def plot(
        self, kind: str, ax: "Axes | None" = None, **options: Unpack[PlotArguments]
    ) -> "Figure | Axes":
        """Draw a figure of this run; see `Logbook.plot`."""
        chosen = PlotArguments(**{**options, "run": self.number})
        return self.logbook.plot(kind, ax, **chosen)

    def details(self) -> list[Table]:
        """Return everything that is stored, as `seatrial-results show` prints it."""
        with self.logbook.opened() as results:
            return [Table(grid) for grid in compare.runs.run_details(results, self.number)]

    @property
    def command(self) -> str:
        """The command of the shell that repeats the run."""
        with self.logbook.opened() as results:
            return compare.runs.command_of(results, self.number)

    def _detail(self) -> "RunDetail":
        with self.logbook.opened() as results:
            return results.reader.run(self.number)

    def _summary(self) -> TextTable:
        """The main metrics of the run, nominal beside identified, with its warnings as notes."""
        with self.logbook.opened() as results:
            summary = results.reader.run(self.number).summary
            stored = results.reader.metrics(self.number)
            diagnostics = results.reader.diagnostics(self.number)
        numbers = {(row.name, row.dof, row.model): row for row in stored}
        rows = []
        for metric in METRICS:
            pair = [numbers.get((metric.name, metric.headline, model)) for model in MODELS]
            if metric.headline and any(pair):
                unit = next(row.unit for row in pair if row)
                values = [row.value if row else None for row in pair]
                rows.append([metric.label, metric.headline, unit, *values])
        choices = ", ".join(getattr(summary, group) for group in GROUPS)
        title = f"run {self.number}, {summary.status}: {choices}, seed {summary.seed}"
        notes = [summary.error] if summary.error else []
        notes += [row.label for row in diagnostics if row.name == "warning" and row.label]
        return grid_of(title, ("metric", "dof", "unit", *MODELS), rows, 3, notes)

    def __repr__(self) -> str:
        return Table(self._summary()).text()

    def _repr_html_(self) -> str:
        return Table(self._summary()).text("html")


MODELS = ("nominal", "identified")


def _rows(record: type[Any], rows: Sequence[Any]) -> "pd.DataFrame":
    """Return records as a frame, which has its columns also without a row."""
    return pd.DataFrame(list(map(asdict, rows)), columns=[field.name for field in fields(record)])
