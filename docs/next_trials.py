"""Simulated trials of `seatrial next`: how soon the interval that is asked for is reached.

`python -m docs.next_trials --seeds 20 --write` computes it, `make next` runs that. The parameters
of the true vessel deviate from the nominal ones by a normal doubt of 20 % (half of the 90 %
interval), in measurement noise and wind, which is measured while its force is not known. Manoeuvres
are sailed one by one, and after each free runs are fitted to all recordings so far, from what was
believed at first; the covariance is enlarged by the slow part of the residuals. Manoeuvres are
chosen by `next`, by a D-optimal design over the same candidates, or are those of IMO's trials:
circles to both sides and zig-zags, repeated until the interval is reached.
"""

import json
from argparse import ArgumentParser
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from seatrial.models.errors import SeatrialError
from seatrial.models.identification.free_parameters import WINDAGE, free_parameters, with_devices
from seatrial.models.identification.free_run_fit import (
    Effort,
    Fit,
    FreeRuns,
    Stage,
    grown,
    segments,
)
from seatrial.models.identification.next_experiment import NORMAL_90, Belief, Purpose, ranked
from seatrial.models.identification.uncertainty import parameter_covariance
from seatrial.models.identification.validation import restart_length
from seatrial.models.recording.recording import Recording, end_to_end
from seatrial.models.simulation.voyage import recording_of
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag
from seatrial.runner.commands import next as command
from seatrial.runner.configuration.config import Trial
from seatrial.runner.trials.closed_loop import Streams, prepare

FILE = Path(__file__).parent / "next_trials.json"
TASKS = {  # vessel: purpose, target [%]
    "kvlcc2": ("tactical_diameter", 5.0),
    "milliampere": ("yaw.|r|r", 6.0),
    "otter": ("tactical_diameter", 4.0),
}
ARMS = ("next", "D-optimal", "IMO")
DOUBT, MOST = 0.2, 8
WINDAGE_SI = 10.0  # deviation of the coefficients of windage [N s^2/m^2, Nm s^2/m^2]
SHARES = (0.1, 0.3, 1.0)  # of the restart length
EFFORT = Effort(2, 8, 1e-4)
State = tuple[Array, Array]  # u (m,) and its information (m, m)


class Estimator:
    """The belief and the recordings so far: a fit of free runs to all of them from the prior.

    Parameters p deviate by what is doubted, and three coefficients of the windage by `WINDAGE_SI`:
    the wind is measured, its force on the vessel is not known.
    """

    def __init__(self, belief: Belief, lag: SecondOrderLag | None) -> None:
        own, model = belief.free, belief.free.nominal
        table, devices = own.labels[: own.of_devices.start], own.labels[own.of_devices]
        free = free_parameters(model, [*table, *WINDAGE], "free", False)
        self.free, self.lag = with_devices(free, devices), lag
        self.own = np.array([label not in WINDAGE for label in self.free.labels])
        self.into = np.linalg.inv(belief.basis)  # u of p - p_hat
        size = np.abs(self.free.values) * DOUBT / NORMAL_90
        self.deviation = np.where(self.own, size, WINDAGE_SI)
        self.change, self.data = np.zeros(len(size)), list[Recording]()
        self.fit: Fit | None = None

    def runs(self, data: Recording, segment_s: float) -> FreeRuns:
        """Free runs of a recording."""
        return FreeRuns(segments(data, self.free, self.lag, None, segment_s), self.deviation)

    def updated(self, data: Recording) -> State:
        """The distribution after one recording more."""
        self.data.append(data)
        whole, model = end_to_end(self.data), self.free.nominal
        length_s, size = restart_length(model, whole), self.deviation

        def stage(share: float, last: bool) -> Stage:
            return Stage(self.runs(whole, share * length_s), EFFORT)

        fit = self.fit = grown(SHARES, stage, self.change, np.zeros_like(size), size, None)
        self.change, count = fit.change, len(size) + len(fit.runs.begin) * len(model.dofs)
        scaled = parameter_covariance(
            fit.jacobian * size, fit.rest, np.ones(len(size)), fit.tau, count, None
        )
        covariance = (max(fit.slow, 1.0) * np.outer(size, size) * scaled)[
            np.ix_(self.own, self.own)
        ]
        u = self.into @ self.change[self.own]
        return u, np.linalg.inv(self.into @ covariance @ self.into.T)


IMO = {  # circles to both sides with the largest helm; zig-zags 10/10 and 20/20 or near
    True: ["turn, 100 %, slower x 3", "turn, -100 %, slower x 3", "zigzag_10, 25 %, slower x 3",
           "zigzag_10, -25 %, slower x 3", "zigzag_20, 50 %, slower x 3",
           "zigzag_20, -50 %, slower x 3"],
    False: ["circle, 100 %", "zigzag_10, 100 %", "zigzag_20, 100 %"],
}  # fmt: skip


def trial(task: str, seeds: int) -> Iterator[dict[str, object]]:
    """Time, width and error of each arm and seed of a vessel."""
    name, target = TASKS[task]
    windy, known = command.trial_of(task, "[wind,noise]"), command.nominal(task, DOUBT)
    planner = command.Planner(known, None, (0.0, 0.0, 0.0), np.inf)
    belief, candidates = known.belief, planner.candidates
    told = np.array([each.information for each in candidates])
    seconds = np.array([each.seconds for each in candidates])
    value = command.value_of(known, name)
    fixed = d_optimal(told, seconds)
    names = [candidate.name for candidate in candidates]
    standard = [names.index(each) for each in IMO[planner.steered]]
    orders: dict[str, Callable[[int, Purpose, Array], int]] = {
        "next": lambda k, purpose, H: ranked(purpose, H, told, seconds)[0],
        "D-optimal": lambda k, purpose, H: fixed[k % len(fixed)],
        "IMO": lambda k, purpose, H: standard[k % len(standard)],
    }
    m = len(known.zero)
    for seed in range(seeds):
        u = np.random.default_rng(1000 + seed).standard_normal(m)
        truth, real = belief.at(u), float(value(u)[0])
        for arm in ARMS:
            state, spent, width = (np.zeros(m), np.eye(m)), 0.0, np.inf
            purpose, centre = command.purpose_of(known, name), float(value(state[0])[0])
            estimator = Estimator(belief, windy.vessel.thruster)
            for k in range(MOST):
                number = orders[arm](k, purpose, state[1] - np.eye(m))
                data = _sailed(planner, windy, candidates[number], truth, 100 * seed + k)
                spent += float(seconds[number])
                try:
                    state = estimator.updated(data)
                    purpose = command.purpose_of(known, name, u=state[0])
                    centre = float(value(state[0])[0])
                except SeatrialError:  # the estimate cannot be sailed: not reached
                    width = float("inf")
                    break
                width = purpose.width(state[1] - np.eye(m))
                if width <= target:
                    break
            error = 100.0 * (real / centre - 1.0)
            yield {"vessel": task, "arm": arm, "seed": seed, "minutes": spent / 60.0,
                   "width": width, "error": error}  # fmt: skip


def d_optimal(told: Array, seconds: Array) -> list[int]:
    """Candidates by the log det that they add in a second, one after the other."""
    H, found = np.eye(told.shape[1]), []
    for _ in range(MOST):
        gain = np.linalg.slogdet(H + told)[1] - np.linalg.slogdet(H)[1]
        found.append(int(np.argmax(gain / seconds)))
        H = H + told[found[-1]]
    return found


def _sailed(
    planner: command.Planner, windy: Trial, candidate: command.Candidate, truth: Vessel, seed: int
) -> Recording:
    """The recording of the true vessel in noise and wind."""
    mission = planner.sailing((candidate.own,))
    setup = prepare(windy, Streams(seed), windy.vessel.nominal(), mission, true=truth)
    voyage = setup.sail().voyage
    return recording_of(voyage, voyage.weather)


def shown(rows: list[dict[str, Any]]) -> str:
    """The table, and the coverage of all trials."""
    lines = ["| vessel | asked for | " + " | ".join(f"{arm} [min]" for arm in ARMS) + " | inside |"]
    lines.append("|---|---|" + "---:|" * (len(ARMS) + 1))
    hits = [abs(float(row["error"])) <= float(row["width"]) for row in rows]
    for vessel, (name, target) in TASKS.items():
        own = [row for row in rows if row["vessel"] == vessel]
        if not own:
            continue
        cells = []
        for arm in ARMS:
            part = [row for row in own if row["arm"] == arm]
            late = sum(float(row["width"]) > target for row in part)
            median = float(np.median([float(row["minutes"]) for row in part]))
            cells.append(
                f"{median:.1f}" + (f" ({late} of {len(part)} not reached)" if late else "")
            )
        inside = sum(hit for hit, row in zip(hits, rows, strict=True) if row["vessel"] == vessel)
        cells.append(f"{inside} of {len(own)}")
        shown_name = name.replace("|", "\\|")
        lines.append(f"| {vessel} | {shown_name} ± {target:g} % | " + " | ".join(cells) + " |")
    low, high = binomtest(sum(hits), len(hits)).proportion_ci()
    share = 100.0 * sum(hits) / len(hits)
    lines.append("")
    lines.append(
        f"Of {len(hits)} final 90 % intervals {share:.0f} % hold the true value (binomial 95 % "
        f"interval {100.0 * low:.0f} to {100.0 * high:.0f} %)."
    )
    return "\n".join(lines)


def main() -> None:
    """Print the table, of the file or computed."""
    parser = ArgumentParser(description="Simulated trials of seatrial next.")
    parser.add_argument("--seeds", type=int, help="compute it over so many seeds")
    parser.add_argument("--write", action="store_true", help="write the results")
    parser.add_argument("--vessel", choices=TASKS, help="only this one")
    options = parser.parse_args()
    if options.seeds is None:
        rows = json.loads(FILE.read_text())
    else:
        rows = []
        for task in [options.vessel] if options.vessel else TASKS:
            try:
                rows += trial(task, options.seeds)
            except SeatrialError as error:
                raise SystemExit(f"{task}: {error}") from error
        if options.write:
            FILE.write_text(json.dumps(rows, indent=1) + "\n")
    print(shown(rows))


if __name__ == "__main__":
    main()
