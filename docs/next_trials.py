"""Simulated trials of `seatrial next`: how soon the interval that is asked for is reached.

`python -m docs.next_trials --seeds 20 --write` computes it on two cores, `make next` runs that.
The parameters of the true vessel, the force of the wind among them, deviate from the nominal ones
by a normal doubt of 20 % (half of the 90 % interval), in measurement noise and wind.
Manoeuvres are sailed one by one, and after each free runs are fitted to all recordings so far, from
what was believed at first; the covariance is enlarged by the slow part of the residuals, and by the
error of the mean of the measured wind. They are chosen by `next`, by a D-optimal design over the
same candidates, or are those of IMO's trials: two circles and four zig-zags, to both sides,
repeated until the interval is reached.

Purposes and widths are by expected widths alone and trials of seeds below 40: what takes several
manoeuvres. The seeds of the file were used for nothing else.
"""

import json
import time
from argparse import ArgumentParser
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from joblib import Parallel, delayed
from scipy.stats import binomtest

from seatrial.models.errors import SeatrialError
from seatrial.models.identification.free_run_fit import Effort, FreeRuns, Stage, grown, segments
from seatrial.models.identification.next_experiment import Belief, Purpose, doubted, ranked
from seatrial.models.identification.uncertainty import parameter_covariance
from seatrial.models.identification.validation import restart_length
from seatrial.models.recording.recording import Recording, end_to_end
from seatrial.models.simulation.voyage import recording_of
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from seatrial.models.vessel.thruster import SecondOrderLag
from seatrial.models.weather.wind import Wind, Windage
from seatrial.runner.commands import next as command
from seatrial.runner.configuration.config import Trial
from seatrial.runner.trials.closed_loop import Streams, prepare

FILE = Path(__file__).parent / "next_trials.json"
TASKS = {  # vessel: purpose, target [%]
    "kvlcc2": ("yaw.rU", 6.0),
    "milliampere": ("sway.v", 8.0),
    "otter": ("left.ahead", 0.2),
}
ARMS = ("next", "D-optimal", "IMO")
DOUBT, MOST = 0.2, 18
FIRST_SEED = 500  # of the file
SHARES = (0.1, 0.3, 1.0)  # of the restart length
EFFORT = Effort(2, 8, 1e-4)
State = tuple[Array, Array]  # u (m,) and its information (m, m)


def with_wind(known: command.Known, windy: Trial) -> tuple[command.Known, Trial]:
    """What is known, in wind whose force is doubted like the rest; and the trial that is sailed.

    The force stands in the table of the model, of the true vessel too.
    """
    wind, nominal = windy.disturbance.wind, windy.vessel.nominal()
    assert isinstance(wind, Wind)
    assert isinstance(wind.windage, Windage)
    belief = doubted(nominal + wind.windage.table(nominal.dofs), DOUBT)
    felt = replace(wind, windage=replace(wind.windage, cx=0.0, cy=0.0, cn=0.0))
    disturbance = replace(windy.disturbance, wind=felt)
    trial = replace(known.trial, disturbance=replace(disturbance, noise=None))
    return replace(known, trial=trial, belief=belief), replace(windy, disturbance=disturbance)


def about(belief: Belief, u: Array) -> Belief:
    """The same doubt about the model at coordinates u (m,)."""
    values = belief.free.values + belief.basis @ u
    return Belief(replace(belief.free, nominal=belief.at(u), values=values), belief.basis)


class Estimator:
    """The belief and the recordings so far: a fit of free runs to all of them from the prior."""

    def __init__(self, belief: Belief, lag: SecondOrderLag | None) -> None:
        self.free, self.lag, self.size = belief.free, lag, np.diag(belief.basis)
        self.change, self.data = np.zeros(len(self.size)), list[Recording]()

    def updated(self, data: Recording) -> State:
        """The distribution after one recording more, with the error of the mean wind."""
        self.data.append(data)
        whole, model, size = end_to_end(self.data), self.free.nominal, self.size
        assert whole.wind is not None
        turned, length_s = np.exp(1j * whole.eta[:, 2]), restart_length(model, whole)
        over_ground = (whole.wind @ [1.0, 1j]) * turned
        mean, error = np.mean(over_ground), np.std(over_ground) / np.sqrt(2.0 * len(whole))

        def runs(share: float, wind: complex) -> FreeRuns:
            blown = replace(whole, wind=np.column_stack([(own := wind / turned).real, own.imag]))
            return FreeRuns(segments(blown, self.free, self.lag, None, share * length_s), size)

        shares = SHARES if len(self.data) == 1 else SHARES[-1:]  # later ones begin near the end
        fit = grown(shares, lambda share, last: Stage(runs(share, mean), EFFORT), self.change,
                    np.zeros_like(size), size, None)  # fmt: skip
        self.change, count = fit.change, len(size) + len(fit.runs.begin) * len(model.dofs)
        J = fit.jacobian * size
        scaled = parameter_covariance(J, fit.rest, np.ones(len(size)), fit.tau, count, None)
        scaled *= max(fit.slow, 1.0)
        longest = np.max(np.diff(fit.runs.begin, append=len(whole)))  # of the fit, in samples
        share, blown = longest * whole.period_s / length_s, (mean + error, mean + 1j * error)
        moved = [(runs(share, wind).point(fit.change, fit.point.start).rest / fit.scale
                  - fit.rest).ravel() for wind in blown]  # fmt: skip
        shift = np.linalg.solve(J.T @ J + fit.tau * np.eye(len(size)), J.T @ np.array(moved).T)
        return fit.change / size, np.asarray(np.linalg.inv(scaled + shift @ shift.T))


IMO = {  # circles to both sides with the largest helm; zig-zags 10/10 and 20/20 or near
    True: ["turn, 100 %, slower x 3", "turn, -100 %, slower x 3", "zigzag_10, 25 %, slower x 3",
           "zigzag_10, -25 %, slower x 3", "zigzag_20, 50 %, slower x 3",
           "zigzag_20, -50 %, slower x 3"],
    False: ["circle, 100 %", "circle, -100 %", "zigzag_10, 100 %", "zigzag_10, -100 %",
            "zigzag_20, 100 %", "zigzag_20, -100 %"],
}  # fmt: skip


def trial(task: str, seed: int) -> list[dict[str, Any]]:
    """Time, width and error of each arm on a vessel, and the time of the processor."""
    name, target = TASKS[task]
    windy = command.trial_of(task, "[wind,noise]")
    known, windy = with_wind(command.nominal(task, DOUBT), windy)
    planner = command.Planner(known, None, (0.0, 0.0, 0.0), np.inf)
    belief, candidates = known.belief, planner.candidates
    value, fixed = command.value_of(known, name), d_optimal(candidates)
    names = [candidate.name for candidate in candidates]
    standard = [candidates[names.index(each)] for each in IMO[planner.steered]]

    def chosen(k: int, purpose: Purpose, state: State) -> command.Candidate:
        now = replace(planner, known=replace(known, belief=about(belief, state[0])))
        own = (now if k else planner).candidates
        told = state[1] - np.eye(len(state[0]))
        return own[ranked(purpose, told, *_arrays(own), target)[0]]

    orders: dict[str, Callable[[int, Purpose, State], command.Candidate]] = {
        "next": chosen,
        "D-optimal": lambda k, purpose, state: fixed[k],
        "IMO": lambda k, purpose, state: standard[k % len(standard)],
    }
    m, rows = len(known.zero), list[dict[str, Any]]()
    u = np.random.default_rng(1000 + seed).standard_normal(m)
    truth, real = belief.at(u), float(value(u)[0])
    for arm in ARMS:
        begin, state, spent, width = time.process_time(), (np.zeros(m), np.eye(m)), 0.0, np.inf
        purpose, centre = command.purpose_of(known, name), float(value(state[0])[0])
        estimator = Estimator(belief, windy.vessel.thruster)
        for k in range(MOST):
            try:
                candidate = orders[arm](k, purpose, state)
                data = _sailed(planner, windy, candidate, truth, 100 * seed + k)
                spent += candidate.seconds
                state = estimator.updated(data)
                purpose = command.purpose_of(known, name, u=state[0])
                centre = float(value(state[0])[0])
            except SeatrialError:  # the estimate cannot be sailed: not reached
                width = float("inf")
                break
            width = purpose.width(state[1] - np.eye(m))
            if width <= target:
                break
        shown = {"minutes": spent / 60.0, "width": width, "error": 100.0 * (real / centre - 1.0),
                 "cpu_s": time.process_time() - begin}  # fmt: skip
        rows.append({"vessel": task, "arm": arm, "seed": seed, "manoeuvres": k + 1,
                     **{key: float(f"{number:.4g}") for key, number in shown.items()}})  # fmt: skip
    return rows


def _arrays(candidates: list[command.Candidate]) -> tuple[Array, Array]:
    """Informations (q, m, m) and times (q,) [s]."""
    told, seconds = zip(*((each.information, each.seconds) for each in candidates), strict=True)
    return np.array(told), np.array(seconds)


def d_optimal(candidates: list[command.Candidate]) -> list[command.Candidate]:
    """Candidates by the log det that they add in a second, one after the other."""
    told, seconds = _arrays(candidates)
    H, found = np.eye(told.shape[1]), []
    for _ in range(MOST):
        gain = np.linalg.slogdet(H + told)[1] - np.linalg.slogdet(H)[1]
        found.append(int(np.argmax(gain / seconds)))
        H = H + told[found[-1]]
    return [candidates[number] for number in found]


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
    head = "vessel", "asked for", *(f"{arm} [min]" for arm in (*ARMS, "set of IMO")), "inside"
    lines = ["| " + " | ".join([*head, "CPU [s]"]) + " |", "|---|---|" + "---:|" * 6]
    inside = [abs(row["error"]) <= row["width"] < np.inf for row in rows]
    for vessel, (name, target) in TASKS.items():
        own = [row | {"hit": hit} for row, hit in zip(rows, inside, strict=True)
               if row["vessel"] == vessel]  # fmt: skip
        if not own:
            continue
        cells, medians = list[str](), list[float]()
        for arm in ARMS:
            part = [row for row in own if row["arm"] == arm]
            late = sum(row["width"] > target for row in part)
            medians.append(float(np.median([row["minutes"] for row in part])))
            least = "> " if 2 * late >= len(part) else ""
            share = f", {100.0 * medians[0] / medians[-1]:.0f} %" if arm != ARMS[0] else ""
            cells.append(
                f"{least}{medians[-1]:.1f}{share}" + (f" ({late} not reached)" * (late > 0))
            )
        minutes = len(IMO[True]) * part[0]["minutes"] / part[0]["manoeuvres"]  # all of a length
        cells += [f"{minutes:.1f}", f"{sum(row['hit'] for row in own)} of {len(own)}"]
        cells.append(f"{sum(row['cpu_s'] for row in own):.0f}")
        asked = f"{name} ± {target:g} %".replace("|", "\\|")
        lines.append(f"| {vessel} | {asked} | " + " | ".join(cells) + " |")
    low, high = binomtest(sum(inside), len(rows)).proportion_ci()
    share = f"{100.0 * sum(inside) / len(rows):.0f} %"
    between = f"{100.0 * low:.0f} to {100.0 * high:.0f} %"
    lines += ["", f"Of {len(rows)} final 90 % intervals {share} hold the true value (binomial 95 % "
              f"interval {between})."]  # fmt: skip
    return "\n".join(lines)


def main() -> None:
    """Print the table, of the file or computed."""
    parser = ArgumentParser(description="Simulated trials of seatrial next.")
    parser.add_argument("--seeds", type=int, help="compute it over so many seeds")
    parser.add_argument("--first", type=int, default=FIRST_SEED, help="the first of them")
    parser.add_argument("--write", action="store_true", help="write the results")
    parser.add_argument("--vessel", choices=TASKS, help="only this one")
    options = parser.parse_args()
    if options.seeds is None:
        rows = json.loads(FILE.read_text())
    else:
        tasks = [options.vessel] if options.vessel else TASKS
        seeds = range(options.first, options.first + options.seeds)
        jobs = (delayed(trial)(task, seed) for task in tasks for seed in seeds)
        rows = [row for rows in Parallel(n_jobs=2, verbose=5)(jobs) for row in rows]
        if options.write:
            lines = ",\n".join(json.dumps(row) for row in rows)
            FILE.write_text(f"[\n{lines}\n]\n")
    print(shown(rows))


if __name__ == "__main__":
    main()
