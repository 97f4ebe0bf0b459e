"""Any run's model can be rebuilt from its coefficient rows and sailed again."""

from pathlib import Path

import numpy as np
import pytest

from seatrial.models.errors import LogbookError
from seatrial.models.identification.problem import Identified
from seatrial.models.simulation.statespace import StateSpace
from seatrial.models.vessel.table import Vessel
from seatrial.runner import closed_loop
from seatrial.runner import trial as trials
from seatrial.runner.database import Logbook, Reader
from seatrial.runner.database.records import RunStart
from seatrial.runner.record.coefficient_rows import state_space_coefficients, stored_vessel
from tests.trials import composed


def test_a_stored_vessel_sails_the_same_track(tmp_path: Path) -> None:
    trial = composed("identifier=plsr", "disturbance=noise", "seed=3")
    results = trials.run(trial)
    url = f"sqlite:///{tmp_path}/results.db"
    start = RunStart(
        fingerprint="f" * 64, **trial.names, seed=3, config={}, overrides=[], git_commit=None,
        git_dirty=None, versions={}, command="",
    )  # fmt: skip
    with Logbook.open(url, results_dir=tmp_path) as logbook:
        begun = logbook.begin_run(start)
        logbook.finish_run(begun.run_id, results)
    with Reader.read(url, results_dir=tmp_path) as reader:
        for model in ("nominal", "identified"):
            vessel = stored_vessel(reader, begun.run_id, model)
            voyage = closed_loop.sail_mission(
                trial, closed_loop.Streams(trial.seed), vessel, trial.excitation
            ).voyage
            stored = reader.series(begun.run_id, f"deployment_{model}")
            for column, name in enumerate(("x", "y", "psi")):
                np.testing.assert_allclose(
                    stored.columns[name], voyage.log.eta[:, column], atol=1e-9
                )
        with pytest.raises(LogbookError, match="no coefficients"):
            stored_vessel(reader, begun.run_id, "unknown")


def test_a_state_space_model_can_be_made_again_from_its_rows() -> None:
    rng = np.random.default_rng(0)
    shapes = {"A": (2, 2), "B": (2, 1), "C": (3, 2), "D": (3, 1), "K": (2, 3), "x0": (2,)}
    parts = {name: rng.normal(size=shape) for name, shape in shapes.items()}
    table = Vessel("none", ("surge",), (), np.zeros((0, 1)))
    model = StateSpace(**parts, period_s=0.5)
    rows = state_space_coefficients(Identified(table, table, state_space=model))
    again = {name: np.zeros(shape) for name, shape in shapes.items()}
    for row in rows:
        name, _, place = row.term.rstrip("]").partition("[")
        again[name][tuple(int(i) - 1 for i in place.split(","))] = row.value
    assert len(rows) == sum(part.size for part in parts.values())  # none of F
    for name, part in parts.items():
        np.testing.assert_array_equal(again[name], part)
    assert state_space_coefficients(Identified(table, table)) == []
