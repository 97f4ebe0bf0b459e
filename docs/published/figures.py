"""Figures of the sources, drawn from the newest sweep of their experiments."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from seatrial.models.simulation import metrics
from seatrial.runner.compare.frame import Queries
from seatrial.runner.compare.grid import number_text, with_unit
from seatrial.runner.compare.plots.style import (
    MODEL_COLOURS,
    PALETTE,
    REFERENCE,
    largest_of,
    marker_of,
    panels,
    prefixed,
    titled,
)
from seatrial.runner.compare.plots.surface import COLOURS
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.compare.where import Condition
from seatrial.runner.record.rows import Series

DECADES = 4.0  # range of the colours of an objective below its highest value
MANY_TERMS = 20  # of one panel, which then has the width of the figure


def objective_figure(results: Queries, sweep: int) -> Figure:
    """Hoyer (2021), Figure 7.20: an objective over two parameters, with its minimum and the truth.

    There is a panel for each run. Diagnostics: `topology` (i, j), and `topology_first` (i) and
    `topology_second` (j), the values of the parameters.
    """
    condition = Condition(sweeps=(sweep,))
    runs = results.runs(condition)
    names = ("topology_first", "topology_second", "topology")
    stored = results.diagnostics(names, condition)
    configs = results.configs_of([run.id for run in runs])
    truths = {
        (row.run, f"{row.dof}.{row.metric}"): row.true_value
        for row in results.coefficients(condition).dropna(subset="true_value").itertuples()
        if row.model == "identified"
    }
    chart, axes = panels(-(-len(runs) // 2), 2, 4.7, 3.9, count=len(runs))
    for panel, run in zip(axes, runs, strict=True):
        own = stored[stored["run"] == run.id]
        first, second, z = (own[own["name"] == name] for name in names)
        labels = first["label"].iloc[0], second["label"].iloc[0]
        truth = [truths[run.id, label] for label in labels if (run.id, label) in truths]
        _objective_panel(panel, first, second, z, truth)
        objective = configs[run.id]["identifier.objective"]
        panel.set_title(f"{run.levels['excitation']}, {objective}", loc="left")
        chart.colorbar(panel.collections[0], ax=panel, label="sum of the objectives", pad=0.02)
    note = "colours: logarithmic, down to a ten-thousandth of the highest value"
    return titled(chart, axes, "Objective over two parameters", [note])


def _objective_panel(
    axes: Axes, first: pd.DataFrame, second: pd.DataFrame, z: pd.DataFrame, truth: Sequence[float]
) -> None:
    x, y = (side["value"].tolist() for side in (first, second))
    heights = np.full((len(x), len(y)), np.nan)
    heights[z["i"].to_numpy(int), z["j"].to_numpy(int)] = z["value"]
    high = float(np.nanmax(heights))
    norm = LogNorm(max(high * 10.0**-DECADES, np.finfo(float).tiny), high)
    axes.pcolormesh(
        x, y, np.maximum(heights, norm.vmin or 0.0).T, norm=norm, cmap=COLOURS, shading="nearest",
        rasterized=True,
    )  # fmt: skip
    i, j = np.unravel_index(int(np.nanargmin(heights)), heights.shape)
    axes.plot(x[i], y[j], "o", mfc="none", mec="#D55E00", mew=2.0, ms=13, label="lowest")
    if len(truth) == 2:
        place = [truth[0]], [truth[1]]
        axes.plot(*place, "*", color="black", mec="white", mew=0.6, ms=12, label="true values")
    axes.set_xlabel(with_unit(first["label"].iloc[0], first["unit"].iloc[0]))
    axes.set_ylabel(with_unit(second["label"].iloc[0], second["unit"].iloc[0]))
    axes.grid(visible=False)


def times_figure(results: Queries, sweep: int) -> Figure:
    """Hoyer (2021), Figure 7.21: time of n predictions without JIT, with JIT, and many at once.

    Diagnostics: `prediction_time` (i = n, label = way), which includes the compilation, and
    `prediction_time_compiled`, which does not.
    """
    condition = Condition(sweeps=(sweep,))
    run = results.runs(condition)[-1]
    lines = {"prediction_time": "-", "prediction_time_compiled": ":"}
    rows = results.diagnostics([*lines], Condition(runs=(run.id,)))
    chart, (axes,) = panels(1, 1, 6.5, 4.2)
    axes.set_xscale("log")
    axes.set_yscale("log")
    for k, way in enumerate(rows["label"].unique()):
        for name, line in lines.items():
            points = rows[(rows["name"] == name) & (rows["label"] == way)].sort_values("i")
            axes.plot(
                points["i"].to_numpy(int), points["value"], color=PALETTE[k], marker=marker_of(k),
                linestyle=line, label=way if line == "-" else None,
            )  # fmt: skip
    axes.set_xlabel("Number of predictions")
    axes.set_ylabel("Time [s]")
    note = "solid: with compilation of the machine code; dotted: without"
    return titled(chart, [axes], "Time of predictions", [note])


def scaled_coefficients_figure(results: Queries, sweep: int) -> Figure:
    """Jervan (2020), Figures 4.6, 4.14, 4.16, 4.18 and 4.20: |Theta_pre| of every term.

    A row for each run whose orders were selected on the test half, as in the thesis; a panel for
    each degree of freedom. Diagnostics: `scaled_coefficient` (dof, label) and `selected_order`.
    """
    condition = Condition(sweeps=(sweep,))
    runs = results.runs(condition)
    configs = results.configs_of([run.id for run in runs])
    runs = [run for run in runs if configs[run.id]["identifier.selection"] == "test"]
    stored = results.diagnostics(("scaled_coefficient", "selected_order"), condition)
    stored = stored[stored["run"].isin([run.id for run in runs])]
    dofs = stored.sort_values("run", kind="stable")["dof"].unique().tolist()
    terms = int(stored[stored["dof"] == dofs[0]].groupby("run").size().max())
    abreast = len(dofs) if terms < MANY_TERMS else 1
    width, rows_of = (3.9, len(runs)) if abreast > 1 else (8.0, len(runs) * len(dofs))
    chart, axes = panels(rows_of, abreast, width, 2.6)
    places = [(run, dof) for run in runs for dof in dofs]
    for panel, (run, dof) in zip(axes, places, strict=True):
        rows = stored[(stored["run"] == run.id) & (stored["dof"] == dof)]
        (order,) = rows.loc[rows["name"] == "selected_order", "value"]
        bars = rows[rows["name"] == "scaled_coefficient"]
        panel.bar(range(len(bars)), bars["value"].abs(), color=PALETTE[0])
        panel.set_xticks(range(len(bars)), bars["label"], rotation=90)
        panel.set_title(f"{dof}, {run.levels['identifier']}, order {order:g}", loc="left")
        panel.set_ylabel("|Theta_pre|" if abreast == 1 or dof == dofs[0] else "")
        panel.grid(visible=False, axis="x")
    return titled(chart, axes, "Coefficients between scaled terms and scaled forces")


def iaew_figure(results: Queries, sweep: int) -> Figure:
    """Jervan (2020), Figures 4.38 and 4.39: error times work from the start, of pose and heading.

    The curve without a model is that of the first run; the others are of the identified models.
    """
    runs = results.runs(Condition(sweeps=(sweep,)))
    configs = results.configs_of([run.id for run in runs])
    curves = {"nominal model": _iaew(results, runs[0].id, "nominal")}
    for run in runs:
        lead = ", lead" if configs[run.id]["controller.thruster_lead"] else ""
        name = f"{run.levels['identifier']}, {configs[run.id]['identifier.force']} force{lead}"
        curves[name] = _iaew(results, run.id, "identified")
    chart, axes = panels(1, 2, 4.6, 3.4)
    colours = (MODEL_COLOURS["nominal"], PALETTE[0], *PALETTE[2:])
    for panel, dof, error in zip(axes, ("position", "heading"), ("m", "rad"), strict=True):
        unit, size = prefixed("J", largest_of([curve[dof] for curve in curves.values()]))
        for colour, (label, curve) in zip(colours, curves.items(), strict=False):
            panel.plot(curve["t"], curve[dof] / size, color=colour, label=label)
        panel.set_title(dof, loc="left")
        panel.set_xlabel("Time [s]")
        panel.set_ylabel(with_unit("IAEW", f"{error} {unit} s"))
        panel.set_ylim(bottom=0.0)
        panel.margins(x=0)
    return titled(chart, axes, "Integral absolute error times work over time")


def _iaew(results: Queries, run: int, model: str) -> dict[str, Sample]:
    """Return the IAEW of a deployment over time [s], of position [m J s] and heading [rad J s]."""
    columns = results.reader.series(run, f"deployment_{model}").columns
    tau = np.column_stack([columns[f"tau_{dof}"] for dof in ("surge", "sway", "yaw")])
    nu = np.column_stack([columns[name] for name in ("u", "v", "r")])
    t, power = columns["t"], (metrics.position_power(tau, nu), metrics.heading_power(tau, nu))
    return {
        "t": t,
        "position": metrics.cumulative_iaew(columns["e_pos"], power[0], t[1] - t[0]),
        "heading": metrics.cumulative_iaew(columns["e_psi"], power[1], t[1] - t[0]),
    }


def force_error_figure(results: Queries, sweep: int) -> Figure:
    """Jervan (2020), Figure 4.47: the error of the model beside an unknown constant force.

    Both are magnitudes over surge and sway, on the test half; a panel for each run.
    """
    runs = results.runs(Condition(sweeps=(sweep,)))
    chart, axes = panels(len(runs), 1, 8.0, 2.3, share_x=True)
    for panel, run in zip(axes, runs, strict=True):
        series = results.reader.series(run.id, "residual")
        force = _magnitude(results.reader.series(run.id, "recording"), "force_ned")
        error, left = _magnitude(series, "residual_identified"), series.columns["train"] == 0
        t, mean = series.columns["t"][left], float(np.mean(error[left]))
        colour, label = MODEL_COLOURS["identified"], "mean of |error|"
        panel.plot(t, error[left], color=colour, label="|error|", linewidth=0.9)
        panel.axhline(mean, color=colour, linestyle="--", label=label)
        panel.plot(t, force[left], color=REFERENCE, label="|force|")
        title = f"mean of |error| {number_text(mean, 3)} N, |force| {number_text(force[-1], 3)} N"
        panel.set_title(f"{run.levels['identifier']}: {title}", loc="left")
        panel.set_ylabel("Force [N]")
        panel.set_ylim(bottom=0.0)
        panel.margins(x=0)
    axes[-1].set_xlabel("Time [s]")
    return titled(chart, axes, "Error of the model and the constant force")


def _magnitude(series: Series, name: str) -> Sample:
    """Return the magnitude of a signal over surge and sway."""
    return np.hypot(series.columns[f"{name}_surge"], series.columns[f"{name}_sway"])


SCALED = "Coefficients between scaled terms and scaled forces"
FIGURES: Mapping[str, tuple[str, Callable[[Queries, int], Figure]]] = {
    "jervan_figure_4_14": (SCALED, scaled_coefficients_figure),
    "jervan_table_4_2": (SCALED, scaled_coefficients_figure),
    "jervan_table_4_5": (SCALED, scaled_coefficients_figure),
    "jervan_table_4_12": ("Integral absolute error times work", iaew_figure),
    "jervan_table_4_16": ("Error of the model and the constant force", force_error_figure),
    "hoyer_figure_7_20": ("An objective over two parameters", objective_figure),
    "hoyer_figure_7_21": ("Time of n predictions", times_figure),
}
