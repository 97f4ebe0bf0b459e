"""Any run's model can be rebuilt from its coefficient rows and sailed again."""

from pathlib import Path

import numpy as np
import pytest

from seatrial.models.errors import LogbookError
from seatrial.runner import closed_loop
from seatrial.runner import trial as trials
from seatrial.runner.database import Logbook, Reader
from seatrial.runner.database.records import RunStart
from seatrial.runner.record.coefficient_rows import stored_vessel
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
                trial, closed_loop.streams(trial.seed), vessel, trial.excitation
            ).voyage
            stored = reader.series(begun.run_id, f"deployment_{model}")
            for column, name in enumerate(("x", "y", "psi")):
                np.testing.assert_allclose(
                    stored.columns[name], voyage.log.eta[:, column], atol=1e-9
                )
        with pytest.raises(LogbookError, match="no coefficients"):
            stored_vessel(reader, begun.run_id, "unknown")
