"""Real trials from the command line: which random streams they draw, and what follows from it."""

from collections import defaultdict
from collections.abc import Mapping

import pandas as pd
import pytest

from seatrial.runner.compare.frame import open_results
from seatrial.runner.database import LogbookWriter
from tests.runner.command import Command

DATABASE = "sqlite:///results/results.db"
SHORT = (
    "evaluation=none", "excitation=zigzag", "excitation.duration_s=120", "sample_time_s=0.5",
    "integration_step_s=0.25", "identifier=ls", "identifier.basis=[u_dot,v_dot,r_dot,u,v,r]",
)  # fmt: skip
FACTORS = (
    "excitation", "seed", "identifier", "disturbance", "disturbance.wind.variation",
    "identifier.lowpass_hz",
)  # fmt: skip
SEARCH = (
    "identifier=nsga2", "identifier.parameters=[surge.u,yaw.r]", "identifier.population=8",
    "identifier.generations=2", "identifier.polish=null",
)  # fmt: skip


def without(options: tuple[str, ...], *prefixes: str) -> list[str]:
    return [option for option in options if not option.startswith(prefixes)]


def stored_trials() -> pd.DataFrame:
    with open_results(DATABASE) as results:
        return results.trials(factors=FACTORS)


def numbers(run: int) -> Mapping[tuple[str, ...], object]:
    """All metrics of a run, and its coefficients with their standard errors, by their place."""
    with LogbookWriter.read(DATABASE) as logbook:
        metrics = {(m.name, m.model, m.dof): m.value for m in logbook.metrics(run)}
        found = {
            (c.term, c.model, c.dof): (c.value, c.std_error) for c in logbook.coefficients(run)
        }
    assert metrics
    assert found
    return metrics | found


@pytest.mark.slow
def test_streams_that_are_drawn_and_their_replicates(seatrial: Command) -> None:
    for sweep in (
        ("-m", *SHORT, "disturbance=calm,noise,wind", "seed=0,1"),
        ("-m", *SHORT, "disturbance=wind", "disturbance.wind.variation=gusting", "seed=0,1"),
        ("-m", *SHORT, "disturbance=calm,noise", "identifier.lowpass_hz=0.4"),
        (*without(SHORT, "identifier"), *SEARCH, "disturbance=noise"),
        (*without(SHORT, "excitation"), "excitation=prbs", "excitation.length_s=30"),
    ):
        seatrial.succeeds(*sweep)
    trials = stored_trials()
    assert trials["streams"].notna().all()
    runs = {tuple(map(str, row[[*FACTORS]])): run for run, row in trials.iterrows()}
    drawn = {(key[0], *key[2:]): {*trials["streams"][run].split()} for key, run in runs.items()}
    assert drawn == {
        ("zigzag", "ls", "calm", "none", "auto"): set(),
        ("zigzag", "ls", "calm", "none", "0.4"): set(),
        ("zigzag", "ls", "noise", "none", "auto"): {"noise"},
        ("zigzag", "ls", "noise", "none", "0.4"): {"noise"},
        ("zigzag", "ls", "wind", "constant", "auto"): set(),
        ("zigzag", "ls", "wind", "gusting", "auto"): {"disturbance"},
        ("zigzag", "nsga2", "noise", "none", "none"): {"noise", "identifier"},
        ("prbs", "ls", "calm", "none", "auto"): {"excitation"},
    }
    seeds: dict[tuple[str, ...], list[int]] = defaultdict(list)
    for key, run in runs.items():
        seeds[key[0], *key[2:]].append(run)
    pairs = {key: pair for key, pair in seeds.items() if len(pair) == 2}
    assert len(pairs) == 4
    for key, (one, other) in pairs.items():
        assert (numbers(one) == numbers(other)) == (not drawn[key])  # to the last bit
    experiments = [{*trials["of_experiment"][each]} for each in seeds.values()]
    assert all(len(each) == 1 for each in experiments)  # of all seeds
    assert len(set.union(*experiments) - {None}) == len(drawn)  # one for each choice of options


@pytest.mark.parametrize(("identifier", "value"), [("ls", 1.0), ("iv", 0.0), ("none", None)])
def test_a_run_stores_what_its_standard_errors_are_of(
    seatrial: Command, identifier: str, value: float | None
) -> None:
    options = SHORT if identifier != "none" else without(SHORT, "identifier")
    seatrial.succeeds(*options, f"identifier={identifier}", "disturbance=calm")
    with LogbookWriter.read(DATABASE) as logbook:
        stored = [f.value for f in logbook.diagnostics(1) if f.name == "interval_of_estimate"]
        errors = [c.std_error for c in logbook.coefficients(1) if c.std_error is not None]
    assert stored == ([] if value is None else [value])
    assert bool(errors) == (value is not None)
