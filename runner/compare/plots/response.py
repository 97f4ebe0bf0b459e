"""Response to set-points over time, three panels for each axis: pose, force and wind force.

The layout is that of Bargouth (2022), sections 4.3 to 4.7: set-point and output, input, wind.
A steered vessel has panels of its heading, and of every input with its limits. The lines are the
models of one run, or with `--rows controller` the runs of several controllers on one mission.
"""

from collections.abc import Mapping, Sequence

import matplotlib.figure
import numpy as np
from matplotlib.axes import Axes

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.frame import FINISHED, Queries, StoredRun, ordered, stored_runs
from seatrial.runner.compare.grid import with_unit
from seatrial.runner.compare.plots.excitation import commanded_signals
from seatrial.runner.compare.plots.request import (
    DEPLOYMENTS,
    PREFIX,
    Facet,
    PlotRequest,
    distinct,
    each_run,
    facets,
)
from seatrial.runner.compare.plots.style import (
    MODEL_COLOURS,
    MUTED,
    PALETTE,
    REFERENCE,
    SHOWN_LIMIT,
    Drawing,
    degrees,
    draw_limit,
    drawing_of,
    largest_of,
    limits_of,
    panels,
    prefixed,
)
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.record.rows import Series
from seatrial.runner.record.vocabulary import DOFS, GROUPS, POSES, Config

FIGURE = Figure(
    "response",
    "Set-points, pose, force and wind over time: models of one run, or runs that differ in --rows.",
    "series deployment_*",
    ("run", "rows", "dof", "model", "facet"),
    caption="Response of the newest deployed run",
    each="dof",
    rows="model",
    report_rows=("model", "controller"),
    place=10,
)

NAMES = dict(zip(DOFS, ("North", "East", "Down", "Roll", "Pitch", "Heading"), strict=True))
POSE_OF = dict(zip(DOFS, POSES, strict=True))
COLOURS = MODEL_COLOURS | {"adaptive": PALETTE[3]}
SHARED_CHOICES = (*GROUPS, "seed")
DIFFERENT_SHARE = 0.01  # share of samples in which equal signals may differ
NOTE = (
    "positions in north and east, forces in the vessel's axes; dashed: set-point; "
    "dotted: reference, if it differs from the set-point"
)
STEERED_NOTE = "inputs as commanded; dashed: reference"
Lines = Mapping[str, Series]  # deployments by label


def drawings(results: Queries, request: PlotRequest) -> list[Drawing]:
    """Draw panels by axis, every model of one run (with --facet, of one for each level).

    With another factor as rows, or several, comma-separated, it is the newest run of every level
    that equals the newest run in all other choices, one figure for each facet.
    """
    rows = [name.strip() for name in request.rows.split(",")]
    if rows == ["model"]:
        kinds = (*DEPLOYMENTS, f"{PREFIX}adaptive")
        runs = each_run(results, request, kinds)
        return [_of_run(results, request, run, series_of) for run, series_of in runs]
    own = [_of_levels(results, request, facet, rows) for facet in facets(results, request, rows)]
    drawn = [drawing for drawing in own if drawing is not None]
    if not drawn:
        raise ConfigurationError(
            f"plot response: got no two finished runs that differ in {request.rows} only, "
            f"expected a mission that each of them sailed with the {request.model} model"
        )
    return drawn


def _of_run(results: Queries, request: PlotRequest, run: StoredRun, series_of: Lines) -> Drawing:
    voyages, absent = distinct(results, run, series_of)
    lines = {f"{name} model": voyage for name, voyage in voyages.items()}
    colours = [COLOURS[name] for name in voyages]
    factors = ("vessel", "disturbance", "identifier", "controller", "evaluation")
    chosen = [run.levels[name] for name in factors if run.levels[name] != "none"]
    title = f"Response, run {run.id}: {', '.join(chosen)}, seed {run.levels['seed']}"
    return _drawing(results, request, run, lines, colours, f"response-run-{run.id}", title, absent)


def _of_levels(
    results: Queries, request: PlotRequest, facet: Facet, rows: Sequence[str]
) -> Drawing | None:
    """Draw the newest run of every level, with all other choices as in the newest run."""
    kind, stored = PREFIX + request.model, results.series_columns(facet.condition)
    deployed = [r for r in facet.runs if r.status == FINISHED and kind in stored.get(r.id, ())]
    if not deployed:
        return None
    last = deployed[-1]
    fixed = [name for name in SHARED_CHOICES if name not in rows]
    newest: dict[str, StoredRun] = {}
    lost: dict[str, str] = {}
    for run in stored_runs(facet.trials):
        if all(run.levels[name] == last.levels[name] for name in fixed):
            label = ", ".join(run.levels[name] for name in rows)
            if run in deployed:
                newest[label] = run
            else:
                unsailed = f"finished without sailing with the {request.model} model"
                lost[label] = unsailed if run.status == FINISHED else run.status
    runs = {label: newest[label] for label in ordered(newest)}
    if len(runs) < 2:
        return None
    lines = {label: results.reader.series(run.id, kind) for label, run in runs.items()}
    first = next(iter(runs.values()))
    title = [first.levels[n] for n in ("vessel", "disturbance", "evaluation")]
    title += [facet.label] if facet.label else []
    notes = [", ".join(f"{label}: run {run.id}" for label, run in runs.items())]
    absent = [f"{label}: {why}" for label, why in lost.items() if label not in runs]
    notes += [f"not shown: {', '.join(absent)}"] if absent else []
    return _drawing(
        results, request, first, lines, [PALETTE[i % len(PALETTE)] for i in range(len(lines))],
        facet.file("response"),
        f"Response with the {request.model} model, {', '.join(title)}, seed {first.levels['seed']}",
        notes,
    )  # fmt: skip


def _drawing(
    results: Queries, request: PlotRequest, run: StoredRun, lines: Lines, colours: Sequence[str],
    name: str, title: str, notes: Sequence[str],
) -> Drawing:  # fmt: skip
    """Draw lines in the colours; vessel and limits are those of `run`."""
    config = results.reader.run(run.id).config
    if all(map(_is_steered, lines.values())):
        note, figure = STEERED_NOTE, _steered(lines, config, colours, request.dofs)
    else:
        note, figure = NOTE, _by_force(lines, limits_of(config), colours, request)
    if figure is None:
        raise ConfigurationError(
            f"plot response: run {run.id} has no response of these degrees of freedom"
        )
    for panel in figure.axes:
        panel.margins(x=0)
    return drawing_of(name, figure, figure.axes, title, [note, *notes])


def _by_force(
    lines: Lines, limits: Mapping[str, float], colours: Sequence[str], request: PlotRequest
) -> matplotlib.figure.Figure | None:
    """Draw one column for each DOF: pose, force with its limit [N, Nm] and wind, if any."""
    first = next(iter(lines.values()))
    dofs = request.shown(lambda dof: all(f"tau_{dof}" in s.columns for s in lines.values()))
    if not dofs:
        return None
    rows = 3 if any(f"wind_{dof}" in first.columns for dof in dofs) else 2
    figure, axes = panels(rows, len(dofs), max(4.3, 7.0 / len(dofs)), 2.1, share_x=True)
    for column, dof in enumerate(dofs):
        pose, force, *wind = axes[column :: len(dofs)]
        _reference(pose, first, dof)
        peak = largest_of([series.columns[f"tau_{dof}"] for series in lines.values()])
        unit, size = prefixed(first.units[f"tau_{dof}"], peak)
        for i, ((label, series), colour) in enumerate(zip(lines.items(), colours, strict=True)):
            signals = {
                pose: _pose(series, POSE_OF[dof]),
                force: series.columns[f"tau_{dof}"] / size,
            }
            width = 1.1 + 0.45 * (len(lines) - 1 - i)  # the first ones are seen below others
            for panel, signal in signals.items():
                panel.plot(series.columns["t"], signal, color=colour, linewidth=width, label=label)
        force.set_ylabel(with_unit(f"Force, {dof}", unit))
        if (limit := limits.get(dof)) is not None:
            draw_limit(force, limit, peak, unit, size)
        for panel in wind:
            _wind(panel, first, dof)
        axes[(rows - 1) * len(dofs) + column].set_xlabel(with_unit("Time", first.units["t"]))
    return figure


def _pose(series: Series, name: str) -> Sample:
    """Return a pose component over time, shape (n,), angles in degrees."""
    values = np.asarray(series.columns[name], dtype=np.float64)
    return degrees(values) if series.units[name] == "rad" else values


def _reference(axes: Axes, series: Series, dof: str) -> None:
    """Draw the set-point, and the reference if it differs from it."""
    name, t = POSE_OF[dof], series.columns["t"]
    setpoint_name = f"{name}_setpoint" if f"{name}_setpoint" in series.columns else f"{name}_d"
    setpoint, reference = _pose(series, setpoint_name), _pose(series, f"{name}_d")
    axes.plot(t, setpoint, "--", color=REFERENCE, linewidth=1.0, label="set-point")
    # a step of the reference may be one sample later
    if np.mean(setpoint != reference) > DIFFERENT_SHARE:
        axes.plot(t, reference, ":", color=MUTED, linewidth=1.0, label="reference")
    unit = "deg" if series.units[name] == "rad" else series.units[name]
    axes.set_ylabel(with_unit(NAMES[dof], unit))


def _wind(axes: Axes, series: Series, dof: str) -> None:
    """Draw the wind force of the first run; it hardly depends on the controller."""
    values, unit = series.columns.get(f"wind_{dof}"), series.units[f"tau_{dof}"]
    if values is not None:
        unit, size = prefixed(unit, largest_of([values]))
        axes.plot(series.columns["t"], values / size, color=MUTED, linewidth=1.0, label="wind")
    axes.set_ylabel(with_unit(f"Wind, {dof}", unit))


def _is_steered(series: Series) -> bool:
    """Return whether a voyage is commanded by inputs, and has a heading."""
    return "psi" in series.columns and not any(n.startswith("tau_") for n in series.columns)


def _steered(
    lines: Lines, config: Config, colours: Sequence[str], dofs: Sequence[str]
) -> matplotlib.figure.Figure | None:
    """Draw heading and inputs, the response in yaw; None without it among the DOFs asked for."""
    if dofs and "yaw" not in dofs:
        return None
    first = next(iter(lines.values()))
    shown = {label: commanded_signals(series, config, ()) for label, series in lines.items()}
    signals = next(iter(shown.values()))
    figure, axes = panels(1 + len(signals), 1, 8.0, 2.3, share_x=True)
    heading, *inputs = axes
    if "psi_d" in first.columns:
        reference = degrees(np.unwrap(first.columns["psi_d"]))
        heading.plot(first.columns["t"], reference, "--", color=REFERENCE, label="reference")
    for (label, series), colour in zip(lines.items(), colours, strict=True):
        t = series.columns["t"]
        heading.plot(t, degrees(np.unwrap(series.columns["psi"])), color=colour, label=label)
        for panel, signal in zip(inputs, shown[label], strict=True):
            panel.plot(t, signal.commanded, color=colour, linewidth=1.1)
    heading.set_ylabel("Heading [deg]")
    for i, (panel, signal) in enumerate(zip(inputs, signals, strict=True)):
        panel.set_ylabel(with_unit(signal.name, signal.unit))
        peak = largest_of([those[i].commanded for those in shown.values()])
        if signal.limits is not None and max(map(abs, signal.limits)) <= SHOWN_LIMIT * peak:
            for side in signal.limits:
                panel.axhline(side, color=REFERENCE, linestyle="-.", linewidth=0.9, label="limit")
    axes[-1].set_xlabel(with_unit("Time", first.units["t"]))
    return figure
