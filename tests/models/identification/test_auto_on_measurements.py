"""`auto` on a measured recording: better than the believed model on the half it has not seen."""

import numpy as np
import pytest

from seatrial.runner import trial as trials
from tests.data import DATA
from tests.trials import composed


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.parametrize("vessel", ["beluga_linear", "beluga_diagonal", "beluga_full"])
def test_every_axis_of_random_1_is_predicted_better_than_without(vessel: str) -> None:
    trial = composed(
        f"vessel={vessel}", "identifier=auto", "controller=none", "evaluation=none",
        "excitation=recording", f"excitation.path={DATA}/beluga/random-1.csv",
    )  # fmt: skip
    assert trial.excitation.train_fraction == 0.5
    trials.check(trial)
    results = trials.run(trial)
    errors = {
        (row.model, row.dof): row.value
        for row in results.metrics
        if (row.name, row.stage) == ("velocity_rmse_free_run", "validation")
    }
    worse = {
        dof: (errors["identified", dof], errors["nominal", dof])
        for dof in trial.vessel.dofs
        if not errors["identified", dof] < errors["nominal", dof]
    }
    assert worse == {}
    assert len(trial.vessel.dofs) == 6
    assert np.all(np.isfinite(list(errors.values())))
