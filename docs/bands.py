"""The table of bands in docs/identification.md: `python -m docs.bands`.

It prints `results/bands.json`. `python -m docs.bands --write` computes it again: the training files
of each case are identified, and it is counted how many of the states that were measured on the test
files lie in the band of nominal 90 % about the free run, and how many of the measures of their
manoeuvres in their intervals; beside it what the data leave open of the parameters alone. Width of
a band and CRPS (`benchmark.crps`) are relative to the deviation of the signal within its file; FIT
is that of the velocities in the free runs, the mean of the cases, beside that of the nominal model.
With --data, --identifier or --case only a part is computed, and the rest of the file is kept.
"""

import json
import sys
from argparse import ArgumentParser
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import process_time
from typing import NamedTuple

import numpy as np

from docs.coverage import trial_of
from docs.pages.markdown import table
from seatrial.models.errors import SeatrialError
from seatrial.models.identification.calibration import bands, calibrated
from seatrial.models.identification.problem import Identified, Problem
from seatrial.models.identification.validation import combined, prediction, scores
from seatrial.models.notation import OrderedManoeuvre
from seatrial.models.simulation.manoeuvre_sheet import COMPARED, DIAGNOSTIC
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from seatrial.runner.compare.benchmark import BAND_LEVEL, cells, crps, half_width, task_of
from seatrial.runner.trials.closed_loop import Streams
from seatrial.runner.trials.manoeuvre_results import recorded_manoeuvres
from seatrial.runner.trials.trial import excite

ROOT = Path(__file__).parents[1]
FILE = ROOT / "results" / "bands.json"
ORDERED = ("helm", "change_of_heading")  # of a sheet: no result


class DataSet(NamedTuple):
    """Cases of a task of the benchmark; `each` leaves out every one of its files in turn."""

    title: str
    task: str
    cases: tuple[str, ...] = ()  # empty: all
    each: bool = False
    entrants: tuple[str, ...] = ("auto",)


SHIP = ("auto", "mmg_joint")
DATA_SETS = {
    "kvlcc2": DataSet(
        "KVLCC2, thirteen zig-zags, each left out", "kvlcc2_hsva", each=True, entrants=SHIP
    ),
    "kvlcc2_three": DataSet("KVLCC2, the benchmark's zig-zags", "kvlcc2_hsva", entrants=SHIP),
    "kvlcc2_marin": DataSet("KVLCC2 of MARIN, from HSVA", "kvlcc2_turns", entrants=SHIP),
    "esso_r": DataSet("Esso Osaka, split R", "esso_miyauchi", ("R",)),
    "esso_trz": DataSet("Esso Osaka, split TRZ", "esso_miyauchi", ("TRZ",)),
    "esso_tzb": DataSet("Esso Osaka, split TZB", "esso_wakita", ("TZB",)),
    "blueboat": DataSet("BlueBoat", "blueboat"),
    "beluga": DataSet("Beluga", "beluga"),
    "ferry": DataSet("ferry, simulated, noise", "ferry_simulated", ("noise",)),
    "model_ship": DataSet("model ship, simulated, noise and wind", "model_ship_simulated",
                          ("noise", "wind")),
}  # fmt: skip
SEEDS = 10  # of a simulated case


@dataclass(frozen=True)
class Count:
    """Sums over the measured states of a case: of velocities, or of poses."""

    states: int = 0
    inside: float = 0.0
    width: float = 0.0
    crps: float = 0.0

    def __add__(self, other: "Count") -> "Count":
        both = zip(asdict(self).values(), asdict(other).values(), strict=True)
        return Count(*(a + b for a, b in both))


@dataclass(frozen=True)
class Scored:
    """What is counted of one distribution: velocities, poses, measures inside of all."""

    velocity: Count
    pose: Count
    measures: tuple[int, int]


@dataclass(frozen=True)
class Row:
    """A case: by the data alone and with the model error, and its CPU time [s] beyond the fit."""

    data: str
    case: str
    entrant: str
    alone: Scored | None  # None: there is no distribution, or it diverges
    both: Scored | None
    seconds: float
    fit: tuple[float, float]  # of the velocities [%], identified and nominal
    note: str = ""


def options_of(data: DataSet, entrant: str) -> Iterator[tuple[str, tuple[str, ...]]]:
    """The cases of a data set, each with the options of its trial."""
    task = task_of(data.task)
    for cell in cells(task, [entrant]):
        chosen = not data.cases or cell.case in data.cases
        if chosen and cell.seed < SEEDS and not cell.lacking:
            if data.each:
                yield from left_out_in_turn(cell.options)
                return
            yield f"{cell.case} {cell.seed}", cell.options


def left_out_in_turn(options: tuple[str, ...]) -> Iterator[tuple[str, tuple[str, ...]]]:
    """The options with one file of the folder for testing, the others for training."""
    train = next(o for o in options if o.startswith("excitation.train="))
    folder = Path(json.loads(train.partition("=")[2])[0]).parent
    files = sorted(map(str, folder.glob("*.dat")))
    rest = tuple(o for o in options if not o.startswith(("excitation.train=", "excitation.test=")))
    for file in files:
        others = json.dumps([other for other in files if other != file])
        split = f"excitation.train={others}", f"excitation.test={json.dumps([file])}"
        yield Path(file).stem, (*rest, *split)


def errors_of(identified: Identified, problem: Problem) -> tuple[Array, Array] | None:
    """Errors of the free run and their standard deviations (N, 2 n_dof); None: no band.

    Both are over the deviation of the signal within its file; starts are left out.
    """
    parts = problem.validation.by_file() or {"": problem.validation}
    found = [_errors(identified, replace(problem, validation=part)) for part in parts.values()]
    if any(each is None for each in found):
        return None
    errors, deviations = zip(*(each for each in found if each is not None), strict=True)
    return np.concatenate(errors), np.concatenate(deviations)


def _errors(identified: Identified, problem: Problem) -> tuple[Array, Array] | None:
    recording = problem.validation
    deviation = bands(identified, recording, problem.thruster)
    run = prediction(identified.model, recording, problem.thruster)
    if deviation is None or not np.all(np.isfinite(deviation)) or run.free_run[1]:
        return None
    errors, spread = run.deviations()[0], run.mean_motion()
    kept = ~recording.piece_starts
    moved = np.where(spread > 0.0, spread, np.inf)
    return (errors / moved)[kept], (deviation / moved)[kept]


def fit(model: Vessel, problem: Problem) -> float:
    """FIT [%] of the velocities in the free runs, the mean of the axes; -inf if one diverges."""
    run = prediction(model, problem.validation, problem.thruster)
    ahead = run.over("free_run")
    own = np.split(scores(ahead, run.mean_motion()).fit, 2)[1]
    return -np.inf if ahead.diverged else combined(own)


def scored(identified: Identified, problem: Problem, length_m: float) -> Scored | None:
    """What is counted of a distribution."""
    found = errors_of(identified, problem)
    if found is None:
        return None
    n, counts = len(problem.nominal.dofs), list[Count]()
    for half in (slice(n, None), slice(0, n)):
        e, s = found[0][:, half], found[1][:, half]
        width = half_width(s)
        counts.append(
            Count(
                e.size, float(np.sum(np.abs(e) <= width)), float(np.sum(2.0 * width)),
                float(np.sum(crps(e, s))),
            )
        )  # fmt: skip
    return Scored(counts[0], counts[1], measured(identified, problem, length_m))


def measured(identified: Identified, problem: Problem, length_m: float) -> tuple[int, int]:
    """Measures of recorded manoeuvres in their intervals, and all that have one."""
    values: dict[tuple[str, int | None], dict[str, float]] = {}
    for row in recorded_manoeuvres(problem, identified, length_m, OrderedManoeuvre()):
        name, value = row.name.removeprefix(DIAGNOSTIC), row.value
        if name not in ORDERED and value is not None and np.isfinite(value):
            assert row.j is not None
            values.setdefault((name, row.i), {})[COMPARED[row.j]] = value
    known = [each for each in values.values() if {"measured", "low", "high"} <= set(each)]
    return sum(each["low"] <= each["measured"] <= each["high"] for each in known), len(known)


def row_of(data: str, case: str, entrant: str, options: Sequence[str]) -> Row:
    """Identify a case and count."""
    trial = trial_of(*options)
    excited = excite(trial, Streams(trial.seed))
    training, testing = (excited.recording.part(m) for m in (excited.training, excited.testing))
    problem = Problem(training, testing, trial.vessel.nominal(), trial.vessel.thruster)
    rng = Streams(trial.seed).generator("identifier")
    try:
        identified = trial.identifier.identify(problem, rng)
    except SeatrialError as error:
        return Row(data, case, entrant, None, None, 0.0, str(error))
    began = process_time()
    both = calibrated(trial.identifier, problem, identified)
    seconds = process_time() - began
    notes = [d.label for d in both.diagnostics if d.name == "no_model_error" and d.label]
    length = trial.vessel.scales.length_m
    alone = scored(identified, problem, length)
    done = None if both.model_error is None else scored(both, problem, length)
    fits = fit(identified.model, problem), fit(problem.nominal, problem)
    return Row(data, case, entrant, alone, done, seconds, fits, "; ".join(notes))


def share(count: Count) -> str:
    """Share inside, width and CRPS of a count."""
    n = max(count.states, 1)
    return f"{count.inside / n:.2f}, {count.width / n:.2f}, {count.crps / n:.3f}"


def shown(rows: Sequence[Row]) -> str:
    """The table in Markdown."""
    lines = []
    for data, (title, *_) in DATA_SETS.items():
        for entrant in dict.fromkeys(row.entrant for row in rows if row.data == data):
            own = [row for row in rows if (row.data, row.entrant) == (data, entrant)]
            known = [row for row in own if row.both is not None]
            fits = np.array([row.fit for row in own])
            own_fit, of_none = fits.mean(axis=0)
            better = f"{np.sum(fits[:, 0] > fits[:, 1])} of {len(own)}"
            line = [title, f"`{entrant}`", f"{own_fit:.1f}, {of_none:.1f}, {better}"]
            for name in ("velocity", "pose"):
                for which in ("alone", "both"):
                    found = [getattr(row, which) for row in known]
                    counts = [getattr(one, name) for one in found if one is not None]
                    line.append(share(sum(counts, Count())) if counts else "-")
            for which in ("alone", "both"):
                found = [getattr(row, which) for row in known]
                pairs = [one.measures for one in found if one is not None]
                inside, count = np.sum([*pairs, (0, 0)], axis=0).tolist()
                line.append(f"{inside} of {count}" if count else "-")
            line += [
                f"{len(known)} of {len(own)}",
                f"{np.median([row.seconds for row in own]):.1f}",
            ]
            lines.append(line)
    headers = ["data", "identifier", "FIT [%], of `none`, better", "velocity: data alone",
               "with model error", "pose: data alone", "with model error", "measures: data alone",
               "with model error", "cases", "CPU [s]"]  # fmt: skip
    return table(headers, lines)


def read(file: Path) -> list[Row]:
    """Rows as stored."""
    if not file.exists():
        sys.exit(f"{file}: not found; `make bands` writes it")
    return [_row(one) for one in json.loads(file.read_text())]


def _row(held: Mapping[str, object]) -> Row:
    own = dict(held)
    for which in ("alone", "both"):
        one = own[which]
        if isinstance(one, Mapping):
            counts = (Count(**one["velocity"]), Count(**one["pose"]))
            own[which] = Scored(*counts, tuple(one["measures"]))
    own["fit"] = tuple(own["fit"])  # type: ignore[arg-type]
    return Row(**own)  # type: ignore[arg-type]


def write(rows: Sequence[Row], file: Path) -> None:
    """Store rows, in place of those of the same cases."""
    stored = read(file) if file.exists() else []
    by_key = {(row.data, row.case, row.entrant): row for row in (*stored, *rows)}
    file.parent.mkdir(exist_ok=True)
    held = [asdict(by_key[key]) for key in sorted(by_key)]
    file.write_text(json.dumps(held, indent=1) + "\n")


def main() -> None:
    """Print the table, of the file or computed."""
    parser = ArgumentParser(description=f"Bands of nominal {100 * BAND_LEVEL:g} %.")
    parser.add_argument("--write", action="store_true", help="compute it, write results/bands.json")
    parser.add_argument("--data", choices=DATA_SETS, action="append", help="only these")
    parser.add_argument("--identifier", action="append", help="entrants in place of the listed")
    parser.add_argument("--case", help="only cases whose name contains this")
    parser.add_argument("--file", type=Path, default=FILE, help="in place of results/bands.json")
    options = parser.parse_args()
    for name in (options.data or DATA_SETS) if options.write else ():
        data = DATA_SETS[name]
        task = task_of(data.task)
        if absent := {cell.case for cell in cells(task) if cell.lacking}:
            print(f"{name}: files of {len(absent)} cases are missing", file=sys.stderr)
        for entrant in options.identifier or data.entrants:
            for case, overrides in options_of(data, entrant):
                if (options.case or "") in case:
                    row = row_of(name, case, entrant, overrides)
                    print(shown([row]).splitlines()[-1], row.note, file=sys.stderr, flush=True)
                    write([row], options.file)
    print(shown(read(options.file)), end="")


if __name__ == "__main__":
    main()
