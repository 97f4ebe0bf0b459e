"""The gallery of the guide: every figure of `seatrial-results plot`, drawn from small sweeps.

`python -m docs.gallery` runs the sweeps of `SWEEPS`, about two minutes, and draws into
results/docs/gallery; trials that are stored are not run again. `python -m docs.gallery track`
draws one figure. `make docs` calls it first.
"""

import re
import shlex
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import chdir, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

from docs.pages.markdown import prose
from seatrial.runner.compare.__main__ import run as results_program
from seatrial.runner.compare.figures import figures

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "results" / "docs"
BENCHMARK = Path("results", "benchmark")
DRAWN = RESULTS / "gallery"
ABSENT = {"benchmark": "Drawn by `make gallery` after `make benchmark`."}
LARGEST = 200_000  # bytes of a figure in SVG; a larger one is shown as PNG
LINE = 74  # characters of a command on the page
WORD = re.compile(r"(?:[^\s'\"]|'[^']*'|\"[^\"]*\")+")

_FERRY = "'disturbance=noise,[wind,noise]' 'seed=range(0,3)' identifier.bootstrap=null"
_ROUTE = (
    "'excitation.route.area=[[0,0],[60,0],[60,40],[0,40]]'"
    " 'excitation.route.obstacles=[[[15,10],[30,10],[30,20],[15,20]]]'"
    " 'excitation.route.start=[5,5,0]' 'excitation.route.goal=[55,35,90]'"
)
_SURGE = (
    "vessel=surge_linear excitation=single_sine disturbance=noise controller=none evaluation=none"
)
# Command lines without the program's name; each has a logbook of its own in results/docs.
SWEEPS: Mapping[str, str] = {
    "ferry": f"-m --variant identifier=none --variant identifier=plsr --variant"
    f" 'identifier=ls identifier.basis=physical' {_FERRY}",
    "surface": "identifier=surface_plsr identifier.bootstrap=null disturbance=noise"
    " evaluation=none",
    "front": f"{_SURGE} identifier=nsga2 identifier.population=40 identifier.generations=20",
    "subspace": "vessel=supply_vessel excitation=prbs excitation.length_s=1440 sample_time_s=1"
    " integration_step_s=1 'disturbance=[noise,process]' identifier=dsr identifier.period_s=1"
    " controller=none evaluation=none",
    "positioning": "-m experiment=positioning controller=lqi,mpc_integral,mpc_condensed seed=0",
    "mix": f"vessel=modulus_ship excitation=optimal_design excitation.length_s=60 controller=none"
    f" evaluation=none identifier=iv {_ROUTE}",
    "zigzag": "vessel=kvlcc2 excitation=rudder_zigzag identifier=none controller=none"
    " evaluation=none",
    "benchmark": "benchmark",  # of `make benchmark`, which takes long: only drawn here
}


@dataclass(frozen=True)
class Entry:
    """A figure: the sweep that it shows, the options of `plot`, and what to look at."""

    sweep: str
    look: str
    options: str = ""


ENTRIES: Mapping[str, Entry] = {
    "bars": Entry(
        "ferry",
        "Every point is a seed. Compare identifiers within a weather, not across weathers.",
        "--metric e_pos_mae",
    ),
    "coefficients": Entry(
        "ferry",
        "An interval that does not cross the line of equality misses the true coefficient. Dashed"
        " intervals are of the estimate only.",
        "--where 'seed=0 and disturbance=noise'",
    ),
    "critical_difference": Entry(
        "benchmark",
        "Entrants joined by a bar do not differ significantly on these tasks.",
        f"--database {BENCHMARK}/results.db",
    ),
    "errors": Entry("ferry", "Tracking errors of the nominal and of the identified model."),
    "excitation": Entry(
        "subspace",
        "Where the spectrum is empty, nothing is learnt about the vessel; the order of a subspace"
        " model is where the singular values fall off.",
    ),
    "manoeuvre": Entry("zigzag", "The measures of the sheet, marked on the track."),
    "orders": Entry(
        "ferry",
        "PLSR alone: the error flattens where further components explain noise.",
        "--where identifier=plsr",
    ),
    "pareto": Entry("front", "The trade-off between the errors of pose and velocity."),
    "prediction": Entry(
        "ferry", "A free run of the held-out part: the vessel is simulated from its forces alone."
    ),
    "residual": Entry("ferry", "The force residual of a good model looks like noise."),
    "response": Entry(
        "positioning",
        "Pose, command and limits. With a preview the vessel begins to move before the set-point"
        " does.",
        "--rows controller",
    ),
    "surface": Entry("surface", "Error over order and number of terms; the choice is marked."),
    "track": Entry(
        "mix", "The hull to scale; a mix is drawn on its planned path, clear of the obstacle."
    ),
}


def entry_of(name: str) -> Entry:
    """The entry of a figure; one that has none is drawn from the ferry's sweep."""
    return ENTRIES.get(name, Entry("ferry", ""))


def plot_command(name: str) -> str:
    """What draws a figure, as a user types it."""
    options = entry_of(name).options
    return f"seatrial-results plot {name}{' ' if options else ''}{options}"


def drawn() -> list[Path]:
    """The figures that are drawn."""
    return sorted(DRAWN.glob("*--*.*"))


def page() -> str:
    """The section of every figure: what to look at, the commands, and the figure."""
    return "\n".join(map(_section, figures()))


def _section(name: str) -> str:
    entry, figure = entry_of(name), figures()[name]
    pictures = [path for path in drawn() if path.stem.partition("--")[0] == name]
    shown = [f"![{figure.help}](gallery/{path.name})" for path in pictures]
    if not shown:
        shown = [f"*{ABSENT.get(entry.sweep, '`make gallery` draws it.')}*"]
    return "\n\n".join(
        [
            f"## {name}",
            f"{prose(figure.help)} {entry.look} It needs {prose(figure.needs)}.",
            f"```console\n$ {_wrapped('seatrial ' + SWEEPS[entry.sweep])}\n"
            f"$ {_wrapped(plot_command(name))}\n```",
            *shown,
            "",
        ]
    )


def _wrapped(command: str) -> str:
    """A command on several lines, as a shell continues it."""
    lines = [""]
    for word in WORD.findall(command):
        if len(lines[-1]) + len(word) > LINE:
            lines.append("     ")
        lines[-1] += f" {word}"
    return " \\\n".join(lines).strip()


def run(words: Sequence[str]) -> None:
    """Run a shell line of this project; its output is shown if it fails."""
    line = " ".join(words)
    done = subprocess.run(line, shell=True, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{line}\n{done.stdout}{done.stderr}")


def available(name: str) -> bool:
    """Whether there are data for a figure."""
    sweep = entry_of(name).sweep
    stored = (ROOT / BENCHMARK / "results.db").exists()
    return sweep != "benchmark" or stored


def sail(sweep: str) -> None:
    """Run a sweep; trials that are stored are not run again."""
    if sweep == "benchmark":
        return
    run([sys.executable, "-m runner", SWEEPS[sweep], f"results_dir={RESULTS / sweep}"])


def draw(name: str) -> None:
    """Draw a figure of its sweep, in place of what was drawn before."""
    folder = RESULTS / entry_of(name).sweep
    output = folder / "figures" / name
    for old in (*output.glob("*"), *DRAWN.glob(f"{name}--*.*")):
        old.unlink()
    words = [*shlex.split(plot_command(name))[1:], "--output", str(output)]
    if "--database" not in words:
        words += ["--database", f"{folder}/results.db"]
    with chdir(ROOT), redirect_stdout(StringIO()):
        code = results_program(words)
    if code:
        sys.exit(f"{plot_command(name)}: exit code {code}")
    DRAWN.mkdir(parents=True, exist_ok=True)
    path = min(output.glob("*.svg"))
    if path.stat().st_size > LARGEST:
        path = path.with_suffix(".png")
    (DRAWN / f"{name}--{path.name}").write_bytes(path.read_bytes())


def main(names: Sequence[str]) -> None:
    """Draw the named figures, by default all for which there are data."""
    chosen = [name for name in names or figures() if available(name)]
    for sweep in dict.fromkeys(entry_of(name).sweep for name in chosen):
        sail(sweep)
    for name in chosen:
        draw(name)
        print(name, flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
