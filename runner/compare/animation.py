"""Animation of a run: its hull on the track to scale, with thrust and rudder, models side by side.

As an HTML page that needs nothing else, as GIF, or as MP4 where ffmpeg is installed.
"""

import json
from pathlib import Path

import numpy as np

from seatrial.models.errors import ConfigurationError, LogbookError
from seatrial.runner.compare.page import render_page, write_page
from seatrial.runner.compare.results import Results
from seatrial.runner.compare.scene import Scene, scene_of
from seatrial.runner.compare.statistics import Sample

FORMATS = (".html", ".gif", ".mp4")
FRAMES = {".html": 900, ".gif": 120, ".mp4": 300}  # at most
WORDS = {"thrust": "thrust", "moment": "yaw moment, at the bow", "rudder": "rudder"}


def animate(results: Results, run: int, file: Path | None) -> Path:
    """Write the animation of a run and return its path.

    The default is an HTML page in the folder of the figures. Raises ConfigurationError for another
    format, a run without motion in the plane, or MP4 without ffmpeg, and LogbookError if the file
    cannot be written.
    """
    path = file or results.reader.results_dir / "figures" / f"animation-run-{run}.html"
    form = path.suffix.lower()
    if form not in FORMATS:
        raise ConfigurationError(
            f"--to: got {str(path)!r}, expected the ending .html, .gif or .mp4"
        )
    scene = scene_of(results, run, FRAMES[form])
    if form == ".html":
        write_page(page_of(scene), path)
        return path
    from seatrial.runner.compare import film

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        film.write(scene, path)
    except OSError as error:
        raise LogbookError(f"{path}: cannot write the animation: {error.strerror}") from error
    return path


def page_of(scene: Scene) -> str:
    """Return the page of a scene; it needs no network."""
    return render_page(
        "animation.html",
        title=scene.title,
        scene=json.dumps(_plain(scene), separators=(",", ":"), allow_nan=False).replace(
            "<", "\\u003c"
        ),
        sails=scene.sails,
        notes=scene.notes,
        kinds=[
            (kind, word)
            for kind, word in WORDS.items()
            if any(part.kind == kind for sail in scene.sails for part in sail.parts)
        ],
    )


def _plain(scene: Scene) -> dict[str, object]:
    """Return the numbers of the page, rounded to a thousandth of the hull."""
    digits = max(0, 3 - int(np.floor(np.log10(scene.length))))
    return {
        "length": scene.length,
        "north": scene.north,
        "east": scene.east,
        "sails": [
            {
                "t": np.round(sail.t, 2).tolist(),
                "x": _rounded(sail.east, digits),
                "y": _rounded(sail.north, digits),
                "psi": _rounded(sail.psi, 4),
                "colour": sail.colour,
                "reference": None
                if sail.reference is None
                else _rounded(sail.reference, digits),
                "parts": [
                    {"kind": part.kind,
                     "at": _rounded(np.hstack([part.start, part.end]), digits)}
                    for part in sail.parts
                ],
            }
            for sail in scene.sails
        ],
    }  # fmt: skip


def _rounded(values: Sample, digits: int) -> list[object]:
    """Return the numbers as a list; what is not finite is 0."""
    return list(np.round(np.nan_to_num(np.asarray(values, dtype=np.float64)), digits).tolist())
