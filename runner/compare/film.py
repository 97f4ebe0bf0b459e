"""GIF and MP4 files of an animated run, drawn by matplotlib."""

import shutil
from pathlib import Path

import numpy as np
from matplotlib.animation import FFMpegWriter, PillowWriter
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon

from seatrial.models.errors import ConfigurationError
from seatrial.runner.compare.plots import style
from seatrial.runner.compare.plots.hull import outline
from seatrial.runner.compare.scene import Sail, Scene

FRAMES_PER_S = 15
INCHES, DPI = 5.0, 100
COLOURS = {"thrust": style.PALETTE[2], "moment": style.PALETTE[3], "rudder": style.REFERENCE}


def write(scene: Scene, path: Path) -> None:
    """Write a GIF or MP4 file; raises ConfigurationError for MP4 without ffmpeg."""
    if path.suffix.lower() == ".mp4" and shutil.which("ffmpeg") is None:
        raise ConfigurationError(
            f"--to: {path} needs the program ffmpeg, which is not installed; expected .gif or .html"
        )
    writer = (FFMpegWriter if path.suffix.lower() == ".mp4" else PillowWriter)(fps=FRAMES_PER_S)
    with style.drawn():
        sheet, panels = style.panels(1, len(scene.sails), INCHES, INCHES)
        ships = [_Ship(axes, sail, scene) for axes, sail in zip(panels, scene.sails, strict=True)]
        style.headed(sheet, panels, scene.title)
        style.footnote(sheet, scene.notes)
        with writer.saving(sheet, str(path), DPI):
            for frame in range(max(len(sail.t) for sail in scene.sails)):
                for ship in ships:
                    ship.move(frame)
                writer.grab_frame()


class _Ship:
    """The moving lines of a panel."""

    def __init__(self, axes: Axes, sail: Sail, scene: Scene) -> None:
        self.axes, self.sail, self.length = axes, sail, scene.length
        if sail.reference is not None:
            axes.plot(
                *sail.reference.T, "--", color=style.REFERENCE, linewidth=0.9, label="reference"
            )
        (self.track,) = axes.plot([], [], color=sail.colour, label=sail.name)
        self.hull = Polygon(np.zeros((5, 2)), closed=True, facecolor="white", edgecolor=sail.colour,
                            zorder=3)  # fmt: skip
        axes.add_patch(self.hull)
        self.lines: list[Line2D] = []
        for part in sail.parts:
            width = 2.6 if part.kind == "rudder" else 1.6
            line = axes.plot([], [], color=COLOURS[part.kind], linewidth=width, zorder=4)
            line[0].set_label(part.kind)
            self.lines += line
        axes.set_xlim(*scene.east)
        axes.set_ylim(*scene.north)
        axes.set_aspect("equal", adjustable="box")
        axes.set_xlabel("East [m]")
        axes.set_ylabel("North [m]")

    def move(self, frame: int) -> None:
        """Show a frame; a shorter voyage stays at its end."""
        sail, i = self.sail, min(frame, len(self.sail.t) - 1)
        north, east, psi = float(sail.north[i]), float(sail.east[i]), float(sail.psi[i])
        self.track.set_data(sail.east[: i + 1], sail.north[: i + 1])
        self.hull.set_xy(outline(north, east, psi, self.length))
        for line, part in zip(self.lines, sail.parts, strict=True):
            line.set_data(*part.in_plane(north, east, psi, i).T)
        self.axes.set_title(f"{sail.t[i]:.0f} s", loc="left")
