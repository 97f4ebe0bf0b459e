"""Response to set-points over time, three panels for each axis: pose, force and wind force.

The layout is that of Bargouth (2022), sections 4.3 to 4.7: set-point and output, input, wind.
A steered vessel has panels of its heading, and of every input with its limits.
"""

from collections.abc import Mapping, Sequence

import matplotlib.figure
import numpy as np
from matplotlib.axes import Axes

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.frame import Queries, StoredRun
from seatrial.runner.compare.grid import with_unit
from seatrial.runner.compare.plots.excitation import commanded_signals
from seatrial.runner.compare.plots.request import PREFIX, PlotRequest, degrees, each_run
from seatrial.runner.compare.plots.style import (
    MODEL_COLOURS,
    MUTED,
    PALETTE,
    REFERENCE,
    SHOWN_LIMIT,
    Drawing,
    draw_limit,
    footnote,
    headed,
    largest_of,
    limits_of,
    panels,
    prefixed,
)
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.record.rows import Series
from seatrial.runner.vocabulary import Config

FIGURE = Figure(
    "response",
    "Set-points, pose, force and wind of one run over time.",
    "series deployment_*",
    caption="Response of the newest deployed run",
    each="dof",
    place=10,
)

POSES = {"surge": "x", "sway": "y", "heave": "z", "roll": "phi", "pitch": "theta", "yaw": "psi"}
NAMES = {
    "surge": "North",
    "sway": "East",
    "heave": "Down",
    "roll": "Roll",
    "pitch": "Pitch",
    "yaw": "Heading",
}
MODELS = ("nominal", "identified", "adaptive")
COLOURS = MODEL_COLOURS | {"adaptive": PALETTE[3]}
DIFFERENT_SHARE = 0.01  # share of samples in which equal signals may differ
NOTE = (
    "positions in north and east, forces in the vessel's axes; dashed: set-point; "
    "dotted: reference, if it differs from the set-point"
)


def drawings(results: Queries, request: PlotRequest) -> list[Drawing]:
    """Draw one figure of one run (with --facet, for each level): panels by axis, every model."""
    runs = each_run(results, request, [PREFIX + model for model in MODELS])
    return [_drawing(results, request, run, kinds) for run, kinds in runs]


def _drawing(
    results: Queries, request: PlotRequest, run: StoredRun, kinds: Sequence[str]
) -> Drawing:
    names = [kind.removeprefix(PREFIX) for kind in kinds]
    if run.levels["identifier"] == "none":  # the identified model is the nominal one
        names = [name for name in names if name != "identified"] or names
    voyages = {name: results.reader.series(run.id, PREFIX + name) for name in names}
    lines = {f"{name} model": voyage for name, voyage in voyages.items()}
    config, colours = results.reader.run(run.id).config, [COLOURS[name] for name in names]
    if all(map(is_steered, lines.values())):
        figure, note = steered(lines, config, colours, request.dofs, f"run {run.id}"), STEERED_NOTE
    else:
        figure = overlaid(lines, request, colours, f"run {run.id}", limits_of(config))
        note = NOTE
    factors = ("vessel", "disturbance", "identifier", "controller", "evaluation")
    chosen = [run.levels[name] for name in factors if run.levels[name] != "none"]
    title = f"Response, run {run.id}: {', '.join(chosen)}, seed {run.levels['seed']}"
    headed(figure, figure.axes, title)
    footnote(figure, [note])
    return Drawing(f"response-run-{run.id}", figure)


def overlaid(
    lines: Mapping[str, Series],
    request: PlotRequest,
    colours: Sequence[str],
    what: str,
    limits: Mapping[str, float],
) -> matplotlib.figure.Figure:
    """Draw missions in the same axes, one column for each DOF: pose, force and wind, if any.

    `lines` are the series by label, `limits` the largest forces [N, Nm] by DOF; `what` names the
    figure in the error message.
    """
    first = next(iter(lines.values()))
    dofs = request.shown(lambda dof: all(f"tau_{dof}" in s.columns for s in lines.values()))
    if not dofs:
        raise ConfigurationError(f"plot: {what} has no response of these degrees of freedom")
    has_wind = any(f"wind_{dof}" in first.columns for dof in dofs)
    rows = 3 if has_wind else 2
    figure, axes = panels(rows, len(dofs), max(4.3, 7.0 / len(dofs)), 2.1, share_x=True)
    for column, dof in enumerate(dofs):
        pose, force, *wind = axes[column :: len(dofs)]
        _reference(pose, first, dof)
        _missions(pose, force, lines, dof, colours)
        unit, size, peak = _forces(lines, dof)
        if (limit := limits.get(dof)) is not None:
            draw_limit(force, limit, peak, unit, size)
        for panel in wind:
            _wind(panel, first, dof)
        axes[(rows - 1) * len(dofs) + column].set_xlabel(with_unit("Time", first.units["t"]))
    for panel in axes:
        panel.margins(x=0)
    return figure


def _forces(lines: Mapping[str, Series], dof: str) -> tuple[str, float, float]:
    """Return the unit of the forces, its size, and the largest force [N, Nm]."""
    series_of = list(lines.values())
    peak = largest_of([series.columns[f"tau_{dof}"] for series in series_of])
    return *prefixed(series_of[0].units[f"tau_{dof}"], peak), peak


def _missions(
    pose: Axes, force: Axes, lines: Mapping[str, Series], dof: str, colours: Sequence[str]
) -> None:
    """Draw pose and force of each mission; the first ones are thicker, to be seen below others."""
    unit, size, _ = _forces(lines, dof)
    for i, ((label, series), colour) in enumerate(zip(lines.items(), colours, strict=True)):
        signals = {pose: _pose(series, POSES[dof]), force: series.columns[f"tau_{dof}"] / size}
        width = 1.1 + 0.45 * (len(lines) - 1 - i)
        for panel, signal in signals.items():
            panel.plot(series.columns["t"], signal, color=colour, linewidth=width, label=label)
    force.set_ylabel(with_unit(f"Force, {dof}", unit))


def _pose(series: Series, name: str) -> Sample:
    """Return a pose component over time, shape (n,), angles in degrees."""
    values = np.asarray(series.columns[name], dtype=np.float64)
    return degrees(values) if series.units[name] == "rad" else values


def _reference(axes: Axes, series: Series, dof: str) -> None:
    """Draw the set-point, and the reference if it differs from it."""
    name, t = POSES[dof], series.columns["t"]
    setpoint_name = f"{name}_setpoint" if f"{name}_setpoint" in series.columns else f"{name}_d"
    setpoint, reference = _pose(series, setpoint_name), _pose(series, f"{name}_d")
    axes.plot(t, setpoint, "--", color=REFERENCE, linewidth=1.0, label="set-point")
    if (
        np.mean(setpoint != reference) > DIFFERENT_SHARE
    ):  # a step of the reference may be one sample later
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


STEERED_NOTE = "inputs as commanded; dashed: reference"


def is_steered(series: Series) -> bool:
    """Return whether a voyage is commanded by inputs, and has a heading."""
    return "psi" in series.columns and not any(n.startswith("tau_") for n in series.columns)


def steered(
    lines: Mapping[str, Series],
    config: Config,
    colours: Sequence[str],
    dofs: Sequence[str],
    what: str,
) -> matplotlib.figure.Figure:
    """Draw heading and inputs of missions in the same axes; `lines` are the series by label.

    `dofs` are those requested; the figure is the one of yaw. `what` names it in the error message.
    """
    if dofs and "yaw" not in dofs:
        raise ConfigurationError(f"plot: {what} has no response of these degrees of freedom")
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
    for panel in axes:
        panel.margins(x=0)
    return figure
