"""Flame graphs of a typical trial and a typical sweep: `python -m docs.profiles after [CHECKOUT]`.

pyinstrument samples the main thread every millisecond of wall-clock time, from the start of the
program to its end; the machine code is compiled beforehand. The output is
`docs/profile_trial_after.svg` and `docs/profile_sweep_after.svg`. A box is a function; its width is
the time spent in it and in the functions it calls, which are drawn above it. Boxes that are too
narrow to be visible are left out. Compiled kernels are drawn separately, to the right of the
program, because numba reports them to a profiler without their callers. CHECKOUT is the folder of
another version of the sources.
"""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
COMMANDS = {
    "trial": ("identifier=plsr",),
    "sweep": ("-m", "identifier=ls,plsr", "disturbance=noise"),
}
SEEDS = {"trial": (), "sweep": ("seed=range(0,25)",)}
COLOURS = {  # of a box, by the package of its function
    "seatrial": "#e8945a",
    "Hydra, OmegaConf": "#7fb3d5",
    "SQLAlchemy, SQLite, Arrow": "#8fc7a0",
    "NumPy, SciPy, numba": "#d9c36a",
    "other": "#c9c9c9",
}
PACKAGES = {
    **dict.fromkeys(("models", "runner"), "seatrial"),
    **dict.fromkeys(("hydra", "hydra_plugins", "omegaconf", "antlr4", "yaml"), "Hydra, OmegaConf"),
    **dict.fromkeys(("sqlalchemy", "sqlite3", "pyarrow", "pandas"), "SQLAlchemy, SQLite, Arrow"),
    **dict.fromkeys(("numpy", "scipy", "numba", "llvmlite", "sklearn"), "NumPy, SciPy, numba"),
}
MACHINERY = ("thread", "importlib", "runpy", "pyinstrument", "string")
WIDTH, ROW, MARGIN, LETTER = 1200.0, 17, 10, 6.4  # [px]; LETTER: mean width of a letter
SEEN = 0.003  # share of the total time below which a box is left out

Frame = dict[str, Any]


def profile(arguments: tuple[str, ...], seeds: tuple[str, ...], checkout: Path) -> Frame:
    """The call tree of one run of the program, with results in a temporary folder."""
    with tempfile.TemporaryDirectory() as folder:
        sampled = Path(folder) / "profile.json"
        sampler = ["pyinstrument", "-i", "0.001", "-r", "json", "--show-all", "-o", str(sampled)]
        sampler += ["-p", f"processor_options.filter_threshold={SEEN}"]
        # The first run compiles kernels that are not in the cache yet.
        for program, more in ((), ()), ((*sampler, "-m"), seeds):
            subprocess.run(
                [
                    *(sys.executable, "-m", *program, "runner", *arguments, *more),
                    f"results_dir={folder}/{len(program)}",
                ],
                env={**os.environ, "PYTHONPATH": str(checkout)}, cwd=checkout, check=True,
                capture_output=True,
            )  # fmt: skip
        root: Frame = json.loads(sampled.read_text())["root_frame"]
        return root


def package_of(frame: Frame) -> str:
    """The package of a frame's function: the first folder of its path, or the module."""
    path = str(frame["file_path_short"]).strip("<>").removeprefix("frozen ")
    return path.split("/")[0].split(".")[0]


def name_of(frame: Frame) -> str:
    """The name of a box: module and function."""
    where = str(frame["file_path_short"]).removesuffix(".py").replace("/", ".")
    what = ".".join(filter(None, (frame.get("class_name"), frame["function"])))
    return f"import {where}" if what == "<module>" else f"{where}: {what}"


def boxes(frame: Frame, x: float, depth: int, scale: float) -> Iterator[tuple[float, int, Frame]]:
    """Left edge [px], row and frame of every box; frames that only call another are left out."""
    inner = frame["children"]
    passes = len(inner) == 1 and inner[0]["time"] > 0.98 * frame["time"]
    same = passes and package_of(inner[0]) == package_of(frame)
    hidden = same or package_of(frame) in MACHINERY or frame["function"] in ("[self]", "<lambda>")
    if not hidden and frame["time"] * scale >= SEEN * WIDTH:
        yield x, depth, frame
    for child in inner:
        yield from boxes(child, x, depth + (not hidden), scale)
        x += child["time"] * scale


def box(x: float, y: float, frame: Frame, scale: float, whole_s: float) -> str:
    """One box as SVG, with its name shortened to the width and the full name as a tooltip."""
    width, name, seconds = frame["time"] * scale, name_of(frame), frame["time"]
    colour = COLOURS[PACKAGES.get(package_of(frame), "other")]
    room = int((width - 4) / LETTER)
    short = name if len(name) <= room else f"{name[: room - 1]}…"
    text = f'<text x="{x + 3:.1f}" y="{y + 12}">{escape(short)}</text>' if room >= 4 else ""
    said = f"{name}: {seconds:.3f} s, {seconds / whole_s:.1%}"
    return (
        f'<g><title>{escape(said)}</title><rect x="{x:.1f}" y="{y}" width="{width:.1f}"'
        f' height="{ROW - 1}" fill="{colour}"/>{text}</g>'
    )


def drawn(root: Frame, title: str) -> str:
    """The flame graph as SVG, with the start of the program at the bottom."""
    whole = root["time"]
    scale = (WIDTH - 2 * MARGIN) / whole
    found = list(boxes(root, MARGIN, 0, scale))
    height = (max(depth for _, depth, _ in found) + 4) * ROW + MARGIN
    parts = [
        box(x, height - MARGIN - (depth + 1) * ROW, frame, scale, whole)
        for x, depth, frame in found
    ]
    x = float(MARGIN)
    for name, colour in COLOURS.items():
        parts.append(f'<rect x="{x:.0f}" y="{ROW + 8}" width="11" height="11" fill="{colour}"/>')
        parts.append(f'<text x="{x + 15:.0f}" y="{ROW + 18}">{name}</text>')
        x += 15 + LETTER * len(name) + 20
    body = "\n".join(parts)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:.0f} {height}"'
        ' font-family="sans-serif" font-size="11">\n'
        f'<rect width="100%" height="100%" fill="#fff"/>\n'
        f'<text x="{MARGIN}" y="{ROW}" font-size="14">{escape(title)}</text>\n{body}\n</svg>\n'
    )


def main() -> None:
    """Profile the trial and the sweep, and draw both flame graphs."""
    if len(sys.argv) < 2:
        sys.exit("docs.profiles: expected a name for the figures, such as after")
    state = sys.argv[1]
    checkout = Path(sys.argv[2]).resolve() if len(sys.argv) > 2 else ROOT
    for kind, arguments in COMMANDS.items():
        root = profile(arguments, SEEDS[kind], checkout)
        asked = " ".join((*arguments, *SEEDS[kind]))
        title = f"python -m runner {asked}: {root['time']:.1f} s ({state})"
        (ROOT / "docs" / f"profile_{kind}_{state}.svg").write_text(drawn(root, title))


if __name__ == "__main__":
    main()
