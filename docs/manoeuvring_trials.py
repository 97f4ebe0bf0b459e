"""What turning circle is predicted after simulated manoeuvring trials: `make manoeuvring`.

The truth is KVLCC2 by the method of MMG. The trials are those of IMO resolution MSC.137(76),
turning circles, each twice, and zig-zags to both sides, with noise; the nominal coefficients are
off by up to 20 %. Three models are identified: a polynomial (Abkowitz) by `iv` and by `auto` from
all trials, and hull, rudder and propeller (MMG) jointly by `output_error` from the zig-zags. Each
then turns at 35 degrees to both sides, as do models that are drawn from its distribution.

`python -m docs.manoeuvring_trials` prints the table of `results/manoeuvring_trials.json`;
`--seeds 20 --write` computes it again.
"""

import json
import sys
from argparse import ArgumentParser
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from docs.coverage import trial_of
from docs.pages.markdown import table
from seatrial.models.errors import ConfigurationError, IdentificationError, RecordingError
from seatrial.models.identification.free_run import course_of, free_run
from seatrial.models.identification.problem import Identified, Problem
from seatrial.models.recording.recording import Recording
from seatrial.models.simulation.manoeuvre_sheet import DEVIATION_SHARE, Track, interval, turn
from seatrial.models.vessel import basis
from seatrial.models.vessel.basis import manoeuvring_basis
from seatrial.models.vessel.devices.device import with_parameters
from seatrial.models.vessel.steering import steady_speed
from seatrial.models.vessel.table import Vessel
from seatrial.runner.trials.closed_loop import Streams
from seatrial.runner.trials.trial import excite

ROOT = Path(__file__).parents[1]
FILE = ROOT / "results" / "manoeuvring_trials.json"
SHAFT = 11.85  # [1/s]
LENGTH_M = 7.0
DRAWS = 100  # models of an interval
LEVEL = 0.9
HELMS_DEG = (35.0, -35.0)
ZIGZAGS = ((20, "zigzag"), (-20, "zigzag"), (10, "zigzag"), (-10, "zigzag"))
CIRCLES = ((35, "turn"), (-35, "turn"), (35, "turn"), (-35, "turn"))
UNSURE = ("epsilon", "kappa", "gamma_R_plus", "gamma_R_minus", "l_R", "t_R", "a_H", "x_H",
          "w_P0", "t_P")  # fmt: skip
FREE = ["table", *(f"rudder.{name}" for name in UNSURE[:-2]), "propeller.w_P0", "propeller.t_P"]
# The rudder in drift and turn; without them the polynomial lacks 13 % of the yaw moment.
CROSS = ("v^2delta/U", "vdelta^2", "rdelta^2", "r^2delta/U", "vrdelta/U", "v^2delta^2",
         "r^2delta^2")  # fmt: skip
NO_MISSION = ("identifier=none", "controller=none", "evaluation=none")


class Method(NamedTuple):
    """An identifier with its options, and the trials that it knows."""

    options: tuple[str, ...]
    kinds: tuple[tuple[int, str], ...]
    devices: bool  # whether rudder and propeller are in the model


METHODS = {
    "iv": Method(
        ("identifier=iv", "identifier.iterations=4", "identifier.orientation_terms=false",
         # the regression as it is, not held to the nominal one
         "identifier.restart_s=null", "identifier.inertia_factor=null"),
        ZIGZAGS + CIRCLES, False,
    ),
    "auto": Method(("identifier=auto",), ZIGZAGS + CIRCLES, False),
    "output_error": Method(
        ("identifier=output_error", "identifier.horizons=[]", "identifier.horizon=250",
         f"identifier.free={FREE}"), ZIGZAGS, True,
    ),
}  # fmt: skip


class Circle(NamedTuple):
    """A predicted tactical diameter over the true one, and its interval; NaN: none."""

    ratio: float
    low: float
    high: float


def trials(seed: int, kinds: Sequence[tuple[int, str]]) -> Recording:
    """The recordings of several trials with noise, one after the other with gaps between them."""
    parts, begin = [], 0.0
    for i, (helm_deg, kind) in enumerate(kinds):
        trial = trial_of(
            "vessel=kvlcc2", f"excitation=rudder_{kind}", f"excitation.helm_deg={helm_deg}",
            f"excitation.turn_deg={abs(helm_deg)}", "excitation.duration_s=150",
            "excitation.approach_s=5", *NO_MISSION, "disturbance=noise",
        )  # fmt: skip
        recording = excite(trial, Streams(1000 * seed + i)).recording
        parts.append(replace(recording, t=recording.t - recording.t[0] + begin))
        begin = float(parts[-1].t[-1]) + 1.0
    joined = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("t", "eta", "nu", "nu_dot", "tau", "attitude", "inputs", "commands")
    }
    return replace(parts[0], tau_actual=None, tau_filtered=None, **joined)


def tactical_diameter(model: Vessel, helm_deg: float) -> float:
    """Of a turning circle that the model predicts from its steady speed [L]."""
    t = 0.1 * np.arange(1500)
    helm = np.radians(helm_deg) * np.clip((t - 5.0) * 0.276 / np.radians(35.0), 0.0, 1.0)
    nothing = np.zeros((len(t), 3))
    nu = nothing.copy()
    nu[:, 0] = steady_speed(model, np.array([0.0, SHAFT]), 5.0)
    inputs = np.column_stack([helm, np.full(len(t), SHAFT)])
    still = Recording(
        model.dofs, t, nothing, nu, nothing, nothing, nothing, inputs=inputs,
        input_names=model.inputs,
    )  # fmt: skip
    x, y, psi, u, v, _ = free_run(model, course_of(still, None, None, None, np.inf), "rk4").T
    return turn(Track(t, x, y, psi, helm, np.hypot(u, v), LENGTH_M))["tactical diameter"]


def nominal_ship(truth: Vessel, share: float) -> Vessel:
    """Hull, rudder and propeller coefficients off by up to a share."""
    rng = np.random.default_rng(5)
    theta = np.array(truth.theta)
    for i, term in enumerate(truth.terms):
        if "U" in term.name:
            theta[i] *= rng.uniform(1.0 - share, 1.0 + share, 3)
    installed = truth.installed
    unsure = np.array([label.partition(".")[2] in UNSURE for label in installed.labels])
    factors = np.where(unsure, rng.uniform(1.0 - share, 1.0 + share, len(unsure)), 1.0)
    values = (installed.parameters * factors).tolist()
    return replace(truth, theta=theta, devices=with_parameters(truth.devices, values))


def polynomial(ship: Vessel) -> Vessel:
    """A table without devices that approximates the forces of a ship over its manoeuvres."""
    terms = manoeuvring_basis(ship.accelerations, ("delta",))[len(ship.dofs) :]
    terms += basis.terms(CROSS)
    rng = np.random.default_rng(0)
    low, high = np.array([[0.4, -0.3, -0.1, -0.62], [1.25, 0.3, 0.1, 0.62]])
    states = rng.uniform(low, high, (4000, 4))
    nu, inputs = states[:, :3], np.column_stack([states[:, 3], np.full(len(states), SHAFT)])
    x = ship.variables(np.zeros_like(nu), nu, inputs=inputs)
    force = ship.inverse(np.zeros_like(nu), nu, inputs=inputs)
    theta = np.linalg.lstsq(basis.evaluate(terms, x), force, rcond=None)[0]
    rows = basis.terms(ship.accelerations) + terms
    return replace(ship, terms=rows, theta=np.vstack([ship.inertia.T, theta]), devices={})


def identified(method: str, seed: int, truth: Vessel) -> Identified:
    """The model that a method identifies from the trials of a seed."""
    options, kinds, devices = METHODS[method]
    nominal = nominal_ship(truth, 0.2)
    nominal = nominal if devices else polynomial(nominal)
    recording = trials(seed, kinds)
    identifier = trial_of(
        "vessel=kvlcc2", "excitation=rudder_turn", "controller=none", "evaluation=none", *options
    ).identifier
    problem = Problem(recording, recording, nominal, None)
    return identifier.identify(problem, np.random.default_rng(seed))


def circles(result: Identified, truth: Vessel) -> list[Circle]:
    """The predicted turning circles to both sides, with the intervals of the drawn models."""
    models, found = list(result.draws(DRAWS, DEVIATION_SHARE)), []
    for helm in HELMS_DEG:
        true = tactical_diameter(truth, helm)
        drawn = np.array([_drawn(model, helm) for model in models]) / true
        own = tactical_diameter(result.model, helm) / true
        found.append(Circle(own, *interval(own, drawn, LEVEL)))
    return found


def _drawn(model: Vessel, helm_deg: float) -> float:
    try:
        return tactical_diameter(model, helm_deg)
    except (ConfigurationError, IdentificationError, RecordingError):
        return np.nan


def computed(seeds: int, methods: Sequence[str]) -> dict[str, list[list[Circle]]]:
    """The circles of every method and seed; those of a fit that fails have no numbers."""
    truth = trial_of("vessel=kvlcc2", "excitation=rudder_turn", *NO_MISSION).vessel.nominal()
    found: dict[str, list[list[Circle]]] = {method: [] for method in methods}
    for seed in range(seeds):
        for method in methods:
            try:
                pair = circles(identified(method, seed, truth), truth)
            except (ConfigurationError, IdentificationError, RecordingError) as error:
                print(f"seed {seed}, {method}: {error}", file=sys.stderr, flush=True)
                pair = [Circle(np.nan, np.nan, np.nan)] * len(HELMS_DEG)
            found[method].append(pair)
            print(f"seed {seed}, {method}: {pair}", file=sys.stderr, flush=True)
    return found


def shown(found: Mapping[str, Sequence[Sequence[Circle]]]) -> str:
    """The table in Markdown."""
    rows = []
    for method, pairs in found.items():
        ratio, low, high = np.array(pairs, dtype=np.float64).reshape(-1, 3).T
        error = 100.0 * np.abs(ratio - 1.0)  # NaN: the fit failed, or the circle was not closed
        known = np.isfinite(low)
        inside = (low[known] <= 1.0) & (high[known] >= 1.0)
        rows.append(
            [
                f"`{method}`",
                f"{np.nanmedian(error):.2f}",
                f"{np.nanmax(error):.2f}",
                f"{np.sum(error < 2.0)} of {len(error)}",
                f"{np.mean(inside):.2f}" if len(inside) else "-",
                str(len(pairs)),
            ]
        )
    headers = ["identifier", "median error [%]", "largest [%]", "within 2 %",
               "90 % intervals that hold the truth", "seeds"]  # fmt: skip
    return table(headers, rows)


def read(file: Path) -> dict[str, list[list[Circle]]]:
    """Circles as stored."""
    if not file.exists():
        sys.exit(f"{file}: not found; `make manoeuvring` writes it")
    held: dict[str, Any] = json.loads(file.read_text())
    return {
        method: [[Circle(*(np.nan if x is None else x for x in one)) for one in pair]
                 for pair in pairs]
        for method, pairs in held.items()
    }  # fmt: skip


def write(found: Mapping[str, Sequence[Sequence[Circle]]], file: Path) -> None:
    """Store circles, in place of those of the same methods."""
    stored: dict[str, Any] = json.loads(file.read_text()) if file.exists() else {}
    stored |= {
        method: [[[x if np.isfinite(x) else None for x in one] for one in pair] for pair in pairs]
        for method, pairs in found.items()
    }
    file.parent.mkdir(exist_ok=True)
    file.write_text(json.dumps(stored, indent=1) + "\n")


def main() -> None:
    """Print the table, of the file or computed."""
    parser = ArgumentParser(description="Turning circles after simulated manoeuvring trials.")
    parser.add_argument("--seeds", type=int, help="compute it over so many seeds")
    parser.add_argument("--write", action="store_true", help="write the results")
    parser.add_argument("--identifier", choices=METHODS, help="only this one")
    options = parser.parse_args()
    if options.seeds is None:
        found = read(FILE)
    else:
        found = computed(options.seeds, [m for m in METHODS if options.identifier in (None, m)])
        if options.write:
            write(found, FILE)
    print(shown(found), end="")


if __name__ == "__main__":
    main()
