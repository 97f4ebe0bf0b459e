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
    Turn,
    ZigZagMeasures,
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
        result = measured_sheet(track, recorded.manoeuvre)
    except RecordingError as error:
        raise ConfigurationError(f"plot manoeuvre: run {run.id}: {error}") from error
    if isinstance(result.measures, Turn):
        figure, axes = style.panels(1, 2, 4.4, 4.4)
        _circle(axes[0], track, result.measures)
        _speeds(axes[1], track, result)
        title = f"Turning circle, helm {round(result.measures.helm_deg)} deg"
    else:
        assert isinstance(result.measures, ZigZagMeasures)
        figure, axes = style.panels(1, 1, 7.0, 4.0)
        _zigzag(axes[0], track, result.measures)
        helm, turned = abs(result.measures.helm_deg), result.measures.turn_deg
        title = f"Zig-zag {round(helm)}/{round(turned)}"
    name, title = f"manoeuvre-run-{run.id}", f"{title}, {subtitle(run)}"
    return style.drawing_of(name, figure, axes, title, notes_of(result))


def _circle(axes: Axes, track: Track, measures: Turn) -> None:
    """The track in ship lengths from the execution, the course of the approach upwards."""
    start = measures.execute_s
    course = track.at(track.psi, start)
    ahead, aside = (way / track.length_m for way in way_from(track, start, course))
    axes.plot(aside, ahead, color=style.PALETTE[0], label="track")
    axes.plot(0.0, 0.0, "o", color=style.REFERENCE, markersize=5, label="execution")
    for name, value, after, k in (
        ("advance", measures.advance, measures.time_90_s, 3),
        ("transfer", measures.transfer, measures.time_90_s, 5),
        ("tactical diameter", measures.tactical_diameter, measures.time_180_s, 1),
    ):
        if np.isfinite(value):
            at = track.at(aside, start + after), track.at(ahead, start + after)
            foot = (at[0], 0.0) if name == "advance" else (0.0, at[1])
            label = f"{name} {number_text(value, 3)} L"
            line = zip(foot, at, strict=True)
            axes.plot(*line, color=style.PALETTE[k], linewidth=1.6, label=label)
    axes.margins(0.08)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("Across the approach [L]")
    axes.set_ylabel("Along the approach [L]")


def _speeds(axes: Axes, track: Track, result: Sheet) -> None:
    """Speed over that of the approach, and yaw rate without dimension, over time."""
    t = track.t - (result.measures.execute_s if isinstance(result.measures, Turn) else 0.0)
    rate = np.gradient(track.psi, track.t) * track.length_m / result.speed_m_s
    axes.plot(t, track.speed / result.speed_m_s, color=style.PALETTE[4], label="U / U0")
    axes.plot(t, np.abs(rate), color=style.PALETTE[2], label="|r| L / U0")
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("Time [s]")
    axes.set_ylabel("Speed, yaw rate [-]")


def _zigzag(axes: Axes, track: Track, measures: ZigZagMeasures) -> None:
    """Heading from the course of the approach and helm over time, with the overshoots."""
    start = measures.execute_s[0]
    course = track.at(track.psi, start)
    heading, t = np.degrees(track.psi - course), track.t - start
    axes.plot(t, np.degrees(track.helm), color=style.PALETTE[1], label="helm")
    axes.plot(t, heading, color=style.PALETTE[0], label="heading from the approach")
    for side in (-1.0, 1.0):
        axes.axhline(side * measures.turn_deg, color=style.MUTED, linewidth=0.7, linestyle=":")
    arrow = {"arrowstyle": "<->", "color": style.MUTED, "lw": 0.8, "shrinkA": 0, "shrinkB": 0}
    overshoots = zip(
        measures.execute_s[1:3], measures.overshoot_s, measures.overshoot_deg, strict=False
    )
    for executed, delay, angle in overshoots:
        time = executed - start + delay
        peak = float(np.interp(time, t, heading))
        side = np.sign(peak)
        axes.annotate("", (time, peak), (time, peak - side * angle), arrowprops=arrow)
        axes.annotate(
            f"{number_text(angle, 3)}°", (time, peak), (0, 3 * side), textcoords="offset points",
            fontsize=8, ha="center", va="bottom" if side > 0.0 else "top",
        )  # fmt: skip
    axes.margins(y=0.12)
    axes.set_xlabel("Time from the execution [s]")
    axes.set_ylabel("Helm and heading [deg]")
