"""Trials run once a session, and their metrics; sweeps with known results."""

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from docs.published.printed import HERE, file_of
from seatrial.runner.record.rows import Metric, Results
from seatrial.runner.trials import trial as trials
from tests.runner.compare import stored
from tests.trials import asked_for

Run = Callable[..., Results]
Values = Callable[..., dict[str, float]]


@cache
def run_once(*overrides: str) -> Results:
    name = overrides[0].removeprefix("experiment=")
    moved = [f"hydra.searchpath=[file://{HERE}]"] if file_of(name).exists() else []
    trial = asked_for(*overrides, *moved)
    trials.check(trial)
    return trials.run(trial)


def store(
    folder: Path, *runs: Results, identifier: str = "ls", first_seed: int = 0, **options: Any
) -> int:
    """The number of a new sweep `mine` in the logbook of a folder, with these results."""
    with stored.logbook_at(folder) as logbook:
        sweep = logbook.begin_sweep("mine", "python -m runner experiment=mine", [], len(runs))
        for seed, results in enumerate(runs, first_seed):
            begin = stored.start(identifier, seed=seed, **options)
            logbook.finish_run(logbook.begin_run(begin, sweep_id=sweep).run_id, results)
    return sweep


@pytest.fixture(scope="session")
def run() -> Run:
    """run("identifier=ls", ...) -> the results of that trial; the same trial is run once."""
    return run_once


@pytest.fixture(scope="session")
def metric() -> Values:
    """metric(results, name, model) -> value by degree of freedom."""

    def found(results: Results, name: str, model: str = "identified") -> dict[str, float]:
        rows: list[Metric] = list(results.metrics)
        return {row.dof: row.value for row in rows if (row.name, row.model) == (name, model)}

    return found
