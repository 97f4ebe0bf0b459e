"""Real trials from the command line: which random streams they draw, and what follows from it."""

from collections.abc import Mapping

import pytest

from seatrial.runner.compare.results import Run, open_results
from seatrial.runner.database import Logbook
from tests.runner.command import Command

DATABASE = "sqlite:///results/results.db"
SHORT = (
    "evaluation=none", "excitation=zigzag", "excitation.duration_s=120", "sample_time_s=0.5",
    "integration_step_s=0.25", "identifier=ls", "identifier.basis=[u_dot,v_dot,r_dot,u,v,r]",
)  # fmt: skip
SEARCH = (
    "identifier=nsga2", "identifier.parameters=[surge.u,yaw.r]", "identifier.population=8",
    "identifier.generations=2", "identifier.polish=null",
)  # fmt: skip


def without(options: tuple[str, ...], *prefixes: str) -> list[str]:
    return [option for option in options if not option.startswith(prefixes)]


def stored_runs() -> list[Run]:
    with open_results(DATABASE) as results:
        return results.runs(factors=["identifier.lowpass_hz"])


def numbers(run: Run) -> Mapping[tuple[str, ...], float | None]:
    """All metrics and coefficients of a run, by their place."""
    with Logbook.read(DATABASE) as logbook:
        metrics = {(m.name, m.model, m.dof): m.value for m in logbook.metrics(run.id)}
        found = {(c.term, c.model, c.dof): c.value for c in logbook.coefficients(run.id)}
        errors = {(*place, "se"): c.std_error for place, c in zip(
            found, logbook.coefficients(run.id), strict=True)}  # fmt: skip
    assert metrics
    assert found
    return metrics | found | errors


def test_streams_that_are_drawn_and_their_replicates(seatrial: Command) -> None:
    for sweep in (
        ("-m", *SHORT, "disturbance=calm,noise,wind", "seed=0,1"),
        ("-m", *SHORT, "disturbance=calm,noise", "identifier.lowpass_hz=0.4"),
        (*without(SHORT, "identifier"), *SEARCH, "disturbance=noise"),
        (*without(SHORT, "excitation"), "excitation=prbs", "excitation.length_s=30"),
    ):
        answer = seatrial(*sweep)
        assert answer.code == 0, answer
    names = ("excitation", "identifier", "disturbance", "seed", "identifier.lowpass_hz")
    runs = {tuple(run.levels[name] for name in names): run for run in stored_runs()}
    drawn = {key[:3]: set(run.drawn or ()) for key, run in runs.items() if run.drawn is not None}
    assert drawn == {
        ("zigzag", "ls", "calm"): set(),
        ("zigzag", "ls", "noise"): {"noise"},
        ("zigzag", "ls", "wind"): {"disturbance"},
        ("zigzag", "nsga2", "noise"): {"noise", "identifier"},
        ("prbs", "ls", "calm"): {"excitation"},
    }
    assert all(run.drawn is not None for run in runs.values())

    pairs = {
        name: [runs["zigzag", "ls", name, seed, "none"] for seed in ("0", "1")]
        for name in ("calm", "noise", "wind")
    }
    for name, (one, other) in pairs.items():
        assert (numbers(one) == numbers(other)) == (name == "calm")  # to the last bit
        assert one.experiment == other.experiment
    filtered = [runs["zigzag", "ls", name, "0", "0.4"] for name in ("calm", "noise")]
    experiments = {run.experiment for run in runs.values()}
    assert len(experiments) == len(pairs) + len(filtered) + 2  # the search and the binary signal
    assert None not in experiments


@pytest.mark.parametrize(("identifier", "value"), [("ls", 1.0), ("iv", 0.0), ("none", None)])
def test_a_run_stores_what_its_standard_errors_are_of(
    seatrial: Command, identifier: str, value: float | None
) -> None:
    options = SHORT if identifier != "none" else without(SHORT, "identifier")
    answer = seatrial(*options, f"identifier={identifier}", "disturbance=calm")
    assert answer.code == 0, answer
    with Logbook.read(DATABASE) as logbook:
        stored = [f.value for f in logbook.diagnostics(1) if f.name == "interval_of_estimate"]
        errors = [c.std_error for c in logbook.coefficients(1) if c.std_error is not None]
    assert stored == ([] if value is None else [value])
    assert bool(errors) == (value is not None)
