"""`seatrial next`: what to sail next, for a purpose, from what is known by now."""

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
import yaml

from seatrial.models.errors import ConfigurationError, SeatrialError
from seatrial.models.excitation.helm_sequence import HelmSequence
from seatrial.models.excitation.next_experiment import Purpose
from seatrial.models.excitation.optimal_design import OptimalDesign
from seatrial.models.notation import PLANAR
from seatrial.runner.compare.cli import run_typer
from seatrial.runner.compare.frame import open_results
from seatrial.runner.configuration.config import Trial, build_trial
from seatrial.runner.configuration.invocation import DEFAULT_DATABASE
from seatrial.runner.export.sailing_sheet import Origin, read_waters, write_files
from seatrial.runner.record.vocabulary import GROUPS
from seatrial.runner.sweeps import in_process
from seatrial.runner.trials.next_experiment import (
    Known,
    after_runs,
    candidates_of,
    chosen_node,
    nominal,
    purpose_of,
)
from seatrial.runner.trials.next_plan import ForcePlanner, Sailed, Sea, SteeredPlanner, sequence

app = typer.Typer(name="seatrial next", pretty_exceptions_enable=False, add_completion=False)
HALF_A_SAMPLE = 0.05  # [s]
FOR = (
    "What is to be predicted and half its 90 % interval: tactical_diameter=3%, "
    "first_overshoot=0.5, coefficients=10%, sway.v=5%, FIT=2, e_pos=5%."
)
FAMILIES = ("helm_sequence", "optimal_design")  # of a vessel that is steered, or takes forces


def main(words: Sequence[str]) -> int:
    """Run `seatrial next` with the words that follow it; returns the exit code."""
    return run_typer(app, words)


@app.command("next")
def next_experiment(
    purpose: Annotated[str, typer.Option("--for", help=FOR)],
    after: Annotated[str, typer.Option(help="Numbers of stored runs: 17,18.")] = "",
    vessel: Annotated[str, typer.Option(help="Without runs: its nominal model.")] = "",
    doubt: Annotated[
        float, typer.Option(help="Half the 90 % interval of nominal parameters over their size.")
    ] = 0.2,
    minutes: Annotated[float, typer.Option(help="Time at sea, with joins and return.")] = 15.0,
    area: Annotated[
        Path | None, typer.Option(help="GeoJSON: the area, then what is to be avoided in it.")
    ] = None,
    origin: Annotated[
        str, typer.Option(help="LAT,LON: the area is in degrees; else in metres, x east.")
    ] = "",
    start: Annotated[str, typer.Option(help="NORTH,EAST,HEADING [m, m, deg].")] = "0,0,0",
    clearance_m: Annotated[
        float, typer.Option("--clearance", help="From the edge of the area [m].")
    ] = 0.0,
    output: Annotated[Path, typer.Option(help="Folder of the files.")] = Path("results/next"),
    database: Annotated[str, typer.Option(help="Of the runs.")] = DEFAULT_DATABASE,
) -> None:
    """Choose what to sail next, and write its sheet, its track and its YAML."""
    name, target, percent = _target(purpose)
    where: Origin = None
    if origin:
        lat, lon = _numbers("origin", origin, 2)
        where = lat, lon
    north, east, heading = _numbers("start", start, 3)
    waters = None if area is None else read_waters(area, where, clearance_m)
    sea = Sea(waters, np.array([north, east, np.radians(heading)]), 60.0 * minutes)
    if bool(after) == bool(vessel):
        raise ConfigurationError("next: expected --after RUNS or --vessel NAME")
    trials = _stored(after, database) if after else []
    if trials:
        known = after_runs(trials, _calm(trials[-1].names["vessel"]))
    else:
        known = _nominal(vessel, doubt)
    wanted = purpose_of(known, name, percent, trials[-1] if trials else None)
    now = wanted.width(np.zeros((1, *2 * known.belief.coordinates.shape[1:])))
    source = f"runs {after}" if after else f"nominal model, doubt {100.0 * doubt:g} %"
    text = " ".join([name, wanted.text, f"± {now:.3g} {wanted.unit}"]).replace("  ", " ")
    head = [*_came(trials, wanted, now), f"{known.trial.vessel.name}, {source}: {text}"]
    if now <= target:
        typer.echo("\n".join([*head, f"{target:g} {wanted.unit} reached: nothing is to be sailed"]))
        return
    planner, sailed, widths = _chosen(known, wanted, target, sea)
    told = _sheet(planner, sailed, widths, wanted)
    verdict = f"reached after {sailed.seconds / 60.0:.1f} min"
    if widths[-1] > target:
        best = f"the best that was found is {widths[-1]:.3g} {wanted.unit}"
        verdict = f"is not reached in {minutes:g} min: {best}"
    typer.echo("\n".join([*head, *told, f"{target:g} {wanted.unit} {verdict}"]))
    expected = {f"{name}, {wanted.unit}": float(widths[-1])}
    text = _yaml(known, planner, sailed, expected)
    typer.echo("wrote " + ", ".join(map(str, _written(output, text, planner, sailed, where))))


def _written(
    folder: Path, text: str, planner: SteeredPlanner | ForcePlanner, sailed: Sailed, origin: Origin
) -> list[Path]:
    """Write the YAML and the track; raises ConfigurationError if they cannot be written."""
    assert sailed.motion is not None
    names = [(begin, planner.candidates[number].name) for begin, number in sailed.chosen]
    file = folder / "excitation.yaml"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
        return [file, *write_files(folder, sailed.motion, names, planner.sea.waters, origin)]
    except OSError as error:
        raise ConfigurationError(f"{folder}: cannot be written: {error.strerror}") from error


def _chosen(
    known: Known, wanted: Purpose, target: float, sea: Sea
) -> tuple[SteeredPlanner | ForcePlanner, Sailed, list[float]]:
    """The sequence with its planner and widths; raises ConfigurationError if nothing fits."""
    kind = SteeredPlanner if isinstance(known.trial.excitation, HelmSequence) else ForcePlanner
    planner = kind(known, candidates_of(known), sea)
    told = np.array([known.information(each.motion) for each in planner.candidates])
    sailed, widths = sequence(wanted, target, told, planner, sea.seconds)
    if sailed.motion is None:
        where = "" if sea.waters is None else " and the area"
        raise ConfigurationError(
            f"next: none of {len(planner.candidates)} manoeuvres fits into "
            f"{sea.seconds / 60.0:g} min{where}"
        )
    return planner, sailed, widths


def _target(text: str) -> tuple[str, float, bool]:
    """Name and target of a purpose, and whether it is in percent."""
    match = re.fullmatch(r"\s*([^=]+?)\s*=\s*(\d+\.?\d*|\.\d+)\s*(%?)\s*", text)
    value = 0.0 if match is None else float(match[2])
    if match is None or value <= 0.0:
        raise ConfigurationError(
            f"next: --for {text}: expected PURPOSE=WIDTH, such as FIT=2 or advance=3%"
        )
    return match[1], value, bool(match[3])


def _numbers(option: str, text: str, count: int) -> list[float]:
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
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
    vessels = dict.fromkeys(trial.names["vessel"] for trial in trials)
    if len(vessels) > 1:
        raise ConfigurationError(
            f"next: runs {after} are of {' and '.join(vessels)}, expected one vessel"
        )
    return trials


def _calm(vessel: str, disturbance: str = "calm") -> Trial:
    """A trial of the vessel whose excitation is the family of its candidates."""
    words = [f"vessel={vessel}", f"disturbance={disturbance}", "controller=none", "evaluation=none"]
    for family in FAMILIES:
        try:
            order = in_process.composed([*words, f"excitation={family}"])
            trial = build_trial(order.config, order.names)
        except SeatrialError:
            if family == FAMILIES[-1]:
                raise
            continue
        if trial.vessel.dofs != PLANAR:
            raise ConfigurationError(
                f"next: {vessel} moves in {', '.join(trial.vessel.dofs)}, expected a vessel in "
                f"{', '.join(PLANAR)}"
            )
        return trial
    raise AssertionError


def _nominal(vessel: str, doubt: float) -> Known:
    if not 0.0 < doubt < 1.0:
        raise ConfigurationError(f"next: --doubt {doubt:g}: expected a number between 0 and 1")
    noisy = _calm(vessel, "noise")
    return nominal(replace(noisy, disturbance=type(noisy.disturbance)()), noisy, doubt)


def _came(trials: Sequence[Trial], purpose: Purpose, now: float) -> list[str]:
    """What was expected of the last run beside what came, if anything was."""
    mission = trials[-1].excitation if trials else None
    expected = mission.expected if isinstance(mission, HelmSequence | OptimalDesign) else None
    value = (expected or {}).get(f"{purpose.name}, {purpose.unit}")
    if value is None:
        return []
    return [f"expected ± {value:.3g} {purpose.unit}, came ± {now:.3g} {purpose.unit}"]


def _sheet(
    planner: SteeredPlanner | ForcePlanner,
    sailed: Sailed,
    widths: Sequence[float],
    purpose: Purpose,
) -> Iterator[str]:
    """Lines of times, helm or forces, and the interval expected after each manoeuvre."""
    said, last = list(zip(sorted(sailed.chosen), widths[1:], strict=True)), ""
    for begin, text in _rows(sailed):
        if said and said[0][0][0] <= begin + HALF_A_SAMPLE:
            (_, number), width = said.pop(0)
            title = planner.candidates[number].name
            yield f"{_clock(begin)}  {title}: then ± {width:.3g} {purpose.unit}"
        if text != last:
            yield f"{_clock(begin)}    {text}"
        last = text
    yield f"{_clock(sailed.seconds)}  end"


def _rows(sailed: Sailed) -> Iterator[tuple[float, str]]:
    """Begin [s] of each step of the helm, or phase, and what is done."""
    mission = sailed.mission
    if isinstance(mission, OptimalDesign):
        for edge, phase in zip(mission.schedule.edges, mission.schedule.phases, strict=False):
            yield edge * mission.period_s, phase.kind
        return
    assert isinstance(mission, HelmSequence)
    for begin, step in zip(mission.edges_s, mission.steps, strict=False):
        angle = (
            f"{np.degrees(step.order):.1f} deg" if mission.helm == "delta" else f"{step.order:.4g}"
        )
        text = {
            "hold": f"{mission.helm} {angle}",
            "zigzag": f"{mission.helm} {angle}, to the other side at {step.turn_deg:g} deg",
            "turn": f"{mission.helm} {angle} for a turn by {step.turn_deg:.0f} deg, then straight",
        }[step.kind]
        yield float(begin), text if step.kind != "turn" or step.turn_deg else "straight"


def _clock(seconds: float) -> str:
    return f"{int(seconds // 60):3d}:{seconds % 60:04.1f}"


def _yaml(
    known: Known, planner: SteeredPlanner | ForcePlanner, sailed: Sailed, expected: dict[str, float]
) -> str:
    """The excitation as a file of the group."""
    mission = sailed.mission
    if isinstance(planner, ForcePlanner):
        nodes = planner.nodes([number for _, number in sailed.chosen])
        node: dict[str, Any] = chosen_node(known, nodes, planner.route(), expected)
        node |= {"vessel": "${vessel}", "period_s": "${sample_time_s}", "draw_seed": "${seed}"}
    else:
        assert isinstance(mission, HelmSequence)
        base = known.trial.config["excitation"]
        assert isinstance(base, dict)
        steps = [
            {name: getattr(step, name) for name in type(step).__dataclass_fields__}
            for step in mission.steps
        ]
        pose = list(map(float, mission.start_pose))
        node = {**base, "steps": steps, "start_pose": pose, "expected": expected}
    plain = json.loads(json.dumps(node, default=np.generic.item))  # lists, no aliases
    return "# Chosen by seatrial next.\n" + str(yaml.safe_dump(plain, sort_keys=False, width=100))
