"""Response to set-points over time, three panels for each axis: pose, force and wind force.

The layout is that of Bargouth (2022), sections 4.3 to 4.7: set-point and output, input, wind.
A steered vessel has panels of its heading, and of every input with its limits. The lines are the
models of one run, or with `--rows controller` the runs of several controllers on one mission.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from seatrial.runner.compare.figures import Figure, PlotRequest, split
from seatrial.runner.compare.frame import FINISHED, LABELS, Queries, StoredRun, ordered, stored_runs
from seatrial.runner.compare.grid import with_unit
from seatrial.runner.compare.plots import selection, style
from seatrial.runner.compare.plots.excitation import commanded_signals
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.record.rows import Series
from seatrial.runner.record.vocabulary import DOFS, POSES

FIGURE = Figure(
    "response",
    "Set-points, pose, force and wind over time: models of one run, or runs that differ in --rows.",
    "series deployment_*", ("run", "rows", "dof", "model", "facet"), rows="model",
    report_rows=("model", "controller"), place=10,
)  # fmt: skip

NAMES = dict(zip(DOFS, ("North", "East", "Down", "Roll", "Pitch", "Heading"), strict=True))
POSE_OF = dict(zip(DOFS, POSES, strict=True))
COLOURS = style.MODEL_COLOURS | {"adaptive": style.PALETTE[3]}
DIFFERENT_SHARE = 0.01  # share of samples in which equal signals may differ
NOTE = (
    "positions in north and east, forces in the vessel's axes; dashed: set-point; "
    "dotted: reference, if it differs from the set-point"
)
Lines = Mapping[str, tuple[Series, str]]  # deployment and colour by label


def drawings(results: Queries, request: PlotRequest) -> list[style.Drawing]:
    """Draw panels by axis, every model of one run (with --facet, of one for each level).

    With another factor as rows, or several, comma-separated, it is the newest run of every level
    that equals the newest run in all other choices, one figure for each facet.
    """
    if request.rows != "model":
        missing = (
            f"plot response: got no two finished runs that differ in {request.rows} only, "
            f"expected a mission that each of them sailed with the {request.model} model"
        )
        return selection.per_facet(_of_levels, missing)(results, request)
    drawn, kinds = list[style.Drawing](), (*selection.DEPLOYMENTS, f"{selection.PREFIX}adaptive")
    for run, series_of in selection.each_run(results, request, kinds):
        voyages, absent = selection.distinct(results, run, series_of)
        lines = {f"{name} model": (voyage, COLOURS[name]) for name, voyage in voyages.items()}
        title = f"Response, {selection.subtitle(run)}, {run.levels['controller']}"
        name = f"response-run-{run.id}"
        drawn.append(_drawing(results, request, run, lines, name, title, absent))
    return drawn


def _of_levels(
    results: Queries, request: PlotRequest, facet: selection.Facet
) -> style.Drawing | None:
    """Draw the newest run of every level, with all other choices as in the newest run."""
    kind, stored = selection.PREFIX + request.model, results.series_columns(facet.condition)
    deployed = [r for r in facet.runs if r.status == FINISHED and kind in stored.get(r.id, ())]
    if not deployed:
        return None
    fixed = [name for name in LABELS if name not in split([request.rows])]
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
        label: (results.reader.series(run.id, kind), style.colour_of(i))
        for i, (label, run) in enumerate(runs.items())
    }
    first = next(iter(runs.values()))
    title = [first.levels[n] for n in ("vessel", "disturbance", "evaluation")]
    title += [*filter(None, [facet.label]), f"seed {first.levels['seed']}"]
    notes = [", ".join(f"{label}: run {run.id}" for label, run in runs.items())]
    absent = [f"{label}: {why}" for label, why in lost.items() if label not in runs]
    notes += [f"not shown: {', '.join(absent)}"] if absent else []
    text = f"Response with the {request.model} model, {', '.join(title)}"
    return _drawing(results, request, first, lines, facet.file("response"), text, notes)


def _drawing(
    results: Queries, request: PlotRequest, run: StoredRun, lines: Lines, name: str, title: str,
    notes: Sequence[str],
) -> style.Drawing:  # fmt: skip
    """Draw a column for each DOF, of pose, force and wind; of a steered vessel heading and inputs.

    `lines` are drawn in their colours; vessel and limits are those of `run`.
    """
    series_of = [series for series, _ in lines.values()]
    first, shared = series_of[0], set.intersection(*({*s.columns} for s in series_of))
    every = {name for series in series_of for name in series.columns}
    steered = "psi" in shared and not any(name.startswith("tau_") for name in every)
    turns = steered and "yaw" in (request.dof or ["yaw"])
    lacking = "" if turns else f"run {run.id} has no response"
    dofs = request.shown(lambda dof: f"tau_{dof}" in shared, lacking)
    signals = commanded_signals(series_of, results.reader.run(run.id).config, dofs)
    poses = dofs or ["yaw"]
    columns, winds = len(poses), [dof for dof in dofs if f"wind_{dof}" in first.columns]
    rows = 1 + len(signals) // columns + bool(winds)
    figure, axes = style.panels(rows, columns, max(4.3, 8.0 / columns), 2.1, share_x=True)

    def draw(panel: Axes, label: str, values_of: Iterable[Sample]) -> None:
        """Draw the values of every line; the first one is thick, to be seen below the others."""
        widths = reversed([1.1 + 0.45 * i for i in range(len(lines))])
        each = zip(lines.items(), values_of, widths, strict=True)
        for (name, (series, colour)), values, width in each:
            curve = style.Curve(series.columns["t"], values, colour, name)
            style.over_time(panel, label, [curve], linewidth=width)

    for panel, dof in zip(axes, poses, strict=False):
        _references(panel, first, dof, steered)
        pose = POSE_OF[dof]
        unit = "deg" if first.units[pose] == "rad" else first.units[pose]
        draw(panel, with_unit(NAMES[dof], unit), (_pose(s, pose, steered) for s in series_of))
    for panel, own in zip(axes[columns:], signals, strict=False):
        heading = f"Force, {own[0].dof}" if own[0].dof else own[0].name
        draw(panel, with_unit(heading, own[0].unit), (signal.commanded for signal in own))
        style.draw_limits(panel, own[0].limits, max(signal.peak for signal in own))
    for panel, dof in zip(axes[columns + len(signals) :], dofs if winds else (), strict=False):
        # that of the first run; it hardly depends on the controller
        values = first.columns.get(f"wind_{dof}", np.full(len(first.columns["t"]), np.nan))
        unit, size = style.prefixed(first.units[f"tau_{dof}"], style.largest_of([values]))
        curve = style.Curve(first.columns["t"], values / size, style.MUTED, "wind")
        style.over_time(panel, with_unit(f"Wind, {dof}", unit), [curve], linewidth=1.0)
    notes = ["inputs as commanded" if steered else NOTE, *notes]
    return style.drawing_of(name, figure, axes, title, notes)


def _pose(series: Series, name: str, unwrapped: bool) -> Sample:
    """Return a pose component over time, shape (n,), angles in degrees."""
    values = np.asarray(series.columns[name], dtype=np.float64)
    if series.units[name] != "rad":
        return values
    return np.asarray(np.degrees(np.unwrap(values) if unwrapped else values))


def _references(axes: Axes, series: Series, dof: str, unwrapped: bool) -> None:
    """Draw the set-point, and the reference if it differs from it."""
    name, drawn = POSE_OF[dof], list[Sample]()
    for end, label, line in (("setpoint", "set-point", "--"), ("d", "reference", ":")):
        if f"{name}_{end}" in series.columns:
            values = _pose(series, f"{name}_{end}", unwrapped)
            # a step of the reference may be one sample later
            if not drawn or np.mean(drawn[0] != values) > DIFFERENT_SHARE:
                look: dict[str, Any] = {"color": style.REFERENCE, "linewidth": 1.0}
                axes.plot(series.columns["t"], values, line, label=label, **look)
            drawn.append(values)
