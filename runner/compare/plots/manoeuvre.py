"""Turning circles and zig-zags as in the booklet of a ship's trials."""

import numpy as np
from matplotlib.axes import Axes

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.runner.compare.figures import Figure, PlotRequest
from seatrial.runner.compare.frame import Queries, StoredRun, stored_runs
from seatrial.runner.compare.grid import number_text
from seatrial.runner.compare.manoeuvre_comparison import newest_manoeuvres, notes_of
from seatrial.runner.compare.plots import selection, style
from seatrial.runner.export import manoeuvre_tracks as tracks
from seatrial.runner.export.manoeuvre_tracks import manoeuvre_sheet as sheets

FIGURE = Figure(
    "manoeuvre", "Turning circle or zig-zag of a run, with its measures.",
    "a recording of a manoeuvre of a steered vessel", ("run",), place=16,
)  # fmt: skip


def drawings(results: Queries, request: PlotRequest) -> list[style.Drawing]:
    """Draw the newest run of each vessel and excitation that is a manoeuvre, or one run."""
    runs = stored_runs(selection.trials_of(results, request))
    newest = newest_manoeuvres(results, runs, ("turn", "zigzag"))
    drawn = [_drawing(run, recorded) for run, recorded in newest]
    if not drawn:
        raise ConfigurationError(
            "plot manoeuvre: no finished run that matches is a turning circle or a zig-zag"
        )
    return drawn


def _drawing(run: StoredRun, recorded: tracks.Recorded) -> style.Drawing:
    track, ordered = recorded
    try:
        result = sheets.measured_sheet(track, ordered)
    except RecordingError as error:
        raise ConfigurationError(f"plot manoeuvre: run {run.id}: {error}") from error
    helm = round(result.values["helm"])
    if result.manoeuvre == "turn":
        figure, axes = style.panels(1, 2, 4.4, 4.4)
        _circle(axes[0], track, result)
        t = track.t - result.start_s  # over that of the approach, and without dimension
        rate = np.gradient(track.psi, track.t) * track.length_m / result.speed_m_s
        axes[1].plot(t, track.speed / result.speed_m_s, color=style.PALETTE[4], label="U / U0")
        axes[1].plot(t, np.abs(rate), color=style.PALETTE[2], label="|r| L / U0")
        axes[1].set_ylim(bottom=0.0)
        axes[1].set(xlabel="Time [s]", ylabel="Speed, yaw rate [-]")
        title = f"Turning circle, helm {helm} deg"
    else:
        figure, axes = style.panels(1, 1, 7.0, 4.0)
        _zigzag(axes[0], track, result)
        title = f"Zig-zag {abs(helm)}/{round(result.values['change of heading'])}"
    name, title = f"manoeuvre-run-{run.id}", f"{title}, {selection.subtitle(run)}"
    return style.drawing_of(name, figure, axes, title, notes_of(result))


def _circle(axes: Axes, track: sheets.Track, result: sheets.Sheet) -> None:
    """The track in ship lengths from the execution, the course of the approach upwards."""
    ahead, aside = sheets.way_from(track, result.start_s)
    axes.plot(aside, ahead, color=style.PALETTE[0], label="track")
    axes.plot(0.0, 0.0, "o", color=style.REFERENCE, markersize=5, label="execution")
    lines = {"advance": (90, 3), "transfer": (90, 5), "tactical diameter": (180, 1)}
    for name, (turned_deg, colour) in lines.items():
        value = result.values[name]
        time = result.start_s + result.values[f"time to {turned_deg} deg"]
        if np.isfinite(value):
            x, y = track.at(aside, time), track.at(ahead, time)
            line = ([x, x], [0.0, y]) if name == "advance" else ([0.0, x], [y, y])
            label = f"{name} {number_text(value, 3)} L"
            axes.plot(*line, color=style.PALETTE[colour], linewidth=1.6, label=label)
    axes.margins(0.08)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel="Across the approach [L]", ylabel="Along the approach [L]")


def _zigzag(axes: Axes, track: sheets.Track, result: sheets.Sheet) -> None:
    """Heading from the course of the approach and helm over time, with the overshoots."""
    start, turned = result.start_s, result.values["change of heading"]
    heading = np.degrees(track.psi - track.at(track.psi, start))
    t = track.t - start
    axes.plot(t, np.degrees(track.helm), color=style.PALETTE[1], label="helm")
    axes.plot(t, heading, color=style.PALETTE[0], label="heading from the approach")
    for angle in (-turned, turned):
        axes.axhline(angle, color=style.MUTED, linewidth=0.7, linestyle=":")
    times = sheets.executions(track)[0][1:]
    for name, executed in zip(("first overshoot", "second overshoot"), times, strict=False):
        if name not in result.values:
            break
        angle = result.values[name]
        time = executed - start + result.values[f"{name}, time"]
        peak = float(np.interp(time, t, heading))
        side = np.sign(peak)
        axes.plot([time, time], [peak - side * angle, peak], color=style.MUTED, linewidth=0.8)
        axes.annotate(
            f"{number_text(angle, 3)}°", (time, peak), (0, 3 * side), textcoords="offset points",
            fontsize=8, ha="center", va="bottom" if side > 0.0 else "top",
        )  # fmt: skip
    axes.margins(y=0.12)
    axes.set(xlabel="Time from the execution [s]", ylabel="Helm and heading [deg]")
