"""`seatrial next`: what to sail next, for a purpose, from what is known by now."""

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
import yaml

from seatrial.models.errors import ConfigurationError, SeatrialError
from seatrial.models.excitation.next_experiment import Purpose
from seatrial.models.notation import PLANAR
from seatrial.runner.compare.cli import run_typer
from seatrial.runner.compare.frame import open_results
from seatrial.runner.configuration.config import Trial, build_trial
from seatrial.runner.configuration.invocation import DEFAULT_DATABASE
from seatrial.runner.export.sailing_sheet import Origin, read_waters, write_files
from seatrial.runner.record.vocabulary import GROUPS
from seatrial.runner.sweeps import in_process
from seatrial.runner.trials.next_experiment import (
    ForcePlanner,
    Known,
    Sailed,
    SteeredPlanner,
    after_runs,
    nominal,
    planner_of,
    purpose_of,
    sequence,
)

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
    where: Origin = (*_numbers("origin", origin, 2),) if origin else None  # type: ignore[assignment]
    pose = np.array(_numbers("start", start, 3)) * (1.0, 1.0, np.pi / 180.0)
    waters = None if area is None else read_waters(area, where, clearance_m)
    if bool(after) == bool(vessel):
        raise ConfigurationError("next: expected --after RUNS or --vessel NAME")
    trials = _stored(after, database) if after else []
    source = f"runs {after}" if after else f"nominal model, doubt {100.0 * doubt:g} %"
    known = _known(trials, vessel, doubt)
    wanted = purpose_of(known, name, percent, trials[-1] if trials else None)
    now, unit = wanted.width(), wanted.unit
    text = " ".join([name, wanted.text, f"± {now:.3g} {unit}"]).replace("  ", " ")
    head = [*_came(trials, wanted, now), f"{known.trial.vessel.name}, {source}: {text}"]
    if now <= target:
        typer.echo("\n".join([*head, f"{target:g} {unit} reached: nothing is to be sailed"]))
        return
    planner = planner_of(known, waters, pose, 60.0 * minutes)
    told = np.array([known.information(each.motion) for each in planner.candidates])
    sailed, widths = sequence(wanted, target, told, planner)
    assert sailed.motion is not None
    verdict = f"reached after {sailed.seconds / 60.0:.1f} min"
    if widths[-1] > target:
        verdict = f"is not reached in {minutes:g} min: the best that was found is "
        verdict += f"{widths[-1]:.3g} {unit}"
    lines = [*head, *_sheet(planner, sailed, widths, unit), f"{target:g} {unit} {verdict}"]
    typer.echo("\n".join(lines))
    node = planner.node(sailed, {f"{name}, {unit}": float(widths[-1])})
    plain = json.loads(json.dumps(node, default=np.generic.item))  # lists, no aliases
    file = output / "excitation.yaml"
    marks = [(begin, planner.candidates[number].name) for begin, number in sailed.chosen]
    try:
        output.mkdir(parents=True, exist_ok=True)
        yaml_text = str(yaml.safe_dump(plain, sort_keys=False, width=100))
        file.write_text("# Chosen by seatrial next.\n" + yaml_text, encoding="utf-8")
        files = [file, *write_files(output, sailed.motion, marks, waters, where)]
    except OSError as error:
        raise ConfigurationError(f"{output}: cannot be written: {error.strerror}") from error
    typer.echo("wrote " + ", ".join(map(str, files)))


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


def _known(trials: Sequence[Trial], vessel: str, doubt: float) -> Known:
    """What is known after trials, or of the nominal model."""
    if trials:
        return after_runs(trials, trial_of(trials[-1].names["vessel"]))
    if not 0.0 < doubt < 1.0:
        raise ConfigurationError(f"next: --doubt {doubt:g}: expected a number between 0 and 1")
    noisy = trial_of(vessel, "noise")
    return nominal(replace(noisy, disturbance=type(noisy.disturbance)()), noisy, doubt)


def trial_of(vessel: str, disturbance: str = "calm") -> Trial:
    """A trial of the vessel whose excitation is the family of its candidates."""
    words = [f"vessel={vessel}", f"disturbance={disturbance}", "controller=none", "evaluation=none"]
    for family in FAMILIES:
        try:
            order = in_process.composed([*words, f"excitation={family}"])
            trial = build_trial(order.config, order.names)
            break
        except SeatrialError:
            if family == FAMILIES[-1]:
                raise
    if trial.vessel.dofs != PLANAR:
        raise ConfigurationError(
            f"next: {vessel} moves in {', '.join(trial.vessel.dofs)}, expected a vessel in "
            f"{', '.join(PLANAR)}"
        )
    return trial


def _came(trials: Sequence[Trial], purpose: Purpose, now: float) -> list[str]:
    """What was expected of the last run beside what came, if anything was."""
    expected = getattr(trials[-1].excitation, "expected", None) if trials else None
    value = (expected or {}).get(f"{purpose.name}, {purpose.unit}")
    if value is None:
        return []
    return [f"expected ± {value:.3g} {purpose.unit}, came ± {now:.3g} {purpose.unit}"]


def _sheet(
    planner: SteeredPlanner | ForcePlanner, sailed: Sailed, widths: Sequence[float], unit: str
) -> Iterator[str]:
    """Lines of times, helm or forces, and the interval expected after each manoeuvre."""
    said, last = list(zip(sorted(sailed.chosen), widths[1:], strict=True)), ""
    for begin, text in planner.rows(sailed):
        if said and said[0][0][0] <= begin + HALF_A_SAMPLE:
            (_, number), width = said.pop(0)
            title = planner.candidates[number].name
            yield f"{_clock(begin)}  {title}: then ± {width:.3g} {unit}"
        if text != last:
            yield f"{_clock(begin)}    {text}"
        last = text
    yield f"{_clock(sailed.seconds)}  end"


def _clock(seconds: float) -> str:
    return f"{int(seconds // 60):3d}:{seconds % 60:04.1f}"
