"""Turning circles and zig-zags as in the booklet of a ship's trials."""

import numpy as np
from matplotlib.axes import Axes

from seatrial.models.errors import ConfigurationError, RecordingError
from seatrial.runner.compare.figures import Figure
from seatrial.runner.compare.frame import Queries, StoredRun, stored_runs
from seatrial.runner.compare.grid import number_text
from seatrial.runner.compare.manoeuvre_comparison import newest_manoeuvres, notes_of
from seatrial.runner.compare.plots import style
from seatrial.runner.compare.plots.request import PlotRequest, subtitle
from seatrial.runner.export.manoeuvre_tracks import (
    Recorded,
    Sheet,
    Track,
    executions,
    measured_sheet,
    way_from,
)

FIGURE = Figure(
    "manoeuvre",
    "Turning circle or zig-zag of a run, with its measures.",
    "a recording of a manoeuvre of a steered vessel",
    ("run",),
    caption="Manoeuvre",
    place=16,
)


def drawings(results: Queries, request: PlotRequest) -> list[style.Drawing]:
    """Draw the newest run of each vessel and excitation that is a manoeuvre, or one run."""
    newest = newest_manoeuvres(
        results, stored_runs(request.trials(results, [], False)), ("turn", "zigzag")
    )
    drawn = [_drawing(run, recorded) for run, recorded in newest]
    if not drawn:
        raise ConfigurationError(
            "plot manoeuvre: no finished run that matches is a turning circle or a zig-zag"
        )
    return drawn


def _drawing(run: StoredRun, recorded: Recorded) -> style.Drawing:
    track = recorded.track
    try:
        result = measured_sheet(track, recorded.ordered)
    except RecordingError as error:
        raise ConfigurationError(f"plot manoeuvre: run {run.id}: {error}") from error
    helm = round(result.values["helm"])
    if result.manoeuvre == "turn":
        figure, axes = style.panels(1, 2, 4.4, 4.4)
        _circle(axes[0], track, result)
        _speeds(axes[1], track, result)
        title = f"Turning circle, helm {helm} deg"
    else:
        figure, axes = style.panels(1, 1, 7.0, 4.0)
        _zigzag(axes[0], track, result)
        title = f"Zig-zag {abs(helm)}/{round(result.turn_deg or 0.0)}"
    name, title = f"manoeuvre-run-{run.id}", f"{title}, {subtitle(run)}"
    return style.drawing_of(name, figure, axes, title, notes_of(result))


def _circle(axes: Axes, track: Track, result: Sheet) -> None:
    """The track in ship lengths from the execution, the course of the approach upwards."""
    ahead, aside = way_from(track, result.start_s)
    axes.plot(aside, ahead, color=style.PALETTE[0], label="track")
    axes.plot(0.0, 0.0, "o", color=style.REFERENCE, markersize=5, label="execution")
    lines = (
        ("advance", "time to 90 deg", style.PALETTE[3]),
        ("transfer", "time to 90 deg", style.PALETTE[5]),
        ("tactical diameter", "time to 180 deg", style.PALETTE[1]),
    )
    for name, reached, colour in lines:
        value, time = result.values[name], result.start_s + result.values[reached]
        if np.isfinite(value):
            at = track.at(aside, time), track.at(ahead, time)
            foot = (at[0], 0.0) if name == "advance" else (0.0, at[1])
            label = f"{name} {number_text(value, 3)} L"
            line = zip(foot, at, strict=True)
            axes.plot(*line, color=colour, linewidth=1.6, label=label)
    axes.margins(0.08)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("Across the approach [L]")
    axes.set_ylabel("Along the approach [L]")


def _speeds(axes: Axes, track: Track, result: Sheet) -> None:
    """Speed over that of the approach, and yaw rate without dimension, over time."""
    t = track.t - result.start_s
    rate = np.gradient(track.psi, track.t) * track.length_m / result.speed_m_s
    axes.plot(t, track.speed / result.speed_m_s, color=style.PALETTE[4], label="U / U0")
    axes.plot(t, np.abs(rate), color=style.PALETTE[2], label="|r| L / U0")
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("Time [s]")
    axes.set_ylabel("Speed, yaw rate [-]")


def _zigzag(axes: Axes, track: Track, result: Sheet) -> None:
    """Heading from the course of the approach and helm over time, with the overshoots."""
    start = result.start_s
    course = track.at(track.psi, start)
    heading, t = np.degrees(track.psi - course), track.t - start
    axes.plot(t, np.degrees(track.helm), color=style.PALETTE[1], label="helm")
    axes.plot(t, heading, color=style.PALETTE[0], label="heading from the approach")
    for side in (-1.0, 1.0):
        turned = side * (result.turn_deg or 0.0)
        axes.axhline(turned, color=style.MUTED, linewidth=0.7, linestyle=":")
    times = executions(track)[0][1:]
    for name, executed in zip(("first overshoot", "second overshoot"), times, strict=False):
        if name not in result.values:
            break
        angle = result.values[name]
        time = executed - start + result.values[f"{name}, time"]
        peak = float(np.interp(time, t, heading))
        side = np.sign(peak)
        arrow = {"arrowstyle": "<->", "color": style.MUTED, "lw": 0.8, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", (time, peak), (time, peak - side * angle), arrowprops=arrow)
        axes.annotate(
            f"{number_text(angle, 3)}°", (time, peak), (0, 3 * side), textcoords="offset points",
            fontsize=8, ha="center", va="bottom" if side > 0.0 else "top",
        )  # fmt: skip
    axes.margins(y=0.12)
    axes.set_xlabel("Time from the execution [s]")
    axes.set_ylabel("Helm and heading [deg]")
