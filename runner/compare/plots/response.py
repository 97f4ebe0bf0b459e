"""Response to set-points over time, three panels for each axis: pose, force and wind force.

The layout is that of Bargouth (2022), sections 4.3 to 4.7: set-point and output, input, wind.
A steered vessel has panels of its heading, and of every input with its limits. The lines are the
models of one run, or with `--rows controller` the runs of several controllers on one mission.
"""

from collections.abc import Mapping, Sequence
from functools import partial

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
from seatrial.runner.record.vocabulary import DOFS, GROUPS, POSES

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
STEERED_NOTE = "inputs as commanded"
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
    """Draw a column for each DOF, of pose, force and wind; of a steered vessel heading and inputs.

    `lines` are drawn in their colours; vessel and limits are those of `run`.
    """
    series_of, colours = zip(*lines.values(), strict=True)
    first, t_label = series_of[0], with_unit("Time", series_of[0].units["t"])
    dofs = request.shown(lambda dof: all(f"tau_{dof}" in s.columns for s in series_of))
    steered = all(
        "psi" in s.columns and not any(n.startswith("tau_") for n in s.columns) for s in series_of
    )
    if not (dofs or (steered and "yaw" in (request.dofs or ["yaw"]))):
        raise ConfigurationError(
            f"plot response: run {run.id} has no response of these degrees of freedom"
        )
    signals_of = commanded_signals(series_of, results.reader.run(run.id).config, dofs)
    poses, signals = dofs or ["yaw"], [*zip(*signals_of, strict=True)]
    columns, winds = len(poses), any(f"wind_{dof}" in first.columns for dof in dofs)
    rows = 1 + len(signals) // columns + winds
    figure, axes = style.panels(rows, columns, max(4.3, 8.0 / columns), 2.1, share_x=True)
    widths = [1.1 + 0.45 * i for i in reversed(range(len(lines)))]  # the first is seen below others
    looks = [{"color": colour, "label": label, "linewidth": width}
             for label, colour, width in zip(lines, colours, widths, strict=True)]  # fmt: skip
    for panel, dof in zip(axes, poses, strict=False):
        _references(panel, first, dof, steered)
        for series, look in zip(series_of, looks, strict=True):
            panel.plot(series.columns["t"], _pose(series, POSE_OF[dof], steered), **look)
    for panel, own in zip(axes[columns:], signals, strict=False):
        for series, signal, look in zip(series_of, own, looks, strict=True):
            panel.plot(series.columns["t"], signal.commanded, **look)
        heading = f"Force, {own[0].dof}" if own[0].dof else own[0].name
        panel.set_ylabel(with_unit(heading, own[0].unit))
        if own[0].limits is not None:
            peak = style.largest_of([signal.commanded for signal in own])
            style.draw_limits(panel, own[0].limits, peak, own[0].unit)
    for panel, dof in zip(axes[columns + len(signals) :], dofs, strict=False):
        # that of the first run; it hardly depends on the controller
        values = first.columns.get(f"wind_{dof}", np.zeros(0))
        unit, size = style.prefixed(first.units[f"tau_{dof}"], style.largest_of([values]))
        if len(values):
            panel.plot(first.columns["t"], values / size, color=style.MUTED, linewidth=1.0,
                       label="wind")  # fmt: skip
        panel.set_ylabel(with_unit(f"Wind, {dof}", unit))
    for panel in axes[-columns:]:
        panel.set_xlabel(t_label)
    for panel in axes:
        panel.margins(x=0)
    note = STEERED_NOTE if steered else NOTE
    return style.drawing_of(name, figure, axes, title, [note, *notes])


def _pose(series: Series, name: str, unwrapped: bool) -> Sample:
    """Return a pose component over time, shape (n,), angles in degrees."""
    values = np.asarray(series.columns[name], dtype=np.float64)
    if series.units[name] != "rad":
        return values
    return np.asarray(np.degrees(np.unwrap(values) if unwrapped else values))


def _references(axes: Axes, series: Series, dof: str, unwrapped: bool) -> None:
    """Draw the set-point, and the reference if it differs from it."""
    name, t = POSE_OF[dof], series.columns["t"]
    drawn: list[Sample] = []
    for column, label, line in (
        (f"{name}_setpoint", "set-point", "--"), (f"{name}_d", "reference", ":"),
    ):  # fmt: skip
        if column in series.columns:
            values = _pose(series, column, unwrapped)
            # a step of the reference may be one sample later
            if not drawn or np.mean(drawn[0] != values) > DIFFERENT_SHARE:
                axes.plot(t, values, line, color=style.REFERENCE, linewidth=1.0, label=label)
            drawn.append(values)
    unit = "deg" if series.units[name] == "rad" else series.units[name]
    axes.set_ylabel(with_unit(NAMES[dof], unit))
