"""Film of a run: its hull on the track to scale, with thrust and rudder, models side by side.

matplotlib's writers make the file: an HTML page with a player, a GIF, or an MP4 by ffmpeg. A thrust
is a line whose length is relative to its limit or largest value; a rudder is a blade behind the
stern, to the side to which the ship turns.
"""

import re
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from matplotlib.animation import FFMpegWriter, FuncAnimation, HTMLWriter, PillowWriter
from matplotlib.axes import Axes
from matplotlib.patches import Polygon

from seatrial.models.errors import ConfigurationError, LogbookError
from seatrial.runner.compare.figures import PlotRequest
from seatrial.runner.compare.frame import Queries
from seatrial.runner.compare.plots import selection, style, track
from seatrial.runner.compare.statistics import Sample
from seatrial.runner.record.rows import Series
from seatrial.runner.record.vocabulary import Config

WRITERS = {".html": HTMLWriter, ".gif": PillowWriter, ".mp4": FFMpegWriter}
FRAMES = {".html": 120, ".gif": 120, ".mp4": 300}  # at most
FRAMES_PER_S, INCHES, DPI = 15, 5.0, 100
STERN, BLADE = -0.5, 0.16  # place and length of a rudder [L], longer than a real one, to be seen
ARROW, ARROW_OF_MOMENT = 0.8, 0.6  # length of a line at the limit [L]
LOOKS: Mapping[str, dict[str, Any]] = {
    "thrust": {"color": style.PALETTE[2], "linewidth": 1.6},
    "moment": {"color": style.PALETTE[3], "linewidth": 1.6},
    "rudder": {"color": style.REFERENCE, "linewidth": 2.6},
}
# Signs of the player's buttons, and a page that fits; matplotlib's page loads them from a network.
PAGE_STYLE = """<meta charset="utf-8"><meta name="viewport" content="width=device-width">
<style>.animation, .animation img { max-width: 100%; } .fa { font-style: normal; }
.fa-minus::before { content: "\\2212"; } .fa-plus::before { content: "+"; }
.fa-fast-backward::before { content: "|\\25c0"; } .fa-fast-forward::before { content: "\\25b6|"; }
.fa-step-backward::before { content: "\\2039"; } .fa-step-forward::before { content: "\\203a"; }
.fa-play::before { content: "\\25b6"; } .fa-pause::before { content: "\\2759\\2759"; }
.fa-flip-horizontal::before { content: "\\25c0"; }</style>"""


class DeviceLine(NamedTuple):
    """A device over time, from `start` to `end` [m]: x ahead and y to starboard, shape (n, 2)."""

    kind: Literal["thrust", "moment", "rudder"]
    start: Sample
    end: Sample


def animate(results: Queries, run: int, file: Path | None) -> Path:
    """Write the film of a run and return the path of its file.

    None is a page in the folder of the figures. Raises ConfigurationError for another ending than
    .html, .gif or .mp4, a run without motion in the plane, or MP4 without ffmpeg.
    """
    path = file or results.reader.results_dir / "figures" / f"animation-run-{run}.html"
    form = path.suffix.lower()
    if form not in FRAMES:
        raise ConfigurationError(f"--to: got '{path}', expected the ending .html, .gif or .mp4")
    if form == ".mp4" and shutil.which("ffmpeg") is None:
        raise ConfigurationError(f"--to: {path} needs the program ffmpeg, or expected .gif, .html")
    with style.drawn():
        film = film_of(results, run, FRAMES[form])
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.touch()
            options = {"embed_frames": True} if form == ".html" else {}
            film.save(path, WRITERS[form](FRAMES_PER_S, **options), dpi=DPI)
            if form == ".html":
                text = path.read_text(encoding="utf-8")
                path.write_text(re.sub("<link[^>]*>", lambda _: PAGE_STYLE, text), encoding="utf-8")
        except OSError as error:
            raise LogbookError(f"{path}: cannot write the animation: {error.strerror}") from error
    return path


def film_of(results: Queries, number: int, most: int) -> FuncAnimation:
    """Return the film of a run in at most so many frames: a panel for each of its voyages."""
    config = results.reader.run(number).config  # that there is one
    kinds = (*selection.DEPLOYMENTS, "recording", track.HARBOUR)
    ((run, stored),) = selection.each_run(results, PlotRequest("film", run=number), kinds)
    whole, absent = selection.distinct(results, run, stored)
    selection.in_plane(run, "animate", whole, ("t", "x", "y", "psi"))
    extent = max(float(np.ptp(one.columns[name])) for one in whole.values() for name in ("x", "y"))
    length, note = track.drawn_length(config, extent)
    devices = parts_of([*whole.values()], config.get("vessel") or {}, length)
    notes = [note, "lines from the hull: thrust, relative to the largest or its limit"]
    notes += ["rudder longer than it is"] * any(p.kind == "rudder" for own in devices for p in own)
    sheet, panels = style.panels(1, len(whole), INCHES, INCHES)
    moves = [
        _drawn(axes, name, series, parts, length, stored.get(track.HARBOUR))
        for axes, (name, series), parts in zip(panels, whole.items(), devices, strict=True)
    ]
    limits = np.array([[axes.get_xlim(), axes.get_ylim()] for axes in panels])
    middle, half = np.mean(limits, axis=(0, 2)), 0.5 * np.max(np.ptp(limits, axis=2))
    for axes in panels:  # the same square for all
        axes.set(xlim=middle[0] + [-half, half], ylim=middle[1] + [-half, half], aspect="equal")
    style.drawing_of("film", sheet, panels, f"R{selection.subtitle(run)[1:]}", [*notes, *absent])

    def show(frame: int) -> list[Polygon]:
        return [move(frame) for move in moves]

    show(0)
    sheet.draw_without_rendering()
    sheet.set_layout_engine("none")  # the panels stay where the first frame has them
    count = max(len(one.columns["t"]) for one in whole.values())
    frames = np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))
    return FuncAnimation(sheet, show, frames)


def _drawn(
    axes: Axes, name: str, series: Series, parts: Sequence[DeviceLine], length: float,
    harbour: Series | None,
) -> Callable[[int], Polygon]:  # fmt: skip
    """Draw what stays, and return what moves the vessel to a frame; it stays at its end."""
    t, norths, easts, psis = (series.columns[key] for key in ("t", "x", "y", "psi"))
    wake, corners = track.draw_track(axes, name, series), None
    axes.plot(easts, norths, color=wake.get_color(), alpha=0.25)
    if harbour is not None:
        track.draw_harbour(axes, harbour, series)
        corners = track.hull_of(harbour)
    axes.margins(0.08 + 0.7 * length / max(np.ptp(easts), np.ptp(norths), length))
    axes.set(xlabel="East [m]", ylabel="North [m]")
    hull = Polygon(np.zeros((5, 2)), facecolor="white", edgecolor=wake.get_color(), zorder=3)
    axes.add_patch(hull)
    lines = [axes.plot([], [], label=part.kind, zorder=4, **LOOKS[part.kind])[0] for part in parts]

    def move(frame: int) -> Polygon:
        k = min(frame, len(t) - 1)
        north, east, psi = float(norths[k]), float(easts[k]), float(psis[k])
        wake.set_data(easts[: k + 1], norths[: k + 1])
        hull.set_xy(track.outline(north, east, psi, length, corners))
        for line, part in zip(lines, parts, strict=True):
            ends = np.array([part.start[k], part.end[k]])
            line.set_data(*track.in_ned(ends, north, east, psi).T)
        axes.set_title(f"{t[k]:.0f} s", loc="left")
        return hull

    return move


def parts_of(series_of: Sequence[Series], vessel: Config, length: float) -> list[list[DeviceLine]]:
    """Return the devices of each series on one scale; `length` [m] is that of the drawn hull."""
    if not any(name.startswith("tau_") for name in series_of[0].columns):
        return [list(_inputs(series, vessel, length)) for series in series_of]
    names = [f"tau_{dof}" for dof in ("surge", "sway", "yaw")]
    forces = [  # in total, from amidships, and the moment as a side force at the bow
        np.column_stack([one.columns.get(name, np.zeros(one.n_rows)) for name in names])
        for one in series_of
    ]
    thrust = ARROW * length / (style.largest_of([tau[:, :2] for tau in forces]) or 1.0)
    moment = ARROW_OF_MOMENT * length / (style.largest_of([tau[:, 2] for tau in forces]) or 1.0)
    parts = []
    for tau in forces:
        amidships, bow = np.zeros((len(tau), 2)), np.tile([0.5 * length, 0.0], (len(tau), 1))
        parts.append([DeviceLine("thrust", amidships, thrust * tau[:, :2])])
        if np.any(tau[:, 2]):
            side = np.column_stack([bow[:, 0], moment * tau[:, 2]])
            parts[-1].append(DeviceLine("moment", bow, side))
    return parts


def _inputs(series: Series, vessel: Config, length: float) -> Iterator[DeviceLine]:
    """Rudders, and the thrust of propellers and thrusters where they are."""
    devices = [one for one in (vessel.get("devices") or {}).values() if isinstance(one, Mapping)]
    scale = length / float(vessel.get("length_m") or length)  # of hulls that are drawn larger
    for name, limits in (vessel.get("inputs") or {}).items():
        if name not in series.columns or name.startswith("alpha"):
            continue
        device = next((d for d in devices if name in d.values()), {})
        value = np.asarray(series.columns[name], dtype=np.float64)
        ahead, side = (scale * float(device.get(key) or 0.0) for key in ("x_m", "y_m"))
        start = np.tile([ahead if "x_m" in device else STERN * length, side], (len(value), 1))
        if not name.startswith("delta"):
            high = max(abs(float(limits.get(end) or 0.0)) for end in ("low", "high")) or 1.0
            fixed = np.full_like(value, float(device.get("angle_rad") or 0.0))
            angle = np.asarray(series.columns.get(str(device.get("alpha")), fixed))
            size = ARROW * length / high * value
            thrust = np.column_stack([size * np.cos(angle), size * np.sin(angle)])
            yield DeviceLine("thrust", start, start + thrust)
        elif device.get("kind") != "plane" and not name.endswith("_s"):
            stock = np.tile([STERN * length, 0.0], (len(value), 1))
            blade = np.column_stack([-np.cos(value), turning_side(series, value) * np.sin(value)])
            yield DeviceLine("rudder", stock, stock + BLADE * length * blade)


def turning_side(series: Series, helm: Sample) -> float:
    """Return 1.0 if a positive helm [rad] turns the ship to starboard, else -1.0.

    It is the sign of b of `r_dot = a r + b helm`, fitted by least squares: conventions differ.
    """
    t = series.columns["t"]
    rate = series.columns.get("r", np.gradient(np.unwrap(series.columns["psi"]), t))
    solution = np.linalg.lstsq(np.column_stack([rate, helm]), np.gradient(rate, t), rcond=None)[0]
    return -1.0 if solution[1] < 0.0 else 1.0
