"""Trials run once a session, and their metrics."""

from collections.abc import Callable
from functools import cache

import pytest

from docs.published.printed import HERE, file_of
from seatrial.runner.record.rows import Metric, Results
from seatrial.runner.trials import trial as trials
from tests.runner.compare.conftest import browser as browser
from tests.trials import asked_for


@cache
def run_once(*overrides: str) -> Results:
    name = overrides[0].removeprefix("experiment=")
    moved = [f"hydra.searchpath=[file://{HERE}]"] if file_of(name).exists() else []
    trial = asked_for(*overrides, *moved)
    trials.check(trial)
    return trials.run(trial)


@pytest.fixture(scope="session")
def run() -> Callable[..., Results]:
    """run("identifier=ls", ...) -> the results of that trial; the same trial is run once."""
    return run_once


@pytest.fixture(scope="session")
def metric() -> Callable[..., dict[str, float]]:
    """metric(results, name, model) -> value by degree of freedom."""

    def found(results: Results, name: str, model: str = "identified") -> dict[str, float]:
        rows: list[Metric] = list(results.metrics)
        return {row.dof: row.value for row in rows if (row.name, row.model) == (name, model)}

    return found
