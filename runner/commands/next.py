"""`seatrial next`: what to sail next, for a purpose, from what is known by now.

Its files have positions in metres, x east and y north, or with an origin in degrees.
"""

import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated
from xml.sax.saxutils import escape

import numpy as np
import typer
import yaml

from seatrial.models.errors import ConfigurationError, SeatrialError
from seatrial.models.excitation.helm_sequence import HelmSequence
from seatrial.models.notation import PLANAR
from seatrial.models.planning.harbour import in_metres, shapes_of
from seatrial.models.planning.planner import Waters
from seatrial.models.recording.recording import Recording
from seatrial.models.vessel.basis import Array
from seatrial.runner.compare.cli import run_typer
from seatrial.runner.compare.frame import open_results
from seatrial.runner.configuration.config import Trial, build_trial
from seatrial.runner.configuration.invocation import DEFAULT_DATABASE
from seatrial.runner.record.vocabulary import GROUPS
from seatrial.runner.sweeps import in_process
from seatrial.runner.trials.next_experiment import (
    Sailed,
    SequencePlanner,
    after_runs,
    nominal,
    planner_of,
    purpose_of,
    sequence,
)

if TYPE_CHECKING:
    import pymap3d
    import shapely
else:
    import lazy_loader

    pymap3d = lazy_loader.load("pymap3d")  # slow to import
    shapely = lazy_loader.load("shapely")

app = typer.Typer(name="seatrial next", pretty_exceptions_enable=False, add_completion=False)
HALF_A_SAMPLE = 0.05  # [s]
FOR = (
    "What is to be predicted and half its 90 % interval over its value: tactical_diameter=3%, "
    "first_overshoot=10%, coefficients=10%, sway.v=5%, FIT=2%, e_pos=5%."
)
GPX = "http://www.topografix.com/GPX/1/1"
Origin = tuple[float, ...] | None  # latitude, longitude [deg]


def main(words: Sequence[str]) -> int:
    """Run `seatrial next` with the words that follow it; returns the exit code."""
    return run_typer(app, words)


@app.command("next")
def next_experiment(
    purpose: Annotated[str, typer.Option("--for", help=FOR)],
    after: Annotated[str, typer.Option(help="Numbers of stored runs: 17,18.")] = "",
    vessel: Annotated[str, typer.Option(help="Without runs: its nominal model.")] = "",
    doubt: Annotated[float, typer.Option(help="Half the interval of nominal parameters.")] = 0.2,
    minutes: Annotated[float, typer.Option(help="Time at sea, with joins and return.")] = 15.0,
    area: Annotated[Path | None, typer.Option(help="GeoJSON: area, then what to avoid.")] = None,
    origin: Annotated[str, typer.Option(help="LAT,LON: area in degrees; else in metres.")] = "",
    start: Annotated[str, typer.Option(help="NORTH,EAST,HEADING [m, m, deg].")] = "0,0,0",
    clearance: Annotated[float, typer.Option(help="From the edge of the area [m].")] = 0.0,
    output: Annotated[Path, typer.Option(help="Folder of the files.")] = Path("results/next"),
    database: Annotated[str, typer.Option(help="Of the runs.")] = DEFAULT_DATABASE,
) -> None:
    """Choose what to sail next, and write its sheet, its track and its YAML."""
    match = re.fullmatch(r"\s*([^=]+?)\s*=\s*(\d+\.?\d*|\.\d+)\s*%?\s*", purpose)
    if match is None or not (target := float(match[2])):
        raise ConfigurationError(f"next: --for {purpose}: expected PURPOSE=WIDTH such as FIT=2%")
    where = _numbers("origin", origin, 2) if origin else None
    pose = _numbers("start", start, 3)
    waters = None if area is None else read_waters(area, where, clearance)
    if bool(after) == bool(vessel) or not 0.0 < doubt < 1.0:
        raise ConfigurationError("next: expected --after RUNS, or --vessel NAME and --doubt < 1")
    if after:
        trials, source = _stored(after, database), f"runs {after}"
        known = after_runs(trials, trial_of(trials[-1].names["vessel"]))
    else:
        trials, source = [], f"nominal model, doubt {100.0 * doubt:g} %"
        known = nominal(trial_of(vessel, "noise"), doubt)
    wanted = purpose_of(known, match[1], trials[-1] if trials else None)
    now, expected = wanted.width(), getattr(trials[-1].excitation, "expected", {}) if trials else {}
    lines = [f"{known.trial.vessel.name}, {source}: {wanted.text} ± {now:.3g} %"]
    if (value := (expected or {}).get(wanted.name)) is not None:
        lines.insert(0, f"expected ± {value:.3g} %, came ± {now:.3g} %")
    if now <= target:
        typer.echo("\n".join([*lines, f"{target:g} % reached: nothing is to be sailed"]))
        return
    planner = planner_of(known, waters, pose, 60.0 * minutes)
    told = np.array([known.information(each.motion) for each in planner.candidates])
    sailed, widths = sequence(wanted, target, told, planner)
    best = f"is not reached in {minutes:g} min: the best that was found is {widths[-1]:.3g} %"
    reached = f"reached after {sailed.seconds / 60.0:.1f} min"
    lines += [*_sheet(planner, sailed, widths), f"{target:g} % "]
    typer.echo("\n".join(lines) + (best if widths[-1] > target else reached))
    node = {**planner.node(sailed), "expected": {wanted.name: widths[-1]}}
    marks = [(begin, planner.candidates[number].name) for begin, number in sailed.chosen]
    try:
        files = write_files(output, node, sailed.motion, marks, waters, where)
    except OSError as error:
        raise ConfigurationError(f"{output}: cannot be written: {error.strerror}") from error
    typer.echo("wrote " + ", ".join(map(str, files)))


def _numbers(option: str, text: str, count: int) -> tuple[float, ...]:
    try:
        values = tuple(map(float, text.split(",")))
    except ValueError:
        values = ()
    if len(values) != count:
        raise ConfigurationError(f"next: --{option} {text}: expected {count} numbers with commas")
    return values


def _stored(after: str, database: str) -> list[Trial]:
    """The trials of runs of one vessel."""
    trials = []
    with open_results(database) as results:
        for number in map(int, _numbers("after", after, after.count(",") + 1)):
            run = results.reader.run(number)
            names = {group: str(getattr(run.summary, group)) for group in GROUPS}
            stored = {"database": {"url": None}, "results_dir": "results"}
            trials.append(build_trial({**run.config, **stored}, names))
    if len(vessels := dict.fromkeys(trial.names["vessel"] for trial in trials)) > 1:
        raise ConfigurationError(
            f"next: runs {after} are of {' and '.join(vessels)}, expected one vessel"
        )
    return trials


def trial_of(vessel: str, disturbance: str = "calm") -> Trial:
    """A trial of the vessel whose excitation is the family of its candidates."""
    words = [f"vessel={vessel}", f"disturbance={disturbance}", "controller=none", "evaluation=none"]

    def built(family: str) -> Trial:
        order = in_process.composed([*words, f"excitation={family}"])
        return build_trial(order.config, order.names)

    try:
        trial = built("helm_sequence")
    except SeatrialError:  # it is not steered
        trial = built("optimal_design")
    if trial.vessel.dofs != PLANAR:
        dofs = ", ".join(trial.vessel.dofs)
        raise ConfigurationError(f"next: {vessel} moves in {dofs}, expected surge, sway, yaw")
    return trial


def _sheet(planner: SequencePlanner, sailed: Sailed, widths: Sequence[float]) -> Iterator[str]:
    """Lines of times, helm or phases, and the interval expected after each manoeuvre."""
    mission, said, last = sailed.mission, [*zip(sorted(sailed.chosen), widths[1:], strict=True)], ""
    if isinstance(mission, HelmSequence):
        rows = [*mission.rows()]
    else:
        edges = mission.period_s * np.array(mission.schedule.edges)
        rows = [*zip(edges, (phase.kind for phase in mission.schedule.phases), strict=False)]
    for begin, text in rows:
        if said and said[0][0][0] <= begin + HALF_A_SAMPLE:
            (_, number), width = said.pop(0)
            yield f"{_clock(begin)}  {planner.candidates[number].name}: then ± {width:.3g} %"
        if text != last:
            yield f"{_clock(begin)}    {text}"
        last = text
    yield f"{_clock(sailed.seconds)}  end"


def _clock(seconds: float) -> str:
    return f"{int(seconds // 60):3d}:{seconds % 60:04.1f}"


def read_waters(path: Path, origin: Origin, clearance_m: float) -> Waters:
    """The area of a GeoJSON file: its first polygon; its holes and the others are obstacles.

    Raises ConfigurationError for a file without a polygon, or positions that are no positions.
    """
    try:
        shapes = shapes_of(path.read_text(encoding="utf-8"))[1]
        about = None if origin is None else origin[::-1]
        parts = [part for _, shape in shapes for part in shapely.get_parts(in_metres(shape, about))]
    except (OSError, ConfigurationError) as error:
        raise ConfigurationError(f"{path}: cannot be read: {error}") from error
    rings = [tuple(ring.coords[:-1]) for part in parts if part.geom_type == "Polygon"
             for ring in (part.exterior, *part.interiors)]  # fmt: skip
    if not rings:
        raise ConfigurationError(f"{path}: got no polygon, expected one of the area")
    return Waters(rings[0], rings[1:], clearance_m)


def positions(track: Array, origin: Origin) -> Array:
    """(x, y) of a track (N, 2) of (north, east) [m]: metres, or longitude and latitude [deg]."""
    if origin is None:
        return np.round(track[:, ::-1], 2)
    return np.round(np.column_stack(pymap3d.ned2geodetic(*track.T, 0.0, *origin, 0.0)[1::-1]), 7)


def write_files(
    folder: Path, node: object, motion: Recording, marks: Sequence[tuple[float, str]],
    waters: Waters | None, origin: Origin,
) -> list[Path]:  # fmt: skip
    """Write the excitation and the expected track: GeoJSON, CSV, a figure, GPX with an origin.

    `marks` are the begin [s] and the name of each manoeuvre. Returns the files.
    """
    from matplotlib.figure import Figure  # slow to import

    folder.mkdir(parents=True, exist_ok=True)
    names = ("excitation.yaml", "track.geojson", "track.csv", "track.svg", "track.gpx")
    sheet, shapes, table, picture, gpx = files = [folder / name for name in names]
    plain = json.loads(json.dumps(node, default=np.generic.item))  # lists, no aliases
    text = yaml.safe_dump(plain, sort_keys=False, width=100)
    sheet.write_text(f"# Chosen by seatrial next.\n{text}", encoding="utf-8")
    at = np.searchsorted(motion.t - motion.t[0], [begin for begin, _ in marks])
    begins = motion.eta[np.minimum(at.astype(np.int64), len(motion) - 1), :2]
    track = motion.eta[:: max(1, round(1.0 / motion.period_s)), :2]
    line, points = (positions(each, origin).tolist() for each in (track, begins))
    both = shapely.GeometryCollection([shapely.LineString(line), shapely.MultiPoint(points)])
    shapes.write_text(shapely.to_geojson(both), encoding="utf-8")
    acting = motion.tau if motion.inputs is None else motion.inputs
    own = [f"tau_{dof}" for dof in motion.dofs] if motion.inputs is None else motion.input_names
    values = np.column_stack([motion.t, motion.eta, acting])
    np.savetxt(table, values, "%.6f", ",", header=",".join(("t,north,east,psi", *own)), comments="")
    figure = Figure(figsize=(6.0, 6.0), layout="constrained")
    axes = figure.add_subplot(xlabel="east [m]", ylabel="north [m]", aspect="equal")
    for name, ring in ({} if waters is None else waters.named).items():
        axes.fill(*np.array(ring)[:, ::-1].T, fill=name != "area", color="0.7")
    axes.plot(motion.eta[:, 1], motion.eta[:, 0])
    for i, ((_, name), (north, east)) in enumerate(zip(marks, begins, strict=True), 1):
        axes.plot(east, north, marker=f"${i}$", linestyle="", label=name)
    axes.legend(fontsize="x-small")
    figure.savefig(picture)
    if origin is None:
        return files[:-1]
    way = "".join(f'<wpt lat="{lat}" lon="{lon}"><name>{escape(name)}</name></wpt>'
                  for (lon, lat), (_, name) in zip(points, marks, strict=True))  # fmt: skip
    sailed = "".join(f'<trkpt lat="{lat}" lon="{lon}"/>' for lon, lat in line)
    gpx.write_text(
        f'<?xml version="1.0"?>\n<gpx xmlns="{GPX}" version="1.1" creator="seatrial">{way}'
        f"<trk><trkseg>{sailed}</trkseg></trk></gpx>\n", encoding="utf-8"
    )  # fmt: skip
    return files
