"""Response to set-points over time, three panels for each axis: pose, force and wind force.

The layout is that of Bargouth (2022), sections 4.3 to 4.7: set-point and output, input, wind.
A steered vessel has panels of its heading, and of every input with its limits. The lines are the
models of one run, or with `--rows controller` the runs of several controllers on one mission.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import matplotlib.figure
import numpy as np
from matplotlib.axes import Axes

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.frame import FINISHED, Queries, StoredRun, ordered, stored_runs
from seatrial.runner.compare.grid import with_unit
from seatrial.runner.compare.plots import style
from seatrial.runner.compare.plots.excitation import commanded_signals
from seatrial.runner.compare.plots.request import (
    DEPLOYMENTS,
    PREFIX,
    Facet,
    PlotRequest,
    distinct,
    each_facet,
    each_run,
    parts_of,
)
from seatrial.runner.compare.plots.style import Drawing
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.record.rows import Series
from seatrial.runner.record.vocabulary import DOFS, GROUPS, POSES, Config

FIGURE = Figure(
    "response",
    "Set-points, pose, force and wind over time: models of one run, or runs that differ in --rows.",
    "series deployment_*",
    ("run", "rows", "dof", "model", "facet"),
    caption="Response of the newest deployed run",
    rows="model",
    report_rows=("model", "controller"),
    place=10,
)

NAMES = dict(zip(DOFS, ("North", "East", "Down", "Roll", "Pitch", "Heading"), strict=True))
POSE_OF = dict(zip(DOFS, POSES, strict=True))
COLOURS = style.MODEL_COLOURS | {"adaptive": style.PALETTE[3]}
SHARED_CHOICES = (*GROUPS, "seed")
DIFFERENT_SHARE = 0.01  # share of samples in which equal signals may differ
NOTE = (
    "positions in north and east, forces in the vessel's axes; dashed: set-point; "
    "dotted: reference, if it differs from the set-point"
)
STEERED_NOTE = "inputs as commanded; dashed: reference"
Lines = Mapping[str, tuple[Series, str]]  # deployment and colour by label


def drawings(results: Queries, request: PlotRequest) -> list[Drawing]:
    """Draw panels by axis, every model of one run (with --facet, of one for each level).

    With another factor as rows, or several, comma-separated, it is the newest run of every level
    that equals the newest run in all other choices, one figure for each facet.
    """
    if request.rows == "model":
        runs = each_run(results, request, (*DEPLOYMENTS, f"{PREFIX}adaptive"))
        return [_of_run(results, request, run, series_of) for run, series_of in runs]
    missing = (
        f"plot response: got no two finished runs that differ in {request.rows} only, "
        f"expected a mission that each of them sailed with the {request.model} model"
    )
    return each_facet(results, request, partial(_of_levels, results, request), missing)


def _of_run(
    results: Queries, request: PlotRequest, run: StoredRun, series_of: Mapping[str, Series]
) -> Drawing:
    voyages, absent = distinct(results, run, series_of)
    lines = {f"{name} model": (voyage, COLOURS[name]) for name, voyage in voyages.items()}
    factors = ("vessel", "disturbance", "identifier", "controller", "evaluation")
    chosen = [run.levels[name] for name in factors if run.levels[name] != "none"]
    title = f"Response, run {run.id}: {', '.join(chosen)}, seed {run.levels['seed']}"
    return _drawing(results, request, run, lines, f"response-run-{run.id}", title, absent)


def _of_levels(results: Queries, request: PlotRequest, facet: Facet) -> Drawing | None:
    """Draw the newest run of every level, with all other choices as in the newest run."""
    kind, stored = PREFIX + request.model, results.series_columns(facet.condition)
    deployed = [r for r in facet.runs if r.status == FINISHED and kind in stored.get(r.id, ())]
    if not deployed:
        return None
    fixed = [name for name in SHARED_CHOICES if name not in parts_of(request.rows)]
    last, newest, lost = deployed[-1], dict[str, StoredRun](), dict[str, str]()
    for run in stored_runs(facet.trials):
        if all(run.levels[name] == last.levels[name] for name in fixed):
            label = run.levels[request.rows]
            if run in deployed:
                newest[label] = run
            else:
                unsailed = f"finished without sailing with the {request.model} model"
                lost[label] = unsailed if run.status == FINISHED else run.status
    if len(newest) < 2:
        return None
    runs = {label: newest[label] for label in ordered(newest)}
    lines = {
        label: (results.reader.series(run.id, kind), style.PALETTE[i % len(style.PALETTE)])
        for i, (label, run) in enumerate(runs.items())
    }
    first = next(iter(runs.values()))
    title = [first.levels[n] for n in ("vessel", "disturbance", "evaluation")]
    title += [facet.label] if facet.label else []
    title += [f"seed {first.levels['seed']}"]
    notes = [", ".join(f"{label}: run {run.id}" for label, run in runs.items())]
    absent = [f"{label}: {why}" for label, why in lost.items() if label not in runs]
    notes += [f"not shown: {', '.join(absent)}"] if absent else []
    text = f"Response with the {request.model} model, {', '.join(title)}"
    return _drawing(results, request, first, lines, facet.file("response"), text, notes)


def _drawing(
    results: Queries, request: PlotRequest, run: StoredRun, lines: Lines, name: str, title: str,
    notes: Sequence[str],
) -> Drawing:  # fmt: skip
    """Draw lines in their colours; vessel and limits are those of `run`."""
    config = results.reader.run(run.id).config
    steered = all(
        "psi" in s.columns and not any(n.startswith("tau_") for n in s.columns)
        for s, _ in lines.values()
    )
    note, draw = (STEERED_NOTE, _steered) if steered else (NOTE, _by_force)
    figure = draw(lines, config, request)
    if figure is None:
        raise ConfigurationError(
            f"plot response: run {run.id} has no response of these degrees of freedom"
        )
    for panel in figure.axes:
        panel.margins(x=0)
    return style.drawing_of(name, figure, figure.axes, title, [note, *notes])


def _by_force(
    lines: Lines, config: Config, request: PlotRequest
) -> matplotlib.figure.Figure | None:
    """Draw one column for each DOF: pose, force with its limit [N, Nm] and wind, if any."""
    first, limits = next(iter(lines.values()))[0], style.limits_of(config)
    dofs = request.shown(lambda dof: all(f"tau_{dof}" in s.columns for s, _ in lines.values()))
    if not dofs:
        return None
    rows = 3 if any(f"wind_{dof}" in first.columns for dof in dofs) else 2
    figure, axes = style.panels(rows, len(dofs), max(4.3, 7.0 / len(dofs)), 2.1, share_x=True)
    for column, dof in enumerate(dofs):
        pose, force, *wind = axes[column :: len(dofs)]
        _reference(pose, first, dof)
        peak = style.largest_of([series.columns[f"tau_{dof}"] for series, _ in lines.values()])
        unit, size = style.prefixed(first.units[f"tau_{dof}"], peak)
        for i, (label, (series, colour)) in enumerate(lines.items()):
            look: dict[str, Any] = {"color": colour, "label": label}
            width = 1.1 + 0.45 * (len(lines) - 1 - i)  # the first ones are seen below others
            t, tau = series.columns["t"], series.columns[f"tau_{dof}"] / size
            pose.plot(t, _pose(series, POSE_OF[dof]), linewidth=width, **look)
            force.plot(t, tau, linewidth=width, **look)
        force.set_ylabel(with_unit(f"Force, {dof}", unit))
        if dof in limits:
            ends = -limits[dof] / size, limits[dof] / size
            style.draw_limits(force, ends, peak / size, unit)
        for panel in wind:  # that of the first run; it hardly depends on the controller
            values, unit = first.columns.get(f"wind_{dof}"), first.units[f"tau_{dof}"]
            if values is not None:
                unit, size = style.prefixed(unit, style.largest_of([values]))
                panel.plot(first.columns["t"], values / size, color=style.MUTED, linewidth=1.0,
                           label="wind")  # fmt: skip
            panel.set_ylabel(with_unit(f"Wind, {dof}", unit))
        axes[(rows - 1) * len(dofs) + column].set_xlabel(with_unit("Time", first.units["t"]))
    return figure


def _pose(series: Series, name: str) -> Sample:
    """Return a pose component over time, shape (n,), angles in degrees."""
    values = np.asarray(series.columns[name], dtype=np.float64)
    return style.degrees(values) if series.units[name] == "rad" else values


def _reference(axes: Axes, series: Series, dof: str) -> None:
    """Draw the set-point, and the reference if it differs from it."""
    name, t = POSE_OF[dof], series.columns["t"]
    setpoint_name = f"{name}_setpoint" if f"{name}_setpoint" in series.columns else f"{name}_d"
    setpoint, reference = _pose(series, setpoint_name), _pose(series, f"{name}_d")
    axes.plot(t, setpoint, "--", color=style.REFERENCE, linewidth=1.0, label="set-point")
    # a step of the reference may be one sample later
    if np.mean(setpoint != reference) > DIFFERENT_SHARE:
        axes.plot(t, reference, ":", color=style.MUTED, linewidth=1.0, label="reference")
    unit = "deg" if series.units[name] == "rad" else series.units[name]
    axes.set_ylabel(with_unit(NAMES[dof], unit))


def _steered(lines: Lines, config: Config, request: PlotRequest) -> matplotlib.figure.Figure | None:
    """Draw heading and inputs, the response in yaw; None without it among the DOFs asked for."""
    if request.dofs and "yaw" not in request.dofs:
        return None
    first = next(iter(lines.values()))[0]
    shown = {label: commanded_signals(series, config, ()) for label, (series, _) in lines.items()}
    signals = next(iter(shown.values()))
    figure, (heading, *inputs) = style.panels(1 + len(signals), 1, 8.0, 2.3, share_x=True)
    if "psi_d" in first.columns:
        reference = style.degrees(np.unwrap(first.columns["psi_d"]))
        heading.plot(first.columns["t"], reference, "--", color=style.REFERENCE, label="reference")
    for label, (series, colour) in lines.items():
        t, psi = series.columns["t"], style.degrees(np.unwrap(series.columns["psi"]))
        heading.plot(t, psi, color=colour, label=label)
        for panel, signal in zip(inputs, shown[label], strict=True):
            panel.plot(t, signal.commanded, color=colour, linewidth=1.1)
    heading.set_ylabel("Heading [deg]")
    for i, (panel, signal) in enumerate(zip(inputs, signals, strict=True)):
        panel.set_ylabel(with_unit(signal.name, signal.unit))
        if signal.limits is not None:
            peak = style.largest_of([those[i].commanded for those in shown.values()])
            style.draw_limits(panel, signal.limits, peak, signal.unit)
    figure.axes[-1].set_xlabel(with_unit("Time", first.units["t"]))
    return figure
