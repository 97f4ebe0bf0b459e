"""The coverage table of docs/identification.md: `python -m docs.coverage`.

It prints `results/coverage.json`. `python -m docs.coverage --seeds 100 --write` computes it again:
the identifiers identify the same recordings, and the share of the true coefficients within 1.96
standard errors of their estimates is counted. `nsga2` ends in the fit of `output_error`, `auto` in
one of these; the errors of `surface_plsr` and `dsr` are bootstraps, as that of `plsr`. Without
--write the table is printed only; with --vessel, --disturbance or --identifier the rest of the file
is kept.
"""

import json
import sys
from argparse import ArgumentParser
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from hydra import compose, initialize_config_dir
from joblib import Parallel, delayed
from omegaconf import OmegaConf
from scipy.stats import binomtest

from docs.pages.markdown import table
from seatrial.models.diagnostics import INTERVAL_OF_ESTIMATE
from seatrial.models.errors import ConfigurationError, IdentificationError, RecordingError
from seatrial.models.identification.problem import Identified, Identifier, Problem, with_interval
from seatrial.models.notation import PLANAR
from seatrial.models.vessel.basis import Array
from seatrial.models.vessel.table import Vessel
from seatrial.runner.configuration.config import Trial, build_trial
from seatrial.runner.sweeps.composition import order_of
from seatrial.runner.trials.closed_loop import Streams
from seatrial.runner.trials.trial import excite

ROOT = Path(__file__).parents[1]
FILE = ROOT / "results" / "coverage.json"
WIDTH = 1.96  # standard errors of an interval of 95 %
PROCESSES = 2
# The true coefficients of the last two would be the nominal ones, about which the prior is.
VESSELS = {
    "milliampere": ("excitation=waypoints",),
    "modulus_ship": ("excitation=prbs", "controller=none"),
    "surge_nonlinear": ("excitation=multisine", "controller=none", "plant.scale=0.8"),
    "beluga_diagonal": ("excitation=multisine", "controller=none", "plant.scale=0.8"),
}
DISTURBANCES = ("noise", "[constant,noise]", "[wind,noise]")
IDENTIFIERS = {
    "robust": ("identifier=robust",),
    "output_error": ("identifier=output_error",),
    "iv": ("identifier=iv",),
    "ls": ("identifier=ls", "identifier.basis=physical"),
    "ridge": ("identifier=ridge", "identifier.basis=physical"),
    "plsr": ("identifier=plsr", "identifier.basis=physical"),
}
CHOICES = {"vessel": VESSELS, "disturbance": DISTURBANCES, "identifier": IDENTIFIERS}
UNUSABLE = (IdentificationError, ConfigurationError, RecordingError)


class Case(NamedTuple):
    """A vessel under a disturbance."""

    vessel: str
    disturbance: str


class Count(NamedTuple):
    """Covered true coefficients of all: those of the inertia, and the others."""

    inertia: tuple[int, int]
    damping: tuple[int, int]

    @property
    def every(self) -> tuple[int, int]:
        """Of all coefficients."""
        (a, n), (b, m) = self
        return a + b, n + m


@dataclass(frozen=True)
class Share:
    """The coverage of an identifier in a case, over the models that say the same of intervals."""

    case: Case
    identifier: str
    covers: bool  # of the models whose interval is said to be one of the coefficient, or the others
    seeds: int  # with such a model
    failed: int  # seeds without a model
    count: Count


def trial_of(*overrides: str) -> Trial:
    """The trial that `python -m runner OVERRIDES` would run."""
    with initialize_config_dir(str(ROOT / "conf"), version_base="1.3"):
        config = compose("trial", list(overrides), return_hydra_config=True)
        OmegaConf.set_struct(config, False)
        order = order_of(config, config.pop("hydra"), list(overrides))
    return build_trial(order.config, order.names)


def cases() -> list[Case]:
    """Every vessel under every disturbance that it takes: only planar ones have wind."""
    return [
        Case(vessel, disturbance)
        for vessel, disturbance in product(VESSELS, DISTURBANCES)
        if "wind" not in disturbance or trial_of(f"vessel={vessel}").vessel.dofs == PLANAR
    ]


def setting(case: Case, names: Sequence[str]) -> tuple[Trial, dict[str, Identifier]]:
    """The trial of a case, for any seed, and the identifiers as configured for its vessel."""
    own = (f"vessel={case.vessel}", *VESSELS[case.vessel])
    identifiers = {name: trial_of(*own, *IDENTIFIERS[name]).identifier for name in names}
    rest = (f"disturbance={case.disturbance}", "identifier=none", "evaluation=none")
    return trial_of(*own, *rest), identifiers


def recorded(trial: Trial, seed: int) -> tuple[Problem, Vessel]:
    """The recording of a trial with this seed, and the true model."""
    found = excite(trial, Streams(seed))
    assert found.truth is not None
    training, testing = found.recording.part(found.training), found.recording.part(found.testing)
    return Problem(training, testing, trial.vessel.nominal(), trial.vessel.thruster), found.truth


def covered(identified: Identified, nominal: Vessel, truth: Vessel) -> Count:
    """Which true coefficients of the nominal model's terms are in their intervals.

    Only coefficients that are not zero and have a standard error are counted. Forces of the
    disturbance are no coefficients of the vessel.
    """
    if identified.std_error is None:
        return Count((0, 0), (0, 0))
    errors = replace(identified.residual, theta=np.nan_to_num(identified.std_error))
    true, error = (model.on(nominal.terms).theta for model in (truth, errors))
    estimate = identified.model.on(nominal.terms).theta
    inertia = np.array([term.name in nominal.accelerations for term in nominal.terms])
    counted = (true != 0.0) & (error > 0.0)
    inside = counted & (np.abs(estimate - true) <= WIDTH * error)

    def count(rows: Array) -> tuple[int, int]:
        return int(np.sum(inside[rows])), int(np.sum(counted[rows]))

    return Count(count(inertia), count(~inertia))


class Model(NamedTuple):
    """What is said of the intervals of one model, and the count of it."""

    covers: bool
    counted: Count


def counts(
    trial: Trial, identifiers: Mapping[str, Identifier], seed: int
) -> dict[str, Model | None]:
    """The counts of identifiers on one recording; None: there is no model."""
    problem, truth = recorded(trial, seed)
    found: dict[str, Model | None] = {}
    for name, identifier in identifiers.items():
        rng = Streams(seed).generator("identifier")
        try:
            identified = identifier.identify(problem, rng)
        except UNUSABLE:
            found[name] = None
        else:
            count = covered(identified, problem.nominal, truth)
            found[name] = Model(says_covers(with_interval(identifier, identified)), count)
    return found


def says_covers(identified: Identified) -> bool:
    """Whether a model says that its intervals are those of the coefficients."""
    said = [f.value for f in identified.diagnostics if f.name == INTERVAL_OF_ESTIMATE]
    return said == [0.0]


def total(found: Sequence[Count]) -> Count:
    """The sum of counts."""
    sums = np.sum([np.array(count) for count in found] or [np.zeros((2, 2))], axis=0).astype(int)
    (a, n), (b, m) = sums.tolist()
    return Count((a, n), (b, m))


def computed(seeds: int, chosen: Sequence[Case], names: Sequence[str]) -> list[Share]:
    """The coverage over the seeds 0 to `seeds` - 1, in two processes."""
    settings = {case: setting(case, names) for case in chosen}
    jobs = list(product(chosen, range(seeds)))
    found = Parallel(n_jobs=PROCESSES)(
        delayed(counts)(*settings[case], seed) for case, seed in jobs
    )
    shares = []
    for case in chosen:
        of_case = [one for (own, _), one in zip(jobs, found, strict=True) if own == case]
        for name in settings[case][1]:
            known = [model for one in of_case if (model := one[name]) is not None]
            shares += shares_of(case, name, known, len(of_case) - len(known))
    return shares


def shares_of(case: Case, name: str, known: Sequence[Model], failed: int) -> list[Share]:
    """One share for the models with intervals of the coefficient, one for the others, if any."""
    shares = []
    for covers in (True, False):
        own = [model.counted for model in known if model.covers == covers]
        if own:
            shares.append(Share(case, name, covers, len(own), failed, total(own)))
    return shares or [Share(case, name, False, 0, failed, total([]))]


def proportion(covered_of_all: tuple[int, int]) -> str:
    """Share and its 95 % interval (Wilson), as if the coefficients were independent."""
    inside, counted = covered_of_all
    if not counted:
        return "-"
    interval = binomtest(inside, counted).proportion_ci(0.95, "wilson")
    return f"{inside / counted:.2f} ({interval.low:.2f} to {interval.high:.2f})"


def shown(shares: Sequence[Share]) -> str:
    """The table in Markdown."""
    rows = [
        [
            f"`{share.case.vessel}`",
            share.case.disturbance.strip("[]").replace(",", " + "),
            f"`{share.identifier}`",
            "coefficient" if share.covers else "of the estimate",
            *map(proportion, (*share.count, share.count.every)),
            str(share.seeds),
            str(share.failed),
        ]
        for share in shares
    ]
    headers = ("vessel", "disturbance", "identifier", "interval", *Count._fields, "all",
               "seeds", "failed")  # fmt: skip
    return table(list(headers), rows)


def read(file: Path) -> list[Share]:
    """Coverage as stored."""
    if not file.exists():
        sys.exit(f"{file}: not found; `make coverage` writes it")
    return [share_of(one) for one in json.loads(file.read_text())]


def write(shares: Sequence[Share], file: Path) -> None:
    """Store coverage, in place of that of the same cases and identifiers."""
    stored = read(file) if file.exists() else []
    again = {(share.case, share.identifier) for share in shares}
    kept = [share for share in stored if (share.case, share.identifier) not in again]
    everything = sorted((*kept, *shares), key=place)
    file.parent.mkdir(exist_ok=True)
    file.write_text(json.dumps([record_of(share) for share in everything], indent=1) + "\n")


def place(share: Share) -> tuple[int, int, int, bool]:
    """Where a row of the table stands: by vessel, disturbance, identifier, interval."""
    case, names = share.case, list(IDENTIFIERS)
    return (
        list(VESSELS).index(case.vessel),
        DISTURBANCES.index(case.disturbance),
        names.index(share.identifier),
        not share.covers,
    )


def share_of(held: Mapping[str, Any]) -> Share:
    """A coverage from its record."""
    inertia, damping = (tuple(held["covered"][name]) for name in Count._fields)
    own = {name: held[name] for name in ("identifier", "covers", "seeds", "failed")}
    case = Case(held["vessel"], held["disturbance"])
    return Share(case=case, count=Count(inertia, damping), **own)


def record_of(share: Share) -> dict[str, Any]:
    """The record of a coverage; counts are [covered, all]."""
    return {
        **share.case._asdict(),
        "identifier": share.identifier,
        "covers": share.covers,
        "seeds": share.seeds,
        "failed": share.failed,
        "covered": share.count._asdict(),
    }


def main() -> None:
    """Print the table, of the file or computed."""
    parser = ArgumentParser(description="Coverage of 95 % intervals.")
    parser.add_argument("--seeds", type=int, help="compute it over so many seeds")
    parser.add_argument("--write", action="store_true", help="write results/coverage.json")
    for name, choices in CHOICES.items():
        parser.add_argument(f"--{name}", choices=choices, action="append", help="only these")
    options = parser.parse_args()
    if options.seeds is None:
        shares = read(FILE)
    else:
        vessels, disturbances = options.vessel or VESSELS, options.disturbance or DISTURBANCES
        chosen = [c for c in cases() if c.vessel in vessels and c.disturbance in disturbances]
        names = [name for name in IDENTIFIERS if name in (options.identifier or IDENTIFIERS)]
        shares = computed(options.seeds, chosen, names)
        if options.write:
            write(shares, FILE)
    print(shown(shares), end="")


if __name__ == "__main__":
    main()
